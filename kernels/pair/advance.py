"""Advance time on one patch, by certified clips, until it is in contact, certainly free, or progress is slow.

Two clips alternate. Each by itself is a lower bound of the time of the earliest contact:

- the volume (`volume`) approaches a simple contact in large steps, however fast the pair rotates;
- the direction of the closest pair at the time reached (`inclusion`) separates the patch from the origin even while the
  volume vanishes.

Together they are Newton's iteration on the gap, from below: it converges quadratically near a simple contact, and every
iterate is a certain lower bound.
"""

import warp as wp

from ..parameters import norm, only_method, real
from .closest_point import closest_on_patch, closest_weights
from .contact_test import point_in_box
from .inclusion import clip, clip_beyond
from .patch import Corners, corners_at, num_sides
from .sub_patch import Patch, Problem
from .volume import clip_volume

# Outcomes of `advance`.
FREE = wp.constant(0)  # no contact in [t_start, t_max]
CONTACT = wp.constant(1)  # a gap within tolerance at the time reached, and no cheap progress beyond it
SLOW = wp.constant(2)  # a gap beyond tolerance, but single directions clip little: subdivide
LIMIT = wp.constant(3)  # iteration limit
_UNDECIDED = wp.constant(-1)

# Clips in a row, far fewer of which are needed.
_VOLUME_STEPS = wp.constant(16)
_FACET_STEPS = wp.constant(12)
# Clips with a direction that turns with a side; beyond a few it is no longer that of the closest pair.
_TURN_STEPS = wp.constant(4)

# An advance stalls at a clip that gains nothing, or after this many small steps since the last stall.
_PATIENCE = wp.constant(3)


is_euclidean = norm.is_ball
vec3 = wp.types.vector(length=3, dtype=real)
floor_errors = wp.constant(real(8.0))


@wp.func
def advance_volume(problem: Problem, t_start: real, t_max: real) -> real:
    """Time up to which the volume keeps its sign from ``t_start`` on: at least that; 2 if beyond ``t_max``."""
    t = t_start
    x = t_max
    for _ in range(_VOLUME_STEPS):
        s, next_x, free = clip_volume(problem.volume, problem.separation, problem.has_separation, t, x, t_max)
        if free:
            return real(2.0)
        if not s > t:
            return t
        t = s
        x = next_x
    return t


@wp.func
def is_within(d: vec3, size: vec3) -> bool:
    """Whether d lies in [-size, size]."""
    return wp.abs(d[0]) <= size[0] and wp.abs(d[1]) <= size[1] and wp.abs(d[2]) <= size[2]


@wp.struct
class Reached:
    """Where an advance ended."""

    t: real
    outcome: int
    iterations: int
    wb: real  # weight of w01 at the closest point
    wc: real  # weight of w10
    from_w11: bool  # whether the rest of the weight is that of w11, else of w00
    point: vec3  # the closest point at t


@wp.func
def point_of(c: Corners, wb: real, wc: real, from_w11: bool) -> vec3:
    """The point with the given weights: a true point of the patch whenever the weights lie on it."""
    origin = c.w00
    if from_w11:
        origin = c.w11
    return origin + wb * (c.w01 - origin) + wc * (c.w10 - origin)


if is_euclidean:
    from .ball import clip_turn, is_in_ball, offset, time_to_ball, turn_along, turn_of_side, with_largest_one

    @wp.func
    def advance_from_ball(
        patch: Patch,
        problem: Problem,
        c: Corners,
        d: vec3,
        velocity: vec3,
        t_start: real,
        t_max: real,
        thorough: bool,
    ) -> real:
        """Clip with the closest pair's direction, now and where the pair reaches the ball, and as it turns with a side.

        d is the closest pair's direction and length at ``t_start``, with the velocity of its point; ``thorough`` tries
        every side.
        """
        separation = problem.separation
        error = problem.error
        h = time_to_ball(d, velocity, separation[0], t_max - t_start)
        ahead = with_largest_one(d + h * velocity)
        d = with_largest_one(d)
        t = clip_beyond(d, offset(d, error, separation), t_start, patch.t0, patch.t1, patch.is_triangle)
        if t > t_max:
            return t
        s = clip_beyond(ahead, offset(ahead, error, separation), t_start, patch.t0, patch.t1, patch.is_triangle)
        t = wp.max(t, s)
        later = corners_at(patch.t0, patch.t1, t_start + h)
        turn = turn_along(c, d, later, ahead, patch.is_face)
        s = clip_turn(patch.t0, patch.t1, separation, error, turn, t_start, t_max, _TURN_STEPS)
        t = wp.max(t, s)
        if thorough:
            for side in range(num_sides(patch.is_face)):
                turn = turn_of_side(side, c, d, patch.is_face)
                s = clip_turn(patch.t0, patch.t1, separation, error, turn, t_start, t_max, _TURN_STEPS)
                t = wp.max(t, s)
        return t

