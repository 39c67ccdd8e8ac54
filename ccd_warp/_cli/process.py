"""The process of the command line: its streams, what others write to them, and Ctrl-C."""

import codecs
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

import warp as wp

from ccd_warp._input.messages import InputError, printable
from ccd_warp._input.options import resolve_device
from ccd_warp._runtime.launch import start_warp
from ccd_warp._runtime.terminal import closed_stderr

FAILED = 3  # the status of a fault of the command itself, with a traceback
INTERRUPTED = 130  # the status of a command that Ctrl-C has ended
_SPELLING = "ccd_warp.spelled"  # how streams write what their encoding lacks
_SPELLED = {"…": "...", "×": "x", "²": "^2", "→": "->", "−": "-", "–": "-", "’": "'", "µ": "u"}


def say(line: str) -> None:
    """Print a line on stderr, where there is one; ``print`` would take stdout where there is none."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(line, file=sys.stderr, flush=True)


def check_standard_output() -> None:
    """Refuse ``--output -`` where the process was started without a standard output."""
    if sys.stdout is None:
        raise InputError("--output -: there is no standard output; give a file, or do not close it")


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """What stands for characters that a terminal does not know: an ellipsis is three dots, most are escaped."""
    assert isinstance(error, UnicodeEncodeError)
    letters = error.object[error.start : error.end]
    return "".join(_SPELLED.get(c) or c.encode("unicode_escape").decode() for c in letters), error.end


codecs.register_error(_SPELLING, _spelled)


@contextmanager
def spelled_streams() -> Iterator[None]:
    """Spell in both streams what their encoding lacks, as ASCII does an ellipsis; Python would raise an error."""
    with ExitStack() as stack:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                stack.callback(stream.reconfigure, errors=stream.errors)
                stream.reconfigure(errors=_SPELLING)
        yield


class _StandardOutput:
    """Standard output that stays silent once its reader has gone, so that the command ends with its own status."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or drop it where nobody reads it."""
        with self._heeding():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered, or drop it where nobody reads it."""
        with self._heeding():
            self._stream.flush()

    @contextmanager
    def _heeding(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # what is still buffered must go somewhere: Python would fail again when it flushes at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if not isinstance(error, BrokenPipeError):
                raise InputError(f"cannot write to standard output ({error.strerror or error})") from error


@contextmanager
def standard_output() -> Iterator[None]:
    """Standard output as :class:`_StandardOutput`, written completely when the work inside is done."""
    stream = sys.stdout
    if stream is None:
        yield
        return
    sys.stdout = _StandardOutput(stream)  # type: ignore[assignment]
    try:
        yield
    finally:
        try:
            sys.stdout.flush()
        finally:
            sys.stdout = stream


def report_on(output: Path | None) -> TextIO:
    """Where the report goes: to stderr where standard output belongs to the result; nowhere if that is closed."""
    stream = sys.stderr if output == Path("-") else sys.stdout
    return stream if stream is not None else open(os.devnull, "w")


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

        start_warp()
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
def warnings_on_stderr(before: Callable[[], None] = lambda: None, *, is_quiet: bool) -> Iterator[None]:
    """Print what the library warns of as one line each, after a call of ``before``, which clears the line there."""

    def show(message: Any, *_: Any, **__: Any) -> None:
        if not is_quiet:
            before()
            warn(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield
