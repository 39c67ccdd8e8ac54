"""A step whose input and results stay on the device: what comes before the search and what the others write to.

Nothing here knows sizes that the device finds out: results have a place for every vertex, body and world, lists have a
capacity, and what does not fit lowers a toi to 0 and sets a flag.
"""

from types import SimpleNamespace

import warp as wp

from .atomics import atomic_min_int64
from .box_tree import WIDTH, BoxTree, Quantization, fill_block, unite_from, vertex_aabb, write_vertex_aabb
from .minima import FOUND, INVALID_INPUT, OPEN, Minima, flag_world, world_of
from .once import once

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# What moves by one fraction in a line search.
PER_SCENE = wp.constant(0)
PER_WORLD = wp.constant(1)
PER_BODY = wp.constant(2)
PER_VERTEX = wp.constant(3)

# Vertices and blocks of static bodies that one item looks after.
CHUNK = wp.constant(64)

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))
_ZERO_BITS = wp.constant(wp.int64(0))


@wp.kernel
def reset(
    begin: int,
    # in
    kept_flags: int,
    # out
    m: Minima,
    counts: wp.array2d[wp.int64],
    num_contacts: wp.array[wp.int32],
    stop: wp.array[wp.int32],
):
    """Nothing touches yet; flags go but those of looks before that concern this one."""
    i = begin + wp.tid()
    if i < m.body.shape[0]:
        m.body[i] = _INFINITY_BITS
    if i < m.world.shape[0]:
        m.world[i] = _INFINITY_BITS
        m.world_flags[i] = m.world_flags[i] & kept_flags
    if i == 0:
        m.scene[0] = _INFINITY_BITS
        if m.world.shape[0] > 1:  # else the flags of the world are those of the scene
            m.flags[0] = m.flags[0] & kept_flags
        num_contacts[0] = 0
        stop[0] = 0  # a launch before may have been ended by it
        for k in range(counts.shape[0]):
            counts[k, FOUND] = wp.int64(0)
            counts[k, OPEN] = wp.int64(0)


@wp.kernel
def reset_vertices(
    begin: int,
    # out
    m: Minima,
):
    """Nothing touches yet, but all does in a world with a coordinate that is not finite: what it would meet is unknown.

    After all input is read.
    """
    v = begin + wp.tid()
    bits = _INFINITY_BITS
    if (m.world_flags[world_of(m, v)] & INVALID_INPUT) != 0:
        bits = _ZERO_BITS
        atomic_min_int64(m.body, m.vertex_body[v], bits)
        atomic_min_int64(m.world, world_of(m, v), bits)
        atomic_min_int64(m.scene, 0, bits)
    m.vertex[v] = bits


@wp.kernel
def set_active(
    begin: int,
    # in
    value: int,
    # out
    body_active: wp.array[wp.int32],
):
    """The same for every body."""
    body_active[begin + wp.tid()] = value


@wp.kernel
def keep_touched(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    by_scene: int,
    m: Minima,
    # out
    body_active: wp.array[wp.int32],
):
    """The bodies of worlds in which something is about to be shortened; the rest is free as it is.

    ``by_scene`` where what touches in one world is shortened in others, too: then all bodies, if anything touches.
    """
    v = vertices[begin + wp.tid()]
    bits = m.world[world_of(m, v)]
    if by_scene != 0:
        bits = m.scene[0]
    if bits < _INFINITY_BITS:
        body_active[m.vertex_body[v]] = 1


@wp.func
def is_finite(x: wp.vec3d) -> bool:
    """Whether all coordinates are numbers."""
    return wp.isfinite(x[0]) and wp.isfinite(x[1]) and wp.isfinite(x[2])


@wp.kernel
def refresh_vertex_aabbs(
    begin: int,
    # in
    is_moved: wp.array[wp.int32],
    vertices: wp.array[wp.int32],
    vertex_world: wp.array[wp.int32],
    world_shift: wp.array[wp.vec3f],
    x: wp.array[wp.vec3d],
    inflation: wp.float64,
    quantization: Quantization,
    num_aabbs: int,
    # out
    vertex_aabbs: wp.array[wp.float32],
):
    """`fill_vertex_aabbs` for a chunk of vertices that rest, if one of them is not where it was."""
    if is_moved[0] != 0:
        first = (begin + wp.tid()) * CHUNK
        for k in range(first, wp.min(first + CHUNK, vertices.shape[0])):
            v = vertices[k]
            for n in range(num_aabbs):
                aabb = vertex_aabb(
                    v, vertex_world, world_shift, x[v], x[v], wp.float64(1.0), inflation, quantization, num_aabbs, n
                )
                write_vertex_aabb(vertex_aabbs, v * num_aabbs + n, aabb)


