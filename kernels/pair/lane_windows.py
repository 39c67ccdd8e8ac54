"""Pairs on arcs, several at once: `windows` in which the lanes are solved by the rounds of straight motion."""

import warp as wp

from ..boxes.lanes import number_of_bits
from ..parameters import real, width
from ..template import specialised
from .arc_rounds import advance_on_arcs
from .arcs import amplitude, error_of, motion_of, points_at, sagitta
from .corotating import are_alike, corotating_window, longest_turned, may_turn, selected
from .lane_solver import LaneAnswer, solve_full
from .meeting import meeting
from .pair_options import LaneOptions
from .points import Points, corners, largest
from .query import Options
from .rounding import PROJECTION_ROOT, START_DISTANCE_ERRORS, UNIT_ROUNDOFF
from .windows import Window, in_slice, in_step, next_window, reached, slice_down, step_down

simd = specialised("pair.simd", width=width)
Lanes = simd.Lanes
Vec3 = simd.Vec3
all_lanes = wp.constant(wp.uint32((1 << width) - 1))

# Rounds of a window that ends where a pair seems to meet, and of all of these; and of further windows, after which pairs
# go on one by one.
_ROUNDS = wp.constant(2)
_MOST_ROUNDS = wp.constant(12)
_LATER_ROUNDS = wp.constant(4)
# Pairs in the lanes below which those that are open wait for others.
_FEWEST = wp.constant(max(width // 2, 1))
_LATER_WINDOWS = wp.constant(6)
_NONE = wp.constant(wp.uint32(0))
zero = wp.constant(wp.float64(0.0))
one = wp.constant(wp.float64(1.0))
two = wp.constant(wp.float64(2.0))
four = wp.constant(wp.float64(4.0))
eighth = wp.constant(wp.float64(0.125))
# Far shorter than a window.
tiny_time = wp.constant(wp.float64(2.0**-60))
# More than how fast two points of a pair part or approach, as a multiple of the largest motion of its corners.
speed_share = wp.constant(wp.float64(8.0))
start_distance_errors = wp.constant(wp.float64(START_DISTANCE_ERRORS))
unbounded = wp.constant(wp.float64(float("inf")))
# What a corner is off by in the precision of the iteration.
corner_error = wp.constant(wp.float64(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))


@simd.func
def sharpness(error: Lanes, kind: int, p: Points) -> Lanes:
    """The sagitta below which a contact of chords is one of arcs, but for rounding."""
    m = largest(corners(kind, p))
    return error + corner_error * simd.greatest_of(m)


@simd.func
def enlarged(a: Vec3, by: Lanes) -> Vec3:
    """A vector with each component enlarged."""
    return simd.vec(a.x + by, a.y + by, a.z + by)


@(simd.rare if width > 1 else simd.func)
def advance_windows(
    kind: int,
    a: Points,
    b: Points,
    lane_options: LaneOptions,
    options: Options,
    lanes: wp.uint32,
    t_start: Lanes,
    used: Lanes,
    num_windows: int,
    num_rounds: int,
    bound: wp.float64,
) -> LaneAnswer:
    """Advance the given lanes through some windows of the slice, or until they are free up to a bound.

    Those that begin with a window over all that is left of the slice have used no iterations.
    """
    amplitudes = amplitude(kind, lane_options.arcs)
    error = error_of(a, b, lane_options.arcs)
    nothing = simd.spread(zero)
    if lane_options.keeps_start_distance != _NONE:
        # what starts at the distance that it keeps has the error of its arcs to begin with
        kept = simd.greatest(lane_options.minimum_separation - start_distance_errors * error, nothing)
        lane_options.minimum_separation = simd.select(
            simd.mask_of(lane_options.keeps_start_distance), kept, lane_options.minimum_separation
        )
    none = simd.mask_of(_NONE)
    shared = simd.bits_of(are_alike(lane_options.arcs) & may_turn(lane_options.minimum_separation))
    window = Window()
    window.begin = in_slice(t_start, options.turns)
    window.h = one - window.begin
    window.h = simd.select(simd.is_less(zero, used), eighth * window.h, window.h)
    window.last = nothing
    lane_options.t_end = real(1.0)
    # the last contact of chords that was within the tolerance
    near = _NONE
    near_u = nothing
    near_v = nothing
    near_gap = nothing
    near_t = nothing
    speed = speed_share * motion_of(a, b, lane_options.arcs)
    tolerance = simd.spread(options.tolerance * options.length_scale)
    answer = LaneAnswer()
    answer.iterations = used
    open = lanes
    windows = int(0)
    while open != _NONE and windows < num_windows:
        end = simd.least(window.begin + window.h, one)
        window.h = end - window.begin
        at_begin = points_at(kind, a, b, lane_options.arcs, window.begin)
        at_end = points_at(kind, a, b, lane_options.arcs, end)
        chords = sagitta(amplitudes, window.h)
        is_corotating = none
        if open & shared != _NONE:
            window_of_body = corotating_window(kind, a, b, lane_options.arcs, at_begin, at_end, window.begin, window.h)
            of_body = window_of_body.sagitta + window_of_body.error
            is_corotating = simd.mask_of(shared) & simd.is_less(of_body, simd.greatest_of(chords))
            at_end = selected(is_corotating, window_of_body.at_end, at_end)
            of_window = simd.vec(of_body, of_body, of_body)
            chords = simd.select(is_corotating, of_window, chords)
        lane_options.sagitta = enlarged(chords, error)
        of_chords = solve_full(kind, at_begin, at_end, lane_options, open, nothing, num_rounds, unbounded)
        is_open = simd.mask_of(open)
        is_free = simd.mask_of(of_chords.free)
        sharp = simd.bits_of(simd.is_at_most(simd.greatest_of(chords), sharpness(error, kind, at_begin)))
        t = reached(window, end, is_free, of_chords.t)
        # a sharp window in which nothing but rounding is left of the motion may end in no contact, where the one before
        # did: its point is one of this contact, with a gap that has changed by the motion since then
        touches = open & sharp & (of_chords.contact | (near & ~of_chords.free))
        is_near = simd.mask_of(open & of_chords.contact)
        # the arcs may be as far from the chords on the other side
        gap = of_chords.gap + two * simd.greatest_of(lane_options.sagitta)
        gap = simd.select(is_corotating, longest_turned * gap, gap)
        near_u = simd.select(is_near, of_chords.u, near_u)
        near_v = simd.select(is_near, of_chords.v, near_v)
        near_gap = simd.select(is_near, gap, near_gap)
        near_t = simd.select(is_near, t, near_t)
        is_contact = simd.mask_of(touches)
        answer.contact = answer.contact | touches
        answer.free = answer.free | (open & of_chords.free & simd.bits_of(simd.is_at_most(one, end)))
        answer.u = simd.select(is_contact, near_u, answer.u)
        answer.v = simd.select(is_contact, near_v, answer.v)
        answer.gap = simd.select(is_contact, near_gap + speed * (t - near_t), answer.gap)
        near = (near & ~(open & of_chords.free)) | (
            open & of_chords.contact & simd.bits_of(simd.is_at_most(gap, tolerance))
        )
        answer.iterations = answer.iterations + simd.select(is_open, of_chords.iterations, nothing)
        following = next_window(window, t, is_free)
        window.begin = simd.select(is_open, following.begin, window.begin)
        window.h = simd.select(is_open, following.h, window.h)
        window.last = simd.select(is_open, following.last, window.last)
        # a lane that is sharp and has neither a contact nor a free window needs other tools
        settled = answer.free | answer.contact | (~of_chords.free & sharp)
        open = open & ~settled & simd.bits_of(simd.is_less(in_step(window.begin, options.turns), bound))
        windows += 1
    answer.t = in_step(simd.least(window.begin, one), options.turns)
    return answer


@(simd.rare if width > 1 else simd.func)
def advance_to_meeting(
    kind: int,
    a: Points,
    b: Points,
    lane_options: LaneOptions,
    options: Options,
    lanes: wp.uint32,
    t_start: Lanes,
    used: Lanes,
    fewest: int,
    cap: int,
    bound: wp.float64,
) -> LaneAnswer:
    """Advance the given lanes as long as there are more of them than the fewest, through windows of few rounds.

    The first window of a pair is all of the slice, the others end where it seems to meet. What a window does depends on
    the time that the pair has reached and on the iterations that it has used alone, so a pair gets the same answer in
    whatever company it is.
    """
    amplitudes = amplitude(kind, lane_options.arcs)
    error = error_of(a, b, lane_options.arcs)
    nothing = simd.spread(zero)
    if lane_options.keeps_start_distance != _NONE:
        # what starts at the distance that it keeps has the error of its arcs to begin with
        kept = simd.greatest(lane_options.minimum_separation - start_distance_errors * error, nothing)
        lane_options.minimum_separation = simd.select(
            simd.mask_of(lane_options.keeps_start_distance), kept, lane_options.minimum_separation
        )
    none = simd.mask_of(_NONE)
    shared = simd.bits_of(are_alike(lane_options.arcs) & may_turn(lane_options.minimum_separation))
    lane_options.t_end = real(1.0)
    rounds = wp.min(cap, _ROUNDS)
    most = wp.float64(wp.max(wp.min(cap, _MOST_ROUNDS) - _ROUNDS, 0))
    answer = LaneAnswer()
    answer.iterations = used
    answer.t = t_start
    open = lanes & simd.bits_of(simd.is_at_most(used, most))
    is_first = bool(True)
    while open != _NONE and (is_first or number_of_bits(open) > fewest):
        is_first = False
        begin = in_slice(answer.t, options.turns)
        starts = simd.is_at_most(answer.iterations, zero)
        at_begin = points_at(kind, a, b, lane_options.arcs, begin)
        sharp = sharpness(error, kind, at_begin)
        seeking = open & ~simd.bits_of(starts)
        met = meeting(kind, a, b, lane_options.arcs, lane_options.minimum_separation, begin, seeking)
        # beyond the time of meeting the window goes on until the sagitta there is of the size of rounding errors
        ahead = simd.least(met.t - begin, one - begin) + tiny_time
        beyond = simd.least(sharp / (simd.greatest_of(amplitudes) * ahead), ahead)
        beyond = simd.greatest(beyond, four * sharp / simd.magnitude(met.speed))
        end = simd.select(starts, one, simd.least(met.t + beyond, one))
        h = end - begin
        at_end = points_at(kind, a, b, lane_options.arcs, end)
        chords = sagitta(amplitudes, h)
        excess = error
        is_corotating = none
        if open & shared != _NONE:
            of_body = corotating_window(kind, a, b, lane_options.arcs, at_begin, at_end, begin, h)
            all_of_body = of_body.sagitta + of_body.error
            is_corotating = simd.mask_of(shared) & simd.is_less(all_of_body, simd.greatest_of(chords))
            at_end = selected(is_corotating, of_body.at_end, at_end)
            chords = simd.select(is_corotating, simd.vec(of_body.sagitta, of_body.sagitta, of_body.sagitta), chords)
            excess = simd.select(is_corotating, error + of_body.error, error)
        lane_options.sagitta = simd.vec(excess, excess, excess)
        of_window = advance_on_arcs(kind, at_begin, at_end, lane_options, chords, open, rounds)
        is_open = simd.mask_of(open)
        is_free = simd.mask_of(of_window.free)
        off_chord = (four * of_window.t * (one - of_window.t)) * simd.greatest_of(chords)
        t = begin + h * of_window.t * slice_down
        t = simd.select(is_free, end, simd.least(simd.greatest(begin, t * step_down), end))
        touches = of_window.contact & simd.bits_of(simd.is_at_most(off_chord, sharp))
        gap = of_window.gap + two * (excess + off_chord)
        gap = simd.select(is_corotating, longest_turned * gap, gap)
        is_contact = simd.mask_of(touches)
        answer.contact = answer.contact | touches
        answer.free = answer.free | (open & of_window.free & simd.bits_of(simd.is_at_most(one, end)))
        answer.u = simd.select(is_contact, of_window.u, answer.u)
        answer.v = simd.select(is_contact, of_window.v, answer.v)
        answer.gap = simd.select(is_contact, gap, answer.gap)
        iterations = answer.iterations + of_window.iterations
        # what gains nothing needs other windows
        iterations = simd.select(simd.is_less(begin, t), iterations, simd.greatest(iterations, most + one))
        answer.iterations = simd.select(is_open, iterations, answer.iterations)
        answer.t = simd.select(is_open, in_step(simd.least(t, one), options.turns), answer.t)
        open = open & ~answer.free & ~answer.contact & simd.bits_of(simd.is_at_most(answer.iterations, most))
        open = open & simd.bits_of(simd.is_less(answer.t, bound))
    return answer


@wp.func
def first_windows(
    kind: int, a: Points, b: Points, lane_options: LaneOptions, options: Options, cap: int, bound: wp.float64
) -> LaneAnswer:
    """Advance the pairs of all lanes from the begin of the slice until most are settled."""
    t = simd.spread(options.turns.t_begin)
    used = simd.spread(zero)
    return advance_to_meeting(kind, a, b, lane_options, options, all_lanes, t, used, _FEWEST, cap, bound)


@wp.func
def later_windows(
    kind: int,
    a: Points,
    b: Points,
    lane_options: LaneOptions,
    options: Options,
    lanes: wp.uint32,
    t_start: Lanes,
    used: Lanes,
    cap: int,
    bound: wp.float64,
) -> LaneAnswer:
    """Advance the given lanes on from a time through shorter windows, after ``used`` iterations each."""
    answer = advance_to_meeting(kind, a, b, lane_options, options, lanes, t_start, used, 0, cap, bound)
    left = lanes & ~(answer.free | answer.contact)
    if left != _NONE:
        windows = wp.min(_LATER_WINDOWS, (cap - _MOST_ROUNDS) / _LATER_ROUNDS)
        last = advance_windows(kind, a, b, lane_options, options, left, answer.t, answer.iterations, windows, _LATER_ROUNDS, bound)
        m = simd.mask_of(left)
        answer.free = answer.free | (last.free & left)
        answer.contact = answer.contact | (last.contact & left)
        answer.t = simd.select(m, last.t, answer.t)
        answer.u = simd.select(m, last.u, answer.u)
        answer.v = simd.select(m, last.v, answer.v)
        answer.gap = simd.select(m, last.gap, answer.gap)
        answer.iterations = simd.select(m, last.iterations, answer.iterations)
    return answer
