"""What the lanes of the narrow phase say of a pair, and how a contact is recorded; on the CPU and on CUDA."""

import warp as wp

from ..atomics import claim_int
from ..pair.hold import held_at
from ..pair.lane_solver import LaneAnswer
from ..pair.norm import MAXIMUM_NORM, has_arcs, is_ball, is_by_pair
from ..pair.pair_options import options_of_pair
from ..pair.query import CLIPPING, Options, share_of_work
from ..pair.single_points import Points, corners, largest, points_of, relative_motion
from ..pair.start_gap import LEAST_TOLERANCE, is_near
from ..pair.status import STATUS_COLLISION, STATUS_INITIAL_CONTACT, STATUS_NO_COLLISION, STATUS_ROUNDING_LIMIT
from ..pair.turns import turns_anywhere
from ..parameters import norm, on_warp, real, width
from ..step.contact_normal import ContactGap, contact_at
from ..step.minima import CONTACTS_OVERFLOW, ROUNDING_LIMIT, STRUCK, Minima, flag_world, is_kinematic, lower_pair
from ..step.step import ContactList
from ..template import specialised

# A toi below this may be so small only because the gap is lost in the rounding of a float32 motion.
_LOST_TOI = wp.constant(wp.float64(2.0**-20))
# A held pair (`hold`) has toi 0 if it touches within this fraction of the step and of its size: what is lost in the
# margin is no progress, and a response is to find the pair among those that touch.
_PRESSED = wp.constant(wp.float64(2.0**-20))
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

solver = specialised("pair.solver", real=real, norm=norm, on_warp=on_warp)
has_own = is_by_pair(norm)
on_arcs = has_arcs(norm)
if on_arcs:
    arc_solver = specialised("pair.arc_solver", norm=norm, real=real, on_warp=on_warp)
    solve_on_arcs, tangents_of_arcs = arc_solver.solve_on_arcs, arc_solver.tangents_of_arcs
else:
    solve_on_arcs = None
is_euclidean = wp.constant(is_ball(norm))
least_tolerance = wp.constant(wp.float64(LEAST_TOLERANCE[real]))
infinite = wp.constant(wp.float64(float("inf")))
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
    """Whether pairs skip the first rounds, which know no separation and are not those of the bisection."""
    if wp.static(has_own):
        return not wp.static(on_arcs) or options.method != CLIPPING
    return options.minimum_separation > wp.float64(0.0) or options.method != CLIPPING


@wp.func
def cap_of_round(options: Options, is_second: int, num_open: wp.int64) -> int:
    """Iterations of each pair: in the second round its share of the work left to the open pairs, 0 without any."""
    if is_second != 0:
        if num_open == wp.int64(0):
            return 0
        return share_of_work(options, num_open)
    return wp.min(options.first_iterations, options.max_iterations)


@wp.func(inline=False)
def finished(
    kind: int, t: wp.float64, used: int, is_contact: bool, a: Points, b: Points, options: Options, cap: int
) -> solver.Outcome:
    """The result of a pair that its lane has left open at time t, after ``used`` iterations.

    Of a contact within a separation only the parameters are set: its lane has found a point, not the closest one.
    """
    outcome = solver.Outcome()
    n = solver.normalise(kind, a, b, options)
    if is_contact:
        outcome.parameters = solver.closest_parameters(kind, n, real(t))
    else:
        outcome = solver.solve(kind, n, options, real(t), used, cap)
    return outcome


@wp.func
def most_gap(options: Options) -> wp.float64:
    """The largest gap at toi 0 that the tolerance explains; where each pair has its own length scale, any."""
    if options.length_scale <= wp.float64(0.0):
        return wp.float64(wp.inf)
    return wp.float64(2.0) * wp.max(options.tolerance, least_tolerance) * options.length_scale


@wp.func(inline=False)
def status_at_start(kind: int, gap: wp.float64, a: Points, options: Options) -> int:
    """The status of a contact at the start with this gap, given the points of the pair there."""
    most = most_gap(options)
    if gap <= most:
        return STATUS_INITIAL_CONTACT
    separation = options.minimum_separation
    if wp.static(norm == MAXIMUM_NORM):
        separation *= options.length_scale
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
    if wp.static(has_own):
        return answer.free
    if options.minimum_separation > wp.float64(0.0):
        return answer.free
    finished = answer.free | answer.contact
    if answer.contact != _NONE and options.length_scale > wp.float64(0.0):
        finished = finished & ~(answer.contact & lanes_at_start(answer))
    return finished


@wp.func
def rest_of(
    outcome: solver.Outcome, answer: LaneAnswer, lane: int, kind: int, a: Points, b: Points, options: Options, cap: int
) -> solver.Outcome:
    """The result of a pair for which `outcome_of` is not all."""
    is_contact = is_set(answer.contact, lane)
    if is_contact and outcome.status == STATUS_NO_COLLISION:
        return outcome
    used = wp.int32(simd.lane_of(answer.iterations, lane))
    found = finished(kind, simd.lane_of(answer.t, lane), used, is_contact, a, b, options, cap)
    if is_contact:
        if options.minimum_separation > wp.float64(0.0):
            outcome.parameters = found.parameters
        found = outcome
    if found.status == STATUS_INITIAL_CONTACT:
        found.status = status_at_start(kind, found.gap, a, options)
    return found


