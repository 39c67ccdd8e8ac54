"""Where contacts in a list on a device are: what is computed from the list when it is asked for.

The kernels run over the capacity of the list and read the number of contacts on the device, so that a graph can hold
them. Rows beyond that number are left as they are.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE, POINT_POINT, POINT_SEGMENT, VERTEX_FACE, VERTEX_PLANE
from .step import ContactList

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ONE = wp.constant(wp.float64(1.0))
_MINUS_ONE = wp.constant(wp.float64(-1.0))


@wp.func
def vertices_of(
    contacts: ContactList, n: int, edge_corners: wp.array[wp.vec3i], face_corners: wp.array[wp.vec3i]
) -> wp.vec4i:
    """Vertices of a contact: v, f0, f1, f2; ea0, ea1, eb0, eb1; p, p, a, b; p, p, q, q; or v alone, with a plane."""
    kind = contacts.kind[n]
    pair = contacts.primitives[n]
    if kind == EDGE_EDGE:
        a = edge_corners[pair[0]]
        b = edge_corners[pair[1]]
        return wp.vec4i(a[0], a[1], b[0], b[1])
    if kind == VERTEX_FACE:
        f = face_corners[pair[1]]
        return wp.vec4i(pair[0], f[0], f[1], f[2])
    if kind == POINT_POINT:
        return wp.vec4i(pair[0], pair[0], pair[1], pair[1])
    if kind == VERTEX_PLANE:
        return wp.vec4i(pair[0], pair[0], pair[0], pair[0])
    s = edge_corners[pair[1]]
    return wp.vec4i(pair[0], pair[0], s[0], s[1])


@wp.kernel
def fill_vertices(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    # out
    vertices: wp.array[wp.vec4i],
):
    """The vertices of each contact."""
    n = begin + wp.tid()
    if n < contacts.count[0]:
        vertices[n] = vertices_of(contacts, n, edge_corners, face_corners)


@wp.kernel
def fill_bodies(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    vertex_body: wp.array[wp.int32],
    plane_body: wp.array[wp.int32],
    # out
    bodies: wp.array[wp.vec2i],
):
    """The bodies of both primitives of each contact."""
    n = begin + wp.tid()
    if n < contacts.count[0]:
        v = vertices_of(contacts, n, edge_corners, face_corners)
        second = vertex_body[v[3]]
        if contacts.kind[n] == VERTEX_PLANE:
            second = plane_body[contacts.primitives[n][1]]
        bodies[n] = wp.vec2i(vertex_body[v[0]], second)


@wp.kernel
def fill_world(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    vertex_world: wp.array[wp.int32],  # empty where there is a single world
    # out
    world: wp.array[wp.int32],
):
    """The world of each contact."""
    n = begin + wp.tid()
    if n < contacts.count[0]:
        w = int(0)
        if vertex_world.shape[0] > 0:
            v = vertices_of(contacts, n, edge_corners, face_corners)
            w = vertex_world[v[0]]
        world[n] = w


@wp.kernel
def fill_weights(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    # out
    weights: wp.array[wp.vec4d],
):
    """The weights of the vertices of each contact in the difference of its closest points, with the bits of the host.

    There the opposite of 0 is -0, which Warp's own minus sign does not give.
    """
    n = begin + wp.tid()
    if n < contacts.count[0]:
        kind = contacts.kind[n]
        u = contacts.parameters[n][0]
        v = contacts.parameters[n][1]
        w = wp.vec4d()
        w[0] = _ONE
        if kind == VERTEX_FACE:
            w = wp.vec4d(_ONE, u + v - _ONE, _MINUS_ONE * u, _MINUS_ONE * v)
        elif kind == EDGE_EDGE:
            w = wp.vec4d(_ONE - u, u, v - _ONE, _MINUS_ONE * v)
        elif kind == POINT_SEGMENT:
            w[2] = u - _ONE
            w[3] = _MINUS_ONE * u
        elif kind == POINT_POINT:
            w[2] = _MINUS_ONE
        weights[n] = w
