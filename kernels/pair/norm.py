"""The norm of a separation: a box or a ball around the origin, and how far each extends along a direction.

In the maximum norm the separation is a box, in the Euclidean norm a ball. Both are convex, so the inclusion test along
a direction d has the support of the shape for its offset: Σ|d_k|·separation_k of the box, separation·|d| of the ball.
A ball stays one only if all axes are scaled alike: in the Euclidean norm a pair is normalised by one power of two, and
the three components of its separation are equal. There each pair has a separation of its own (`pair_options`), as radii
and holds ask for; in the maximum norm only what is held has, which is a norm of its own here. Kernels are made for one
norm, so that a scene without Euclidean distances compiles nothing of them.
"""

MAXIMUM_NORM = "maximum"
EUCLIDEAN_NORM = "euclidean"
# A box for each pair, where something starts within its distance (`hold`).
OWN_BOX_NORM = "own_box"


def is_ball(norm: str) -> bool:
    """Whether the separation is a ball."""
    return norm == EUCLIDEAN_NORM


def is_by_pair(norm: str) -> bool:
    """Whether each pair has a separation of its own, which may be above 0."""
    return norm != MAXIMUM_NORM


def shape_of(norm: str) -> str:
    """The norm whose separations have the same shape: a ball or a box."""
    return EUCLIDEAN_NORM if is_ball(norm) else MAXIMUM_NORM
