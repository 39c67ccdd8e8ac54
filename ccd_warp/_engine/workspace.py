"""What stays from step to step: a mesh's topology on a device, the boxes of what rests, buffers."""

from typing import Any

from ccd_warp._engine.boxes import StepBoxes
from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.topology import Topology
from ccd_warp._mesh import CollisionMesh
from ccd_warp._runtime.threads import StopFlag


class Workspace:
    """A mesh's own on a device; used by one step at a time.

    A step that does not end well leaves it half-made: it is dropped then, and the next step makes one anew.
    """

    def __init__(self, mesh: CollisionMesh, device: Any) -> None:
        self.topology = Topology.of(mesh, device)
        self.buffers = Buffers(device)
        self.flag = StopFlag(device)
        self.boxes = StepBoxes(self.topology, self.buffers)
