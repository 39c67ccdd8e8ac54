"""What is near at one time: the list of pairs within a distance, and for each vertex how far it may move.

The length by which a vertex may move is an atomic minimum as those of the toi; a pair for which the search has no
capacity lowers it to 0 (`mark_overflow`). The kernel that measures the pairs is `measure_pairs`.
"""

import warp as wp

from ..atomics import atomic_min_int64
from ..pair.rounding import RELATIVE, UNIT_ROUNDOFF
from ..step.contacts import sort_key
from ..step.minima import CONTACTS_OVERFLOW, INVALID_INPUT, Minima, flag_world, world_of
from .pair_distance import UNDERFLOW

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_INFINITY_BITS = wp.constant(wp.int64(0x7FF0000000000000))
_DOWN = wp.constant(wp.float64(1.0 - RELATIVE * UNIT_ROUNDOFF[wp.float64]))


@wp.struct
class Reach:
    """How near is near."""

    distance: wp.float64  # pairs that are farther apart than this, and their radii, are left out
    kept: wp.float64  # the distance that bounds of displacements keep, beside the radii
    radius: wp.array[wp.float64]  # of each vertex, or empty
    stop: wp.array[wp.int32]  # set when the host wants a kernel to end


@wp.struct
class ProximityList:
    """Pairs of all kinds in any order, as many as the capacity allows, and the number of pairs found."""

    count: wp.array[wp.int32]
    kind: wp.array[wp.int32]
    primitives: wp.array[wp.vec2i]
    parameters: wp.array[wp.vec2d]
    distance: wp.array[wp.float64]
    direction: wp.array[wp.vec3d]
    features: wp.array[wp.int32]


@wp.struct
class Proximity:
    """What is listed of a near pair."""

    parameters: wp.vec2d
    distance: wp.float64
    direction: wp.vec3d
    features: int


@wp.func
def record_proximity(
    n: int, kind: int, pair: wp.vec2i, vertex: int, proximity: Proximity, minima: Minima, proximities: ProximityList
):
    """Write a pair at the place ``n`` that was claimed for it; if the list is full, flag the world of its vertex."""
    if n >= proximities.kind.shape[0]:
        flag_world(minima, vertex, CONTACTS_OVERFLOW)
        return
    proximities.kind[n] = kind
    proximities.primitives[n] = pair
    proximities.parameters[n] = proximity.parameters
    proximities.distance[n] = proximity.distance
    proximities.direction[n] = proximity.direction
    proximities.features[n] = proximity.features


@wp.func
def lower_bounds(c: wp.vec3i, bits: wp.int64, minima: Minima):
    """Lower the bounds of the vertices of a primitive."""
    for k in range(3):
        atomic_min_int64(minima.vertex, c[k], bits)


@wp.func
def bound_pair(
    a: wp.vec3i, b: wp.vec3i, least: wp.float64, kept: wp.float64, body_static: wp.array[wp.int32], minima: Minima
):
    """Lower the bounds of a pair that is at least ``least`` apart, and is to keep a distance (rounding, step 16).

    The two sides share what is between; a static one leaves all of it to the other.
    """
    gap = (least - kept) * _DOWN - UNDERFLOW
    if not gap > _ZERO:
        gap = _ZERO  # also where a radius is not finite
    is_static_a = body_static[minima.vertex_body[a[0]]] != 0
    is_static_b = body_static[minima.vertex_body[b[0]]] != 0
    if not is_static_a and not is_static_b:
        gap = wp.max(_HALF * gap - UNDERFLOW, _ZERO)
    bits = wp.cast(gap, wp.int64)
    if not is_static_a:
        lower_bounds(a, bits, minima)
    if not is_static_b:
        lower_bounds(b, bits, minima)


@wp.kernel
def reset_bounds(
    begin: int,
    # in
    largest: wp.float64,
    body_static: wp.array[wp.int32],
    # out
    minima: Minima,
):
    """Set the bound of each vertex to the largest; to 0 if it is static, or its world has a bad coordinate.

    Runs after all input is read.
    """
    v = begin + wp.tid()
    bits = wp.cast(largest, wp.int64)
    if body_static[minima.vertex_body[v]] != 0 or (minima.world_flags[world_of(minima, v)] & INVALID_INPUT) != 0:
        bits = wp.int64(0)
    minima.vertex[v] = bits


@wp.kernel
def unbind(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    # out
    minima: Minima,
):
    """Let nothing bound vertices that take no part."""
    minima.vertex[vertices[begin + wp.tid()]] = _INFINITY_BITS


@wp.kernel
def note_inflation(
    begin: int,  # a single item
    # in
    inflation: wp.float64,
    # in and out
    of_static: wp.array[wp.float64],
    # out
    is_moved: wp.array[wp.int32],
):
    """Have the boxes of static bodies made again if they have another inflation."""
    if not (of_static[begin + wp.tid()] == inflation):
        is_moved[0] = 1  # until `settle`
        of_static[0] = inflation


@wp.func
def key_and_place(kind: int, pair: wp.vec2i, n: int, index_bits: int, place_bits: int) -> wp.int64:
    """A key in the order of `sort_key`, without the bits that no index needs, and a place behind it.

    Such numbers are sorted in half of the time that a sort takes which moves places along with keys.
    """
    bits = wp.int64(index_bits)
    key = (wp.int64(kind) << bits | wp.int64(pair[0])) << bits | wp.int64(pair[1])
    return key << wp.int64(place_bits) | wp.int64(n)


@wp.kernel
def proximity_keys(
    begin: int,
    # in
    proximities: ProximityList,
    index_bits: int,
    place_bits: int,
    # out
    keys: wp.array[wp.int64],
):
    """Keys that order pairs by kind, then lexicographically; with their places behind them where these have bits."""
    n = begin + wp.tid()
    if n < proximities.count[0]:
        if place_bits == 0:
            keys[n] = sort_key(proximities.kind[n], proximities.primitives[n])
        else:
            keys[n] = key_and_place(proximities.kind[n], proximities.primitives[n], n, index_bits, place_bits)
