"""The files that are read: regular ones, because reading a pipe or a device might wait for ever."""

import contextlib
from pathlib import Path

from ccd_warp._scene.input.messages import InputError

_POINTER = b"version https://git-lfs.github.com/spec/"


def check_file(path: Path) -> None:
    """Refuse what is missing, no regular file, or a pointer of Git LFS in place of a file.

    Raises:
        InputError: If it is one of these.
    """
    if path.is_file():
        with contextlib.suppress(OSError), path.open("rb") as file:  # reading it says why it cannot be read
            if file.read(len(_POINTER)) == _POINTER:
                raise InputError(f"{path}: is a pointer of Git LFS and not the file; get that by: git lfs pull")
        return
    if path.exists():
        raise InputError(f"{path}: no such file but a folder, a pipe or a device; expected a regular file")
    raise InputError(f"{path}: no such file; give a mesh file such as PLY, OBJ, STL, OFF or GLB")


def read_file(path: Path) -> bytes:
    """The content of a regular file."""
    check_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def not_installed(package: str | None) -> InputError:
    """The error of a file whose reader is not installed."""
    return InputError(f"{package} reads it; install with: pip install 'ccd-warp[formats]'")