else:
    from .facets import Facet, clip_facet, widest_facet

    if only_method == "clipping":
        from ..narrow_phase.whole_warp import latest, num_shares, number_in_warp

        @wp.func
        def advance_facets(
            patch: Patch, problem: Problem, facet: Facet, t_start: real, t_max: real, thorough: bool
        ) -> real:
            """Clip with facets by the threads of a warp, which share them; one clip in the source: a small kernel."""
            t = t_start
            number = facet.number
            count = int(0)  # of those that are tried after the widest
            k = number_in_warp() - num_shares()
            is_widest = bool(True)
            while is_widest or k < count:
                s = clip_facet(
                    patch.t0, patch.t1, problem.separation, problem.error, number, t_start, t_max, _FACET_STEPS
                )
                if is_widest and (thorough or s <= t_start) and facet.slack > real(0.0):
                    count = 3 + 3 * num_sides(patch.is_face)
                t = wp.max(t, s)
                k += num_shares()
                number = real(k)
                is_widest = False
            if count > 0:
                t = latest(t)
            return t

    else:

        @wp.func
        def advance_facets(
            patch: Patch, problem: Problem, facet: Facet, t_start: real, t_max: real, thorough: bool
        ) -> real:
            """Clip with the widest facet, and with every facet if ``thorough`` or if the widest one gains nothing.

            It may gain nothing because its side vanishes.
            """
            separation = problem.separation
            error = problem.error
            t = clip_facet(patch.t0, patch.t1, separation, error, facet.number, t_start, t_max, _FACET_STEPS)
            if (thorough or t <= t_start) and facet.slack > real(0.0):
                for number in range(3 + 3 * num_sides(patch.is_face)):
                    s = clip_facet(patch.t0, patch.t1, separation, error, real(number), t_start, t_max, _FACET_STEPS)
                    t = wp.max(t, s)
            return t


@wp.func
def contact_at(c: Corners, patch: Patch, size: vec3, floor: vec3, reached: Reached) -> Reached:
    """Search for a true point of the patch in [-size, size]: the closest point if it is inside, else any.

    Where it finds one, it sets the point, its weights and the outcome. Of a ball, size is the radius, beyond which
    the floor comes; the closest point is computed anew without losing digits where the patch is a sliver.
    """
    point = point_of(c, reached.wb, reached.wc, reached.from_w11)
    touches = is_within(point, size)
    if wp.static(is_euclidean):
        touches = is_in_ball(point, floor, size)
        if not touches:
            wb, wc, from_w11 = closest_weights(c.w00, c.w01, c.w10, c.w11, patch.is_triangle)
            reached.wb = wb
            reached.wc = wc
            reached.from_w11 = from_w11
            point = point_of(c, wb, wc, from_w11)
            touches = is_in_ball(point, floor, size)
    elif not touches:
        touches, point, wb, wc = point_in_box(c, patch.narrowing, size)
        if touches:
            reached.wb = wb
            reached.wc = wc
            reached.from_w11 = False
    reached.outcome = _UNDECIDED
    if touches:
        reached.point = point
        reached.outcome = CONTACT
    return reached


