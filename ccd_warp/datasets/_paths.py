"""Where the files of the public data lie, and how one of them is replaced."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ccd_warp._input.arguments import check_path

DEPTHS = ("", "*/", "*/*/")  # of the scenes: the folder itself, its children, theirs


def root_folder(folder: str | Path) -> Path:
    """The folder without dots, so that it has a name."""
    root = Path(os.path.abspath(check_path("folder", folder)))
    if not root.is_dir():
        raise ValueError(f"{folder} is not a folder; expected the public data, one of its parts or one of its scenes")
    return root


def scene_name(scene: Path, root: Path) -> str:
    """Name of a scene relative to the folder that was given; that of its own folder where that is no part of it."""
    return scene.relative_to(root).as_posix() if root in scene.parents else scene.name


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to beside ``path``, which it replaces at the end; after an error ``path`` is as it was."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
