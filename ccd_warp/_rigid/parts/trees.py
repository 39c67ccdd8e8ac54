"""Trees of the parts of bodies: the primitives of a body are halved until a part has a dozen of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.rotations import EPS
from ccd_warp._scene.mesh import CollisionMesh

# Primitives of a part at most.
PART = 12
_UP = 1.0 + 64.0 * EPS


def ranges(first: NDArray[np.intp], counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """The numbers from each first one on, so many of each."""
    return np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


def distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The different ones of some keys, in their order; by a sort in place, in a tenth of the time of NumPy's table."""
    keys.sort()
    return keys[np.append(keys[1:] != keys[:-1], True)[: len(keys)]]


class PartNodes(NamedTuple):
    """Nodes of trees of parts (`overlap`), those of a tree one after another.

    Attributes:
        centre: Centre of a sphere around each node, in the frame of its body, shape [N, 3].
        radius: Radius of the sphere, shape [N].
        axes: Directions of the sides of a box around the same centre, shape [N, 3, 3].
        half: Half of each side, shape [N, 3].
        thickness: The largest radius of its vertices, shape [N].
    """

    centre: NDArray[np.float64]
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
        tree_of_key: dict[tuple[bytes, ...], int] = {}
        self.of_body = np.zeros(mesh.num_bodies, dtype=np.intp)
        parts: list[Any] = []
        for body in range(mesh.num_bodies):
            of_vertices = slice(*mesh.body_vertex_range[body : body + 2])
            corners_of_body = [
                x[rows[first[body] : first[body + 1]]] - self._first_vertex[body]
                for x, rows, first in zip(corners, self._rows, self._first, strict=True)
            ]
            thickness = b"" if mesh.radius is None else mesh.radius[of_vertices].tobytes()
            key = (vertices[of_vertices].tobytes(), thickness, *(x.tobytes() for x in corners_of_body))
            self.of_body[body] = tree_of_key.setdefault(key, len(tree_of_key))
            if self.of_body[body] == len(parts):
                parts.append(_halved(corners_of_body, vertices[of_vertices]))
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
        """Primitives of bodies, by their numbers in the order of the parts of their bodies (`BodyParts.primitives`)."""
        tree = self.of_body[body]
        row = self._first_row[tree] + number
        corners = self._corners[row] + (self._first_vertex[body] - self._origin[tree])[:, None]
        kind, number = self._kind[row], self._number[row]
        primitive = np.empty(len(row), dtype=np.intp)
        for kind_number, (rows, first) in enumerate(zip(self._rows, self._first, strict=True)):
            is_of_kind = kind == kind_number
            primitive[is_of_kind] = rows[first[body[is_of_kind]] + number[is_of_kind]]
        return corners, kind, primitive

    def _nodes(self, vertices: NDArray[np.float64], radius: NDArray[np.float64] | None, num_nodes: int) -> PartNodes:
        """The nodes of all trees, level by level."""
        arrays = [np.zeros((num_nodes, *shape)) for shape in ((3,), (), (3, 3), (3,), ())]
        part = np.repeat(np.arange(len(self.begins) - 1), np.diff(self.begins))
        of_part, vertex = np.divmod(distinct((part[:, None] * len(vertices) + self._corners).ravel()), len(vertices))
        first_vertex = np.searchsorted(of_part, np.arange(len(self.begins)))
        size = 1
        while size <= self.num_parts.max(initial=0):
            trees = np.flatnonzero(self.num_parts >= size)  # those with so many nodes on a level
            number = np.tile(np.arange(size), len(trees))
            tree = np.repeat(trees, size)
            step = self.num_parts[tree] // size
            part = self.first_part[tree] + number * step
            begin, end = first_vertex[part], first_vertex[part + step]
            node_vertices = vertex[ranges(begin, end - begin)]
            rows = _bounds(vertices[node_vertices], None if radius is None else radius[node_vertices], end - begin)
            for values, row in zip(arrays, rows, strict=True):
                values[self.first_node[tree] + size - 1 + number] = row
            size *= 2
        return PartNodes(*arrays)


