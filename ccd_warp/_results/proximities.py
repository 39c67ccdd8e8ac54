"""What is near at one time: the pairs, where they are nearest, and what follows from the mesh."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.pairs import ClosePairs, radii_of_pairs
from ccd_warp._results.shared_features import unique_rows
from ccd_warp._runtime.display import counted, html_table, kind_name, named_counts, pairs_of_bodies
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.mesh import CollisionMesh


@text_completed_by(ClosePairs)
@dataclass(frozen=True, repr=False, eq=False)
class Proximities(ClosePairs):
    """Pairs of primitives that are near at one time: :func:`ccd_warp.find_proximity`.

    They are ordered by :class:`ccd_warp.PairKind` and then lexicographically by primitives. ``proximities[chosen]``,
    with a slice, a mask or an array of indices, is a ``Proximities`` of these alone.

    The closest point of a face may lie on its rim, and that of an edge at an end: a vertex near the common edge of two
    faces is near both, at one and the same point, and near its edges besides. ``features`` says which vertices span the
    closest point of each primitive, and :meth:`unique` keeps each such proximity once.

    Attributes:
        parameters: (u, v) of the closest points, as in :class:`ccd_warp.PairResult`, float64, shape [m, 2].
        distance: Euclidean distance of the closest points, a length, float64, shape [m]. Radii are not subtracted. Of a
            vertex inside a half-space it is negative, its depth.
        direction: Unit vector from the closest point of the second primitive to that of the first, float64, shape
            [m, 3], or [m, 2] in the plane. It is 0 where the two points are the same, and of a vertex and a plane the
            unit normal of the plane.
        features: Which of the four ``vertices`` span the closest features, one bit each, 1, 2, 4 and 8 from the first
            column on, int32, shape [m]. 15 is the inside of a face or of two edges.
        mesh: The mesh.
        positions: Positions of all vertices, float64, shape [V, 3], or [V, 2] in the plane.
        radius: Radius of all vertices, float64, shape [V]; None where there are none.
        shared_by: How many pairs, this one included, have the closest features of each that :meth:`unique` keeps,
            int32, shape [m]; None of all pairs.
    """

    parameters: NDArray[np.float64]
    distance: NDArray[np.float64]
    direction: NDArray[np.float64]
    features: NDArray[np.int32]
    mesh: CollisionMesh
    positions: NDArray[np.float64]
    radius: NDArray[np.float64] | None = None
    shared_by: NDArray[np.int32] | None = field(default_factory=lambda: None)  # so that the class has none

    @classmethod
    def _of_list(cls, count: int, columns: dict[str, Callable[[], NDArray[Any]]], **others: Any) -> "Proximities":
        """A table of so many pairs, whose columns are computed when they are read, and other fields."""
        table = object.__new__(cls)
        others |= {} if "shared_by" in columns else {"shared_by": None}
        vars(table).update(others, _count=count, _unread=columns)
        return table

    if not TYPE_CHECKING:  # no attributes but those that are declared

        def __getattr__(self, name: str) -> Any:
            """A column that has not been read before; of threads that ask at once, each may compute it."""
            unread = vars(self).get("_unread", {})
            column = unread.get(name)
            if column is not None:
                vars(self).setdefault(name, column())
                unread.pop(name, None)
            if name not in vars(self):
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)
            return vars(self)[name]

    def __getstate__(self) -> dict[str, Any]:
        """All columns, read."""
        return self._fields()

    def __len__(self) -> int:
        return vars(self)["_count"] if "_count" in vars(self) else len(self.kind)

    def _known_mesh(self) -> CollisionMesh:
        return self.mesh

    @property
    def normal(self) -> NDArray[np.float64]:
        """``direction``, by the name that it has in contacts."""
        return self.direction

    @lazy_property
    def points(self) -> NDArray[np.float64]:
        """The closest points of both surfaces, of the first and the second, float64, shape [m, 2, 3] or [m, 2, 2].

        Each is the radius of its primitive from the closest point of the primitive, toward the other one. Positions
        weighted with ``weights`` give the closest points of the primitives themselves.
        """
        weights, x = self.weights[..., None], self.positions
        vertices = self.vertices
        of_first = np.maximum(weights[:, 1], 0.0)
        points = np.empty((len(self), 2, x.shape[1]))
        points[:, 0] = weights[:, 0] * x[vertices[:, 0]]
        between = x[vertices[:, 1]]
        points[:, 0] += of_first * between
        points[:, 1] = (of_first - weights[:, 1]) * between
        for column in (2, 3):
            points[:, 1] -= weights[:, column] * x[vertices[:, column]]
        of_plane = self.kind == int(PairKind.VERTEX_PLANE)
        points[of_plane, 1] = points[of_plane, 0] - self.distance[of_plane, None] * self.direction[of_plane]
        if self.radius is not None:
            radii = radii_of_pairs(self.kind, vertices, self.radius, self.mesh._largest_around(self.radius))
            points += (radii * np.array([-1.0, 1.0]))[..., None] * self.direction[:, None]
        return points

    def unique(self) -> "Proximities":
        """Each two closest features once, by the first pair that has them.

        They are two vertices, a vertex and an edge, two edges, or a vertex and a face. What a vertex has to do with an
        edge is listed for each face at the edge, and perhaps for pairs of edges, and what it has to do with a face for
        each face of the same vertices; two edges are in one pair only. ``shared_by`` says in how many.
        """
        mesh, columns = self.mesh, (self.kind, self.primitives, self.features)
        rows, shared_by = unique_rows(*columns, mesh)
        return replace(self[rows], shared_by=shared_by)

    def __repr__(self) -> str:
        if len(self) == 0:
            return "Proximities(no pair)"
        named = ", ".join(named_counts(pairs_of_bodies(self.mesh.names, self.bodies)))
        pairs = counted(len(self), "pair", "pairs")
        return f"Proximities({pairs}: {named}; the least distance is {self.distance.min():.6g})"

    def _repr_html_(self) -> str:
        return html_table(repr(self), ("kind", "primitives", "bodies", "distance"), list(self._rows()))

    def _rows(self) -> Iterator[tuple[str, str, str, float]]:
        names = self.mesh.names
        columns = (self.kind, self.primitives, self.bodies, self.distance)
        for kind, (i, j), (a, b), distance in zip(*(column.tolist() for column in columns), strict=True):
            yield kind_name(PairKind(kind)), f"{i}, {j}", f"{names[a]}, {names[b]}", distance
