"""The gradient of the least times of impact on a device: which contact attains each, and sums over its points.

In the forward pass all that the backward pass needs is kept: the points of the contacts, their vertices, their keys,
which order them, and the least key among the contacts that attain the toi of each vertex, body and world, and of the
scene. So positions and results may be overwritten.

In the backward pass each contact collects the adjoints of the minima that it attains, and those that have some are
differentiated (`toi_slope`). The contributions to a vertex are
added in the order of the contacts' keys, whatever the order in which the contacts were listed: contacts are sorted by
key, then their columns, stably, by vertex. So the sums are the same in every bit on each run, without an atomic
operation but the minimum of keys, whose result has no order.
"""

import warp as wp

from ..atomics import atomic_min_int64
from ..pair_kind import VERTEX_FACE, VERTEX_PLANE
from .contact_place import vertices_of
from .contacts import contact_key
from .step import ContactList

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_KEY = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))
_ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Pairs:
    """The pairs of a list of contacts as a table: the columns of `toi_slope`, and what they belong to."""

    kinds: wp.array[wp.int32]
    points_t0: wp.array2d[wp.vec3d]
    points_t1: wp.array2d[wp.vec3d]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    planes: wp.array[wp.vec3d]  # normals of those of pairs with planes
    distances: wp.array[wp.float64]  # empty without radii
    keys: wp.array[wp.int64]  # NO_KEY: there is no contact
    vertices: wp.array[wp.vec4i]  # whose positions the columns are, or which has the radius
    bodies: wp.array[wp.vec2i]
    radius_columns: wp.array[wp.vec2i]  # of the vertices that have the radii of the pair, -1 for none; empty without


@wp.struct
class Attained:
    """The least key of the contacts that attain the toi of each vertex, body, world, and of the scene."""

    vertex: wp.array[wp.int64]
    body: wp.array[wp.int64]
    world: wp.array[wp.int64]
    scene: wp.array[wp.int64]


@wp.struct
class Adjoints:
    """Tois, or what changes with them."""

    vertex: wp.array[wp.float64]
    body: wp.array[wp.float64]
    world: wp.array[wp.float64]
    scene: wp.array[wp.float64]


@wp.kernel
def gather_pairs(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    vertex_body: wp.array[wp.int32],
    plane_point: wp.array[wp.vec3d],
    plane_vertex: wp.array[wp.int32],  # the vertex that is the point of one that moves, or -1; empty: none moves
    plane_body: wp.array[wp.int32],
    separation: wp.float64,
    radius: wp.array[wp.float64],  # empty without radii
    neighbour_begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    # out
    pairs: Pairs,
):
    """The points of each contact at both ends of the step, and its distance."""
    n = begin + wp.tid()
    pairs.keys[n] = NO_KEY
    if n >= contacts.count[0]:
        return
    kind = contacts.kind[n]
    pairs.keys[n] = contact_key(contacts, n)
    pairs.kinds[n] = kind
    pairs.toi[n] = contacts.toi[n]
    pairs.status[n] = contacts.status[n]
    pairs.planes[n] = contacts.normal[n]
    v = vertices_of(contacts, n, edge_corners, face_corners)
    second_body = vertex_body[v[3]]
    for c in range(4):
        pairs.points_t0[n, c] = start[v[c]]
        pairs.points_t1[n, c] = end[v[c]]
    if kind == VERTEX_PLANE:
        k = contacts.primitives[n][1]
        second_body = plane_body[k]
        pairs.points_t0[n, 3] = plane_point[k]
        pairs.points_t1[n, 3] = plane_point[k]
        if plane_vertex.shape[0] > 0:
            if plane_vertex[k] >= 0:
                v[3] = plane_vertex[k]
                pairs.points_t0[n, 3] = start[v[3]]
                pairs.points_t1[n, 3] = end[v[3]]
    pairs.bodies[n] = wp.vec2i(vertex_body[v[0]], second_body)
    if radius.shape[0] > 0:
        num_first = int(2)
        if kind == VERTEX_FACE:
            num_first = 1
        a = int(0)
        b = int(num_first)
        if kind == VERTEX_PLANE:  # it meets all primitives around the vertex
            b = -1
            thickest = int(v[0])
            for m in range(neighbour_begin[v[0]], neighbour_begin[v[0] + 1]):
                if radius[neighbours[m]] > radius[thickest]:
                    thickest = neighbours[m]
            if thickest != v[0]:  # columns that repeat the vertex repeat it in its place
                a = 1
                if v[3] == v[0]:
                    v[3] = thickest
                v[1] = thickest
                v[2] = thickest
            pairs.distances[n] = separation + radius[v[a]]
        else:
            if num_first == 2 and radius[v[1]] > radius[v[0]]:
                a = 1
            for c in range(4):
                if c > b and radius[v[c]] > radius[v[b]]:
                    b = c
            pairs.distances[n] = separation + radius[v[a]] + radius[v[b]]
        pairs.radius_columns[n] = wp.vec2i(a, b)
    pairs.vertices[n] = v