def _halved(
    primitives: list[NDArray[np.integer]], vertices: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The parts of a body with these faces, edges and points: corners, kinds, numbers in their order; their sizes."""
    faces, edges, points = primitives
    corners = np.concatenate([faces, edges[:, [0, 1, 1]], np.repeat(points, 3, axis=1)]).astype(np.intp)
    counts = [len(x) for x in primitives]
    kind, number = np.repeat(np.arange(3), counts), np.concatenate([np.arange(n) for n in counts])
    if len(corners) == 0:
        return corners, kind, number, np.zeros(0, dtype=np.intp)
    middle = vertices[corners].mean(axis=1)
    order, sizes = np.arange(len(corners)), np.array([len(corners)])
    while sizes.max() > PART:
        places, starts = middle[order], np.cumsum(sizes) - sizes
        part = np.repeat(np.arange(len(sizes)), sizes)
        extent = np.maximum.reduceat(places, starts) - np.minimum.reduceat(places, starts)
        order = order[np.lexsort((places[np.arange(len(order)), extent.argmax(axis=1)[part]], part))]
        sizes = np.column_stack([sizes // 2, sizes - sizes // 2]).ravel()
    return corners[order], kind[order], number[order], sizes


def _bounds(
    places: NDArray[np.float64], radii: NDArray[np.float64] | None, counts: NDArray[np.intp]
) -> tuple[NDArray[np.float64], ...]:
    """The fields of `PartNodes`, each node with so many corners at these places, at least one, of these radii.

    The sides of a box are along the axes of the frame, or along the principal axes of the corners, whichever box has
    the smaller surface.
    """
    starts = np.cumsum(counts) - counts
    node = np.repeat(np.arange(len(counts)), counts)
    columns = np.ascontiguousarray(places.T)  # NumPy sums rows of three slowly
    from_mean = columns - (np.add.reduceat(columns, starts, axis=1) / counts)[:, node]
    spread = np.empty((len(counts), 3, 3))
    for j, k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        spread[:, j, k] = spread[:, k, j] = np.add.reduceat(from_mean[j] * from_mean[k], starts)
    spread[~np.isfinite(spread).all(axis=(1, 2))] = 0.0
    upright = np.broadcast_to(np.eye(3), spread.shape)
    boxes = [_box(columns, starts, node, axes) for axes in (upright, np.linalg.eigh(spread)[1].transpose(0, 2, 1))]
    is_less = _surface(boxes[1][-1]) < _surface(boxes[0][-1])
    best = [np.where(is_less.reshape(-1, *[1] * (x.ndim - 1)), y, x) for x, y in zip(*boxes, strict=True)]
    thickness = np.zeros(len(counts)) if radii is None else np.maximum.reduceat(radii, starts)
    return *best, thickness


def _box(
    columns: NDArray[np.float64], starts: NDArray[np.intp], node: NDArray[np.intp], axes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Centre, radius, axes and half sides of boxes along axes, shape [N, 3, 3], around the corners of nodes."""
    along_axes = _along(columns, node, axes)
    lower, upper = (f.reduceat(along_axes, starts, axis=1) for f in (np.minimum, np.maximum))
    centre = np.einsum("nji,nj->ni", axes, (0.5 * lower + 0.5 * upper).T)
    from_centre = columns - centre.T[:, node]
    half = np.maximum.reduceat(np.abs(_along(from_centre, node, axes)), starts, axis=1).T * _UP
    x, y, z = from_centre
    radius = np.maximum.reduceat(np.sqrt(x * x + y * y + z * z), starts) * _UP
    return centre, radius, axes, half


def _along(columns: NDArray[np.float64], node: NDArray[np.intp], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners, shape [3, n], along the axes of their nodes."""
    x, y, z = columns
    return np.stack([x * a[node] + y * b[node] + z * c[node] for a, b, c in axes.transpose(1, 2, 0)])


def _surface(half: NDArray[np.float64]) -> NDArray[np.float64]:
    return half[:, 0] * half[:, 1] + half[:, 1] * half[:, 2] + half[:, 2] * half[:, 0]
