"""The process of the command line: its streams, and what others write to them."""

import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import warp as wp

from ccd_warp._runtime.quiet import start_warp
from ccd_warp._scene.input.messages import InputError, printable
from ccd_warp._scene.input.options import resolve_device

STDOUT = Path("-")
FAILED = 3  # the status of a fault of the command itself, with a traceback
INTERRUPTED = 130  # the status of a command that Ctrl-C has ended


def say(line: str) -> None:
    """Print a line on stderr, where there is one; ``print`` would take stdout where there is none."""
    if sys.stderr is not None:
        print(line, file=sys.stderr, flush=True)


def warn(line: str) -> None:
    """Print a warning of one line."""
    say(f"ccd-warp: warning: {printable(line)}")


def write_out(text: str, stream: TextIO, name: Path | str = "standard output") -> None:
    """Write a text at once; a reader who has gone, as that of a pipe to ``head``, changes nothing.

    Raises:
        InputError: If it cannot be written, as on a full disk.
    """
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        # what is still buffered must go somewhere: Python would fail again when it flushes at the end
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if not isinstance(error, BrokenPipeError):
            raise InputError(f"cannot write to {name} ({error.strerror or error})") from error


def teller(output: Path | None, *, is_quiet: bool) -> Callable[[str], None]:
    """What prints the report: to stderr where standard output takes the result, and nothing where it is quiet."""
    if is_quiet:
        return lambda text: None
    return lambda text: write_out(f"{text}\n", sys.stderr if output == STDOUT else sys.stdout)


def check_output(path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse a file of results that cannot be written, before the computation."""
    if path is None or path == STDOUT:
        return
    if path.suffix.lower() not in suffixes:
        raise InputError(f"--output {path}: the name must end in {' or '.join(suffixes)}, or be - alone")
    if not path.parent.is_dir():
        raise InputError(f"--output {path}: the folder {path.parent} does not exist; create it first")


def make_folder(folder: Path, option: str) -> None:
    """Make a folder to write to, if it does not exist; none with the name of a file of results."""
    if folder.suffix.lower() in (".csv", ".json", ".npz", ".png") and not folder.is_dir():
        raise InputError(f"{option} {folder}: expected the name of a folder, found that of a file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option} {folder}: cannot create it ({error.strerror or error})") from error


def start_quietly(device: str | None, *, needs_cache: bool = True) -> None:
    """Start Warp without its banner, and keep compile messages and trimesh's log off the terminal.

    Raises:
        ValueError: If there is no such device.
        OSError: If kernels have to be compiled and the cache cannot be written, unless none is needed.
    """
    wp.config.log_level = wp.LOG_ERROR
    import trimesh  # noqa: F401  # so that the time to read files is not that of this import

    start_warp(needs_cache=needs_cache)
    resolve_device(device)
    logger = logging.getLogger("trimesh")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False


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
