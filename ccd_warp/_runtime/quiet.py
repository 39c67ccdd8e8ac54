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


def start_warp() -> None:
    """Initialise Warp, one thread at a time, without a warning where there is no CUDA driver."""
    global _is_started
    if _is_started:
        return
    try:
        with building, quietly(), nullcontext() if _has_driver() else _without_driver_warning():
            _init()
    except OSError as error:
        raise OSError(unwritable_cache(error.filename or wp.config.kernel_cache_dir, error)) from error
    _is_started = True


def _init() -> None:
    """Initialise Warp, with an empty cache of its own where it can have no other and the package brings its kernels."""
    try:
        wp.init()
    except OSError:
        if not has_any():
            raise
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
