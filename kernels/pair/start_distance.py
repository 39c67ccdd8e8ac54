"""What starts within its distance parts and slides freely, and comes no closer.

A step that starts where a pair is within its distance has toi 0, whichever way the pair moves: nothing proves it free.
A line search ends at the distance, so the next one would begin there, and stay. Therefore a pair may keep less: what
its vertices kept at the start. The **start distance** of a vertex is how near it was to anything there, a lower bound
of the distance of every pair that it belongs to as a vertex, or as an end of an edge; infinite where that is beyond
the distance. A pair then keeps the least of its distance and the start distances of its vertices, less a margin for its
rounding.

By vertex, not by pair: what slides over a mesh at less than the distance meets the next face from beyond the distance,
and its vertices take their start distance along. In a vertex-face pair the vertex has one, and the face takes none: so
what rests on a large face does not lower what all else keeps of that face.

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
_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.func
def least_of(start_distance: wp.array[wp.float64], corners: wp.vec3i) -> wp.float64:
    """The least start distance of the vertices of a primitive."""
    return wp.min(start_distance[corners[0]], wp.min(start_distance[corners[1]], start_distance[corners[2]]))


@wp.func
def start_distance_of(start_distance: wp.array[wp.float64], first: wp.vec3i, second: wp.vec3i) -> wp.float64:
    """The least start distance of the vertices of a pair, of which some repeat; infinite where none is kept."""
    if start_distance.shape[0] == 0:
        return _INFINITY
    return wp.min(least_of(start_distance, first), least_of(start_distance, second))
