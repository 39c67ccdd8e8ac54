"""Launches outside a recording that are made again and again, of which Warp checks and packs little anew."""

from typing import Any

import warp as wp

from ccd_warp._runtime.launch import Execution, block_dim_of, load

_GRAIN = 1024


class RepeatedLaunches:
    """Launches by kernel. Each kernel has one that is given other arguments and another number of items each time.

    That takes a third of the time of a new launch, which is more than the kernels of a small step take.
    """

    def __init__(self, execution: Execution) -> None:
        self.execution = execution
        self._commands: dict[Any, Any] = {}

    def launch(self, kernel: wp.Kernel, count: int, inputs: list, outputs: list) -> None:
        """Run ``kernel`` for items 0 … count-1; the arguments are those of :meth:`Execution.launch`."""
        execution = self.execution
        if count == 0:
            return
        is_shared = count >= 2 * _GRAIN and execution.num_threads > 1 and not execution.is_cuda
        if is_shared or execution.device.is_capturing:
            execution.launch(kernel, count, inputs, outputs, grain=_GRAIN)
            return
        arguments = [0, *inputs, *outputs]
        command = self._commands.pop(kernel, None)  # no other thread changes it meanwhile
        if command is None:
            load(kernel, execution.device, execution.progress)
            block_dim = block_dim_of(kernel, execution.device)
            options: Any = {"device": execution.device, "block_dim": block_dim, "record_tape": False}
            command = wp.launch(kernel, dim=count, inputs=arguments, record_cmd=True, **options)
        else:
            command.set_params(arguments)
            command.set_dim(count)
        command.launch()
        self._commands[kernel] = command
