"""Contacts: their normals, their order, and the first contact of each vertex and each body."""

import warp as wp

from .atomics import atomic_min_int32
from .minima import Minima
from .pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE, VERTEX_PLANE
from .rounding import inverse_power_of_two

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Sine below which two sides count as parallel, so that their cross product is not used as a direction.
_PARALLEL = wp.constant(wp.float64(1.0e-12))
# In place of the index of a first contact: none.
NO_CONTACT = wp.constant(2**31 - 1)
_PLANE_BIT = wp.constant(wp.int64(1 << 30))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.struct
class ContactList:
    """Contacts of all kinds in any order, as many as the capacity allows, and the number of contacts found."""

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
    """Unit normal of two sides, directed against the relative velocity of the first primitive; 0 if there is none.

    Parallel or vanishing sides do not determine a normal: then the part of the velocity across the longer side is used.
    """
    a = to_unit_size(q)
    b = to_unit_size(r)
    w = to_unit_size(velocity)
    n = wp.cross(a, b)
    if wp.length(n) <= _PARALLEL * wp.length(a) * wp.length(b):
        along = wp.where(wp.max(wp.abs(r)) > wp.max(wp.abs(q)), b, a)
        n = w
        if wp.dot(along, along) > _ZERO:
            n = w - (wp.dot(w, along) / wp.dot(along, along)) * along
    n = wp.normalize(n)
    if wp.dot(n, w) > _ZERO:
        n = -n
    return n


@wp.func
def across(w: wp.vec3d, side: wp.vec3d) -> wp.vec3d:
    """The part of w orthogonal to a side, 0 if it consists of rounding only; all of w if the side has no length."""
    s = to_unit_size(side)
    n = to_unit_size(w)
    if wp.dot(s, s) > _ZERO:
        n = n - (wp.dot(n, s) / wp.dot(s, s)) * s
        if wp.length(n) <= _PARALLEL:
            n = wp.vec3d(_ZERO, _ZERO, _ZERO)
    return n


@wp.func
def point_normal(side: wp.vec3d, velocity: wp.vec3d, gap: wp.vec3d) -> wp.vec3d:
    """Unit normal of a point at a segment, or at a point if the side is 0, directed against the relative velocity.

    If the velocity has no part across the side, the normal is along the gap, which a minimum separation leaves. It is 0
    if both vanish.
    """
    n = -across(velocity, side)
    if wp.dot(n, n) == _ZERO:
        n = across(gap, side)
    return wp.normalize(n)


@wp.func
def position(p_t0: wp.vec3d, p_t1: wp.vec3d, t: wp.float64) -> wp.vec3d:
    """Position of a point at time t."""
    return (_ONE - t) * p_t0 + t * p_t1


@wp.kernel
def lift(
    # in
    points: wp.array2d[wp.vec2d],
    # out
    lifted: wp.array2d[wp.vec3d],
):
    """Embed points of the plane in space at z = 0."""
    i, j = wp.tid()
    p = points[i, j]
    lifted[i, j] = wp.vec3d(p[0], p[1], _ZERO)


@wp.func
def normal_at(
    kind: int,
    first: wp.vec3i,
    second: wp.vec3i,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t: wp.float64,
    uv: wp.vec2d,
) -> wp.vec3d:
    """Unit normal of a contact of two primitives, given by their vertices."""
    a0 = position(vertices_t0[first[0]], vertices_t1[first[0]], t)
    b0 = position(vertices_t0[second[0]], vertices_t1[second[0]], t)
    b1 = position(vertices_t0[second[1]], vertices_t1[second[1]], t)
    # motion of the two points in contact over the step
    va = vertices_t1[first[0]] - vertices_t0[first[0]]
    vb = vertices_t1[second[0]] - vertices_t0[second[0]]
    vb1 = vertices_t1[second[1]] - vertices_t0[second[1]]
    if kind == EDGE_EDGE:
        q = position(vertices_t0[first[1]], vertices_t1[first[1]], t) - a0
        r = b1 - b0
        va = (_ONE - uv[0]) * va + uv[0] * (vertices_t1[first[1]] - vertices_t0[first[1]])
        vb = (_ONE - uv[1]) * vb + uv[1] * vb1
    else:
        q = b1 - b0
        r = position(vertices_t0[second[2]], vertices_t1[second[2]], t) - b0
        vb = (_ONE - uv[0] - uv[1]) * vb + uv[0] * vb1 + uv[1] * (vertices_t1[second[2]] - vertices_t0[second[2]])
    if kind == EDGE_EDGE or kind == VERTEX_FACE:
        return contact_normal(q, r, va - vb)
    # missing vertices repeat the last one, so q is the segment, or 0 for a point
    return point_normal(q, va - vb, a0 - b0 - uv[0] * q)


