"""The contacts of a step that start near: where it matters how near vertices are at the start (`start_distance`).

It matters where a contact starts within its distance; the least distance of a pair is proved in the norm of the
separation. And it matters where a contact only passes by: a vertex that slides at its distance over a mesh starts a
rounding beyond it, and meets a face that it was not near to a rounding within it. The distances are lowered by
`measure_pairs`, after a search at one time.
"""

import warp as wp

from ..boxes.thickness import distance_of
from ..pair.passing import clip_passing
from ..pair.patch import Corners
from ..pair.rounding import PROJECTION_ROOT, UNIT_ROUNDOFF
from ..pair.single_points import Points, corners, largest, points_of
from ..pair_kind import EDGE_EDGE, VERTEX_FACE, VERTEX_PLANE
from ..parameters import norm
from ..step.contacts import vertices_of
from ..step.minima import Minima, world_of
from .box_distance import box_distance
from .pair_distance import measured
from .proximity import Reach

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_ROOT = wp.constant(wp.float64(PROJECTION_ROOT * UNIT_ROUNDOFF[wp.float64]))
# A share of a distance, and of the corners of a pair, that is more than all that rounding takes.
_CLEARLY = wp.constant(wp.float64(1.0 - 2.0**-20))
_NOISE = wp.constant(wp.float64(2.0**-40))


@wp.func
def least_distance(kind: int, p: Points) -> wp.float64:
    """A lower bound of the distance of a pair in the norm of the separation."""
    if wp.static(norm.is_ball):
        return measured(kind, p, True).least
    else:
        return box_distance(kind, p)


@wp.func
def patch_point(kind: int, c: Corners, parameters: wp.vec2d) -> wp.vec3d:
    """The difference of two points of a pair, given by their parameters."""
    along_q = parameters[0]
    along_r = parameters[1]
    if kind == EDGE_EDGE:
        along_q = parameters[1]
        along_r = parameters[0]
    return c.w00 + along_q * (c.w01 - c.w00) + along_r * (c.w10 - c.w00)


@wp.func
def comes_within(kind: int, c0: Corners, c1: Corners, parameters: wp.vec2d, distance: wp.float64) -> bool:
    """Whether two points of a pair clearly come nearer than a distance; where these touch first, most pairs do."""
    gap = patch_point(kind, c0, parameters)
    motion = patch_point(kind, c1, parameters) - gap
    nearest = gap + wp.clamp(-wp.dot(gap, motion) / wp.dot(motion, motion), _ZERO, _ONE) * motion
    size = wp.length(nearest)
    if wp.static(not norm.is_ball):
        size = wp.max(wp.abs(nearest))
    return size < _CLEARLY * distance - _NOISE * (wp.max(largest(c0)) + wp.max(largest(c1)))


@wp.func
def passes_by(kind: int, a: Points, b: Points, parameters: wp.vec2d, distance: wp.float64) -> bool:
    """Whether a direction keeps a pair at a distance all the step, in the norm of the separation."""
    c0 = corners(kind, a)
    c1 = corners(kind, b)
    if comes_within(kind, c0, c1, parameters, distance):
        return False
    error = _ROOT * (largest(c0) + largest(c1))
    separation = wp.vec3d(distance, distance, distance)
    return clip_passing(c0, c1, error, separation, kind == VERTEX_FACE, wp.uint32(1), _ZERO, _ONE) > _ONE


module = wp.get_module(f"ccd_warp.near_contacts.{'ball' if norm.is_ball else 'box'}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def note_near_contacts(
    begin: int,
    # in
    count: wp.array[wp.int32],
    kinds: wp.array[wp.int32],
    primitives: wp.array[wp.vec2i],
    parameters: wp.array[wp.vec2d],
    vertex_corners: wp.array[wp.vec3i],
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    x: wp.array[wp.vec3d],
    x_t1: wp.array[wp.vec3d],
    reach: Reach,
    minima: Minima,
    # out
    world_near: wp.array[wp.int32],
):
    """Note the worlds of contacts that start within the distance, or pass by at it.

    Those beyond the list may be in any world. What passes keeps its distance but for the slack that ``reach`` has
    beyond it. Without positions at the end, as on arcs, any may pass by.
    """
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
    if world_near[world_of(minima, first[0])] != 0:
        return
    start = points_of(kind, first, second, x)
    is_near = x_t1.shape[0] == 0
    if not is_near:
        is_near = not (least_distance(kind, start) > distance_of(reach.distance, reach.radius, first, second))
    if not is_near:
        end = points_of(kind, first, second, x_t1)
        slack = reach.distance - reach.kept
        kept = distance_of(reach.kept, reach.radius, first, second) - slack
        is_near = passes_by(kind, start, end, parameters[n], kept)
    if is_near:
        world_near[world_of(minima, first[0])] = 1
