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
    clip = make_inclusion(real).clip
    advance_volume = make_volume(real).advance_volume

    @wp.func
    def is_within(d: vec3, size: vec3) -> bool:
        return wp.abs(d[0]) <= size[0] and wp.abs(d[1]) <= size[1] and wp.abs(d[2]) <= size[2]

    @wp.func
    def clamp_to(q: vec3, box: vec3) -> vec3:
        return vec3(
            wp.clamp(q[0], -box[0], box[0]), wp.clamp(q[1], -box[1], box[1]), wp.clamp(q[2], -box[2], box[2])
        )

    @wp.func
    def closest_pair(patch: Patch, t: real, separation: vec3):
        """Vector from the separation box to the patch at time t, and where on the patch it ends."""
        p00 = patch.t0.w00 + t * (patch.t1.w00 - patch.t0.w00)
        p01 = patch.t0.w01 + t * (patch.t1.w01 - patch.t0.w01)
        p10 = patch.t0.w10 + t * (patch.t1.w10 - patch.t0.w10)
        p11 = patch.t0.w11 + t * (patch.t1.w11 - patch.t0.w11)
        q, wb, wc, from_w11 = closest_on_patch(p00, p01, p10, p11, patch.is_triangle)
        d = q
        if separation[0] > real(0.0) or separation[1] > real(0.0) or separation[2] > real(0.0):
            # alternate projections converge to the closest pair of the two convex sets
            for _ in range(3):
                c = clamp_to(q, separation)
                d, wb, wc, from_w11 = closest_on_patch(p00 - c, p01 - c, p10 - c, p11 - c, patch.is_triangle)
                q = d + c
            d = q - clamp_to(q, separation)
        return d, wb, wc, from_w11

    @wp.func
    def advance(patch: Patch, problem: Problem, t_start: real, t_max: real, max_iterations: int):
        """Earliest time of the patch that is not certainly free.

        Invariant: the patch is free of contact on [t_start, t).
        Returns t, outcome, iterations, weights of w01 and w10 at t, whether they count from w11.
        """
        margin = problem.error + problem.separation
        floor = real(8.0) * problem.error  # a smaller gap is beyond what rounding can tell apart
        t = t_start
        outcome = int(-1)
        iterations = int(0)
        slow = int(0)
        gap = real(1.0e30)
        wb = real(0.0)
        wc = real(0.0)
        from_w11 = bool(False)
        while outcome < 0:
            if iterations >= max_iterations:
                outcome = LIMIT
            else:
                iterations += 1
                start = t
                t = advance_volume(problem.volume, problem.volume_bound, t, t_max)
                if t > t_max:
                    outcome = FREE
                else:
                    d, wb, wc, from_w11 = closest_pair(patch, t, problem.separation)
                    s = clip(d, margin, t, patch)
                    new_gap = wp.dot(d, d)
                    if s > t_max:
                        outcome = FREE
                    elif is_within(d, floor):
                        outcome = CONTACT
                    else:
                        if s - start < real(0.25) * (t_max - start) and new_gap > real(0.25) * gap:
                            slow += 1
                        gap = new_gap
                        if s <= t:
                            slow += _PATIENCE
                        if slow >= _PATIENCE:
                            outcome = SLOW
                            if is_within(d, problem.delta):
                                outcome = CONTACT
                        t = s
        return t, outcome, iterations, wb, wc, from_w11

    return SimpleNamespace(advance=advance)
