"""The points of pairs, and the corners of their patches: differences in float64, from which the narrow phase starts."""

import warp as wp

from ..pair_kind import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE
from ..parameters import width
from ..template import specialised

simd = specialised("pair.simd", width=width)
Corners = specialised("pair.patch", width=width).Corners


@wp.struct
class Points:
    """The four points of a pair at one time."""

    p0: simd.Vec3
    p1: simd.Vec3
    p2: simd.Vec3
    p3: simd.Vec3


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
def largest(c: Corners) -> simd.Vec3:
    """Largest |corner| per axis."""
    along_u0 = simd.greatest(simd.magnitude(c.w00), simd.magnitude(c.w01))
    return simd.greatest(along_u0, simd.greatest(simd.magnitude(c.w10), simd.magnitude(c.w11)))


@simd.func
def total(c: Corners) -> simd.Vec3:
    """Sum of the magnitudes: unlike a maximum it propagates NaN."""
    of_corners = simd.magnitude(c.w00) + simd.magnitude(c.w01) + simd.magnitude(c.w10) + simd.magnitude(c.w11)
    return of_corners + simd.magnitude(c.q) + simd.magnitude(c.r)


@simd.func
def longest_side(a: Points, b: Points) -> simd.Lanes:
    """Longest side of the box around the points at both ends of the step."""
    low_a = simd.least(simd.least(a.p0, a.p1), simd.least(a.p2, a.p3))
    low_b = simd.least(simd.least(b.p0, b.p1), simd.least(b.p2, b.p3))
    high_a = simd.greatest(simd.greatest(a.p0, a.p1), simd.greatest(a.p2, a.p3))
    high_b = simd.greatest(simd.greatest(b.p0, b.p1), simd.greatest(b.p2, b.p3))
    side = simd.greatest(high_a, high_b) - simd.least(low_a, low_b)
    return simd.greatest(simd.greatest(side.x, side.y), side.z)


@simd.func
def farthest(a: Points, b: Points) -> simd.Lanes:
    """Largest |coordinate| of the points at both ends of the step."""
    of_a = simd.greatest(
        simd.greatest(simd.magnitude(a.p0), simd.magnitude(a.p1)), simd.greatest(simd.magnitude(a.p2), simd.magnitude(a.p3))
    )
    of_b = simd.greatest(
        simd.greatest(simd.magnitude(b.p0), simd.magnitude(b.p1)), simd.greatest(simd.magnitude(b.p2), simd.magnitude(b.p3))
    )
    return simd.greatest_of(simd.greatest(of_a, of_b))


@wp.func
def scaled(p: Points, s: simd.Vec3) -> Points:
    """Points with each axis multiplied by a factor."""
    r = Points()
    r.p0 = simd.scaled(p.p0, s)
    r.p1 = simd.scaled(p.p1, s)
    r.p2 = simd.scaled(p.p2, s)
    r.p3 = simd.scaled(p.p3, s)
    return r
