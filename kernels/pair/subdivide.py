"""Bisection of a patch in (u, v) with a stack of fixed depth, for patches on which single directions clip little."""

import warp as wp

from ..interrupts import is_stopped
from ..parameters import only_method, real
from .advance import CONTACT, LIMIT, SLOW, Reached, advance
from .answer import STACK_DEPTH, Answer, parameters
from .rounding import MAX_SPLITS
from .status import STATUS_COLLISION, STATUS_ITERATION_LIMIT, STATUS_NO_COLLISION, STATUS_RESOLUTION_LIMIT
from .sub_patch import Patch, Problem, sub_corners

vec3 = wp.types.vector(length=3, dtype=real)
narrowest = wp.constant(real(2.0 ** -MAX_SPLITS[real]))
half = wp.constant(real(0.5))
depth = wp.constant(STACK_DEPTH)


# An entry of the stack: t, u0, u1, v0, v1.
vec5 = wp.types.vector(length=5, dtype=real)
# A warp of CUDA that shares a patch has one stack in shared memory in place of one for each thread.
on_warp = only_method == "clipping"
entries = wp.types.matrix(shape=(1 if on_warp else STACK_DEPTH, 5), dtype=real)


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
    __shared__ double entries[{STACK_DEPTH}][5];
    if (is_new) {{
        __syncwarp();
        if (threadIdx.x == 0)
            for (int k = 0; k < 5; ++k)
                entries[place][k] = entry[k];
        __syncwarp();
    }}
    for (int k = 0; k < 5; ++k)
        entry[k] = entries[place][k];
#endif
    return entry;
