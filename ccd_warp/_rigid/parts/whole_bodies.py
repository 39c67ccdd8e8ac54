"""Which whole bodies may touch in slices of a step whose rows are not known beforehand: on the device, or others."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._engine.motion import Slice, Slices
from ccd_warp._rigid.parts.overlap import pairs_of, partners_of
from ccd_warp._rigid.parts.walk import record_walk
from ccd_warp._rigid.rotations import in_space
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.rigid import part_overlap as kernels

_RUN = 256  # vertices that one item bounds
_MOST_PAIRS = 1 << 21  # of bodies, which are listed
_MOST_RECORDINGS = 4  # by their numbers of slices


class WholeBodies:
    """The bodies of a mesh, each in one box, and the slices in which they may touch.

    Bodies that neither stand nor are on a path are searched in every slice.
    """

    def __init__(self, topology: Topology, radius: wp.array) -> None:
        """Allocate the arrays of the bodies; ``radius`` is that of their vertices, empty where there is none."""
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
        self._links = self._int32(np.where(mesh.rigid, np.arange(mesh.num_bodies), -1))
        self._bounds: list[wp.array] = [
            wp.empty(len(body), dtype=dtype, device=self._device) for dtype in (wp.vec3d, wp.vec3d, wp.float64)
        ]
        self._trees = self._new_trees(mesh, counts > 0)
        pairs = np.array(pairs_of(mesh, counts > 0), dtype=np.int32)
        self._pairs: wp.array = wp.array(pairs, dtype=wp.vec2i, device=self._device)
        always = ~(mesh.rigid | mesh.static)
        self._always, self._is_any_always = self._int32(always), int(always.any())

    @staticmethod
    def are_few(mesh: CollisionMesh) -> bool:
        """Whether they are looked for: of few bodies in a world, and with no half-space that moves."""
        kept = MeshCache.of(mesh).parts
        if "are few" not in kept:
            kept["are few"] = not (mesh.planes.vertices >= 0).any() and partners_of(mesh)[1].sum() <= _MOST_PAIRS
        return bool(kept["are few"])

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

    def new_marks(self, num_slices: int) -> Any:
        """The bodies that may touch in each slice, as the struct of the kernels."""
        marks, count = kernels.PartPairs(), len(self._always)
        marks.marks = wp.zeros((num_slices, count), dtype=wp.int32, device=self._device)
        marks.is_any = wp.zeros(num_slices, dtype=wp.int32, device=self._device)
        return marks

    def record_bounds(self, recording: Recording, start: Any, end: Any) -> None:
        """Record the launches that bound the bodies, given the rows of both ends."""
        inputs = [*self._runs, self._links, start, end, self._radius]
        count = len(self._runs[2])
        recording.launch(kernels.bound_rows, count, inputs=inputs, outputs=self._bounds, grain=16)
        inputs = [self._first_run, *self._bounds]
        recording.launch(kernels.bound_bodies, len(self._links), inputs=inputs, outputs=[self._trees])

    def record_near(
        self, recording: Recording, paths: Any, t_max: Any, reach: Any, active: wp.array, stop: wp.array, marks: Any
    ) -> None:
        """Record the launches that mark what comes within a distance of another body of which one is active.

        Args:
            recording: Where to.
            paths: The paths of all bodies, as the struct of the kernels.
            t_max: The end of the last slice.
            reach: The distance, Euclidean, besides the radii of the vertices.
            active: Bodies of which one of each pair is, int32, shape [B].
            stop: What ends the search.
            marks: Those of :meth:`new_marks`, which are written.
        """
        num_slices = len(marks.is_any)
        inputs = [self._always, self._is_any_always, active]
        recording.launch(kernels.clear_marks, num_slices * len(self._always), inputs=inputs, outputs=[marks])
        of_slices = num_slices, t_max, reach, True
        record_walk(recording, self._trees, self._pairs, paths, 0, 1, marks, active, stop, *of_slices)


class NearBodies:
    """The search for whole bodies that are near in steps on the host, of which all others than rigid ones stand.

    It goes with its workspace, which no step uses again after an error or an interrupt: its stop flag is never cleared.
    """

    @staticmethod
    def are_found(mesh: CollisionMesh) -> bool:
        """Whether they are looked for: others than rigid bodies and those that stand move in every slice."""
        return WholeBodies.are_few(mesh) and not (~mesh.rigid & ~mesh.static).any()

    def __init__(self, topology: Topology) -> None:
        """Allocate the arrays of a mesh."""
        self._topology, self._bodies = topology, WholeBodies(topology, topology.radius)
        self._flag = StopFlag(topology.device)
        self._every = wp.full(topology.mesh.num_bodies, value=1, dtype=wp.int32, device=topology.device)
        self._no_rows: wp.array = wp.empty(0, dtype=wp.vec3d, device=topology.device)
        self._recordings: dict[tuple[int, int], tuple[Recording, Any]] = {}

    def slices(
        self, paths: Any, positions: Positions, slices: Slices, reach: float, execution: Execution
    ) -> list[Slice]:
        """The slices in which anything is near, with the bodies that are; at least one.

        Args:
            paths: The table of the paths, on the device.
            positions: Positions at both ends, of rigid bodies in their own frames.
            slices: The slices of the step.
            reach: A Euclidean distance, besides the radii of the vertices.
            execution: Where to search.
        """
        ends: list[wp.array] = [
            wp.array(x, dtype=wp.vec3d, device=self._topology.device, copy=False) for x in positions
        ]
        values = {"start": ends[0], "end": ends[1], "t_max": slices.t_max, "reach": reach}
        key = slices.num_slices, execution.num_threads
        while len(self._recordings) >= _MOST_RECORDINGS and key not in self._recordings:
            self._recordings.pop(next(iter(self._recordings)))
        if key not in self._recordings:
            of_slices = Recording(Execution(self._topology.device, execution.num_threads, self._flag), values)
            found = self._bodies.new_marks(slices.num_slices)
            with of_slices.section("near"):
                self._bodies.record_bounds(of_slices, Slot("start"), Slot("end"))
                asked = Slot("t_max"), Slot("reach"), self._every, self._flag.array
                self._bodies.record_near(of_slices, paths, *asked, found)
            self._recordings[key] = of_slices, found
        recording, found = self._recordings[key]
        for name, value in values.items():
            recording.bind(name, value)
        recording.play("near")
        for name in ("start", "end"):  # the caller's arrays
            recording.bind(name, self._no_rows)
        marks: NDArray[np.bool_] = found.marks.numpy() != 0
        near = np.flatnonzero(found.is_any.numpy())
        return [slices.slice(k)._replace(active=marks[k]) for k in (near.tolist() or [0])]
