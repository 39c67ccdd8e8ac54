"""How near vertices are to anything at the start: which contacts start within their distance, and the holds of `hold`.

The least distance of a pair is proved in the norm of the separation. The holds themselves are lowered by
`measure_pairs`, after a search at one time.
"""

import warp as wp

from ..boxes.thickness import distance_of
from ..pair.norm import is_ball
from ..pair.single_points import Points, points_of
from ..pair_kind import VERTEX_PLANE
from ..parameters import norm
from ..step.contacts import vertices_of
from ..step.minima import Minima, world_of
from .box_distance import box_distance
from .pair_distance import measured
from .proximity import Reach

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))


@wp.func
def least_distance(kind: int, p: Points) -> wp.float64:
    """A lower bound of the distance of a pair in the norm of the separation."""
    if wp.static(is_ball(norm)):
        return measured(kind, p, True).least
    else:
        return box_distance(kind, p)


module = wp.get_module(f"ccd_warp.near_contacts.{'ball' if is_ball(norm) else 'box'}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def note_near_contacts(
    begin: int,
    # in
    count: wp.array[wp.int32],
    kinds: wp.array[wp.int32],
    primitives: wp.array[wp.vec2i],
    vertex_corners: wp.array[wp.vec3i],
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    x: wp.array[wp.vec3d],
    reach: Reach,
    minima: Minima,
    # out
    world_near: wp.array[wp.int32],
):
    """Note the worlds of contacts that start within the distance; those beyond the list may be in any world."""
    n = begin + wp.tid()
    if n == 0 and count[0] > kinds.shape[0]:
        for world in range(world_near.shape[0]):
            world_near[world] = 1
    if n >= count[0]:
        return
    kind = kinds[n]
    if kind == VERTEX_PLANE:
        return
    first, second = vertices_of(kind, primitives[n], vertex_corners, edge_corners, face_corners)
    least = least_distance(kind, points_of(kind, first, second, x))
    if not (least > distance_of(reach.distance, reach.radius, first, second)):
        world_near[world_of(minima, first[0])] = 1


@wp.kernel
def reset_holds(
    begin: int,
    # out
    minima: Minima,
):
    """Hold nothing."""
    minima.vertex[begin + wp.tid()] = _INFINITY_BITS
