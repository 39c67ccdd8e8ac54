"""Trees of the parts of bodies: the primitives of a body are halved until a part has a dozen of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._joint_courses import EPS

if TYPE_CHECKING:
    from ccd_warp._mesh import CollisionMesh

# Primitives of a part at most.
PART = 12
_UP = 1.0 + 64.0 * EPS


def ranges(first: NDArray[np.intp], counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """The numbers from each first one on, so many of each."""
    return np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


class PartNodes(NamedTuple):
    """Nodes of trees of parts (`near_parts`), those of a tree one after another.

    Attributes:
        centre: Centre of a sphere around each node, in the frame of its body, shape [N, 3].
        arm: Length of that, shape [N].
        radius: Radius of the sphere, shape [N].
        axes: Directions of the sides of a box around the same centre, shape [N, 3, 3].
        half: Half of each side, shape [N, 3].
        thickness: The largest radius of its vertices, shape [N].
    """

    centre: NDArray[np.float64]
    arm: NDArray[np.float64]
    radius: NDArray[np.float64]
    axes: NDArray[np.float64]
    half: NDArray[np.float64]
    thickness: NDArray[np.float64]


class PartTrees:
    """The trees of the bodies of a mesh, of which those that are copies of one in their own frames have one.

    Attributes:
        of_body: The tree of each body, shape [B].
        num_parts: The number of parts of each tree, a power of two; 0 of a body without primitives, shape [S].
        first_part: The first part of each tree, shape [S + 1].
        first_node: Its first node, shape [S].
        begins: The first primitive of each part, shape [P + 1].
        nodes: The nodes.
    """

    def __init__(self, mesh: CollisionMesh, vertices: NDArray[np.float64]) -> None:
        """Divide the bodies of a mesh whose vertices, of rigid bodies in their own frames, are at these places."""
        points = mesh.codimensional_points[:, None]
        corners = [mesh.faces, mesh.edges[mesh.codimensional_edges], points]
        self._first_vertex = mesh.body_vertex_range[:-1].astype(np.intp)
        bodies = [mesh.vertex_body[x[:, 0]] for x in corners]
        self._rows = [np.argsort(body, kind="stable") for body in bodies]  # by body, for each kind
        every = np.arange(mesh.num_bodies + 1)
        self._first = [np.searchsorted(body[rows], every) for body, rows in zip(bodies, self._rows, strict=True)]
        found: dict[tuple[bytes, ...], int] = {}
        self.of_body = np.zeros(mesh.num_bodies, dtype=np.intp)
        parts: list[Any] = []
        for body in range(mesh.num_bodies):
            of_vertices = slice(*mesh.body_vertex_range[body : body + 2])
            own = [
                x[rows[first[body] : first[body + 1]]] - self._first_vertex[body]
                for x, rows, first in zip(corners, self._rows, self._first, strict=True)
            ]
            thickness = b"" if mesh.radius is None else mesh.radius[of_vertices].tobytes()
            key = (vertices[of_vertices].tobytes(), thickness, *(x.tobytes() for x in own))
            self.of_body[body] = found.setdefault(key, len(found))
            if self.of_body[body] == len(parts):
                parts.append(_halved(own, vertices[of_vertices]))
                parts[-1][0][:] += self._first_vertex[body]
        # the primitives of all trees: vertices of the first body that has the tree, kinds, and numbers in the body
        self._corners, self._kind, self._number = (np.concatenate(x) for x in list(zip(*parts, strict=True))[:3])
        self._origin = np.zeros(len(parts), dtype=np.intp)
        self._origin[self.of_body[::-1]] = self._first_vertex[::-1]
        sizes = np.concatenate([x[3] for x in parts])
        self.begins = np.append(0, np.cumsum(sizes))
        self.num_parts = np.array([len(x[3]) for x in parts], dtype=np.intp)
        self.first_part = np.append(0, np.cumsum(self.num_parts))
        self._first_row = self.begins[self.first_part]
        num_nodes = np.maximum(2 * self.num_parts - 1, 0)
        self.first_node = np.cumsum(num_nodes) - num_nodes
        self.nodes = self._nodes(vertices, mesh.radius, int(num_nodes.sum()))

    def primitives(
        self, body: NDArray[np.intp], number: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Primitives of bodies, by their numbers in the order of the parts of their bodies (`NearParts.primitives`)."""
        tree = self.of_body[body]
        row = self._first_row[tree] + number
        corners = self._corners[row] + (self._first_vertex[body] - self._origin[tree])[:, None]
        kind, number = self._kind[row], self._number[row]
        found = np.empty(len(row), dtype=np.intp)
        for each, (rows, first) in enumerate(zip(self._rows, self._first, strict=True)):
            own = kind == each
            found[own] = rows[first[body[own]] + number[own]]
        return corners, kind, found

    def _nodes(self, vertices: NDArray[np.float64], radius: NDArray[np.float64] | None, num_nodes: int) -> PartNodes:
        """The nodes of all trees, level by level."""
        found = [np.zeros((num_nodes, *shape)) for shape in ((3,), (), (), (3, 3), (3,), ())]
        size = 1
        while size <= self.num_parts.max(initial=0):
            trees = np.flatnonzero(self.num_parts >= size)  # those with so many nodes on a level
            number = np.tile(np.arange(size), len(trees))
            tree = np.repeat(trees, size)
            step = self.num_parts[tree] // size
            part = self.first_part[tree] + number * step
            begin, end = self.begins[part], self.begins[part + step]
            corners = self._corners[ranges(begin, end - begin)].ravel()
            rows = _bounds(vertices[corners], None if radius is None else radius[corners], 3 * (end - begin))
            for values, own in zip(found, rows, strict=True):
                values[self.first_node[tree] + size - 1 + number] = own
            size *= 2
        return PartNodes(*found)


