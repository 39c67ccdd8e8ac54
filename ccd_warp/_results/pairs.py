"""Tables of pairs of primitives: what contacts, what is near and what intersects have in common."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._runtime.status import IntersectionKind, PairKind, primitives_of

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

# Fields of a table that have no row for each pair.
_OF_MESH = ("mesh", "positions", "radius")
_NO_VERTEX = np.iinfo(np.int32).max


def pair_corners(
    mesh: "CollisionMesh", kind: PairKind | IntersectionKind, primitives: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Vertices of both primitives of each pair of a kind, int32, shapes [m, 1 to 3], and [m, 0] of a plane.

    Raises:
        ValueError: If the mesh does not have such primitives.
    """
    tables: dict[str, tuple[str, int, Any]] = {
        "vertex": ("vertices", mesh.num_vertices, None),
        "edge": ("edges", mesh.num_edges, mesh.edges),
        "face": ("faces", mesh.num_faces, mesh.faces),
        "plane": ("planes", len(mesh.planes), np.zeros((len(mesh.planes), 0), dtype=np.int32)),
    }
    sides = []
    for name, ids in zip(primitives_of(kind), primitives.T, strict=True):
        names, count, table = tables[name]
        if len(ids) and not (ids.min() >= 0 and ids.max() < count):
            raise ValueError(
                f"contacts.primitives holds {ids[(ids < 0) | (ids >= count)][0]}; "
                f"expected indices of the mesh's {count} {names}"
            )
        sides.append(ids[:, None] if table is None else table[ids])
    return sides[0], sides[1]


