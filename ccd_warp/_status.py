"""Closed sets of the results: pair kinds and statuses."""

from enum import IntEnum

from ccd_warp.kernels import patch, subdivide


class PairKind(IntEnum):
    """Kind of a primitive pair."""

    VERTEX_FACE = int(patch.VERTEX_FACE)
    EDGE_EDGE = int(patch.EDGE_EDGE)
    POINT_SEGMENT = int(patch.POINT_SEGMENT)
    POINT_POINT = int(patch.POINT_POINT)


class CCDStatus(IntEnum):
    """How the answer for a pair was reached. Every toi is conservative, whatever the status."""

    NO_COLLISION = int(subdivide.STATUS_NO_COLLISION)
    """Certainly no contact in [0, t_max]; toi is inf."""

    COLLISION = int(subdivide.STATUS_COLLISION)
    """The gap at toi is within the tolerance."""

    INITIAL_CONTACT = int(subdivide.STATUS_INITIAL_CONTACT)
    """The gap is within the tolerance at the start and does not open at once; toi is 0."""

    ITERATION_LIMIT = int(subdivide.STATUS_ITERATION_LIMIT)
    """``max_iterations`` was reached; toi is the earliest time still open. Raise ``max_iterations`` for a later one."""

    RESOLUTION_LIMIT = int(subdivide.STATUS_RESOLUTION_LIMIT)
    """The patch cannot be split further in this precision; toi is the earliest time still open."""

    INVALID = int(subdivide.STATUS_INVALID)
    """A coordinate is not finite (Warp arrays only; NumPy input raises a ValueError); toi is 0."""
