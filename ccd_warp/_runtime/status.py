"""Enumerations of the results: kinds of pairs, statuses and flags."""

from enum import IntEnum, IntFlag

from ccd_warp.kernels import pair_kind
from ccd_warp.kernels.pair import status
from ccd_warp.kernels.step import minima


class PairKind(IntEnum):
    """Kind of a primitive pair; where a result has a number for each kind, they are in this order."""

    VERTEX_FACE = int(pair_kind.VERTEX_FACE)
    EDGE_EDGE = int(pair_kind.EDGE_EDGE)
    POINT_SEGMENT = int(pair_kind.POINT_SEGMENT)
    POINT_POINT = int(pair_kind.POINT_POINT)
    VERTEX_PLANE = int(pair_kind.VERTEX_PLANE)


class IntersectionKind(IntEnum):
    """Kind of a pair of primitives that intersect at one time; the first four have the numbers of :class:`PairKind`."""

    VERTEX_FACE = int(pair_kind.VERTEX_FACE)
    """A vertex is in a face, or on its boundary."""

    EDGE_EDGE = int(pair_kind.EDGE_EDGE)
    """Two edges have a common point; of a mesh in the plane the inside of one crosses that of the other."""

    POINT_SEGMENT = int(pair_kind.POINT_SEGMENT)
    """A codimensional point is on a codimensional edge; of a mesh in the plane any vertex on any edge."""

    POINT_POINT = int(pair_kind.POINT_POINT)
    """Two codimensional points are in one place."""

    EDGE_FACE = 4
    """The inside of an edge passes through the inside of a face, from one side to the other."""

    VERTEX_PLANE = 5
    """A vertex is in a half-space, or on its plane."""


# The primitives that have another name in the kind of a pair.
_CODIMENSIONAL = {"point": "vertex", "segment": "edge"}


def primitives_of(kind: PairKind | IntersectionKind) -> tuple[str, str]:
    """What the two primitives of a pair of a kind are, as its name says: a vertex, an edge, a face or a plane."""
    first, second = (_CODIMENSIONAL.get(word, word) for word in kind.name.lower().split("_"))
    return first, second


class CCDStatus(IntEnum):
    """How the result of a pair was obtained. Every toi is conservative, whatever the status."""

    NO_COLLISION = int(status.STATUS_NO_COLLISION)
    """Certainly no contact in [0, t_max]; toi is inf."""

    COLLISION = int(status.STATUS_COLLISION)
    """The gap at toi is within the tolerance."""

    INITIAL_CONTACT = int(status.STATUS_INITIAL_CONTACT)
    """The gap is within the tolerance at the start and does not open at once; toi is 0."""

    ITERATION_LIMIT = int(status.STATUS_ITERATION_LIMIT)
    """``max_iterations``, or the pair's share of ``max_work``, was reached; toi is the earliest time still open."""

    RESOLUTION_LIMIT = int(status.STATUS_RESOLUTION_LIMIT)
    """The patch cannot be subdivided further in this precision; toi is the earliest time still open."""

    INVALID = int(status.STATUS_INVALID)
    """A coordinate is not finite (Warp arrays only; NumPy input raises a ValueError); toi is 0."""

    ROUNDING_LIMIT = int(status.STATUS_ROUNDING_LIMIT)
    """Rounding at the size of the pair and its motion exceeds the tolerance and hides its gap at the start; toi is 0.

    So it is where positions blow up; the pair may be far from any contact. With a motion that has a ``within``, this
    hides gaps, too.
    """


class LaunchFlag(IntFlag):
    """Outcome of a launch on the device, 0 if there was no problem. Every toi is conservative, whatever the flags."""

    PAIRS_OVERFLOW = int(minima.PAIRS_OVERFLOW)
    """There are more than ``max_pairs`` pairs of a kind; the excess counts with toi 0 and is not among the contacts."""

    CONTACTS_OVERFLOW = int(minima.CONTACTS_OVERFLOW)
    """There are more than ``max_contacts`` contacts; the excess is missing only from the list of contacts, of a line
    search from that of its last pass, and on a tape from the gradients of any."""

    INVALID_INPUT = int(minima.INVALID_INPUT)
    """A coordinate is not finite, and every toi of its world is 0."""

    ROUNDING_LIMIT = int(minima.ROUNDING_LIMIT)
    """Rounding hides the gap of a pair at the start, with ``CCDStatus.ROUNDING_LIMIT``; of a line search in its last
    pass."""
    STATIC_MOVED = int(minima.STATIC_MOVED)
    """An end position of a static body differs from its start position, and every toi of its world is 0."""

    STRUCK = int(minima.STRUCK)
    """A kinematic body strikes vertices that a line search has stopped; the pairs are among the contacts."""
