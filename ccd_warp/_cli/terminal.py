"""The terminal of stderr, on which a command says what it does while native code is kept from writing there."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_closed: list[int] = []  # where stderr led before it was closed, the outermost first
_closing = threading.Lock()  # while a line is written, and while stderr is closed and opened


@contextmanager
def closed_stderr() -> Iterator[None]:
    """Drop what native code writes to stderr, as OpenGL and VTK do."""
    try:
        saved = os.dup(2)
    except OSError:  # the process has no stderr
        yield
        return
    try:
        with open(os.devnull, "wb") as null, _closing:
            _closed.append(saved)
            os.dup2(null.fileno(), 2)
        yield
    finally:
        with _closing:
            os.dup2(saved, 2)
            if saved in _closed:
                _closed.remove(saved)
            os.close(saved)


def has_terminal() -> bool:
    """Whether stderr is a terminal, where it is not closed."""
    if _closed:
        return os.isatty(_closed[0])
    return sys.stderr is not None and sys.stderr.isatty()


def write_to_terminal(text: str) -> None:
    """Write a text to stderr at once, also while it is closed to native code."""
    with _closing:
        if _closed:
            os.write(_closed[0], text.encode())
        else:
            sys.stderr.write(text)
            sys.stderr.flush()
