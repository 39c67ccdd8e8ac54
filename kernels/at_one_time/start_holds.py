"""How near each vertex is to anything at the start: the holds of `hold`, found by a search at one time.

The least distance of a pair is proved in the norm of the separation. In the Euclidean norm it is that of
`pair_distance`. In the maximum norm, a direction d bounds the distance of the patch by least d·W / Σ|d_k|, and the best
direction is one of the facets of `facets`: an axis, a side crossed with an axis, or the normal.
"""

import warp as wp

from ..atomics import atomic_min_int64
from ..boxes.thickness import distance_of
from ..interrupts import is_stopped
from ..pair.norm import is_ball
from ..pair.rounding import LARGEST, inverse_power_of_two
from ..pair.single_points import Points, corners, largest, points_of, scaled, total
from ..pair_key import pair_of
from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE, VERTEX_PLANE
from ..parameters import norm
from ..step.contact_normal import to_unit_size
from ..step.contacts import vertices_of
from ..step.minima import FOUND, Minima, world_of
from .pair_distance import UNDERFLOW, bound_along, measured
from .proximity import Reach

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))
_ZERO = wp.constant(wp.float64(0.0))
_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))
_SHRUNK = wp.constant(wp.float64(2.0**-10))
_RESTORED = wp.constant(wp.float64(2.0**10))


@wp.func
def box_distance(kind: int, given: Points) -> wp.float64:
    """A lower bound of the distance of a pair in the maximum norm, NaN where a coordinate is not finite.

    Invariant: no two points of the pair are closer (rounding, step 15, with Σ|d_k| in place of |d|).
    """
    p = given
    c = corners(kind, p)
    restored = wp.float64(1.0)
    t = total(c)
    if not (t[0] + t[1] + t[2] < LARGEST):
        p = scaled(p, wp.vec3d(_SHRUNK, _SHRUNK, _SHRUNK))
        c = corners(kind, p)
        restored = _RESTORED
    size = largest(c)
    if not (t[0] + t[1] + t[2] == t[0] + t[1] + t[2]) or not wp.isfinite(wp.max(size)):
        return wp.float64(wp.nan)
    s = inverse_power_of_two(wp.max(size))
    w00 = s * c.w00
    w01 = s * c.w01
    w10 = s * c.w10
    w11 = s * c.w11
    error = s * size
    third = w10 - w01  # of a face
    least = _ZERO
    for number in range(13):
        d = wp.vec3d(_ZERO, _ZERO, _ZERO)
        axis = number % 3
        d[axis] = wp.float64(1.0)
        if number >= 3:
            side = w01 - w00
            if number >= 6:
                side = w10 - w00
            if number >= 9:
                side = wp.where(kind == VERTEX_FACE, third, wp.vec3d())
            d = wp.cross(side, d)
        if number == 12:
            d = wp.cross(w01 - w00, w10 - w00)
        if wp.max(wp.abs(d)) > _ZERO:
            d = to_unit_size(d)
            norm = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
            least = wp.max(least, bound_along(d, w00, w01, w10, w11, error, norm))
            least = wp.max(least, bound_along(-d, w00, w01, w10, w11, error, norm))
    return wp.max(wp.min(least / s * restored, _LARGEST_FINITE) - UNDERFLOW, _ZERO)


@wp.func
def least_distance(kind: int, p: Points, is_euclidean: bool) -> wp.float64:
    """A lower bound of the distance of a pair in the norm of the separation."""
    if is_euclidean:
        return measured(kind, p).least
    return box_distance(kind, p)


@wp.func
def lower_hold(corners: wp.vec3i, bits: wp.int64, minima: Minima):
    """Lower the holds of the vertices of a primitive."""
    for k in range(3):
        atomic_min_int64(minima.vertex, corners[k], bits)


module = wp.get_module(f"ccd_warp.holds.{'ball' if is_ball(norm) else 'box'}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def lower_holds(
    begin: int,
    # in
    num_solvers: int,
    chunk: int,
    kind: int,
    counts: wp.array2d[wp.int64],
    pairs: wp.array[wp.int64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    x: wp.array[wp.vec3d],
    reach: Reach,
    # out
    minima: Minima,
):
    """Lower the holds of the vertices of the pairs of a solver that are within the distance.

    They are the bits of the minima of the vertices. A coordinate that is not finite holds at 0.
    """
    count = wp.int32(wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0])))
    first = (begin + wp.tid()) * chunk
    while first < count:
        if is_stopped(reach.stop):
            return
        for k in range(first, wp.min(first + chunk, count)):
            pair = pair_of(pairs[k])
            a = first_corners[pair[0]]
            b = second_corners[pair[1]]
            least = least_distance(kind, points_of(kind, a, b, x), wp.static(is_ball(norm)))
            if not (least > distance_of(reach.distance, reach.radius, a, b)):
                bits = wp.int64(0)
                if least > _ZERO:
                    bits = wp.cast(least, wp.int64)
                lower_hold(a, bits, minima)
                if kind == EDGE_EDGE or kind == POINT_POINT:
                    lower_hold(b, bits, minima)
        if first > 2147483647 - num_solvers * chunk:
            return
        first += num_solvers * chunk


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
    least = least_distance(kind, points_of(kind, first, second, x), wp.static(is_ball(norm)))
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