@wp.func
def contact_key(contacts: ContactList, n: int) -> wp.int64:
    """A key that orders contacts by kind, then by pair: two bits, and 31 for each index.

    A vertex and a plane come after all pairs of points, as their kind with a larger first index: a mesh with planes has
    at most 2^30 vertices.
    """
    pair = contacts.primitives[n]
    first = wp.int64(pair[0])
    kind = wp.int64(contacts.kind[n] - 2)  # the sort is of signed numbers
    if contacts.kind[n] == VERTEX_PLANE:
        first = first | _PLANE_BIT
        kind = wp.int64(POINT_POINT - 2)
    return (kind << wp.int64(62)) | (first << wp.int64(31)) | wp.int64(pair[1])


@wp.kernel
def contact_keys(
    begin: int,
    # in
    contacts: ContactList,
    # out
    keys: wp.array[wp.int64],
):
    """The keys of all contacts."""
    n = begin + wp.tid()
    if n < contacts.count[0]:
        keys[n] = contact_key(contacts, n)


@wp.kernel
def order_contacts(
    begin: int,
    # in
    order: wp.array[wp.int32],
    contacts: ContactList,
    # out
    ordered: ContactList,
):
    """Copy the contacts in the given order."""
    n = begin + wp.tid()
    if n >= contacts.count[0]:
        return
    k = order[n]
    ordered.kind[n] = contacts.kind[k]
    ordered.primitives[n] = contacts.primitives[k]
    ordered.toi[n] = contacts.toi[k]
    ordered.status[n] = contacts.status[k]
    ordered.parameters[n] = contacts.parameters[k]
    ordered.gap[n] = contacts.gap[k]
    ordered.width[n] = contacts.width[k]
    ordered.normal[n] = contacts.normal[k]


@wp.kernel
def reset_first(
    begin: int,
    # out
    first: wp.array[wp.int32],
):
    """Let every vertex, or every body, have no contact yet."""
    first[begin + wp.tid()] = NO_CONTACT


@wp.func
def first_of_primitive(
    c: wp.vec3i,
    m: Minima,
    bits: wp.int64,
    n: int,
    vertex_contact: wp.array[wp.int32],
    body_contact: wp.array[wp.int32],
):
    """Record a contact for each vertex of a primitive, and for its body, whose earliest toi is that of the contact."""
    for k in range(3):
        if m.vertex[c[k]] == bits:
            atomic_min_int32(vertex_contact, c[k], n)
    body = m.vertex_body[c[0]]
    if m.body[body] == bits:
        atomic_min_int32(body_contact, body, n)


@wp.kernel
def first_contacts(
    begin: int,
    # in
    contacts: ContactList,
    vertex_corners: wp.array[wp.vec3i],
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    minima: Minima,
    # out
    vertex_contact: wp.array[wp.int32],
    body_contact: wp.array[wp.int32],
):
    """The contact that each toi belongs to: the one of lowest index if several have this toi."""
    n = begin + wp.tid()
    if n >= contacts.count[0]:
        return
    kind = contacts.kind[n]
    pair = contacts.primitives[n]
    bits = wp.cast(contacts.toi[n], wp.int64)
    first = wp.vec3i()
    second = wp.vec3i()
    if kind == EDGE_EDGE:
        first = edge_corners[pair[0]]
    else:
        first = vertex_corners[pair[0]]
    if kind == VERTEX_FACE:
        second = face_corners[pair[1]]
    elif kind == POINT_POINT:
        second = vertex_corners[pair[1]]
    elif kind == VERTEX_PLANE:
        second = first  # a plane has no vertices; for its body see `first_plane_contacts`
    else:
        second = edge_corners[pair[1]]
    first_of_primitive(first, minima, bits, n, vertex_contact, body_contact)
    first_of_primitive(second, minima, bits, n, vertex_contact, body_contact)
