"""Stage: load every kernel on the device; those for which no cubin was made are compiled, several at a time."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.cuda_modules import cuda_modules
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.small_scene import run_small_scene
from ccd_warp.benchmarks.gpu_check.target import Target
from ccd_warp.benchmarks.gpu_check.variants import cpu_modules, is_compiled, variants


def cases(target: Target, **_: Any) -> Cases:
    """All modules at once."""
    return {"modules": partial(load_all, target)}


def load_all(target: Target, record: Record) -> None:
    """Load all modules, and say how many had to be compiled, and what memory they take."""
    if not target.is_real:
        count = len(cuda_modules())
        record.add(f"{count} modules; they are compiled as they are used", modules=count)
        return
    device = wp.get_device(target.device)
    wanted = variants()
    folder = Path(wp.config.kernel_cache_dir)
    lacking = [(name, dim) for name, module, dim in wanted if not is_compiled(folder, module, device, dim)]
    record.add(
        f"{len(wanted) - len(lacking)} of {len(wanted)} modules are compiled already, in {folder}",
        modules=len(wanted),
        lacking=[f"{name}, {dim} threads a block" for name, dim in lacking],
    )
    before = device.free_memory
    begin = time.perf_counter()
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        on_cpu = [pool.submit(load, "cpu", module, None) for module in cpu_modules()]
        seconds = list(pool.map(lambda each: load(device, *each[1:]), wanted))
        slowest_on_cpu = max(future.result() for future in on_cpu)
    whole = time.perf_counter() - begin
    slowest, name = max(zip(seconds, (name for name, _, _ in wanted), strict=True))
    record.add(
        f"loaded in {whole:.1f} s; the slowest took {slowest:.1f} s, and {slowest_on_cpu:.1f} s on the CPU",
        seconds=whole,
        slowest={"seconds": slowest, "name": name, "on the CPU": slowest_on_cpu},
    )
    loaded = device.free_memory
    run_small_scene(target.device)
    launched = device.free_memory
    taken = {"modules": before - loaded, "first launches": loaded - launched, "all": device.total_memory - launched}
    said = ", ".join(f"{what} {size / 2**20:,.0f} MiB" for what, size in taken.items())
    record.add(f"memory of the device in use: {said}", bytes=taken)


def load(device: Any, module: Any, block_dim: int | None) -> float:
    """Load a module, and return the seconds that it took."""
    begin = time.perf_counter()
    wp.load_module(module=module, device=device, block_dim=block_dim)
    return time.perf_counter() - begin
