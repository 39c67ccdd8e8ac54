"""The cull of any number of lanes, called for pairs of points: what `test_rounding` and `test_cull` attack."""

from functools import cache

import numpy as np
import warp as wp
from ccd_warp.kernels.pair.single_points import corners, points_of
from ccd_warp.kernels.template import specialised

KINDS = {"vertex-face": 0, "edge-edge": 1}
WIDTHS = (1, 4, 8)


@cache
def _make_probe(width, test, flags):
    module = wp.get_module(f"cull_probe.{width}.{test}.{flags}")
    options = {"enable_backward": False, "fuse_fp": False, **({"cpu_compiler_flags": flags} if flags else {})}
    wp.set_module_options(options, module=module)
    cull = specialised("search.cull", width=width)
    free_lanes, bits_of = cull.free_lanes, cull.bits_of
    by_volume, by_sides = cull.is_free_by_volume, cull.is_free_by_sides
    Corners = specialised("pair.patch", width=width).Corners
    lanes = wp.constant(width)

    if width > 1:
        points_at = specialised("search.lane_points", width=width).points_at
        corners_of_lanes = specialised("pair.points", width=width).corners

        @wp.func
        def corners_at(kind: int, x: wp.array[wp.vec3d], first: int, count: int) -> Corners:
            vertices = wp.zeros(shape=32, dtype=wp.int32)
            for k in range(lanes):
                for n in range(4):
                    vertices[n * 8 + k] = 4 * wp.min(first + k, count - 1) + n
            return corners_of_lanes(kind, points_at(x, vertices, 0, 8))

    else:

        @wp.func
        def corners_at(kind: int, x: wp.array[wp.vec3d], first: int, count: int) -> Corners:
            v = 4 * first
            if kind == 1:
                return corners(kind, points_of(kind, wp.vec3i(v, v + 1, v), wp.vec3i(v + 2, v + 3, v), x))
            return corners(kind, points_of(kind, wp.vec3i(v, v, v), wp.vec3i(v + 1, v + 2, v + 3), x))

    @wp.kernel(module=module)
    def probe(
        kind: int,
        x0: wp.array[wp.vec3d],
        x1: wp.array[wp.vec3d],
        separation: wp.float64,
        is_euclidean: int,
        t_end: wp.float64,
        is_free: wp.array[wp.bool],
    ):
        first = wp.tid() * lanes
        count = is_free.shape[0]
        c0 = corners_at(kind, x0, first, count)
        c1 = corners_at(kind, x1, first, count)
        bits = wp.uint32(0)
        if wp.static(test == "volume"):
            bits = bits_of(by_volume(c0, c1, separation, is_euclidean, t_end))
        elif wp.static(test == "sides"):
            bits = bits_of(by_sides(kind, c0, c1, separation, is_euclidean, t_end))
        else:
            bits = free_lanes(kind, c0, c1, separation, is_euclidean, t_end, wp.uint32(0xFFFFFFFF))
        for k in range(lanes):
            if first + k < count:
                is_free[first + k] = ((bits >> wp.uint32(k)) & wp.uint32(1)) != wp.uint32(0)

    return probe


def culled(kind, points_t0, points_t1, width, *, separation=0.0, is_euclidean=False, t_end=1.0, test="both", flags=""):
    """Which pairs, given by points of shape [n, 4, 3], a test of the cull proves free.

    A separation is one in the maximum norm, or with ``is_euclidean`` a distance.
    ``flags`` are those of Warp's compiler, such as another processor.
    """
    count = len(points_t0)
    x = [wp.array(np.reshape(p, (-1, 3)), dtype=wp.vec3d, device="cpu") for p in (points_t0, points_t1)]
    is_free = wp.zeros(count, dtype=wp.bool, device="cpu")
    inputs = [KINDS[kind], *x, separation, int(is_euclidean), t_end]
    wp.launch(_make_probe(width, test, flags), -(-count // width), inputs=inputs, outputs=[is_free], device="cpu")
    return is_free.numpy()
