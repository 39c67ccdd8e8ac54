"""Whether a pair with toi 0 is near at the start, or rounding at the size of the pair hides its gap.

A pair whose end is at 1e15 has rounding errors of a tenth of a length unit all along, at its start as well: no bound
can tell its gap from none there, so its toi is 0, though it touches nothing. The gap at the start alone tells the two
apart, where it is more than the tolerance and the start is not as large itself. It decides nothing but the status.

The gap is that of two true points within 16 u of the largest corner, on each axis (`contact_normal`); with that added,
it is an upper bound. So a pair is called near only if it is.
"""

import warp as wp

from ..pair_kind import VERTEX_FACE
from .closest_point import closest_weights
from .rounding import UNIT_ROUNDOFF, inverse_power_of_two
from .single_points import Points, corners, largest

# The least tolerance that rounding at the length scale allows, times some digits: below it nothing is said of rounding.
LEAST_TOLERANCE = {wp.float64: 2.0**-26, wp.float32: 2.0**-18}
_NOISE = wp.constant(wp.float64(16.0 * UNIT_ROUNDOFF[wp.float64]))


@wp.func(inline=False)
def is_near(kind: int, points: Points, reach: wp.float64, is_euclidean: bool) -> bool:
    """Whether two points of a pair are certain to be within a length of each other."""
    c = corners(kind, points)
    size = largest(c)
    s = inverse_power_of_two(wp.max(size))
    w00 = s * c.w00
    w01 = s * c.w01
    w10 = s * c.w10
    w11 = s * c.w11
    wb, wc, from_w11 = closest_weights(w00, w01, w10, w11, kind == VERTEX_FACE)
    origin = wp.where(from_w11, w11, w00)
    gap = wp.abs(origin + wb * (w01 - origin) + wc * (w10 - origin)) + _NOISE * s * size
    length = wp.max(gap)
    if is_euclidean:
        length = wp.length(gap)
    return length <= s * reach
