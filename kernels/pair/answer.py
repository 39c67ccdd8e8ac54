"""The answer of a search on a patch: a time, how it was reached, and a point of the patch."""

import warp as wp

from ..pair_kind import POINT_SEGMENT, VERTEX_FACE
from ..parameters import real

# Largest number of patches or boxes on the stack at the same time.
STACK_DEPTH = 64


vec3 = wp.types.vector(length=3, dtype=real)


@wp.struct
class Answer:
    """Earliest contact of a pair."""

    toi: real  # 2: none
    width: real  # of the reported box in time: 0 except for boxes of the bisection
    status: int
    iterations: int
    parameters: wp.vec2d
    point: vec3  # a point of the patch at toi, in normalised units: its size bounds the gap
    error: vec3  # rounding bound of a projection of the patches that were searched


@wp.func
def parameters(kind: int, u0: real, u1: real, v0: real, v1: real, wb: real, wc: real, from_w11: bool) -> wp.vec2d:
    """Barycentric (u, v) of f1 and f2, or positions (u, v) along the edges, from weights on a sub-patch."""
    uc = u0
    vc = v0
    if from_w11:
        uc = u1
        vc = v1
    # the neighbours of the corner (uc, vc) are w01 = (u0, v1) and w10 = (u1, v0)
    c = wp.vec2d(wp.float64(uc), wp.float64(vc))
    b01 = wp.vec2d(wp.float64(u0), wp.float64(v1))
    b10 = wp.vec2d(wp.float64(u1), wp.float64(v0))
    if kind == POINT_SEGMENT:
        c = wp.vec2d(c[1], c[0])
        b01 = wp.vec2d(b01[1], b01[0])
        b10 = wp.vec2d(b10[1], b10[0])
    if kind == VERTEX_FACE:
        c = wp.vec2d((wp.float64(1.0) - c[0]) * c[1], c[0])
        b01 = wp.vec2d((wp.float64(1.0) - b01[0]) * b01[1], b01[0])
        b10 = wp.vec2d((wp.float64(1.0) - b10[0]) * b10[1], b10[0])
    return c + wp.float64(wb) * (b01 - c) + wp.float64(wc) * (b10 - c)
