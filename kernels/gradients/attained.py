"""Which contacts attain the least times of impact.

A minimum passes its gradient to the contact that attains it, of several to the one with the least key (`contacts`): the
first in the order of contacts. Those that attain a minimum are listed in any order, and sorted by key. The only atomic
operations are the minimum of keys, which has no order, and the counter of a list that is sorted.

A minimum that no contact attains has no gradient (`regularity`): one of a pair beyond the capacity, or one that a line
search has raised to the time of a part of the gap.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim_int
from ..pair_kind import VERTEX_PLANE
from ..step.contact_place import vertices_of
from ..step.contacts import contact_key
from ..step.step import ContactList

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_KEY = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))


@wp.struct
class Check:
    """A step that has been checked: its contacts, its tois, and what they depend on."""

    contacts: ContactList
    start: wp.array[wp.vec3d]
    end: wp.array[wp.vec3d]
    vertex_toi: wp.array[wp.float64]
    body_toi: wp.array[wp.float64]
    world_toi: wp.array[wp.float64]
    toi: wp.array[wp.float64]
    separation: wp.float64
    radius: wp.array[wp.float64]  # empty without radii


@wp.struct
class CheckedMesh:
    """What belongs to the primitives of contacts."""

    num_vertices: int
    edge_corners: wp.array[wp.vec3i]
    face_corners: wp.array[wp.vec3i]
    vertex_body: wp.array[wp.int32]
    vertex_world: wp.array[wp.int32]  # empty where there is one world
    plane_point: wp.array[wp.vec3d]
    plane_vertex: wp.array[wp.int32]  # the vertex that is the point of one that moves, or -1; empty: none moves
    plane_body: wp.array[wp.int32]
    neighbour_begin: wp.array[wp.int32]  # empty without radii
    neighbours: wp.array[wp.int32]


@wp.struct
class Attained:
    """Contacts that attain minima, and the least key for each minimum; empty for minima that have no gradient."""

    count: wp.array[wp.int32]
    keys: wp.array[wp.int64]  # in ascending order once the list is sorted; NO_KEY: there is no contact
    listed: wp.array[wp.int32]  # places among the contacts of the check
    vertex: wp.array[wp.int64]
    body: wp.array[wp.int64]
    world: wp.array[wp.int64]
    scene: wp.array[wp.int64]


@wp.func
def second_body(check: Check, mesh: CheckedMesh, n: int, v: wp.vec4i) -> int:
    """Body of the second primitive of a contact."""
    if check.contacts.kind[n] == VERTEX_PLANE:
        return mesh.plane_body[check.contacts.primitives[n][1]]
    return mesh.vertex_body[v[3]]


@wp.func
def world_of_vertex(mesh: CheckedMesh, v: int) -> int:
    """World of a vertex."""
    if mesh.vertex_world.shape[0] > 0:
        return mesh.vertex_world[v]
    return 0


@wp.kernel
def attain(
    begin: int,
    # in
    check: Check,
    mesh: CheckedMesh,
    # in and out
    attained: Attained,
):
    """Lower the key of each minimum to that of a contact that attains it, and list such contacts."""
    n = begin + wp.tid()
    if n >= check.contacts.count[0]:
        return
    t = check.contacts.toi[n]
    if check.toi[0] != t and attained.vertex.shape[0] + attained.body.shape[0] + attained.world.shape[0] == 0:
        return
    v = vertices_of(check.contacts, n, mesh.edge_corners, mesh.face_corners)
    # what attains the minimum of a body attains those of its vertices in it, which a plane has not
    if check.contacts.kind[n] != VERTEX_PLANE:
        if check.vertex_toi[v[0]] != t and check.vertex_toi[v[1]] != t:
            if check.vertex_toi[v[2]] != t and check.vertex_toi[v[3]] != t:
                return
    key = contact_key(check.contacts, n)
    is_wanted = bool(False)
    if attained.vertex.shape[0] > 0:
        is_wanted = True
        for c in range(4):
            if check.vertex_toi[v[c]] == t:
                atomic_min_int64(attained.vertex, v[c], key)
    if attained.body.shape[0] > 0:
        for k in range(2):
            body = mesh.vertex_body[v[0]]
            if k == 1:
                body = second_body(check, mesh, n, v)
            if check.body_toi[body] == t:
                is_wanted = True
                atomic_min_int64(attained.body, body, key)
    if attained.world.shape[0] > 0:
        world = world_of_vertex(mesh, v[0])
        if check.world_toi[world] == t:
            is_wanted = True
            atomic_min_int64(attained.world, world, key)
    if attained.scene.shape[0] > 0:
        if check.toi[0] == t:
            is_wanted = True
            atomic_min_int64(attained.scene, 0, key)
    if is_wanted:
        k = claim_int(attained.count, 0, 1)
        attained.keys[k] = key
        attained.listed[k] = n
