"""The inclusion test: at which times a patch is certainly free of contact.

A patch is the convex hull of four corners that move linearly. For any vector d the minimum of d·W over the patch is
attained at a corner, so the test is exact up to the rounding bound of `rounding`, for every d. Solved for t instead of
evaluated on a box, the test becomes a clip: it gives the whole time interval in which d separates the patch from the
origin.
"""

from types import SimpleNamespace

import warp as wp

from .once import once
from .patch import make_patch
from .rounding import RELATIVE, TINY_DIRECTION, UNIT_ROUNDOFF


@once
def make_inclusion(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    Patch = make_patch(real).Patch
    u = UNIT_ROUNDOFF[real]
    round_up = wp.constant(real(1.0 + RELATIVE * u))
    round_down = wp.constant(real(1.0 - RELATIVE * u))
    tiny_direction = wp.constant(real(TINY_DIRECTION[real]))

    @wp.func
    def offset(d: vec3, margin: vec3) -> real:
        """Upper bound of the exact Σ|d_k|·margin_k (rounding, step 6); the margin is E + separation."""
        return (wp.abs(d[0]) * margin[0] + wp.abs(d[1]) * margin[1] + wp.abs(d[2]) * margin[2]) * round_up

    @wp.func
    def clip_corner(a: real, b: real, off: real, t: real, end: real) -> real:
        """Time up to which one corner stays beyond ``off``, at most ``end``; -1 if it is not beyond it at ``t``.

        a and b are d·W at t = 0 and t = 1 (rounding, step 7).
        """
        if b > off:
            if a > off:
                return end
            if (off - a) / (b - a) * round_up < t:
                return end
            return real(-1.0)
        if a > off:
            return wp.min(end, (a - off) / (a - b) * round_down)
        return real(-1.0)

    @wp.func
    def clip(d: vec3, margin: vec3, t: real, patch: Patch) -> real:
        """Time s >= t such that d separates the patch from the separation box on [t, s); 2 if it does until the end."""
        if wp.max(wp.abs(d)) < tiny_direction:
            return t
        off = offset(d, margin)
        s = clip_corner(wp.dot(d, patch.t0.w00), wp.dot(d, patch.t1.w00), off, t, real(2.0))
        s = clip_corner(wp.dot(d, patch.t0.w01), wp.dot(d, patch.t1.w01), off, t, s)
        s = clip_corner(wp.dot(d, patch.t0.w10), wp.dot(d, patch.t1.w10), off, t, s)
        if not patch.is_triangle:
            s = clip_corner(wp.dot(d, patch.t0.w11), wp.dot(d, patch.t1.w11), off, t, s)
        return wp.max(s, t)

    return SimpleNamespace(clip=clip, clip_corner=clip_corner, offset=offset)
