"""The solver of a single pair: its earliest time of impact, for every pair kind and both precisions.

The corners of the patch are formed (differences first, in float64), each axis is normalised by a power of two, and the
whole patch is advanced; only a pair whose advance is slow is subdivided.
"""

import warp as wp

from ..pair_kind import VERTEX_FACE
from ..parameters import norm, only_method, real
from ..template import specialised
from .advance import point_of
from .answer import Answer, parameters
from .bisection import bisect
from .closest_point import closest_weights
from .in_precision import normalised, volume_between
from .norm import Norm
from .patch import corners_at
from .points import Points, corners, farthest, largest, longest_side, scaled, total
from .query import BISECTION, Options
from .rounding import (
    LARGEST,
    PROJECTION_PATCH,
    PROJECTION_ROOT,
    RELATIVE,
    SLACK,
    TINY,
    UNIT_ROUNDOFF,
    inverse_power_of_two,
)
from .start_distance import OF_COORDINATES
from .status import (
    STATUS_COLLISION,
    STATUS_INITIAL_CONTACT,
    STATUS_INVALID,
    STATUS_NO_COLLISION,
)
from .sub_patch import Patch, Problem
from .subdivide import advance_and_subdivide

# A separation beyond any corner, in normalised units; small enough for every product in float32.
FAR = wp.constant(wp.float64(2.0**60))

vec3d = wp.vec3d

is_euclidean = norm.is_ball
by_pair = norm.is_by_pair
on_arcs = norm.has_arcs
if is_euclidean:
    from .ball import start_gap_share
else:
    from .facets import start_gap_share

vec3 = wp.types.vector(length=3, dtype=real)
root_bound = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
patch_bound = wp.constant(real(PROJECTION_PATCH * UNIT_ROUNDOFF[real]))
length64 = specialised("pair.support", norm=Norm.EUCLIDEAN).length
round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
round_up = wp.constant(real(1.0 + (SLACK if is_euclidean else RELATIVE) * UNIT_ROUNDOFF[real]))
slack_down = wp.constant(wp.float64(1.0 - (SLACK + RELATIVE) * UNIT_ROUNDOFF[real]))
length_up = wp.constant(wp.float64(1.0 + RELATIVE * UNIT_ROUNDOFF[wp.float64]))
tiny = wp.constant(real(TINY[real]))
of_coordinates = wp.constant(wp.float64(OF_COORDINATES))
one = wp.constant(wp.float64(1.0))
smaller = wp.constant(wp.float64(1.0 / 1024.0))
Corners64 = specialised("pair.patch").Corners


@wp.struct
class Outcome:
    """The reported result of a pair."""

    toi: wp.float64
    status: int
    parameters: wp.vec2d
    gap: wp.float64
    width: wp.float64
    iterations: int


@wp.struct
class Normalised:
    """A pair in normalised units."""

    patch: Patch
    problem: Problem
    size: vec3  # largest corner, per axis
    unit: vec3d  # length of a normalised unit, per axis
    is_valid: bool


@wp.struct
class Measured:
    """Corners at both ends; an axis on which they overflow is multiplied by 1/1024 before."""

    c0: Corners64
    c1: Corners64
    pre: vec3d
    is_finite: bool


@wp.struct
class Lengths:
    """What a pair is asked for, as lengths times ``shrink``: 1/1024 where points or their box come near overflow."""

    shrink: wp.float64
    separation: wp.float64
    delta: wp.float64


@wp.func
def is_within_range(sums: vec3d) -> bool:
    """Whether sums of magnitudes are finite."""
    return sums[0] <= LARGEST and sums[1] <= LARGEST and sums[2] <= LARGEST


@wp.func
def measured(kind: int, points_t0: Points, points_t1: Points) -> Measured:
    """The corners of a pair; not finite where the input is not."""
    r = Measured()
    r.c0 = corners(kind, points_t0)
    r.c1 = corners(kind, points_t1)
    r.pre = vec3d(one, one, one)
    sums = total(r.c0) + total(r.c1)
    if not is_within_range(sums):
        # an overflow, or NaN in the input: try again with the axes that overflowed at 1/1024 of their size
        for k in range(3):
            if wp.static(is_euclidean) or not sums[k] <= LARGEST:
                r.pre[k] = smaller
        r.c0 = corners(kind, scaled(points_t0, r.pre))
        r.c1 = corners(kind, scaled(points_t1, r.pre))
        sums = total(r.c0) + total(r.c1)
    r.is_finite = is_within_range(sums)
    return r


