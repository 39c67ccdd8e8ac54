"""What launches on tapes keep with the step on the device that they are launches of."""

from typing import TYPE_CHECKING, Any

from ccd_warp._runtime.repeated import RepeatedLaunches

if TYPE_CHECKING:
    from ccd_warp._engine.device.step import DeviceStep


class TapeMemory:
    """Memory that such launches use again, and what is made once for all of them.

    Attributes:
        query: What counts as touching, as the struct of the kernels.
        found_on_host: The toi of the scene and the number of contacts, the same memory as the arrays of the result; on
            CUDA None.
        launch: Launches a kernel, of which Warp checks and packs little anew.
        copies: Memory that launches have used, and will use again.
        attaining: The same of backward passes.
        groups: What line searches know of the vertices that move by one fraction, by the kind of line search.
    """

    def __init__(self, step: "DeviceStep") -> None:
        """Make what all need.

        Raises:
            ValueError: If the distance of a pair follows from its start.
        """
        topology, result = step.topology, step.result
        self.query = step.touch().query(is_planar=topology.mesh.dimension == 2)
        is_cpu = topology.device.is_cpu
        self.found_on_host: Any = (result.toi.numpy(), result.contacts.count.numpy()) if is_cpu else None
        self.launch = RepeatedLaunches(step.execution).launch
        self.copies: list[Any] = []
        self.attaining: list[Any] = []
        self.groups: dict[str, Any] = {}

    @classmethod
    def of(cls, step: "DeviceStep") -> "TapeMemory":
        """That of a step, which the first launch on a tape makes.

        Raises:
            ValueError: If the distance of a pair follows from its start.
        """
        if cls not in step.kept_by_rings:
            step.kept_by_rings[cls] = cls(step)
        memory: TapeMemory = step.kept_by_rings[cls]
        return memory