@wp.kernel
def attain(
    begin: int,
    # in
    pairs: Pairs,
    vertex_world: wp.array[wp.int32],
    toi: Adjoints,
    # out
    attained: Attained,
):
    """Lower the key of each minimum to that of a contact that attains it."""
    n = begin + wp.tid()
    key = pairs.keys[n]
    if key == NO_KEY:
        return
    t = pairs.toi[n]
    v = pairs.vertices[n]
    is_plane = pairs.kinds[n] == VERTEX_PLANE
    for c in range(4):
        if c == 0 or not is_plane:
            if toi.vertex[v[c]] == t:
                atomic_min_int64(attained.vertex, v[c], key)
    for k in range(2):
        body = pairs.bodies[n][k]
        if toi.body[body] == t:
            atomic_min_int64(attained.body, body, key)
    world = int(0)
    if vertex_world.shape[0] > 0:
        world = vertex_world[v[0]]
    if toi.world[world] == t:
        atomic_min_int64(attained.world, world, key)
    if toi.scene[0] == t:
        atomic_min_int64(attained.scene, 0, key)


@wp.kernel
def collect(
    begin: int,
    # in
    pairs: Pairs,
    vertex_world: wp.array[wp.int32],
    attained: Attained,
    gradient: Adjoints,  # of the world empty where it is that of the scene
    # out
    adjoint: wp.array[wp.float64],
    order_keys: wp.array[wp.int64],
    order: wp.array[wp.int32],
):
    """The adjoint of the toi of each contact: the sum over the minima that it attains, in one order."""
    n = begin + wp.tid()
    key = pairs.keys[n]
    order_keys[n] = key
    order[n] = n
    total = _ZERO
    if key != NO_KEY:
        v = pairs.vertices[n]
        for c in range(4):
            if c == 0 or v[c] != v[c - 1]:
                if attained.vertex[v[c]] == key:
                    total += gradient.vertex[v[c]]
        bodies = pairs.bodies[n]
        if attained.body[bodies[0]] == key:
            total += gradient.body[bodies[0]]
        if bodies[1] != bodies[0] and attained.body[bodies[1]] == key:
            total += gradient.body[bodies[1]]
        if gradient.world.shape[0] > 0:
            world = int(0)
            if vertex_world.shape[0] > 0:
                world = vertex_world[v[0]]
            if attained.world[world] == key:
                total += gradient.world[world]
        if attained.scene[0] == key:
            total += gradient.scene[0]
    adjoint[n] = total


@wp.kernel
def list_columns(
    begin: int,
    # in
    pairs: Pairs,
    adjoint: wp.array[wp.float64],
    order: wp.array[wp.int32],
    num_vertices: int,
    # out
    column_vertex: wp.array[wp.int32],
    columns: wp.array[wp.int32],
):
    """The columns of the contacts in their order, with the vertex to which each contributes."""
    m = begin + wp.tid()
    n = order[m]
    for c in range(4):
        vertex = int(num_vertices)  # beyond all: it contributes to none
        if pairs.keys[n] != NO_KEY:
            v = pairs.vertices[n]
            if adjoint[n] != _ZERO and (c == 0 or v[c] != v[c - 1]):
                vertex = v[c]
        column_vertex[4 * m + c] = vertex
        columns[4 * m + c] = 4 * n + c


@wp.func
def first_of(values: wp.array[wp.int32], count: int, value: int) -> int:
    """The first place of a sorted list whose value is not below another."""
    low = int(0)
    high = int(count)
    while low < high:
        middle = (low + high) / 2
        if values[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low
