"""Gather: contacts in order with their normals, and the earliest toi of every vertex and body, and whose it is.

A toi is not negative, so its bits as an integer compare as the numbers do, and the minimum is an integer's: native on
CUDA, and the same whatever comes first. Which contact it belongs to is settled in a second pass, the lowest index where
several share it.
"""

import warp as wp

from .patch import EDGE_EDGE, VERTEX_FACE
from .points import pair_of
from .rounding import inverse_power_of_two

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Sine below which two sides count as parallel and their cross product as no direction.
_PARALLEL = wp.constant(wp.float64(1.0e-12))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))

# Place of the number of contacts in a row of counts.
CONTACTS = wp.constant(0)


@wp.struct
class Contacts:
    """What the narrow phase writes of contacts of one kind."""

    pair: wp.array[wp.int64]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    parameters: wp.array[wp.vec2d]
    gap: wp.array[wp.float64]
    width: wp.array[wp.float64]


@wp.struct
class ContactList:
    """Contacts of all kinds in any order, as far as there is room, and how many there are."""

    count: wp.array[wp.int32]
    kind: wp.array[wp.int32]
    primitives: wp.array[wp.vec2i]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    parameters: wp.array[wp.vec2d]
    gap: wp.array[wp.float64]
    width: wp.array[wp.float64]
    normal: wp.array[wp.vec3d]


@wp.func
def to_unit_size(a: wp.vec3d) -> wp.vec3d:
    """A vector scaled by a power of two so that its products neither overflow nor underflow."""
    return a * inverse_power_of_two(wp.max(wp.abs(a)))


@wp.func
def contact_normal(q: wp.vec3d, r: wp.vec3d, velocity: wp.vec3d) -> wp.vec3d:
    """Unit normal of two sides against the relative velocity of the first primitive; 0 where there is none.

    Parallel or vanishing sides leave a choice: then it is the part of the velocity across the longer side.
    """
    a = to_unit_size(q)
    b = to_unit_size(r)
    w = to_unit_size(velocity)
    n = wp.cross(a, b)
    if wp.length(n) <= _PARALLEL * wp.length(a) * wp.length(b):
        along = to_unit_size(q)
        if wp.max(wp.abs(r)) > wp.max(wp.abs(q)):
            along = to_unit_size(r)
        n = w
        if wp.dot(along, along) > _ZERO:
            n = w - (wp.dot(w, along) / wp.dot(along, along)) * along
    n = wp.normalize(n)
    if wp.dot(n, w) > _ZERO:
        n = -n
    return n


@wp.func
def across(w: wp.vec3d, side: wp.vec3d) -> wp.vec3d:
    """The part of w across a side, 0 where rounding is all that is left of it; all of w if the side has no length."""
    s = to_unit_size(side)
    n = to_unit_size(w)
    if wp.dot(s, s) > _ZERO:
        n = n - (wp.dot(n, s) / wp.dot(s, s)) * s
        if wp.length(n) <= _PARALLEL:
            n = wp.vec3d(_ZERO, _ZERO, _ZERO)
    return n


@wp.func
def point_normal(side: wp.vec3d, velocity: wp.vec3d, gap: wp.vec3d) -> wp.vec3d:
    """Unit normal of a point at a segment, or at a point if the side is 0: against the relative velocity.

    Where that has no part across the side it is along the gap (a minimum separation leaves one); 0 where both vanish.
    """
    n = -across(velocity, side)
    if wp.dot(n, n) == _ZERO:
        n = across(gap, side)
    return wp.normalize(n)


@wp.func
def position(x_t0: wp.vec3d, x_t1: wp.vec3d, t: wp.float64) -> wp.vec3d:
    return (_ONE - t) * x_t0 + t * x_t1


@wp.kernel
def lift(
    # in
    points: wp.array2d[wp.vec2d],
    # out
    lifted: wp.array2d[wp.vec3d],
):
    """Points of the plane as points of space at z = 0."""
    i, j = wp.tid()
    p = points[i, j]
    lifted[i, j] = wp.vec3d(p[0], p[1], _ZERO)


