"""What intersects at one time: the pairs, where they meet, and what follows from the mesh."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.pairs import PairTable, bodies_of, vertices_of
from ccd_warp._runtime.display import counted, html_table, kind_name, named_counts, pairs_of_bodies, point_text
from ccd_warp._runtime.status import IntersectionKind
from ccd_warp._scene.mesh import CollisionMesh


class Crossings:
    """Which pairs of a table pass through each other, and which touch."""

    kind: NDArray[np.int32]
    points: NDArray[np.float64]

    @property
    def is_crossing(self) -> NDArray[np.bool_]:
        """Whether the pair passes through each other, bool, shape [m]; otherwise it touches, and CCD has it at toi 0.

        Edges through faces, and in the plane edges that cross, are what :func:`ccd_warp.mesh_ccd` does not see.
        """
        crossing = IntersectionKind.EDGE_FACE if self.points.shape[1] == 3 else IntersectionKind.EDGE_EDGE
        is_crossing: NDArray[np.bool_] = self.kind == int(crossing)
        return is_crossing

    @property
    def num_crossing(self) -> int:
        """Number of pairs that pass through each other."""
        return int(self.is_crossing.sum())

    @property
    def num_touching(self) -> int:
        """Number of pairs that touch."""
        return len(self.kind) - self.num_crossing


@dataclass(frozen=True, repr=False, eq=False)
class Intersections(Crossings, PairTable):
    """Pairs of primitives that touch or pass through each other at one time: :func:`ccd_warp.find_intersections`.

    They are ordered by :class:`ccd_warp.IntersectionKind` and then lexicographically by primitives.
    ``intersections[chosen]``, with a slice, a mask or an array of indices, is an ``Intersections`` of these alone.

    Attributes:
        kind: :class:`ccd_warp.IntersectionKind` of each pair, int32, shape [m].
        primitives: Indices of a vertex and a face; of two edges, the lower first; of the vertex and the edge of a point
            on a segment; of two points, the lower first; of an edge and a face; or of a vertex and a plane of
            ``mesh.planes``; int32, shape [m, 2].
        parameters: (u, v) of the common point as in :class:`ccd_warp.PairResult`, and of an edge through a face the
            place f0 + u (f1 − f0) + v (f2 − f0) in the face, within 1e-7 of the exact ones, float64, shape [m, 2].
            Where two edges overlap in a segment, those of its middle.
        edge_parameter: Of an edge through a face the place e0 + s (e1 − e0) on the edge, 0 for all other kinds,
            float64, shape [m].
        points: The common points, a length, float64, shape [m, 3], or [m, 2] in the plane. Of a vertex in a half-space
            that of the vertex.
        vertices: Vertices of each pair, two columns for the first primitive and three for the second, which repeat the
            last vertex of a primitive that has less, and for a plane the vertex that meets it, int32, shape [m, 5].
        bodies: Bodies of the first and the second primitive, int32, shape [m, 2].
        world: World of each pair, int32, shape [m].
        mesh: The mesh.
    """

    parameters: NDArray[np.float64]
    edge_parameter: NDArray[np.float64]
    points: NDArray[np.float64]
    vertices: NDArray[np.int32]
    bodies: NDArray[np.int32]
    world: NDArray[np.int32]
    mesh: CollisionMesh

    def by_bodies(self) -> Counter[tuple[str, str]]:
        """Number of pairs by the names of their bodies, the body with the lower index first."""
        return pairs_of_bodies(self.mesh.names, self.bodies)

    def describe(self) -> str:
        """What intersects, in a sentence: how many pairs, of which kinds and bodies."""
        if len(self) == 0:
            return "nothing touches or passes through another"
        parts = []
        is_crossing = self.is_crossing
        for pairs, words in (
            (self[is_crossing], ("pair passes", "pairs pass", "through each other")),
            (self[~is_crossing], ("pair touches", "pairs touch", "")),
        ):
            if len(pairs):
                text = " ".join(filter(None, [counted(len(pairs), *words[:2]), words[2]]))
                parts.append(f"{text}: {', '.join(named_counts(pairs.by_bodies()))}")
        return "; ".join(parts)

    def __repr__(self) -> str:
        return f"Intersections({self.describe()})"

    def _repr_html_(self) -> str:
        names = self.mesh.names
        rows = [
            (kind_name(kind), f"{i}, {j}", f"{names[a]}, {names[b]}", point_text(point))
            for kind, (i, j), (a, b), point in self._rows()
        ]
        return html_table(repr(self), ("kind", "primitives", "bodies", "point"), rows)

    def _rows(self) -> Iterator[tuple[IntersectionKind, list[int], list[int], list[float]]]:
        kinds = map(IntersectionKind, self.kind.tolist())
        return zip(kinds, self.primitives.tolist(), self.bodies.tolist(), self.points.tolist(), strict=True)


def located(
    mesh: CollisionMesh,
    x: NDArray[np.float64],
    kind: NDArray[np.int32],
    primitives: NDArray[np.int32],
    parameters: NDArray[np.float64],
) -> Intersections:
    """The intersections of a mesh at positions x, from (u, v) and the parameter on the edge, shape [m, 3]."""
    vertices = vertices_of(mesh, IntersectionKind, kind, primitives, width=5)
    first, second = x[vertices[:, 0]], x[vertices[:, 1]]
    along = np.where(kind == int(IntersectionKind.EDGE_FACE), parameters[:, 2], parameters[:, 0])[:, None]
    is_edge = np.isin(kind, (int(IntersectionKind.EDGE_FACE), int(IntersectionKind.EDGE_EDGE)))[:, None]
    points = np.where(is_edge, (1.0 - along) * first + along * second, first)
    bodies = bodies_of(mesh, IntersectionKind, kind, primitives, vertices)
    world = mesh.vertex_world[vertices[:, 0]]
    return Intersections(
        kind, primitives, parameters[:, :2].copy(), parameters[:, 2].copy(), points, vertices, bodies, world, mesh
    )


def crossing_at_start(start: Intersections | None) -> str:
    """What crosses at the start of a step, empty if nothing does or nobody has looked."""
    return f"at the start {start[start.is_crossing].describe()}" if start is not None and start.num_crossing else ""
