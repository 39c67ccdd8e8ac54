"""What starts within its distance parts and slides freely, and comes no closer.

A step that starts where a pair is within its distance has toi 0, whichever way the pair moves: nothing proves it free.
A line search ends at the distance, so the next one would begin there, and stay. Therefore a pair may keep less: what
its vertices kept at the start. The **start distance** of a vertex says how near it was to anything there, to which it
belongs as the vertex of a pair, or as an end of an edge, in two lower bounds: of the distances d of these pairs as a
length h ≤ d, and as a share s ≤ d / D of the distance D of each; infinite where they are beyond their distances. A pair
then keeps D, or less, max(s D, min(h, D)) with the least s and h of its vertices, less a margin for its rounding.

Both hold, so their greatest does. Where all have one distance they are the same. Where radii differ, a length alone
would let what is pressed on by a thin body, a rounding within that thickness, come as near to a thick one; a share
alone would let what starts deep within a thick body come as deep into a thin one.

By vertex, not by pair: what slides over a mesh at less than the distance meets the next face from beyond the distance,
and its vertices take their start distance along. In a vertex-face pair the vertex has one, and the face takes none: so
what rests on a large face does not lower what all else keeps of that face.

**Rounding.** A share is the rounded quotient times 1 - 2u, which rounds to no more than d / D, and a length by it the
rounded product times 1 - 2u; from both 2^-1074 is taken, as either may be subnormal. A pair that has all of its
distance, s = 1, keeps it in every bit.

**The margin.** At the start the gap of a pair is at least what it keeps plus a margin: 128 u times its size, the
largest corner of its patch at either end of the step, and 16 u times its largest coordinate. Within the bounds on
rounding (`rounding`, steps 4 to 9) nothing could be proved free, and positions that are rounded do not slide exactly:
four points that are off by 2 u of their coordinates change a gap by 14 u. A margin only lowers what is kept, in a
search, by that; so it is stated, and nothing depends on it. Where it is more than the start distance, the
pair keeps 0, and cannot pass.

With so little to spare, such a pair is first tried with the directions of `passing`, which prove most of what slides at
once. On straight lines it is decided to rounding: the tolerance, which ends the search for the time of a contact, is 0.
"""

import warp as wp

from .rounding import UNIT_ROUNDOFF

# Of the size of a pair, and of its largest coordinate as a share of that.
MARGIN = 128.0 * UNIT_ROUNDOFF[wp.float64]
OF_COORDINATES = 0.125
_DOWN = wp.constant(wp.float64(1.0 - 2.0 * UNIT_ROUNDOFF[wp.float64]))
_UNDERFLOW = wp.constant(wp.float64(2.0**-1074))
_LARGEST = wp.constant(wp.float64(1.7976931348623157e308))
_INFINITY = wp.constant(wp.float64(float("inf")))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.struct
class StartDistance:
    """Of a vertex, or the least of several; both infinite where none is kept."""

    share: wp.float64  # of the distance of each pair, at most 1
    length: wp.float64


@wp.func
def share_of(least: wp.float64, distance: wp.float64) -> wp.float64:
    """The share of its distance that a pair has which is at least ``least`` apart, rounded down; 1 where it is more."""
    if least >= distance:
        return _ONE
    return wp.max(least / wp.min(distance, _LARGEST) * _DOWN - _UNDERFLOW, _ZERO)


@wp.func
def kept_of(at_start: StartDistance, distance: wp.float64) -> wp.float64:
    """What a pair keeps of its distance, rounded down."""
    if at_start.share >= _ONE:
        return distance
    by_share = at_start.share * wp.min(distance, _LARGEST) * _DOWN - _UNDERFLOW
    return wp.max(by_share, wp.min(at_start.length, distance))


@wp.func
def start_distance_of(start_distance: wp.array[wp.float64], first: wp.vec3i, second: wp.vec3i) -> StartDistance:
    """The least start distance of the vertices of a pair, of which some repeat, from share and length of each.

    The first primitive has at most two. Where all of a distance is kept the length does not matter, and is infinite.
    """
    least = StartDistance()
    least.share = _INFINITY
    least.length = _INFINITY
    if start_distance.shape[0] > 0:
        a = 2 * first[0]
        b = 2 * first[1]
        c = 2 * second[0]
        d = 2 * second[1]
        e = 2 * second[2]
        of_first = wp.min(start_distance[a], start_distance[b])
        least.share = wp.min(of_first, wp.min(start_distance[c], wp.min(start_distance[d], start_distance[e])))
        if least.share < _ONE:
            of_first = wp.min(start_distance[a + 1], start_distance[b + 1])
            of_second = wp.min(start_distance[c + 1], wp.min(start_distance[d + 1], start_distance[e + 1]))
            least.length = wp.min(of_first, of_second)
    return least
