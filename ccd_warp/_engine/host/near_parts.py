"""Which parts of bodies may touch in slices of a motion, by spheres and boxes, before a vertex is placed.

The faces of a body are halved until a part has a dozen of them; a part has a sphere in the frame of its body, which
goes with it, or stands in a box. Two parts cannot touch in a window of time if in the middle of it they are farther
apart than their points can come nearer in half of it (`_joint_sweeps`). Trees of the parts of two bodies are tested
from the top, and a slice is halved into windows where that separates more (`kernels.search.near_parts`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._joint_courses import EPS

if TYPE_CHECKING:
    from ccd_warp._mesh import CollisionMesh
    from ccd_warp._runtime.launch import Execution

# Primitives of a part at most.
PART = 12
_UP = 1.0 + 64.0 * EPS
# Tests of pairs of bodies in a launch, links in windows, and pairs of parts for which there is room at first.
_MOST_ITEMS, _MOST_POSES, _ROOM = 1 << 22, 1 << 17, 1 << 16
_LONG = 1 << 14  # items from which an interrupt would have to wait


class PartTree(NamedTuple):
    """The trees of the parts of all bodies, node by node, those of a body one after another (`near_parts`).

    Attributes:
        first: The first node of each body, shape [B].
        num_parts: The number of its parts, a power of two; 0 of one without primitives, shape [B].
        first_part: The first of its parts, shape [B + 1].
        centre: Centre of a sphere around each node, in the frame of its body, shape [N, 3].
        arm: Length of that, shape [N].
        radius: Radius of the sphere, shape [N].
        axes: Directions of the sides of a box around the same centre, shape [N, 3, 3].
        half: Half of each side, shape [N, 3].
        thickness: The largest radius of its vertices, shape [N].
    """

    first: NDArray[np.int32]
    num_parts: NDArray[np.int32]
    first_part: NDArray[np.int32]
    centre: NDArray[np.float64]
    arm: NDArray[np.float64]
    radius: NDArray[np.float64]
    axes: NDArray[np.float64]
    half: NDArray[np.float64]
    thickness: NDArray[np.float64]


def spans(each: NDArray[np.intp], t_max: float) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """So many slices of [0, t_max] for each world: the world, the begin and the end of each slice."""
    world = np.repeat(np.arange(len(each)), each)
    number = np.arange(len(world)) - np.repeat(np.cumsum(each) - each, each)
    begin, end = (t_max * (number + k) / each[world] for k in (0, 1))
    return world, begin, np.where(number + 1 == each[world], t_max, end)


def ranges(first: NDArray[np.intp], counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """The numbers from each first one on, so many of each."""
    return np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


def distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The different ones of some keys, in their order; by a sort in place, in a tenth of the time of NumPy's table."""
    keys.sort()
    return keys[np.append(keys[1:] != keys[:-1], True)[: len(keys)]]


