"""Plain inclusion bisection, the method of the literature, against which the default method is measured.

A box [t0, t1] × [u0, u1] × [v0, v1] is discarded if the hull of its eight corners misses the separation box on one of
the three axes; with a Euclidean distance, if the hull is farther than that from the origin. It is accepted if the hull
is no wider than the tolerance on every axis. Otherwise its widest parameter is halved, and the earlier (lower) half is
searched first.

Differs from Wang et al. 2021, section 4:

1. Boxes wait on a stack of fixed depth, not in a queue; boxes that start at or after the best toi are dropped.
2. The rounding bound is per axis, and it covers a minimum separation.
3. The triangle is a patch whose side u = 1 has shrunk to a point, so every box lies in the domain.
4. The widest parameter is the one that moves a corner most, in units of the tolerance.
"""

import warp as wp

from ..interrupts import is_stopped
from ..parameters import norm, real
from .answer import STACK_DEPTH, Answer, parameters
from .patch import Corners, corners_at
from .rounding import MAX_SPLITS, MOVING, SQUARE_UNDERFLOW
from .status import STATUS_COLLISION, STATUS_ITERATION_LIMIT, STATUS_NO_COLLISION, STATUS_RESOLUTION_LIMIT
from .sub_patch import Patch, Problem, sub_corners

is_euclidean = norm.is_ball
square_underflow = wp.constant(real(SQUARE_UNDERFLOW[real]))
vec3 = wp.types.vector(length=3, dtype=real)
box_stack = wp.types.vector(length=6 * STACK_DEPTH, dtype=real)
narrowest = wp.constant(real(2.0 ** -MAX_SPLITS[real]))
moving = wp.constant(real(MOVING))
half = wp.constant(real(0.5))
depth = wp.constant(STACK_DEPTH)


@wp.func
def low(a: Corners, b: Corners) -> vec3:
    """Lower corner of the box around the corners of a patch at two times."""
    m = wp.min(wp.min(a.w00, a.w01), wp.min(a.w10, a.w11))
    return wp.min(m, wp.min(wp.min(b.w00, b.w01), wp.min(b.w10, b.w11)))


@wp.func
def high(a: Corners, b: Corners) -> vec3:
    """Upper corner of that box."""
    m = wp.max(wp.max(a.w00, a.w01), wp.max(a.w10, a.w11))
    return wp.max(m, wp.max(wp.max(b.w00, b.w01), wp.max(b.w10, b.w11)))


@wp.func
def share(a: vec3, b: vec3, delta: vec3) -> real:
    """Length of a - b in units of the tolerance (L∞)."""
    return wp.max(wp.cw_div(wp.abs(a - b), delta))


@wp.func
def bisect(
    kind: int, root: Patch, problem: Problem, t_max: real, max_iterations: int, stop: wp.array[wp.int32]
) -> Answer:
    """Earliest contact of a patch on [0, t_max].

    Invariant: every contact lies in a box of the stack, or at or after ``answer.toi``.
    """
    answer = Answer()
    answer.toi = real(2.0)
    answer.status = STATUS_NO_COLLISION
    margin = problem.separation + moving * problem.error
    stack = box_stack()
    stack[1] = t_max
    stack[3] = real(1.0)
    stack[5] = real(1.0)
    top = int(1)
    while top > 0 and not is_stopped(stop):
        top -= 1
        t0 = stack[6 * top]
        t1 = stack[6 * top + 1]
        u0 = stack[6 * top + 2]
        u1 = stack[6 * top + 3]
        v0 = stack[6 * top + 4]
        v1 = stack[6 * top + 5]
        if not t0 < answer.toi:
            continue
        if answer.iterations >= max_iterations:
            # the smallest time still open is a lower bound of the toi
            for k in range(top):
                t0 = wp.min(t0, stack[6 * k])
            answer.toi = wp.min(answer.toi, t0)
            answer.width = t_max - answer.toi
            answer.status = STATUS_ITERATION_LIMIT
            break
        answer.iterations += 1
        patch = Patch()
        patch.t0 = sub_corners(root.t0, u0, u1, v0, v1)
        patch.t1 = sub_corners(root.t1, u0, u1, v0, v1)
        a = corners_at(patch.t0, patch.t1, t0)
        b = corners_at(patch.t0, patch.t1, t1)
        lower = low(a, b)
        upper = high(a, b)
        is_free = bool(False)
        is_narrow = bool(True)
        for k in range(3):
            is_free = is_free or lower[k] > margin[k] or upper[k] < -margin[k]
            is_narrow = is_narrow and upper[k] - lower[k] <= problem.delta[k]
        if wp.static(is_euclidean):
            # the nearest point of the box (rounding, step 13)
            errors = moving * problem.error
            nearest = wp.max(wp.max(lower - errors, -upper - errors), vec3())
            radius = problem.separation[0]
            is_free = wp.dot(nearest, nearest) > radius * radius + square_underflow
        if is_free:
            continue
        dt = share(b.w00, a.w00, problem.delta)
        dt = wp.max(dt, share(b.w01, a.w01, problem.delta))
        dt = wp.max(dt, share(b.w10, a.w10, problem.delta))
        dt = wp.max(dt, share(b.w11, a.w11, problem.delta))
        du = wp.max(share(a.w10, a.w00, problem.delta), share(b.w10, b.w00, problem.delta))
        du = wp.max(du, wp.max(share(a.w11, a.w01, problem.delta), share(b.w11, b.w01, problem.delta)))
        dv = wp.max(share(a.w01, a.w00, problem.delta), share(b.w01, b.w00, problem.delta))
        dv = wp.max(dv, wp.max(share(a.w11, a.w10, problem.delta), share(b.w11, b.w10, problem.delta)))
        tm = half * (t0 + t1)
        if not (tm > t0 and tm < t1):
            dt = real(-1.0)
        if u1 - u0 <= narrowest:
            du = real(-1.0)
        if v1 - v0 <= narrowest:
            dv = real(-1.0)
        widest = wp.max(dt, wp.max(du, dv))
        if is_narrow or widest < real(0.0) or top + 2 > depth:
            answer.toi = t0
            answer.width = t1 - t0
            answer.status = STATUS_COLLISION
            if not is_narrow:
                answer.status = STATUS_RESOLUTION_LIMIT
            answer.point = a.w00
            answer.parameters = parameters(kind, u0, u1, v0, v1, real(0.0), real(0.0), False)
            continue
        # upper half below, lower half on top
        for k in range(2):
            at = 6 * (top + k)
            stack[at] = t0
            stack[at + 1] = t1
            stack[at + 2] = u0
            stack[at + 3] = u1
            stack[at + 4] = v0
            stack[at + 5] = v1
        up = 6 * top
        if widest == dt:
            stack[up] = tm
            stack[up + 7] = tm
        elif widest == du:
            stack[up + 2] = half * (u0 + u1)
            stack[up + 9] = half * (u0 + u1)
        else:
            stack[up + 4] = half * (v0 + v1)
            stack[up + 11] = half * (v0 + v1)
        top += 2
    return answer
