"""Cubins made without a GPU: ``--precompile DIR`` makes them, and the check uses them with ``--precompiled DIR``.

Warp looks for a module at ``DIR/<version>/wp_<name>_<hash>/wp_<name>_<hash>.sm90.cubin`` (`Module.load`). The hash is
that of the source of its kernels, the options and the threads a block, and of nothing about the GPU or the machine. A
module is compiled only if that file and its ``.meta`` do not exist. Warp's own compiler makes cubins for any GPU, and
needs none, so a kernel cache that is filled here has every module there. By default Warp looks for PTX where the driver
is new enough to compile that; ``warp.config.cuda_output`` makes it look for cubins.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.gpu_check.journal import read_json, write_json
from ccd_warp.benchmarks.gpu_check.variants import variants

ARCHS = (80, 90, 120)
MANIFEST = "precompiled.json"
# Names the folder to the processes that the check starts.
_VARIABLE = "CCD_WARP_PRECOMPILED"


def use(folder: Path, *, cubins: bool) -> None:
    """Let Warp keep and look for compiled modules in a folder; to be called before Warp starts.

    Args:
        folder: The folder, as it was given to :func:`precompile`, or an empty one.
        cubins: Whether to look for cubins, rather than for what Warp would choose.
    """
    wp.config.kernel_cache_dir = str(folder)
    if cubins:
        wp.config.cuda_output = "cubin"


def use_in_all_processes(folder: Path) -> None:
    """Use the cubins of a folder here, and in the processes that are started from here and call :func:`use_named`."""
    os.environ[_VARIABLE] = str(folder.resolve())
    use_named()


def use_named() -> None:
    """Use the cubins of the folder that the environment names, if it does."""
    if _VARIABLE in os.environ:
        use(Path(os.environ[_VARIABLE]), cubins=True)


def check_folder(folder: Path) -> str:
    """A line on what a folder of cubins holds.

    Raises:
        ValueError: If it holds none, or those of another version of Warp.
    """
    manifest = read_json(folder / MANIFEST)
    if manifest is None:
        raise ValueError(f"precompiled is {folder}; expected a folder that --precompile has filled")
    if manifest["warp"] != wp.config.version:
        raise ValueError(
            f"precompiled is {folder}, made with Warp {manifest['warp']}; expected cubins of Warp {wp.config.version}"
        )
    archs = ", ".join(f"sm_{arch}" for arch in manifest["archs"])
    return f"{manifest['modules']} modules for {archs} in {folder}"


def precompile(folder: Path, archs: Iterable[int], say: Callable[[str], None], words: Iterable[str] = ()) -> list[Path]:
    """Compile every module that the check launches, several at a time; what is there already is kept.

    Args:
        folder: Where they go; :func:`use` has been called with it.
        archs: Compute capabilities, as 90 for sm_90.
        say: Called with a line for each module.
        words: Only modules whose name contains one of these; all if there are none.

    Returns:
        The files.
    """
    wp.init()
    archs = tuple(archs)
    wanted = [each for each in variants() if not tuple(words) or any(word in each[0] for word in words)]
    begin = time.perf_counter()
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        orders = [(name, module, dim, arch) for arch in archs for name, module, dim in wanted]
        paths = list(pool.map(lambda order: compile_one(*order, say), orders))
    size = sum(path.stat().st_size for path in paths)
    write_json(
        folder / MANIFEST,
        {
            "warp": wp.config.version,
            "archs": archs,
            "modules": len(wanted),
            "machine": platform.machine(),
            "files": [str(path.relative_to(Path(wp.config.kernel_cache_dir).parent)) for path in paths],
        },
    )
    say(f"{len(paths)} cubins of {size / 2**20:.0f} MiB in {time.perf_counter() - begin:.0f} s, in {folder}")
    return paths


def compile_one(name: str, module: Any, block_dim: int, arch: int, say: Callable[[str], None]) -> Path:
    """Compile a module for a GPU and a number of threads a block, under the name that it will be looked for."""
    begin = time.perf_counter()
    options = module.resolve_options(wp.config, block_dim=block_dim)
    module.get_module_hash(block_dim)
    is_new = module._compile(None, output_arch=arch, use_ptx=False, options=options)
    if is_new:
        say(f"{name}, sm_{arch}, {block_dim} threads a block: {time.perf_counter() - begin:.1f} s")
    file = module._get_compile_output_name(None, arch, use_ptx=False, block_dim=block_dim)
    return Path(wp.config.kernel_cache_dir, module.get_module_identifier(block_dim), file)
