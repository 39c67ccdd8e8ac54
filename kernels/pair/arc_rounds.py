"""Rounds of the lanes in a window on arcs: along chords, off which the points are by no more than a parabola.

At a share s of a window a point of an arc is off its chord by at most 4s(1 − s) of its sagitta: by nothing at both
ends. So a window that ends where a pair touches comes to the contact in one round, as on straight paths, where a pair
with the sagitta as a separation would stop short of it. Along a direction the bound is a parabola, and where it meets a
line a root of a quadratic; in the volume it is a cubic above the product of the parabola and the support of the normal.
The **bow** of a window is its sagitta in normalised units, rounded up. The rounding is step 19 of `rounding`.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE
from ..parameters import norm, real, width
from ..template import specialised
from . import simd
from .in_precision import narrowed, widened
from .lane_advance import near_errors, point_at, settled
from .lane_closest import LaneClosest, closest
from .lane_pair import LanePair, normalise, volume_of
from .lane_solver import LaneAnswer, gap_at
from .pair_options import LaneOptions
from .patch import Corners, Volume, corners_at
from .points import Points
from .rounding import RELATIVE, SLACK, SQUARE_UNDERFLOW, TINY_DIRECTION, UNIT_ROUNDOFF
from .simd import (
    Lanes,
    Mask,
    Vec3,
    bits_of,
    dot,
    greatest,
    greatest_of,
    is_at_most,
    is_less,
    is_within,
    least,
    magnitude,
    mask_of,
    opposite,
    select,
    spread,
    square_root,
    vec,
)
from .support import support
from .volume import clip_with_reach, reach_of

_NONE = wp.constant(wp.uint32(0))
# Clips with the volume in a round, at most.
_VOLUME_CLIPS = wp.constant(6)

is_euclidean = norm.is_ball
simd64 = specialised("pair.simd", width=width)
unit = UNIT_ROUNDOFF[real]
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
two = wp.constant(real(2.0))
quarter = wp.constant(real(0.25))
four = wp.constant(real(4.0))
minus_one = wp.constant(real(-1.0))
floor_errors = wp.constant(real(8.0))
round_up = wp.constant(real(1.0 + RELATIVE * unit))
round_down = wp.constant(real(1.0 - RELATIVE * unit))
sagitta_up = wp.constant(real(1.0 + SLACK * unit))
four_thirds_up = wp.constant(real(4.0 / 3.0 * (1.0 + RELATIVE * unit)))
root_error = wp.constant(real(RELATIVE * unit))
square_error = wp.constant(real(2.0 * RELATIVE * unit))
square_underflow = wp.constant(real(SQUARE_UNDERFLOW[real]))
tiny_direction = wp.constant(real(TINY_DIRECTION[real]))
# A sagitta beyond any corner, in normalised units.
far = wp.constant(wp.float64(2.0**60))
zero64 = wp.constant(wp.float64(0.0))

if is_euclidean:
    from .ball import is_in_ball, offset, with_largest_one

    @simd.func
    def direction_of(d: Vec3) -> Vec3:
        """The direction of the closest pair, at a length whose square neither overflows nor underflows."""
        return with_largest_one(d)

    @simd.func
    def is_close(x: Vec3, by: Vec3, separation: Vec3) -> Mask:
        """Whether a point is within the separation, and so much more on each axis."""
        return is_in_ball(x, by, separation)

else:
    from .facets import clip_facet, offset, widest_facet
    from .lane_touch import touching_point

    # Clips with a facet in a round.
    _FACET_STEPS = wp.constant(4)
    box_errors = wp.constant(real(256.0))

    @simd.func
    def direction_of(d: Vec3) -> Vec3:
        """The direction of the closest pair."""
        return d

    @simd.func
    def is_close(x: Vec3, by: Vec3, separation: Vec3) -> Mask:
        """Whether a point is within the separation, and so much more on each axis."""
        return is_within(x, by + separation)


@simd.func
def bow_reach(f: Volume, separation: Vec3, sagitta: Vec3) -> Volume:
    """The reach of a separation and a parabola over a window: a cubic to be restricted with f (rounding, step 19)."""
    r = reach_of(f, separation)
    mid = support(sagitta, f.normal_mid)
    r.b1 = r.b1 + four_thirds_up * greatest(support(sagitta, f.normal_t0), mid)
    r.b2 = r.b2 + four_thirds_up * greatest(support(sagitta, f.normal_t1), mid)
    return r


@simd.func
def clip_corner(a: Lanes, b: Lanes, off: Lanes, bow: Lanes, bends: bool, t: Lanes) -> Lanes:
    """Share up to which one corner stays beyond ``off`` and a parabola, 2 if until the end; -1 if it is not at ``t``.

    a and b are d·W at both ends, the parabola is bow·s(1 − s) (rounding, step 19).
    """
    x = a - off
    y = b - off
    is_beyond_t0 = is_less(zero, x)
    is_beyond_t1 = is_less(zero, y)
    # from the end at which it is beyond: first − fall·s + bow·s²
    first = select(is_beyond_t0, x, y)
    last = select(is_beyond_t0, y, x)
    fall = ((first - last) + bow) + root_error * (first + magnitude(last) + bow)
    stays = is_at_most(fall, zero)
    root = fall
    if bends:
        square = fall * fall
        rest = (square + square_underflow) - (four * round_down) * (first * bow)
        has_none = is_less(rest, minus_one * square_error * square)
        is_bent = is_less(zero, bow)
        stays = stays | (is_bent & has_none)
        root = select(is_bent, square_root(greatest(rest, zero) + square_error * square), root)
    s = ((first + first) / (fall + root)) * round_down
    has_entered = is_less((one - s) * round_up, t)
    s = select(is_beyond_t0, select(stays, two, least(two, s)), minus_one)
    return select(is_beyond_t1 & ((is_beyond_t0 & is_at_most(one, s)) | (opposite(is_beyond_t0) & has_entered)), two, s)


@simd.func
def clip_bow(d: Vec3, off: Lanes, bow: Lanes, t: Lanes, n: LanePair, is_triangle: bool) -> Lanes:
    """Share s >= t such that d·W stays above ``off`` and the parabola on [t, s); 2 if it does to the end."""
    bends = bits_of(is_less(zero, bow)) != _NONE
    s = clip_corner(dot(d, n.t0.w00), dot(d, n.t1.w00), off, bow, bends, t)
    s = least(s, clip_corner(dot(d, n.t0.w01), dot(d, n.t1.w01), off, bow, bends, t))
    s = least(s, clip_corner(dot(d, n.t0.w10), dot(d, n.t1.w10), off, bow, bends, t))
    if not is_triangle:
        s = least(s, clip_corner(dot(d, n.t0.w11), dot(d, n.t1.w11), off, bow, bends, t))
    can_prove = is_at_most(tiny_direction, greatest_of(magnitude(d)))
    return select(can_prove & is_less(t, s), s, t)


@wp.struct
class ArcWindow:
    """Pairs in a window on arcs, normalised."""

    n: LanePair
    bow: Vec3
    slack: Vec3  # what of the separation is for rounding
    volume: Volume
    reach: Volume


@wp.struct
class ArcReached:
    """Where the lanes are in a window, as shares of it."""

    t: Lanes
    u: Lanes  # weights of the contact
    v: Lanes
    point: Vec3
    iterations: Lanes
    open: wp.uint32
    free: wp.uint32
    contact: wp.uint32


@wp.struct
class ArcStep:
    """What directions show of open lanes at a time t."""

    t: Lanes  # time up to which they separate, 2 if beyond the end
    separation: Vec3  # with the parabola at t
    is_near: Mask  # whether the gap at t is few times rounding


@wp.struct
class ArcTouch:
    """Which lanes touch, where and when."""

    contact: Mask
    t: Lanes
    point: Vec3


@simd.func
def window_of(
    kind: int, at_begin: Points, at_end: Points, options: LaneOptions, sagitta: simd64.Vec3, rounding: simd64.Lanes
) -> ArcWindow:
    """Pairs in a window; those whose sagitta is beyond any corner are not valid."""
    w = ArcWindow()
    w.n = normalise(kind, at_begin, at_end, options)
    slack = simd64.scaled(simd64.vec(rounding, rounding, rounding), w.n.scale)
    w.slack = vec(narrowed(slack.x), narrowed(slack.y), narrowed(slack.z))
    bow = simd64.scaled(sagitta, w.n.scale)
    w.n.is_valid = w.n.is_valid & simd64.bits_of(simd64.is_less(simd64.greatest_of(bow), far))
    w.bow = sagitta_up * vec(narrowed(bow.x), narrowed(bow.y), narrowed(bow.z))
    w.volume = volume_of(kind, at_begin, at_end, w.n, w.n.separation + (w.bow + w.bow), True)
    w.reach = bow_reach(w.volume, w.n.separation, w.bow)
    return w


@simd.func
def clip_with_volume(w: ArcWindow, open: Mask, t: Lanes, end: Lanes):
    """Clip open lanes until the volume gains nothing more.

    Returns the time reached, which lanes are free until the end, and those in which it gains more.
    """
    x = end
    free = mask_of(_NONE)
    moving = open
    clips = int(0)
    while bits_of(moving) != _NONE and clips < _VOLUME_CLIPS:
        s, next_x, now_free = clip_with_reach(w.volume, w.reach, t, x, end)
        free = free | (moving & now_free)
        gains = is_less(settled, s - t)
        t = select(moving, s, t)
        x = select(moving, next_x, x)
        moving = moving & gains & opposite(now_free)
        clips += 1
    return t, free, moving


@simd.func
def bow_at(w: ArcWindow, t: Lanes) -> Vec3:
    """How far the points may be off their chords at a time."""
    return (four * t * (one - t)) * w.bow


@simd.func
def step_along(w: ArcWindow, c: Corners, d: Vec3, is_face: bool, t: Lanes) -> ArcStep:
    """Clip with the direction of the closest pair; c are the corners at t, and d is their closest point."""
    n = w.n
    r = ArcStep()
    local = bow_at(w, t)
    r.separation = n.separation + local
    along = direction_of(d)
    off = offset(along, n.error, n.separation)
    r.t = clip_bow(along, off, (four * round_up) * support(w.bow, along), t, n, is_face)
    # where the patch meets a corner of the box, its closest point is farther than a side of the box
    most = four * greatest_of(w.slack + local)
    r.is_near = is_close(d, near_errors * n.error + vec(most, most, most), r.separation)
    return r


if not is_euclidean:

    @simd.func
    def needs_facets(w: ArcWindow, d: Vec3, step: ArcStep, gain: Lanes, is_first: bool) -> Mask:
        """Which lanes need the facets of the separation box: those in a plane, or of little gain."""
        n = w.n
        has_box = opposite(is_within(n.separation, two * w.slack + box_errors * n.error))
        slow = has_box & opposite(step.is_near) & is_less(gain, quarter)
        flat = w.volume.is_flat & opposite(is_close(d, near_errors * n.error, n.separation))
        if is_first:
            flat = flat & is_less(zero, greatest_of(w.bow))
        return flat | slow

    @simd.func
    def step_with_facets(
        w: ArcWindow, c: Corners, is_face: bool, turns: Mask, t: Lanes, end: Lanes, step: ArcStep
    ) -> ArcStep:
        """Clip some lanes with the facet that separates farthest, with the sagitta of all of the window."""
        n = w.n
        r = step
        facet = widest_facet(c, step.separation, n.error, is_face, near_errors)
        whole = n.separation + w.bow
        s = clip_facet(n.t0, n.t1, whole, n.error, facet.number, t, end, _FACET_STEPS)
        r.t = greatest(step.t, select(turns & is_less(zero, facet.slack), s, t))
        r.is_near = (turns & is_at_most(facet.floor_excess, zero)) | (opposite(turns) & step.is_near)
        return r


@simd.func
def touch_of(w: ArcWindow, near: LaneClosest, is_face: bool, lanes: Mask, t: Lanes, step: ArcStep) -> ArcTouch:
    """Which of some lanes touch where the clips have led; what rounding hides at the begin stays there.

    On the chord alone, as far as rounding goes, a contact is one of the arcs.
    """
    n = w.n
    r = ArcTouch()
    floor = floor_errors * n.error
    is_sharp = is_within(bow_at(w, step.t), w.slack + n.error)
    is_begin = is_at_most(t, zero)
    r.contact = lanes & (is_sharp | is_begin)
    if bits_of(r.contact) != _NONE:
        stays = is_begin & is_close(near.d, floor, step.separation)
        r.contact = r.contact & (is_sharp | stays)
        r.t = select(stays, t, step.t)
        c = corners_at(n.t0, n.t1, r.t)
        r.point = point_at(c, near.u, near.v, is_face)
        touches = is_close(r.point, floor, step.separation + n.delta)
        if wp.static(not is_euclidean):
            others = r.contact & opposite(touches)
            if bits_of(others) != _NONE:
                # of a patch at the corner of a separation box another point may touch than the closest one
                size = floor + step.separation + n.delta
                number = widest_facet(c, step.separation, n.error, is_face, near_errors).number
                other = touching_point(step.separation, c, number, r.point, size, is_face)
                r.point = select(others, other, r.point)
                touches = is_close(r.point, floor, step.separation + n.delta)
        r.contact = r.contact & touches
    return r


@simd.func
def advance_round(w: ArcWindow, is_face: bool, is_first: bool, reached: ArcReached) -> ArcReached:
    """One round of the lanes that are open.

    Invariant: each pair is free of contact on [0, t).
    """
    n = w.n
    r = reached
    begin = reached.t
    end = spread(one)
    t, free, moving = clip_with_volume(w, mask_of(reached.open), begin, end)
    r.t = t
    r.iterations = select(mask_of(reached.open), reached.iterations + one, reached.iterations)
    r.free = reached.free | bits_of(free)
    r.open = reached.open & ~r.free
    if r.open != _NONE:
        c = corners_at(n.t0, n.t1, t)
        near = closest(c, is_face)
        step = step_along(w, c, near.d, is_face, t)
        open = mask_of(r.open)
        if wp.static(not is_euclidean):
            turns = open & needs_facets(w, near.d, step, step.t - begin, is_first) & opposite(is_less(end, step.t))
            if bits_of(turns) != _NONE:
                step = step_with_facets(w, c, is_face, turns, t, end, step)
        free = open & is_less(end, step.t)
        touch = touch_of(w, near, is_face, open & step.is_near & opposite(moving) & opposite(free), t, step)
        if bits_of(touch.contact) != _NONE:
            step.t = select(touch.contact, touch.t, step.t)
            r.u = select(touch.contact, near.u, r.u)
            r.v = select(touch.contact, near.v, r.v)
            r.point = select(touch.contact, touch.point, r.point)
            r.contact = r.contact | bits_of(touch.contact)
        r.free = r.free | bits_of(free)
        r.t = select(open, step.t, t)
        r.open = r.open & ~r.free & ~r.contact & bits_of(is_less(begin, r.t))
    return r


@simd.func
def advance_on_arcs(
    kind: int,
    at_begin: Points,
    at_end: Points,
    options: LaneOptions,
    sagitta: simd64.Vec3,
    rounding: simd64.Lanes,
    lanes: wp.uint32,
    num_rounds: int,
) -> LaneAnswer:
    """Advance the pairs of the given lanes through a window by some rounds; times are shares of it.

    The sagitta is that of the window, and that of the options what is added to the separation at all times, of which
    this much is for rounding.
    Invariant: each pair is free of contact on [0, t).
    """
    w = window_of(kind, at_begin, at_end, options, sagitta, rounding)
    nothing = spread(zero)
    r = ArcReached()
    r.t = nothing
    r.u = nothing
    r.v = nothing
    r.point = vec(nothing, nothing, nothing)
    r.iterations = nothing
    r.open = w.n.is_valid & lanes
    rounds = int(0)
    while r.open != _NONE and rounds < num_rounds:
        r = advance_round(w, kind == VERTEX_FACE, rounds == 0, r)
        rounds += 1
    answer = LaneAnswer()
    answer.free = r.free
    answer.contact = r.contact
    answer.t = widened(r.t)
    answer.iterations = widened(r.iterations)
    if answer.contact != _NONE:
        answer.gap = gap_at(w.n, r.point)
        answer.u = widened(r.v)
        answer.v = widened(r.u)
        if kind == EDGE_EDGE or kind == POINT_POINT:
            answer.u = widened(r.u)
            answer.v = widened(r.v)
    return answer
