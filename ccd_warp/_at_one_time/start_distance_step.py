"""How near vertices are to anything at the start of a step, and in which worlds it matters."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time.proximity_step import StepAtOneTime
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._engine.mesh.start_distances import corners_by_kind
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.motion import Slice
from ccd_warp._results.results import Contacts
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels.narrow_phase.sinks import START_DISTANCE
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.template import specialised


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
        return self.least_of_vertices(batches, self.workspace.start_distances).reshape(-1, 2)

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels know how near is near, what pairs keep, and where start distances go."""
        found = self.workspace.start_distances
        found.fill_(np.inf)
        self.plan.bind(reach=self._reach(self.separation), start_distances=found.view(wp.int64))

    def _reach(self, distance: float) -> Any:
        """How near is near, and what pairs keep besides their radii."""
        return self.reach(distance, self.options.separation(length_scale_of(self.mesh, self.options)))

    def worlds_near(self, contacts: Contacts, distance: float) -> NDArray[np.bool_]:
        """Whether one of these contacts of a world starts within a distance, and radii, or passes by, shape [W]."""
        topology, device = self.topology, self.topology.device
        near: wp.array = wp.zeros(self.mesh.num_worlds, dtype=wp.int32, device=device)
        if len(contacts):
            values = {"kind": wp.int32, "primitives": wp.vec2i, "parameters": wp.vec2d}
            listed: list[wp.array] = [
                wp.array(getattr(contacts, name), dtype=dtype, device=device) for name, dtype in values.items()
            ]
            count: wp.array = wp.array([len(contacts)], dtype=wp.int32, device=device)
            ends: list[wp.array] = [wp.array(x, dtype=wp.vec3d, device=device) for x in (self.positions[0], self._end)]
            self.execution = Execution(device, self.options.threads, self.workspace.flag)
            kernels = specialised("at_one_time.near_contacts", norm=self.norm().shape)
            self.execution.launch(
                kernels.note_near_contacts,
                len(contacts),
                inputs=[
                    *(count, *listed, *corners_by_kind(topology), *ends),
                    *(self._reach(distance), self.workspace.contacts.minima),
                ],
                outputs=[near],
            )
        return near.numpy() != 0
