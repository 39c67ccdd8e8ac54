"""The gradients of times of impact, given those of the minima that contacts attain.

The contacts that attain a minimum (`attained`) are gathered as a table of pairs, whose slopes (`toi_slope`) then say
how their tois change. What they add to a vertex is added in the order of their keys (`toi_adjoint_rows`). So the sums
are the same in every bit on each run.
"""

import warp as wp

from ..pair_kind import VERTEX_FACE, VERTEX_PLANE
from ..step.contact_place import vertices_of
from .attained import NO_KEY, Attained, Check, CheckedMesh, second_body, world_of_vertex
from .toi_slope import Table

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class MinimaGradients:
    """Gradients of the minima; empty for those that have none."""

    vertex: wp.array[wp.float64]
    body: wp.array[wp.float64]
    world: wp.array[wp.float64]
    scene: wp.array[wp.float64]


@wp.struct
class Pairs:
    """Pairs as a table, and the vertices whose positions their points are."""

    table: Table
    radius_columns: wp.array[wp.vec2i]  # of the vertices that have the radii of the pair, -1 for none; empty without
    column_vertex: wp.array[wp.int32]  # of the four columns of each pair, the vertex; num_vertices: none
    columns: wp.array[wp.int32]


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
    attained: Attained,
    gradient: MinimaGradients,
    # out
    pairs: Pairs,
):
    """The points of a listed contact at both ends of the step, its distance, and the gradient by its toi."""
    m = begin + wp.tid()
    pairs.table.toi_gradient[m] = _ZERO
    for c in range(4):
        pairs.column_vertex[4 * m + c] = mesh.num_vertices  # beyond all: it adds to none
        pairs.columns[4 * m + c] = 4 * m + c
    if attained.keys[m] == NO_KEY:
        return
    n = attained.listed[m]
    v = vertices_of(check.contacts, n, mesh.edge_corners, mesh.face_corners)
    adjoint = adjoint_of(check, mesh, n, v, attained.keys[m], attained, gradient)
    if adjoint == _ZERO:
        return
    kind = check.contacts.kind[n]
    pairs.table.toi_gradient[m] = adjoint
    pairs.table.kinds[m] = kind
    pairs.table.toi[m] = check.contacts.toi[n]
    pairs.table.status[m] = check.contacts.status[n]
    for c in range(4):
        pairs.table.points_t0[m, c] = check.start[v[c]]
        pairs.table.points_t1[m, c] = check.end[v[c]]
    if kind == VERTEX_PLANE:
        k = check.contacts.primitives[n][1]
        pairs.table.planes[m] = check.contacts.normal[n]
        pairs.table.points_t0[m, 3] = mesh.plane_point[k]
        pairs.table.points_t1[m, 3] = mesh.plane_point[k]
        if mesh.plane_vertex.shape[0] > 0:
            if mesh.plane_vertex[k] >= 0:
                v[3] = mesh.plane_vertex[k]
                pairs.table.points_t0[m, 3] = check.start[v[3]]
                pairs.table.points_t1[m, 3] = check.end[v[3]]
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
            pairs.table.distances[m] = check.separation + check.radius[v[a]]
        else:
            if num_first == 2 and check.radius[v[1]] > check.radius[v[0]]:
                a = 1
            for c in range(4):
                if c > b and check.radius[v[c]] > check.radius[v[b]]:
                    b = c
            pairs.table.distances[m] = check.separation + check.radius[v[a]] + check.radius[v[b]]
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
    attained: Attained,
    gradient: MinimaGradients,
    # out
    pairs: Pairs,
):
    """Replace the gradients by the tois of listed contacts that attain a minimum."""
    m = begin + wp.tid()
    if pairs.table.toi_gradient[m] == _ZERO:
        return
    v = vertices_of(check.contacts, attained.listed[m], mesh.edge_corners, mesh.face_corners)
    pairs.table.toi_gradient[m] = adjoint_of(check, mesh, attained.listed[m], v, attained.keys[m], attained, gradient)
