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
from .lane_closest import closest
from .lane_pair import LanePair, normalise, volume_of
from .lane_solver import LaneAnswer, gap_at
from .pair_options import LaneOptions
from .patch import Volume, corners_at
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
    is_face = kind == VERTEX_FACE
    n = normalise(kind, at_begin, at_end, options)
    bow64 = simd64.scaled(sagitta, n.scale)
    open = n.is_valid & lanes & simd64.bits_of(simd64.is_less(simd64.greatest_of(bow64), far))
    slack64 = simd64.scaled(simd64.vec(rounding, rounding, rounding), n.scale)
    slack = vec(narrowed(slack64.x), narrowed(slack64.y), narrowed(slack64.z))
    bow = sagitta_up * vec(narrowed(bow64.x), narrowed(bow64.y), narrowed(bow64.z))
    volume = volume_of(kind, at_begin, at_end, n, n.separation + (bow + bow), True)
    reach = bow_reach(volume, n.separation, bow)
    t = spread(zero)
    end = spread(one)
    iterations = t
    u = t
    v = t
    touched = vec(t, t, t)
    answer = LaneAnswer()
    rounds = int(0)
    while open != _NONE and rounds < num_rounds:
        begin = t
        moving = mask_of(open)
        iterations = select(moving, iterations + one, iterations)
        free = mask_of(_NONE)
        x = end
        clips = int(0)
        while bits_of(moving) != _NONE and clips < _VOLUME_CLIPS:
            s, next_x, now_free = clip_with_reach(volume, reach, t, x, end)
            free = free | (moving & now_free)
            gains = is_less(settled, s - t)
            t = select(moving, s, t)
            x = select(moving, next_x, x)
            moving = moving & gains & opposite(now_free)
            clips += 1
        answer.free = answer.free | bits_of(free)
        open = open & ~answer.free
        if open != _NONE:
            c = corners_at(n.t0, n.t1, t)
            near = closest(c, is_face)
            local = (four * t * (one - t)) * bow
            separation = n.separation + local
            d = direction_of(near.d)
            off = offset(d, n.error, n.separation)
            s = clip_bow(d, off, (four * round_up) * support(bow, d), t, n, is_face)
            still = mask_of(open)
            free = still & is_less(end, s)
            floor = floor_errors * n.error
            # where the patch meets a corner of the box, its closest point is farther than a side of the box
            most = four * greatest_of(slack + local)
            is_near = is_close(near.d, near_errors * n.error + vec(most, most, most), separation)
            if wp.static(not is_euclidean):
                # as on straight paths, with the sagitta of all of the window, where the others gain little
                has_box = opposite(is_within(n.separation, two * slack + box_errors * n.error))
                slow = has_box & opposite(is_near) & is_less(s - begin, quarter)
                touches = is_close(near.d, near_errors * n.error, n.separation)
                flat = volume.is_flat & opposite(touches)
                if rounds == 0:
                    flat = flat & is_less(zero, greatest_of(bow))
                turns = still & (flat | slow) & opposite(free)
                if bits_of(turns) != _NONE:
                    facet = widest_facet(c, separation, n.error, is_face, near_errors)
                    whole = n.separation + bow
                    turned = clip_facet(n.t0, n.t1, whole, n.error, facet.number, t, end, _FACET_STEPS)
                    turned = select(turns & is_less(zero, facet.slack), turned, t)
                    s = greatest(s, turned)
                    is_near = (turns & is_at_most(facet.floor_excess, zero)) | (opposite(turns) & is_near)
                    free = still & is_less(end, s)
            # on the chord alone, as far as rounding goes, a contact is one of the arcs
            is_sharp = is_within((four * s * (one - s)) * bow, slack + n.error)
            is_begin = is_at_most(t, zero)
            contact = still & is_near & opposite(moving) & opposite(free) & (is_sharp | is_begin)
            if bits_of(contact) != _NONE:
                stays = is_begin & is_close(near.d, floor, separation)
                contact = contact & (is_sharp | stays)
                at = select(stays, t, s)
                c = corners_at(n.t0, n.t1, at)
                point = point_at(c, near.u, near.v, is_face)
                touches = is_close(point, floor, separation + n.delta)
                if wp.static(not is_euclidean):
                    others = contact & opposite(touches)
                    if bits_of(others) != _NONE:
                        # of a patch at the corner of a separation box another point may touch than the closest one
                        size = floor + separation + n.delta
                        number = widest_facet(c, separation, n.error, is_face, near_errors).number
                        point = select(others, touching_point(separation, c, number, point, size, is_face), point)
                        touches = is_close(point, floor, separation + n.delta)
                contact = contact & touches
                s = select(contact, at, s)
                u = select(contact, near.u, u)
                v = select(contact, near.v, v)
                touched = select(contact, point, touched)
                answer.contact = answer.contact | bits_of(contact)
            answer.free = answer.free | bits_of(free)
            t = select(still, s, t)
            open = open & ~answer.free & ~answer.contact & bits_of(is_less(begin, t))
        rounds += 1
    answer.t = widened(t)
    answer.iterations = widened(iterations)
    if answer.contact != _NONE:
        answer.gap = gap_at(n, touched)
        answer.u = widened(v)
        answer.v = widened(u)
        if kind == EDGE_EDGE or kind == POINT_POINT:
            answer.u = widened(u)
            answer.v = widened(v)
    return answer
