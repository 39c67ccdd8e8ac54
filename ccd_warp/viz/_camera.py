"""The direction from which a step is seen."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_array

# The automatic direction to the viewer: across the motion's larger horizontal axis, along it, and up.
_ACROSS, _ALONG, _UP = -1.0, -0.62, 0.58


def direction_to_viewer(
    start: NDArray[np.float64], end: NDArray[np.float64], direction: ArrayLike | None
) -> NDArray[np.float64]:
    """Unit vector from a scene to its viewer, shape [3].

    Args:
        start: Positions at t = 0, shape [V, 3].
        end: Positions at t = 1, shape [V, 3].
        direction: Direction that is given; by default from the side of the motion, a little above it, or along z where
            everything stays in a plane across it.

    Raises:
        ValueError: If the direction is not valid.
    """
    if direction is not None:
        return _validated(direction)
    if (start[:, 2] == start[0, 2]).all() and (end[:, 2] == start[0, 2]).all():
        return np.array([0.0, 0.0, 1.0])
    along_x, along_y, _ = np.abs(end - start).max(axis=0)
    towards = np.array([_ALONG, _ACROSS, _UP] if along_x >= along_y else [_ACROSS, _ALONG, _UP])
    return towards / np.linalg.norm(towards)


def _validated(direction: ArrayLike) -> NDArray[np.float64]:
    """The unit vector of a direction, or a ValueError."""
    expected = "three finite numbers, not all 0"
    towards = as_array(direction, "camera", expected)
    is_valid = towards.shape == (3,) and towards.dtype.kind in "fiu"
    towards = towards.astype(np.float64) if is_valid else np.zeros(3)
    if not np.isfinite(towards).all() or not towards.any():
        raise ValueError(f"camera is {shown(direction)}; expected {expected}")
    towards = towards / np.abs(towards).max()
    return towards / np.linalg.norm(towards)
