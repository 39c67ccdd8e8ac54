"""Start Warp, and keep out of a user's output what Warp says because of this library.

Warp prints a banner when it starts and a line for each module that it loads. Where ccd_warp starts it, or loads a
module of its own, these would appear in the output of a program that may never have mentioned Warp. Warnings and errors
stay, and so does what Warp says of the user's own kernels. ``warp.config.log_level = warp.LOG_DEBUG`` shows everything.
"""

import atexit
import ctypes
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import warp as wp

from ccd_warp._runtime.kernel_cache import unwritable_cache
from ccd_warp._runtime.packaged import has_any
from ccd_warp.kernels.once import building

_DRIVERS = {"linux": ("libcuda.so", "libcuda.so.1"), "win32": ("nvcuda.dll",)}
_DRIVER_WARNING = b"Could not find or load the NVIDIA CUDA driver"

_is_started = False
why_no_cache = ""  # why Warp could not have its cache, where it has an empty one of its own instead


@contextmanager
def quietly() -> Iterator[None]:
    """Keep Warp's information out while this library has it start or load, with `building` locked."""
    level = wp.config.log_level
    try:
        if level > wp.LOG_DEBUG:
            wp.config.log_level = max(level, wp.LOG_WARNING)
        yield
    finally:
        wp.config.log_level = level


def start_warp(*, needs_cache: bool = True) -> None:
    """Initialise Warp, one thread at a time, without a warning where there is no CUDA driver.

    Raises:
        OSError: If the cache cannot be written, and is needed as the package brings no kernels.
    """
    global _is_started
    if _is_started:
        return
    try:
        with building, quietly(), nullcontext() if _has_driver() else _without_driver_warning():
            _init(needs_cache and not has_any())
    except OSError as error:
        raise OSError(_unwritable(error)) from error
    _is_started = True


def _unwritable(error: OSError) -> str:
    return unwritable_cache(error.filename or wp.config.kernel_cache_dir, error)


def _init(needs_cache: bool) -> None:
    """Initialise Warp, with an empty cache of its own where it can have no other and needs none."""
    global why_no_cache
    try:
        wp.init()
    except OSError as error:
        if needs_cache:
            raise
        why_no_cache = _unwritable(error)
        wp.config.kernel_cache_dir = tempfile.mkdtemp(prefix="ccd_warp_")
        atexit.register(shutil.rmtree, wp.config.kernel_cache_dir, ignore_errors=True)
        wp.init()
    # The version of its compiler is a part of each object's name, and Warp writes it into one buffer for all threads:
    # the second of two that ask at once may find it empty. Warp keeps the first answer.
    if ask := getattr(wp._src.context, "_get_cpu_toolchain_version", None):
        ask()


def _has_driver() -> bool:
    """Whether the library can be loaded that Warp looks for, by the names that Warp tries."""
    for name in _DRIVERS.get(sys.platform, ()):
        try:
            ctypes.CDLL(name)
            return True
        except OSError:
            pass
    return False


@contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Keep one line of native code, which no log level governs, from stderr; everything else still gets there."""
    try:
        saved = os.dup(2)
        caught = tempfile.TemporaryFile()
    except OSError:  # there is no stderr, or nowhere to keep it
        yield
        return
    try:
        os.dup2(caught.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        with caught:
            caught.seek(0)
            others = b"".join(line for line in caught if _DRIVER_WARNING not in line)
        if others:
            os.write(2, others)
