"""The first clips of a pair, for all lanes at once: those of `advance`, without a branch of a lane's own.

A round is one clip with the volume, of a few Newton steps, and one with the direction of the closest pair. It ends with
each lane free, in contact, or further on in time; whatever is still open after a few rounds goes on to the solver for
single pairs, at the time reached. Rounds are numbered for each pair by itself, and no lane looks at another, so a pair
gets the same answer in whatever lane and company it is solved.
"""

import warp as wp

from . import simd
from .ball import clip_turn, is_in_ball, offset, time_to_ball, turn_along, with_largest_one
from .facets import clip_facet, widest_facet
from .inclusion import clip, clip_beyond
from .lane_closest import closest
from .lane_pair import LanePair
from .lane_touch import touching_point
from .norm import is_ball
from .pair_kind import VERTEX_FACE
from .parameters import norm, real, with_facets
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
from .volume import clip_volume

_NONE = wp.constant(wp.uint32(0))
# Clips with the volume in a round: in the first rounds, and at most in the later ones.
_VOLUME_CLIPS = wp.constant(3)
_MOST_VOLUME_CLIPS = wp.constant(8)
# Clips with a facet in a round.
_FACET_STEPS = wp.constant(4)
# Clips with a direction that turns with a side.
_TURN_STEPS = wp.constant(2)


is_euclidean = is_ball(norm)

unit = UNIT_ROUNDOFF[real]
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
settled = wp.constant(real(8.0 * unit))  # a gain of the volume that is rounding only
quarter = wp.constant(real(0.25))
patience = wp.constant(real(3.0))
huge = wp.constant(real(1.0e30))
stall_errors = wp.constant(real(128.0))
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


@simd.func
def needs_facets(n: LanePair, volume: Volume) -> Mask:
    """Whether only the facets of the patch and its separation box bring a pair all the way to a contact."""
    needs = volume.is_flat
    if wp.static(with_facets):
        # a separation of the size of the rounding error is one more margin; a larger one has a box with facets
        needs = needs | opposite(is_within(n.separation, box_errors * n.error))
    return needs


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
class LaneTurn:
    """What the widest facet shows at a time."""

    t: Lanes  # time up to which it separates, 2 if beyond the end
    gap: Lanes  # square of its slack
    number: Lanes  # of the facet
    at_floor: Mask  # whether no facet separates by more than rounding


@simd.func
def turn(n: LanePair, c: Corners, is_face: bool, t: Lanes, end: Lanes) -> LaneTurn:
    """Clip with the widest facet of each lane at time t; the corners are those at t."""
    r = LaneTurn()
    facet = widest_facet(c, n.separation, n.error, is_face)
    s = clip_facet(n.t0, n.t1, n.separation, n.error, facet.number, t, end, _FACET_STEPS)
    r.t = select(is_less(zero, facet.slack), s, t)
    r.gap = facet.slack * facet.slack
    r.number = facet.number
    r.at_floor = is_at_most(facet.floor_excess, zero)
    return r


