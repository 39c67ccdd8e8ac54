"""The inclusion test: at which times a patch is certainly free of contact.

A patch is the convex hull of four corners that move linearly. For any vector d the minimum of d·W over the patch is
attained at a corner, so the test is exact up to the rounding bound of `rounding`, for every d. Solved for t instead of
evaluated on a box, the test becomes a clip: it gives the whole time interval in which d separates the patch from the
origin.
"""

import warp as wp

from ..parameters import real
from . import simd
from .patch import Corners
from .rounding import RELATIVE, TINY_DIRECTION, UNIT_ROUNDOFF
from .simd import Lanes, Vec3, dot, greatest_of, is_at_most, is_less, least, magnitude, opposite, select

minus_one = wp.constant(real(-1.0))
two = wp.constant(real(2.0))
round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
tiny_direction = wp.constant(real(TINY_DIRECTION[real]))


@simd.func
def offset(d: Vec3, margin: Vec3) -> Lanes:
    """Upper bound of the exact Σ|d_k|·margin_k (rounding, step 6); the margin is E + separation."""
    return dot(magnitude(d), margin) * round_up


@simd.func
def clip_corner(a: Lanes, b: Lanes, off: Lanes, t: Lanes) -> Lanes:
    """Time up to which one corner stays beyond ``off``, 2 if until the end; -1 if it is not beyond it at ``t``.

    a and b are d·W at t = 0 and t = 1 (rounding, step 7). The quotient of those that leave is also that of those
    that enter.
    """
    is_beyond_t0 = is_less(off, a)
    is_beyond_t1 = is_less(off, b)
    crossing = (a - off) / (a - b)
    has_entered = is_less(crossing * round_up, t)
    stays = is_beyond_t1 & (is_beyond_t0 | has_entered)
    leaves = is_beyond_t0 & opposite(is_beyond_t1)
    s = select(leaves, least(two, crossing * round_down), minus_one)
    return select(stays, two, s)


@simd.func
def clip_beyond(d: Vec3, off: Lanes, t: Lanes, t0: Corners, t1: Corners, is_triangle: bool) -> Lanes:
    """Time s >= t such that d·W stays above ``off`` on [t, s), which proves it free; 2 if it does to the end.

    ``off`` bounds the rounding errors and the separation along d, together; t0 and t1 are the corners at both ends.
    """
    s = clip_corner(dot(d, t0.w00), dot(d, t1.w00), off, t)
    s = least(s, clip_corner(dot(d, t0.w01), dot(d, t1.w01), off, t))
    s = least(s, clip_corner(dot(d, t0.w10), dot(d, t1.w10), off, t))
    if not is_triangle:
        s = least(s, clip_corner(dot(d, t0.w11), dot(d, t1.w11), off, t))
    m = magnitude(d)
    can_prove = is_at_most(tiny_direction, greatest_of(m))
    return select(can_prove & is_less(t, s), s, t)


@simd.func
def clip(d: Vec3, margin: Vec3, t: Lanes, t0: Corners, t1: Corners, is_triangle: bool) -> Lanes:
    """Time s >= t such that d separates the patch from the separation box on [t, s); 2 if it does until the end.

    t0 and t1 are the corners at both ends of the step.
    """
    return clip_beyond(d, offset(d, margin), t, t0, t1, is_triangle)
