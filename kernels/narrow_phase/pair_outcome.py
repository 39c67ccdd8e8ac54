"""What the lanes of the narrow phase say of a pair, and what the solver for single pairs adds, on any device."""

import warp as wp

from ..pair.lane_solver import LaneAnswer
from ..pair.pair_options import options_of_pair
from ..pair.query import CLIPPING, Options, share_of_work
from ..pair.single_points import Points
from ..pair.start_gap import LEAST_TOLERANCE, is_near
from ..pair.status import STATUS_COLLISION, STATUS_INITIAL_CONTACT, STATUS_NO_COLLISION, STATUS_ROUNDING_LIMIT
from ..parameters import norm, only_method, real, width
from ..step.minima import OPEN
from ..step.pair_list import LeastToi, PairList, Round, num_found, vertices_of_pair
from ..template import specialised
from .sinks import Table

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

solver = specialised("pair.solver", real=real, norm=norm, only_method=only_method)
by_pair = norm.is_by_pair
on_arcs = norm.has_arcs
if on_arcs:
    solve_on_arcs = specialised("pair.arc_solver", norm=norm, real=real, only_method=only_method).solve_on_arcs
is_euclidean = wp.constant(norm.is_ball)
least_tolerance = wp.constant(wp.float64(LEAST_TOLERANCE[real]))
simd = specialised("pair.simd", width=width)


@wp.func
def is_set(bits: wp.uint32, lane: int) -> bool:
    """Whether the bit of a lane is set."""
    return ((bits >> wp.uint32(lane)) & _ONE) != _NONE


@wp.func
def outcome_of(answer: LaneAnswer, lane: int, options: Options) -> solver.Outcome:
    """The result of a pair that its lane has settled."""
    outcome = solver.Outcome()
    outcome.toi = wp.float64(wp.inf)
    outcome.status = STATUS_NO_COLLISION
    outcome.iterations = wp.int32(simd.lane_of(answer.iterations, lane))
    t = simd.lane_of(answer.t, lane)
    if is_set(answer.contact, lane) and t <= options.t_max:
        outcome.toi = t
        outcome.status = STATUS_COLLISION
        if t == wp.float64(0.0):
            outcome.status = STATUS_INITIAL_CONTACT
        outcome.parameters = wp.vec2d(simd.lane_of(answer.u, lane), simd.lane_of(answer.v, lane))
        outcome.gap = simd.lane_of(answer.gap, lane)
    return outcome


@wp.func
def skips_first_rounds(options: Options) -> bool:
    """Whether pairs skip the first rounds, which are not those of the bisection, and know no share of the gap."""
    skips = options.method != CLIPPING
    if wp.static(by_pair and not on_arcs):
        skips = skips or options.start_gap_fraction > wp.float64(0.0)
    return skips


@wp.func
def cap_of_round(options: Options, round: Round, pairs: PairList) -> int:
    """Iterations of each pair: in the second round its share of the work left to the open pairs, 0 without any."""
    if round.is_second != 0:
        num_open = pairs.counts[pairs.kind, OPEN]
        if num_open == wp.int64(0):
            return 0
        return share_of_work(options, num_open)
    return wp.min(options.first_iterations, options.max_iterations)


@wp.func
def num_pairs(pairs: PairList, options: Options, round: Round) -> int:
    """Number of pairs that a round takes: none in the second round if the first has left none open."""
    if cap_of_round(options, round, pairs) == 0:
        return 0
    return wp.int32(num_found(pairs))


@wp.func
def is_beyond(t: wp.float64, least: LeastToi) -> bool:
    """Whether a pair that is free on [0, t) cannot lower the least toi so far."""
    return wp.cast(t, wp.int64) >= least.bits[0]


