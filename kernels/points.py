"""The points of a pair, and the corners of its patch: differences in float64, from which the solver starts."""

import warp as wp

from .patch import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE, make_patch

vec3d = wp.vec3d
Corners = make_patch(wp.float64).Corners


@wp.struct
class Points:
    """The four points of a pair at one time."""

    p0: vec3d
    p1: vec3d
    p2: vec3d
    p3: vec3d


@wp.func
def scaled(p: Points, s: vec3d) -> Points:
    """Points with each axis multiplied by a factor."""
    r = Points()
    r.p0 = wp.cw_mul(p.p0, s)
    r.p1 = wp.cw_mul(p.p1, s)
    r.p2 = wp.cw_mul(p.p2, s)
    r.p3 = wp.cw_mul(p.p3, s)
    return r


@wp.func
def longest_side(a: Points, b: Points) -> wp.float64:
    """Longest side of the box around the points at both ends of the step."""
    low = wp.min(wp.min(wp.min(a.p0, a.p1), wp.min(a.p2, a.p3)), wp.min(wp.min(b.p0, b.p1), wp.min(b.p2, b.p3)))
    high = wp.max(wp.max(wp.max(a.p0, a.p1), wp.max(a.p2, a.p3)), wp.max(wp.max(b.p0, b.p1), wp.max(b.p2, b.p3)))
    return wp.max(high - low)


@wp.func
def points_of(kind: int, first: wp.vec3i, second: wp.vec3i, x: wp.array[vec3d]) -> Points:
    """Points of a pair of primitives of a mesh, from the vertices of each."""
    p = Points()
    p.p0 = x[first[0]]
    if kind == EDGE_EDGE:
        p.p1 = x[first[1]]
        p.p2 = x[second[0]]
        p.p3 = x[second[1]]
    else:
        p.p1 = x[second[0]]
        p.p2 = x[second[1]]
        p.p3 = x[second[2]]
    return p


@wp.func
def is_stationary(a: Points, b: Points) -> bool:
    """Whether no point of a pair moves between two times."""
    return a.p0 == b.p0 and a.p1 == b.p1 and a.p2 == b.p2 and a.p3 == b.p3


@wp.func
def relative_motion(a: Points, b: Points) -> wp.float64:
    """Largest relative displacement (L∞) of any two points of a pair between two times."""
    low = vec3d()
    high = vec3d()
    for k in range(3):
        d0 = b.p0[k] - a.p0[k]
        d1 = b.p1[k] - a.p1[k]
        d2 = b.p2[k] - a.p2[k]
        d3 = b.p3[k] - a.p3[k]
        low[k] = wp.min(wp.min(d0, d1), wp.min(d2, d3))
        high[k] = wp.max(wp.max(d0, d1), wp.max(d2, d3))
    d = high - low
    return wp.max(wp.max(d[0], d[1]), d[2])


@wp.func
def row_points(x: wp.array2d[vec3d], i: int) -> Points:
    """Points of a row; missing points repeat the last one, so that they enlarge no box."""
    p = Points()
    p.p0 = x[i, 0]
    p.p1 = x[i, 1]
    p.p2 = x[i, wp.min(2, x.shape[1] - 1)]
    p.p3 = x[i, wp.min(3, x.shape[1] - 1)]
    return p


@wp.func
def corners(kind: int, p: Points) -> Corners:
    """Corners and sides of the patch: one rounded difference each (rounding, step 1)."""
    c = Corners()
    if kind == VERTEX_FACE:
        c.w00 = p.p0 - p.p1
        c.w01 = p.p0 - p.p2
        c.w10 = p.p0 - p.p3
        c.w11 = c.w10
        c.q = p.p1 - p.p2
        c.r = p.p1 - p.p3
    elif kind == EDGE_EDGE:
        c.w00 = p.p0 - p.p2
        c.w01 = p.p0 - p.p3
        c.w10 = p.p1 - p.p2
        c.w11 = p.p1 - p.p3
        c.q = p.p2 - p.p3
        c.r = p.p1 - p.p0
    else:
        c.w00 = p.p0 - p.p1
        c.w01 = c.w00
        if kind == POINT_SEGMENT:
            c.w01 = p.p0 - p.p2
            c.q = p.p1 - p.p2
        c.w10 = c.w00
        c.w11 = c.w01
    return c


@wp.func
def magnitude(c: Corners) -> vec3d:
    """Largest |corner| per axis."""
    return wp.max(wp.max(wp.abs(c.w00), wp.abs(c.w01)), wp.max(wp.abs(c.w10), wp.abs(c.w11)))


@wp.func
def total(c: Corners) -> vec3d:
    """Sum of the magnitudes: unlike a maximum it propagates NaN."""
    return wp.abs(c.w00) + wp.abs(c.w01) + wp.abs(c.w10) + wp.abs(c.w11) + wp.abs(c.q) + wp.abs(c.r)
