"""The first clips of a pair, for all lanes at once: those of `advance`, without a branch of a lane's own.

A round is one clip with the volume, of a few Newton steps, and one with the direction of the closest pair. It ends with
each lane free, in contact, or further on in time; whatever is still open after a few rounds goes on to the solver for
single pairs, at the time reached. Rounds are numbered for each pair by itself, and no lane looks at another, so a pair
gets the same answer in whatever lane and company it is solved.
"""

import warp as wp

from ..pair_kind import VERTEX_FACE
from ..parameters import norm, real, with_facets
from . import simd
from .inclusion import clip, clip_beyond
from .lane_closest import LaneClosest, closest
from .lane_pair import LanePair
from .lane_touch import touching_point
from .patch import Corners, Volume, corners_at
from .rounding import UNIT_ROUNDOFF
from .simd import (
    Lanes,
    Mask,
    Vec3,
    bits_of,
    dot,
    greatest,
    is_at_most,
    is_less,
    is_within,
    mask_of,
    opposite,
    select,
    spread,
    vec,
)
from .support import length
from .volume import above_bound, clip_hull, clip_volume, lowered, reach_of, restrict, whole

_NONE = wp.constant(wp.uint32(0))
# Clips with the volume in a round: in the first rounds, and at most in the later ones.
_VOLUME_CLIPS = wp.constant(3)
_MOST_VOLUME_CLIPS = wp.constant(8)
# Clips with a facet in a round.
_FACET_STEPS = wp.constant(4)
# Clips with a direction that turns with a side.
_TURN_STEPS = wp.constant(2)


is_euclidean = norm.is_ball
by_pair = norm.is_by_pair

unit = UNIT_ROUNDOFF[real]
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
settled = wp.constant(real(8.0 * unit))  # a gain of the volume that is rounding only
quarter = wp.constant(real(0.25))
patience = wp.constant(real(3.0))
huge = wp.constant(real(1.0e30))
# Rounding bounds of a gap below which a pair is near: the next clip leads to the contact, if there is one.
near_errors = wp.constant(real(128.0))
box_errors = wp.constant(real(256.0))
floor_errors = wp.constant(real(8.0))


@wp.struct
class LaneReached:
    """Where the lanes are."""

    t: Lanes
    u: Lanes  # weights of the contact
    v: Lanes
    point: Vec3
    iterations: Lanes
    gap: Lanes  # squared length of the last direction
    slow: Lanes  # rounds with little progress
    open: Mask
    free: Mask
    contact: Mask
    is_regular: Mask  # whether the weights of the contact are those of the closest point (`lane_closest`)


@simd.func
def start(t: Lanes, open: wp.uint32) -> LaneReached:
    """Lanes at a time, of which some are open."""
    r = LaneReached()
    r.t = t
    r.open = mask_of(open)
    r.iterations = spread(zero)
    r.gap = spread(huge)
    r.slow = spread(zero)
    return r


@wp.struct
class LaneStep:
    """What the direction of the closest pair shows at a time t."""

    t: Lanes  # time up to which it separates, 2 if beyond the end
    gap: Lanes  # square of the gap
    number: Lanes  # of the facet that separates farthest, where one is taken
    floor: Vec3  # size of the closest point below which the gap may consist of rounding errors only
    is_near: Mask  # whether the gap is few times as large


@simd.func
def point_at(c: Corners, u: Lanes, v: Lanes, is_face: bool) -> Vec3:
    """The point of a patch with given weights."""
    cu = one - u
    cv = one - v
    point = cu * (cv * c.w00 + v * c.w01) + u * (cv * c.w10 + v * c.w11)
    if is_face:
        point = (cu - v) * c.w00 + v * c.w01 + u * c.w10
    return point