@wp.func(inline=False)
def status_of(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    gap: wp.float64,
    vertices_t0: wp.array[wp.vec3d],
    options: Options,
) -> int:
    """`status_at_start` of a pair of primitives."""
    own = options_of_pair(options, first, second)
    return status_at_start(kind, gap, points_of(kind, first, second, vertices_t0), own)


@wp.func(inline=False)
def motion_of(
    kind: int, first: wp.vec3i, second: wp.vec3i, vertices_t0: wp.array[wp.vec3d], vertices_t1: wp.array[wp.vec3d]
) -> wp.float64:
    """`relative_motion` of a pair; out of line, so that nobody keeps its points in registers for it."""
    return relative_motion(points_of(kind, first, second, vertices_t0), points_of(kind, first, second, vertices_t1))


@wp.func(inline=False)
def is_pressed(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    toi: wp.float64,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
) -> bool:
    """Whether a held pair touches as good as from the start."""
    a = points_of(kind, first, second, vertices_t0)
    motion = relative_motion(a, points_of(kind, first, second, vertices_t1))
    return toi <= _PRESSED and toi * motion <= _PRESSED * wp.max(largest(corners(kind, a)))


@wp.func(inline=False)
def parameters_at(kind: int, t: wp.float64, a: Points, b: Points, options: Options) -> wp.vec2d:
    """Parameters of the closest point at a time: those of a contact within a separation."""
    return solver.closest_parameters(kind, solver.normalise(kind, a, b, options), real(t))


# on CUDA out of line, so that its registers are not those of every thread; on the CPU a call costs 3 % of a step
@wp.func(inline=not on_warp)
def place_at(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t: wp.float64,
    uv: wp.vec2d,
    options: Options,
) -> ContactGap:
    """`contact_at`, for points on arcs from where they are and how they move at that time."""
    a = points_of(kind, first, second, vertices_t0)
    b = points_of(kind, first, second, vertices_t1)
    if wp.static(on_arcs):
        tangents = tangents_of_arcs(kind, first, second, a, b, t, options)
        return contact_at(kind, tangents.a, tangents.b, wp.float64(0.5), uv)
    return contact_at(kind, a, b, t, uv)


@wp.func(inline=False)
def is_struck(
    first: wp.vec3i,
    second: wp.vec3i,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    options: Options,
    minima: Minima,
) -> bool:
    """Whether of a pair only what is kinematic moves."""
    free = first
    if is_kinematic(minima, first[0]):
        free = second
    elif not is_kinematic(minima, second[0]):
        return False
    for k in range(3):
        if not (vertices_t0[free[k]] == vertices_t1[free[k]]):
            return False
    if wp.static(on_arcs):
        return not turns_anywhere(free, options.turns)
    return True


@wp.func(inline=True)
def record_contact(
    kind: int,
    pair: wp.vec2i,
    first: wp.vec3i,
    second: wp.vec3i,
    outcome: solver.Outcome,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    options: Options,
    only_moving: int,
    gaps_moved: wp.float64,
    # out
    minima: Minima,
    contacts: ContactList,
):
    """Lower the minima, and append the contact to the list if there is capacity; ``options`` are of all pairs.

    With ``only_moving`` a pair of which only what is kinematic moves sets a flag in place of lowering the minima.
    """
    is_held = bool(False)
    if wp.static(has_own):
        if held_at(options.hold, first, second) < infinite:
            if is_pressed(kind, first, second, outcome.toi, vertices_t0, vertices_t1):
                is_held = True
                outcome.toi = wp.float64(0.0)
                if outcome.status == STATUS_COLLISION:
                    outcome.status = STATUS_INITIAL_CONTACT
    toi = outcome.toi
    status = outcome.status
    if status == STATUS_INITIAL_CONTACT and outcome.gap > most_gap(options) and not is_held:
        status = status_of(kind, first, second, outcome.gap, vertices_t0, options)
        if status == STATUS_ROUNDING_LIMIT:
            flag_world(minima, first[0], ROUNDING_LIMIT)
    if gaps_moved > wp.float64(0.0) and toi < _LOST_TOI and not is_held:
        motion = motion_of(kind, first, second, vertices_t0, vertices_t1)
        if gaps_moved * outcome.gap < motion:
            toi = wp.max(toi, gaps_moved * outcome.gap / motion)
    if only_moving != 0 and is_struck(first, second, vertices_t0, vertices_t1, options, minima):
        flag_world(minima, first[0], STRUCK)
    else:
        lower_pair(minima, first, second, wp.cast(toi, wp.int64))
    n = claim_int(contacts.count, 0)
    if n < contacts.toi.shape[0]:
        contacts.kind[n] = kind
        contacts.primitives[n] = pair
        contacts.toi[n] = outcome.toi
        contacts.status[n] = status
        contacts.gap[n] = outcome.gap
        contacts.width[n] = outcome.width
        at_toi = place_at(kind, first, second, vertices_t0, vertices_t1, outcome.toi, outcome.parameters, options)
        contacts.parameters[n] = at_toi.parameters
        contacts.normal[n] = at_toi.direction
    else:
        flag_world(minima, first[0], CONTACTS_OVERFLOW)
