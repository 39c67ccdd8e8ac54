"""The files that are read: regular ones within a limit of size."""

import stat
from pathlib import Path

from ccd_warp._scene.input.messages import InputError

# A file that lies on the disk as it is may be larger than what an archive unpacks to: 1 GiB, or ``max_bytes`` if that
# is more. A sparse file takes no disk, and is as large as it claims once it is read.
PLAIN_BYTES = 1 << 30


def check_size(what: str, size: int, limit: int) -> None:
    """Refuse what takes more bytes than the limit."""
    if size > limit:
        raise InputError(
            f"{what} has {size:,} bytes, and the limit is {limit:,} bytes; raise it with --max-bytes (max_bytes= in "
            "Python) if you trust it"
        )


def check_file(path: Path, max_bytes: int) -> int:
    """The size of a regular file in bytes.

    Raises:
        InputError: If it is missing or too large, or no regular file: reading a pipe or a device might wait for ever.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: no such file; give a mesh file such as PLY, OBJ, STL, OFF or GLB") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: no such file but a folder, a pipe or a device; expected a regular file")
    check_size(f"{path}: it", found.st_size, max(max_bytes, PLAIN_BYTES))
    return found.st_size


def read_file(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file, whose size is checked before it is read."""
    size = check_file(path, max_bytes)
    try:
        with path.open("rb") as file:
            data = file.read(size + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if len(data) != size:
        raise InputError(f"{path}: holds other than the {size:,} bytes that it has; is it being written?")
    return data
