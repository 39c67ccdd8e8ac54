"""Warp's kernel cache on the disk: what is damaged there is compiled again, and what cannot be written is named."""

import os
import shutil
import warnings
from typing import Any

import warp as wp

_ADVICE = "free space there, or let WARP_CACHE_PATH name a folder that can be written"


def load_or_repair(kernel: Any, device: Any, block_dim: int | None) -> None:
    """Load a kernel's module, compiled or from the cache; where files there are damaged, name them and compile again.

    Raises:
        OSError: If the cache cannot be written.
    """
    if device.is_cpu:
        block_dim = 1  # as Warp takes it there; the cache tells modules apart by it
    try:
        _load(kernel, device, block_dim)
        return
    except Exception as error:  # Warp raises whatever a damaged file leads to
        failure = error
    # There is a folder of the module only if it was compiled before.
    folder = os.path.join(str(wp.config.kernel_cache_dir), kernel.module.get_module_identifier(block_dim))
    if os.path.isdir(folder):
        reason = " ".join(str(failure).split())
        warnings.warn(
            f"Warp's kernel cache is damaged in {folder} ({reason}); it is compiled again", RuntimeWarning, stacklevel=2
        )
        shutil.rmtree(folder, ignore_errors=True)
        try:
            _load(kernel, device, block_dim)
            return
        except Exception as error:
            failure = error
    if isinstance(failure, OSError) or os.path.isdir(folder):
        raise OSError(unwritable_cache(folder, failure)) from failure
    raise failure


def _load(kernel: Any, device: Any, block_dim: int | None) -> None:
    wp.load_module(module=kernel.module, device=device, block_dim=block_dim)
    if device.is_cpu:  # an object file of zeros, as a crash of the machine leaves it, is loaded and holds nothing
        key = (device.context, block_dim)
        if kernel.module.execs[key].get_kernel_hooks(kernel).forward is None:
            del kernel.module.execs[key]
            raise RuntimeError(f"the kernel {kernel.key} is missing")


def unwritable_cache(folder: Any, error: Exception) -> str:
    """What a message says of a cache that cannot be written."""
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    return f"Warp's kernel cache cannot be written in {os.fspath(folder)} ({reason}); {_ADVICE}"
