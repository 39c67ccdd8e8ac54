"""A parallel view that shows the whole motion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_array

# The automatic direction to the viewer: across the motion's larger horizontal axis, along it, and up.
_ACROSS, _ALONG, _UP = -1.0, -0.62, 0.58
_LEAST_HALF_SIDE = 0.05  # of the view, so that a motion straight towards the viewer does not fill the panel


@dataclass(frozen=True)
class Camera:
    """A parallel view.

    Attributes:
        position: Position of the viewer, shape [3].
        focus: Point in the middle of the view, shape [3].
        up: Upward direction, shape [3].
        parallel_scale: Half the visible height.
        size: Width and height in pixels.
    """

    position: NDArray[np.float64]
    focus: NDArray[np.float64]
    up: NDArray[np.float64]
    parallel_scale: float
    size: tuple[float, float]

    @property
    def pixel(self) -> float:
        """Length of a pixel."""
        return 2.0 * self.parallel_scale / self.size[1]


def make_camera(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    direction: ArrayLike | None,
    size: tuple[float, float],
    margins: tuple[float, float, float],
) -> Camera:
    """Fit the start and end positions into a panel.

    Args:
        start: Positions at t = 0, shape [V, 3].
        end: Positions at t = 1, shape [V, 3].
        direction: From the scene to the viewer, shape [3]; by default from the side of the motion, a little above it,
            or along z where everything stays in a plane across it.
        size: Width and height of the panel in pixels.
        margins: Pixels that stay free at the sides, above and below.

    Returns:
        The view; z is up, or y in a view along z.

    Raises:
        ValueError: If the direction is not valid.
    """
    viewer_direction = validated_direction(direction)
    towards = _direction_to_viewer(start, end) if viewer_direction is None else viewer_direction
    axis = np.array([0.0, 0.0, 1.0]) if np.hypot(*towards[:2]) > 1e-6 else np.array([0.0, 1.0, 0.0])
    right = np.cross(axis, towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    shown = np.concatenate([start, end]) @ np.column_stack([right, up])
    lower, upper = shown.min(axis=0), shown.max(axis=0)
    half = np.maximum(0.5 * (upper - lower), _LEAST_HALF_SIDE)
    side, above, below = margins
    available = np.maximum([size[0] - 2 * side, size[1] - above - below], 1)
    pixel = float((2.0 * half / available).max())
    middle = 0.5 * (lower + upper) + [0.0, 0.5 * (above - below) * pixel]
    focus = middle @ np.array([right, up])
    return Camera(focus + 10.0 * towards, focus, up, 0.5 * size[1] * pixel, size)


def _direction_to_viewer(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    if (start[:, 2] == start[0, 2]).all() and (end[:, 2] == start[0, 2]).all():
        return np.array([0.0, 0.0, 1.0])
    return automatic_direction(end - start)


def automatic_direction(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector to the viewer, across a motion of shape [n, 3]."""
    along_x, along_y, _ = np.abs(motion).max(axis=0)
    towards = np.array([_ALONG, _ACROSS, _UP] if along_x >= along_y else [_ACROSS, _ALONG, _UP])
    return towards / np.linalg.norm(towards)


def validated_direction(direction: ArrayLike | None) -> NDArray[np.float64] | None:
    """A unit vector if a direction is given, or a ValueError."""
    if direction is None:
        return None
    expected = "three finite numbers, not all 0"
    towards = as_array(direction, "camera", expected)
    is_valid = towards.shape == (3,) and towards.dtype.kind in "fiu"
    towards = towards.astype(np.float64) if is_valid else np.zeros(3)
    if not np.isfinite(towards).all() or not towards.any():
        raise ValueError(f"camera is {shown(direction)}; expected {expected}")
    towards = towards / np.abs(towards).max()
    return towards / np.linalg.norm(towards)
