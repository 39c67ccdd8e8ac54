"""The holds of vertices (`hold`) in a line search on the device."""

import warp as wp

from .minima import Minima, world_of

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# A pair that starts within its distance has toi 0; one that starts next to it may have one that is lost in rounding.
_NEAR_BITS = wp.constant(wp.int64(0x3EB0000000000000))  # of 2^-20
_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.kernel
def clear_holds(
    begin: int,
    # out
    hold: wp.array[wp.float64],
):
    """Hold nothing."""
    hold[begin + wp.tid()] = _INFINITY


@wp.kernel
def clear_near(
    begin: int,
    # out
    body_near: wp.array[wp.int32],
    is_near: wp.array[wp.int32],
):
    """Note that no body is near another."""
    i = begin + wp.tid()
    body_near[i] = 0
    if i == 0:
        is_near[0] = 0


@wp.kernel
def note_near(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    m: Minima,
    # out
    body_near: wp.array[wp.int32],
    is_near: wp.array[wp.int32],
):
    """Note the bodies of the worlds whose toi is 0 or next to it."""
    v = vertices[begin + wp.tid()]
    if m.world[world_of(m, v)] < _NEAR_BITS:
        body_near[m.vertex_body[v]] = 1
        is_near[0] = 1


@wp.kernel
def keep_holds(
    begin: int,
    # in
    m: Minima,
    # out
    hold: wp.array[wp.float64],
):
    """Keep the holds that a search has found as minima of the vertices."""
    v = begin + wp.tid()
    hold[v] = wp.cast(m.vertex[v], wp.float64)
