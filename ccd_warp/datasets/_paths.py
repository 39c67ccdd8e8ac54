"""Locations of the files of the public data, and the replacement of a file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ccd_warp._input.arguments import check_path

DEPTHS = ("", "*/", "*/*/")  # of the scenes: the folder itself, its children, their children


def root_folder(folder: str | Path) -> Path:
    """The absolute path of a folder, so that it has a name."""
    root = Path(os.path.abspath(check_path("folder", folder)))
    if not root.is_dir():
        raise ValueError(f"{folder} is not a folder; expected the public data, one of its parts or one of its scenes")
    return root


def scene_name(scene: Path, root: Path) -> str:
    """Name of a scene relative to the given folder, or of the scene's own folder if it is not inside that."""
    return scene.relative_to(root).as_posix() if root in scene.parents else scene.name


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path next to ``path`` that replaces it at the end; after an error ``path`` is unchanged."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
