"""Which bodies another comes near, found among the launches of a step: those that none comes near have no boxes."""

import numpy as np
import warp as wp

from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Recording
from ccd_warp.kernels.boxes import near_bodies as kernels

# From so many bodies on it pays; up to so many, of so many vertices, it costs little though all boxes are compared with
# all, and one thread makes the box of a body.
_FEWEST_BODIES, _MOST_BODIES, _MOST_VERTICES = 16, 1 << 12, 1 << 12


class NearBodies:
    """The boxes of bodies, and which of them meet others.

    Attributes:
        near: Which bodies are active and near others, or static, int32, shape [B].
        is_any: Whether any does that is not static, a flag on the device.
    """

    def __init__(self, topology: Topology) -> None:
        mesh, array = topology.mesh, topology.array
        self._count, self._filter = mesh.num_bodies, topology.collision_filter
        always = np.where(mesh.static, 2, mesh.kinematic | mesh.self_collision)
        self._begin, self._always = array(mesh.body_vertex_range, wp.int32), array(always, wp.int32)
        empty = [np.empty((mesh.num_bodies, 3)) for _ in range(2)]
        self._boxes = [array(values, wp.vec3d) for values in empty]
        self.near, self.is_any = (array(np.ones(count), wp.int32) for count in (mesh.num_bodies, 1))

    @staticmethod
    def of(topology: Topology, fewest: int | None = None) -> "NearBodies | None":
        """Those of a mesh; None where it does not pay to look which bodies are near, as for fewer than ``fewest``."""
        mesh = topology.mesh
        is_worth = (fewest or _FEWEST_BODIES) <= mesh.num_bodies <= _MOST_BODIES and topology.may_have_inactive_bodies
        largest = np.diff(mesh.body_vertex_range).max(initial=0)
        return NearBodies(topology) if is_worth and largest <= _MOST_VERTICES else None

    def record(self, recording: Recording, stages: Stages, active: wp.array) -> wp.array:
        """Record the launches that find which of the active bodies are near another; returns these, int32, [B]."""
        step = stages.step
        inputs = [self._begin, step.vertices_t0, step.vertices_t1, stages.box_radius, stages.inflation]
        outputs = [*self._boxes, self.is_any]
        recording.launch(kernels.fill_body_boxes, self._count, inputs=inputs, outputs=outputs, grain=64)
        inputs, outputs = [*self._boxes, active, self._always, self._filter], [self.near, self.is_any]
        recording.launch(kernels.mark_active_near, self._count, inputs=inputs, outputs=outputs, grain=64)
        return self.near
