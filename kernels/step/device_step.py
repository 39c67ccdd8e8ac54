"""A step whose input and results stay on the device: the kernels that reset its results and place its boxes.

The sizes of these kernels do not depend on what the device finds: results have a place for every vertex, body and
world, and lists have a fixed capacity. A pair beyond the capacity lowers its toi to 0 and sets a flag.
"""

import warp as wp

from ..atomics import atomic_min_int64
from ..boxes.box_tree import Quantization, Worlds, vertex_aabb, write_vertex_aabb
from .minima import FOUND, INVALID_INPUT, MOST_FOUND, MOST_LISTED, STATIC_MOVED, STRUCK, Minima, world_of

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# The parts of a mesh that move by one common fraction in a line search.
PER_SCENE = wp.constant(0)
PER_WORLD = wp.constant(1)
PER_BODY = wp.constant(2)
PER_VERTEX = wp.constant(3)

# Vertices of static bodies that one item reads on the CPU.
CHUNK = wp.constant(64)

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))
_ZERO_BITS = wp.constant(wp.int64(0))


@wp.kernel
def reset(
    begin: int,
    # in
    kept_flags: int,
    keeps_toi: int,  # 1: every toi stays
    # out
    m: Minima,
    counts: wp.array2d[wp.int64],
    num_contacts: wp.array[wp.int32],
    stop: wp.array[wp.int32],
):
    """Set the toi of bodies, worlds and scene to infinity, counts to 0; clear all flags but those in ``kept_flags``.

    A pass that keeps flags is not the first of its launch: the most pairs and contacts of those before it stay known.
    """
    i = begin + wp.tid()
    if i < m.world.shape[0]:
        m.world_flags[i] = m.world_flags[i] & kept_flags
    if keeps_toi == 0:
        if i < m.body.shape[0]:
            m.body[i] = _INFINITY_BITS
        if i < m.world.shape[0]:
            m.world[i] = _INFINITY_BITS
        if i == 0:
            m.scene[0] = _INFINITY_BITS
    if i == 0:
        if m.world.shape[0] > 1:  # otherwise the scene and its only world share their flags
            m.flags[0] = m.flags[0] & kept_flags
        stop[0] = 0  # it may have ended an earlier launch
    if i < counts.shape[0]:
        most = wp.max(counts[i, MOST_FOUND], counts[i, FOUND])
        most_listed = counts[i, MOST_LISTED]
        for column in range(counts.shape[1]):
            counts[i, column] = wp.int64(0)
        if kept_flags != 0:
            counts[i, MOST_FOUND] = most
        if i == 1:
            if kept_flags != 0:
                counts[i, MOST_LISTED] = wp.max(most_listed, wp.int64(num_contacts[0]))
            num_contacts[0] = 0


@wp.kernel
def tell_most_found(
    begin: int,
    # in and out
    counts: wp.array2d[wp.int64],
):
    """Of each kind, let the number of pairs be the most of any pass; launched after the last."""
    k = begin + wp.tid()
    counts[k, FOUND] = wp.max(counts[k, FOUND], counts[k, MOST_FOUND])


@wp.kernel
def reset_vertices(
    begin: int,
    # out
    m: Minima,
):
    """Set the toi of each vertex to infinity, or to 0 in a world whose input is not as it has to be.

    Of a coordinate that is not finite, or a static body that moves, contacts are unknown, so the whole world counts as
    touching. Runs after all input is read.
    """
    v = begin + wp.tid()
    bits = _INFINITY_BITS
    if (m.world_flags[world_of(m, v)] & (INVALID_INPUT | STATIC_MOVED)) != 0:
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
    is_any_active: wp.array[wp.int32],
):
    """Write one value for every body, and whether a body is active."""
    i = begin + wp.tid()
    body_active[i] = value
    if i == 0:
        is_any_active[0] = value


@wp.kernel
def keep_touched(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    by_scene: int,
    m: Minima,
    # out
    body_active: wp.array[wp.int32],
    is_any_active: wp.array[wp.int32],
):
    """Activate the bodies of the worlds in which a contact was found, where the motion is about to be shortened.

    The other worlds are known to be free of contact and are not searched again. With ``by_scene``, a contact shortens
    the motion in all worlds: then any contact activates all bodies. What a kinematic body strikes is to be found again,
    so that the last pass lists it.
    """
    v = vertices[begin + wp.tid()]
    bits = m.world[world_of(m, v)]
    flags = m.world_flags[world_of(m, v)]
    if by_scene != 0:
        bits = m.scene[0]
        flags = m.flags[0]
    if bits < _INFINITY_BITS or (flags & STRUCK) != 0:
        body_active[m.vertex_body[v]] = 1
        is_any_active[0] = 1


@wp.kernel
def refresh_vertex_aabbs(
    begin: int,
    # in
    is_moved: wp.array[wp.int32],
    vertices: wp.array[wp.int32],
    worlds: Worlds,
    x: wp.array[wp.vec3d],
    inflation: wp.float64,
    box_radius: wp.array[wp.float64],
    quantization: Quantization,
    num_aabbs: int,
    # out
    vertex_aabbs: wp.array[wp.float32],
):
    """`fill_vertex_aabbs` for static vertices, if any has changed its position or radius."""
    if is_moved[0] != 0:
        v = vertices[begin + wp.tid()]
        for n in range(num_aabbs):
            one = wp.float64(1.0)
            aabb = vertex_aabb(v, worlds, x, x, one, inflation, box_radius, quantization, num_aabbs, n)
            write_vertex_aabb(vertex_aabbs, v * num_aabbs + n, aabb)


@wp.kernel
def settle(
    begin: int,
    # out
    is_moved: wp.array[wp.int32],
):
    """Mark the boxes of static bodies as up to date; a single item, launched after all kernels that update them."""
    is_moved[begin + wp.tid()] = 0