def _halved(
    primitives: list[NDArray[np.integer]], vertices: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The parts of a body with these faces, edges and points: corners, kinds, numbers in their order; their sizes."""
    faces, edges, points = primitives
    corners = np.concatenate([faces, edges[:, [0, 1, 1]], np.repeat(points, 3, axis=1)]).astype(np.intp)
    counts = [len(x) for x in primitives]
    kind, number = np.repeat(np.arange(3), counts), np.concatenate([np.arange(n) for n in counts])
    middle = vertices[corners].mean(axis=1) if len(corners) else np.zeros((0, 3))
    parts = [np.arange(len(corners))] if len(corners) else []
    while max(map(len, parts), default=0) > PART:
        parts = [half for rows in parts for half in _halves(rows, middle)]
    order = np.concatenate([*parts, np.zeros(0, np.intp)])
    return corners[order], kind[order], number[order], np.array([len(x) for x in parts], dtype=np.intp)


def _halves(rows: NDArray[np.intp], middle: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Both halves of primitives along the axis on which they extend most."""
    places = middle[rows]
    half = len(rows) // 2
    sides = np.argpartition(places[:, int(np.ptp(places, axis=0).argmax())], half)
    return [rows[sides[:half]], rows[sides[half:]]]


def _bounds(
    places: NDArray[np.float64], radii: NDArray[np.float64] | None, counts: NDArray[np.intp]
) -> tuple[NDArray[np.float64], ...]:
    """The fields of `PartNodes`, each node with so many corners at these places, at least one, of these radii.

    The sides of a box are along the axes of the frame, or along the principal axes of the corners, whichever box has
    the smaller surface.
    """
    starts = np.cumsum(counts) - counts
    from_mean = places - np.repeat(np.add.reduceat(places, starts) / counts[:, None], counts, axis=0)
    spread = np.add.reduceat(from_mean[:, :, None] * from_mean[:, None], starts)
    spread[~np.isfinite(spread).all(axis=(1, 2))] = 0.0
    best: list[Any] = []
    for axes in (np.broadcast_to(np.eye(3), spread.shape), np.linalg.eigh(spread)[1].transpose(0, 2, 1)):
        own = np.einsum("nij,nj->ni", np.repeat(axes, counts, axis=0), places)
        lower, upper = (f.reduceat(own, starts) for f in (np.minimum, np.maximum))
        centre = np.einsum("nji,nj->ni", axes, 0.5 * lower + 0.5 * upper)
        from_centre = places - np.repeat(centre, counts, axis=0)
        sides = np.abs(np.einsum("nij,nj->ni", np.repeat(axes, counts, axis=0), from_centre))
        half = np.maximum.reduceat(sides, starts) * _UP
        radius = np.maximum.reduceat(np.linalg.norm(from_centre, axis=1), starts) * _UP
        surface = half[:, 0] * half[:, 1] + half[:, 1] * half[:, 2] + half[:, 2] * half[:, 0]
        found: list[Any] = [centre, np.linalg.norm(centre, axis=1) * _UP, radius, axes, half, surface]
        if best:
            is_less = np.less(found[-1], best[-1])
            found = [
                np.where(np.reshape(is_less, (-1, *[1] * (x.ndim - 1))), x, y) for x, y in zip(found, best, strict=True)
            ]
        best = found
    thickness = np.zeros(len(counts)) if radii is None else np.maximum.reduceat(radii, starts)
    return *best[:-1], thickness