@wp.func
def find_contact(patch: Patch, size: vec3, floor: vec3, t: real, is_stalled: bool, reached: Reached) -> Reached:
    """Search for a contact at the time before the last clip, t, and in a stall then at the time reached.

    The later time is reported only if the gap there is within tolerance as well.
    """
    s = reached.t
    for k in range(2):  # one test in the source: a small kernel
        now = wp.where(k == 0, t, s)
        found = contact_at(corners_at(patch.t0, patch.t1, now), patch, size, floor, reached)
        if k == 0 or found.outcome == CONTACT:
            reached = found
        if found.outcome != CONTACT:
            break
        reached.t = now
        if not is_stalled:
            break
    return reached


@wp.func
def advance(patch: Patch, problem: Problem, t_start: real, t_max: real, max_iterations: int) -> Reached:
    """Earliest time at which the patch is not certainly free.

    Invariant: the patch is free of contact on [t_start, t).
    """
    floor = floor_errors * problem.error  # a smaller gap may consist of rounding errors only
    contact_size = problem.separation + problem.delta
    if wp.static(not is_euclidean):
        contact_size = contact_size + floor
    reached = Reached()
    reached.t = t_start
    reached.outcome = _UNDECIDED
    slow = int(0)  # small steps since the last stall
    gap = real(1.0e30)
    margin = problem.error + problem.separation
    # a separation of the size of the rounding error is one more margin; a larger one needs the facets of its box
    use_facets = problem.volume.is_flat or not is_within(problem.separation, real(256.0) * problem.error)
    if wp.static(is_euclidean):
        use_facets = bool(False)  # a ball has none: set after a stall, where every side is tried
    while reached.outcome == _UNDECIDED:
        if reached.iterations >= max_iterations:
            reached.outcome = LIMIT
            break
        reached.iterations += 1

        start = reached.t
        t = advance_volume(problem, start, t_max)
        reached.t = t
        if t > t_max:
            reached.outcome = FREE
            break

        c = corners_at(patch.t0, patch.t1, t)
        at_floor = bool(False)
        new_gap = real(0.0)
        s = t
        if wp.static(is_euclidean):
            d, wb, wc, from_w11 = closest_on_patch(c.w00, c.w01, c.w10, c.w11, patch.is_triangle)
            reached.wb = wb
            reached.wc = wc
            reached.from_w11 = from_w11
            velocity = point_of(patch.t1, wb, wc, from_w11) - point_of(patch.t0, wb, wc, from_w11)
            s = advance_from_ball(patch, problem, c, d, velocity, t, t_max, use_facets or slow > 0)
            at_floor = is_in_ball(d, floor, problem.separation)
            slack = wp.length(d) - problem.separation[0]
            new_gap = slack * slack
        else:
            if use_facets:
                facet = widest_facet(c, problem.separation, problem.error, patch.is_face, floor_errors)
                s = advance_facets(patch, problem, facet, t, t_max, slow > 0)
                at_floor = facet.floor_excess <= real(0.0)
                new_gap = facet.slack * facet.slack
            if not use_facets or at_floor or s <= t or slow > 0:
                d, wb, wc, from_w11 = closest_on_patch(c.w00, c.w01, c.w10, c.w11, patch.is_triangle)
                reached.wb = wb
                reached.wc = wc
                reached.from_w11 = from_w11
                if not use_facets:
                    s = clip(d, margin, t, patch.t0, patch.t1, patch.is_triangle)
                    at_floor = is_within(d, floor + problem.separation)
                    new_gap = wp.dot(d, d)
        if s > t_max:
            reached.outcome = FREE
            break

        if s - start < real(0.25) * (t_max - start) and new_gap > real(0.25) * gap:
            slow += 1
        gap = new_gap
        reached.t = s
        is_stalled = s <= t or slow >= _PATIENCE
        if at_floor or is_stalled:
            reached = find_contact(patch, contact_size, floor, t, not at_floor, reached)
        if is_stalled:
            if reached.outcome == _UNDECIDED and use_facets:
                reached.outcome = SLOW
            use_facets = True  # they may make progress where the direction of the closest pair does not
            slow = 0
    if reached.outcome == LIMIT or reached.outcome == SLOW:
        reached.point = point_of(corners_at(patch.t0, patch.t1, reached.t), reached.wb, reached.wc, reached.from_w11)
    return reached
