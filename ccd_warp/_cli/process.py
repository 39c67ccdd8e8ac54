"""The process of the command line: its streams, what others write to them, and Ctrl-C."""

import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from ccd_warp._input.messages import printable
from ccd_warp._input.options import resolve_device

INTERRUPTED = 130  # the status of a command that Ctrl-C has ended


def say(line: str) -> None:
    """Print a line on stderr, where there is one; ``print`` would take stdout where there is none."""
    if sys.stderr is not None:
        print(line, file=sys.stderr, flush=True)


def warn(line: str) -> None:
    """Print a warning of one line."""
    say(f"ccd-warp: warning: {printable(line)}")


def start_quietly(device: str | None) -> None:
    """Start Warp without its banner, and keep compile messages and trimesh's log off the terminal.

    Args:
        device: The device asked for.

    Raises:
        ValueError: If there is no such device.
    """
    wp.config.log_level = wp.LOG_ERROR
    with closed_stderr(), _heeded_interrupts():
        import trimesh  # noqa: F401

        wp.init()
        resolve_device(device)
    logger = logging.getLogger("trimesh")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False


@contextmanager
def _heeded_interrupts() -> Iterator[None]:
    """Raise Ctrl-C again where the work inside has caught it, as trimesh catches whatever its imports raise."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught = []
    before = signal.getsignal(signal.SIGINT)

    def heed(number: int, frame: Any) -> None:
        caught.append(number)
        if callable(before):
            before(number, frame)

    if callable(before):  # else it is ignored, as in a job in the background
        signal.signal(signal.SIGINT, heed)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if caught:
        raise KeyboardInterrupt


@contextmanager
def closed_stderr() -> Iterator[None]:
    """Drop what native code writes to stderr: without a CUDA driver Warp complains there, whatever its log level."""
    try:
        saved = os.dup(2)
    except OSError:  # the process has no stderr
        yield
        return
    try:
        with open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


@contextmanager
def notice(message: str, *, seconds: float, is_quiet: bool) -> Iterator[None]:
    """Say ``message`` on a terminal's stderr if the work inside takes longer than ``seconds``."""
    if is_quiet or sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    timer = threading.Timer(seconds, lambda: say(message))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def warnings_on_stderr(before: Callable[[], None], *, is_quiet: bool) -> Iterator[None]:
    """Print what the library warns of as one line each, after a call of ``before``, which clears the line there."""

    def show(message: Any, *_: Any, **__: Any) -> None:
        if not is_quiet:
            before()
            warn(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield
