"""The moving facets of a patch enlarged by a box: a complete set of separating directions.

The Minkowski sum of the patch and the separation box is a convex polytope whose facet normals are among the axes, the
cross products of the sides with the axes, and the normal of the patch. It contains the origin iff none of them
separates, so at every time before a contact one of them does. The axes are constant, the cross products of the sides
with the axes are linear in t, and the normal is quadratic in t (it is treated by `volume`). Clipping with a moving
facet, rather than with its normal at one time, converges quadratically however fast the pair rotates, even if the pair
lies in one plane, where the volume vanishes.
"""

from types import SimpleNamespace

import warp as wp

from .once import once
from .patch import make_patch
from .rounding import CROSSING, MOVING, RELATIVE, TINY, TINY_DIRECTION, UNIT_ROUNDOFF


@once
def make_facets(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Corners = types.Corners
    Problem = types.Problem
    unit = UNIT_ROUNDOFF[real]
    half = wp.constant(real(0.5))
    one_percent = wp.constant(real(0.01))
    moving = wp.constant(real(MOVING))
    floor_errors = wp.constant(real(8.0))
    round_down = wp.constant(real(1.0 - RELATIVE * unit))
    round_up = wp.constant(real(1.0 + RELATIVE * unit))
    fraction_down = wp.constant(real(1.0 - CROSSING * unit))
    tiny_direction = wp.constant(real(TINY_DIRECTION[real]))
    underflow = wp.constant(real(TINY[real] * TINY_DIRECTION[real]))

    @wp.struct
    class Facet:
        """The facet with the largest slack at one time."""

        side: int  # -1: an axis; 0, 1, 2: a side crossed with an axis
        axis: int
        slack: real  # distance from the enlarged patch along the direction, divided by the L1 norm of the direction
        floor_excess: real  # largest slack beyond separation and rounding

    @wp.func
    def corners_at(patch: Patch, t: real) -> Corners:
        """Corners at one time (rounding, step 8)."""
        c = Corners()
        s = real(1.0) - t
        c.w00 = s * patch.t0.w00 + t * patch.t1.w00
        c.w01 = s * patch.t0.w01 + t * patch.t1.w01
        c.w10 = s * patch.t0.w10 + t * patch.t1.w10
        c.w11 = s * patch.t0.w11 + t * patch.t1.w11
        return c

    @wp.func
    def side_of(c: Corners, side: int) -> vec3:
        """Sides of distinct directions: along v, along u at v = 0, along u at v = 1."""
        if side == 0:
            return c.w01 - c.w00
        if side == 1:
            return c.w10 - c.w00
        return c.w11 - c.w01

    @wp.func
    def direction(c: Corners, side: int, axis: int) -> vec3:
        """Normal of a facet whose direction is constant or linear in time."""
        e = vec3()
        e[axis] = real(1.0)
        if side >= 0:
            e = wp.cross(side_of(c, side), e)
        return e

    @wp.func
    def consider(facet: Facet, side: int, axis: int, d: vec3, c: Corners, problem: Problem) -> Facet:
        """Keep the facet with the larger slack, and the largest excess."""
        p = wp.dot(d, c.w00)
        q = wp.dot(d, c.w01)
        r = wp.dot(d, c.w10)
        s = wp.dot(d, c.w11)
        gap = wp.max(wp.min(wp.min(p, q), wp.min(r, s)), -wp.max(wp.max(p, q), wp.max(r, s)))
        m = wp.abs(d)
        size = m[0] + m[1] + m[2]
        if size > tiny_direction:
            gap = gap - wp.dot(m, problem.separation)
            facet.floor_excess = wp.max(facet.floor_excess, gap - floor_errors * wp.dot(m, problem.error))
            # of two with similar slack the first is kept: axes are constant, whereas a side may vanish
            slack = gap / size
            if slack > facet.slack + one_percent * wp.abs(facet.slack):
                facet.slack = slack
                facet.side = side
                facet.axis = axis
        return facet

    @wp.func
    def widest_facet(c: Corners, is_face: bool, problem: Problem) -> Facet:
        """The facet that separates best at one time."""
        facet = Facet()
        facet.slack = -real(1.0e30)
        facet.floor_excess = -real(1.0e30)
        for side in range(-1, 3):
            for axis in range(3):
                if side < 2 or is_face:  # opposite sides of a parallelogram are parallel
                    facet = consider(facet, side, axis, direction(c, side, axis), c, problem)
        n = wp.cross(side_of(c, 0), side_of(c, 1))
        kept = facet
        facet = consider(facet, 3, 0, n, c, problem)
        # the normal is used for the excess only: clipping along it is left to the volume
        kept.floor_excess = facet.floor_excess
        return kept

    @wp.func
    def separation_share(c: Corners, d: vec3, problem: Problem) -> real:
        """Lower bound of the gap along one direction, as a share of the separation along it."""
        low = wp.min(wp.min(wp.dot(d, c.w00), wp.dot(d, c.w01)), wp.min(wp.dot(d, c.w10), wp.dot(d, c.w11)))
        high = wp.max(wp.max(wp.dot(d, c.w00), wp.dot(d, c.w01)), wp.max(wp.dot(d, c.w10), wp.dot(d, c.w11)))
        m = wp.abs(d)
        along = wp.dot(m, problem.separation)
        share = real(0.0)
        if wp.max(m) > tiny_direction and along > real(0.0):
            share = (wp.max(low, -high) - wp.dot(m, problem.error) * round_up) / along
        return share

    @wp.func
    def start_gap_share(c: Corners, is_face: bool, problem: Problem) -> real:
        """Tight lower bound of the gap (L∞) at one time, as a share of the separation, from all directions."""
        share = separation_share(c, wp.cross(side_of(c, 0), side_of(c, 1)), problem)
        for axis in range(3):
            for side in range(-1, 3):
                if side < 2 or is_face:
                    share = wp.max(share, separation_share(c, direction(c, side, axis), problem))
        return share

    @wp.func
    def first_zero(h0: real, h1: real, h2: real, first: real) -> real:
        """First zero of the hull of three control points at 0, 1, 2, at most ``first``; 0 if h0 is not positive."""
        if not h0 > real(0.0):
            return real(0.0)
        if h1 <= real(0.0):
            first = wp.min(first, h0 / (h0 - h1))
        if h2 <= real(0.0):
            first = wp.min(first, real(2.0) * (h0 / (h0 - h2)))
            if h1 > real(0.0):
                first = wp.min(first, real(1.0) + h1 / (h1 - h2))
        return first

    @wp.func
    def corner_zero(d_t: vec3, d_x: vec3, o_t: real, o_x: real, sign: real, w_t: vec3, w_x: vec3, first: real) -> real:
        """The `first_zero` of one corner: of its projection on a moving direction, less the offsets."""
        h0 = sign * wp.dot(d_t, w_t) - o_t
        h1 = half * (sign * (wp.dot(d_t, w_x) + wp.dot(d_x, w_t))) - half * (o_t + o_x)
        h2 = sign * wp.dot(d_x, w_x) - o_x
        return first_zero(h0, h1, h2, first)

    @wp.func
    def clip_facet(patch: Patch, problem: Problem, side: int, axis: int, t_start: real, t_max: real) -> real:
        """Time up to which a moving facet separates (rounding, step 10): at least ``t_start``; 2 if beyond t_max."""
        margin = problem.separation + moving * problem.error
        t = t_start
        x = t_max
        c_t = corners_at(patch, t)
        d_t = direction(c_t, side, axis)
        sign = real(1.0)
        if wp.dot(d_t, c_t.w00) < real(0.0):
            sign = real(-1.0)
        for _ in range(12):
            if wp.max(wp.abs(d_t)) < tiny_direction:
                return t
            c_x = corners_at(patch, x)
            d_x = direction(c_x, side, axis)
            o_t = wp.dot(wp.abs(d_t), margin) * round_up + underflow
            o_x = wp.dot(wp.abs(d_x), margin) * round_up + underflow
            first = real(3.0)
            first = corner_zero(d_t, d_x, o_t, o_x, sign, c_t.w00, c_x.w00, first)
            first = corner_zero(d_t, d_x, o_t, o_x, sign, c_t.w01, c_x.w01, first)
            first = corner_zero(d_t, d_x, o_t, o_x, sign, c_t.w10, c_x.w10, first)
            first = corner_zero(d_t, d_x, o_t, o_x, sign, c_t.w11, c_x.w11, first)
            if first >= real(3.0):
                if x >= t_max:
                    return real(2.0)
                step = x - t
                t = x
                x = wp.min(t_max, t + real(4.0) * step)
            else:
                s = (t + (x - t) * (half * first) * fraction_down) * round_down
                if not s > t:
                    return t
                x = wp.min(t_max, s + real(2.0) * (s - t))
                t = s
            c_t = corners_at(patch, t)
            d_t = direction(c_t, side, axis)
        return t

    @wp.func
    def advance_facets(
        patch: Patch, problem: Problem, facet: Facet, t_start: real, t_max: real, thorough: bool
    ) -> real:
        """Clip with the widest facet, and with every facet if ``thorough`` or if the widest one gains nothing.

        It may gain nothing because its side vanishes.
        """
        t = clip_facet(patch, problem, facet.side, facet.axis, t_start, t_max)
        if (thorough or t <= t_start) and facet.slack > real(0.0):
            for axis in range(3):
                for side in range(-1, 3):
                    if side < 2 or patch.is_face:
                        t = wp.max(t, clip_facet(patch, problem, side, axis, t_start, t_max))
        return t

    return SimpleNamespace(
        corners_at=corners_at,
        direction=direction,
        start_gap_share=start_gap_share,
        widest_facet=widest_facet,
        first_zero=first_zero,
        clip_facet=clip_facet,
        advance_facets=advance_facets,
    )
