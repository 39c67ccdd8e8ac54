"""One precompiled header of Warp for all threads that compile for this library.

Warp makes a header for each thread on the CPU, which takes two seconds, as long as two small modules. In one folder it
serves all: Warp writes it under another name first, so no thread finds half of it.
"""

import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# What Warp calls a header that it has not finished yet, and how soon after the beginning that file is there.
_UNFINISHED = "*.tmp"
_BEGINS_WITHIN = 0.2
# Nobody waits longer than this, in seconds; who has waited in vain makes a header of its own.
_LONGEST_WAIT = 30.0
_PAUSE = 0.01
_TRIES = 3

_of_thread = threading.local()
_lock = threading.Lock()
_folders: set[str] = set()


@contextmanager
def one_header() -> Iterator[None]:
    """Where this thread compiles a module, have it take the header of the first thread that did."""
    _share()
    _of_thread.shares = True
    try:
        yield
    finally:
        _of_thread.shares = False


def remove_headers() -> None:
    """Remove the folders of all headers, before a process ends at once: Python would at its usual end.

    Threads that still compile get none from now on, and wait.
    """
    if _lock.acquire(timeout=_LONGEST_WAIT):
        for folder in _folders:
            for _ in range(_TRIES):  # a compiler may be writing into it
                shutil.rmtree(folder, ignore_errors=True)


def _share() -> None:
    """Let Warp ask here for the folder of the header; where it has no such question any more, nothing changes."""
    try:
        from warp._src import context  # Warp has no public name for what is asked
    except ImportError:
        return
    runtime: Any = getattr(context, "runtime", None)
    with _lock:
        folder_of_thread = getattr(runtime, "get_clang_pch_dir", None)
        if folder_of_thread is not None and not isinstance(folder_of_thread, _Shared):
            runtime.get_clang_pch_dir = _Shared(folder_of_thread)


class _Shared:
    """The folder of the header: for threads in :func:`one_header` that of the first, and for others Warp's own."""

    def __init__(self, folder_of_thread: Callable[[], Any]) -> None:
        self._folder_of_thread = folder_of_thread
        self._folder: str | None = None
        self._since = 0.0

    def __call__(self) -> Any:
        with _lock:
            if not getattr(_of_thread, "shares", False):
                return self._new()
            if self._folder is None or not os.path.isdir(self._folder):
                self._folder, self._since = self._new(), time.monotonic()
                return self._folder
            folder, since = self._folder, self._since
        end = time.monotonic() + _LONGEST_WAIT
        while self._is_begun(folder, since):
            if time.monotonic() > end:
                with _lock:
                    self._folder = None
                    return self._new()
            time.sleep(_PAUSE)
        return folder

    def _new(self) -> Any:
        folder = self._folder_of_thread()
        if folder is not None:
            _folders.add(folder)
        return folder

    @staticmethod
    def _is_begun(folder: str, since: float) -> bool:
        return time.monotonic() < since + _BEGINS_WITHIN or any(Path(folder).glob(_UNFINISHED))
