"""The files that are read: regular ones within a limit of size, each noted by what tells whether it has changed."""

import contextlib
import stat
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

from ccd_warp._input.messages import InputError

# A file that lies on the disk as it is may be larger than what an archive unpacks to: 1 GiB, or ``max_bytes`` if that
# is more. A sparse file takes no disk, and is as large as it claims once it is read.
PLAIN_BYTES = 1 << 30
Stamp = tuple[str, int, int]

_noted: ContextVar[list[Stamp] | None] = ContextVar("noted", default=None)


@contextlib.contextmanager
def noted_files() -> Iterator[list[Stamp]]:
    """The stamps of all files that are read within, in a list that grows."""
    stamps: list[Stamp] = []
    outer = _noted.get()
    token = _noted.set(stamps)
    try:
        yield stamps
    finally:
        _noted.reset(token)
        if outer is not None:
            outer.extend(stamps)


def stamp(path: Path) -> Stamp:
    """What tells whether a file has changed: its place, its size in bytes, and when it was written.

    Raises:
        InputError: If it is missing, or no regular file: reading a pipe or a device might wait for ever.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: no such file; give a mesh file such as PLY, OBJ, STL, OFF or GLB") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: no such file but a folder, a pipe or a device; expected a regular file")
    return str(path.absolute()), found.st_size, found.st_mtime_ns


def note(path: Path) -> int:
    """Note a regular file that is about to be read, and return its size in bytes."""
    found = stamp(path)
    stamps = _noted.get()
    if stamps is not None:
        stamps.append(found)
    return found[1]


def check_size(what: str, size: int, limit: int) -> None:
    """Refuse what takes more bytes than the limit."""
    if size > limit:
        raise InputError(
            f"{what} has {size:,} bytes, and the limit is {limit:,} bytes; raise it with --max-bytes (max_bytes= in "
            "Python) if you trust it"
        )


def read_file(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file, whose size is checked before it is read."""
    size = note(path)
    check_size(f"{path}: it", size, max(max_bytes, PLAIN_BYTES))
    try:
        with path.open("rb") as file:
            data = file.read(size + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if len(data) != size:
        raise InputError(f"{path}: holds other than the {size:,} bytes that it has; is it being written?")
    return data
