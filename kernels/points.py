"""The points of pairs, and the corners of their patches: differences in float64, from which the narrow phase starts."""

from types import SimpleNamespace

import warp as wp

from .once import once
from .pair_kind import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE
from .patch import make_patch
from .simd import make_simd


@once
def make_points(width: int) -> SimpleNamespace:
    """Struct and functions for a number of lanes of float64."""
    simd = make_simd(wp.float64, width)
    Lanes = simd.Lanes
    Vec3 = simd.Vec3
    magnitude = simd.magnitude
    least = simd.least
    greatest = simd.greatest
    scaled_by = simd.scaled
    Corners = make_patch(wp.float64, width).Corners

    @wp.struct
    class Points:
        """The four points of a pair at one time."""

        p0: Vec3
        p1: Vec3
        p2: Vec3
        p3: Vec3

    @simd.func
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

    @simd.func
    def largest(c: Corners) -> Vec3:
        """Largest |corner| per axis."""
        along_u0 = greatest(magnitude(c.w00), magnitude(c.w01))
        return greatest(along_u0, greatest(magnitude(c.w10), magnitude(c.w11)))

    @simd.func
    def total(c: Corners) -> Vec3:
        """Sum of the magnitudes: unlike a maximum it propagates NaN."""
        of_corners = magnitude(c.w00) + magnitude(c.w01) + magnitude(c.w10) + magnitude(c.w11)
        return of_corners + magnitude(c.q) + magnitude(c.r)

    @simd.func
    def longest_side(a: Points, b: Points) -> Lanes:
        """Longest side of the box around the points at both ends of the step."""
        low_a = least(least(a.p0, a.p1), least(a.p2, a.p3))
        low_b = least(least(b.p0, b.p1), least(b.p2, b.p3))
        high_a = greatest(greatest(a.p0, a.p1), greatest(a.p2, a.p3))
        high_b = greatest(greatest(b.p0, b.p1), greatest(b.p2, b.p3))
        side = greatest(high_a, high_b) - least(low_a, low_b)
        return greatest(greatest(side.x, side.y), side.z)

    @wp.func
    def scaled(p: Points, s: Vec3) -> Points:
        """Points with each axis multiplied by a factor."""
        r = Points()
        r.p0 = scaled_by(p.p0, s)
        r.p1 = scaled_by(p.p1, s)
        r.p2 = scaled_by(p.p2, s)
        r.p3 = scaled_by(p.p3, s)
        return r

    return SimpleNamespace(
        Points=Points, corners=corners, largest=largest, total=total, longest_side=longest_side, scaled=scaled
    )


# of a single pair
vec3d = wp.vec3d
Points = make_points(1).Points
corners = make_points(1).corners


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
