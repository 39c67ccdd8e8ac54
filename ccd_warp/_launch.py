"""Launch a kernel over a range: in one go on CUDA, in disjoint parts on Python threads on the CPU.

Warp runs a CPU kernel serially and releases the GIL meanwhile, so disjoint ranges on Python threads run in parallel.
Every kernel launched here takes ``begin: int`` as its first parameter and works on item ``begin + wp.tid()``.
"""

import itertools
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import warp as wp


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=max(1, os.cpu_count() or 1), thread_name_prefix="ccd_warp")


def default_num_threads() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def launch(kernel, count: int, inputs: list, outputs: list, *, device, num_threads: int, grain: int = 1024) -> None:
    """Run ``kernel`` for items 0 … count-1.

    Args:
        kernel: Warp kernel whose first parameter is ``begin: int``.
        count: Number of items; nothing is launched for zero.
        inputs: Kernel inputs after ``begin``.
        outputs: Kernel outputs.
        device: Warp device.
        num_threads: Parts that run at a time on the CPU; ignored on CUDA.
        grain: Smallest number of items that is worth a part of its own.
    """
    if count == 0:
        return
    parts = 1
    if not wp.get_device(device).is_cuda:
        parts = max(1, min(num_threads, count // grain))
    if parts == 1:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], outputs=outputs, device=device)
        return
    wp.load_module(module=kernel.module, device=device)  # once, before the threads race for it
    bounds = [count * k // parts for k in range(parts + 1)]
    futures = [
        _pool().submit(wp.launch, kernel, dim=end - begin, inputs=[begin, *inputs], outputs=outputs, device=device)
        for begin, end in itertools.pairwise(bounds)
    ]
    for future in futures:
        future.result()
