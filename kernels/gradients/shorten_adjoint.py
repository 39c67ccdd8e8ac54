"""The gradient of a shortened motion: from that of its end to those of the start, of the end before, and of the toi."""

import warp as wp

from ..parameters import dimension, real
from ..step import in_space as positions
from .regularity import UNKNOWN

_ZERO = wp.constant(wp.float64(0.0))

vec, in_space = positions.vec, positions.in_space
module = wp.get_module(f"ccd_warp.shorten_adjoint.{real.__name__}.{dimension}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def shorten_back(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    group: wp.array[wp.int32],  # of each of them, which moves by one fraction; -1: it is not shortened
    toi: wp.array[wp.float64],  # of each group
    share: wp.float64,  # of a toi that is kept
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],  # before the motion was shortened
    t0_by_vertex: int,
    t1_by_vertex: int,
    # in and out
    gradient_t0: wp.array[vec],  # empty where none is asked for
    gradient_t1: wp.array[vec],
    # out
    of_fraction: wp.array[wp.float64],
):
    """Turn the gradient of the end y' = (1 - f) x + f y of a vertex into those of x and y, and of f."""
    k = begin + wp.tid()
    of_fraction[k] = _ZERO
    if group[k] < 0:
        return
    t = toi[group[k]]
    if not wp.isfinite(t):
        return
    v = vertices[k]
    row = wp.where(t1_by_vertex != 0, v, k)
    g = gradient_t1[row]
    f = share * t
    if f > _ZERO and not (g == vec()):  # a vertex that takes no part may be at no number
        of_fraction[k] = wp.dot(in_space(g), end[v] - start[v])
    kept = real(f) * g
    gradient_t1[row] = kept
    if gradient_t0.shape[0] > 0:
        row_t0 = wp.where(t0_by_vertex != 0, v, k)
        gradient_t0[row_t0] = gradient_t0[row_t0] + (g - kept)


@wp.kernel(module=module)
def clear_unknown(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertex_rating: wp.array[wp.int32],
    t1_by_vertex: int,
    # in and out
    gradient_t1: wp.array[vec],
):
    """Take the gradient from positions whose derivative is not known."""
    k = begin + wp.tid()
    v = vertices[k]
    if vertex_rating[v] == UNKNOWN:
        gradient_t1[wp.where(t1_by_vertex != 0, v, k)] = vec()
