"""Pairs in lanes: their differences are formed and scaled, one pair in each lane.

This is `normalise` of `solver`, step by step: differences in float64 (rounding, step 1), each axis multiplied by a
power of two (step 2). A pair whose coordinates come near overflow, or are not finite, is left to the solver for single
pairs.
"""

from types import SimpleNamespace

import warp as wp

from .norm import MAXIMUM_NORM, is_ball, is_by_pair
from .once import once
from .pair_options import make_pair_options
from .patch import make_patch
from .points import make_points
from .rounding import LARGEST, PROJECTION_ROOT, RELATIVE, SLACK, TINY, UNIT_ROUNDOFF
from .simd import header, make_simd

# A separation beyond any corner, in normalised units; small enough for every product in float32.
_FAR = wp.constant(wp.float64(2.0**60))


def _power_of_two(width: int) -> str:
    """C++ of `inverse_power_of_two` of `rounding` on lanes."""
    vector = "" if width == 1 else f" __attribute__((ext_vector_type({width})))"
    return (
        header(wp.float64, width)
        + f"    typedef long long Bits64{vector};\n"
        + """
    const Lanes a = lanes(x);
    Bits64 bits;
    memcpy(&bits, &a, sizeof(bits));
    const Bits64 mirrored = 2045 - ((bits >> 52) & 0x7FF);
    const Bits64 one = (Bits64)1;
    const Bits64 power = (mirrored < one ? one : mirrored) << 52;
    Lanes r;
    memcpy(&r, &power, sizeof(r));
    return of_lanes(r);
"""
    )


