"""Every module that the check launches, on CUDA for each number of threads a block, and on the CPU beside it."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.cuda_modules import cuda_modules
from ccd_warp.kernels.pair.norm import MAXIMUM_NORM
from ccd_warp.kernels.search.search_types import BOXES, CULL

from ccd_warp._runtime.lanes import narrow_phase_on, search_on

# Threads a block that the check tries for the pair functions.
BLOCK_DIMS = (32, 64, 128, 256)
# In the names of modules whose kernels are launched with each of them.
_BY_BLOCK_DIM = "points_toi"
# Modules in whose place the CPU has others, with its lanes.
_ONLY_CUDA = ("narrow_phase", "queued_pairs", "half_warp", "search", "candidate_cull")


def variants() -> list[tuple[str, Any, int]]:
    """Name, module and threads a block of everything that is launched on CUDA."""
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
    modules |= {narrow_phase_on(cpu, real, MAXIMUM_NORM).solve_pairs.module for real in (wp.float64, wp.float32)}
    for walk, end, with_lists in product(("search_trees", "search_hashes"), (BOXES, CULL), (False, True)):
        modules.add(search_on(cpu, walk, end, with_lists, is_cuda=False).module)
    return list(modules)


def is_compiled(folder: Path, module: Any, device: Any, block_dim: int) -> bool:
    """Whether a module need not be compiled: whether its file is where Warp looks for it."""
    name = module.get_module_identifier(block_dim)
    return (folder / name / module._get_compile_output_name(device, block_dim=block_dim)).exists()
