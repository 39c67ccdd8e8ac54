"""Narrow phase: earliest time of impact of one pair a thread, for every pair kind and both precisions.

A thread forms the corners of its pair's patch (differences first, in float64), normalises each axis by a power of two,
and advances the whole patch; only a pair whose advance is slow goes on to the stack.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from .advance import CONTACT, LIMIT, SLOW, make_advance
from .patch import EDGE_EDGE, VERTEX_FACE, make_patch
from .rounding import (
    LARGEST,
    PROJECTION_PATCH,
    PROJECTION_ROOT,
    RELATIVE,
    TINY,
    UNIT_ROUNDOFF,
    inverse_power_of_two,
)
from .subdivide import (
    STATUS_COLLISION,
    STATUS_INITIAL_CONTACT,
    STATUS_INVALID,
    STATUS_ITERATION_LIMIT,
    STATUS_NO_COLLISION,
    make_subdivide,
)
from .volume import make_volume

vec3d = wp.vec3d


@wp.struct
class Points:
    """The four points of a pair at one time."""

    p0: vec3d
    p1: vec3d
    p2: vec3d
    p3: vec3d


@wp.func
def scaled(p: Points, s: vec3d) -> Points:
    r = Points()
    r.p0 = wp.cw_mul(p.p0, s)
    r.p1 = wp.cw_mul(p.p1, s)
    r.p2 = wp.cw_mul(p.p2, s)
    r.p3 = wp.cw_mul(p.p3, s)
    return r


@wp.func
def side(a: Points, b: Points, k: int) -> wp.float64:
    """Side k of the box around both frames, without overflow."""
    low = wp.min(wp.min(wp.min(a.p0[k], a.p1[k]), wp.min(a.p2[k], a.p3[k])), wp.min(b.p0[k], b.p1[k]))
    low = wp.min(low, wp.min(b.p2[k], b.p3[k]))
    high = wp.max(wp.max(wp.max(a.p0[k], a.p1[k]), wp.max(a.p2[k], a.p3[k])), wp.max(b.p0[k], b.p1[k]))
    high = wp.max(high, wp.max(b.p2[k], b.p3[k]))
    return wp.min(high - low, LARGEST)


@cache
def make_narrow_phase(real) -> SimpleNamespace:
    """Kernels for one floating-point type of the iteration; positions are float64 always."""
    vec3 = wp.types.vector(length=3, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Problem = types.Problem
    Corners64 = make_patch(wp.float64).Corners
    Corners = types.Corners
    advance = make_advance(real).advance
    with_volume = make_volume(real).with_volume
    subdivide = make_subdivide(real).subdivide
    parameters = make_subdivide(real).parameters
    root_bound = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
    patch_bound = wp.constant(real(PROJECTION_PATCH * UNIT_ROUNDOFF[real]))
    round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
    tiny = wp.constant(real(TINY[real]))
    largest = wp.constant(LARGEST)

    @wp.func
    def corners(kind: int, p: Points) -> Corners64:
        """Corners and sides of the patch: one rounded difference each (rounding, step 1)."""
        c = Corners64()
        if kind == VERTEX_FACE:
            c.w00 = p.p0 - p.p1
            c.w01 = p.p0 - p.p2
            c.w10 = p.p0 - p.p3
            c.w11 = c.w10
            c.q = p.p1 - p.p2
            c.r = p.p1 - p.p3
        else:
            c.w00 = p.p0 - p.p2
            c.w01 = p.p0 - p.p3
            c.w10 = p.p1 - p.p2
            c.w11 = p.p1 - p.p3
            c.q = p.p2 - p.p3
            c.r = p.p1 - p.p0
        return c

    @wp.func
    def magnitude(c: Corners64) -> vec3d:
        """Largest |corner| per axis."""
        m = wp.max(wp.max(wp.abs(c.w00), wp.abs(c.w01)), wp.max(wp.abs(c.w10), wp.abs(c.w11)))
        return m

    @wp.func
    def total(c: Corners64) -> vec3d:
        """Sum of the magnitudes: unlike a maximum it keeps NaN."""
        return wp.abs(c.w00) + wp.abs(c.w01) + wp.abs(c.w10) + wp.abs(c.w11) + wp.abs(c.q) + wp.abs(c.r)

    @wp.func
    def normalised(c: Corners64, s: vec3d) -> Corners:
        """Corners in normalised units (rounding, step 2)."""
        r = Corners()
        r.w00 = vec3(wp.cw_mul(c.w00, s))
        r.w01 = vec3(wp.cw_mul(c.w01, s))
        r.w10 = vec3(wp.cw_mul(c.w10, s))
        r.w11 = vec3(wp.cw_mul(c.w11, s))
        r.q = vec3(wp.cw_mul(c.q, s))
        r.r = vec3(wp.cw_mul(c.r, s))
        return r

    @wp.func
    def solve(
        kind: int,
        x_t0: Points,
        x_t1: Points,
        tolerance: wp.float64,
        minimum_separation: wp.float64,
        length_scale: wp.float64,
        t_max: wp.float64,
        t_end: real,
        max_iterations: int,
    ):
        """Earliest toi of one pair (inf if none), status, iterations, (u, v).

        ``length_scale`` 0 stands for the pair's own; ``t_end`` is t_max rounded up.
        """
        toi = wp.float64(wp.inf)
        status = STATUS_NO_COLLISION
        iterations = int(0)
        where = wp.vec2d(wp.float64(0.0), wp.float64(0.0))

        c0 = corners(kind, x_t0)
        c1 = corners(kind, x_t1)
        sums = total(c0) + total(c1)
        pre = vec3d(wp.float64(1.0), wp.float64(1.0), wp.float64(1.0))
        if not (sums[0] <= largest and sums[1] <= largest and sums[2] <= largest):
            # an overflow, or no numbers at all: try again with the axes that overflowed at 1/1024 of their size
            for k in range(3):
                if not sums[k] <= largest:
                    pre[k] = wp.float64(1.0 / 1024.0)
            c0 = corners(kind, scaled(x_t0, pre))
            c1 = corners(kind, scaled(x_t1, pre))
            sums = total(c0) + total(c1)
        if not (sums[0] <= largest and sums[1] <= largest and sums[2] <= largest):
            toi = wp.float64(0.0)
            status = STATUS_INVALID
        else:
            scale = length_scale
            if scale <= wp.float64(0.0):
                scale = wp.max(wp.max(side(x_t0, x_t1, 0), side(x_t0, x_t1, 1)), side(x_t0, x_t1, 2))
            delta_length = wp.min(tolerance * scale, largest)
            separation_length = wp.min(minimum_separation * scale, largest)

            m = wp.max(magnitude(c0), magnitude(c1))
            # an axis shorter than the tolerance needs no magnification beyond it
            s = vec3d()
            for k in range(3):
                s[k] = inverse_power_of_two(wp.max(m[k], delta_length * pre[k]))
            size = vec3(wp.cw_mul(m, s))
            problem = Problem()
            problem.error = root_bound * size + vec3(tiny, tiny, tiny)
            for k in range(3):
                # corners are below 4 in these units: more separation or tolerance means no more
                length = wp.min(separation_length * pre[k] * s[k], wp.float64(8.0))
                problem.separation[k] = real(length) * round_up
                length = wp.min(delta_length * pre[k] * s[k], wp.float64(8.0))
                problem.delta[k] = real(length)
            problem.delta = problem.delta + real(2.0) * problem.error
            problem.has_separation = separation_length > wp.float64(0.0)
            patch = Patch()
            patch.t0 = normalised(c0, s)
            patch.t1 = normalised(c1, s)
            patch.is_face = kind == VERTEX_FACE
            patch.is_triangle = kind == VERTEX_FACE
            problem = with_volume(problem, patch.t0, patch.t1)

            t, outcome, iterations, wb, wc, from_w11 = advance(patch, problem, real(0.0), t_end, max_iterations)
            if outcome == SLOW:
                problem.error = patch_bound * size + vec3(tiny, tiny, tiny)
                problem.delta = problem.delta + real(2.0) * problem.error
                t, status, n, where = subdivide(kind, patch, problem, t, t_end, max_iterations - iterations)
                iterations += n
            else:
                if outcome == CONTACT:
                    status = STATUS_COLLISION
                elif outcome == LIMIT:
                    status = STATUS_ITERATION_LIMIT
                where = parameters(kind, real(0.0), real(1.0), real(0.0), real(1.0), wb, wc, from_w11)
            if status != STATUS_NO_COLLISION:
                if wp.float64(t) > t_max:
                    status = STATUS_NO_COLLISION
                else:
                    toi = wp.float64(t)
                    if status == STATUS_COLLISION and t == real(0.0):
                        status = STATUS_INITIAL_CONTACT
        return toi, status, iterations, where

    module = wp.get_module(f"ccd_warp.narrow_phase.{real.__name__}")
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)

    @wp.kernel(module=module)
    def points_toi(
        begin: int,
        # in
        kind: int,
        x_t0: wp.array2d[vec3d],
        x_t1: wp.array2d[vec3d],
        tolerance: wp.float64,
        minimum_separation: wp.float64,
        length_scale: wp.float64,
        t_max: wp.float64,
        t_end: real,
        max_iterations: int,
        # out
        toi_out: wp.array[wp.float64],
        status_out: wp.array[wp.int32],
        parameters_out: wp.array[wp.vec2d],
        iterations_out: wp.array[wp.int32],
    ):
        """Pairs given by their points, shape [n, 4]."""
        i = begin + wp.tid()
        a = Points()
        a.p0 = x_t0[i, 0]
        a.p1 = x_t0[i, 1]
        a.p2 = x_t0[i, 2]
        a.p3 = x_t0[i, 3]
        b = Points()
        b.p0 = x_t1[i, 0]
        b.p1 = x_t1[i, 1]
        b.p2 = x_t1[i, 2]
        b.p3 = x_t1[i, 3]
        toi, status, iterations, where = solve(
            kind, a, b, tolerance, minimum_separation, length_scale, t_max, t_end, max_iterations
        )
        toi_out[i] = toi
        status_out[i] = status
        parameters_out[i] = where
        iterations_out[i] = iterations

    @wp.kernel(module=module)
    def pairs_toi(
        begin: int,
        # in
        kind: int,
        pairs: wp.array[wp.vec2i],
        first_corners: wp.array[wp.vec3i],
        second_corners: wp.array[wp.vec3i],
        x_t0: wp.array[vec3d],
        x_t1: wp.array[vec3d],
        tolerance: wp.float64,
        minimum_separation: wp.float64,
        length_scale: wp.float64,
        t_max: wp.float64,
        t_end: real,
        max_iterations: int,
        # out
        toi_out: wp.array[wp.float64],
        status_out: wp.array[wp.int32],
        parameters_out: wp.array[wp.vec2d],
        iterations_out: wp.array[wp.int32],
    ):
        """Pairs given by primitive ids of a mesh, shape [n], and the vertices of each primitive."""
        i = begin + wp.tid()
        first = first_corners[pairs[i][0]]
        second = second_corners[pairs[i][1]]
        i0 = first[0]
        i1 = second[0]
        i2 = second[1]
        i3 = second[2]
        if kind == EDGE_EDGE:
            i1 = first[1]
            i2 = second[0]
            i3 = second[1]
        a = Points()
        a.p0 = x_t0[i0]
        a.p1 = x_t0[i1]
        a.p2 = x_t0[i2]
        a.p3 = x_t0[i3]
        b = Points()
        b.p0 = x_t1[i0]
        b.p1 = x_t1[i1]
        b.p2 = x_t1[i2]
        b.p3 = x_t1[i3]
        toi, status, iterations, where = solve(
            kind, a, b, tolerance, minimum_separation, length_scale, t_max, t_end, max_iterations
        )
        toi_out[i] = toi
        status_out[i] = status
        parameters_out[i] = where
        iterations_out[i] = iterations

    return SimpleNamespace(points_toi=points_toi, pairs_toi=pairs_toi)
