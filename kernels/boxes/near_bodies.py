"""Which bodies another comes near, found among the launches of a step: the boxes around whole bodies, all with all.

The boxes are in float64, rounded outward, and closed: those that touch in a point meet. Where bodies are too many or
too large for that, a launch searches all of them, and the host has a tree of them (`body_boxes`).
"""

import warp as wp

from ..search.collision_filter import CollisionFilter, are_bodies_excluded

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY = wp.constant(wp.float64(float("inf")))
# More than what rounding takes of a sum, as shares of its terms.
_OUTWARD = wp.constant(wp.float64(1.0 + 2.0**-50))
_ROUNDING = wp.constant(wp.float64(2.0**-51))


@wp.kernel
def fill_body_boxes(
    begin: int,
    # in
    body_begin: wp.array[wp.int32],  # the first vertex of each body, and the end of the last
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    radius: wp.array[wp.float64],  # of the boxes around each vertex, where they have some
    inflation: wp.float64,
    # out
    lower: wp.array[wp.vec3d],
    upper: wp.array[wp.vec3d],
    is_any: wp.array[wp.int32],
):
    """Compute a box around each body over the step, rounded outward; everything if a coordinate is not finite."""
    i = begin + wp.tid()
    if i == 0:
        is_any[0] = 0
    low = wp.vec3d(_INFINITY, _INFINITY, _INFINITY)
    high = -low
    growth = wp.float64(0.0)
    is_finite = bool(True)
    for v in range(body_begin[i], body_begin[i + 1]):
        p = vertices_t0[v]
        q = vertices_t1[v]
        low = wp.min(low, wp.min(p, q))
        high = wp.max(high, wp.max(p, q))
        if radius.shape[0] > 0:
            growth = wp.max(growth, radius[v])
        for axis in range(3):
            is_finite = is_finite and wp.isfinite(p[axis]) and wp.isfinite(q[axis])
    growth = (growth + inflation) * _OUTWARD
    for axis in range(3):
        low[axis] = (low[axis] - growth) - _ROUNDING * (wp.abs(low[axis]) + growth)
        high[axis] = (high[axis] + growth) + _ROUNDING * (wp.abs(high[axis]) + growth)
        if not is_finite:
            low[axis] = -_INFINITY
            high[axis] = _INFINITY
    lower[i] = low
    upper[i] = high


@wp.kernel
def mark_active_near(
    begin: int,
    # in
    lower: wp.array[wp.vec3d],
    upper: wp.array[wp.vec3d],
    active: wp.array[wp.int32],
    always: wp.array[wp.int32],  # 1: searched if it is active, whatever comes near it; 2: static
    collision_filter: CollisionFilter,
    # out
    is_near: wp.array[wp.int32],
    is_any: wp.array[wp.int32],
):
    """Mark the active bodies whose boxes meet those of others with which they may collide, and whether any does."""
    i = begin + wp.tid()
    near = int(active[i])
    if near != 0 and always[i] == 0:
        near = int(0)
        low = lower[i]
        high = upper[i]
        j = int(0)
        while near == 0 and j < lower.shape[0]:
            if lower[j][0] <= high[0] and upper[j][0] >= low[0]:
                if lower[j][1] <= high[1] and upper[j][1] >= low[1]:
                    if lower[j][2] <= high[2] and upper[j][2] >= low[2] and j != i:
                        if not are_bodies_excluded(i, j, collision_filter):
                            near = 1
            j += 1
    is_near[i] = near
    if near != 0 and always[i] != 2:
        is_any[0] = 1