@wp.func(inline=only_method != "")
def finished(
    kind: int, t: wp.float64, used: int, is_contact: bool, a: Points, b: Points, options: Options, cap: int
) -> solver.Outcome:
    """The result of a pair that its lane has left open at time t, after ``used`` iterations.

    Of a contact only the parameters are set: its lane has found a point, which need not be the closest one.
    """
    outcome = solver.Outcome()
    n = solver.normalise(kind, a, b, options)
    if is_contact:
        outcome.parameters = solver.closest_parameters(kind, n, real(t))
    else:
        outcome = solver.solve(kind, n, options, real(t), used, cap)
    return outcome


@wp.func
def finished_of_list(
    pairs: PairList, k: int, t: wp.float64, used: int, a: Points, b: Points, options: Options, cap: int
) -> solver.Outcome:
    """The result of a pair of a list that its lane has left open at time t, after ``used`` iterations."""
    vertices = vertices_of_pair(pairs, k)
    of_pair = options_of_pair(options, vertices.first, vertices.second)
    if wp.static(on_arcs):
        return solve_on_arcs(pairs.kind, vertices.first, vertices.second, t, used, a, b, of_pair, cap)
    else:
        return finished(pairs.kind, t, used, False, a, b, of_pair, cap)


@wp.func
def most_gap(options: Options) -> wp.float64:
    """The largest gap at toi 0 that the tolerance explains; where each pair has its own length scale, any."""
    if options.length_scale <= wp.float64(0.0):
        return wp.float64(wp.inf)
    return wp.float64(2.0) * wp.max(options.tolerance, least_tolerance) * options.length_scale


@wp.func(inline=False)
def status_at_start(kind: int, gap: wp.float64, most: wp.float64, a: Points, separation: wp.float64) -> int:
    """The status of a contact at the start with this gap, of which tolerance explains ``most``, given its points."""
    if gap <= most:
        return STATUS_INITIAL_CONTACT
    if is_near(kind, a, separation + most, is_euclidean):
        return STATUS_INITIAL_CONTACT
    return STATUS_ROUNDING_LIMIT


@wp.func
def lanes_at_start(answer: LaneAnswer) -> wp.uint32:
    """The lanes that have reached no time."""
    return simd.bits_of(simd.is_at_most(answer.t, simd.spread(wp.float64(0.0))))


@wp.func
def finished_lanes(answer: LaneAnswer, options: Options) -> wp.uint32:
    """The lanes of which `outcome_of` says all there is to say; for the others `finished` goes on."""
    finished = answer.free | (answer.contact & answer.closest)
    if answer.contact != _NONE and options.length_scale > wp.float64(0.0):
        finished = finished & ~(answer.contact & lanes_at_start(answer))
    return finished


@wp.func
def finished_of_table(
    kind: int, answer: LaneAnswer, lane: int, a: Points, b: Points, options: Options, cap: int
) -> solver.Outcome:
    """The result of a pair of a table for which `outcome_of` is not all."""
    outcome = outcome_of(answer, lane, options)
    is_contact = is_set(answer.contact, lane)
    if is_contact and outcome.status == STATUS_NO_COLLISION:
        return outcome
    if not (is_contact and is_set(answer.closest, lane)):
        used = wp.int32(simd.lane_of(answer.iterations, lane))
        of_solver = finished(kind, simd.lane_of(answer.t, lane), used, is_contact, a, b, options, cap)
        if is_contact:
            outcome.parameters = of_solver.parameters
        else:
            outcome = of_solver
    if outcome.status == STATUS_INITIAL_CONTACT:
        outcome.status = status_at_start(kind, outcome.gap, most_gap(options), a, options.minimum_separation)
    return outcome


@wp.func
def write_row(k: int, outcome: solver.Outcome, table: Table):
    """Write the result of a pair of a table."""
    table.toi[k] = outcome.toi
    table.status[k] = outcome.status
    table.parameters[k] = outcome.parameters
    table.gap[k] = outcome.gap
    table.width[k] = outcome.width
    table.iterations[k] = outcome.iterations
