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
polygons = wp.types.matrix(shape=(2 * _MAX_VERTICES, 5), dtype=real)


@wp.func
def point_in_box(c: Corners, narrowing: real, size: vec3):
    """Whether a point of the patch lies in [-size, size], such a point, and its weights of w01 and w10.

    Side after side, of two polygons that alternate, the one becomes the part of the other that is inside of the side.
    """
    both = polygons()
    both[0] = vertex(c.w00[0], c.w00[1], c.w00[2], real(0.0), real(0.0))
    both[1] = vertex(c.w01[0], c.w01[1], c.w01[2], real(1.0), real(0.0))
    both[2] = vertex(c.w11[0], c.w11[1], c.w11[2], narrowing, real(1.0))
    both[3] = vertex(c.w10[0], c.w10[1], c.w10[2], real(0.0), real(1.0))
    n = int(4)
    p = int(0)  # where the polygon begins
    for side in range(6):
        axis = side / 2
        sign = real(1 - 2 * (side % 2))
        bound = size[axis]
        out = _MAX_VERTICES - p
        m = int(0)
        if n > 0:
            a = both[p + n - 1]
            da = sign * a[axis] - bound
            for i in range(n):
                b = both[p + i]
                db = sign * b[axis] - bound
                if (da <= real(0.0)) != (db <= real(0.0)) and m < _MAX_VERTICES:
                    both[out + m] = a + (da / (da - db)) * (b - a)
                    m += 1
                if db <= real(0.0) and m < _MAX_VERTICES:
                    both[out + m] = b
                    m += 1
                a = b
                da = db
        p = out
        n = m
    q = both[p]
    return n > 0, vec3(q[0], q[1], q[2]), q[3], q[4]
