"""How far the separation extends along a direction, in the norm that it has (`norm`)."""

import warp as wp

from ..parameters import norm, real
from . import simd
from .rounding import SQUARE_UNDERFLOW
from .simd import Lanes, Vec3, dot, magnitude, square_root

square_underflow = wp.constant(real(SQUARE_UNDERFLOW[real]))


@simd.func
def length(d: Vec3) -> Lanes:
    """The Euclidean length of d; the slack of the separation covers its roundings (rounding, step 13)."""
    return square_root(dot(d, d) + square_underflow)


if not norm.is_ball:

    @simd.func
    def support(separation: Vec3, d: Vec3) -> Lanes:
        """Largest product of d with a point of the separation box."""
        return dot(separation, magnitude(d))

else:

    @simd.func
    def support(separation: Vec3, d: Vec3) -> Lanes:
        """Largest product of d with a point of the ball."""
        return separation.x * length(d)
