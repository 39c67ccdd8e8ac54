"""The norm of a separation: a box or a ball around the origin, and how far each extends along a direction.

In the maximum norm the separation is a box, in the Euclidean norm a ball. Both are convex, so the inclusion test along
a direction d has the support of the shape for its offset: Σ|d_k|·separation_k of the box, separation·|d| of the ball.
A ball stays one only if all axes are scaled alike: in the Euclidean norm a pair is normalised by one power of two, and
the three components of its separation are equal. Each pair has a separation of its own (`pair_options`), as radii and
start distances ask for. Kernels are made for one norm, so that a scene compiles nothing of the others, and one without
a separation nothing of any. Where bodies turn, a pair has a separation of its own for each part of the step, which
includes how far its points are from their chords (`arcs`): two more norms.
"""

# A box; in the solver one of no size.
MAXIMUM_NORM = "maximum"
EUCLIDEAN_NORM = "euclidean"
# A box of a size for each pair.
OWN_BOX_NORM = "own_box"
# Of pairs whose points move on arcs.
ARC_BOX_NORM = "arc_box"
ARC_BALL_NORM = "arc_ball"


def is_ball(norm: str) -> bool:
    """Whether the separation is a ball."""
    return norm in (EUCLIDEAN_NORM, ARC_BALL_NORM)


def is_by_pair(norm: str) -> bool:
    """Whether pairs may have a separation, each its own."""
    return norm != MAXIMUM_NORM


def has_arcs(norm: str) -> bool:
    """Whether points move on arcs."""
    return norm in (ARC_BOX_NORM, ARC_BALL_NORM)


def shape_of(norm: str) -> str:
    """The norm whose separations have the same shape: a ball or a box."""
    return EUCLIDEAN_NORM if is_ball(norm) else MAXIMUM_NORM
