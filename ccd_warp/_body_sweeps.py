"""Where bodies on paths are in the middle of windows of slices of the step, and how far their points go in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ccd_warp._joint_bounds import Window
from ccd_warp._joint_courses import EPS
from ccd_warp._joint_sweeps import Sweeps, slack
from ccd_warp._rotations import cross, norms, products, quaternions_of, rotated

if TYPE_CHECKING:
    from ccd_warp._body_paths import BodyPaths

_UP = 1.0 + 1024.0 * EPS  # rounding of a bound itself
_ERROR = 256.0 * EPS  # of a path, its places and rotations, relative to all its lengths, and to its turn


class BodySweeps:
    """Bodies in slices of the step, those of one slice after those of another."""

    def __init__(self, paths: BodyPaths, num_slices: int) -> None:
        self._paths, self._shape = paths, (num_slices, len(paths) // max(num_slices, 1))

    def _sweeps(
        self,
        t_begin: NDArray[np.float64],
        t_end: NDArray[np.float64],
        middles: NDArray[np.float64],
        pairs: NDArray[np.intp],
    ) -> Sweeps:
        """Bodies against the world; nothing else is known of pairs of them.

        The origin of a body moves by no more than |velocity| + |turning| + |ω| |pivot| in all of the step, and the
        acceleration of a point is no more than |ω| |turning| + |ω|² times its distance from the pivot.
        """
        paths, (n, count) = self._paths, self._shape
        window = Window.of(t_begin, t_end)
        duration, off = (np.repeat(x, count) for x in (window.duration, slack(window)))
        half = np.repeat(window.half, count) * duration
        fields = [np.empty((n, len(middles), count, size)) for size in (3, 4, 3, 3)]
        with np.errstate(all="ignore"):
            arms, rows = rotated(paths.rotation, -paths.pivot), np.arange(len(paths))
            for k, middle in enumerate(middles):
                t = np.repeat(middle, count)
                turn = quaternions_of(paths.omega, t)
                around = rotated(turn, paths.turning) + cross(paths.omega, rotated(turn, arms))
                values = (
                    paths.pivot_t0 + arms + paths.displacements(arms, rows, t),
                    products(turn, paths.rotation),
                    half[:, None] * (paths.velocity + around),
                    half[:, None] * paths.omega,
                )
                for field, own in zip(fields, values, strict=True):
                    field[:, k] = own.reshape(n, count, -1)
            turn, arm, turning = norms(paths.omega), norms(paths.pivot), norms(paths.turning)
            speed = norms(paths.velocity) + turning + turn * arm
            size = 2.0 * norms(paths.pivot_t0) + 4.0 * (speed + arm)
            wrong, off = _ERROR * (1.0 + turn), off * duration
            bends = 0.5 * half * half
            reach = np.stack(
                [
                    half * speed,
                    wrong * (size + speed) + off * speed,
                    half * turn,
                    wrong * (1.0 + turn) + off * turn,
                    bends * turn * (turning + turn * arm),
                    bends * turn * turn,
                ],
                axis=1,
            )
            reach = (reach * _UP).reshape(n, count, 6)
        position, rotation, velocity, omega = fields
        return Sweeps(position, rotation, velocity, omega, reach, np.zeros((n, 0, 6)))
