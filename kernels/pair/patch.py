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

import warp as wp

from ..parameters import real
from . import simd
from .simd import Lanes, Mask, Vec3, dot, greatest, least, minus

one = wp.constant(real(1.0))


@wp.struct
class Corners:
    """Four corners and two sides of a patch at one time."""

    w00: Vec3
    w01: Vec3
    w10: Vec3
    w11: Vec3
    q: Vec3
    r: Vec3


@wp.struct
class Volume:
    """The volume f = P·(Q×R) of a patch, a cubic in t."""

    b0: Lanes  # its Bernstein coefficients on [0, 1]
    b1: Lanes
    b2: Lanes
    b3: Lanes
    bound: Lanes  # magnitude below which it proves nothing
    is_flat: Mask  # it proves nothing at any time
    normal_t0: Vec3  # Bernstein coefficients of Q×R, where there is a separation
    normal_mid: Vec3
    normal_t1: Vec3


@simd.func
def corners_at(t0: Corners, t1: Corners, t: Lanes) -> Corners:
    """Corners at one time, without the sides (rounding, step 8)."""
    c = Corners()
    s = one - t
    c.w00 = s * t0.w00 + t * t1.w00
    c.w01 = s * t0.w01 + t * t1.w01
    c.w10 = s * t0.w10 + t * t1.w10
    c.w11 = s * t0.w11 + t * t1.w11
    return c


@simd.func
def side_of(c: Corners, side: int) -> Vec3:
    """Sides of distinct directions: along v, along u at v = 0, along u at v = 1."""
    s = c.w01 - c.w00
    if side == 1:
        s = c.w10 - c.w00
    if side == 2:
        s = c.w11 - c.w01
    return s


@wp.func
def num_sides(is_face: bool) -> int:
    """Sides of distinct directions: opposite sides of a parallelogram are parallel."""
    return wp.where(is_face, 3, 2)


@wp.func
def gap_along(d: Vec3, c: Corners) -> Lanes:
    """Distance along d by which the patch is beyond the origin, on either side."""
    p = dot(d, c.w00)
    q = dot(d, c.w01)
    r = dot(d, c.w10)
    s = dot(d, c.w11)
    low = least(least(p, q), least(r, s))
    return greatest(low, minus(greatest(greatest(p, q), greatest(r, s))))
