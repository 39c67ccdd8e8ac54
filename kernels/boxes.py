"""Swept axis-aligned boxes of vertices, edges and faces."""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

LARGEST = wp.constant(wp.float64(1.7976931348623157e308))


@wp.func
def next_below(x: wp.float64) -> wp.float64:
    """Largest float64 below x; minus infinity stays."""
    bits = wp.cast(x, wp.int64)
    if x == wp.float64(0.0):
        bits = wp.int64(-9223372036854775807)  # the smallest negative number, 0x8000000000000001
    elif x > wp.float64(0.0):
        bits = bits - wp.int64(1)
    elif bits != wp.int64(-4503599627370496):  # 0xfff0000000000000, minus infinity
        bits = bits + wp.int64(1)
    return wp.cast(bits, wp.float64)


@wp.func
def vec3_min(a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """Componentwise minimum, exact."""
    return wp.vec3d(wp.min(a[0], b[0]), wp.min(a[1], b[1]), wp.min(a[2], b[2]))


@wp.func
def vec3_max(a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """Componentwise maximum, exact."""
    return wp.vec3d(wp.max(a[0], b[0]), wp.max(a[1], b[1]), wp.max(a[2], b[2]))


@wp.kernel
def swept_boxes(
    begin: int,
    # in
    corners: wp.array[wp.vec3i],
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    inflation: wp.float64,
    # out
    box_lower: wp.array[wp.vec3d],
    box_upper: wp.array[wp.vec3d],
):
    """Box around a primitive at both frames; a primitive with fewer than three vertices repeats one in ``corners``."""
    i = begin + wp.tid()
    c = corners[i]
    lower = vec3_min(vertices_t0[c[0]], vertices_t1[c[0]])
    upper = vec3_max(vertices_t0[c[0]], vertices_t1[c[0]])
    if c[1] != c[0]:
        lower = vec3_min(lower, vec3_min(vertices_t0[c[1]], vertices_t1[c[1]]))
        upper = vec3_max(upper, vec3_max(vertices_t0[c[1]], vertices_t1[c[1]]))
    if c[2] != c[0]:
        lower = vec3_min(lower, vec3_min(vertices_t0[c[2]], vertices_t1[c[2]]))
        upper = vec3_max(upper, vec3_max(vertices_t0[c[2]], vertices_t1[c[2]]))
    if inflation > wp.float64(0.0):
        # The sum rounds to nearest, so its neighbour outward bounds the exact sum.
        for k in range(3):
            # Where it overflows the largest number will do: nothing lies beyond.
            lower[k] = wp.max(next_below(lower[k] - inflation), -LARGEST)
            upper[k] = wp.min(-next_below(-(upper[k] + inflation)), LARGEST)
    box_lower[i] = lower
    box_upper[i] = upper