if is_euclidean:
    from .ball import clip_turn, is_in_ball, offset, time_to_ball, turn_along, with_largest_one

    @simd.func
    def clip_ahead(n: LanePair, c: Corners, d: Vec3, velocity: Vec3, is_face: bool, t: Lanes, end: Lanes) -> Lanes:
        """Clip with the direction that the closest pair will have where it reaches the ball, fixed and turning.

        d is its direction and length at t, with the velocity of its point; c are the corners at t.
        """
        h = time_to_ball(d, velocity, n.separation.x, end - t)
        ahead = with_largest_one(d + h * velocity)
        s = clip_beyond(ahead, offset(ahead, n.error, n.separation), t, n.t0, n.t1, is_face)
        side = turn_along(c, with_largest_one(d), corners_at(n.t0, n.t1, t + h), ahead, is_face)
        turned = clip_turn(n.t0, n.t1, n.separation, n.error, side, t, end, _TURN_STEPS)
        return greatest(s, turned)

    @simd.func
    def step_from(
        n: LanePair, volume: Volume, c: Corners, near: LaneClosest, is_face: bool, open: Mask, t: Lanes, end: Lanes
    ) -> LaneStep:
        """Clip the open lanes beyond the ball; c are the corners at t, and near their closest point."""
        r = LaneStep()
        r.number = spread(zero)
        r.floor = floor_errors * n.error
        r.is_near = is_in_ball(near.d, near_errors * n.error, n.separation)
        gap = length(near.d) - n.separation.x
        r.gap = gap * gap
        d = with_largest_one(near.d)
        r.t = clip_beyond(d, offset(d, n.error, n.separation), t, n.t0, n.t1, is_face)
        if wp.static(with_facets):
            turns = open & is_at_most(r.t, end) & opposite(r.is_near)
            if bits_of(turns) != _NONE:
                velocity = point_at(n.t1, near.u, near.v, is_face) - point_at(n.t0, near.u, near.v, is_face)
                r.t = select(turns, greatest(r.t, clip_ahead(n, c, near.d, velocity, is_face, t, end)), r.t)
        return r

    @simd.func
    def is_contact(n: LanePair, point: Vec3, floor: Vec3) -> Mask:
        """Whether the gap at a point is at most the tolerance."""
        return is_in_ball(point, floor, n.separation + n.delta)

    @simd.func
    def is_at_floor(n: LanePair, d: Vec3, floor: Vec3) -> Mask:
        """Whether a gap may consist of rounding errors only."""
        return is_in_ball(d, floor, n.separation)

else:

    @simd.func
    def is_contact(n: LanePair, point: Vec3, floor: Vec3) -> Mask:
        """Whether the gap at a point is at most the tolerance."""
        return is_within(point, floor + n.delta)

    @simd.func
    def is_at_floor(n: LanePair, d: Vec3, floor: Vec3) -> Mask:
        """Whether a gap may consist of rounding errors only."""
        return is_within(d, floor)


if with_facets and not is_euclidean:
    from .facets import clip_facet, widest_facet

    @simd.func
    def needs_facets(n: LanePair, volume: Volume) -> Mask:
        """Whether only the facets of the patch and its separation box bring a pair all the way to a contact."""
        # a separation of the size of the rounding error is one more margin; a larger one has a box with facets
        if wp.static(by_pair):
            return volume.is_flat | opposite(is_within(n.separation, box_errors * n.error))
        return volume.is_flat

    @simd.func
    def step_from(
        n: LanePair, volume: Volume, c: Corners, near: LaneClosest, is_face: bool, open: Mask, t: Lanes, end: Lanes
    ) -> LaneStep:
        """Clip the open lanes beyond the separation box, of which some take the facet that separates farthest."""
        r = LaneStep()
        r.number = spread(zero)
        r.floor = n.separation + floor_errors * n.error
        r.is_near = is_within(near.d, n.separation + near_errors * n.error)
        r.gap = dot(near.d, near.d)
        r.t = clip(near.d, n.error + n.separation, t, n.t0, n.t1, is_face)
        turns = open & needs_facets(n, volume)
        if bits_of(turns) != _NONE:
            facet = widest_facet(c, n.separation, n.error, is_face, near_errors)
            s = clip_facet(n.t0, n.t1, n.separation, n.error, facet.number, t, end, _FACET_STEPS)
            r.number = select(turns, facet.number, r.number)
            r.t = select(turns, greatest(r.t, select(is_less(zero, facet.slack), s, t)), r.t)
            r.is_near = (turns & is_at_most(facet.floor_excess, zero)) | (opposite(turns) & r.is_near)
            r.gap = select(turns, facet.slack * facet.slack, r.gap)
        return r

elif not is_euclidean:

    @simd.func
    def step_from(
        n: LanePair, volume: Volume, c: Corners, near: LaneClosest, is_face: bool, open: Mask, t: Lanes, end: Lanes
    ) -> LaneStep:
        """Clip pairs without a separation, or with the closest pair's direction alone."""
        r = LaneStep()
        r.number = spread(zero)
        margin = n.error
        r.floor = floor_errors * n.error
        near_by = near_errors * n.error
        if wp.static(by_pair):
            margin = margin + n.separation
            r.floor = r.floor + n.separation
            near_by = near_by + n.separation
        r.is_near = is_within(near.d, near_by)
        r.gap = dot(near.d, near.d)
        r.t = clip(near.d, margin, t, n.t0, n.t1, is_face)
        return r


