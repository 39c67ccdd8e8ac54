"""Positions of either precision, in space or in the plane, as positions in space in float64."""

import warp as wp

from ..parameters import dimension, real

vec = wp.types.vector(length=dimension, dtype=real)


@wp.func
def in_space(x: vec) -> wp.vec3d:
    """A position in float64, which represents either precision exactly; in the plane z is 0."""
    y = wp.vec3d()
    for i in range(wp.static(dimension)):
        y[i] = wp.float64(x[i])
    return y
