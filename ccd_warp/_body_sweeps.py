"""Where bodies on paths are in the middle of slices of the step, and how far their points go from there in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ccd_warp._joint_courses import EPS
from ccd_warp._joint_sweeps import Sweeps
from ccd_warp._rotations import norms, products, quaternions_of, rotated

if TYPE_CHECKING:
    from ccd_warp._body_paths import BodyPaths

_UP = 1.0 + 1024.0 * EPS  # rounding of a bound itself
_ERROR = 256.0 * EPS  # of a path, its places and rotations, relative to all its lengths, and to its turn


class BodySweeps:
    """Bodies in slices of the step, those of one slice after those of another."""

    def __init__(self, paths: BodyPaths, num_slices: int) -> None:
        self._paths, self._shape = paths, (num_slices, len(paths) // max(num_slices, 1))
        self._found: Sweeps | None = None  # of the last slices

    def _sweeps(self, t_begin: NDArray[np.float64], t_end: NDArray[np.float64]) -> Sweeps:
        """Bodies against the world.

        The origin of a body moves by no more than |velocity| + |turning| + |ω| |pivot| in all of the step.
        """
        paths = self._paths
        begin, end = (np.repeat(t, self._shape[1]) for t in (t_begin, t_end))
        middle, half = 0.5 * begin + 0.5 * end, (0.5 * end - 0.5 * begin) * _UP
        with np.errstate(all="ignore"):
            arms = rotated(paths.rotation, -paths.pivot)
            position = paths.pivot_t0 + arms + paths.displacements(arms, np.arange(len(paths)), middle)
            rotation = products(quaternions_of(paths.omega, middle), paths.rotation)
            turn, arm = norms(paths.omega), norms(paths.pivot)
            speed = norms(paths.velocity) + norms(paths.turning) + turn * arm
            size = norms(paths.pivot_t0) + norms(position) + speed + arm
            moved = (half * speed + _ERROR * (1.0 + turn) * size) * _UP
            turned = (half * turn + _ERROR * (1.0 + turn)) * _UP
        n, count = self._shape
        self._found = Sweeps(
            position.reshape(n, count, 3).transpose(1, 2, 0),
            rotation.reshape(n, count, 4).transpose(1, 2, 0),
            moved.reshape(n, count).T,
            turned.reshape(n, count).T,
        )
        return self._found

    def _relative_sweeps(
        self, pairs: list[tuple[int, int]], t_begin: NDArray[np.float64], t_end: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Pairs of bodies against each other: each goes as far as against the world, as has mostly been computed."""
        found = self._found or self._sweeps(t_begin, t_end)
        first, second = (np.array([pair[k] for pair in pairs], dtype=np.intp) for k in (0, 1))
        return found.moved[first] + found.moved[second], found.turned[first], found.turned[second]