if with_facets:

    @simd.func
    def clip_with_volume(n: LanePair, volume: Volume, open: Mask, t: Lanes, end: Lanes, is_whole: bool):
        """Clip open lanes until the volume gains nothing more: in later rounds most are about to be contacts.

        None of these rounds is ``is_whole``.

        Returns the time reached, which lanes are free until the end, and those in which it gains nothing more.
        """
        x = end
        free = mask_of(_NONE)
        moving = open
        steps = int(0)
        while bits_of(moving) != _NONE and steps < _MOST_VOLUME_CLIPS:
            s, next_x, now_free = clip_volume(volume, n.separation, wp.static(by_pair), t, x, end)
            free = free | (moving & now_free)
            gains = is_less(settled, s - t)
            t = select(moving, s, t)
            x = select(moving, next_x, x)
            moving = moving & gains & opposite(now_free)
            steps += 1
        return t, free, opposite(moving)

else:

    @simd.func
    def clip_with_volume(n: LanePair, volume: Volume, open: Mask, t: Lanes, end: Lanes, is_whole: bool):
        """Clip all lanes a few times; where ``is_whole`` says so, from t = 0 on and to 1.

        Returns the time reached, which lanes are free until the end, and those in which it gains nothing more.
        """
        x = end
        free = mask_of(_NONE)
        last = t
        if wp.static(by_pair):
            reach = reach_of(volume, n.separation)
        for k in range(_VOLUME_CLIPS):
            last = t
            h = whole(volume)
            if wp.static(by_pair):
                kept = whole(reach)
            if k > 0 or not is_whole:
                h = restrict(volume, t, x)
                if wp.static(by_pair):
                    kept = restrict(reach, t, x)
            h = above_bound(volume, h)
            if wp.static(by_pair):
                h = lowered(h, kept)
            t, x, now_free = clip_hull(h, t, x, end)
            free = free | now_free
            if bits_of(open & opposite(free)) == _NONE:
                break
        return t, free, is_at_most(t - last, settled)


@simd.func
def advance_round(
    kind: int, n: LanePair, volume: Volume, t_end: real, is_whole: bool, reached: LaneReached
) -> LaneReached:
    """One round of the lanes that are open.

    Invariant: each pair is free of contact on [0, t).
    """
    is_face = kind == VERTEX_FACE
    end = spread(t_end)
    t, free, is_settled = clip_with_volume(n, volume, reached.open, reached.t, end, is_whole)
    r = reached
    r.iterations = select(reached.open, reached.iterations + one, reached.iterations)
    still_open = reached.open & opposite(free)
    if bits_of(still_open) == _NONE:
        # the volume alone has settled all lanes
        r.free = reached.open
        r.contact = still_open
        r.open = still_open
        return r
    c = corners_at(n.t0, n.t1, t)
    near = closest(c, is_face)
    step = step_from(n, volume, c, near, is_face, still_open, t, end)
    free = free | is_less(end, step.t)
    has_stalled = is_at_most(patience, reached.slow)
    contact = still_open & step.is_near & (is_settled | has_stalled) & opposite(free)
    if bits_of(contact) != _NONE:
        # where the clip has led, which is free until then; what rounding hides at the start stays there
        stays = is_at_most(t, zero) & is_at_floor(n, near.d, step.floor)
        at = select(stays, t, step.t)
        c = corners_at(n.t0, n.t1, at)
        point = point_at(c, near.u, near.v, is_face)
        touches = is_contact(n, point, step.floor)
        if wp.static(with_facets and by_pair and not is_euclidean):
            # of a patch at the corner of a separation box another point may touch than the closest one
            has_box = opposite(is_within(n.separation, vec(spread(zero), spread(zero), spread(zero))))
            others = contact & has_box & opposite(touches)
            if bits_of(others) != _NONE:
                size = step.floor + n.delta
                point = select(others, touching_point(n.separation, c, step.number, point, size, is_face), point)
                touches = is_contact(n, point, step.floor)
        contact = contact & touches
        step.t = select(contact, at, step.t)
        r.u = select(contact, near.u, reached.u)
        r.v = select(contact, near.v, reached.v)
        r.point = select(contact, point, reached.point)
        r.is_regular = reached.is_regular | (contact & near.is_regular)
    is_small = is_less(step.t - reached.t, quarter * (end - reached.t))
    is_slow = is_small & is_less(quarter * reached.gap, step.gap)
    r.slow = select(is_slow, reached.slow + one, reached.slow)
    r.gap = step.gap
    r.t = select(reached.open, step.t, reached.t)
    r.free = reached.open & free
    r.contact = contact
    # a lane that gains nothing needs other tools
    r.open = reached.open & is_less(reached.t, step.t) & opposite(free | contact)
    return r
