"""The lanes of the narrow phase: what the rounds of `lane_advance` settle for several pairs at once.

`first_rounds` takes pairs as they come: two rounds, which are all that most pairs need. What they leave open is packed
into full vectors again, and `later_rounds` takes it from there, with the facets of `facets` for pairs that have a
minimum separation or lie in one plane.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE
from ..parameters import norm, real, width
from ..template import specialised
from . import simd
from .in_precision import narrowed, widened
from .lane_pair import LanePair, normalise, volume_of
from .norm import Norm
from .pair_options import LaneOptions as Options
from .points import Points
from .query import CLIPPING
from .rounding import RELATIVE, SLACK, UNIT_ROUNDOFF
from .simd import Lanes, Vec3, bits_of, greatest, is_at_most, is_less, least, magnitude, mask_of, select, spread

# Rounds of every pair; and further ones, after which a pair goes on to the solver for single pairs.
FIRST_ROUNDS = wp.constant(2)
_LATER_ROUNDS = wp.constant(8)
_NONE = wp.constant(wp.uint32(0))

is_euclidean = norm.is_ball
by_pair = norm.is_by_pair
if is_euclidean:
    from .ball import start_gap_share
else:
    from .facets import start_gap_share

simd64 = specialised("pair.simd", width=width)
may_keep_start_distance = by_pair and not norm.has_arcs
if may_keep_start_distance:
    from .pair_options import lanes_at_start_distance
    from .passing import clip_passing
length64 = specialised("pair.support", width=width, norm=Norm.EUCLIDEAN).length
three = wp.constant(real(3.0))
round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
slack_down = wp.constant(wp.float64(1.0 - (SLACK + RELATIVE) * UNIT_ROUNDOFF[real]))
length_up = wp.constant(wp.float64(1.0 + RELATIVE * UNIT_ROUNDOFF[wp.float64]))
all_lanes = wp.constant(wp.uint32((1 << width) - 1))


@wp.struct
class LaneAnswer:
    """What is known of the pair in each lane: free, or in contact at t, or free on [0, t)."""

    free: wp.uint32  # bits of the lanes
    contact: wp.uint32
    closest: wp.uint32  # whether the parameters of a contact are those of the closest point
    t: simd64.Lanes
    u: simd64.Lanes  # parameters of a contact, as reported
    v: simd64.Lanes
    gap: simd64.Lanes
    iterations: simd64.Lanes


@simd.func
def coordinate_bound(size: Lanes, error: Lanes, separation: Lanes) -> Lanes:
    """Upper bound of a coordinate of a point beyond the separation."""
    return magnitude(size) + three * error - round_down * separation


# not out of line for plain numbers: on CUDA the later rounds have a kernel of their own, and a call passes structs
# through memory
@(simd.rare if width > 1 else simd.func)
def with_start_gap(n: LanePair, is_face: bool, fraction: real) -> LanePair:
    """Reduce the separation to a fraction of the gap at the start, where that is smaller."""
    share = fraction * start_gap_share(n.t0, is_face, n.separation, n.error)
    share = least(greatest(share, real(0.0)) * round_down, real(1.0))
    n.separation = share * n.separation
    return n


@simd64.func
def gap_at(n: LanePair, point: Vec3) -> simd64.Lanes:
    """Upper bound of the gap beyond the separation, in its norm, at the point of a contact, as a length."""
    if wp.static(is_euclidean):
        nothing = spread(real(0.0))
        x64 = widened(coordinate_bound(point.x, n.error.x, nothing))
        y64 = widened(coordinate_bound(point.y, n.error.y, nothing))
        z64 = widened(coordinate_bound(point.z, n.error.z, nothing))
        all64 = length64(simd64.vec(x64, y64, z64)) * length_up
        more = all64 - widened(n.separation.x) * slack_down
        return simd64.greatest(more * length_up, wp.float64(0.0)) / n.scale.x
    x = widened(coordinate_bound(point.x, n.error.x, n.separation.x)) / n.scale.x
    y = widened(coordinate_bound(point.y, n.error.y, n.separation.y)) / n.scale.y
    z = widened(coordinate_bound(point.z, n.error.z, n.separation.z)) / n.scale.z
    return simd64.greatest(simd64.greatest(x, y), simd64.greatest(z, wp.float64(0.0)))


def make_solve(with_facets: bool):
    advance = specialised("pair.lane_advance", norm=norm, real=real, width=width, with_facets=with_facets)
    advance_round = advance.advance_round
    start = advance.start

    @wp.func
    def solve(
        kind: int,
        points_t0: Points,
        points_t1: Points,
        options: Options,
        lanes: wp.uint32,
        t_start: simd64.Lanes,
        num_rounds: int,
        bound: wp.float64,
    ) -> LaneAnswer:
        """Advance the pairs of the given lanes by some rounds, or until they are free up to a bound."""
        answer = LaneAnswer()
        n = normalise(kind, points_t0, points_t1, options)
        open = n.is_valid & lanes
        if wp.static(with_facets and by_pair):
            if options.start_gap_fraction > wp.float64(0.0):
                n = with_start_gap(n, kind == VERTEX_FACE, real(options.start_gap_fraction))
        volume = volume_of(kind, points_t0, points_t1, n, n.separation, wp.static(by_pair))
        t = narrowed(t_start)
        if wp.static(with_facets and may_keep_start_distance):
            kept = lanes_at_start_distance(options) & open
            if kept != _NONE:
                end = spread(options.t_end)
                s = clip_passing(n.t0, n.t1, n.error, n.separation, kind == VERTEX_FACE, kept, t, end)
                t = select(mask_of(kept), s, t)
                answer.free = bits_of(is_less(end, t)) & open
                open = open & ~answer.free
        reached = start(t, open)
        rounds = int(0)
        is_at_begin = bits_of(is_at_most(t, real(0.0))) == all_lanes
        is_whole = wp.static(not with_facets and width > 1) and is_at_begin and options.t_end == real(1.0)
        while open != _NONE and rounds < num_rounds:
            reached = advance_round(kind, n, volume, options.t_end, is_whole, reached)
            is_whole = False
            answer.free = answer.free | bits_of(reached.free)
            answer.contact = answer.contact | bits_of(reached.contact)
            # what is free up to the bound needs no better answer
            open = bits_of(reached.open) & simd64.bits_of(simd64.is_less(widened(reached.t), bound))
            reached.open = mask_of(open)
            rounds += 1
        if answer.contact != _NONE:
            answer.gap = gap_at(n, reached.point)
            answer.closest = bits_of(reached.is_regular)
            if wp.static(not by_pair):
                answer.closest = all_lanes
            elif wp.static(not is_euclidean):
                answer.closest = _NONE
            answer.u = widened(reached.v)
            answer.v = widened(reached.u)
            if kind == EDGE_EDGE or kind == POINT_POINT:
                answer.u = widened(reached.u)
                answer.v = widened(reached.v)
        answer.t = widened(reached.t)
        answer.iterations = widened(reached.iterations)
        return answer

    return solve


solve_plain = make_solve(with_facets=False)
solve_full = make_solve(with_facets=True)


@wp.func
def first_rounds(
    kind: int, points_t0: Points, points_t1: Points, options: Options, cap: int, bound: wp.float64
) -> LaneAnswer:
    """Advance the pairs of all lanes from the start, by at most ``cap`` rounds, or until they are free to a bound."""
    t = simd64.spread(wp.float64(0.0))
    return solve_plain(kind, points_t0, points_t1, options, all_lanes, t, wp.min(cap, FIRST_ROUNDS), bound)


@(simd64.rare if width > 1 else simd64.func)
def later_rounds(
    kind: int,
    points_t0: Points,
    points_t1: Points,
    options: Options,
    lanes: wp.uint32,
    t_start: simd64.Lanes,
    used: simd64.Lanes,
    cap: int,
    bound: wp.float64,
) -> LaneAnswer:
    """Advance the given lanes on from a time, after ``used`` iterations each."""
    rounds = cap - FIRST_ROUNDS
    if options.method != CLIPPING:
        rounds = 0
    rounds = wp.min(rounds, _LATER_ROUNDS)
    answer = solve_full(kind, points_t0, points_t1, options, lanes, t_start, rounds, bound)
    answer.iterations = answer.iterations + used
    return answer
