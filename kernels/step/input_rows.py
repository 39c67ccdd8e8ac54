"""The input of a step on the device: the kernels that read rows of positions, check static ones, and shorten a step."""

import warp as wp

from ..parameters import dimension, real
from . import in_space as positions
from .device_step import PER_BODY, PER_VERTEX, PER_WORLD
from .minima import INVALID_INPUT, STATIC_MOVED, Minima, flag_world, world_of

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))


@wp.func
def is_finite(x: wp.vec3d) -> bool:
    """Whether all coordinates are finite."""
    return wp.isfinite(x[0]) and wp.isfinite(x[1]) and wp.isfinite(x[2])


vec, in_space = positions.vec, positions.in_space
module = wp.get_module(f"ccd_warp.device_input.{real.__name__}.{dimension}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def read_moving(
    begin: int,
    # in
    vertices: wp.array[wp.int32],  # -1 - v in place of a vertex v that takes no part
    vertices_t0: wp.array[vec],
    vertices_t1: wp.array[vec],
    t0_by_vertex: int,  # 0: the rows are the moving vertices only
    t1_by_vertex: int,
    is_displacement: int,
    is_kept: int,  # 0: the step reads the input array itself
    # out
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    m: Minima,
):
    """Read the positions of a moving vertex into float64; those of one that takes no part need not be finite."""
    k = begin + wp.tid()
    v = wp.max(vertices[k], -1 - vertices[k])
    a = in_space(vertices_t0[wp.where(t0_by_vertex != 0, v, k)])
    b = in_space(vertices_t1[wp.where(t1_by_vertex != 0, v, k)])
    if is_displacement != 0:
        b = a + b
    if is_kept != 0:
        start[v] = a
        end[v] = b
    if vertices[k] >= 0 and not (is_finite(a) and is_finite(b)):
        flag_world(m, v, INVALID_INPUT)


@wp.func
def stays(a: vec, b: vec, is_displacement: int) -> bool:
    """Whether a vertex at a ends there, given its end position or its displacement."""
    if is_displacement != 0:
        return b == vec()
    return a == b


@wp.kernel(module=module)
def read_static(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertices_t0: wp.array[vec],
    vertices_t1: wp.array[vec],
    t1_by_vertex: int,  # 0: it has no rows of static vertices
    is_displacement: int,
    chunk: int,  # vertices of an item, as above
    # out
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    is_moved: wp.array[wp.int32],
    m: Minima,
):
    """Read the positions of a chunk of static vertices, and set ``is_moved`` if one of them has changed.

    A vertex that does not end where it starts flags its world.

    A vertex with a coordinate that is not finite keeps its last position, since later launches may not read it.
    """
    first = (begin + wp.tid()) * chunk
    for k in range(first, wp.min(first + chunk, vertices.shape[0])):
        v = vertices[k]
        a = in_space(vertices_t0[v])
        if not is_finite(a):
            flag_world(m, v, INVALID_INPUT)
            continue
        if not (a == start[v]):
            is_moved[0] = 1  # until `settle`, when all boxes are up to date
            start[v] = a
            end[v] = a
        if t1_by_vertex != 0:
            if not stays(vertices_t0[v], vertices_t1[v], is_displacement):
                flag_world(m, v, STATIC_MOVED)


@wp.kernel(module=module)
def check_static(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertices_t1: wp.array[vec],
    is_displacement: int,
    chunk: int,  # vertices of an item, as above
    start: wp.array[wp.vec3d],
    # out
    m: Minima,
):
    """Flag the worlds in which a static vertex of a chunk, which is where it was, does not end there."""
    first = (begin + wp.tid()) * chunk
    for k in range(first, wp.min(first + chunk, vertices.shape[0])):
        v = vertices[k]
        a = vec()
        for i in range(wp.static(dimension)):
            a[i] = real(start[v][i])
        if not stays(a, vertices_t1[v], is_displacement):
            flag_world(m, v, STATIC_MOVED)


@wp.kernel(module=module)
def shorten(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertices_t0: wp.array[vec],
    t0_by_vertex: int,
    t1_by_vertex: int,
    per: int,
    safety: wp.float64,
    body_kept: wp.array[wp.int32],  # 1: what moves its vertices is not here; empty where there is no such body
    m: Minima,
    # in and out
    vertices_t1: wp.array[vec],
):
    """Shorten the motion of a free vertex to the share ``safety`` of the toi of the part that it moves with.

    A share of 0 moves it back to exactly its start.
    """
    k = begin + wp.tid()
    v = vertices[k]
    if body_kept.shape[0] > 0:
        if body_kept[m.vertex_body[v]] != 0:
            return
    bits = m.scene[0]
    if per == PER_WORLD:
        bits = m.world[world_of(m, v)]
    elif per == PER_BODY:
        bits = m.body[m.vertex_body[v]]
    elif per == PER_VERTEX:
        bits = m.vertex[v]
    if bits < _INFINITY_BITS:
        row = wp.where(t1_by_vertex != 0, v, k)
        x = vertices_t0[wp.where(t0_by_vertex != 0, v, k)]
        f = safety * wp.cast(bits, wp.float64)
        if f > wp.float64(0.0):
            y = vertices_t1[row]
            for i in range(wp.static(dimension)):
                if y[i] != x[i]:  # a stationary coordinate must not move by a rounding
                    # a difference of two distant positions, which could overflow, is avoided
                    x[i] = real((wp.float64(1.0) - f) * wp.float64(x[i]) + f * wp.float64(y[i]))
        vertices_t1[row] = x
