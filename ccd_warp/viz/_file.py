"""Pictures: an image that a notebook shows, and its file."""

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.input.arguments import check_path


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A picture of a step. A notebook shows it, and it can stand for its file where a path is expected.

    Attributes:
        image: Red, green and blue of each pixel, from the top left, uint8, shape [height, width, 3].
        path: The file to which it was written; None if it was not.
    """

    image: NDArray[np.uint8]
    path: Path | None = None

    def save(self, path: str | Path) -> "Picture":
        """Write the picture to a file.

        Args:
            path: File to write, ``.png``.

        Returns:
            The picture, with this path.

        Raises:
            OSError: If the file cannot be written.
            ValueError: If the path is not as described.
        """
        path = check_path("path", path)
        check_picture_path(path, "path")
        self._as_pil().save(path, optimize=True)
        return Picture(self.image, path)

    def __fspath__(self) -> str:
        if self.path is None:
            raise ValueError("picture has no file; expected picture.save(path) before")
        return str(self.path)

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        return f"Picture({width} × {height} pixels{'' if self.path is None else f', {self.path}'})"

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self._as_pil().save(file, format="PNG", optimize=True)
        return file.getvalue()

    def _as_pil(self) -> Any:
        from PIL import Image

        return Image.fromarray(self.image)


def check_picture_path(path: Path, argument: str) -> None:
    """Reject a picture that cannot be written, before the computation.

    Raises:
        ValueError: If the name does not end in .png, or the folder does not exist or is not writable.
    """
    if path.suffix.lower() != ".png":
        raise ValueError(f"{argument} {path}: the name must end in .png")
    if not path.parent.is_dir():
        raise ValueError(f"{argument} {path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ValueError(f"{argument} {path}: cannot be written; choose another name or change its permissions")
