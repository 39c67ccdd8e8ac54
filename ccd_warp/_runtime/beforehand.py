"""Compile kernels before they are needed, side by side and without loading them, for this machine or for others."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import warp as wp

from ccd_warp._runtime.launch import build_side_by_side
from ccd_warp._runtime.packaged import is_known, meta_name, object_name
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.shared_header import one_header
from ccd_warp._runtime.target import compiler_flags

# These take longest, and begin.
_LONG = ("narrow_phase", "last", "later", "queued_pairs", "search")


def compile_modules(modules: Mapping[str, Any], place: Any, progress: Progress | None = None) -> dict[str, Path]:
    """Compile modules into Warp's kernel cache, but for those that are there, and those that come with the package.

    Args:
        modules: Those of `every_module`, for the lanes of the place.
        place: A Warp device, a level of x86-64 by name, or the architecture of a GPU as a number, such as 90.
        progress: Told how many are ready.

    Returns:
        Files of objects and of what Warp knows of their kernels, by the names that they have in a package.
    """
    progress = progress or Progress()
    device = wp.get_device("cpu") if isinstance(place, str) else None if isinstance(place, int) else place
    is_cpu = device is not None and device.is_cpu
    how = {"output_arch": place, "use_ptx": False} if device is None else {}
    made: dict[str, Path] = {}

    def compile_one(module: Any) -> None:
        module.options["cpu_compiler_flags"] = compiler_flags(place) if isinstance(place, str) else None
        module.mark_modified()
        block_dim = 1 if is_cpu else module.options["block_dim"]
        identifier = module.get_module_identifier(block_dim)
        name = module._get_compile_output_name(device, block_dim=block_dim, **how)
        folder = Path(str(wp.config.kernel_cache_dir), identifier)
        packaged_name = object_name(module, block_dim, name.removeprefix(identifier))
        if not is_known(packaged_name):
            with one_header():
                module._compile(device, options=module.resolve_options(wp.config, block_dim=block_dim), **how)
            made[packaged_name] = folder / name
            made[meta_name(module, block_dim)] = folder / f"{identifier}.meta"
        progress.done += 1

    def rank(name: str) -> int:
        return next((k for k, word in enumerate(_LONG) if word in name), len(_LONG))

    progress.begin("compiling kernels", len(modules))
    tasks = [lambda m=modules[name]: compile_one(m) for name in sorted(modules, key=rank)]
    build_side_by_side(tasks, progress)
    return made
