"""The cull: one inclusion test over the whole step, on which most candidates of a broad phase end.

It is the volume's hull (`volume`) in float64 on the corners as they are, without normalisation: about 90 flops, no
division, no branch. The bound is that of `rounding`, step 9, with sums of magnitudes where `volume` takes maxima.
Underflow is covered by an absolute term that grows with P, so axes may differ in scale as they like; where a product of
three lengths comes near overflow, or is so small that the absolute term hides it (lengths far below 2^-250), the test
proves nothing and the pair goes on to the solver, which normalises.
"""

import warp as wp

from .points import Corners
from .rounding import UNIT_ROUNDOFF, VOLUME

_BOUND = wp.constant(wp.float64((VOLUME + 1.0) * UNIT_ROUNDOFF[wp.float64]))
_SEPARATION_UP = wp.constant(wp.float64(1.0 + 2.0**-48))
_GUARD = wp.constant(wp.float64(2.0**-800))
_LARGEST = wp.constant(wp.float64(2.0**750))
_THIRD = wp.constant(wp.float64(1.0 / 3.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.func
def is_free_by_volume(c0: Corners, c1: Corners, separation: wp.float64, t_end: wp.float64) -> bool:
    """Whether the volume keeps its sign on [0, t_end], farther from 0 than any contact could bring it."""
    n0 = wp.cross(c0.q, c0.r)
    n1 = wp.cross(c1.q, c1.r)
    nm = wp.cross(c0.q, c1.r) + wp.cross(c1.q, c0.r)  # twice the middle coefficient of Q×R
    b0 = wp.dot(c0.w00, n0)
    b1 = _THIRD * (wp.dot(c1.w00, n0) + wp.dot(c0.w00, nm))
    b2 = _THIRD * (wp.dot(c0.w00, n1) + wp.dot(c1.w00, nm))
    b3 = wp.dot(c1.w00, n1)
    p = wp.abs(c0.w00) + wp.abs(c1.w00)
    q = wp.abs(c0.q) + wp.abs(c1.q)
    r = wp.abs(c0.r) + wp.abs(c1.r)
    n = wp.vec3d(q[1] * r[2] + q[2] * r[1], q[2] * r[0] + q[0] * r[2], q[0] * r[1] + q[1] * r[0])
    size = wp.dot(p, n)
    # |n_k| of the normal at any time is at most n_k, so this is above the sum of separation and rounding
    bound = _BOUND * size + separation * (n[0] + n[1] + n[2]) * _SEPARATION_UP
    # an underflow in Q×R is multiplied by P and by the separation
    bound += _GUARD * (_ONE + p[0] + p[1] + p[2] + separation)
    if not (size < _LARGEST and bound < _LARGEST):
        return False
    if t_end < _ONE:
        # the blossom on [0, t_end]
        s = _ONE - t_end
        t0 = s * b0 + t_end * b1
        t1 = s * b1 + t_end * b2
        t2 = s * b2 + t_end * b3
        b1 = t0
        b2 = s * t0 + t_end * t1
        b3 = s * b2 + t_end * (s * t1 + t_end * t2)
    if b0 > bound:
        return b1 > bound and b2 > bound and b3 > bound
    return b0 < -bound and b1 < -bound and b2 < -bound and b3 < -bound
