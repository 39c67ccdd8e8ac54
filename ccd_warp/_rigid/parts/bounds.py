"""Where bodies on paths are in the middle of slices of the step, and how far their points go in them.

A point at an arm c of a body, whose origin moves at a speed |v| and that turns by ω, goes at most h (|v| + |ω| |c|)
from its place in the middle of a slice, h half of its duration, and as far beyond as points may be from the path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.rotations import EPS, cross, norms, products, quaternions_of, rotated

Array = NDArray[np.float64]

_UP = 1.0 + 1024.0 * EPS  # rounding of a bound itself
_ERROR = 256.0 * EPS  # of a path, its places and rotations, relative to all its lengths, and to its turn
_TIME_ERROR = 16.0 * EPS  # of the times of slices, which are 1 at most


class SweptBounds(NamedTuple):
    """Bodies in slices of the step; n slices of B bodies.

    Attributes:
        position: Places of their origins in the middle of each slice, shape [n, B, 3].
        rotation: Their unit quaternions, shape [n, B, 4].
        velocity: Velocities of their origins in the middle of each slice, in half of it, shape [n, B, 3].
        omega: Rotation vectors in half of it, shape [n, B, 3].
        reach: Shape [n, B, 6]: how far the origin of a body goes from the middle in half of the slice at most, and by
            how much rounding and the excess of the path may move any of its points; by how much it turns, in radians,
            and by how much rounding turns it. A point goes as far as the origin and the turn times the length of its
            arm. Then by how much the path of the origin bends from its velocity in the middle, and what an arm adds to
            that, times its length.
    """

    position: Array
    rotation: Array
    velocity: Array
    omega: Array
    reach: Array

    @classmethod
    def of(cls, paths: BodyPaths, t_begin: Array, t_end: Array) -> SweptBounds:
        """Bodies in slices of the step, each with as many paths, those of one slice after those of another.

        The origin of a body moves by no more than |velocity| + |turning| + |ω| |pivot| in all of the step, and the
        acceleration of a point is no more than |ω| |turning| + |ω|² times its distance from the pivot. Windows whose
        ends are off by a few units in the last place of 1 are covered.
        """
        n = len(t_begin)
        count = len(paths) // max(n, 1)
        middle = t_begin + 0.5 * (t_end - t_begin)
        half = np.maximum(middle - t_begin, t_end - middle) * (1.0 + 4.0 * EPS)
        t, half = np.repeat(middle, count), np.repeat(half, count)
        with np.errstate(all="ignore"):
            arms, rows = rotated(paths.rotation, -paths.pivot), np.arange(len(paths))
            turned = quaternions_of(paths.omega, t)
            around = rotated(turned, paths.turning) + cross(paths.omega, rotated(turned, arms))
            turn, arm, turning = norms(paths.omega), norms(paths.pivot), norms(paths.turning)
            speed = norms(paths.velocity) + turning + turn * arm
            size = 2.0 * norms(paths.pivot_t0) + 4.0 * (speed + arm)
            wrong, bends = _ERROR * (1.0 + turn), 0.5 * half * half
            reach = np.stack(
                [
                    half * speed,
                    wrong * (size + speed) + _TIME_ERROR * speed + paths.excess,
                    half * turn,
                    wrong * (1.0 + turn) + _TIME_ERROR * turn,
                    bends * turn * (turning + turn * arm),
                    bends * turn * turn,
                ],
                axis=1,
            )
            fields = (
                paths.pivot_t0 + arms + paths.displacements(arms, rows, t),
                products(turned, paths.rotation),
                half[:, None] * (paths.velocity + around),
                half[:, None] * paths.omega,
                reach * _UP,
            )
        return cls(*(x.reshape(n, count, -1) for x in fields))