@wp.func
def lengths_of(points_t0: Points, points_t1: Points, m: vec3d, pre: vec3d, options: Options) -> Lengths:
    """The lengths of a pair with these largest corners on each axis."""
    r = Lengths()
    r.shrink = wp.min(wp.min(pre[0], pre[1]), pre[2])
    scale = options.length_scale * r.shrink
    if scale <= wp.float64(0.0):
        scale = longest_side(points_t0, points_t1)
        if r.shrink < one or not scale <= LARGEST:
            r.shrink = smaller
            small = vec3d(smaller, smaller, smaller)
            scale = longest_side(scaled(points_t0, small), scaled(points_t1, small))
    r.delta = wp.min(options.tolerance * scale, LARGEST)
    if wp.static(by_pair):
        r.separation = wp.min(options.minimum_separation * r.shrink, LARGEST)
        if wp.static(not is_euclidean):
            if options.length_scale <= wp.float64(0.0):
                r.separation = wp.min(options.minimum_separation * scale, LARGEST)
        if options.margin > wp.float64(0.0):
            size = wp.max(m[0] / pre[0], wp.max(m[1] / pre[1], m[2] / pre[2])) * r.shrink
            size += of_coordinates * farthest(points_t0, points_t1) * r.shrink
            r.separation = wp.max(r.separation - options.margin * size, wp.float64(0.0))
    return r


@wp.func
def with_start_gap(n: Normalised, fraction: wp.float64) -> Normalised:
    """Reduce the separation to a fraction of the gap at the start, where that is smaller."""
    share = start_gap_share(n.patch.t0, n.patch.is_face, n.problem.separation, n.problem.error)
    share = wp.max(share * real(fraction), real(0.0)) * round_down
    if share < real(1.0):
        n.problem.separation = share * n.problem.separation
        n.problem.has_separation = share > real(0.0)
    return n


@wp.func
def normalise(kind: int, points_t0: Points, points_t1: Points, options: Options) -> Normalised:
    """Form the corners and scale each axis by a power of two (rounding, steps 1 and 2)."""
    n = Normalised()
    of_lengths = measured(kind, points_t0, points_t1)
    n.is_valid = of_lengths.is_finite
    if n.is_valid:
        c0 = of_lengths.c0
        c1 = of_lengths.c1
        pre = of_lengths.pre
        m = wp.max(largest(c0), largest(c1))
        lengths = lengths_of(points_t0, points_t1, m, pre, options)
        reach = m  # what fits into a normalised unit
        if wp.static(is_euclidean):
            # one scale for all axes, so that the ball stays a ball
            reach = vec3d(wp.max(m), wp.max(m), wp.max(m))
        s = vec3d()
        is_cut = bool(False)
        for k in range(3):
            # an axis on which the patch is smaller than the tolerance is not magnified beyond the tolerance
            unit = pre[k] / lengths.shrink
            s[k] = inverse_power_of_two(wp.max(reach[k], lengths.delta * unit))
            n.unit[k] = one / s[k] / pre[k]
            # corners are below 4 in these units, so a separation or tolerance above FAR has the effect of FAR
            length = lengths.separation * unit
            if wp.static(on_arcs):
                length = (lengths.separation + options.sagitta[k] * lengths.shrink) * unit
            length = wp.min(length * s[k], FAR)
            is_cut = is_cut or length == FAR
            n.problem.separation[k] = real(length) * round_up
            length = wp.min(lengths.delta * unit * s[k], FAR)
            if wp.static(not on_arcs):
                length = wp.where(options.margin > wp.float64(0.0), wp.float64(0.0), length)
            n.problem.delta[k] = real(length)
        n.size = vec3(wp.cw_mul(m, s))
        n.problem.error = root_bound * n.size + vec3(tiny, tiny, tiny)
        n.problem.delta = n.problem.delta + real(2.0) * n.problem.error
        n.problem.has_separation = lengths.separation > wp.float64(0.0)
        if wp.static(on_arcs):
            n.problem.has_separation = bool(True)
        n.patch.t0 = normalised(c0, s)
        n.patch.t1 = normalised(c1, s)
        n.patch.is_face = kind == VERTEX_FACE
        n.patch.is_triangle = kind == VERTEX_FACE
        n.patch.narrowing = wp.where(kind == VERTEX_FACE, real(0.0), real(1.0))
        if options.start_gap_fraction > wp.float64(0.0) and n.problem.has_separation and not is_cut:
            n = with_start_gap(n, options.start_gap_fraction)
        n.problem.volume = volume_between(
            c0, c1, s, n.patch.t0, n.patch.t1, n.problem.separation, n.problem.has_separation
        )
    return n


