"""What stays from step to step: a mesh's topology on a device, the boxes of what rests, buffers."""

from typing import Any

from ccd_warp._engine.boxes import StepBoxes
from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.contacts import ContactStore
from ccd_warp._engine.topology import Topology
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.threads import StopFlag

_MOST_OPTIONS = 8


class Workspace:
    """A mesh's own on a device; used by one step at a time.

    A step that does not end well leaves it half-made: it is dropped then, and the next step makes one anew.
    """

    def __init__(self, mesh: CollisionMesh, device: Any) -> None:
        self.topology = Topology.of(mesh, device)
        self.buffers = Buffers(device)
        self.flag = StopFlag(device)
        self.boxes = StepBoxes(self.topology, self.buffers)
        self._packed: dict[Any, Any] = {}

    @lazy_property
    def contacts(self) -> ContactStore:
        """Where a step puts its contacts."""
        return ContactStore(self.topology, self.buffers)

    def packed(self, options: Options, length_scale: float, max_iterations: int | None = None) -> Any:
        """Options as the kernels take them, with the stop flag; packed once, which takes as long as a launch."""
        key = (options, length_scale, max_iterations)
        if key not in self._packed:
            if len(self._packed) >= _MOST_OPTIONS:
                self._packed.clear()
            self._packed[key] = options.for_kernel(length_scale, max_iterations, self.flag.array)
        return self._packed[key]
