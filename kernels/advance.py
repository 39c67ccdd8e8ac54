"""Advance time on one patch, by certified clips, until contact, freedom, or slow progress.

Two clips alternate, each a lower bound of the earliest contact by itself:

- the volume (`volume`), which sees a simple contact from afar, however fast the pair turns;
- the direction of the closest pair at the time reached (`inclusion`), which sees that the patch lies beside the origin
  even while the volume vanishes.

Together they are Newton's iteration on the gap, from below: near a simple contact quadratic, and every iterate certain.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from .closest_point import make_closest_point
from .contact_test import make_contact_test
from .facets import make_facets
from .inclusion import make_inclusion
from .patch import make_patch
from .volume import make_volume

# Outcomes of `advance`.
FREE = wp.constant(0)  # no contact in [t_start, t_max]
CONTACT = wp.constant(1)  # a gap within tolerance at the time reached, and no cheap progress beyond it
SLOW = wp.constant(2)  # a gap beyond tolerance, but single directions clip little: subdivide
LIMIT = wp.constant(3)  # iteration limit

# Small steps in a row before an advance counts as slow.
_PATIENCE = wp.constant(3)


@cache
def make_advance(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Problem = types.Problem
    closest_on_patch = make_closest_point(real).closest_on_patch
    Corners = types.Corners
    reaches_box = make_contact_test(real).reaches_box
    clip = make_inclusion(real).clip
    advance_volume = make_volume(real).advance_volume
    facets = make_facets(real)
    corners_at = facets.corners_at
    widest_facet = facets.widest_facet
    advance_facets = facets.advance_facets

    @wp.func
    def is_within(d: vec3, size: vec3) -> bool:
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
        """The point that the weights name: a real point of the patch, whatever rounding did to them."""
        origin = c.w00
        if from_w11:
            origin = c.w11
        return origin + wb * (c.w01 - origin) + wc * (c.w10 - origin)

    @wp.func
    def is_contact(c: Corners, size: vec3, wb: real, wc: real, from_w11: bool) -> bool:
        """Whether a real point of the patch lies in [-size, size]: the closest one at hand, or else any."""
        return is_within(point_of(c, wb, wc, from_w11), size) or reaches_box(c, size)

    @wp.func
    def advance(patch: Patch, problem: Problem, t_start: real, t_max: real, max_iterations: int) -> Reached:
        """Earliest time of the patch that is not certainly free.

        Invariant: the patch is free of contact on [t_start, t).
        """
        floor = real(8.0) * problem.error  # a smaller gap is beyond what rounding can tell apart
        contact_size = problem.separation + problem.delta + floor
        t = t_start
        outcome = int(-1)
        iterations = int(0)
        slow = int(0)
        gap = real(1.0e30)
        wb = real(0.0)
        wc = real(0.0)
        from_w11 = bool(False)
        use_facets = problem.has_separation or problem.is_flat
        while outcome < 0:
            if iterations >= max_iterations:
                outcome = LIMIT
            else:
                iterations += 1
                start = t
                t = advance_volume(problem, t, t_max)
                if t > t_max:
                    outcome = FREE
                else:
                    c = corners_at(patch, t)
                    d, wb, wc, from_w11 = closest_on_patch(c.w00, c.w01, c.w10, c.w11, patch.is_triangle)
                    if use_facets:
                        facet = widest_facet(c, patch.is_face, problem)
                        s = advance_facets(patch, problem, facet, t, t_max, slow > 0)
                        at_floor = facet.floor_excess <= real(0.0)
                        new_gap = facet.slack * facet.slack
                    else:
                        s = clip(d, problem.error, t, patch)
                        at_floor = is_within(d, floor)
                        new_gap = wp.dot(d, d)
                    if s > t_max:
                        outcome = FREE
                    elif at_floor and is_contact(c, contact_size, wb, wc, from_w11):
                        outcome = CONTACT
                    else:
                        if s - start < real(0.25) * (t_max - start) and new_gap > real(0.25) * gap:
                            slow += 1
                        gap = new_gap
                        if s <= t:
                            slow += _PATIENCE
                        if slow >= _PATIENCE:
                            if is_contact(c, contact_size, wb, wc, from_w11):
                                outcome = CONTACT
                                # the later time stands only if the gap there is within tolerance as well
                                if not is_contact(corners_at(patch, s), contact_size, wb, wc, from_w11):
                                    s = t
                            elif use_facets:
                                outcome = SLOW
                            use_facets = True
                            slow = 0
                        t = s
        reached = Reached()
        reached.t = t
        reached.outcome = outcome
        reached.iterations = iterations
        reached.wb = wb
        reached.wc = wc
        reached.from_w11 = from_w11
        if outcome != FREE:
            reached.point = point_of(corners_at(patch, t), wb, wc, from_w11)
        return reached

    return SimpleNamespace(Reached=Reached, advance=advance, point_of=point_of)
