"""Which pairs of primitives intersect at one time, as far as float64 can tell.

Every answer follows from signs of determinants of differences of coordinates. A sign is **certain** where the magnitude
of the computed determinant exceeds a bound on its error, and where coordinates are equal so that it is 0 by its form:
all points in a plane across an axis, or two points in one place. All other signs are `UNKNOWN`.

The bounds, with the unit roundoff u = 2⁻⁵³ and no fused operations: a term of the volume is a product of three rounded
differences, five roundings in all with the inner difference among them and the two products, and two more for the sum
of three terms. A bound of 8.1 u times the sum of magnitudes (the permanent) therefore covers a volume, and one of 4.1 u
an area; the factors below are 16 and 8, so that the rounding of the permanent itself is covered, too. A product that
underflows errs by at most 2⁻¹⁰⁷⁵, which may be multiplied by one more difference: `_GUARD` times a sum of lengths
covers it. A permanent near overflow proves nothing, and a comparison with NaN is false.

What stays open is decided in integers on the host (`exact_intersections`).
"""

import warp as wp

from ..pair_key import pair_of
from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# What a test finds.
APART = wp.constant(0)  # certainly no common point, or not of the kind that is asked for
FOUND = wp.constant(1)  # certainly of that kind
OPEN = wp.constant(2)  # to be decided exactly
NOT_THROUGH = wp.constant(3)  # the edge is certainly not through the inside of the face, and may touch it

# A sign that rounding hides.
UNKNOWN = wp.constant(2)

_VOLUME = wp.constant(wp.float64(16.0 * 2.0**-53))
_AREA = wp.constant(wp.float64(8.0 * 2.0**-53))
_GUARD = wp.constant(wp.float64(2.0**-1000))
_LARGEST = wp.constant(wp.float64(2.0**1000))
_ONE = wp.constant(wp.float64(1.0))


@wp.func
def sign_beyond(value: wp.float64, permanent: wp.float64, bound: wp.float64) -> int:
    """The sign of a determinant whose error a bound covers, or `UNKNOWN`."""
    if permanent < _LARGEST:
        if value > bound:
            return 1
        if value < -bound:
            return -1
    return UNKNOWN


@wp.func
def volume_sign(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, d: wp.vec3d) -> int:
    """Sign of det(a − d, b − d, c − d): the side of the plane (b, c, d) on which a is."""
    p = a - d
    q = b - d
    r = c - d
    x0 = q[1] * r[2]
    x1 = q[2] * r[1]
    y0 = q[2] * r[0]
    y1 = q[0] * r[2]
    z0 = q[0] * r[1]
    z1 = q[1] * r[0]
    size = wp.vec3d(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2]))
    value = p[0] * (x0 - x1) + p[1] * (y0 - y1) + p[2] * (z0 - z1)
    permanent = size[0] * (wp.abs(x0) + wp.abs(x1))
    permanent += size[1] * (wp.abs(y0) + wp.abs(y1))
    permanent += size[2] * (wp.abs(z0) + wp.abs(z1))
    bound = _VOLUME * permanent + _GUARD * (_ONE + size[0] + size[1] + size[2])
    sign = sign_beyond(value, permanent, bound)
    if sign == UNKNOWN:
        for k in range(3):
            if a[k] == b[k] and b[k] == c[k] and c[k] == d[k]:
                return 0
        if a == b or a == c or a == d or b == c or b == d or c == d:
            return 0
    return sign


@wp.func
def area_sign(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int) -> int:
    """Sign of the area of a triangle that is projected along an axis: the side of the line (b, c) on which a is."""
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    left = (a[i] - c[i]) * (b[j] - c[j])
    right = (a[j] - c[j]) * (b[i] - c[i])
    permanent = wp.abs(left) + wp.abs(right)
    sign = sign_beyond(left - right, permanent, _AREA * permanent + _GUARD)
    if sign == UNKNOWN:
        if (a[i] == b[i] and b[i] == c[i]) or (a[j] == b[j] and b[j] == c[j]):
            return 0
        if (a[i] == b[i] and a[j] == b[j]) or (a[i] == c[i] and a[j] == c[j]) or (b[i] == c[i] and b[j] == c[j]):
            return 0
    return sign


@wp.func
def are_opposite(a: int, b: int) -> bool:
    """Whether two certain signs differ, and none is 0."""
    return a * b == -1


@wp.func
def are_same(a: int, b: int) -> bool:
    """Whether two certain signs are equal, and none is 0."""
    return a * b == 1


