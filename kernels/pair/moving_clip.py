"""Clipping with a moving direction: up to which time does it keep separating a patch?

The direction is linear in time, as are the corners, so its product with a corner is quadratic. On an interval [t, x]
the line from its first control point to the steepest of the others lies below it, and up to the root of that line the
direction separates (rounding, step 10). Where the whole interval is free, the next one is four times as long; where it
is not, twice as long as the part that was.
"""

from collections.abc import Callable
from typing import Any

import warp as wp

from ..parameters import real
from . import simd
from .patch import Corners, corners_at
from .rounding import CROSSING, MOVING, RELATIVE, TINY, TINY_DIRECTION, UNIT_ROUNDOFF
from .simd import (
    Lanes,
    Vec3,
    bits_of,
    dot,
    greatest,
    greatest_of,
    is_at_most,
    is_less,
    least,
    magnitude,
    mask_of,
    minus,
    opposite,
    select,
    spread,
)

unit = UNIT_ROUNDOFF[real]
zero = wp.constant(real(0.0))
half = wp.constant(real(0.5))
one = wp.constant(real(1.0))
two = wp.constant(real(2.0))
four = wp.constant(real(4.0))
moving = wp.constant(real(MOVING))
round_down = wp.constant(real(1.0 - RELATIVE * unit))
fraction_down = wp.constant(real(1.0 - CROSSING * unit))
tiny_direction = wp.constant(real(TINY_DIRECTION[real]))
underflow = wp.constant(real(TINY[real] * TINY_DIRECTION[real]))


@simd.func
def crossing(h0: Lanes, h1: Lanes, h2: Lanes) -> Lanes:
    """Fraction of an interval at which the steepest line from the first of three control points to another is zero.

    2 if none of them falls to zero, -1 if the first is not above it.
    """
    is_clear = is_less(zero, least(h1, h2))
    fraction = h0 / greatest(two * (h0 - h1), h0 - h2)
    return select(is_less(zero, h0), select(is_clear, two, fraction), minus(spread(one)))


@simd.func
def corner_crossing(sign: Lanes, d_t: Vec3, d_x: Vec3, o_t: Lanes, o_x: Lanes, w_t: Vec3, w_x: Vec3) -> Lanes:
    """The `crossing` of one corner: of its projection on a moving direction, less the offsets."""
    h0 = sign * dot(d_t, w_t) - o_t
    h1 = half * (sign * (dot(d_t, w_x) + dot(d_x, w_t))) - half * (o_t + o_x)
    return crossing(h0, h1, sign * dot(d_x, w_x) - o_x)


def clip_along(Which: Any, direction: Callable, offset: Callable) -> Any:
    """The clip for a family of directions.

    Args:
        Which: Type of what tells the directions of a family from each other.
        direction: That direction at given corners, for each lane.
        offset: Upper bound of rounding errors and separation along a direction.
    """

    @simd.func
    def clip(
        t0: Corners, t1: Corners, separation: Vec3, error: Vec3, which: Which, t_start: Lanes, end: Lanes, steps: int
    ) -> Lanes:
        """Time up to which the direction separates (rounding, steps 10 and 13): at least t_start; 2 if beyond ``end``.

        t0 and t1 are the corners at both ends of the step.
        """
        margin = moving * error
        t = t_start
        x = end
        c_t = corners_at(t0, t1, t)
        d_t = direction(which, c_t)
        sign = select(is_less(dot(d_t, c_t.w00), zero), minus(spread(one)), one)
        free = mask_of(wp.uint32(0))
        running = opposite(free)
        for _ in range(steps):
            c_x = corners_at(t0, t1, x)
            d_x = direction(which, c_x)
            o_t = offset(d_t, margin, separation) + underflow
            o_x = offset(d_x, margin, separation) + underflow
            fraction = corner_crossing(sign, d_t, d_x, o_t, o_x, c_t.w00, c_x.w00)
            fraction = least(fraction, corner_crossing(sign, d_t, d_x, o_t, o_x, c_t.w01, c_x.w01))
            fraction = least(fraction, corner_crossing(sign, d_t, d_x, o_t, o_x, c_t.w10, c_x.w10))
            fraction = least(fraction, corner_crossing(sign, d_t, d_x, o_t, o_x, c_t.w11, c_x.w11))
            m_t = magnitude(d_t)
            can_prove = is_at_most(tiny_direction, greatest_of(m_t))
            running = running & can_prove & is_less(zero, fraction)
            is_clear = is_less(one, fraction)
            free = free | (running & is_clear & is_at_most(end, x))
            s = (t + (x - t) * (fraction * fraction_down)) * round_down
            s = select(is_clear, x, s)
            running = running & is_less(t, s)
            s = select(running, s, t)
            step = s - t
            x = select(running, least(end, s + select(is_clear, four * step, step + step)), x)
            t = s
            running = running & opposite(free)
            if bits_of(running) == wp.uint32(0):
                break
            c_t = corners_at(t0, t1, t)
            d_t = direction(which, c_t)
        return select(free, two, t)

    return clip
