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
        parts = 1 if self.is_cuda else max(1, min(self.num_threads, count // grain))
        if parts == 1:
            wp.launch(kernel, dim=count, inputs=[0, *inputs], outputs=outputs, device=self.device)
            return
        bounds = [count * k // parts for k in range(parts + 1)]

        def part(begin: int, end: int) -> None:
            wp.launch(kernel, dim=end - begin, inputs=[begin, *inputs], outputs=outputs, device=self.device)

        self.run([lambda b=b, e=e: part(b, e) for b, e in itertools.pairwise(bounds)])  # type: ignore[misc]

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
