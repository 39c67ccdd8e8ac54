"""What a backward pass adds to the gradients of the points of pair functions, in space or in the plane."""

import warp as wp

from ..pair_kind import POINT_POINT, POINT_SEGMENT
from ..parameters import dimension
from .toi_slope import Slopes

_ONE = wp.constant(wp.float64(1.0))

vec = wp.types.vector(length=dimension, dtype=wp.float64)
module = wp.get_module(f"ccd_warp.toi_adjoint_points.{dimension}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.func
def of_columns(x: wp.vec3d) -> vec:
    """The coordinates that the points have."""
    y = vec()
    for i in range(wp.static(dimension)):
        y[i] = x[i]
    return y


@wp.kernel(module=module)
def add_points(
    begin: int,
    # in
    kind: int,
    slopes: Slopes,
    adjoint: wp.array[wp.float64],
    # out
    points_t0: wp.array2d[vec],  # empty where no gradient is asked for
    points_t1: wp.array2d[vec],
):
    """Add the gradients of the points of a pair."""
    i = begin + wp.tid()
    t = slopes.time[i]
    for c in range(4):
        p = int(c)  # the columns are p, p, a, b and p, p, q, q
        if c > 0 and kind == POINT_SEGMENT:
            p = c - 1
        if kind == POINT_POINT:
            p = c / 2
        along = (-adjoint[i] * slopes.weights[i][c]) * slopes.slope[i]
        if points_t0.shape[0] > 0:
            points_t0[i, p] = points_t0[i, p] + of_columns((_ONE - t) * along)
        if points_t1.shape[0] > 0:
            points_t1[i, p] = points_t1[i, p] + of_columns(t * along)
