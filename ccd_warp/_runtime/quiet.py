"""Start Warp, and keep out of a user's output what Warp says because of this library.

Warp prints a banner when it starts and a line for each module that it loads. What it says of the user's own kernels is
the user's business; what it says while a function of ccd_warp is at work would appear in the output of a program that
may never have mentioned Warp. ``warp.config.log_level = warp.LOG_DEBUG`` shows everything.
"""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from ccd_warp._runtime import launch
from ccd_warp.kernels.once import building

_PACKAGE = __name__.partition(".")[0] + "."
_DRIVERS = {"linux": ("libcuda.so", "libcuda.so.1"), "win32": ("nvcuda.dll",)}
_DRIVER_WARNING = b"Could not find or load the NVIDIA CUDA driver"

_is_started = False


class _ForOthers:
    """Warp's own logger, without the information that a call of this library has caused."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.debug, self.error = logger.debug, logger.error

    def info(self, message: str) -> None:
        """Pass a banner, a module line or a time on, unless a function of this library is among the callers."""
        if wp.config.log_level <= wp.LOG_DEBUG or not _is_called_by_us():
            self._logger.info(message)

    def warning(self, message: str, category: Any = None, stacklevel: int = 1) -> None:
        """Pass a warning on; one more frame, this one, lies between it and its cause."""
        self._logger.warning(message, category, stacklevel + 1)


def _is_called_by_us() -> bool:
    frame = sys._getframe(2)
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if name.startswith(_PACKAGE) and name != __name__:
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def keep_warp_quiet() -> None:
    """Put the filter before Warp's own logger, or leave the logger that the user has set."""
    try:
        from warp._src.logger import LoggerBasic, get_logger  # Warp has no public name for what is set
    except ImportError:
        return
    logger = get_logger()
    if type(logger) is LoggerBasic:
        wp.set_logger(_ForOthers(logger))


def start_warp() -> None:
    """Initialise Warp, one thread at a time, without a warning where there is no CUDA driver."""
    global _is_started
    if _is_started:
        return
    with building:
        if _has_driver():
            launch.start_warp()
        else:
            with _without_driver_warning():
                launch.start_warp()
    _is_started = True


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
