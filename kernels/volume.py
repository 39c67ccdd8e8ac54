"""The volume f(t) = P·(Q×R) as an inclusion function: an interval of time in which it keeps its sign is free of contact.

A contact makes P, Q, R linearly dependent, so f = 0 is necessary for one, wherever it lies on the patch. With a
separation box, n·F = f for the moving normal n = Q×R, so |f| ≤ Σ separation_k·|n_k| is necessary. f is a cubic in t; in
Bernstein form its hull bounds it on any interval, and the crossing of the hull is a clip of time that converges
quadratically to a simple root, from below. No root is ever *found* here: the univariate method decides with the roots
and misses collisions, this one only skips times at which f is certainly not zero. Where f vanishes altogether (motion
in one plane) it skips nothing, and the directions of `inclusion` do the work.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from .rounding import RELATIVE, TINY, UNIT_ROUNDOFF, VOLUME


@cache
def make_volume(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    vec4 = wp.types.vector(length=4, dtype=real)
    volume_bound = wp.constant(real(VOLUME * UNIT_ROUNDOFF[real]))
    tiny = wp.constant(real(TINY[real]))
    third = wp.constant(real(1.0 / 3.0))
    half = wp.constant(real(0.5))
    round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
    fraction_down = wp.constant(real(1.0 - 4.0 * RELATIVE * UNIT_ROUNDOFF[real]))

    @wp.func
    def permanent(p: vec3, q: vec3, r: vec3) -> real:
        """Sum of the magnitudes of the six products of a determinant."""
        return (
            p[0] * (q[1] * r[2] + q[2] * r[1])
            + p[1] * (q[0] * r[2] + q[2] * r[0])
            + p[2] * (q[0] * r[1] + q[1] * r[0])
        )

    @wp.func
    def max_abs(a: vec3, b: vec3) -> vec3:
        return vec3(
            wp.max(wp.abs(a[0]), wp.abs(b[0])),
            wp.max(wp.abs(a[1]), wp.abs(b[1])),
            wp.max(wp.abs(a[2]), wp.abs(b[2])),
        )

    @wp.func
    def volume_coefficients(p0: vec3, q0: vec3, r0: vec3, p1: vec3, q1: vec3, r1: vec3, separation: vec3):
        """Bernstein coefficients of f on [0, 1], and the bound below which |f| proves nothing (rounding, step 9)."""
        n0 = wp.cross(q0, r0)
        n1 = wp.cross(q1, r1)
        nm = half * (wp.cross(q0, r1) + wp.cross(q1, r0))
        m0 = wp.dot(p0, nm)
        m1 = wp.dot(p1, nm)
        b = vec4(
            wp.dot(p0, n0), third * (wp.dot(p1, n0) + m0 + m0), third * (wp.dot(p0, n1) + m1 + m1), wp.dot(p1, n1)
        )
        q = max_abs(q0, q1)
        r = max_abs(r0, r1)
        # |n_k| of the rounded coefficients is at most (1 + 8u) of these sums
        n = vec3(q[1] * r[2] + q[2] * r[1], q[2] * r[0] + q[0] * r[2], q[0] * r[1] + q[1] * r[0])
        bound = volume_bound * permanent(max_abs(p0, p1), q, r) + tiny
        if separation[0] > real(0.0) or separation[1] > real(0.0) or separation[2] > real(0.0):
            m = max_abs(max_abs(n0, n1), nm)
            bound += wp.dot(separation, m + volume_bound * n) * (real(2.0) - round_down)
        return b, bound

    @wp.func
    def crossing(i: real, a: real, j: real, b: real, first: real) -> real:
        """Where the segment between two control points falls to zero, if it does, else ``first``."""
        if a > real(0.0) and b <= real(0.0):
            return wp.min(first, (i + (j - i) * (a / (a - b))))
        return first

    @wp.func
    def hull_crossing(b: vec4) -> real:
        """First zero of the convex hull of four control points at 0, 1, 2, 3, b[0] > 0; 4 if there is none."""
        first = real(4.0)
        if b[1] <= real(0.0) or b[2] <= real(0.0) or b[3] <= real(0.0):
            first = crossing(real(0.0), b[0], real(1.0), b[1], first)
            first = crossing(real(0.0), b[0], real(2.0), b[2], first)
            first = crossing(real(0.0), b[0], real(3.0), b[3], first)
            first = crossing(real(1.0), b[1], real(2.0), b[2], first)
            first = crossing(real(1.0), b[1], real(3.0), b[3], first)
            first = crossing(real(2.0), b[2], real(3.0), b[3], first)
        return first

    @wp.func
    def restrict(b: vec4, t: real, x: real) -> vec4:
        """Bernstein coefficients on [t, x]: the blossom of b."""
        ct = real(1.0) - t
        cx = real(1.0) - x
        t0 = ct * b[0] + t * b[1]
        t1 = ct * b[1] + t * b[2]
        t2 = ct * b[2] + t * b[3]
        x0 = cx * b[0] + x * b[1]
        x1 = cx * b[1] + x * b[2]
        x2 = cx * b[2] + x * b[3]
        tt0 = ct * t0 + t * t1
        tt1 = ct * t1 + t * t2
        tx0 = cx * t0 + x * t1
        tx1 = cx * t1 + x * t2
        xx0 = cx * x0 + x * x1
        xx1 = cx * x1 + x * x2
        return vec4(ct * tt0 + t * tt1, cx * tt0 + x * tt1, cx * tx0 + x * tx1, cx * xx0 + x * xx1)

    @wp.func
    def advance_volume(b: vec4, bound: real, t_start: real, t_max: real) -> real:
        """Time up to which f keeps its sign from ``t_start`` on: at least ``t_start``; 2 if beyond ``t_max``."""
        t = t_start
        x = t_max
        for _ in range(16):
            c = restrict(b, t, x)
            if c[0] < real(0.0):
                c = -c
            c = vec4(c[0] - bound, c[1] - bound, c[2] - bound, c[3] - bound)
            if not c[0] > real(0.0):
                return t
            first = hull_crossing(c)
            if first >= real(4.0):
                if x >= t_max:
                    return real(2.0)
                step = x - t
                t = x
                x = wp.min(t_max, t + real(4.0) * step)
            else:
                # the fraction of [t, x] is rounded down and never reaches the crossing
                s = (t + (x - t) * (first * third) * fraction_down) * round_down
                if not s > t:
                    return t
                newton = real(2.0) * (s - t)
                t = s
                x = wp.min(t_max, t + newton)
        return t

    return SimpleNamespace(volume_coefficients=volume_coefficients, advance_volume=advance_volume)
