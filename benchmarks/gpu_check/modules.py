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
from ccd_warp.benchmarks.gpu_check.small_scene import run_small_scene
from ccd_warp.benchmarks.gpu_check.target import Target
from ccd_warp.kernels.search_types import BOXES, CULL

from ccd_warp._runtime.lanes import narrow_phase_on, pair_search_on

# Threads a block that the check tries for the pair functions; Warp's own number is the largest.
BLOCK_DIMS = (32, 64, 128, 256)
# In the names of modules whose kernels are launched with each of them.
_BY_BLOCK_DIM = "points_toi"
# Modules in whose place the CPU has others.
_ONLY_CUDA = ("narrow_phase", "queued_pairs", "pair_search")
_NARROW_PHASE = ("points_toi", "solve_pairs", "pairs_bound")


def variants() -> list[tuple[str, Any, int]]:
    """Name, module and threads a block of everything that the check launches on CUDA."""
    modules = cuda_modules()
    wanted = [(name, module, module.options["block_dim"]) for name, module in modules.items()]
    for name, module in modules.items():
        if _BY_BLOCK_DIM in name:
            wanted += [(name, module, dim) for dim in BLOCK_DIMS if dim != module.options["block_dim"]]
    return wanted


def cpu_modules() -> list[Any]:
    """The modules of the CPU, whose answers are compared; those of the lanes are others than on CUDA."""
    cpu = wp.get_device("cpu")
    modules = {module for name, module in cuda_modules().items() if not name.startswith(_ONLY_CUDA)}
    for real in (wp.float64, wp.float32):
        modules |= {getattr(narrow_phase_on(cpu, real), kernel).module for kernel in _NARROW_PHASE}
    return [*modules, *(pair_search_on(cpu, end, lists).module for end in (BOXES, CULL) for lists in (False, True))]


def run(target: Target, record: Record, **_: Any) -> None:
    """Load all modules, and say how many had to be compiled, and what memory they take."""
    device = wp.get_device(target.device)
    if not target.is_real:
        record.add(f"{len(cuda_modules())} modules; they are compiled as they are used", modules=len(cuda_modules()))
        return
    total = int(device.total_memory)
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
        on_cpu = [pool.submit(load, "cpu", module, None) for module in cpu_modules()]
        seconds = list(pool.map(lambda each: load(device, *each[1:]), wanted))
        after = target.free_memory()
        slowest_on_cpu = max(future.result() for future in on_cpu)
    whole = time.perf_counter() - begin
    slowest, name = max(zip(seconds, (name for name, _, _ in wanted), strict=True))
    record.add(
        f"loaded in {whole:.1f} s; the slowest took {slowest:.1f} s, and {slowest_on_cpu:.1f} s on the CPU",
        seconds=whole,
        slowest={"seconds": slowest, "name": name, "on the CPU": slowest_on_cpu},
        bytes=(before or 0) - (after or 0),
    )
    run_small_scene(target.device)
    launched = target.free_memory()
    record.add(
        f"the context, modules and stacks take {(total - (launched or 0)) / 2**20:,.0f} MiB of {total / 2**30:.1f} GiB, "
        f"of which the first launches of all kernels have taken {((after or 0) - (launched or 0)) / 2**20:,.0f}",
        bytes_of_first_launches=(after or 0) - (launched or 0),
        bytes_in_use=total - (launched or 0),
    )


def cached(folder: Path, module: Any, device: Any, block_dim: int) -> bool:
    """Whether a module need not be compiled: whether its file is where Warp looks for it."""
    name = module.get_module_identifier(block_dim)
    return (folder / name / module._get_compile_output_name(device, block_dim=block_dim)).exists()


def load(device: Any, module: Any, block_dim: int | None) -> float:
    """Load a module, and return the seconds that it took."""
    begin = time.perf_counter()
    wp.load_module(module=module, device=device, block_dim=block_dim)
    return time.perf_counter() - begin
