"""Which parts of bodies may touch in slices of a motion, by spheres and boxes, before a vertex is placed.

A part has a sphere and a box in the frame of its body, which go with it (`trees`). Two parts cannot touch in a
slice if in the middle of it they are farther apart than their points can come nearer in half of it (`bounds`).
Trees of the parts of two bodies are tested from the top (`kernels.rigid.part_overlap`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.parts.bounds import SweptBounds
from ccd_warp._rigid.parts.trees import PartTrees, distinct, ranges
from ccd_warp._rigid.rotations import EPS, rotated
from ccd_warp._runtime.launch import Execution
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.mesh import CollisionMesh

# Tests of pairs of bodies in a launch, bodies in slices, and the capacity for pairs of parts at first.
_MOST_ITEMS, _MOST_POSES, _CAPACITY = 1 << 22, 1 << 17, 1 << 16
_LONG = 1 << 14  # items from which an interrupt would have to wait
_MANY = 1 << 12  # pairs of bodies from which boxes say first which meet at all
_ERROR = 1024.0 * EPS  # of these boxes, relative to their coordinates


def spans(count: NDArray[np.intp], t_max: float) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """So many slices of [0, t_max] for each world: the world, the begin and the end of each slice."""
    world = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(world)) - np.repeat(np.cumsum(count) - count, count)
    begin, end = (t_max * (number + k) / count[world] for k in (0, 1))
    return world, begin, np.where(number + 1 == count[world], t_max, end)


class BodyParts:
    """The parts of the bodies of a mesh of one world, and which of them may touch.

    Attributes:
        mesh: The mesh.
        body: The body of each part, shape [P].
        begins: The first primitive of each part, shape [P + 1], in the order of the parts.
        row_of: The row of a motion that a rigid body is, shape [B].
        pairs: Pairs of bodies that may collide, of which one moves, shape [m, 2]; the first is rigid.
    """

    def __init__(self, mesh: CollisionMesh, vertices: NDArray[np.float64]) -> None:
        """Divide the bodies of a mesh whose vertices, of rigid ones in their own frames, are at these places."""
        self.mesh = mesh
        with np.errstate(all="ignore"):  # what is no number, or too large for its square, is near
            trees = self._trees = PartTrees(mesh, vertices)
        counts = trees.num_parts[trees.of_body]
        self._first_part = np.append(0, np.cumsum(counts))
        self.body = np.repeat(np.arange(mesh.num_bodies), counts)
        number = np.arange(len(self.body)) - self._first_part[self.body]
        of_tree = trees.first_part[trees.of_body[self.body]] + number
        self.begins = np.append(0, np.cumsum(np.diff(trees.begins)[of_tree]))
        self._first_row = self.begins[self._first_part]  # of each body
        self.row_of = np.cumsum(mesh.rigid) - 1
        pairs = _pairs(mesh)
        self.pairs = pairs[(counts[pairs] > 0).all(axis=1)]
        self._on_device: dict[str, Any] = {}

    def primitives(self, row: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Some primitives in the order of the parts.

        Returns:
            Their vertices, one of fewer than three repeated, shape [n, 3]; their kinds, 0 of a face, 1 of a
            codimensional edge, 2 of a codimensional point; the number of each among those of its kind.
        """
        body = np.searchsorted(self._first_row, row, side="right") - 1
        return self._trees.primitives(body, row - self._first_row[body])

    def num_bodies(self, group: NDArray[np.intp], part: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Of how many bodies the parts of each of so many groups are."""
        keys = distinct(group * self.mesh.num_bodies + self.body[part])
        return np.bincount(keys // self.mesh.num_bodies, minlength=count)

    def overlapping(
        self,
        motion: RigidMotion,
        world: NDArray[np.intp],
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        reach: float,
        execution: Execution,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
        """Pairs of parts that may come within a distance in slices of the step.

        Args:
            motion: The motion, whose rows are the rigid bodies.
            world: World of each slice, shape [n].
            begin: Its begin.
            end: Its end.
            reach: The distance, Euclidean, besides the radii of the vertices.
            execution: Where to test.

        Returns:
            The slice and both parts of each pair, in no order.

        Guarantee: two primitives of different parts of bodies that may collide, which come within the distance at some
        time of a slice, on trajectories within the excess of those of the motion in the mathematics of real numbers,
        are in such a pair; and a primitive that comes so near to a half-space is in a pair of its part with itself.
        That holds for slices whose ends are off by a few units in the last place of 1.
        """
        near_pairs: list[tuple[Any, ...]] = [(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.int32))]
        if len(self.pairs):
            slices_at_once = max(1, min(_MOST_ITEMS // len(self.pairs), _MOST_POSES // motion.num_bodies))
            capacity = _CAPACITY
            for first in range(0, len(world), slices_at_once):
                some = slice(first, first + slices_at_once)
                swept = SweptBounds.of(motion._of_worlds(world[some]), begin[some], end[some])
                near, capacity = self._near(swept, reach, execution, capacity)
                near_pairs.append((near[0] + first, *near[1:]))
        if len(self.mesh.planes):
            rigid = np.flatnonzero(self.mesh.rigid)
            slices_at_once = max(1, _MOST_POSES // motion.num_bodies)
            for first in range(0, len(world), slices_at_once):
                some = slice(first, first + slices_at_once)
                swept = SweptBounds.of(motion._of_worlds(world[some]), begin[some], end[some])
                row, part = self._near_planes(swept, rigid, reach)
                near_pairs.append((first + row, *2 * [part.astype(np.int32)]))
        of_slice, a, b = (np.concatenate(x) for x in zip(*near_pairs, strict=True))
        return of_slice, a, b

    def _near_planes(
        self, swept: SweptBounds, rigid: NDArray[np.intp], reach: float
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Slices, and parts of rigid bodies that may meet a half-space in them: bodies first, then their parts."""
        trees = self._trees
        root = np.where(trees.num_parts > 0, trees.first_node, 0)[trees.of_body]
        row, number = (x.ravel() for x in np.indices(swept.position.shape[:2]))
        near = self._meets_plane(swept, row, number, root[rigid[number]], reach)
        row, number = row[near], number[near]
        body = rigid[number]
        counts = trees.num_parts[trees.of_body[body]]
        part = ranges(self._first_part[body], counts)
        row, number = np.repeat(row, counts), np.repeat(number, counts)
        leaf = part - np.repeat(self._first_part[body], counts) + np.repeat(root[body] + counts - 1, counts)
        near = self._meets_plane(swept, row, number, leaf, reach)
        return row[near], part[near]

    def _meets_plane(
        self, swept: SweptBounds, row: NDArray[np.intp], number: NDArray[np.intp], node: NDArray[np.intp], reach: float
    ) -> NDArray[np.bool_]:
        """Whether nodes of rigid bodies may come within a distance of the solid of a half-space in slices."""
        nodes, is_near = self._trees.nodes, np.zeros(len(row), dtype=bool)
        with np.errstate(all="ignore"):
            rotation, origin = swept.rotation[row, number], swept.position[row, number]
            centre = origin + rotated(rotation, nodes.centre[node])
            goes, arm, radius = swept.reach[row, number], nodes.arm[node], nodes.radius[node]
            moved = goes[:, 0] + goes[:, 1] + (goes[:, 2] + goes[:, 3]) * arm
            turned = (goes[:, 2] + goes[:, 3]) * radius
            back = rotation * [-1.0, -1.0, -1.0, 1.0]
            for point, normal in zip(self.mesh.planes.points, unit_normals(self.mesh.planes.normals), strict=True):
                height = ((centre - point) * normal).sum(axis=1)
                sides = rotated(back, np.broadcast_to(normal, centre.shape))
                box = (np.abs(np.einsum("nij,nj->ni", nodes.axes[node], sides)) * nodes.half[node]).sum(axis=1)
                least = height - moved - np.minimum(radius, box + turned) - nodes.thickness[node] - reach
                size = np.abs(centre).max(axis=1) + np.abs(point).max() + np.abs(height) + moved + radius
                is_near |= ~(least > _ERROR * size)  # also where a number is none
        return is_near

    def _near(
        self, swept: SweptBounds, reach: float, execution: Execution, capacity: int
    ) -> tuple[list[NDArray[Any]], int]:
        """The pairs in some slices, and the capacity for them from now on."""
        from ccd_warp.kernels.rigid import part_overlap as kernels  # few programs need it

        def on_device(values: NDArray[np.float64], dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=execution.device, copy=execution.is_cuda)

        num_slices = len(swept.position)
        motion = kernels.PartMotion()
        motion.position, motion.velocity, motion.omega = (
            on_device(values, wp.vec3d) for values in (swept.position, swept.velocity, swept.omega)
        )
        motion.rotation = on_device(swept.rotation, wp.vec4d)
        motion.reach = on_device(swept.reach, kernels.vec6d)
        of_bodies = self.pairs
        if len(of_bodies) > _MANY:
            of_bodies = of_bodies[self._meet(swept, reach)]
        body_pairs: wp.array = wp.array(of_bodies, dtype=wp.vec2i, device=execution.device)
        num_items, trees, stop = num_slices * len(of_bodies), self._trees_on(execution.device), execution.flag
        assert stop is not None
        while True:
            pairs = kernels.PartPairs()
            pairs.count = wp.zeros((1, 1), dtype=wp.int64, device=execution.device)
            pairs.row, pairs.a, pairs.b = (
                wp.empty(capacity, dtype=wp.int32, device=execution.device) for _ in range(3)
            )
            execution.launch(
                kernels.find_overlapping_parts,
                num_items,
                inputs=[body_pairs, trees, motion, reach, stop.array],
                outputs=[pairs],
                grain=256,
                parts_per_thread=8,
                is_long=lambda: num_items > _LONG,
            )
            count = int(pairs.count.numpy()[0, 0])
            if count <= capacity:
                return [x.numpy()[:count].copy() for x in (pairs.row, pairs.a, pairs.b)], capacity
            capacity = count + count // 8

    def _meet(self, swept: SweptBounds, reach: float) -> NDArray[np.bool_]:
        """Which pairs of bodies meet by the boxes around them in all slices."""
        trees, count = self._trees, self.mesh.num_bodies
        root = np.where(trees.num_parts > 0, trees.first_node, 0)[trees.of_body]
        centre, arm, size = trees.nodes.centre[root], trees.nodes.arm[root], trees.nodes.radius[root]
        size = size + trees.nodes.thickness[root] + 0.5 * reach
        lower, upper = np.empty((count, 3)), np.empty((count, 3))
        rigid = np.flatnonzero(self.mesh.rigid)
        with np.errstate(all="ignore"):
            lower[:], upper[:] = centre - size[:, None], centre + size[:, None]
            rotation, position, goes = swept.rotation, swept.position, swept.reach
            num_slices = len(position)
            places = rotated(rotation.reshape(-1, 4), np.tile(centre[rigid], (num_slices, 1))).reshape(position.shape)
            places = places + position
            moved = goes[..., 0] + goes[..., 1] + (goes[..., 2] + goes[..., 3]) * arm[rigid] + size[rigid]
            lower[rigid] = (places - moved[..., None]).min(axis=0)
            upper[rigid] = (places + moved[..., None]).max(axis=0)
            wide = _ERROR * (np.abs(lower) + np.abs(upper) + arm[:, None] + size[:, None])
            lower, upper = lower - wide, upper + wide
            a, b = self.pairs.T
            meets = np.ones(len(a), dtype=bool)
            for k in range(3):  # what is no number meets all
                meets &= ~((lower[a, k] > upper[b, k]) | (lower[b, k] > upper[a, k]))
        return meets

    def _trees_on(self, device: Any) -> Any:
        """The trees on a device."""
        if str(device) not in self._on_device:
            from ccd_warp.kernels.rigid import part_overlap as kernels

            trees = self._trees
            arrays = {
                "first": trees.first_node[trees.of_body],
                "num_parts": trees.num_parts[trees.of_body],
                "first_part": self._first_part,
                "link": np.where(self.mesh.rigid, self.row_of, -1),
                **trees.nodes._asdict(),
            }
            part_trees = kernels.PartTrees()
            for name, values in arrays.items():
                dtype = wp.int32 if values.dtype == np.intp else wp.float64 if values.ndim == 1 else wp.vec3d
                setattr(part_trees, name, wp.array(values, dtype=dtype, device=device))
            self._on_device[str(device)] = part_trees
        return self._on_device[str(device)]


def _pairs(mesh: CollisionMesh) -> NDArray[np.intp]:
    """Pairs of bodies that may collide, of which the first is rigid; some rigid bodies stand where they are."""
    may = np.triu(np.ones((mesh.num_bodies, mesh.num_bodies), dtype=bool), 1)
    if mesh.body_pairs is not None:
        may &= mesh.body_pairs
    may &= ~(mesh.static & mesh.static[:, None])
    pairs = np.argwhere(may)
    swapped = ~mesh.rigid[pairs[:, 0]]
    pairs[swapped] = pairs[swapped][:, ::-1]
    return pairs
