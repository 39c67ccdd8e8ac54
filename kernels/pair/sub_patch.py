"""A patch of one pair that is subdivided, and what stays constant meanwhile."""

import warp as wp

from ..parameters import real
from .patch import Corners, Volume

vec3 = wp.types.vector(length=3, dtype=real)


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

    volume: Volume
    has_separation: bool
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
