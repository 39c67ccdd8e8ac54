"""How near vertices are to anything at the start of a step, and in which worlds it matters."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time.proximity_step import StepAtOneTime
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._engine.mesh.start_distances import corners_by_kind
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._engine.motion import Slice
from ccd_warp._engine.stages import Stages
from ccd_warp._results.results import Contacts
from ccd_warp._runtime.launch import Recording
from ccd_warp._runtime.written import Written
from ccd_warp.kernels.narrow_phase.sinks import START_DISTANCE
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.template import specialised

# What the kernel reads of a contact, and for how many there is a place at least.
_COLUMNS = {"kind": wp.int32, "primitives": wp.vec2i, "parameters": wp.vec2d}
_FEW = 64


class StartDistanceStep(StepAtOneTime):
    """The start distance of each vertex."""

    goal = "start distances"
    sink = int(START_DISTANCE)

    def __init__(self, workspace: Workspace, positions: Positions, *arguments: Any) -> None:
        """Begin at the first of these positions; the others are those at the end of the step."""
        super().__init__(workspace, positions, *arguments)
        self._end = positions[1]

    def norm(self) -> Norm:
        """The norm of separations."""
        return norm_of(self.mesh, self.options)

    def start_distances(self, distance: float) -> NDArray[np.float64]:
        """For each vertex how near it is to anything within a distance, inf beyond, as share and length, [V, 2]."""
        batches = self.search(distance)
        return self.least_of_vertices(batches, self.workspace.start_distances.array).reshape(-1, 2)

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels know how near is near, what pairs keep, and where start distances go."""
        found = self.workspace.start_distances
        found.write(np.float64(np.inf))
        bits = self.workspace.packed_once("start distances", lambda: found.array.view(wp.int64))
        self.plan.bind(reach=self._reach(self.separation), start_distances=bits)

    def _reach(self, distance: float) -> Any:
        """How near is near, and what pairs keep besides their radii."""
        return self.reach(distance, self.options.separation(length_scale_of(self.mesh, self.options)))

    def worlds_near(self, contacts: Contacts, distance: float) -> NDArray[np.bool_]:
        """Whether one of these contacts of a world starts within a distance, and radii, or passes by, shape [W]."""
        plan, worlds = self.plan_of_step(), self.workspace.kept(_NearWorlds, lambda: _NearWorlds(self.topology))
        plan.set_positions((self.positions[0], self._end))
        plan.bind(reach=self._reach(distance))
        plan.play(*worlds.section(contacts, self.norm()))
        plan.release_positions()
        return worlds.near.array.numpy() != 0


class _NearWorlds:
    """Contacts in arrays that stay, and in which worlds one of them is near.

    Attributes:
        near: 1 for each such world, int32, shape [W].
    """

    def __init__(self, topology: Topology) -> None:
        self._topology, self._arrays = topology, dict[int, dict[str, Written]]()
        self._count, self.near = (Written(self._zeros(n, wp.int32)) for n in (1, topology.mesh.num_worlds))

    def _zeros(self, count: int, dtype: Any) -> wp.array:
        return wp.zeros(count, dtype=dtype, device=self._topology.device)

    def section(self, contacts: Contacts, norm: Norm) -> tuple[str, Callable[[Stages, Recording], None]]:
        """The section for these contacts, one for each power of two that holds them, and what records it."""
        capacity = max(_FEW, 1 << (len(contacts) - 1).bit_length())
        if capacity not in self._arrays:
            self._arrays[capacity] = {name: Written(self._zeros(capacity, of)) for name, of in _COLUMNS.items()}
        arrays = self._arrays[capacity]
        for name, array in arrays.items() if len(contacts) else ():
            array.write_first(getattr(contacts, name))
        self._count.write(np.int32(len(contacts)))
        self.near.write(np.int32(0))

        def record(stages: Stages, recording: Recording) -> None:
            kernel = specialised("at_one_time.near_contacts", norm=norm.shape).note_near_contacts
            listed = [self._count.array, *(array.array for array in arrays.values())]
            of_step = [stages.step.vertices_t0, stages.step.vertices_t1, stages.reach, stages.step.minima]
            recording.launch(kernel, capacity, [*listed, *corners_by_kind(self._topology), *of_step], [self.near.array])

        return f"{capacity} near contacts", record
