"""Launch a kernel over a range: in one go on CUDA, in disjoint parts on Python threads on the CPU.

Warp runs a CPU kernel serially and releases the GIL meanwhile, so disjoint ranges on Python threads run in parallel.
Every kernel launched here takes ``begin: int`` as its first parameter and works on item ``begin + wp.tid()``.
"""

import itertools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

_loading = threading.Lock()
_loaded: set[tuple[Any, str]] = set()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1), thread_name_prefix="ccd_warp")


def default_num_threads() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load(kernel: Any, device: Any) -> None:
    """Compile and load a kernel once, before threads race for it."""
    key = (kernel.module, str(device))
    if key not in _loaded:
        with _loading:
            wp.load_module(module=kernel.module, device=device)
        _loaded.add(key)


@dataclass(frozen=True)
class Execution:
    """Where and on how many threads to run."""

    device: Any
    num_threads: int

    @property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.device.is_cuda

    def launch(self, kernel: Any, count: int, inputs: list, outputs: list, grain: int = 1024) -> None:
        """Run ``kernel`` for items 0 … count-1.

        Args:
            kernel: Warp kernel whose first parameter is ``begin: int``.
            count: Number of items; nothing is launched for zero.
            inputs: Kernel inputs after ``begin``.
            outputs: Kernel outputs.
            grain: Smallest number of items that is worth a part of its own.
        """
        if count == 0:
            return
        load(kernel, self.device)

        def part(begin: int, end: int) -> None:
            wp.launch(kernel, dim=end - begin, inputs=[begin, *inputs], outputs=outputs, device=self.device)

        self.run([lambda b=b, e=e: part(b, e) for b, e in self.ranges(count, grain)])  # type: ignore[misc]

    def ranges(self, count: int, grain: int, parts_per_thread: int = 1) -> list[tuple[int, int]]:
        """Parts of 0 … count-1 for the threads, none much smaller than ``grain``."""
        parts = 1 if self.is_cuda else max(1, min(self.num_threads * parts_per_thread, count // grain))
        return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))

    def run(self, tasks: Sequence[Callable[[], Any]]) -> list[Any]:
        """Call the tasks, at most ``num_threads`` at a time, one of them here; their results in order."""
        if self.num_threads == 1 or self.is_cuda or len(tasks) == 1:
            return [task() for task in tasks]
        results: list[Any] = [None] * len(tasks)
        pending = iter(range(len(tasks)))
        lock = threading.Lock()

        def work() -> None:
            while True:
                with lock:
                    k = next(pending, None)
                if k is None:
                    return
                results[k] = tasks[k]()

        futures = [_pool().submit(work) for _ in range(min(self.num_threads, len(tasks)) - 1)]
        try:
            work()
        finally:
            # one that still waits for a thread of the pool has nothing left to do; the others are waited for
            running = [future for future in futures if not future.cancel()]
            wait(running)
        for future in running:
            future.result()
        return results


@dataclass(frozen=True)
class Slot:
    """An array argument of a recording that :meth:`Recording.bind` names."""

    name: str


class Recording:
    """Launches that are packed once and then repeated, in the order in which they were given."""

    def __init__(self, execution: Execution, arrays: dict[str, wp.array]) -> None:
        """``arrays`` are what the slots hold to begin with."""
        self.execution = execution
        self._arrays = dict(arrays)
        self._groups: list[list[wp.Launch]] = []
        self._uses: dict[str, list[tuple[wp.Launch, int]]] = {name: [] for name in arrays}

    @property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.execution.is_cuda

    def launch(
        self, kernel: Any, count: int, inputs: list, outputs: list, grain: int = 1024, parts_per_thread: int = 1
    ) -> None:
        """Keep a launch; arguments as of :meth:`Execution.launch`, and slots among them."""
        if count == 0:
            return
        load(kernel, self.execution.device)
        arguments = [*inputs, *outputs]
        packed = [self._arrays[a.name] if isinstance(a, Slot) else a for a in arguments]
        group = []
        for begin, end in self.execution.ranges(count, grain, parts_per_thread):
            command = wp.launch(
                kernel, dim=end - begin, inputs=[begin, *packed], device=self.execution.device, record_cmd=True
            )
            group.append(command)
            for index, argument in enumerate(arguments):
                if isinstance(argument, Slot):
                    self._uses[argument.name].append((command, index + 1))
        self._groups.append(group)

    def bind(self, name: str, array: wp.array) -> None:
        """Put an array in the place of a slot."""
        if array is self._arrays[name]:
            return
        self._arrays[name] = array
        for command, index in self._uses[name]:
            command.set_param_at_index(index, array)

    def play(self) -> None:
        """Launch all: on the CPU on threads, unless a graph is captured, which sees this thread alone."""
        is_serial = self.execution.is_cuda or self.execution.device.is_capturing
        for group in self._groups:
            if is_serial or len(group) == 1:
                for command in group:
                    command.launch()
            else:
                self.execution.run([command.launch for command in group])
