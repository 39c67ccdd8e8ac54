"""The volume f(t) = P·(Q×R) as an inclusion function: as long as it keeps its sign there is no contact.

A contact makes P, Q, R linearly dependent, so f = 0 is necessary for a contact anywhere on the patch. With a separation
box, n·F = f for the moving normal n = Q×R, so |f| ≤ Σ separation_k·|n_k| is necessary. f is a cubic in t. The convex
hull of its Bernstein coefficients bounds it on any interval, and the first crossing of the hull is a clip of time that
converges quadratically to a simple root, from below. No root is ever *computed* here: the univariate method decides by
the roots and misses collisions, whereas this one only skips times at which f is certainly not zero. Where f vanishes
identically (motion in one plane) it skips nothing, and the directions of `inclusion` make the progress.
"""

from types import SimpleNamespace

import warp as wp

from .once import once
from .patch import make_patch
from .rounding import CROSSING, RELATIVE, TINY, UNIT_ROUNDOFF, VOLUME


@once
def make_volume(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    vec4 = wp.types.vector(length=4, dtype=real)
    types = make_patch(real)
    Problem = types.Problem
    Corners = types.Corners
    unit_bound = wp.constant(real(VOLUME * UNIT_ROUNDOFF[real]))
    tiny = wp.constant(real(TINY[real]))
    third = wp.constant(real(1.0 / 3.0))
    half = wp.constant(real(0.5))
    round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
    round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
    fraction_down = wp.constant(real(1.0 - CROSSING * UNIT_ROUNDOFF[real]))

    @wp.func
    def with_volume(problem: Problem, c0: Corners, c1: Corners) -> Problem:
        """Set the Bernstein coefficients of f on [0, 1], and the bound below which |f| proves nothing."""
        n0 = wp.cross(c0.q, c0.r)
        n1 = wp.cross(c1.q, c1.r)
        nm = half * (wp.cross(c0.q, c1.r) + wp.cross(c1.q, c0.r))
        m0 = wp.dot(c0.w00, nm)
        m1 = wp.dot(c1.w00, nm)
        b1 = third * (wp.dot(c1.w00, n0) + m0 + m0)
        b2 = third * (wp.dot(c0.w00, n1) + m1 + m1)
        problem.volume = vec4(wp.dot(c0.w00, n0), b1, b2, wp.dot(c1.w00, n1))
        q = wp.max(wp.abs(c0.q), wp.abs(c1.q))
        r = wp.max(wp.abs(c0.r), wp.abs(c1.r))
        # the sums of the magnitudes of the products of Q×R, and of the determinant
        n = vec3(q[1] * r[2] + q[2] * r[1], q[2] * r[0] + q[0] * r[2], q[0] * r[1] + q[1] * r[0])
        p = wp.max(wp.abs(c0.w00), wp.abs(c1.w00))
        problem.volume_bound = unit_bound * wp.dot(p, n) + tiny
        if problem.has_separation:
            problem.volume_bound += unit_bound * wp.dot(problem.separation, n)
            problem.normal_t0 = n0
            problem.normal_mid = nm
            problem.normal_t1 = n1
        largest = wp.max(wp.abs(problem.volume))
        problem.is_flat = largest <= problem.volume_bound
        return problem

    @wp.func
    def separation_offset(problem: Problem, t: real, x: real) -> vec4:
        """Bernstein coefficients, on [t, x], of a cubic above Σ separation_k·|n_k|."""
        ct = real(1.0) - t
        cx = real(1.0) - x
        t0 = ct * problem.normal_t0 + t * problem.normal_mid
        t1 = ct * problem.normal_mid + t * problem.normal_t1
        x0 = cx * problem.normal_t0 + x * problem.normal_mid
        x1 = cx * problem.normal_mid + x * problem.normal_t1
        a = wp.dot(problem.separation, wp.abs(ct * t0 + t * t1))
        b = wp.dot(problem.separation, wp.abs(cx * t0 + x * t1))
        c = wp.dot(problem.separation, wp.abs(cx * x0 + x * x1))
        return vec4(a, third * (a + b + b), third * (b + b + c), c) * round_up

    @wp.func
    def crossing(i: real, a: real, j: real, b: real, first: real) -> real:
        """Minimum of ``first`` and the place, if any, where the segment between two control points falls to zero."""
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
    def advance_volume(problem: Problem, t_start: real, t_max: real) -> real:
        """Time up to which f keeps its sign from ``t_start`` on: at least ``t_start``; 2 if beyond ``t_max``."""
        t = t_start
        x = t_max
        for _ in range(16):  # one clip in each; far fewer are needed
            c = restrict(problem.volume, t, x)
            if c[0] < real(0.0):
                c = -c
            bound = problem.volume_bound
            c = c - vec4(bound, bound, bound, bound)
            if problem.has_separation:
                c = c - separation_offset(problem, t, x)
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
                # the fraction of [t, x] is rounded down, so it never reaches the crossing
                s = (t + (x - t) * (first * third) * fraction_down) * round_down
                if not s > t:
                    return t
                newton = real(2.0) * (s - t)
                t = s
                x = wp.min(t_max, t + newton)
        return t

    return SimpleNamespace(
        with_volume=with_volume,
        advance_volume=advance_volume,
        restrict=restrict,
        separation_offset=separation_offset,
        hull_crossing=hull_crossing,
    )
