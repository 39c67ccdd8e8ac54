"""How near each vertex is to anything at the start of a step: a step at one time, with holds in place of times."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.hold_distance import corners_by_kind
from ccd_warp._engine.proximities import reach_of
from ccd_warp._engine.proximity_step import StepAtOneTime
from ccd_warp._engine.scene import norm_of
from ccd_warp._results import Contacts, Counts
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels.norm import is_ball


class HoldStep(StepAtOneTime):
    """The hold of each vertex."""

    goal = "holds"

    def find_holds(self, distance: float) -> NDArray[np.float64]:
        """For each vertex how near it is to anything within a distance, and inf beyond, shape [V]."""
        from ccd_warp.kernels import start_holds as kernels  # few programs need it

        plan = self.search(distance)
        minima = self.workspace.contacts.minima
        with self.timed("pairs"):
            self.execution.launch(kernels.reset_holds, self.mesh.num_vertices, inputs=[], outputs=[minima])
            plan.set_reach(reach_of(self.topology.radius, distance, self.workspace.flag.array))
            batches = plan.batches(self.capacity(plan.key_bytes))
        for batch in self.timed_batches(batches):
            with self.timed("distances"):
                self.survivors.update(batch.found)
                plan.lower_holds()
        with self.timed("gather"):
            holds: wp.array = minima.vertex.view(wp.float64)
            result = holds.numpy().copy()
        self.finish(plan)
        return result

    def worlds_near(self, contacts: Contacts, distance: float) -> NDArray[np.bool_]:
        """Whether one of these contacts of a world starts within a distance, and radii, shape [W]."""
        from ccd_warp.kernels import start_holds as kernels

        topology, device = self.topology, self.topology.device
        self.counts = Counts()  # nothing is searched
        near: wp.array = wp.zeros(self.mesh.num_worlds, dtype=wp.int32, device=device)
        if len(contacts):
            values = {"kind": wp.int32, "primitives": wp.vec2i}
            listed: list[wp.array] = [
                wp.array(getattr(contacts, name), dtype=dtype, device=device) for name, dtype in values.items()
            ]
            count: wp.array = wp.array([len(contacts)], dtype=wp.int32, device=device)
            x: wp.array = wp.array(self.positions[0], dtype=wp.vec3d, device=device)
            reach = reach_of(topology.radius, distance, self.workspace.flag.array)
            self.execution = Execution(device, self.options.threads, self.workspace.flag)
            self.execution.launch(
                kernels.make_holds(is_ball(norm_of(self.mesh, self.options))).note_near_contacts,
                len(contacts),
                inputs=[count, *listed, *corners_by_kind(topology), x, reach, self.workspace.contacts.minima],
                outputs=[near],
            )
        return near.numpy() != 0