def as_slice(rows: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Ascending indices of rows, as a slice where they follow each other: tables are mostly sorted by kind."""
    return slice(rows[0], rows[-1] + 1) if rows[-1] - rows[0] == len(rows) - 1 else rows


def vertices_of(
    mesh: "CollisionMesh",
    kinds: type[PairKind] | type[IntersectionKind],
    kind: NDArray[np.int32],
    primitives: NDArray[np.int32],
    width: int = 4,
) -> NDArray[np.int32]:
    """The vertices of each pair, shape [m, width]: two columns for the first primitive, or one next to a face of four.

    The last vertex of a primitive that has fewer is repeated, and that of the first stands for a plane.
    """
    vertices = np.empty((len(kind), width), dtype=np.int32)
    for member in kinds:
        indices = np.flatnonzero(kind == int(member))
        if len(indices) == 0:
            continue
        sides, rows = pair_corners(mesh, member, primitives[indices]), as_slice(indices)
        b = sides[1].shape[1]
        of_first = width - max(b, width - 2) if b else width
        for side, begin, end in zip(sides, (0, of_first), (of_first, width), strict=True):
            for column in range(begin, end):
                vertices[rows, column] = side[:, min(column - begin, side.shape[1] - 1)]
    return vertices


def bodies_of(
    mesh: "CollisionMesh",
    kinds: type[PairKind] | type[IntersectionKind],
    kind: NDArray[np.int32],
    primitives: NDArray[np.int32],
    vertices: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Bodies of the first and the second primitive of each pair with these vertices, shape [m, 2]."""
    bodies: NDArray[np.int32] = mesh.vertex_body[vertices[:, [0, -1]]]
    is_plane = kind == int(kinds.VERTEX_PLANE)
    bodies[is_plane, 1] = mesh.planes.bodies[primitives[is_plane, 1]]
    return bodies


def pair_vertices(mesh: "CollisionMesh", pairs: "PairTable") -> NDArray[np.int32]:
    """The vertices of contacts, or of what is near, shape [m, 4], as :attr:`ClosePairs.vertices` has them."""
    return vertices_of(mesh, PairKind, pairs.kind, pairs.primitives)


def pair_bodies(mesh: "CollisionMesh", pairs: "PairTable") -> NDArray[np.int32]:
    """Bodies of the first and the second primitive of each of them, shape [m, 2]."""
    return bodies_of(mesh, PairKind, pairs.kind, pairs.primitives, pair_vertices(mesh, pairs))


def radii_of_pairs(
    kind: NDArray[np.int32],
    vertices: NDArray[np.int32],
    radius: NDArray[np.float64],
    around: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Radii of both primitives of each pair with these vertices, shape [m, 2].

    A primitive has the largest of its vertices; a plane has none, and meets the largest ``around`` its vertex.
    """
    of_vertices, is_first = radius[vertices], first_columns(kind)
    radii = np.stack([np.where(side, of_vertices, 0.0).max(axis=1) for side in (is_first, ~is_first)], axis=1)
    of_planes = kind == int(PairKind.VERTEX_PLANE)
    radii[of_planes] = np.stack([around[vertices[of_planes, 0]], np.zeros(of_planes.sum())], axis=1)
    return radii


def first_columns(kind: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which of the four vertices of each pair belong to the first primitive, shape [m, 4]."""
    is_first: NDArray[np.bool_] = np.arange(4) < np.where(kind == int(PairKind.VERTEX_FACE), 1, 2)[:, None]
    return is_first


def features_of(
    kind: NDArray[np.int32], vertices: NDArray[np.integer[Any]], spans: NDArray[np.bool_]
) -> list[NDArray[np.int64]]:
    """Numbers of the vertices or edges that one or two of the vertices of each primitive span, of both sides."""
    columns = np.ascontiguousarray(vertices.T)  # NumPy takes a third of the time column by column
    of_face = kind == int(PairKind.VERTEX_FACE)
    first = {0: spans[:, 0], 1: spans[:, 1] & ~of_face}
    second = {1: spans[:, 1] & of_face, 2: spans[:, 2], 3: spans[:, 3]}
    features = []
    for side in (first, second):
        low = reduce(np.minimum, [np.where(spanned, columns[k], _NO_VERTEX) for k, spanned in side.items()])
        high = reduce(np.maximum, [np.where(spanned, columns[k], -1) for k, spanned in side.items()])
        features.append(feature_number(low, high))
    return features


def feature_number(low: NDArray[np.integer[Any]], high: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """One number for each edge from a vertex to a higher one, or vertex, where both are the same."""
    number: NDArray[np.int64] = high.astype(np.int64) << 32 | low.astype(np.int64)
    return number


@dataclass(frozen=True, repr=False, eq=False)
class PairTable:
    """Pairs by their kinds and primitives; subclasses add columns, and may add the mesh and its positions."""

    kind: NDArray[np.int32]
    primitives: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.kind)

    def __getitem__(self, index: slice | NDArray[Any] | list[int] | list[bool]) -> Self:
        if isinstance(index, (int, np.integer)):
            raise TypeError(f"index is {index}; expected a slice, a mask or a list of indices")
        return self._subset(index)

    def _subset(self, index: slice | Sequence[int] | Sequence[bool] | NDArray[Any]) -> Self:
        """The pairs with these indices alone."""
        if not isinstance(index, slice):
            index = np.asarray(index) if len(index) else np.zeros(0, dtype=np.int64)
            if index.dtype == bool and index.shape == (len(self),):
                index = np.flatnonzero(index)
        # NumPy takes rows in a fifth of the time in which it indexes by them
        is_rows = not isinstance(index, slice) and index.ndim == 1 and index.dtype != bool
        of_rows = {name: v for name, v in self._fields().items() if v is not None and name not in _OF_MESH}
        taken = {name: v.take(index, axis=0) if is_rows else v[index] for name, v in of_rows.items()}
        return type(self)(**(self._fields() | taken))

    def _fields(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


class ClosePairs(PairTable):
    """Pairs of the kinds that CCD knows, with their closest points: contacts, and what is near.

    Attributes:
        kind: :class:`ccd_warp.PairKind` of each pair, int32, shape [m].
        primitives: Indices of a vertex and a face, of two edges, of the vertex and the edge of a codimensional point
            and a codimensional edge (in the plane of any vertex and edge), of the vertices of two codimensional points,
            or of a vertex and a plane of ``mesh.planes``, int32, shape [m, 2].
    """

    parameters: NDArray[np.float64]

    def _known_mesh(self) -> "CollisionMesh":
        """The mesh of the pairs."""
        raise NotImplementedError

    def _mesh_or_none(self) -> "CollisionMesh | None":
        """The mesh of the pairs; None where they were made of arrays alone."""
        return self._known_mesh()

    def _to_exclude(self, mesh: "CollisionMesh") -> dict[str, NDArray[np.int32]]:
        """The pairs by the keys of ``exclude_pairs`` of a mesh.

        Raises:
            ValueError: If they are those of a mesh with other primitives.
        """
        source = self._mesh_or_none()
        for name in ("edges", "faces"):
            of_mesh = getattr(mesh, name)
            if source is not None and source is not mesh and not np.array_equal(getattr(source, name), of_mesh):
                raise ValueError(
                    f"exclude_pairs is {self!r} of a mesh with {len(getattr(source, name))} other {name}; expected "
                    f"contacts or proximities of a mesh with the {len(of_mesh)} {name} of this one"
                )
        return {kind.name.lower(): self.primitives[self.kind == int(kind)] for kind in PairKind}

    def _kept(self) -> dict[str, Any]:
        """Where stays what has been computed of the pairs; threads that ask at once may compute the same twice."""
        return vars(self)

    def _once(self, name: str, compute: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """What stays under this name, computed if it is not there yet."""
        kept = self._kept()
        if kept.get(name) is None:
            kept[name] = compute()
        values: NDArray[Any] = kept[name]
        return values

    @property
    def vertices(self) -> NDArray[np.int32]:
        """Vertices of each pair, int32, shape [m, 4].

        They are v, f0, f1, f2; ea0, ea1, eb0, eb1; p, p, a, b; p, p, q, q; or of a vertex and a plane v, v, v, v.
        Columns repeat the vertex of a point so that there are always four.
        """
        return self._once("vertices", lambda: pair_vertices(self._known_mesh(), self))

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the four ``vertices`` in the difference of the closest points, float64, shape [m, 4].

        Those of the first primitive add up to 1, those of the second to -1, and a column that repeats a vertex has
        weight 0. The derivative of the distance by the position of a vertex is its weight times ``normal``, or
        ``direction`` of what is near: a force of magnitude f that pushes the two apart is f times that on each vertex.
        """
        return self._once("weights", lambda: _weights(self.kind, self.parameters))

    @property
    def bodies(self) -> NDArray[np.int32]:
        """Bodies of the first and the second primitive of each pair, int32, shape [m, 2]."""
        return bodies_of(self._known_mesh(), PairKind, self.kind, self.primitives, self.vertices)

    @property
    def world(self) -> NDArray[np.int32]:
        """World of each pair, int32, shape [m]."""
        return self._once("world", lambda: self._known_mesh().vertex_world[self.vertices[:, 0]])


def _weights(kind: NDArray[np.int32], parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    u, v = parameters.T
    one, zero = np.ones(len(kind)), np.zeros(len(kind))
    by_kind: dict[PairKind, tuple[Any, ...]] = {
        PairKind.VERTEX_FACE: (one, u + v - 1.0, -u, -v),
        PairKind.EDGE_EDGE: (1.0 - u, u, v - 1.0, -v),
        PairKind.POINT_SEGMENT: (one, zero, u - 1.0, -u),
        PairKind.POINT_POINT: (one, zero, -one, zero),
        PairKind.VERTEX_PLANE: (one, zero, zero, zero),
    }
    weights = np.empty((len(kind), 4))
    for of_kind, columns in by_kind.items():
        rows = kind == int(of_kind)
        weights[rows] = np.stack(columns, axis=1)[rows]
    return weights