class NearParts:
    """The parts of the bodies of a mesh of one world, and which of them may touch.

    Attributes:
        tree: The trees of the bodies.
        mesh: The mesh.
        body: The body of each part, shape [P].
        begins: The first primitive of each part, shape [P + 1].
        primitives: Vertices of all primitives in the order of the parts, one of fewer than three repeated, [n, 3].
        kind: 0 of a face, 1 of a codimensional edge, 2 of a codimensional point, shape [n].
        number: The number of each among those of its kind, shape [n].
        link_of: The row of a motion that a rigid body is, shape [B].
        pairs: Pairs of bodies that may collide, of which one moves, shape [m, 2]; the first is a link.
    """

    def __init__(self, mesh: CollisionMesh, vertices: NDArray[np.float64]) -> None:
        """Divide the bodies of a mesh whose vertices, of links in their own frames, are at these places."""
        self.mesh = mesh
        self.primitives, order, self.begins, counts = _halved(mesh, vertices)
        self.body = np.repeat(np.arange(mesh.num_bodies), counts)
        bounds = np.cumsum([0, mesh.num_faces, len(mesh.codimensional_edges)])
        self.kind = np.searchsorted(bounds, order, side="right") - 1
        self.number = order - bounds[self.kind]
        self.tree = _tree(mesh, vertices, self.primitives, self.begins, counts)
        self.link_of = np.cumsum(mesh.rigid) - 1
        self.pairs = _pairs(mesh)
        self._on_device: dict[str, tuple[Any, Any]] = {}

    def num_bodies(self, group: NDArray[np.intp], part: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Of how many bodies the parts of each of so many groups are."""
        keys = distinct(group * self.mesh.num_bodies + self.body[part])
        return np.bincount(keys // self.mesh.num_bodies, minlength=count)

    def near(
        self,
        motion: Any,
        world: NDArray[np.intp],
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        reach: float,
        execution: Execution,
        halvings: int = 0,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
        """Pairs of parts that may come within a distance in windows of slices of the step.

        Args:
            motion: The motion, whose rows are the rigid bodies.
            world: World of each slice, shape [n].
            begin: Its begin.
            end: Its end.
            reach: The distance, Euclidean, besides the radii of the vertices.
            execution: Where to test.
            halvings: A slice has 2^halvings windows of the same length.

        Returns:
            The window and both parts of each pair, in no order; windows are numbered through all slices.

        Guarantee: two primitives of different parts of bodies that may collide, which come within the distance at some
        time of a window, on the trajectories of the motion in the mathematics of real numbers, are in such a pair. That
        holds for windows whose ends are off by a few units in the last place of 1.
        """
        found: list[tuple[Any, ...]] = [(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.int32))]
        if len(self.pairs):
            num_links = int(self.mesh.rigid.sum())
            most = min(_MOST_ITEMS // len(self.pairs), (_MOST_POSES >> halvings) // num_links)
            room = _ROOM
            for first in range(0, len(world), max(1, most)):
                some = slice(first, first + max(1, most))
                part, room = self._near(
                    motion._of_worlds(world[some]), begin[some], end[some], reach, execution, halvings, room
                )
                found.append((part[0] + (first << halvings), *part[1:]))
        window, a, b = (np.concatenate(x) for x in zip(*found, strict=True))
        return window, a, b

    def _near(
        self, motion: Any, begin: Any, end: Any, reach: float, execution: Execution, halvings: int, room: int
    ) -> tuple[list[NDArray[Any]], int]:
        """The pairs in some slices, and for how many there is room now."""
        from ccd_warp.kernels.search import near_parts as kernels  # few programs need it

        pairs, trees, links = self._arrays(execution.device)
        counts = 1 << np.arange(halvings + 1)
        share = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
        swept = motion._sweeps(begin, end, begin + share[:, None] * (end - begin), links)

        def on_device(values: NDArray[np.float64], dtype: Any) -> wp.array:
            rows = np.ascontiguousarray(values).reshape(len(begin), -1, values.shape[-1])
            return wp.array(rows, dtype=dtype, device=execution.device, copy=execution.is_cuda)

        given = kernels.PartMotion()
        given.num_links, given.num_halvings = swept.position.shape[2], halvings
        given.position, given.velocity, given.omega = (
            on_device(values, wp.vec3d) for values in (swept.position, swept.velocity, swept.omega)
        )
        given.rotation = on_device(swept.rotation, wp.vec4d)
        given.reach = on_device(swept.reach, kernels.vec6d)
        given.relative_reach = on_device(swept.relative, kernels.vec6d)
        num_items = len(begin) * len(self.pairs)
        while True:
            near = kernels.NearPairs()
            near.count = wp.zeros((1, 1), dtype=wp.int64, device=execution.device)
            near.window = wp.empty(room, dtype=wp.int64, device=execution.device)
            near.a, near.b = (wp.empty(room, dtype=wp.int32, device=execution.device) for _ in range(2))
            stop = execution.flag
            assert stop is not None
            execution.launch(
                kernels.find_near_parts,
                num_items,
                inputs=[pairs, trees, given, reach, stop.array],
                outputs=[near],
                grain=256,
                parts_per_thread=8,
                is_long=lambda: num_items > _LONG,
            )
            found = int(near.count.numpy()[0, 0])
            if found <= room:
                return [x.numpy()[:found].copy() for x in (near.window, near.a, near.b)], room
            room = found + found // 8

    def _arrays(self, device: Any) -> tuple[Any, Any, list[tuple[int, int]]]:
        """Pairs of bodies and trees on a device, and the pairs of links among the former."""
        if str(device) not in self._on_device:
            from ccd_warp.kernels.search import near_parts as kernels

            moves = self.mesh.rigid[self.pairs[:, 1]]
            rows = np.where(moves, np.cumsum(moves) - 1, -1)
            pairs: wp.array = wp.array(np.column_stack([self.pairs, rows]), dtype=wp.vec3i, device=device)
            trees = kernels.PartTrees()
            for name, values in self.tree._asdict().items():
                dtype = wp.int32 if values.dtype == np.int32 else wp.float64 if values.ndim == 1 else wp.vec3d
                setattr(trees, name, wp.array(values, dtype=dtype, device=device))
            link = np.where(self.mesh.rigid, self.link_of, -1)
            trees.link = wp.array(link, dtype=wp.int32, device=device)
            self._on_device[str(device)] = pairs, trees
        moving = self.pairs[self.mesh.rigid[self.pairs[:, 1]]]
        return *self._on_device[str(device)], list(map(tuple, self.link_of[moving].tolist()))


def _pairs(mesh: CollisionMesh) -> NDArray[np.intp]:
    """Pairs of bodies with vertices that may collide, of which the first is a link; some links stand where they are."""
    filled = np.zeros(mesh.num_bodies, dtype=bool)
    filled[mesh.vertex_body] = True
    may = np.triu(np.ones((mesh.num_bodies, mesh.num_bodies), dtype=bool), 1)
    if mesh.body_pairs is not None:
        may &= mesh.body_pairs
    may &= filled & filled[:, None] & ~(mesh.static & mesh.static[:, None])
    pairs = np.argwhere(may)
    swapped = ~mesh.rigid[pairs[:, 0]]
    pairs[swapped] = pairs[swapped][:, ::-1]
    return pairs


def _halved(mesh: CollisionMesh, vertices: NDArray[np.float64]) -> tuple[Any, Any, Any, Any]:
    """Primitives in the order of parts, this order, where each part begins, and the number of parts of each body."""
    lone, points = mesh.edges[mesh.codimensional_edges], mesh.codimensional_points
    corners = np.concatenate([mesh.faces, lone[:, [0, 1, 1]], np.repeat(points[:, None], 3, axis=1)]).astype(np.int32)
    body = mesh.vertex_body[corners[:, 0]]
    middle = vertices[corners].mean(axis=1)
    parts: list[NDArray[np.intp]] = []
    counts = np.zeros(mesh.num_bodies, dtype=np.intp)
    for each in np.unique(body).tolist():
        own = [np.flatnonzero(body == each)]
        while max(map(len, own)) > PART:
            own = [half for rows in own for half in _halves(rows, middle)]
        parts += own
        counts[each] = len(own)
    begins = np.cumsum([0, *map(len, parts)]).astype(np.intp)
    order = np.concatenate([*parts, np.zeros(0, np.intp)])
    return corners[order], order, begins, counts


def _halves(rows: NDArray[np.intp], middle: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Both halves of primitives along the axis on which they extend most."""
    places = middle[rows]
    half = len(rows) // 2
    sides = np.argpartition(places[:, int(np.ptp(places, axis=0).argmax())], half)
    return [rows[sides[:half]], rows[sides[half:]]]


def _tree(
    mesh: CollisionMesh,
    vertices: NDArray[np.float64],
    primitives: NDArray[np.int32],
    begins: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> PartTree:
    """The trees of all bodies, level by level; of a node without primitives the sphere means nothing."""
    sizes = np.maximum(2 * counts - 1, 0)
    first, first_part = np.cumsum(sizes) - sizes, np.append(0, np.cumsum(counts))
    num_nodes = int(sizes.sum())
    found = [np.zeros((num_nodes, *shape)) for shape in ((3,), (), (), (3, 3), (3,), ())]
    size = 1
    while size <= counts.max(initial=0):
        bodies = np.flatnonzero(counts >= size)  # those with so many nodes on a level
        number = np.tile(np.arange(size), len(bodies))
        body = np.repeat(bodies, size)
        step = counts[body] // size
        from_part = first_part[body] + number * step
        rows = _nodes(mesh, vertices, primitives, begins[from_part], begins[from_part + step])
        for values, own in zip(found, rows, strict=True):
            values[first[body] + size - 1 + number] = own
        size *= 2
    return PartTree(first.astype(np.int32), counts.astype(np.int32), first_part.astype(np.int32), *found)


def _nodes(
    mesh: CollisionMesh,
    vertices: NDArray[np.float64],
    primitives: NDArray[np.int32],
    begin: NDArray[np.intp],
    end: NDArray[np.intp],
) -> tuple[NDArray[np.float64], ...]:
    """Centre, arm, radius, axes, half and thickness of nodes that have the primitives of these rows, at least one.

    The sides of a box are along the axes of the frame, or along the principal axes of the corners, whichever box has
    the smaller surface.
    """
    counts = 3 * (end - begin)
    corners = primitives[ranges(begin, end - begin)].ravel()
    places, starts = vertices[corners], np.cumsum(counts) - counts
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
    thickness = np.zeros(len(begin)) if mesh.radius is None else np.maximum.reduceat(mesh.radius[corners], starts)
    return *best[:-1], thickness
