"""Pair functions on a tape: one recorded function gives the points of pairs the gradients of their tois."""

from typing import Any

import warp as wp

from ccd_warp._results.touch import Touch
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.tape import active_tape
from ccd_warp.kernels.gradients import toi_slope
from ccd_warp.kernels.template import specialised


def record_pairs(
    execution: Execution,
    touch: Touch,
    kind: PairKind,
    arrays: list[wp.array],
    points: list[wp.array],
    toi: wp.array,
    status: wp.array,
) -> None:
    """Record the backward pass of a result on the active tape; the values of the points are needed no longer.

    Args:
        execution: Where the pairs were solved.
        touch: What counts as touching.
        kind: The kind of the pairs.
        arrays: Those of the caller.
        points: The same points as the solver has taken them, vec3d.
        toi: Their tois, which from now on require a gradient.
        status: Their status.
    """
    count, device = len(toi), toi.device
    slopes = struct_of(
        toi_slope.Slopes,
        {name: wp.empty(count, dtype=dtype, device=device) for name, dtype in dtypes_of(toi_slope.Slopes).items()},
    )
    is_planar = arrays[0].dtype is wp.vec2d
    columns = {"points_t0": points[0], "points_t1": points[1], "toi": toi, "status": status}
    inputs = [touch.query(is_planar=is_planar), int(kind), struct_of(toi_slope.Table, columns)]
    execution.launch(toi_slope.fill_slopes, count, inputs, [slopes])
    toi.requires_grad = True
    kernels = specialised("gradients.toi_adjoint_points", dimension=2 if is_planar else 3)
    dtype = wp.vec2d if is_planar else wp.vec3d
    wanting = [array if array.requires_grad else None for array in arrays]

    def backward() -> None:
        grads = []
        for array in wanting:
            grad: Any = array if array is None else array.grad
            if grad is not None and grad.dtype is not dtype:  # float64 with an axis more
                grad = wp.array(ptr=grad.ptr, dtype=dtype, shape=grad.shape[:2], device=device, copy=False)
            grads.append(grad)
        execution.launch(kernels.add_points, count, [int(kind), slopes, toi.grad], grads)

    active_tape().record_func(backward, [toi, *(array for array in wanting if array is not None)])
