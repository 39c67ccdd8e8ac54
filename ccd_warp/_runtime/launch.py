"""Launch a kernel over a range: in one go on CUDA, in disjoint parts on Python threads on the CPU.

Warp runs a CPU kernel serially and releases the GIL meanwhile, so disjoint ranges on Python threads run in parallel.
Every kernel launched here takes ``begin: int`` as its first parameter and works on item ``begin + wp.tid()``.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp

from ccd_warp._runtime.threads import StopFlag, run, run_aside
from ccd_warp.kernels.once import building

# Items of a kernel that does little for each, which a part holds at most: some 20 ms.
_MOST_ITEMS = 1 << 19

_loaded: set[tuple[Any, str]] = set()
_is_started = False


def start_warp() -> None:
    """Initialise Warp, one thread at a time."""
    global _is_started
    if not _is_started:
        with building:
            wp.init()
        _is_started = True


def load(kernel: Any, device: Any) -> None:
    """Compile and load a kernel once, on a thread of its own, so that an interrupt is answered meanwhile."""
    key = (kernel.module, str(device))
    if key in _loaded:
        return

    def compile_module() -> None:
        with building:
            wp.load_module(module=kernel.module, device=device)

    if device.is_capturing:  # Warp allows it on the thread of the capture alone
        compile_module()
    else:
        run_aside(compile_module)
    _loaded.add(key)


@dataclass(frozen=True)
class Execution:
    """Where and on how many threads to run.

    Attributes:
        device: Warp device.
        num_threads: Threads on the CPU.
        flag: What kernels that may run long look at, or None where none is launched.
        tick: Called ten times a second while a long job runs, on the thread that waits for it.
    """

    device: Any
    num_threads: int
    flag: StopFlag | None = None
    tick: Callable[[], None] | None = None

    @property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.device.is_cuda

    def launch(
        self, kernel: Any, count: int, inputs: list, outputs: list, grain: int = 1024, *, is_long: bool = False
    ) -> None:
        """Run ``kernel`` for items 0 … count-1.

        Args:
            kernel: Warp kernel whose first parameter is ``begin: int``.
            count: Number of items; nothing is launched for zero.
            inputs: Kernel inputs after ``begin``.
            outputs: Kernel outputs.
            grain: Smallest number of items that is worth a part of its own.
            is_long: Whether items may take long: then the kernel reads the stop flag.
        """
        if count == 0:
            return
        load(kernel, self.device)

        def part(begin: int, end: int) -> None:
            wp.launch(kernel, dim=end - begin, inputs=[begin, *inputs], outputs=outputs, device=self.device)

        if self.is_serial:
            part(0, count)
            return
        parts = self.ranges(count, grain)
        self.run([lambda b=b, e=e: part(b, e) for b, e in parts], is_long=is_long)  # type: ignore[misc]

    @property
    def is_serial(self) -> bool:
        """Whether this thread launches all: on CUDA, and in a graph of the CPU, which records this thread alone."""
        return self.is_cuda or self.device.is_capturing

    def ranges(self, count: int, grain: int, parts_per_thread: int = 1) -> list[tuple[int, int]]:
        """Parts of 0 … count-1 for the threads, none much smaller than ``grain``, and none so large as to take long."""
        parts = 1
        if not self.is_cuda:
            parts = max(1, min(self.num_threads * parts_per_thread, count // grain), -(-count // _MOST_ITEMS))
        return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))

    def run(self, tasks: Sequence[Callable[[], Any]], *, is_long: bool = False) -> list[Any]:
        """Call the tasks, at most ``num_threads`` at a time; their results in order, once all have ended.

        Long ones run on other threads, while this one waits and answers an interrupt.
        """
        if self.is_serial:
            return [task() for task in tasks]
        return run(tasks, self.num_threads, self.flag, is_long=is_long, tick=self.tick)


@dataclass(frozen=True)
class Slot:
    """An argument of a recording that :meth:`Recording.bind` names."""

    name: str


@dataclass(frozen=True)
class _Group:
    """The parts of a launch, and when it is left out, or may take long."""

    commands: list[wp.Launch]
    is_needed: Callable[[], bool] | None
    is_long: Callable[[], bool] | None


class Recording:
    """Launches that are packed once and then repeated, in the order in which they were given."""

    def __init__(self, execution: Execution, values: dict[str, Any]) -> None:
        """``values`` are what the slots hold to begin with."""
        self.execution = execution
        self._values = dict(values)
        self._groups: list[_Group] = []
        self._uses: dict[str, list[tuple[wp.Launch, int]]] = {name: [] for name in values}

    @property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.execution.is_cuda

    def launch(
        self,
        kernel: Any,
        count: int,
        inputs: list,
        outputs: list,
        grain: int = 1024,
        parts_per_thread: int = 1,
        *,
        is_needed: Callable[[], bool] | None = None,
        is_long: Callable[[], bool] | None = None,
    ) -> None:
        """Keep a launch; arguments as of :meth:`Execution.launch`, and slots among them.

        Args:
            kernel: As there, as are those that follow.
            count: Number of items.
            inputs: Kernel inputs.
            outputs: Kernel outputs.
            grain: Smallest part.
            parts_per_thread: Parts for each thread.
            is_needed: Asked on the CPU, outside a graph: whether there is anything to do.
            is_long: Asked there, too: whether it may take long.
        """
        if count == 0:
            return
        load(kernel, self.execution.device)
        arguments = [*inputs, *outputs]
        packed = [self._values[a.name] if isinstance(a, Slot) else a for a in arguments]
        commands = []
        for begin, end in self.execution.ranges(count, grain, parts_per_thread):
            command = wp.launch(
                kernel, dim=end - begin, inputs=[begin, *packed], device=self.execution.device, record_cmd=True
            )
            commands.append(command)
            for index, argument in enumerate(arguments):
                if isinstance(argument, Slot):
                    self._uses[argument.name].append((command, index + 1))
        self._groups.append(_Group(commands, is_needed, is_long))

    def bind(self, name: str, value: Any) -> None:
        """Put an array or a number in the place of a slot."""
        if value is self._values[name]:
            return
        self._values[name] = None  # nothing is bound while only some launches have the new one
        for command, index in self._uses[name]:
            command.set_param_at_index(index, value)
        self._values[name] = value

    def play(self) -> None:
        """Launch all: on the CPU on threads, unless a graph is captured, which sees this thread alone."""
        is_serial = self.execution.is_serial
        for group in self._groups:
            if is_serial:
                for command in group.commands:
                    command.launch()
            elif group.is_needed is None or group.is_needed():
                is_long = group.is_long is not None and group.is_long()
                if is_long or len(group.commands) > 1:
                    self.execution.run([command.launch for command in group.commands], is_long=is_long)
                else:
                    group.commands[0].launch()
