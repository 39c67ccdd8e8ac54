"""The cull: inclusion tests over the whole step, which discard most candidates of a broad phase.

The first test is the hull of the volume (`volume`) in float64, on the corners without normalisation: about 90 flops, no
division, no branch. The bound is that of `rounding`, step 9, with sums of magnitudes where `volume` takes maxima.
Underflow is covered by an absolute term that grows with P, so the scales of the axes may differ arbitrarily. Where a
product of three lengths comes near overflow, or is so small that the absolute term exceeds it (lengths far below
2^-250), the test proves nothing and the pair is passed on to the solver, which normalises.

A pair in one plane has no volume. For it there is a second test, along the directions in that plane across each side:
no other directions are needed to separate two convex figures in a plane. Its bound is that of `rounding`, step 11.
"""

import warp as wp

from .patch import VERTEX_FACE
from .points import Corners
from .rounding import SIDES, UNIT_ROUNDOFF, VOLUME

_BOUND = wp.constant(wp.float64((VOLUME + 1.0) * UNIT_ROUNDOFF[wp.float64]))
_SEPARATION_UP = wp.constant(wp.float64(1.0 + 2.0**-48))
_GUARD = wp.constant(wp.float64(2.0**-800))
_LARGEST = wp.constant(wp.float64(2.0**750))
_SIDES = wp.constant(wp.float64(SIDES * UNIT_ROUNDOFF[wp.float64]))
_SIDES_UNDERFLOW = wp.constant(wp.float64(2.0**-1060))
_THIRD = wp.constant(wp.float64(1.0 / 3.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.func
def is_free_by_volume(c0: Corners, c1: Corners, separation: wp.float64, t_end: wp.float64) -> bool:
    """Whether the volume keeps its sign on [0, t_end], with a magnitude that excludes a contact."""
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
    # |n_k| of the normal at any time is at most n_k, so this bounds the sum of separation and rounding from above
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


@wp.func
def later(a: wp.float64, b: wp.float64, t_end: wp.float64) -> wp.float64:
    """A linear function at ``t_end`` from its values at 0 and 1."""
    if t_end < _ONE:
        return (_ONE - t_end) * a + t_end * b
    return b


@wp.func
def is_free_along(
    d: wp.vec3d, is_triangle: bool, c0: Corners, c1: Corners, size: wp.vec3d, separation: wp.float64, t_end: wp.float64
) -> bool:
    """Whether all corners stay on one side of the origin along d (rounding, step 11)."""
    a00 = wp.dot(d, c0.w00)
    a01 = wp.dot(d, c0.w01)
    a10 = wp.dot(d, c0.w10)
    a11 = a10
    b00 = later(a00, wp.dot(d, c1.w00), t_end)
    b01 = later(a01, wp.dot(d, c1.w01), t_end)
    b10 = later(a10, wp.dot(d, c1.w10), t_end)
    b11 = b10
    if not is_triangle:
        a11 = wp.dot(d, c0.w11)
        b11 = later(a11, wp.dot(d, c1.w11), t_end)
    length = wp.abs(d)
    bound = _SIDES * wp.dot(length, size) + separation * (length[0] + length[1] + length[2]) * _SEPARATION_UP
    bound += _SIDES_UNDERFLOW
    if not bound < _LARGEST:
        return False
    if a00 > bound:
        return (
            a01 > bound and a10 > bound and a11 > bound and b00 > bound and b01 > bound and b10 > bound and b11 > bound
        )
    bound = -bound
    if a00 < bound:
        return (
            a01 < bound and a10 < bound and a11 < bound and b00 < bound and b01 < bound and b10 < bound and b11 < bound
        )
    return False


@wp.func
def is_free_by_sides(kind: int, c0: Corners, c1: Corners, separation: wp.float64, t_end: wp.float64) -> bool:
    """Whether a direction across a side, in the plane of both sides at the start, separates the pair on [0, t_end]."""
    n = wp.cross(c0.q, c0.r)
    size = wp.max(wp.abs(c0.w00), wp.abs(c1.w00))
    size = wp.max(size, wp.max(wp.abs(c0.w01), wp.abs(c1.w01)))
    size = wp.max(size, wp.max(wp.abs(c0.w10), wp.abs(c1.w10)))
    size = wp.max(size, wp.max(wp.abs(c0.w11), wp.abs(c1.w11)))
    is_triangle = kind == VERTEX_FACE
    if is_free_along(wp.cross(n, c0.q), is_triangle, c0, c1, size, separation, t_end):
        return True
    if is_free_along(wp.cross(n, c0.r), is_triangle, c0, c1, size, separation, t_end):
        return True
    if is_triangle:
        return is_free_along(wp.cross(n, c0.q - c0.r), is_triangle, c0, c1, size, separation, t_end)
    return False


@wp.func
def is_free(kind: int, c0: Corners, c1: Corners, separation: wp.float64, t_end: wp.float64) -> bool:
    """Whether one of the tests proves that there is no contact on [0, t_end]."""
    if is_free_by_volume(c0, c1, separation, t_end):
        return True
    return is_free_by_sides(kind, c0, c1, separation, t_end)