@once
def make_lane_pair(real, width: int, norm: str = MAXIMUM_NORM) -> SimpleNamespace:
    """Structs and functions for lanes of one floating-point type, with separations in one norm."""
    is_euclidean = is_ball(norm)
    has_own = is_by_pair(norm)
    simd64 = make_simd(wp.float64, width)
    simd = make_simd(real, width)
    Lanes64 = simd64.Lanes
    Lanes = simd.Lanes
    Vec3d = simd64.Vec3
    Vec3 = simd.Vec3
    Corners = make_patch(real, width).Corners
    Corners64 = make_patch(wp.float64, width).Corners
    points = make_points(width)
    Points = points.Points
    corners = points.corners
    largest = points.largest
    total = points.total
    longest_side = points.longest_side
    vec64 = simd64.vec
    vec = simd.vec
    Options = make_pair_options(real, width, norm).LaneOptions
    root_bound = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
    round_up = wp.constant(real(1.0 + (SLACK if is_euclidean else RELATIVE) * UNIT_ROUNDOFF[real]))
    tiny = wp.constant(real(TINY[real]))

    @wp.func_native(_power_of_two(width))
    def inverse_power_of_two(x: Lanes64) -> Lanes64:
        """Power of two s with 1/2 <= s·x < 1, as in `rounding`."""
        ...

    if real == wp.float64:

        @wp.func
        def narrowed(x: Lanes64) -> Lanes:
            """Lanes in the precision of the iteration."""
            return x

        @wp.func
        def widened(x: Lanes) -> Lanes64:
            """Lanes in float64."""
            return x

    elif width == 1:

        @wp.func
        def narrowed(x: Lanes64) -> Lanes:
            """Lanes in the precision of the iteration."""
            return wp.float32(x)

        @wp.func
        def widened(x: Lanes) -> Lanes64:
            """Lanes in float64."""
            return wp.float64(x)

    else:
        typed = f"""
    typedef double Wide __attribute__((ext_vector_type({width})));
    typedef float Narrow __attribute__((ext_vector_type({width})));
    Wide wide;
    Narrow narrow;
"""

        narrowed_snippet = (
            typed
            + f"""
    __builtin_memcpy(&wide, &x, sizeof(wide));
    narrow = __builtin_convertvector(wide, Narrow);
    wp::vec_t<{width}, float> r;
    __builtin_memcpy(&r, &narrow, sizeof(narrow));
    return r;
"""
        )

        @wp.func_native(narrowed_snippet)
        def narrowed(x: Lanes64) -> Lanes:
            """Lanes in the precision of the iteration."""
            ...

        widened_snippet = (
            typed
            + f"""
    __builtin_memcpy(&narrow, &x, sizeof(narrow));
    wide = __builtin_convertvector(narrow, Wide);
    wp::vec_t<{width}, double> r;
    __builtin_memcpy(&r, &wide, sizeof(wide));
    return r;
"""
        )

        @wp.func_native(widened_snippet)
        def widened(x: Lanes) -> Lanes64:
            """Lanes in float64."""
            ...

    @wp.func
    def narrowed(a: Vec3d) -> Vec3:
        return vec(narrowed(a.x), narrowed(a.y), narrowed(a.z))

    @wp.struct
    class LanePair:
        """A pair in each lane, in normalised units; the fields are those of `Patch` and `Problem` in `patch`."""

        t0: Corners
        t1: Corners
        error: Vec3
        separation: Vec3
        delta: Vec3
        unit: Vec3d
        is_valid: wp.uint32  # bits of the lanes that neither overflow nor hold NaN

    greatest64 = simd64.greatest
    least64 = simd64.least
    is_at_most64 = simd64.is_at_most
    both64 = simd64.both
    either64 = simd64.either
    spread64 = simd64.spread
    scaled64 = simd64.scaled
    bits64 = simd64.bits_of
    spread = simd.spread

    @wp.func
    def normalised(c: Corners64, s: Vec3d) -> Corners:
        """Corners in normalised units (rounding, step 2)."""
        r = Corners()
        r.w00 = narrowed(scaled64(c.w00, s))
        r.w01 = narrowed(scaled64(c.w01, s))
        r.w10 = narrowed(scaled64(c.w10, s))
        r.w11 = narrowed(scaled64(c.w11, s))
        r.q = narrowed(scaled64(c.q, s))
        r.r = narrowed(scaled64(c.r, s))
        return r

    @wp.func
    def is_finite(sums: Vec3d) -> wp.uint32:
        """Bits of the lanes whose differences neither overflow nor hold NaN."""
        limit = spread64(LARGEST)
        fits = both64(is_at_most64(sums.x, limit), is_at_most64(sums.y, limit))
        return bits64(both64(fits, is_at_most64(sums.z, limit)))

    @simd64.func
    def capped(length: Lanes64, s: Lanes64) -> Lanes64:
        """A length in normalised units; corners are below 4, so anything larger has the effect of `_FAR`."""
        return least64(length * s, spread64(_FAR))

    @simd.func
    def with_bounds(n: LanePair, size: Vec3, separation: Vec3, delta: Vec3) -> LanePair:
        """Set the rounding bound of a projection, the separation and the largest gap that counts as contact."""
        least_error = spread(tiny)
        n.error = spread(root_bound) * size + vec(least_error, least_error, least_error)
        n.separation = spread(round_up) * separation
        n.delta = delta + n.error + n.error
        return n

    @simd64.func
    def scaled_pair(
        n: LanePair,
        c0: Corners64,
        c1: Corners64,
        m: Vec3d,  # largest corners
        s: Vec3d,  # factors
        separation_length: Lanes64,
        delta_length: Lanes64,
    ) -> LanePair:
        """The pair with its axes multiplied by powers of two."""
        one = spread64(wp.float64(1.0))
        n.unit = vec64(one / s.x, one / s.y, one / s.z)
        n.t0 = normalised(c0, s)
        n.t1 = normalised(c1, s)
        separation = vec64(
            capped(separation_length, s.x), capped(separation_length, s.y), capped(separation_length, s.z)
        )
        # a separation that is cut is left to the solver for single pairs
        far = spread64(_FAR)
        is_cut = either64(is_at_most64(far, separation.x), is_at_most64(far, separation.y))
        n.is_valid = n.is_valid & ~bits64(either64(is_cut, is_at_most64(far, separation.z)))
        delta = vec64(capped(delta_length, s.x), capped(delta_length, s.y), capped(delta_length, s.z))
        return with_bounds(n, narrowed(scaled64(m, s)), narrowed(separation), narrowed(delta))

    @simd64.func
    def normalise(kind: int, points_t0: Points, points_t1: Points, options: Options) -> LanePair:
        """Form the differences and scale each axis by a power of two (rounding, steps 1 and 2)."""
        n = LanePair()
        c0 = corners(kind, points_t0)
        c1 = corners(kind, points_t1)
        n.is_valid = is_finite(total(c0) + total(c1))
        scale = spread64(options.length_scale)
        if options.length_scale <= wp.float64(0.0):
            scale = longest_side(points_t0, points_t1)
            n.is_valid = n.is_valid & bits64(is_at_most64(scale, spread64(LARGEST)))
        limit = spread64(LARGEST)
        delta_length = least64(options.tolerance * scale, limit)
        if wp.static(has_own):
            separation_length = least64(options.minimum_separation, limit)  # one in each lane
        else:
            separation_length = least64(options.minimum_separation * scale, limit)
        m = greatest64(largest(c0), largest(c1))
        most = greatest64(m.x, greatest64(m.y, m.z))
        if wp.static(has_own):
            separation_length = greatest64(separation_length - options.margin * most, spread64(wp.float64(0.0)))
        if wp.static(is_euclidean):
            # a length, and one scale for all axes, so that the ball stays a ball
            if wp.static(not has_own):
                separation_length = least64(spread64(options.minimum_separation), limit)
            shared = inverse_power_of_two(greatest64(most, delta_length))
            return scaled_pair(n, c0, c1, m, vec64(shared, shared, shared), separation_length, delta_length)
        # an axis on which the patch is smaller than the tolerance is not magnified beyond the tolerance
        s = vec64(
            inverse_power_of_two(greatest64(m.x, delta_length)),
            inverse_power_of_two(greatest64(m.y, delta_length)),
            inverse_power_of_two(greatest64(m.z, delta_length)),
        )
        return scaled_pair(n, c0, c1, m, s, separation_length, delta_length)

    return SimpleNamespace(
        LanePair=LanePair,
        normalise=normalise,
        narrowed=narrowed,
        widened=widened,
    )