@wp.func
def gap_of(point: vec3, error: vec3, n: Normalised) -> wp.float64:
    """Upper bound of the gap beyond the separation, in its norm, at a point of a patch with an error, as a length."""
    gap = wp.float64(0.0)
    if wp.static(is_euclidean):
        x = vec3d(wp.abs(point) + real(3.0) * error)
        gap = length64(x) * length_up - wp.float64(n.problem.separation[0]) * slack_down
        return wp.max(gap * length_up, wp.float64(0.0)) * n.unit[0]
    for k in range(3):
        # the separation was rounded up, and the point carries the errors of a corner and of its interpolation
        beyond = wp.abs(point[k]) + real(3.0) * error[k] - round_down * n.problem.separation[k]
        if beyond > real(0.0):
            gap = wp.max(gap, wp.float64(beyond) * n.unit[k])
    return gap


@wp.func
def to_lengths(n: Normalised) -> vec3:
    """Factors that convert corners to lengths, up to a factor common to all axes."""
    largest = wp.max(wp.max(n.unit[0], n.unit[1]), n.unit[2])
    if largest <= LARGEST:
        return vec3(n.unit / largest)
    return vec3(real(1.0), real(1.0), real(1.0))


@wp.func
def closest_in_space(n: Normalised, t: real):
    """Weights of the closest point at a time, in the Euclidean norm of lengths."""
    c = corners_at(n.patch.t0, n.patch.t1, t)
    s = to_lengths(n)
    wb, wc, from_w11 = closest_weights(
        wp.cw_mul(s, c.w00),
        wp.cw_mul(s, c.w01),
        wp.cw_mul(s, c.w10),
        wp.cw_mul(s, c.w11),
        n.patch.is_triangle,
    )
    return wb, wc, from_w11


@wp.func
def closest_parameters(kind: int, n: Normalised, t: real) -> wp.vec2d:
    """Parameters of the closest point at a time."""
    wb, wc, from_w11 = closest_in_space(n, t)
    return parameters(kind, real(0.0), real(1.0), real(0.0), real(1.0), wb, wc, from_w11)


@wp.func
def closest_point(n: Normalised, t: real) -> vec3:
    """The closest point at a time, in normalised units."""
    wb, wc, from_w11 = closest_in_space(n, t)
    return point_of(corners_at(n.patch.t0, n.patch.t1, t), wb, wc, from_w11)


@wp.func
def solve(kind: int, n: Normalised, options: Options, t_start: real, used: int, max_iterations: int) -> Outcome:
    """Earliest toi of one pair that is free on [0, t_start), inf if none; ``used`` iterations have been made."""
    outcome = Outcome()
    outcome.toi = wp.float64(wp.inf)
    outcome.status = STATUS_NO_COLLISION
    if not n.is_valid:
        outcome.toi = wp.float64(0.0)
        outcome.status = STATUS_INVALID
        outcome.gap = wp.float64(wp.inf)
        outcome.width = options.t_max
    else:
        answer = Answer()
        patch_error = patch_bound * n.size + vec3(tiny, tiny, tiny)
        bisects = options.method == BISECTION
        if wp.static(only_method != ""):
            bisects = wp.static(only_method == "bisection")
        if bisects:
            n.problem.error = patch_error
            if wp.static(is_euclidean):
                n.problem.delta = real(0.5) * n.problem.delta  # the diagonal of a box that counts as contact
            n.problem.delta = n.problem.delta + real(2.0) * n.problem.error
            answer = bisect(kind, n.patch, n.problem, options.t_end, max_iterations, options.stop)
            answer.error = patch_error
        else:
            answer = advance_and_subdivide(
                kind, n.patch, n.problem, patch_error, t_start, options.t_end, used, max_iterations, options.stop
            )
        outcome.iterations = answer.iterations
        if answer.status != STATUS_NO_COLLISION and wp.float64(answer.toi) <= options.t_max:
            outcome.toi = wp.float64(answer.toi)
            outcome.status = answer.status
            outcome.width = wp.float64(answer.width)
            is_open = answer.status != STATUS_COLLISION
            if not is_open and answer.toi == real(0.0):
                outcome.status = STATUS_INITIAL_CONTACT
            if is_open or n.problem.has_separation or options.method == BISECTION:
                # the toi is the earliest time still open, on any sub-patch; or the point is one within the
                # separation, or a corner of a box of the bisection, which need not be the closest
                answer.parameters = closest_parameters(kind, n, answer.toi)
                if is_open:
                    answer.point = closest_point(n, answer.toi)
                    outcome.width = options.t_max - outcome.toi
            outcome.parameters = answer.parameters
            outcome.gap = gap_of(answer.point, answer.error, n)
    return outcome