@wp.kernel
def refresh_blocks(
    begin: int,
    # in
    is_moved: wp.array[wp.int32],
    vertex_aabbs: wp.array[wp.float32],
    num_corners: int,
    # out
    tree: BoxTree,
):
    """`fill_blocks` for a chunk of blocks of a tree at rest, if something in it moved."""
    if is_moved[0] != 0:
        count = (tree.num_boxes + WIDTH - 1) / WIDTH
        first = (begin + wp.tid()) * CHUNK
        for b in range(first, wp.min(first + CHUNK, count)):
            fill_block(vertex_aabbs, num_corners, tree, b)


@wp.kernel
def refresh_levels(
    begin: int,
    # in
    is_moved: wp.array[wp.int32],
    count: int,
    # out
    tree: BoxTree,
):
    """`unite_levels`, likewise; a single item."""
    if is_moved[0] != 0:
        unite_from(tree, 2, count)


@wp.kernel
def settle(
    begin: int,
    # out
    is_moved: wp.array[wp.int32],
):
    """The boxes of static bodies are where their positions are; a single item, after all that makes them."""
    is_moved[begin + wp.tid()] = 0


@once
def make_input(real) -> SimpleNamespace:
    """Kernels that read positions of one precision."""
    vec3 = wp.types.vector(length=3, dtype=real)
    module = wp.get_module(f"ccd_warp.device_input.{real.__name__}")
    wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)

    @wp.kernel(module=module)
    def read_moving(
        begin: int,
        # in
        vertices: wp.array[wp.int32],
        vertices_t0: wp.array[vec3],
        vertices_t1: wp.array[vec3],
        t0_by_vertex: int,  # 0: rows are those of the moving vertices alone
        t1_by_vertex: int,
        is_displacement: int,
        is_kept: int,  # 0: the input itself is what the step reads
        # out
        start: wp.array[wp.vec3d],
        end: wp.array[wp.vec3d],
        m: Minima,
    ):
        """Positions of a moving vertex in float64, which hold those of either precision."""
        k = begin + wp.tid()
        v = vertices[k]
        a = wp.vec3d(vertices_t0[wp.where(t0_by_vertex != 0, v, k)])
        b = wp.vec3d(vertices_t1[wp.where(t1_by_vertex != 0, v, k)])
        if is_displacement != 0:
            b = a + b
        if is_kept != 0:
            start[v] = a
            end[v] = b
        if not (is_finite(a) and is_finite(b)):
            flag_world(m, v, INVALID_INPUT)

    @wp.kernel(module=module)
    def read_static(
        begin: int,
        # in
        vertices: wp.array[wp.int32],
        vertices_t0: wp.array[vec3],
        # out
        start: wp.array[wp.vec3d],
        end: wp.array[wp.vec3d],
        is_moved: wp.array[wp.int32],
        m: Minima,
    ):
        """Positions of a chunk of vertices that rest, and whether one is not where it was the last time.

        What is no number is left where it was: it may not be read again.
        """
        first = (begin + wp.tid()) * CHUNK
        for k in range(first, wp.min(first + CHUNK, vertices.shape[0])):
            v = vertices[k]
            a = wp.vec3d(vertices_t0[v])
            if not is_finite(a):
                flag_world(m, v, INVALID_INPUT)
            elif not (a == start[v]):
                is_moved[0] = 1  # until all boxes are where the positions are: `settle`
                start[v] = a
                end[v] = a

    @wp.kernel(module=module)
    def shorten(
        begin: int,
        # in
        vertices: wp.array[wp.int32],
        vertices_t0: wp.array[vec3],
        t0_by_vertex: int,
        t1_by_vertex: int,
        per: int,
        safety: wp.float64,
        m: Minima,
        # in and out
        vertices_t1: wp.array[vec3],
    ):
        """Move a vertex no farther than a share of the toi of what it moves with; exactly nowhere for a share of 0."""
        k = begin + wp.tid()
        v = vertices[k]
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
                for i in range(3):
                    if y[i] != x[i]:  # what rests is not to move by a rounding
                        # no difference of two far positions is formed, which could overflow
                        x[i] = real((wp.float64(1.0) - f) * wp.float64(x[i]) + f * wp.float64(y[i]))
            vertices_t1[row] = x

    return SimpleNamespace(read_moving=read_moving, read_static=read_static, shorten=shorten)
