"""Bisection of a patch in (u, v) with a stack of fixed depth, for patches on which single directions clip little."""

from types import SimpleNamespace

import warp as wp

from .advance import CONTACT, LIMIT, SLOW, make_advance
from .answer import STACK_DEPTH, make_answer
from .interrupts import is_stopped
from .once import once
from .patch import make_patch
from .rounding import MAX_SPLITS
from .status import (
    STATUS_COLLISION,
    STATUS_ITERATION_LIMIT,
    STATUS_NO_COLLISION,
    STATUS_RESOLUTION_LIMIT,
)


@once
def make_subdivide(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    box_stack = wp.types.vector(length=5 * STACK_DEPTH, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Problem = types.Problem
    sub_corners = types.sub_corners
    advance = make_advance(real).advance
    Answer = make_answer(real).Answer
    parameters = make_answer(real).parameters
    narrowest = wp.constant(real(2.0 ** -MAX_SPLITS[real]))
    depth = wp.constant(STACK_DEPTH)

    @wp.func
    def longest(a: vec3) -> real:
        return wp.max(wp.max(wp.abs(a[0]), wp.abs(a[1])), wp.abs(a[2]))

    @wp.func
    def subdivide(
        kind: int,
        root: Patch,
        problem: Problem,
        t_start: real,
        t_max: real,
        max_iterations: int,
        stop: wp.array[wp.int32],
    ) -> Answer:
        """Earliest contact of a patch that is free on [0, t_start).

        Invariant: every contact lies on a patch of the stack, or at or after ``toi``. A patch is halved across its
        longer side, and the half with the closest point is searched first: a contact on it bounds the time to search
        the others.
        """
        answer = Answer()
        answer.toi = real(2.0)
        answer.status = STATUS_NO_COLLISION
        stack = box_stack()
        stack[0] = t_start
        stack[1] = real(0.0)
        stack[2] = real(1.0)
        stack[3] = real(0.0)
        stack[4] = real(1.0)
        top = int(1)
        while top > 0 and not is_stopped(stop):
            top -= 1
            t = stack[5 * top]
            u0 = stack[5 * top + 1]
            u1 = stack[5 * top + 2]
            v0 = stack[5 * top + 3]
            v1 = stack[5 * top + 4]
            if t < answer.toi:
                patch = Patch()
                patch.t0 = sub_corners(root.t0, u0, u1, v0, v1)
                patch.t1 = sub_corners(root.t1, u0, u1, v0, v1)
                patch.is_face = root.is_face
                patch.is_triangle = root.is_triangle and u1 == real(1.0)
                patch.narrowing = real(1.0)
                if root.is_face:
                    patch.narrowing = (real(1.0) - u1) / (real(1.0) - u0)
                end = wp.min(answer.toi, t_max)
                reached = advance(patch, problem, t, end, max_iterations - answer.iterations)
                answer.iterations += reached.iterations
                t = reached.t
                outcome = reached.outcome
                box_status = STATUS_COLLISION
                if outcome == SLOW and t < answer.toi:
                    du = wp.max(longest(patch.t0.w10 - patch.t0.w00), longest(patch.t1.w10 - patch.t1.w00))
                    du = wp.max(du, wp.max(longest(patch.t0.w11 - patch.t0.w01), longest(patch.t1.w11 - patch.t1.w01)))
                    dv = wp.max(longest(patch.t0.w01 - patch.t0.w00), longest(patch.t1.w01 - patch.t1.w00))
                    dv = wp.max(dv, wp.max(longest(patch.t0.w11 - patch.t0.w10), longest(patch.t1.w11 - patch.t1.w10)))
                    split_u = (du >= dv and u1 - u0 > narrowest) or v1 - v0 <= narrowest
                    if (u1 - u0 <= narrowest and v1 - v0 <= narrowest) or top + 2 > depth:
                        outcome = CONTACT
                        box_status = STATUS_RESOLUTION_LIMIT
                    else:
                        # lower half [u0, mu] × [v0, mv], upper half [nu, u1] × [nv, v1]
                        mu = u1
                        nu = u0
                        mv = v1
                        nv = v0
                        closest = reached.wb
                        if reached.from_w11:
                            closest = real(1.0) - reached.wc
                        if split_u:
                            mu = real(0.5) * (u0 + u1)
                            nu = mu
                            closest = reached.wc
                            if reached.from_w11:
                                closest = real(1.0) - reached.wb
                        else:
                            mv = real(0.5) * (v0 + v1)
                            nv = mv
                        lower = 5 * top + 5
                        upper = 5 * top
                        if closest > real(0.5):
                            lower = 5 * top
                            upper = 5 * top + 5
                        stack[lower] = t
                        stack[lower + 1] = u0
                        stack[lower + 2] = mu
                        stack[lower + 3] = v0
                        stack[lower + 4] = mv
                        stack[upper] = t
                        stack[upper + 1] = nu
                        stack[upper + 2] = u1
                        stack[upper + 3] = nv
                        stack[upper + 4] = v1
                        top += 2
                elif outcome == LIMIT:
                    # the smallest time still open is a lower bound of the toi
                    for k in range(top):
                        t = wp.min(t, stack[5 * k])
                    outcome = CONTACT
                    box_status = STATUS_ITERATION_LIMIT
                    top = 0
                if outcome == CONTACT and t < answer.toi:
                    answer.toi = t
                    answer.status = box_status
                    answer.point = reached.point
                    answer.parameters = parameters(kind, u0, u1, v0, v1, reached.wb, reached.wc, reached.from_w11)
        return answer

    return SimpleNamespace(subdivide=subdivide)