@wp.func
def test_edge_face(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> int:
    """Whether the inside of an edge passes through the inside of a face, from one side to the other."""
    side_p = volume_sign(p, a, b, c)
    side_q = volume_sign(q, a, b, c)
    if are_same(side_p, side_q):
        return APART
    # which way the line through p and q passes the sides of the face
    past_ab = volume_sign(p, q, a, b)
    past_bc = volume_sign(p, q, b, c)
    past_ca = volume_sign(p, q, c, a)
    if are_opposite(past_ab, past_bc) or are_opposite(past_bc, past_ca) or are_opposite(past_ca, past_ab):
        return APART
    if are_opposite(side_p, side_q) and are_same(past_ab, past_bc) and are_same(past_bc, past_ca):
        return FOUND
    if side_p == 0 or side_q == 0 or past_ab == 0 or past_bc == 0 or past_ca == 0:
        return NOT_THROUGH
    return OPEN


@wp.func
def test_vertex_face(v: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> int:
    """Whether a vertex is in a closed face."""
    side = volume_sign(v, a, b, c)
    if side == 1 or side == -1:
        return APART
    is_inside = bool(False)
    for axis in range(3):
        ab = area_sign(v, a, b, axis)
        bc = area_sign(v, b, c, axis)
        ca = area_sign(v, c, a, axis)
        if are_opposite(ab, bc) or are_opposite(bc, ca) or are_opposite(ca, ab):
            return APART  # the projections are apart, for a face without area, too
        # of one sign or 0, with an area that is not 0: the projection of the face is one to one
        if ab != UNKNOWN and bc != UNKNOWN and ca != UNKNOWN and (ab != 0 or bc != 0 or ca != 0):
            is_inside = True
    if side == 0 and is_inside:
        return FOUND
    return OPEN


@wp.func
def test_edge_edge(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d, s: wp.vec3d) -> int:
    """Whether two closed edges have a common point."""
    side = volume_sign(p, q, r, s)
    if side == 1 or side == -1:
        return APART
    is_crossing = bool(False)
    for axis in range(3):
        r_side = area_sign(r, p, q, axis)
        s_side = area_sign(s, p, q, axis)
        p_side = area_sign(p, r, s, axis)
        q_side = area_sign(q, r, s, axis)
        if are_same(r_side, s_side) or are_same(p_side, q_side):
            return APART
        if r_side != UNKNOWN and s_side != UNKNOWN and p_side != UNKNOWN and q_side != UNKNOWN and r_side != s_side:
            is_crossing = True  # they are not parallel in this projection, which is one to one on their plane
    if side == 0 and is_crossing:
        return FOUND
    return OPEN


@wp.func
def test_point_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> int:
    """Whether a point is on a closed segment, given that it is in the box around it."""
    is_known = bool(True)
    for axis in range(3):
        side = area_sign(p, a, b, axis)
        if side == 1 or side == -1:
            return APART
        is_known = is_known and side == 0
    if is_known:
        for k in range(3):
            if p[k] < wp.min(a[k], b[k]) or p[k] > wp.max(a[k], b[k]):
                return APART
        return FOUND
    return OPEN


@wp.func
def test_crossing_in_plane(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d, s: wp.vec3d) -> int:
    """Whether the insides of two edges in the plane z = 0 cross each other in one point."""
    r_side = area_sign(r, p, q, 2)
    s_side = area_sign(s, p, q, 2)
    p_side = area_sign(p, r, s, 2)
    q_side = area_sign(q, r, s, 2)
    if are_same(r_side, s_side) or are_same(p_side, q_side):
        return APART
    if are_opposite(r_side, s_side) and are_opposite(p_side, q_side):
        return FOUND
    if r_side == 0 or s_side == 0 or p_side == 0 or q_side == 0:
        return APART  # an end is on the line through the other edge
    return OPEN


@wp.kernel
def test_pairs(
    begin: int,
    # in
    kind: int,
    in_plane: int,
    keys: wp.array[wp.int64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    num_vertices: int,  # the first vertex of an edge that is tested against a face is a number from here on
    x: wp.array[wp.vec3d],
    # out
    verdict: wp.array[wp.int32],
):
    """What the test of each pair finds."""
    n = begin + wp.tid()
    pair = pair_of(keys[n])
    a = first_corners[pair[0]]
    b = second_corners[pair[1]]
    if kind == VERTEX_FACE:
        if a[0] >= num_vertices:
            verdict[n] = test_edge_face(x[a[1]], x[a[2]], x[b[0]], x[b[1]], x[b[2]])
        else:
            verdict[n] = test_vertex_face(x[a[0]], x[b[0]], x[b[1]], x[b[2]])
    elif kind == EDGE_EDGE:
        if in_plane != 0:
            verdict[n] = test_crossing_in_plane(x[a[0]], x[a[1]], x[b[0]], x[b[1]])
        else:
            verdict[n] = test_edge_edge(x[a[0]], x[a[1]], x[b[0]], x[b[1]])
    elif kind == POINT_POINT:
        verdict[n] = wp.where(x[a[0]] == x[b[0]], FOUND, APART)
    else:
        verdict[n] = test_point_segment(x[a[0]], x[b[0]], x[b[1]])
