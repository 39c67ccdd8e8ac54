"""A lower bound of the distance of a pair at one time in the maximum norm.

A direction d bounds the distance of the patch by least d·W / Σ|d_k|, and the best direction is one of the facets of
`facets`: an axis, a side crossed with an axis, or the normal.
"""

import warp as wp

from ..pair.lane_scale import to_unit_size
from ..pair.rounding import LARGEST, PROJECTION_ROOT, RELATIVE, TINY, UNIT_ROUNDOFF, inverse_power_of_two
from ..pair.single_points import Points, corners, largest, scaled, total
from ..pair_kind import VERTEX_FACE
from .pair_distance import UNDERFLOW, lowest, without

_ZERO = wp.constant(wp.float64(0.0))
_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))
_SHRUNK = wp.constant(wp.float64(2.0**-10))
_RESTORED = wp.constant(wp.float64(2.0**10))
_PROJECTION = wp.constant(wp.float64(PROJECTION_ROOT * UNIT_ROUNDOFF[wp.float64]))
_TINY = wp.constant(wp.float64(TINY[wp.float64]))
_DOWN = wp.constant(wp.float64(1.0 - RELATIVE * UNIT_ROUNDOFF[wp.float64]))


@wp.func
def bound_along(
    n: wp.vec3d, w00: wp.vec3d, w01: wp.vec3d, w10: wp.vec3d, w11: wp.vec3d, size: wp.vec3d, norm: wp.float64
) -> wp.float64:
    """A lower bound of the distance of the patch in the norm dual to that of n, rounding included (step 15)."""
    _, projection = lowest(n, w00, w01, w10, w11)
    along = projection - (_PROJECTION * wp.dot(wp.abs(n), size) + _TINY)
    return along / norm * _DOWN


@wp.func
def box_distance(kind: int, points: Points) -> wp.float64:
    """A lower bound of the distance of a pair in the maximum norm, NaN where a coordinate is not finite.

    Invariant: no two points of the pair are closer (rounding, step 15, with Σ|d_k| in place of |d|).
    """
    p = points
    c = corners(kind, p)
    restored = wp.float64(1.0)
    t = total(c)
    if not (t[0] + t[1] + t[2] < LARGEST):
        p = scaled(p, wp.vec3d(_SHRUNK, _SHRUNK, _SHRUNK))
        c = corners(kind, p)
        restored = _RESTORED
    size = largest(c)
    if not (t[0] + t[1] + t[2] == t[0] + t[1] + t[2]) or not wp.isfinite(wp.max(size)):
        return wp.float64(wp.nan)
    s = inverse_power_of_two(wp.max(size))
    w00 = s * c.w00
    w01 = s * c.w01
    w10 = s * c.w10
    w11 = s * c.w11
    error = s * size
    third = w10 - w01  # of a face
    least = _ZERO
    for number in range(13):
        d = wp.vec3d(_ZERO, _ZERO, _ZERO)
        axis = number % 3
        d[axis] = wp.float64(1.0)
        if number >= 3:
            side = w01 - w00
            if number >= 6:
                side = w10 - w00
            if number >= 9:
                side = wp.where(kind == VERTEX_FACE, third, wp.vec3d())
            d = wp.cross(side, d)
        if number == 12:
            q = w01 - w00
            r = w10 - w00
            d = wp.cross(q, r)
            # of two sides that are nearly parallel, the product is off along the longer one
            if wp.dot(q, q) < wp.dot(r, r):
                q = r
            d = without(d, q)
        if wp.max(wp.abs(d)) > _ZERO:
            d = to_unit_size(d)
            norm = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
            least = wp.max(least, bound_along(d, w00, w01, w10, w11, error, norm))
            least = wp.max(least, bound_along(-d, w00, w01, w10, w11, error, norm))
    return wp.max(wp.min(least / s * restored, _LARGEST_FINITE) - UNDERFLOW, _ZERO)
