"""Write a file beside its place and rename it, so that an earlier good one survives a full disk."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ccd_warp._input.messages import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path of the same ending to write to, which takes the place of ``path`` if all goes well, and is gone if not.

    What is no regular file, as a named pipe, is written to directly; of a link its target is replaced.

    Raises:
        InputError: If it cannot be written.
    """
    target = Path(os.path.realpath(path))
    is_special = target.exists() and not target.is_file()
    beside = target if is_special else target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        yield beside
        if not is_special:
            os.replace(beside, target)
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error})") from error
    finally:
        if not is_special:
            beside.unlink(missing_ok=True)
