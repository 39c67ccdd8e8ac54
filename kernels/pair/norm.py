"""The norm of a separation: a box or a ball around the origin, and how far each extends along a direction.

In the maximum norm the separation is a box, in the Euclidean norm a ball. Both are convex, so the inclusion test along
a direction d has the support of the shape for its offset: Σ|d_k|·separation_k of the box, separation·|d| of the ball.
A ball stays one only if all axes are scaled alike: in the Euclidean norm a pair is normalised by one power of two, and
the three components of its separation are equal. Each pair has a separation of its own (`pair_options`), as radii and
start distances ask for. Kernels are made for one norm, so that a scene compiles nothing of the others, and one without
a separation nothing of any. Where bodies turn, a pair has a separation of its own for each part of the step, which
includes how far its points are from their chords (`arcs`): two more norms.
"""

from enum import StrEnum


class Norm(StrEnum):
    """A norm, as a parameter of templates; what a kernel does follows from what the norm says of itself."""

    MAXIMUM = "maximum"  # a box; in the solver one of no size
    EUCLIDEAN = "euclidean"
    OWN_BOX = "own_box"  # a box of a size for each pair
    ARC_BOX = "arc_box"  # of pairs whose points move on arcs
    ARC_BALL = "arc_ball"

    @property
    def is_ball(self) -> bool:
        """Whether the separation is a ball."""
        return self in (Norm.EUCLIDEAN, Norm.ARC_BALL)

    @property
    def is_by_pair(self) -> bool:
        """Whether pairs may have a separation, each its own."""
        return self != Norm.MAXIMUM

    @property
    def has_arcs(self) -> bool:
        """Whether points move on arcs."""
        return self in (Norm.ARC_BOX, Norm.ARC_BALL)

    @property
    def shape(self) -> "Norm":
        """The norm whose separations have the same shape: a ball or a box."""
        return Norm.EUCLIDEAN if self.is_ball else Norm.MAXIMUM

    @property
    def on_arcs(self) -> "Norm":
        """The norm with separations of the same shape where points move on arcs."""
        return Norm.ARC_BALL if self.is_ball else Norm.ARC_BOX

    @property
    def suffix(self) -> str:
        """What names of modules have at their end."""
        return "" if self == Norm.MAXIMUM else f".{self}"
