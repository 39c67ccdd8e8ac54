"""When the points of a pair on arcs seem to meet: Newton's iteration on the distance of the pair, from where it is.

Nothing here carries a guarantee: the time is only a good end for a window (`lane_windows`), in which whatever is
claimed is proved.
"""

import warp as wp

from ..pair_kind import VERTEX_FACE
from ..parameters import norm, width
from ..template import specialised
from .arcs import Arcs, points_at, velocities_at
from .points import Points, corners

simd = specialised("pair.simd", width=width)
closest = specialised("pair.lane_closest", real=wp.float64, width=width).closest
support = specialised("pair.support", real=wp.float64, width=width, norm=norm).support
Lanes = simd.Lanes

# Steps after which a pair that has not been seen to meet counts as one that does not.
_STEPS = wp.constant(5)
_NONE = wp.constant(wp.uint32(0))
zero = wp.constant(wp.float64(0.0))
two = wp.constant(wp.float64(2.0))
# A step of the iteration, as part of the slice, after which the next is below rounding.
last_step = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Meeting:
    """When a pair seems to meet, as a time of the slice, 2 if it does not; and how fast it approaches then."""

    t: Lanes
    speed: Lanes
    gap: Lanes  # how far apart the pair is to begin with, beyond its separation


@simd.func
def meeting(kind: int, a: Points, b: Points, arcs: Arcs, separation: Lanes, begin: Lanes, lanes: wp.uint32) -> Meeting:
    """The time from ``begin`` on at which a pair seems to come within its separation."""
    r = Meeting()
    r.t = begin
    box = simd.vec(separation, separation, separation)
    open = lanes
    steps = int(0)
    while open != _NONE and steps < _STEPS:
        c = corners(kind, points_at(kind, a, b, arcs, r.t))
        v = corners(kind, velocities_at(kind, a, b, arcs, r.t))
        near = closest(c, kind == VERTEX_FACE)
        velocity = v.w00 + near.v * (v.w01 - v.w00) + near.u * (v.w10 - v.w00)
        gap = simd.dot(near.d, near.point) - support(box, near.d)
        speed = simd.minus(simd.dot(near.d, velocity))
        is_open = simd.mask_of(open)
        step = gap / speed
        t = simd.greatest(r.t + step, begin)
        length = simd.square_root(simd.dot(near.d, near.d))
        if steps == 0:
            r.gap = gap / length
            t = simd.select(simd.is_less(zero, speed), t, simd.spread(two))
        t = simd.least(t, two)
        r.speed = simd.select(is_open, speed / length, r.speed)
        r.t = simd.select(is_open, t, r.t)
        open = open & simd.bits_of(simd.is_less(last_step, simd.magnitude(step)) & simd.is_less(r.t, two))
        steps += 1
    r.t = simd.select(simd.mask_of(open), two, r.t)
    return r
