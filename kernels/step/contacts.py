"""Contacts: the list of them, their order, and the first contact of each vertex, body and world."""

import warp as wp

from ..atomics import atomic_min_int32
from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE, VERTEX_PLANE
from .minima import Minima, world_of
from .step import ContactList

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# In place of the index of a first contact: none.
NO_CONTACT = wp.constant(2**31 - 1)
_PLANE_BIT = wp.constant(wp.int64(1 << 30))
_ZERO = wp.constant(wp.float64(0.0))


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


@wp.kernel
def mark_finite(
    # in
    values: wp.array[wp.float64],
    # out
    is_finite: wp.array[wp.bool],
):
    """Whether each value is finite."""
    i = wp.tid()
    is_finite[i] = wp.isfinite(values[i])


@wp.func
def sort_key(kind_of_pair: int, pair: wp.vec2i) -> wp.int64:
    """A key that orders pairs of primitives by kind, then by index: two bits, and 31 for each index.

    A vertex and a plane come after all pairs of points, as their kind with a larger first index: a mesh with planes has
    at most 2^30 vertices.
    """
    first = wp.int64(pair[0])
    kind = wp.int64(kind_of_pair - 2)  # the sort is of signed numbers
    if kind_of_pair == VERTEX_PLANE:
        first = first | _PLANE_BIT
        kind = wp.int64(POINT_POINT - 2)
    return (kind << wp.int64(62)) | (first << wp.int64(31)) | wp.int64(pair[1])


@wp.func
def contact_key(contacts: ContactList, n: int) -> wp.int64:
    """The key of a contact."""
    return sort_key(contacts.kind[n], contacts.primitives[n])


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


@wp.func_native(
    """
#if !defined(__CUDA_ARCH__)
    const int ahead = n + 16;
    if (ahead < end) {
        const int k = order.data[ahead];
        __builtin_prefetch(kind.data + k);
        __builtin_prefetch(primitives.data + k);
        __builtin_prefetch(toi.data + k);
        __builtin_prefetch(status.data + k);
        __builtin_prefetch(parameters.data + k);
        __builtin_prefetch(gap.data + k);
        __builtin_prefetch(width.data + k);
        __builtin_prefetch(normal.data + k);
    }
#endif
"""
)
def fetch_ahead(
    n: int,
    end: int,
    order: wp.array[wp.int32],
    kind: wp.array[wp.int32],
    primitives: wp.array[wp.vec2i],
    toi: wp.array[wp.float64],
    status: wp.array[wp.int32],
    parameters: wp.array[wp.vec2d],
    gap: wp.array[wp.float64],
    width: wp.array[wp.float64],
    normal: wp.array[wp.vec3d],
):
    """Let the memory bring a contact that soon follows in an order, on the CPU."""
    ...


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
    c = contacts
    end = wp.min(c.count[0], order.shape[0])
    if n >= end:
        return
    fetch_ahead(n, end, order, c.kind, c.primitives, c.toi, c.status, c.parameters, c.gap, c.width, c.normal)
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
    """Let every vertex, body or world have no contact yet."""
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


@wp.func
def vertices_of(
    kind: int,
    pair: wp.vec2i,
    vertex_corners: wp.array[wp.vec3i],
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
):
    """The vertices of both primitives of a pair; a plane has none, and those of the first stand for it."""
    first = wp.vec3i()
    if kind == EDGE_EDGE:
        first = edge_corners[pair[0]]
    else:  # the number of an edge may be beyond the last vertex
        first = vertex_corners[pair[0]]
    second = first
    if kind == VERTEX_FACE:
        second = face_corners[pair[1]]
    elif kind == POINT_POINT:
        second = vertex_corners[pair[1]]
    elif kind != VERTEX_PLANE:
        second = edge_corners[pair[1]]
    return first, second


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
    world_contact: wp.array[wp.int32],
):
    """The contact that each toi belongs to: the one of lowest index if several have this toi."""
    n = begin + wp.tid()
    if n >= contacts.count[0]:
        return
    bits = wp.cast(contacts.toi[n], wp.int64)
    # a plane has no vertices; for its body see `first_plane_contacts`
    first, second = vertices_of(contacts.kind[n], contacts.primitives[n], vertex_corners, edge_corners, face_corners)
    first_of_primitive(first, minima, bits, n, vertex_contact, body_contact)
    first_of_primitive(second, minima, bits, n, vertex_contact, body_contact)
    world = world_of(minima, first[0])
    if minima.world[world] == bits:
        atomic_min_int32(world_contact, world, n)
