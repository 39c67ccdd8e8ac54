"""Pairs in lanes: their differences are formed and scaled, one pair in each lane.

This is `normalise` of `solver`, step by step: differences in float64 (rounding, step 1), each axis multiplied by a
power of two (step 2). A pair whose coordinates come near overflow, or are not finite, is left to the solver for single
pairs.
"""

import warp as wp

from ..parameters import norm, real, width
from ..template import specialised
from . import simd
from .in_precision import narrowed, normalised, volume_between
from .lane_scale import inverse_power_of_two
from .pair_options import LaneOptions as Options
from .patch import Corners, Volume
from .points import Points, corners, largest, longest_side, total
from .rounding import LARGEST, PROJECTION_ROOT, RELATIVE, SLACK, TINY, UNIT_ROUNDOFF
from .simd import Vec3, spread, vec

# A separation beyond any corner, in normalised units; small enough for every product in float32.
_FAR = wp.constant(wp.float64(2.0**60))

is_euclidean = norm.is_ball
by_pair = norm.is_by_pair
simd64 = specialised("pair.simd", width=width)
if by_pair:
    from .pair_options import lanes_at_start_distance, without_margin
Corners64 = specialised("pair.patch", width=width).Corners
root_bound = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
round_up = wp.constant(real(1.0 + (SLACK if is_euclidean else RELATIVE) * UNIT_ROUNDOFF[real]))
tiny = wp.constant(real(TINY[real]))


@wp.struct
class LanePair:
    """A pair in each lane, in normalised units; the fields are those of `Patch` and `Problem` in `patch`."""

    t0: Corners
    t1: Corners
    error: Vec3
    separation: Vec3
    delta: Vec3
    scale: simd64.Vec3  # normalised units of a length unit, per axis: powers of two
    is_valid: wp.uint32  # bits of the lanes that neither overflow nor hold NaN


@simd64.func
def volume_of(
    kind: int, points_t0: Points, points_t1: Points, n: LanePair, separation: Vec3, has_separation: bool
) -> Volume:
    """The volume of a pair, beyond a separation."""
    c0 = corners(kind, points_t0)
    c1 = corners(kind, points_t1)
    return volume_between(c0, c1, n.scale, n.t0, n.t1, separation, has_separation)


@simd64.func
def is_finite(sums: simd64.Vec3) -> wp.uint32:
    """Bits of the lanes whose differences neither overflow nor hold NaN."""
    limit = simd64.spread(LARGEST)
    fits = simd64.is_at_most(sums.x, limit) & simd64.is_at_most(sums.y, limit)
    return simd64.bits_of(fits & simd64.is_at_most(sums.z, limit))


@simd64.func
def capped(length: simd64.Lanes, s: simd64.Lanes) -> simd64.Lanes:
    """A length in normalised units; corners are below 4, so anything larger has the effect of `_FAR`."""
    return simd64.least(length * s, _FAR)


@simd.func
def with_bounds(n: LanePair, size: Vec3, separation: Vec3, delta: Vec3) -> LanePair:
    """Set the rounding bound of a projection, the separation and the largest gap that counts as contact."""
    least_error = spread(tiny)
    n.error = root_bound * size + vec(least_error, least_error, least_error)
    n.separation = round_up * separation
    n.delta = delta + n.error + n.error
    return n


@simd64.func
def scaled_pair(
    n: LanePair,
    c0: Corners64,
    c1: Corners64,
    m: simd64.Vec3,  # largest corners
    s: simd64.Vec3,  # factors
    separation_length: simd64.Vec3,
    delta_length: simd64.Lanes,
) -> LanePair:
    """The pair with its axes multiplied by powers of two."""
    n.scale = s
    n.t0 = normalised(c0, s)
    n.t1 = normalised(c1, s)
    separation = simd64.vec(
        capped(separation_length.x, s.x), capped(separation_length.y, s.y), capped(separation_length.z, s.z)
    )
    # a separation that is cut is left to the solver for single pairs
    far = simd64.spread(_FAR)
    is_cut = simd64.is_at_most(far, separation.x) | simd64.is_at_most(far, separation.y)
    n.is_valid = n.is_valid & ~simd64.bits_of(is_cut | simd64.is_at_most(far, separation.z))
    delta = simd64.vec(capped(delta_length, s.x), capped(delta_length, s.y), capped(delta_length, s.z))
    return with_bounds(n, narrowed(simd64.scaled(m, s)), narrowed(separation), narrowed(delta))


@simd64.func
def normalise(kind: int, points_t0: Points, points_t1: Points, options: Options) -> LanePair:
    """Form the differences and scale each axis by a power of two (rounding, steps 1 and 2)."""
    n = LanePair()
    c0 = corners(kind, points_t0)
    c1 = corners(kind, points_t1)
    n.is_valid = is_finite(total(c0) + total(c1))
    scale = simd64.spread(options.length_scale)
    if options.length_scale <= wp.float64(0.0):
        scale = longest_side(points_t0, points_t1)
        n.is_valid = n.is_valid & simd64.bits_of(simd64.is_at_most(scale, LARGEST))
    limit = simd64.spread(LARGEST)
    delta_length = simd64.least(options.tolerance * scale, limit)
    m = simd64.greatest(largest(c0), largest(c1))
    most = simd64.greatest_of(m)
    if wp.static(by_pair):
        # a length in each lane
        separation_length = simd64.least(options.minimum_separation, limit)
        if wp.static(not is_euclidean):
            if options.length_scale <= wp.float64(0.0):
                separation_length = simd64.least(options.minimum_separation * scale, limit)
        separation_length = without_margin(separation_length, most, points_t0, points_t1, options)
    else:
        separation_length = simd64.spread(wp.float64(0.0))
    gap_length = delta_length
    if wp.static(by_pair and not norm.has_arcs):
        gap_length = simd64.select(simd64.mask_of(lanes_at_start_distance(options)), wp.float64(0.0), delta_length)
    separation = simd64.vec(separation_length, separation_length, separation_length)
    if wp.static(norm.has_arcs):
        separation = simd64.least(separation + options.sagitta, simd64.vec(limit, limit, limit))
    if wp.static(is_euclidean):
        # one scale for all axes, so that the ball stays a ball
        shared = inverse_power_of_two(simd64.greatest(most, delta_length))
        return scaled_pair(n, c0, c1, m, simd64.vec(shared, shared, shared), separation, gap_length)
    # an axis on which the patch is smaller than the tolerance is not magnified beyond the tolerance
    s = simd64.vec(
        inverse_power_of_two(simd64.greatest(m.x, delta_length)),
        inverse_power_of_two(simd64.greatest(m.y, delta_length)),
        inverse_power_of_two(simd64.greatest(m.z, delta_length)),
    )
    return scaled_pair(n, c0, c1, m, s, separation, gap_length)
