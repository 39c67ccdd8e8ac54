"""Launch a kernel over a range: at once on CUDA, in disjoint parts on Python threads on the CPU.

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

# Largest number of items in a part of a kernel that does little work for each: some 20 ms.
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
    """Compile and load a kernel once, on its own thread, so that an interrupt is handled meanwhile."""
    key = (kernel.module, str(device))
    if key in _loaded:
        return

    def compile_module() -> None:
        with building:
            wp.load_module(module=kernel.module, device=device)

    if device.is_capturing:  # Warp allows it only on the thread of the capture
        compile_module()
    else:
        run_aside(compile_module)
    _loaded.add(key)


@dataclass(frozen=True)
class Execution:
    """The device and the number of threads on which to run.

    Attributes:
        device: Warp device.
        num_threads: Threads on the CPU.
        flag: The flag that long kernels read to stop early, or None where no such kernel is launched.
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
            grain: Smallest number of items that is worth its own part.
            is_long: Whether items may take long, in which case the kernel reads the stop flag.
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
        """Whether this thread launches all: on CUDA, and in a capture on the CPU, which records only this thread."""
        return self.is_cuda or self.device.is_capturing

    def ranges(self, count: int, grain: int, parts_per_thread: int = 1) -> list[tuple[int, int]]:
        """Parts of 0 … count-1 for the threads, none much smaller than ``grain``, none so large that it takes long."""
        parts = 1
        if not self.is_cuda:
            parts = max(1, min(self.num_threads * parts_per_thread, count // grain), -(-count // _MOST_ITEMS))
        return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))

    def run(
        self, tasks: Sequence[Callable[[], Any]], *, is_long: bool = False, own: Callable[[], Any] | None = None
    ) -> list[Any]:
        """Call the tasks, at most ``num_threads`` at a time, and return their results in order once all have ended.

        Long tasks run on other threads, while this one waits and handles an interrupt, or does ``own`` work in pieces.
        """
        if self.is_serial:
            results = [task() for task in tasks]
            if own is not None:
                own()
            return results
        return run(tasks, self.num_threads, self.flag, is_long=is_long, own=own, tick=self.tick)


@dataclass(frozen=True)
class Slot:
    """A named argument of a recording, set by :meth:`Recording.bind`."""

    name: str


@dataclass(frozen=True)
class _Group:
    """The parts of a launch, with the conditions under which it is needed and may take long."""

    commands: list[wp.Launch]
    is_needed: Callable[[], bool] | None
    is_long: Callable[[], bool] | None


class Recording:
    """Launches that are packed once and then repeated, in the order in which they were given."""

    def __init__(self, execution: Execution, values: dict[str, Any]) -> None:
        """``values`` are the initial values of the slots."""
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
        """Record a launch; the arguments are those of :meth:`Execution.launch`, and may include slots.

        Args:
            kernel: As in :meth:`Execution.launch`, like the following ones.
            count: Number of items.
            inputs: Kernel inputs.
            outputs: Kernel outputs.
            grain: Smallest part.
            parts_per_thread: Parts for each thread.
            is_needed: Called on the CPU outside a capture: whether there is anything to do.
            is_long: Called likewise: whether the launch may take long.
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
        """Set a slot to an array or a number."""
        if value is self._values[name]:
            return
        self._values[name] = None  # no value counts as bound while only some launches have the new one
        for command, index in self._uses[name]:
            command.set_param_at_index(index, value)
        self._values[name] = value

    def play(self) -> None:
        """Launch all groups: on the CPU on threads, unless a graph is captured, which records only this thread."""
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