@wp.func
def normal_at(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    x_t0: wp.array[wp.vec3d],
    x_t1: wp.array[wp.vec3d],
    t: wp.float64,
    uv: wp.vec2d,
) -> wp.vec3d:
    """Unit normal of a contact of two primitives, given by their vertices."""
    a0 = position(x_t0[first[0]], x_t1[first[0]], t)
    b0 = position(x_t0[second[0]], x_t1[second[0]], t)
    b1 = position(x_t0[second[1]], x_t1[second[1]], t)
    # motion of the two points in contact over the step
    va = x_t1[first[0]] - x_t0[first[0]]
    vb = x_t1[second[0]] - x_t0[second[0]]
    vb1 = x_t1[second[1]] - x_t0[second[1]]
    if kind == EDGE_EDGE:
        q = position(x_t0[first[1]], x_t1[first[1]], t) - a0
        r = b1 - b0
        va = (_ONE - uv[0]) * va + uv[0] * (x_t1[first[1]] - x_t0[first[1]])
        vb = (_ONE - uv[1]) * vb + uv[1] * vb1
    else:
        q = b1 - b0
        r = position(x_t0[second[2]], x_t1[second[2]], t) - b0
        vb = (_ONE - uv[0] - uv[1]) * vb + uv[0] * vb1 + uv[1] * (x_t1[second[2]] - x_t0[second[2]])
    if kind == EDGE_EDGE or kind == VERTEX_FACE:
        return contact_normal(q, r, va - vb)
    # absent corners repeat the last one, so q is the segment, or 0 for a point
    return point_normal(q, va - vb, a0 - b0 - uv[0] * q)


@wp.kernel
def describe_contacts(
    begin: int,
    # in
    kind: int,
    order: wp.array[wp.int32],
    contacts: Contacts,
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    x_t0: wp.array[wp.vec3d],
    x_t1: wp.array[wp.vec3d],
    first_contact: int,
    # out
    kind_out: wp.array[wp.int32],
    primitives_out: wp.array[wp.vec2i],
    toi_out: wp.array[wp.float64],
    status_out: wp.array[wp.int32],
    parameters_out: wp.array[wp.vec2d],
    gap_out: wp.array[wp.float64],
    width_out: wp.array[wp.float64],
    normal_out: wp.array[wp.vec3d],
):
    """Write the contacts of a kind in their order, with their normals."""
    n = begin + wp.tid()
    k = order[n]
    slot = first_contact + n
    pair = pair_of(contacts.pair[k])
    first = first_corners[pair[0]]
    second = second_corners[pair[1]]
    t = contacts.toi[k]
    uv = contacts.parameters[k]
    kind_out[slot] = kind
    primitives_out[slot] = pair
    toi_out[slot] = t
    status_out[slot] = contacts.status[k]
    gap_out[slot] = contacts.gap[k]
    width_out[slot] = contacts.width[k]
    parameters_out[slot] = uv
    normal_out[slot] = normal_at(kind, first, second, x_t0, x_t1, t, uv)


@wp.func
def contact_vertex(
    kind: int, pair: wp.vec2i, k: int, first_corners: wp.array[wp.vec3i], second_corners: wp.array[wp.vec3i]
) -> int:
    """Vertex k of the four of a contact; absent ones repeat another."""
    if kind == EDGE_EDGE and k < 2:
        return first_corners[pair[0]][k]
    if kind == EDGE_EDGE:
        return second_corners[pair[1]][k - 2]
    if k == 0:
        return first_corners[pair[0]][0]
    return second_corners[pair[1]][k - 1]


@wp.kernel
def lower_toi(
    begin: int,
    # in
    kind: int,
    first_contact: int,
    primitives: wp.array[wp.vec2i],
    toi: wp.array[wp.float64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    vertex_body: wp.array[wp.int32],
    # out
    vertex_toi_bits: wp.array[wp.int64],
    body_toi_bits: wp.array[wp.int64],
):
    """Lower the toi of the vertices and bodies of a contact. Serial on the CPU: its atomics are none across threads."""
    n = first_contact + begin + wp.tid()
    bits = wp.cast(toi[n], wp.int64)
    for k in range(4):
        v = contact_vertex(kind, primitives[n], k, first_corners, second_corners)
        wp.atomic_min(vertex_toi_bits, v, bits)
        wp.atomic_min(body_toi_bits, vertex_body[v], bits)


@wp.kernel
def first_contacts(
    begin: int,
    # in
    kind: int,
    first_contact: int,
    primitives: wp.array[wp.vec2i],
    toi: wp.array[wp.float64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    vertex_body: wp.array[wp.int32],
    vertex_toi_bits: wp.array[wp.int64],
    body_toi_bits: wp.array[wp.int64],
    # out
    vertex_contact: wp.array[wp.int32],
    body_contact: wp.array[wp.int32],
):
    """The contact that each toi belongs to: the lowest index. Serial on the CPU, as above."""
    n = first_contact + begin + wp.tid()
    bits = wp.cast(toi[n], wp.int64)
    for k in range(4):
        v = contact_vertex(kind, primitives[n], k, first_corners, second_corners)
        if vertex_toi_bits[v] == bits:
            wp.atomic_min(vertex_contact, v, n)
        if body_toi_bits[vertex_body[v]] == bits:
            wp.atomic_min(body_contact, vertex_body[v], n)
