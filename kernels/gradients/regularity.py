"""Which minima of tois have a gradient, and which positions of a line search rest on one that has none.

A vertex has a **rating** after each pass of a line search. It is REGULAR as long as no motion was shortened, or only by
regular contacts of vertices that are so. Where a pass lets it stay where it starts, it is STOPPED, if the contact that
says so is not regular: it stays there for some moves of the vertices, not for all. Else it is UNKNOWN: the fraction of
its motion follows from a start distance (`start_distance`), from a part of a gap, from a limit, or from what is not
listed.

A vertex that is not UNKNOWN depends on none that is: the fraction in which it moves has the least rating of the
vertices of its contact, and what stays does so whatever was before.
"""

import warp as wp

from ..pair_kind import VERTEX_PLANE
from ..step.contact_place import vertices_of
from .attained import NO_KEY, Attained, Check, CheckedMesh, second_body, world_of_vertex

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

UNKNOWN = wp.constant(0)
STOPPED = wp.constant(1)
REGULAR = wp.constant(2)
_ZERO = wp.constant(wp.float64(0.0))


@wp.kernel
def rate_minima(
    begin: int,
    # in
    check: Check,
    mesh: CheckedMesh,
    attained: Attained,  # of one kind of minima
    is_regular: wp.array[wp.bool],  # of each listed contact
    start_distance: wp.array[wp.float64],  # share and length of each vertex, infinite where none is kept; or empty
    vertex_rating: wp.array[wp.int32],  # empty: all are regular
    # out
    rating: wp.array[wp.int32],  # of each minimum
):
    """Rate the minima that a listed contact attains."""
    m = begin + wp.tid()
    key = attained.keys[m]
    if key == NO_KEY:
        return
    n = attained.listed[m]
    v = vertices_of(check.contacts, n, mesh.edge_corners, mesh.face_corners)
    is_plane = check.contacts.kind[n] == VERTEX_PLANE
    of_contact = int(UNKNOWN)
    if is_regular[m]:
        of_contact = int(REGULAR)
    for c in range(4):
        if start_distance.shape[0] > 0 and not is_plane:
            if wp.isfinite(start_distance[2 * v[c]]):
                of_contact = int(UNKNOWN)
        if vertex_rating.shape[0] > 0:
            of_contact = wp.min(of_contact, vertex_rating[v[c]])
    if is_plane and vertex_rating.shape[0] > 0 and mesh.plane_vertex.shape[0] > 0:
        of_plane = mesh.plane_vertex[check.contacts.primitives[n][1]]
        if of_plane >= 0:
            of_contact = wp.min(of_contact, vertex_rating[of_plane])
    if attained.vertex.shape[0] > 0:
        for c in range(4):
            if attained.vertex[v[c]] == key:
                rating[v[c]] = of_contact
    if attained.body.shape[0] > 0:
        first = mesh.vertex_body[v[0]]
        second = second_body(check, mesh, n, v)
        if attained.body[first] == key:
            rating[first] = of_contact
        if attained.body[second] == key:
            rating[second] = of_contact
    if attained.world.shape[0] > 0:
        world = world_of_vertex(mesh, v[0])
        if attained.world[world] == key:
            rating[world] = of_contact
    if attained.scene.shape[0] > 0:
        if attained.scene[0] == key:
            rating[0] = of_contact


@wp.kernel
def rate_vertices(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    group: wp.array[wp.int32],  # of each of them, which moves by one fraction; -1: it is not shortened
    toi: wp.array[wp.float64],  # of each group
    share: wp.float64,  # of a toi that is kept
    rating: wp.array[wp.int32],  # of each group whose toi is finite
    # in and out
    vertex_rating: wp.array[wp.int32],
):
    """Rate the positions of vertices after a pass."""
    k = begin + wp.tid()
    g = group[k]
    if g < 0:
        return
    if not wp.isfinite(toi[g]):
        return
    v = vertices[k]
    if share * toi[g] > _ZERO:
        vertex_rating[v] = wp.min(vertex_rating[v], rating[g])
    else:
        vertex_rating[v] = wp.max(STOPPED, rating[g])


@wp.kernel
def note_regular(
    begin: int,
    # in
    rating: wp.array[wp.int32],
    # out
    is_regular: wp.array[wp.bool],
):
    """Whether a rating is that of what is regular."""
    i = begin + wp.tid()
    is_regular[i] = rating[i] == REGULAR
