"""Whole bodies, each in one box, and the launches that find which of them, or of parts, may touch in slices."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._rigid.parts.trees import ranges
from ccd_warp._rigid.rotations import in_space
from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.input.worlds import worlds_of_bodies
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.rigid import part_overlap as kernels

_RUN = 256  # vertices that one item bounds
_MOST_PAIRS = 1 << 21  # of bodies, which are listed
_MOST_BODIES_OF_WORLDS = 64  # of one of many worlds, of which each has as many tests
_LONG = 1 << 12  # items, or slices, from which an interrupt would have to wait
# Items on the CPU, and on CUDA, below which the slices of a pair of bodies are divided among several.
_FEW, _FEW_ON_CUDA = 64, 1 << 14


class WholeBodies:
    """The bodies of a mesh, each in one box, and the slices in which they may touch.

    Bodies that neither stand nor are on a path are searched in every slice.

    Attributes:
        trees: Of one node each, as the struct of the kernels.
        pairs: Pairs of bodies that may collide, as `pairs_of` has them.
    """

    def __init__(self, topology: Topology, radius: wp.array, row_of: NDArray[np.integer] | None = None) -> None:
        """Allocate the arrays of the bodies.

        Args:
            topology: Of their mesh.
            radius: That of their vertices, empty where there is none.
            row_of: The row of a table of paths that each rigid body is; by default its number.
        """
        mesh, self._device, self._radius = topology.mesh, topology.device, radius
        takes_part = np.ones(mesh.num_vertices, dtype=bool)
        takes_part[mesh.unused_vertices] = False
        vertices = np.flatnonzero(takes_part)
        counts = np.bincount(mesh.vertex_body[vertices], minlength=mesh.num_bodies)
        num_runs = -(-counts // _RUN)
        body = np.repeat(np.arange(mesh.num_bodies), num_runs)
        number = np.arange(len(body)) - (np.cumsum(num_runs) - num_runs)[body]
        first = (np.cumsum(counts) - counts)[body] + _RUN * number
        self._runs = [self._int32(x) for x in (vertices, np.append(first, len(vertices)), body)]
        self._first_run = self._int32(np.append(0, np.cumsum(num_runs)))
        row_of = np.arange(mesh.num_bodies) if row_of is None else row_of
        self._links = self._int32(np.where(mesh.rigid, row_of, -1))
        self._bounds: list[wp.array] = [
            wp.empty(len(body), dtype=dtype, device=self._device) for dtype in (wp.vec3d, wp.vec3d, wp.float64)
        ]
        self.trees = self._new_trees(mesh, counts > 0)
        pairs = np.array(pairs_of(mesh, counts > 0), dtype=np.int32)
        self.pairs: wp.array = wp.array(pairs, dtype=wp.vec2i, device=self._device)
        always = ~(mesh.rigid | mesh.static)
        self._always, self._is_any_always = self._int32(always), int(always.any())

    @classmethod
    def are_found(cls, mesh: CollisionMesh, num_worlds: int = 1) -> bool:
        """Whether they are looked for on the host: where all others than rigid ones stand, and are not always near."""
        are_few = num_worlds == 1 or mesh.num_bodies <= _MOST_BODIES_OF_WORLDS
        return are_few and cls.are_few(mesh) and not (~mesh.rigid & ~mesh.static).any()

    @classmethod
    def are_few(cls, mesh: CollisionMesh) -> bool:
        """Whether they are few in a world, and no half-space moves."""
        return not (mesh.planes.vertices >= 0).any() and cls.num_pairs(mesh) <= _MOST_PAIRS

    @staticmethod
    def num_pairs(mesh: CollisionMesh) -> int:
        """A bound on the number of pairs of them in a world."""
        kept = MeshCache.of(mesh).parts
        if "pairs" not in kept:
            kept["pairs"] = int(partners_of(mesh)[1].sum()) + mesh.num_bodies * len(mesh.planes)
        return int(kept["pairs"])

    def _int32(self, values: Any) -> wp.array:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=self._device)

    def _new_trees(self, mesh: CollisionMesh, is_filled: Any) -> Any:
        """Trees of one node each, whose boxes are made in each step."""
        count, device = mesh.num_bodies, self._device
        trees = kernels.PartTrees()
        trees.first = trees.first_part = self._int32(np.arange(count))
        trees.num_parts, trees.link = self._int32(is_filled), self._links
        axes = np.broadcast_to(np.eye(3), (count, 3, 3))
        trees.axes = wp.array(axes, dtype=wp.vec3d, device=device)
        trees.centre, trees.half = (wp.zeros(count, dtype=wp.vec3d, device=device) for _ in range(2))
        trees.radius, trees.thickness = (wp.zeros(count, dtype=wp.float64, device=device) for _ in range(2))
        trees.plane_point = wp.array(in_space(mesh.planes.points), dtype=wp.vec3d, device=device)
        trees.plane_normal = wp.array(in_space(unit_normals(mesh.planes.normals)), dtype=wp.vec3d, device=device)
        return trees

    @staticmethod
    def new_marks(num_bodies: int, num_slices: int, device: wp.Device) -> Any:
        """Marks of what may touch in each slice, as the struct of the kernels."""
        near = kernels.NearMarks()
        near.bodies = wp.zeros((num_slices, num_bodies), dtype=wp.int32, device=device)
        near.is_any = wp.zeros(num_slices, dtype=wp.int32, device=device)
        return near

    def record_bounds(self, recording: Recording, start: wp.array | Slot, end: wp.array | Slot) -> None:
        """Record the launches that bound the bodies, given the rows of both ends."""
        inputs = [*self._runs, self._links, start, end, self._radius]
        count = len(self._runs[2])
        recording.launch(kernels.bound_rows, count, inputs=inputs, outputs=self._bounds, grain=16)
        inputs = [self._first_run, *self._bounds]
        recording.launch(kernels.bound_bodies, len(self._links), inputs=inputs, outputs=[self.trees])

    def record_near(
        self, recording: Recording, paths: Any, t_max: float, reach: float, active: wp.array, stop: wp.array, near: Any
    ) -> None:
        """Record the launches that mark what comes within a distance of another body of which one is active.

        Args:
            recording: Where to.
            paths: The paths of all bodies, as the struct of the kernels.
            t_max: The end of the last slice.
            reach: The distance, Euclidean, besides the radii of the vertices.
            active: Bodies of which one of each pair is, int32, shape [B].
            stop: What ends the search.
            near: The marks.
        """
        num_slices = len(near.is_any)
        inputs = [self._always, self._is_any_always, active]
        recording.launch(kernels.clear_marks, num_slices * len(self._always), inputs=inputs, outputs=[near])
        record_walk(recording, self.trees, self.pairs, paths, 0, 1, near, active, stop, num_slices, t_max, reach)


def record_walk(
    recording: Recording,
    trees: Any,
    pairs: wp.array,
    paths: Any,
    num_links: int,
    num_worlds: int,
    near: Any,
    active: wp.array,
    stop: wp.array,
    num_slices: Any,
    t_max: Any,
    reach: Any,
) -> None:
    """Record the walk through the trees of these pairs of bodies in each world; the last arguments may be slots."""
    device, num_bodies = recording.device, len(trees.first)
    boxes = [wp.empty((num_worlds, num_bodies), dtype=wp.vec3d, device=device) for _ in range(2)]
    shared = [trees, paths, num_links]
    recording.launch(kernels.sweep_bodies, num_worlds * num_bodies, inputs=[*shared, t_max, reach], outputs=boxes)
    num_pairs = num_worlds * len(pairs)
    num_begins = max(1, (_FEW_ON_CUDA if recording.is_cuda else _FEW) // max(num_pairs, 1))
    num_items = num_pairs * num_begins
    of_slices = [num_slices, num_begins, t_max, reach]

    def is_long() -> bool:
        count = recording.values[num_slices.name] if isinstance(num_slices, Slot) else num_slices
        return bool(max(num_items, count) > _LONG)

    recording.launch(
        kernels.mark_near,
        num_items,
        inputs=[pairs, *shared, *boxes, *of_slices, active, stop],
        outputs=[near],
        grain=_FEW,
        parts_per_thread=8,
        is_long=is_long,
    )


def pairs_of(mesh: CollisionMesh, is_filled: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Pairs of bodies with primitives that may collide, the first rigid, the second -1 - k of half-space k.

    Some rigid bodies stand where they are.
    """
    order, counts = partners_of(mesh)
    first = np.repeat(np.arange(len(order)), counts)
    a, b = order[first], order[ranges(np.arange(1, len(order) + 1), counts)]
    may = is_filled[a] & is_filled[b] & (mesh.rigid[a] | mesh.rigid[b]) & ~(mesh.static[a] & mesh.static[b])
    if mesh.body_pairs is not None:
        may &= mesh.body_pairs[a, b]
    pairs = np.column_stack([a[may], b[may]])
    swapped = ~mesh.rigid[pairs[:, 0]]
    pairs[swapped] = pairs[swapped][:, ::-1]
    rigid = np.flatnonzero(mesh.rigid & is_filled)
    planes = np.stack(np.meshgrid(rigid, -1 - np.arange(len(mesh.planes)), indexing="ij"), axis=-1)
    return np.concatenate([pairs, planes.reshape(-1, 2)])


def partners_of(mesh: CollisionMesh) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bodies in an order, and how many of those that follow each may be in a world with it, shape [B] each."""
    world = np.zeros(mesh.num_bodies, dtype=np.intp)
    if mesh.num_worlds > 1:
        first, last = worlds_of_bodies(mesh.vertex_body, mesh.vertex_world, mesh.num_bodies)
        world = first if (first >= last).all() else world
    order = np.argsort(world, kind="stable")
    return order, np.searchsorted(world[order], world[order], side="right") - 1 - np.arange(len(order))
