"""What starts within its distance parts and slides freely, and comes no closer.

A step that starts where a pair is within its distance has toi 0, whichever way the pair moves: nothing proves it free.
A line search ends at the distance, so the next one would begin there, and stay. Therefore a pair may keep less: what
its vertices kept at the start. The **hold** of a vertex is how near it was to anything there, a lower bound of the
distance of every pair that it belongs to as a vertex, or as an end of an edge; infinite where that is beyond the
distance. A pair then keeps the least of its distance and the holds of its vertices, less a margin for its rounding.

By vertex, not by pair: what slides over a mesh at less than the distance meets the next face from beyond the distance,
and its vertices take their hold along. In a vertex-face pair the vertex has the hold, and the face takes none: so what
rests on a large face does not lower what all else keeps of that face.

**The margin.** At the start the gap of a held pair is at least what it keeps plus a margin, a multiple of u times its
size, the largest corner of its patch at either end of the step. Within the bounds on rounding (`rounding`, steps 4 to
9) nothing could be proved free. 128 u suffice in the Euclidean norm, 1024 u in the maximum norm, whose directions are
cross products: then 99.97 and 99.1 in a hundred of the pairs that slide have their whole step, and of those that part
nearly all (`benchmarks/notes/distances.md`). A margin only lowers what is kept, by 1.4e-14 or 1.1e-13 of the size of a
pair in a search; so it is stated, and nothing depends on it. Where it is more than the hold, the pair keeps 0, and
cannot pass.
"""

import warp as wp

from .rounding import UNIT_ROUNDOFF

# By the norm of the separation: whether it is a ball.
MARGIN = {True: 128.0 * UNIT_ROUNDOFF[wp.float64], False: 1024.0 * UNIT_ROUNDOFF[wp.float64]}
_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.func
def held_at(hold: wp.array[wp.float64], first: wp.vec3i, second: wp.vec3i) -> wp.float64:
    """The least hold of the vertices of a pair, of which some repeat; infinite where nothing is held."""
    if hold.shape[0] == 0:
        return _INFINITY
    of_first = wp.min(hold[first[0]], wp.min(hold[first[1]], hold[first[2]]))
    return wp.min(of_first, wp.min(hold[second[0]], wp.min(hold[second[1]], hold[second[2]])))
