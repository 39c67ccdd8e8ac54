"""Pairs on arcs, several at once: windows that end where a pair seems to meet, solved by the rounds of `arc_rounds`.

The first window is the whole slice, which is all that most free pairs need. The next ends at the time at which Newton's
iteration sees the pair meet (`meeting`), and a little after it, so that the contact is within. What such windows do not
bring further goes on in those of `windows`, and at last to the solver for single pairs.
"""

import warp as wp

from ..boxes.lanes import number_of_bits
from ..parameters import real, width
from ..template import specialised
from .arc_rounds import advance_on_arcs
from .arcs import amplitude, error_of, points_at, sagitta
from .corotating import are_alike, corotating_window, longest_turned, may_turn, selected
from .lane_solver import LaneAnswer
from .meeting import Meeting, meeting
from .pair_options import LaneOptions
from .points import Points, corners, largest
from .rounding import PROJECTION_ROOT, START_DISTANCE_ERRORS, UNIT_ROUNDOFF
from .windows import Window, in_slice, in_step, next_window, reached

simd = specialised("pair.simd", width=width)
Lanes = simd.Lanes
Vec3 = simd.Vec3

# Rounds of a window; of all windows that end where a pair seems to meet; of those that shrink by themselves as well.
_ROUNDS = wp.constant(2)
_MOST_ROUNDS = wp.constant(12)
_ALL_ROUNDS = wp.constant(32)
# Pairs in the lanes below which those that are open wait for others.
_FEWEST = wp.constant(max(width // 2, 1))
_NONE = wp.constant(wp.uint32(0))
zero = wp.constant(wp.float64(0.0))
one = wp.constant(wp.float64(1.0))
two = wp.constant(wp.float64(2.0))
four = wp.constant(wp.float64(4.0))
eight = wp.constant(wp.float64(8.0))
eighth = wp.constant(wp.float64(0.125))
# Far shorter than a window.
tiny_time = wp.constant(wp.float64(2.0**-60))
start_distance_errors = wp.constant(wp.float64(START_DISTANCE_ERRORS))
# What a corner is off by in the precision of the iteration.
corner_error = wp.constant(wp.float64(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))


@wp.struct
class Bounds:
    """What bounds the arcs of a pair in all of a slice."""

    amplitudes: Vec3
    rounding: Lanes
    error: Lanes  # rounding, and how far points may be beside their paths
    shared: wp.uint32  # the lanes whose bodies share most of their turn


@wp.struct
class Ends:
    """Both ends of the window of each lane, and the gap at its begin, where it has been looked for."""

    begin: Lanes
    end: Lanes
    at_begin: Points
    at_end: Points
    gap: Lanes


@wp.struct
class Chords:
    """The chords over a window, of the world or of an observer who turns with a body."""

    at_end: Points
    sagitta: Vec3
    error: Lanes  # that of the observer
    is_corotating: simd.Mask


@simd.func
def sharpness(error: Lanes, kind: int, p: Points) -> Lanes:
    """The sagitta below which a contact of chords is one of arcs, but for rounding."""
    m = largest(corners(kind, p))
    return error + corner_error * simd.greatest_of(m)


@simd.func
def enlarged(a: Vec3, by: Lanes) -> Vec3:
    """A vector with each component enlarged."""
    return simd.vec(a.x + by, a.y + by, a.z + by)


@simd.func
def bounds_of(kind: int, a: Points, b: Points, options: LaneOptions) -> Bounds:
    """Bounds of the arcs of the pairs."""
    arcs = options.arcs
    r = Bounds()
    r.amplitudes = amplitude(kind, arcs)
    r.rounding = error_of(a, b, arcs.slack, r.amplitudes)
    r.error = r.rounding + arcs.excess
    return r


@simd.func
def with_margin(options: LaneOptions, error: Lanes) -> LaneOptions:
    """The options, where what starts at the distance that it keeps has the error of its arcs to begin with."""
    r = options
    if options.keeps_start_distance != _NONE:
        kept = simd.greatest(options.minimum_separation - start_distance_errors * error, simd.spread(zero))
        r.minimum_separation = simd.select(simd.mask_of(options.keeps_start_distance), kept, options.minimum_separation)
    return r


@simd.func
def end_at_meeting(met: Meeting, bounds: Bounds, begin: Lanes, sharp: Lanes) -> Lanes:
    """When a window ends in which a pair seems to meet."""
    amplitude = simd.greatest_of(bounds.amplitudes)
    # after the meeting it goes on until the sagitta there is of the size of rounding errors
    ahead = simd.least(met.t - begin, one - begin) + tiny_time
    after = simd.least(sharp / (amplitude * ahead), ahead)
    after = simd.greatest(after, four * sharp / simd.magnitude(met.speed))
    # nor is it longer than it takes for the sagitta to be as large as the gap
    fits = simd.square_root(eight * simd.greatest(met.gap, zero) / amplitude) + after
    fits = simd.select(simd.mask_of(bounds.shared), two, fits)
    return simd.least(met.t + after, begin + fits)


@simd.func
def chords_of(
    kind: int, a: Points, b: Points, options: LaneOptions, bounds: Bounds, ends: Ends, open: wp.uint32
) -> Chords:
    """The chords over a window, in which those of an observer who turns are taken where their sagitta is less."""
    nothing = simd.spread(zero)
    h = ends.end - ends.begin
    r = Chords()
    r.at_end = ends.at_end
    r.sagitta = sagitta(bounds.amplitudes, h)
    r.error = nothing
    r.is_corotating = simd.mask_of(_NONE)
    if open & bounds.shared != _NONE:
        of_body = corotating_window(kind, a, b, options.arcs, ends.at_begin, ends.at_end, ends.begin, h)
        all_of_body = of_body.sagitta + of_body.error
        r.is_corotating = simd.mask_of(bounds.shared) & simd.is_less(all_of_body, simd.greatest_of(r.sagitta))
        r.at_end = selected(r.is_corotating, of_body.at_end, ends.at_end)
        of_all = simd.vec(of_body.sagitta, of_body.sagitta, of_body.sagitta)
        r.sagitta = simd.select(r.is_corotating, of_all, r.sagitta)
        r.error = simd.select(r.is_corotating, of_body.error, nothing)
    return r


@simd.func
def with_contacts(answer: LaneAnswer, of_window: LaneAnswer, chords: Chords, error: Lanes) -> LaneAnswer:
    """An answer with the contacts of a window, whose gaps are of chords off the arcs by no more than an error."""
    r = answer
    is_contact = simd.mask_of(of_window.contact)
    off_chord = (four * of_window.t * (one - of_window.t)) * simd.greatest_of(chords.sagitta)
    gap = of_window.gap + two * ((error + chords.error) + off_chord)
    gap = simd.select(chords.is_corotating, longest_turned * gap, gap)
    r.contact = answer.contact | of_window.contact
    r.u = simd.select(is_contact, of_window.u, answer.u)
    r.v = simd.select(is_contact, of_window.v, answer.v)
    r.gap = simd.select(is_contact, gap, answer.gap)
    return r


@simd.func
def advance_to_meeting(
    kind: int,
    a: Points,
    b: Points,
    lane_options: LaneOptions,
    lanes: wp.uint32,
    t_start: Lanes,
    used: Lanes,
    is_first: bool,
    cap: int,
    bound: wp.float64,
) -> LaneAnswer:
    """Advance the given lanes through windows of few rounds; in a first call, as long as most of them are open.

    The first window of a pair is all of the slice, the others end where it seems to meet. What a window does depends on
    the time that the pair has reached and on the iterations that it has used alone, so a pair gets the same answer in
    whatever company it is.
    """
    arcs = lane_options.arcs
    nothing = simd.spread(zero)
    bounds = bounds_of(kind, a, b, lane_options)
    options = with_margin(lane_options, bounds.error)
    bounds.shared = simd.bits_of(are_alike(arcs) & may_turn(options.minimum_separation))
    options.t_end = real(1.0)
    rounds = wp.min(cap, _ROUNDS)
    most = wp.float64(wp.max(wp.min(cap, _MOST_ROUNDS) - _ROUNDS, 0))
    limit = most
    fewest = int(0)
    if is_first:
        fewest = _FEWEST
    else:
        limit = wp.float64(wp.max(wp.min(cap, _ALL_ROUNDS) - _ROUNDS, 0))
    answer = LaneAnswer()
    answer.iterations = used
    answer.t = t_start
    window = Window()
    window.h = eighth * (one - in_slice(t_start, arcs.t_begin, arcs.t_length))
    window.last = nothing
    open = lanes & simd.bits_of(simd.is_at_most(used, limit))
    # no pair of a call has been here before, or all of them have
    starts = (open & simd.bits_of(simd.is_at_most(used, zero))) != _NONE
    shrinks = simd.mask_of(_NONE)
    ends = Ends()
    ends.gap = nothing
    while open != _NONE and (starts or number_of_bits(open) > fewest):
        if starts:
            ends.begin = nothing
            ends.end = simd.spread(one)
            ends.at_begin = a
            ends.at_end = b
        else:
            ends.begin = in_slice(answer.t, arcs.t_begin, arcs.t_length)
            ends.at_begin = points_at(kind, a, b, arcs, ends.begin)
        sharp = sharpness(bounds.rounding, kind, ends.at_begin)
        if not starts:
            shrinks = simd.is_less(most, answer.iterations)
            seeking = open & ~simd.bits_of(shrinks)
            met = meeting(kind, a, b, arcs, options.minimum_separation + arcs.excess, ends.begin, seeking)
            end = end_at_meeting(met, bounds, ends.begin, sharp)
            ends.end = simd.least(simd.select(shrinks, ends.begin + window.h, end), one)
            ends.gap = met.gap
            ends.at_end = points_at(kind, a, b, arcs, ends.end)
        window.begin = ends.begin
        window.h = ends.end - ends.begin
        chords = chords_of(kind, a, b, options, bounds, ends, open)
        off_arc = bounds.error + chords.error
        options.sagitta = simd.vec(off_arc, off_arc, off_arc)
        blur = bounds.rounding + chords.error
        of_window = advance_on_arcs(kind, ends.at_begin, chords.at_end, options, chords.sagitta, blur, open, rounds)
        is_open = simd.mask_of(open)
        is_free = simd.mask_of(of_window.free)
        answer = with_contacts(answer, of_window, chords, bounds.error)
        answer.free = answer.free | (open & of_window.free & simd.bits_of(simd.is_at_most(one, ends.end)))
        t = reached(window, ends.end, is_free, of_window.t)
        iterations = answer.iterations + simd.greatest(of_window.iterations, one)
        # what gains nothing, or is within its separation as far as its closest points show, goes on in windows that
        # shrink by themselves
        gains = simd.is_less(ends.begin, t)
        if not starts:
            gains = shrinks | (gains & simd.is_less(zero, ends.gap))
        iterations = simd.select(gains, iterations, simd.greatest(iterations, most + one))
        answer.iterations = simd.select(is_open, iterations, answer.iterations)
        answer.t = simd.select(is_open, in_step(simd.least(t, one), arcs.t_begin, arcs.t_length), answer.t)
        following = next_window(window, t, is_free)
        first_of_all = eighth * (one - in_slice(answer.t, arcs.t_begin, arcs.t_length))
        window.h = simd.select(shrinks, following.h, first_of_all)
        window.last = simd.select(shrinks, following.last, nothing)
        # a lane that is sharp and has neither a contact nor a free window needs other tools
        is_sharp = shrinks & simd.is_at_most(simd.greatest_of(chords.sagitta), sharp)
        settled = answer.free | answer.contact | (simd.bits_of(is_sharp) & ~of_window.free)
        open = open & ~settled & simd.bits_of(simd.is_at_most(answer.iterations, limit))
        open = open & simd.bits_of(simd.is_less(answer.t, bound))
        starts = False
    return answer
