"""Which contacts attain the least times of impact, and what the gradients of these are to them.

A minimum passes its gradient to the contact that attains it, of several to the one with the least key (`contacts`): the
first in the order of contacts. Those that attain a minimum are listed in any order, sorted by key, and gathered as a
table of pairs, whose slopes (`toi_slope`) then say how their tois change. What they add to a vertex is added in the
order of their keys (`toi_adjoint_rows`). So the sums are the same in every bit on each run; the only atomic operations
are the minimum of keys, which has no order, and the counter of a list that is sorted.

A minimum that no contact attains has no gradient (`regularity`): one of a pair beyond the capacity, or one that a line
search has raised to the time of a part of the gap.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim_int
from ..pair_kind import VERTEX_FACE, VERTEX_PLANE
from .contact_place import vertices_of
from .contacts import contact_key
from .step import ContactList

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_KEY = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))
_ZERO = wp.constant(wp.float64(0.0))


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
    """The least key of the contacts that attain each minimum; empty for minima that have no gradient."""

    vertex: wp.array[wp.int64]
    body: wp.array[wp.int64]
    world: wp.array[wp.int64]
    scene: wp.array[wp.int64]


@wp.struct
class MinimaGradients:
    """Gradients of the minima; empty for those that have none."""

    vertex: wp.array[wp.float64]
    body: wp.array[wp.float64]
    world: wp.array[wp.float64]
    scene: wp.array[wp.float64]


@wp.struct
class Pairs:
    """Pairs as a table: the columns of `toi_slope`, and what their tois are to the result."""

    toi_gradient: wp.array[wp.float64]  # of the result by the toi
    kinds: wp.array[wp.int32]
    points_t0: wp.array2d[wp.vec3d]
    points_t1: wp.array2d[wp.vec3d]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    planes: wp.array[wp.vec3d]  # normals of those of pairs with planes
    distances: wp.array[wp.float64]  # empty without radii
    radius_columns: wp.array[wp.vec2i]  # of the vertices that have the radii of the pair, -1 for none; empty without
    column_vertex: wp.array[wp.int32]  # of the four columns of each pair, the vertex; num_vertices: none
    columns: wp.array[wp.int32]


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
    # out
    count: wp.array[wp.int32],
    keys: wp.array[wp.int64],
    listed: wp.array[wp.int32],
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
        k = claim_int(count, 0)
        keys[k] = key
        listed[k] = n


@wp.func
def adjoint_of(
    check: Check, mesh: CheckedMesh, n: int, v: wp.vec4i, key: wp.int64, attained: Attained, gradient: MinimaGradients
) -> wp.float64:
    """The gradient by the toi of a contact: the sum over the minima that it attains, in one order."""
    total = _ZERO
    if attained.vertex.shape[0] > 0:
        for c in range(4):
            if c == 0 or v[c] != v[c - 1]:
                if attained.vertex[v[c]] == key:
                    total += gradient.vertex[v[c]]
    if attained.body.shape[0] > 0:
        first = mesh.vertex_body[v[0]]
        second = second_body(check, mesh, n, v)
        if attained.body[first] == key:
            total += gradient.body[first]
        if second != first and attained.body[second] == key:
            total += gradient.body[second]
    if attained.world.shape[0] > 0:
        world = world_of_vertex(mesh, v[0])
        if attained.world[world] == key:
            total += gradient.world[world]
    if attained.scene.shape[0] > 0:
        if attained.scene[0] == key:
            total += gradient.scene[0]
    return total


@wp.kernel
def gather_pairs(
    begin: int,
    # in
    check: Check,
    mesh: CheckedMesh,
    keys: wp.array[wp.int64],  # sorted; NO_KEY: there is no contact
    listed: wp.array[wp.int32],
    attained: Attained,
    gradient: MinimaGradients,
    # out
    pairs: Pairs,
):
    """The points of a listed contact at both ends of the step, its distance, and the gradient by its toi."""
    m = begin + wp.tid()
    pairs.toi_gradient[m] = _ZERO
    for c in range(4):
        pairs.column_vertex[4 * m + c] = mesh.num_vertices  # beyond all: it adds to none
        pairs.columns[4 * m + c] = 4 * m + c
    if keys[m] == NO_KEY:
        return
    n = listed[m]
    v = vertices_of(check.contacts, n, mesh.edge_corners, mesh.face_corners)
    adjoint = adjoint_of(check, mesh, n, v, keys[m], attained, gradient)
    if adjoint == _ZERO:
        return
    kind = check.contacts.kind[n]
    pairs.toi_gradient[m] = adjoint
    pairs.kinds[m] = kind
    pairs.toi[m] = check.contacts.toi[n]
    pairs.status[m] = check.contacts.status[n]
    for c in range(4):
        pairs.points_t0[m, c] = check.start[v[c]]
        pairs.points_t1[m, c] = check.end[v[c]]
    if kind == VERTEX_PLANE:
        k = check.contacts.primitives[n][1]
        pairs.planes[m] = check.contacts.normal[n]
        pairs.points_t0[m, 3] = mesh.plane_point[k]
        pairs.points_t1[m, 3] = mesh.plane_point[k]
        if mesh.plane_vertex.shape[0] > 0:
            if mesh.plane_vertex[k] >= 0:
                v[3] = mesh.plane_vertex[k]
                pairs.points_t0[m, 3] = check.start[v[3]]
                pairs.points_t1[m, 3] = check.end[v[3]]
    if check.radius.shape[0] > 0:
        num_first = int(2)
        if kind == VERTEX_FACE:
            num_first = 1
        a = int(0)
        b = int(num_first)
        if kind == VERTEX_PLANE:  # it meets all primitives around the vertex
            b = -1
            thickest = int(v[0])
            for k in range(mesh.neighbour_begin[v[0]], mesh.neighbour_begin[v[0] + 1]):
                if check.radius[mesh.neighbours[k]] > check.radius[thickest]:
                    thickest = mesh.neighbours[k]
            if thickest != v[0]:  # columns that repeat the vertex repeat it in its place
                a = 1
                if v[3] == v[0]:
                    v[3] = thickest
                v[1] = thickest
                v[2] = thickest
            pairs.distances[m] = check.separation + check.radius[v[a]]
        else:
            if num_first == 2 and check.radius[v[1]] > check.radius[v[0]]:
                a = 1
            for c in range(4):
                if c > b and check.radius[v[c]] > check.radius[v[b]]:
                    b = c
            pairs.distances[m] = check.separation + check.radius[v[a]] + check.radius[v[b]]
        pairs.radius_columns[m] = wp.vec2i(a, b)
    for c in range(4):
        if c == 0 or v[c] != v[c - 1]:
            pairs.column_vertex[4 * m + c] = v[c]


@wp.kernel
def change_gradients(
    begin: int,
    # in
    check: Check,
    mesh: CheckedMesh,
    keys: wp.array[wp.int64],
    listed: wp.array[wp.int32],
    attained: Attained,
    gradient: MinimaGradients,
    # out
    pairs: Pairs,
):
    """Replace the gradients by the tois of listed contacts that attain a minimum."""
    m = begin + wp.tid()
    if pairs.toi_gradient[m] == _ZERO:
        return
    v = vertices_of(check.contacts, listed[m], mesh.edge_corners, mesh.face_corners)
    pairs.toi_gradient[m] = adjoint_of(check, mesh, listed[m], v, keys[m], attained, gradient)
