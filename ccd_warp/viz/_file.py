"""The file of a picture."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def check_picture_path(path: Path, argument: str) -> None:
    """Reject a file that cannot be written, before the computation.

    Raises:
        ValueError: If the name does not end in .png, or the folder does not exist or is not writable.
    """
    if path.suffix.lower() != ".png":
        raise ValueError(f"{argument} {path}: the name must end in .png")
    if not path.parent.is_dir():
        raise ValueError(f"{argument} {path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ValueError(f"{argument} {path}: cannot be written; choose another name or change its permissions")


def write_png(path: Path, image: NDArray[np.uint8], zoom: int) -> None:
    """Write an image of shape [zoom h, zoom w, 3]; each pixel of the file is the mean of zoom² pixels."""
    from PIL import Image

    height, width = (side // zoom for side in image.shape[:2])
    pixels = image.reshape(height, zoom, width, zoom, 3).mean(axis=(1, 3))
    Image.fromarray((pixels + 0.5).astype(np.uint8)).save(path, optimize=True)
