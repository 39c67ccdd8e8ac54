"""Warp's kernel cache on the disk: what is damaged there is compiled again, and what cannot be written is named.

Before it is looked at, a module is looked for in the package (`packaged`).
"""

import os
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from ccd_warp._runtime.kept_hashes import keep_in_cache, recall_from_cache
from ccd_warp._runtime.packaged import load_packaged
from ccd_warp._runtime.shared_header import one_header
from ccd_warp._runtime.target import set_flags

_ADVICE = "free space there, or let WARP_CACHE_PATH name a folder that can be written"
_is_said = False
_is_announced = False


def load_or_repair(kernel: wp.Kernel, device: wp.Device, block_dim: int | None) -> None:
    """Load a kernel's module, of the package, from the cache or compiled; damaged files are named, and compiled again.

    Raises:
        OSError: If the cache cannot be written.
    """
    if device.is_cpu:
        block_dim = 1  # as Warp takes it there; the cache tells modules apart by it
    set_flags(kernel.module, device)
    if load_packaged(kernel.module, device, block_dim) and _is_there(kernel, device, block_dim):
        return
    recall_from_cache(kernel.module, block_dim)
    # There is a folder of the module only if it was compiled before.
    folder = os.path.join(str(wp.config.kernel_cache_dir), kernel.module.get_module_identifier(block_dim))
    if not os.path.isdir(folder):
        _say_once(device)
        _forget(kernel.module, block_dim)  # what is compiled is named by a hash of Warp's own
    try:
        _load(kernel, device, block_dim)
        keep_in_cache(kernel.module, block_dim)
        return
    except Exception as error:  # Warp raises whatever a damaged file leads to
        failure = error
    if os.path.isdir(folder):
        reason = " ".join(str(failure).split())
        warnings.warn(
            f"Warp's kernel cache is damaged in {folder} ({reason}); it is compiled again", RuntimeWarning, stacklevel=2
        )
        shutil.rmtree(folder, ignore_errors=True)
        _forget(kernel.module, block_dim)
        try:
            _load(kernel, device, block_dim)
            keep_in_cache(kernel.module, block_dim)
            return
        except Exception as error:
            failure = error
    if isinstance(failure, OSError) or os.path.isdir(folder):
        raise OSError(unwritable_cache(folder, failure)) from failure
    raise failure


def is_current(module: wp.Module, device: wp.Device) -> bool:
    """Whether a module that has been loaded on the CPU is as it was then.

    A launch would load it again if not, with the flags of another device, and each of several threads would: Warp gives
    what they load one name, and unloads the code of the one for that of another.
    """
    if device.is_cuda:
        return True  # this thread alone launches
    hasher, loaded = module.hashers.get(1), module.execs.get((device.context, 1))
    return hasher is not None and loaded is not None and hasher.get_hash() == loaded.module_hash


def _forget(module: wp.Module, block_dim: int | None) -> None:
    """Let Warp compute the hash of a module for a device, and compile it; what is loaded on others is not touched."""
    for known in (module.hashers, module.resolved_options):
        known.pop(block_dim, None)
    module.failed_builds = {}


def _say_once(device: wp.Device) -> None:
    """Say once in a process why a first call takes seconds, in notebooks and logs, too; not where Warp is silent."""
    global _is_said
    is_silent = wp.config.log_level > wp.LOG_WARNING and not _is_announced
    if _is_said or is_silent or sys.stderr is None:
        return
    _is_said = True
    # the time is that of `ccd-warp bench --only start`
    time = ", about 10 s on two free cores" if device.is_cpu else ""
    line = f"ccd_warp: compiling kernels{time}; they are kept in {wp.config.kernel_cache_dir}"
    print(f"\r{line}" if sys.stderr.isatty() else line, file=sys.stderr, flush=True)


@contextmanager
def announced_compilation() -> Iterator[None]:
    """Say that kernels are compiled also where Warp itself is silent, as the command line keeps it."""
    global _is_announced
    _is_announced = True
    try:
        yield
    finally:
        _is_announced = False


def _load(kernel: wp.Kernel, device: wp.Device, block_dim: int | None) -> None:
    module, compiled = kernel.module, _compiled_for_gpu(kernel.module, device, block_dim)
    with one_header():
        if compiled:
            module.load(device, block_dim, output_arch=device.arch, **compiled)
        else:
            wp.load_module(module=module, device=device, block_dim=block_dim)
    if not _is_there(kernel, device, block_dim):
        raise RuntimeError(f"the kernel {kernel.key} is missing")


def _is_there(kernel: wp.Kernel, device: wp.Device, block_dim: int | None) -> bool:
    """Whether a module has its kernel: an object file of zeros, as a crash of the machine leaves it, has none."""
    key = (device.context, block_dim)
    if device.is_cuda or kernel.module.execs[key].get_kernel_hooks(kernel).forward is not None:
        return True
    del kernel.module.execs[key]
    return False


def _compiled_for_gpu(module: wp.Module, device: wp.Device, block_dim: int | None) -> dict[str, str]:
    """Code that `ccd-warp compile --arch` has put into the cache: Warp itself may look there for PTX alone."""
    if not device.is_cuda:
        return {}
    name = module.get_module_identifier(block_dim)
    path = os.path.join(str(wp.config.kernel_cache_dir), name, name)
    files = {"binary_path": f"{path}.sm{device.arch}.cubin", "meta_path": f"{path}.meta"}
    return files if all(map(os.path.isfile, files.values())) else {}


def unwritable_cache(folder: Any, error: Exception) -> str:
    """What a message says of a cache that cannot be written."""
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    return f"Warp's kernel cache cannot be written in {os.fspath(folder)} ({reason}); {_ADVICE}"