@simd.func
def point_at(c: Corners, u: Lanes, v: Lanes) -> Vec3:
    """The point of a patch with given weights."""
    cu = one - u
    cv = one - v
    return cu * (cv * c.w00 + v * c.w01) + u * (cv * c.w10 + v * c.w11)


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
def advance_round(
    kind: int, n: LanePair, volume: Volume, has_separation: bool, t_end: real, reached: LaneReached
) -> LaneReached:
    """One round of the lanes that are open.

    Invariant: each pair is free of contact on [0, t).
    """
    is_triangle = kind == VERTEX_FACE
    end = spread(t_end)
    begin = reached.t
    t = begin
    x = end
    free = mask_of(wp.uint32(0))
    is_settled = free
    if wp.static(with_facets):
        # what is still open after the first rounds is mostly a contact: until the volume gains nothing more
        steps = int(0)
        moving = reached.open
        while bits_of(moving) != _NONE and steps < _MOST_VOLUME_CLIPS:
            s, next_x, now_free = clip_volume(volume, n.separation, has_separation, t, x, end)
            free = free | (moving & now_free)
            gains = is_less(settled, s - t)
            t = select(moving, s, t)
            x = select(moving, next_x, x)
            moving = moving & gains & opposite(now_free)
            steps += 1
        is_settled = opposite(moving)
    else:
        last = t
        for _ in range(_VOLUME_CLIPS):
            last = t
            t, x, now_free = clip_volume(volume, n.separation, False, t, x, end)
            free = free | now_free
            if bits_of(reached.open & opposite(free)) == _NONE:
                break
        is_settled = is_at_most(t - last, settled)
    r = reached
    still_open = reached.open & opposite(free)
    if bits_of(still_open) == _NONE:
        # the volume alone has settled all lanes
        r.free = reached.open
        r.contact = still_open
        r.open = still_open
        r.iterations = select(reached.open, reached.iterations + one, reached.iterations)
        return r
    c = corners_at(n.t0, n.t1, t)
    near = closest(c, is_triangle)
    # a smaller gap may consist of rounding errors only
    floor = floor_errors * n.error
    near_floor = stall_errors * n.error
    if wp.static(is_euclidean):
        d = with_largest_one(near.d)
        s = clip_beyond(d, offset(d, n.error, n.separation), t, n.t0, n.t1, is_triangle)
        at_floor = is_in_ball(near.d, floor, n.separation)
        is_near = is_in_ball(near.d, near_floor, n.separation)
        gap = length(near.d) - n.separation.x
        gap = gap * gap
        turns = still_open & is_at_most(s, end) & opposite(at_floor)
        if bits_of(turns) != _NONE:
            velocity = point_at(n.t1, near.u, near.v) - point_at(n.t0, near.u, near.v)
            s = select(turns, greatest(s, clip_ahead(n, c, near.d, velocity, is_triangle, t, end)), s)
    else:
        margin = n.error
        if wp.static(with_facets):
            floor = n.separation + floor
            near_floor = n.separation + near_floor
            margin = n.error + n.separation
        at_floor = is_within(near.d, floor)
        is_near = is_within(near.d, near_floor)
        gap = dot(near.d, near.d)
        s = clip(near.d, margin, t, n.t0, n.t1, is_triangle)
    number = spread(zero)
    if wp.static(with_facets and not is_euclidean):
        turns = still_open & needs_facets(n, volume)
        if bits_of(turns) != _NONE:
            turned = turn(n, c, is_triangle, t, end)
            number = select(turns, turned.number, number)
            s = select(turns, greatest(s, turned.t), s)
            at_floor = (turns & turned.at_floor) | (opposite(turns) & at_floor)
            gap = select(turns, turned.gap, gap)
    has_stalled = is_at_most(patience, reached.slow) & is_near
    claims = (at_floor & is_settled) | has_stalled
    free = free | is_less(end, s)
    point = near.point
    size = floor + n.delta
    is_in_box = is_within(point, size)
    if wp.static(is_euclidean):
        # the point of contact with a ball is the closest one
        is_in_box = is_in_ball(point, floor, n.separation + n.delta)
    if wp.static(with_facets and not is_euclidean):
        # of a patch at the corner of a separation box another point may touch than the closest one
        has_box = opposite(is_within(n.separation, vec(spread(zero), spread(zero), spread(zero))))
        others = still_open & claims & has_box & opposite(is_in_box | free)
        if bits_of(others) != _NONE:
            point = select(others, touching_point(n.separation, c, number, near.point, size, is_triangle), point)
            is_in_box = is_within(point, size)
    contact = still_open & claims & is_in_box & opposite(free)
    r.iterations = select(reached.open, reached.iterations + one, reached.iterations)
    r.u = select(contact, near.u, reached.u)
    r.v = select(contact, near.v, reached.v)
    r.point = select(contact, point, reached.point)
    is_small = is_less(s - begin, quarter * (end - begin))
    is_slow = is_small & is_less(quarter * reached.gap, gap)
    r.slow = select(is_slow, reached.slow + one, reached.slow)
    r.gap = gap
    r.t = select(reached.open, select(contact, t, s), reached.t)
    r.free = reached.open & free
    r.contact = contact
    # a lane that gains nothing needs other tools
    goes_on = is_less(begin, s) & opposite(free | contact)
    r.open = reached.open & goes_on
    return r
