"""The norm of a separation: a box or a ball around the origin, and how far each extends along a direction.

In the maximum norm the separation is a box, in the Euclidean norm a ball. Both are convex, so the inclusion test along
a direction d has the support of the shape for its offset: Σ|d_k|·separation_k of the box, separation·|d| of the ball.
A ball stays one only if all axes are scaled alike: in the Euclidean norm a pair is normalised by one power of two, and
the three components of its separation are equal. Where each pair has a separation of its own (`pair_options`), that is
a norm of its own here. Kernels are made for one norm, so that a scene without Euclidean distances, or without radii,
compiles nothing of them.
"""

from types import SimpleNamespace

import warp as wp

from .once import once
from .rounding import SQUARE_UNDERFLOW
from .simd import make_simd

MAXIMUM_NORM = "maximum"
EUCLIDEAN_NORM = "euclidean"
# Each pair has a separation of its own: a ball, for meshes with radii and for what starts within its distance
# (`thickness`, `hold`); or a box, for the latter.
THICK_NORM = "thick"
OWN_BOX_NORM = "own_box"


def is_ball(norm: str) -> bool:
    """Whether the separation is a ball."""
    return norm in (EUCLIDEAN_NORM, THICK_NORM)


def is_by_pair(norm: str) -> bool:
    """Whether each pair has a separation of its own."""
    return norm in (THICK_NORM, OWN_BOX_NORM)


@once
def make_norm(real, width: int, norm: str) -> SimpleNamespace:
    """Functions for one floating-point type, a number of lanes and a norm."""
    simd = make_simd(real, width)
    Lanes = simd.Lanes
    Vec3 = simd.Vec3
    spread = simd.spread
    square_root = simd.square_root
    magnitude = simd.magnitude
    dot = simd.dot
    square_underflow = wp.constant(real(SQUARE_UNDERFLOW[real]))

    @simd.func
    def length(d: Vec3) -> Lanes:
        """The Euclidean length of d; the slack of the separation covers its roundings (rounding, step 13)."""
        return square_root(dot(d, d) + spread(square_underflow))

    if not is_ball(norm):

        @simd.func
        def support(separation: Vec3, d: Vec3) -> Lanes:
            """Largest product of d with a point of the separation box."""
            return dot(separation, magnitude(d))

    else:

        @simd.func
        def support(separation: Vec3, d: Vec3) -> Lanes:
            """Largest product of d with a point of the ball."""
            return separation.x * length(d)

    return SimpleNamespace(length=length, support=support)
