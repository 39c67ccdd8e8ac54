"""Where the contacts of a list on a device are in space: where the surfaces touch, with their radii.

That is halfway between the closest points of the two surfaces, each of which is a radius from that of its primitive.
"""

import warp as wp

from ..boxes.thickness import radius_of
from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE, VERTEX_PLANE
from ..parameters import dimension, real
from . import in_space as positions
from .contact_place import vertices_of
from .contact_sides import position
from .step import ContactList

_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))


vec, in_space = positions.vec, positions.in_space
module = wp.get_module(f"ccd_warp.contact_points.{real.__name__}.{dimension}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.kernel(module=module)
def fill_points(
    begin: int,
    # in
    contacts: ContactList,
    edge_corners: wp.array[wp.vec3i],
    face_corners: wp.array[wp.vec3i],
    vertices_t0: wp.array[vec],
    vertices_t1: wp.array[vec],
    moving_row: wp.array[wp.int32],  # the place of each vertex among the moving ones; -1: it is static
    t1_by_vertex: int,  # 0: the rows are the moving vertices only
    plane_point: wp.array[wp.vec3d],
    plane_vertex: wp.array[wp.int32],  # the vertex that is the point of one that moves, or -1; empty: none moves
    plane_unit: wp.array[wp.vec3d],  # their unit normals
    radius: wp.array[wp.float64],  # of each vertex; empty where there are none
    box_radius: wp.array[wp.float64],  # the largest of the primitives around each vertex, with which planes meet it
    # out
    points: wp.array[wp.vec3d],
):
    """Midpoint of the closest points of each contact's surfaces, in the operations, and their order, of the host."""
    n = begin + wp.tid()
    if n >= contacts.count[0]:
        return
    kind = contacts.kind[n]
    uv = contacts.parameters[n]
    weights = wp.vec4d(_ONE, _ZERO, _ONE, _ZERO)  # those of repeated vertices add 0
    num_first = int(2)  # vertices of the first primitive
    if kind == VERTEX_FACE:
        weights = wp.vec4d(_ONE, _ONE - uv[0] - uv[1], uv[0], uv[1])
        num_first = 1
    elif kind == EDGE_EDGE:
        weights = wp.vec4d(_ONE - uv[0], uv[0], _ONE - uv[1], uv[1])
    elif kind != POINT_POINT and kind != VERTEX_PLANE:
        weights = wp.vec4d(_ONE, _ZERO, _ONE - uv[0], uv[0])
    v = vertices_of(contacts, n, edge_corners, face_corners)
    first = wp.vec3d()
    second = wp.vec3d()
    for k in range(4):
        a = in_space(vertices_t0[v[k]])
        b = a
        row = moving_row[v[k]]
        if row >= 0:
            b = in_space(vertices_t1[wp.where(t1_by_vertex != 0, v[k], row)])
        p = weights[k] * position(a, b, contacts.toi[n])
        if k < num_first:
            first += p
        else:
            second += p
    points[n] = _HALF * first + _HALF * second
    if kind == VERTEX_PLANE:
        k = contacts.primitives[n][1]
        p = plane_point[k]
        if plane_vertex.shape[0] > 0:
            if plane_vertex[k] >= 0:
                a = in_space(vertices_t0[plane_vertex[k]])
                row = wp.where(t1_by_vertex != 0, plane_vertex[k], moving_row[plane_vertex[k]])
                p = position(a, in_space(vertices_t1[row]), contacts.toi[n])
        h = _HALF * first - _HALF * p
        unit = plane_unit[k]
        points[n] = first - (h[0] * unit[0] + h[1] * unit[1] + h[2] * unit[2]) * unit
    if radius.shape[0] > 0:
        lean = -box_radius[v[0]]
        if kind != VERTEX_PLANE:
            of_first = radius_of(radius, wp.vec3i(v[0], v[0], v[num_first - 1]))
            lean = radius_of(radius, wp.vec3i(v[num_first], v[2], v[3])) - of_first
        points[n] = points[n] + (_HALF * lean) * contacts.normal[n]  # += would be an atomic operation
