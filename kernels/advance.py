"""Advance time on one patch, by certified clips, until it is in contact, certainly free, or progress is slow.

Two clips alternate. Each by itself is a lower bound of the time of the earliest contact:

- the volume (`volume`) approaches a simple contact in large steps, however fast the pair rotates;
- the direction of the closest pair at the time reached (`inclusion`) separates the patch from the origin even while the
  volume vanishes.

Together they are Newton's iteration on the gap, from below: it converges quadratically near a simple contact, and every
iterate is a certain lower bound.
"""

from types import SimpleNamespace

import warp as wp

from .closest_point import make_closest_point
from .contact_test import make_contact_test
from .facets import make_facets
from .inclusion import make_inclusion
from .once import once
from .patch import make_patch
from .volume import make_volume

# Outcomes of `advance`.
FREE = wp.constant(0)  # no contact in [t_start, t_max]
CONTACT = wp.constant(1)  # a gap within tolerance at the time reached, and no cheap progress beyond it
SLOW = wp.constant(2)  # a gap beyond tolerance, but single directions clip little: subdivide
LIMIT = wp.constant(3)  # iteration limit
_UNDECIDED = wp.constant(-1)

# An advance stalls at a clip that gains nothing, or after this many small steps since the last stall.
_PATIENCE = wp.constant(3)


@once
def make_advance(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Problem = types.Problem
    closest_on_patch = make_closest_point(real).closest_on_patch
    Corners = types.Corners
    point_in_box = make_contact_test(real).point_in_box
    clip = make_inclusion(real).clip
    advance_volume = make_volume(real).advance_volume
    facets = make_facets(real)
    corners_at = facets.corners_at
    widest_facet = facets.widest_facet
    advance_facets = facets.advance_facets

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

    @wp.func
    def find_contact(c: Corners, patch: Patch, size: vec3, reached: Reached) -> Reached:
        """Search for a true point of the patch in [-size, size]: the closest point if it is inside, else any.

        Where it finds one, it sets the point, its weights and the outcome.
        """
        point = point_of(c, reached.wb, reached.wc, reached.from_w11)
        found = is_within(point, size)
        if not found:
            found, point, wb, wc = point_in_box(c, patch.narrowing, size)
            if found:
                reached.wb = wb
                reached.wc = wc
                reached.from_w11 = False
        if found:
            reached.point = point
            reached.outcome = CONTACT
        return reached

    @wp.func
    def find_contact_at_stall(c: Corners, patch: Patch, size: vec3, t: real, reached: Reached) -> Reached:
        """Search for a contact at the time before the last clip, t, and then at the time reached.

        The later time is reported only if the gap there is within tolerance as well.
        """
        here = find_contact(c, patch, size, reached)
        if here.outcome != CONTACT:
            return here
        here.outcome = _UNDECIDED
        later = find_contact(corners_at(patch, here.t), patch, size, here)
        if later.outcome == CONTACT:
            return later
        here.outcome = CONTACT
        here.t = t
        return here

    @wp.func
    def advance(patch: Patch, problem: Problem, t_start: real, t_max: real, max_iterations: int) -> Reached:
        """Earliest time at which the patch is not certainly free.

        Invariant: the patch is free of contact on [t_start, t).
        """
        floor = real(8.0) * problem.error  # a smaller gap may consist of rounding errors only
        contact_size = problem.separation + problem.delta + floor
        reached = Reached()
        reached.t = t_start
        reached.outcome = _UNDECIDED
        slow = int(0)  # small steps since the last stall
        gap = real(1.0e30)
        margin = problem.error + problem.separation
        # a separation of the size of the rounding error is one more margin; a larger one needs the facets of its box
        use_facets = problem.is_flat or not is_within(problem.separation, real(256.0) * problem.error)
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

            c = corners_at(patch, t)
            at_floor = bool(False)
            new_gap = real(0.0)
            s = t
            if use_facets:
                facet = widest_facet(c, patch.is_face, problem)
                s = advance_facets(patch, problem, facet, t, t_max, slow > 0)
                at_floor = facet.floor_excess <= real(0.0)
                new_gap = facet.slack * facet.slack
            if not use_facets or at_floor or s <= t or slow > 0:
                d, wb, wc, from_w11 = closest_on_patch(c.w00, c.w01, c.w10, c.w11, patch.is_triangle)
                reached.wb = wb
                reached.wc = wc
                reached.from_w11 = from_w11
                if not use_facets:
                    s = clip(d, margin, t, patch)
                    at_floor = is_within(d, floor + problem.separation)
                    new_gap = wp.dot(d, d)
            if s > t_max:
                reached.outcome = FREE
                break

            if at_floor:
                reached = find_contact(c, patch, contact_size, reached)
                if reached.outcome == CONTACT:
                    break

            if s - start < real(0.25) * (t_max - start) and new_gap > real(0.25) * gap:
                slow += 1
            gap = new_gap
            reached.t = s
            is_stalled = s <= t or slow >= _PATIENCE
            if is_stalled:
                reached = find_contact_at_stall(c, patch, contact_size, t, reached)
                if reached.outcome == _UNDECIDED and use_facets:
                    reached.outcome = SLOW
                use_facets = True  # they may make progress where the direction of the closest pair does not
                slow = 0
        if reached.outcome == LIMIT or reached.outcome == SLOW:
            reached.point = point_of(corners_at(patch, reached.t), reached.wb, reached.wc, reached.from_w11)
        return reached

    return SimpleNamespace(Reached=Reached, advance=advance, point_of=point_of)
