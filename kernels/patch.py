"""The moving patch: the one shape to which every pair kind is reduced.

A pair touches at time t iff its patch, the convex hull of four corners that move linearly, contains the origin:
F(t,u,v) = 0, with F bilinear in (u, v) and linear in t.

| pair          | w00     | w01     | w10     | w11     | q       | r       |
|---------------|---------|---------|---------|---------|---------|---------|
| vertex-face   | v − f0  | v − f1  | v − f2  | v − f2  | f0 − f1 | f0 − f2 |
| edge-edge     | a0 − b0 | a0 − b1 | a1 − b0 | a1 − b1 | b0 − b1 | a1 − a0 |
| point-segment | p − a   | p − b   | p − a   | p − b   | a − b   | 0       |
| point-point   | p − q   | p − q   | p − q   | p − q   | 0       | 0       |

The sides are q = w01 − w00 and r = w10 − w00. In two dimensions the third coordinate is 0. u runs from w0* to w1*, v
from w*0 to w*1; a triangle is the patch whose side u = 1 has shrunk to a point.
"""

from types import SimpleNamespace

import warp as wp

from .once import once

# Pair kinds; ccd_warp.PairKind mirrors these.
VERTEX_FACE = wp.constant(0)
EDGE_EDGE = wp.constant(1)
POINT_SEGMENT = wp.constant(2)
POINT_POINT = wp.constant(3)


@once
def make_patch(real) -> SimpleNamespace:
    """Structs and functions for one floating-point type."""
    vec3 = wp.types.vector(length=3, dtype=real)
    vec4 = wp.types.vector(length=4, dtype=real)

    @wp.struct
    class Corners:
        """Four corners and two sides of a patch at one time."""

        w00: vec3
        w01: vec3
        w10: vec3
        w11: vec3
        q: vec3
        r: vec3

    @wp.struct
    class Patch:
        """A patch over the whole step; its sides are set only where the volume needs them (the root patch)."""

        t0: Corners
        t1: Corners
        is_face: bool  # its sides along u intersect
        is_triangle: bool  # they intersect at u = 1, so w11 = w10
        narrowing: real  # length of the side u = 1 over that of the parallel side u = 0

    @wp.struct
    class Problem:
        """The quantities that are constant while a pair is subdivided; lengths in normalised units, per axis."""

        volume: vec4  # Bernstein coefficients of P·(Q×R)
        volume_bound: real  # magnitude below which the volume proves nothing
        normal_t0: vec3  # Bernstein coefficients of Q×R
        normal_mid: vec3
        normal_t1: vec3
        has_separation: bool
        is_flat: bool  # the volume proves nothing at any time
        error: vec3  # rounding bound E of a projection
        separation: vec3  # half sides of the separation box
        delta: vec3  # largest gap that counts as contact

    @wp.func
    def sub_corner(c: Corners, u: real, v: real) -> vec3:
        """Point (u, v) of the patch (rounding, step 3)."""
        x = (real(1.0) - v) * c.w00 + v * c.w01
        y = (real(1.0) - v) * c.w10 + v * c.w11
        return (real(1.0) - u) * x + u * y

    @wp.func
    def sub_corners(c: Corners, u0: real, u1: real, v0: real, v1: real) -> Corners:
        """Corners of the sub-patch [u0, u1] × [v0, v1]."""
        s = Corners()
        s.w00 = sub_corner(c, u0, v0)
        s.w01 = sub_corner(c, u0, v1)
        s.w10 = sub_corner(c, u1, v0)
        s.w11 = sub_corner(c, u1, v1)
        return s

    return SimpleNamespace(Corners=Corners, Patch=Patch, Problem=Problem, sub_corners=sub_corners)