"""
)
def shared_entry(place: int, is_new: bool, entry: vec5) -> vec5:
    """An entry of the stack that the one warp of a block shares, which is written if it is new."""
    ...


@wp.func
def length_u(patch: Patch) -> real:
    """Largest length (L∞) of the patch along u, on both sides and at both ends of the step."""
    at_v0 = wp.max(wp.max(wp.abs(patch.t0.w10 - patch.t0.w00)), wp.max(wp.abs(patch.t1.w10 - patch.t1.w00)))
    at_v1 = wp.max(wp.max(wp.abs(patch.t0.w11 - patch.t0.w01)), wp.max(wp.abs(patch.t1.w11 - patch.t1.w01)))
    return wp.max(at_v0, at_v1)


@wp.func
def length_v(patch: Patch) -> real:
    """Largest length (L∞) of the patch along v, on both sides and at both ends of the step."""
    at_u0 = wp.max(wp.max(wp.abs(patch.t0.w01 - patch.t0.w00)), wp.max(wp.abs(patch.t1.w01 - patch.t1.w00)))
    at_u1 = wp.max(wp.max(wp.abs(patch.t0.w11 - patch.t0.w10)), wp.max(wp.abs(patch.t1.w11 - patch.t1.w10)))
    return wp.max(at_u0, at_u1)


@wp.func
def closest_along(reached: Reached, along_u: bool) -> real:
    """Parameter of the closest point within the patch, in [0, 1], along u or v."""
    weight = wp.where(along_u, reached.wc, reached.wb)
    opposite = wp.where(along_u, reached.wb, reached.wc)
    return wp.where(reached.from_w11, real(1.0) - opposite, weight)


@wp.func
def sub_patch(root: Patch, entry: vec5) -> Patch:
    """The part of a patch that an entry of the stack is: (t, u0, u1, v0, v1)."""
    patch = Patch()
    patch.t0 = sub_corners(root.t0, entry[1], entry[2], entry[3], entry[4])
    patch.t1 = sub_corners(root.t1, entry[1], entry[2], entry[3], entry[4])
    patch.is_face = root.is_face
    patch.is_triangle = root.is_triangle and entry[2] == real(1.0)
    patch.narrowing = real(1.0)
    if root.is_face:
        patch.narrowing = (real(1.0) - entry[2]) / (real(1.0) - entry[1])
    return patch


@wp.func
def is_wide(entry: vec5) -> bool:
    """Whether a part of a patch can be halved."""
    return entry[2] - entry[1] > narrowest or entry[4] - entry[3] > narrowest


@wp.func
def halves_of(patch: Patch, entry: vec5, t: real, reached: Reached):
    """The halves of a part that is free up to t, across its longer side that can be halved, the closer one last."""
    u0 = entry[1]
    u1 = entry[2]
    v0 = entry[3]
    v1 = entry[4]
    can_split_u = u1 - u0 > narrowest
    can_split_v = v1 - v0 > narrowest
    split_u = (length_u(patch) >= length_v(patch) and can_split_u) or not can_split_v
    # lower half [u0, mu] × [v0, mv], upper half [nu, u1] × [nv, v1]
    mu = wp.where(split_u, half * (u0 + u1), u1)
    nu = wp.where(split_u, mu, u0)
    mv = wp.where(split_u, v1, half * (v0 + v1))
    nv = wp.where(split_u, v0, mv)
    is_upper_first = closest_along(reached, split_u) > half
    lower = vec5(t, u0, mu, v0, mv)
    upper = vec5(t, nu, u1, nv, v1)
    return wp.where(is_upper_first, lower, upper), wp.where(is_upper_first, upper, lower)


@wp.func
def advance_and_subdivide(
    kind: int,
    root: Patch,
    problem: Problem,
    patch_error: vec3,
    t_start: real,
    t_max: real,
    used: int,
    max_iterations: int,
    stop: wp.array[wp.int32],
) -> Answer:
    """Earliest contact of a patch that is free on [0, t_start), after ``used`` iterations.

    Invariant: every contact lies on a patch of the stack, or at or after ``toi``. The whole patch is advanced first,
    with its own error. Only where that is slow, it is advanced with ``patch_error``, that of a part, and halved, as its
    halves are, across its longer side. The half with the closest point is searched first: a contact on it bounds the
    time to search the others.
    """
    answer = Answer()
    answer.toi = real(2.0)
    answer.status = STATUS_NO_COLLISION
    answer.iterations = used
    has_own_error = bool(True)
    stack = entries()
    whole = vec5(t_start, real(0.0), real(1.0), real(0.0), real(1.0))
    stack[0] = whole
    if wp.static(on_warp):
        shared_entry(0, True, whole)
    top = int(1)
    while top > 0 and not is_stopped(stop):
        top -= 1
        if wp.static(on_warp):
            entry = shared_entry(top, False, whole)
        else:
            entry = stack[top]
        t = entry[0]
        if not t < answer.toi:
            continue
        patch = sub_patch(root, entry)
        end = wp.min(answer.toi, t_max)
        reached = advance(patch, problem, t, end, max_iterations - answer.iterations)
        answer.iterations += reached.iterations
        t = reached.t
        if reached.outcome == SLOW and has_own_error:
            has_own_error = False
            problem.error = patch_error
            problem.delta = problem.delta + real(2.0) * patch_error
            whole[0] = t
            stack[0] = whole
            if wp.static(on_warp):
                shared_entry(0, True, whole)
            top = 1
            continue
        if reached.outcome == SLOW and t < answer.toi:
            if is_wide(entry) and top + 2 <= depth:
                farther, closer = halves_of(patch, entry, t, reached)
                if wp.static(on_warp):
                    shared_entry(top, True, farther)
                    shared_entry(top + 1, True, closer)
                else:
                    stack[top] = farther
                    stack[top + 1] = closer
                top += 2
                continue
        status = STATUS_NO_COLLISION
        if reached.outcome == CONTACT:
            status = STATUS_COLLISION
        elif reached.outcome == SLOW:
            status = STATUS_RESOLUTION_LIMIT
        elif reached.outcome == LIMIT:
            # the smallest time still open is a lower bound of the toi
            for k in range(top):
                if wp.static(on_warp):
                    t = wp.min(t, shared_entry(k, False, whole)[0])
                else:
                    t = wp.min(t, stack[k][0])
            status = STATUS_ITERATION_LIMIT
            top = 0
        if status != STATUS_NO_COLLISION and t < answer.toi:
            answer.toi = t
            answer.status = status
            answer.point = reached.point
            answer.parameters = parameters(
                kind, entry[1], entry[2], entry[3], entry[4], reached.wb, reached.wc, reached.from_w11
            )
    answer.error = problem.error
    return answer
