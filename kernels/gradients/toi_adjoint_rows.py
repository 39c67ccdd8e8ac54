"""What a backward pass adds to the gradients of a mesh's positions, of either precision, in space or in the plane."""

import warp as wp

from ..parameters import dimension, real
from ..step import in_space as positions
from .toi_adjoint import Pairs
from .toi_slope import Slopes

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))

vec = positions.vec
module = wp.get_module(f"ccd_warp.toi_adjoint_rows.{real.__name__}.{dimension}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.func
def rounded(x: wp.vec3d) -> vec:
    """A vector in the precision and the dimension of the positions."""
    y = vec()
    for i in range(wp.static(dimension)):
        y[i] = real(x[i])
    return y


@wp.kernel(module=module)
def add_rows(
    begin: int,
    # in
    pairs: Pairs,
    num_columns: int,
    slopes: Slopes,
    num_vertices: int,
    moving_row: wp.array[wp.int32],  # the place of each vertex among the moving ones; -1: it is static
    t0_by_vertex: int,  # 0: the rows are the moving vertices only
    t1_by_vertex: int,
    is_displacement: int,
    # out
    gradient_t0: wp.array[vec],  # of the input of a launch; empty where none is asked for
    gradient_t1: wp.array[vec],
    gradient_radius: wp.array[wp.float64],
):
    """Add what all pairs contribute to a vertex, in their order, at the first of its columns; these are sorted."""
    first = begin + wp.tid()
    v = pairs.column_vertex[first]
    if v == num_vertices:
        return
    if first > 0:
        if pairs.column_vertex[first - 1] == v:
            return
    of_start = wp.vec3d()
    of_end = wp.vec3d()
    of_radius = _ZERO
    for k in range(first, num_columns):
        if pairs.column_vertex[k] != v:
            break
        n = pairs.columns[k] / 4
        c = pairs.columns[k] % 4
        t = slopes.time[n]
        along = (-pairs.table.toi_gradient[n] * slopes.weights[n][c]) * slopes.slope[n]
        of_start += (_ONE - t) * along
        of_end += t * along
        if pairs.radius_columns.shape[0] > 0:
            of_columns = pairs.radius_columns[n]
            if of_columns[0] == c or of_columns[1] == c:
                of_radius += pairs.table.toi_gradient[n] * slopes.distance[n]
    row = moving_row[v]
    row_t0 = wp.where(t0_by_vertex != 0, v, row)
    row_t1 = wp.where(t1_by_vertex != 0, v, row)
    if row_t1 < 0 or is_displacement != 0:  # the end is the start, or follows from it
        of_start += of_end
    if gradient_t0.shape[0] > 0 and row_t0 >= 0:
        gradient_t0[row_t0] = gradient_t0[row_t0] + rounded(of_start)
    if gradient_t1.shape[0] > 0 and row_t1 >= 0:
        gradient_t1[row_t1] = gradient_t1[row_t1] + rounded(of_end)
    if gradient_radius.shape[0] > 0:
        gradient_radius[v] = gradient_radius[v] + of_radius
