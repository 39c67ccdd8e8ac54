"""The contact test: does a flat patch intersect a box around the origin?

A contact is reported only if a true point of the patch is found within separation and tolerance, so rounding cannot
produce one where the gap is larger. The patch is clipped against the six sides of the box (Sutherland and Hodgman
1974): the vertices of the remaining polygon, if any, are points of the patch, each off by no more than the rounding of
its interpolation. Unlike a closest point, this test stays accurate for slivers.
"""

import warp as wp

from ..parameters import real
from .patch import Corners

# Four corners, and at most one more for each side of the box.
_MAX_VERTICES = 10


vec3 = wp.types.vector(length=3, dtype=real)
vertex = wp.types.vector(length=5, dtype=real)  # position, and its weights of w01 and w10
polygon = wp.types.matrix(shape=(_MAX_VERTICES, 5), dtype=real)


@wp.func
def clip_polygon(p: polygon, n: int, axis: int, sign: real, bound: real):
    """Part of a convex polygon where sign·x[axis] <= bound, and its number of vertices."""
    out = polygon()
    m = int(0)
    if n > 0:
        a = p[n - 1]
        da = sign * a[axis] - bound
        for i in range(n):
            b = p[i]
            db = sign * b[axis] - bound
            if (da <= real(0.0)) != (db <= real(0.0)) and m < _MAX_VERTICES:
                out[m] = a + (da / (da - db)) * (b - a)
                m += 1
            if db <= real(0.0) and m < _MAX_VERTICES:
                out[m] = b
                m += 1
            a = b
            da = db
    return out, m


@wp.func
def point_in_box(c: Corners, narrowing: real, size: vec3):
    """Whether a point of the patch lies in [-size, size], such a point, and its weights of w01 and w10."""
    p = polygon()
    p[0] = vertex(c.w00[0], c.w00[1], c.w00[2], real(0.0), real(0.0))
    p[1] = vertex(c.w01[0], c.w01[1], c.w01[2], real(1.0), real(0.0))
    p[2] = vertex(c.w11[0], c.w11[1], c.w11[2], narrowing, real(1.0))
    p[3] = vertex(c.w10[0], c.w10[1], c.w10[2], real(0.0), real(1.0))
    n = int(4)
    for axis in range(3):
        p, n = clip_polygon(p, n, axis, real(1.0), size[axis])
        p, n = clip_polygon(p, n, axis, real(-1.0), size[axis])
    q = p[0]
    return n > 0, vec3(q[0], q[1], q[2]), q[3], q[4]
