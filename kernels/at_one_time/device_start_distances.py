"""The start distances of vertices (`start_distance`) in a line search on the device."""

import warp as wp

from ..step.minima import PAIRS_OVERFLOW, Minima, world_of

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.kernel
def clear_start_distances(
    begin: int,
    # out
    start_distance: wp.array[wp.float64],  # share and length of each vertex
):
    """Let no vertex keep a distance."""
    start_distance[begin + wp.tid()] = _INFINITY


@wp.kernel
def clear_near(
    begin: int,
    # out
    body_near: wp.array[wp.int32],
    world_near: wp.array[wp.int32],
    is_near: wp.array[wp.int32],
):
    """Note that nothing is near."""
    i = begin + wp.tid()
    if i < body_near.shape[0]:
        body_near[i] = 0
    if i < world_near.shape[0]:
        world_near[i] = 0
    if i == 0:
        is_near[0] = 0


@wp.kernel
def note_near_bodies(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    world_near: wp.array[wp.int32],
    minima: Minima,
    # out
    body_near: wp.array[wp.int32],
    is_near: wp.array[wp.int32],
):
    """Note the bodies of these worlds."""
    v = vertices[begin + wp.tid()]
    if world_near[world_of(minima, v)] != 0:
        body_near[minima.vertex_body[v]] = 1
        is_near[0] = 1


@wp.kernel
def drop_start_distances(
    begin: int,
    # in
    m: Minima,
    # out
    start_distance: wp.array[wp.float64],
):
    """Let no vertex keep a distance in a world that has a flag of a pair beyond the capacity, which is not measured."""
    v = begin + wp.tid()
    if (m.world_flags[world_of(m, v)] & PAIRS_OVERFLOW) != 0:
        start_distance[2 * v] = _INFINITY
        start_distance[2 * v + 1] = _INFINITY
