"""The contact test: does a flat patch reach into a box around the origin?

A contact is claimed only where a real point of the patch is found within separation and tolerance, so rounding cannot
claim one where the gap is larger. The patch is clipped against the six sides of the box (Sutherland and Hodgman 1974):
what is left, if anything, are points of the patch, each off by no more than the rounding of its interpolation. Unlike a
closest point, this stays accurate for slivers.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from .patch import make_patch

# Four corners, and at most one more a side.
_MAX_VERTICES = 10


@cache
def make_contact_test(real) -> SimpleNamespace:
    """Functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    polygon = wp.types.matrix(shape=(_MAX_VERTICES, 3), dtype=real)
    Corners = make_patch(real).Corners

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
    def reaches_box(c: Corners, size: vec3) -> bool:
        """Whether a point of the patch lies in [-size, size]."""
        p = polygon()
        p[0] = c.w00
        p[1] = c.w01
        p[2] = c.w11
        p[3] = c.w10
        n = int(4)
        for axis in range(3):
            p, n = clip_polygon(p, n, axis, real(1.0), size[axis])
            p, n = clip_polygon(p, n, axis, real(-1.0), size[axis])
        return n > 0

    return SimpleNamespace(reaches_box=reaches_box)
