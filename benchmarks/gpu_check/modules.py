"""Stage: load every kernel on the device; those for which no cubin was made are compiled, several at a time."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.cuda_modules import cuda_modules
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target

# Threads a block that the check tries for the pair functions; Warp's own number is the largest.
BLOCK_DIMS = (32, 64, 128, 256)
# In the names of modules whose kernels are launched with each of them.
_BY_BLOCK_DIM = "points_toi"


def variants() -> list[tuple[str, Any, int]]:
    """Name, module and threads a block of everything that the check launches on CUDA."""
    modules = cuda_modules()
    wanted = [(name, module, module.options["block_dim"]) for name, module in modules.items()]
    for name, module in modules.items():
        if _BY_BLOCK_DIM in name:
            wanted += [(name, module, dim) for dim in BLOCK_DIMS if dim != module.options["block_dim"]]
    return wanted


def run(target: Target, record: Record, **_: Any) -> None:
    """Load all modules, and say how many had to be compiled, and what memory they take."""
    device = wp.get_device(target.device)
    if not target.is_real:
        wanted = [(name, module, 1) for name, module in cuda_modules().items()]
        record.add(f"{len(wanted)} modules; they are compiled as they are used", modules=len(wanted))
        return
    before = target.free_memory()
    wanted = variants()
    folder = Path(wp.config.kernel_cache_dir)
    found = [cached(folder, module, device, dim) for _, module, dim in wanted]
    record.add(
        f"{sum(found)} of {len(wanted)} modules are compiled already, in {folder}",
        modules=len(wanted),
        cached=sum(found),
        lacking=[f"{name}, {dim} threads" for (name, _, dim), there in zip(wanted, found, strict=True) if not there],
    )
    begin = time.perf_counter()
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        seconds = list(pool.map(lambda each: load(device, *each[1:]), wanted))
    after = target.free_memory()
    record.add(
        f"loaded in {time.perf_counter() - begin:.1f} s, the slowest in {max(seconds):.1f} s",
        seconds=time.perf_counter() - begin,
        slowest=max(zip(seconds, (name for name, _, _ in wanted), strict=True)),
        bytes=before - after if before is not None and after is not None else None,
    )


def cached(folder: Path, module: Any, device: Any, block_dim: int) -> bool:
    """Whether a module need not be compiled: whether its file is where Warp looks for it."""
    name = module.get_module_identifier(block_dim)
    return (folder / name / module._get_compile_output_name(device, block_dim=block_dim)).exists()


def load(device: Any, module: Any, block_dim: int) -> float:
    """Load a module, and return the seconds that it took."""
    begin = time.perf_counter()
    wp.load_module(module=module, device=device, block_dim=block_dim)
    return time.perf_counter() - begin
