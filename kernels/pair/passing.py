"""Directions for a pair that passes by at its distance: those of the hull that it sweeps.

What slides along something keeps its distance, and comes no closer. Only the direction in which it is nearest, where it
passes, proves that, and the closest pair before the passage has another, which comes to it in the limit. But a constant
direction that separates the corners at both ends of a step separates them all the time. The corners of a pair whose
sides do not turn, at both ends, span a convex hull: the patch, swept along its velocity. As any convex set it has a
separating direction from a ball or a box around the origin among few, wherever there is one: the normals of its faces,
which are cross products of the sides with each other and with the velocity; of a ball, the way to a corner or an edge,
which is the closest pair's at either end or, of an edge that a corner sweeps, what lies across the velocity; of a box,
the axes and their cross products with the edges. All of them are tried here, once, before the
rounds of a pair that keeps its start distance (`start_distance`). For sides that turn they are good guesses.

Such pairs have a slack of few roundings, so directions are to be accurate: of two edges that are nearly parallel, the
cross product is made orthogonal to the longer one again, and what lies across an edge is so twice. Nothing here carries
a guarantee but that of `inclusion`.
"""

import warp as wp

from ..parameters import norm, real
from . import simd
from .inclusion import clip_beyond
from .patch import Corners, corners_at, side_of
from .rounding import TINY
from .simd import Lanes, Vec3, bits_of, cross, dot, greatest, greatest_of, is_at_most, is_less, magnitude, minus, select

is_euclidean = norm.is_ball
if is_euclidean:
    from .ball import offset
    from .lane_closest import closest
else:
    from .facets import axis_of, offset

# Directions that are tried: three sides with the motion and one another; then four corners across the motion, and four
# across a side at either end, and the closest pair's at the end; or the axes, and these with the motion and the sides.
_COUNT = wp.constant(17 if is_euclidean else 19)
_NONE = wp.constant(wp.uint32(0))
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
tiny = wp.constant(real(TINY[real]))


@simd.func
def across(a: Vec3, edge: Vec3) -> Vec3:
    """The part of a vector that is orthogonal to an edge."""
    return a - (dot(a, edge) / (dot(edge, edge) + tiny)) * edge


@simd.func
def normal_of(a: Vec3, b: Vec3) -> Vec3:
    """The normal of two edges."""
    is_longer = is_less(dot(b, b), dot(a, a))
    return across(cross(a, b), select(is_longer, a, b))


if is_euclidean:

    @simd.func
    def across_edge(c: Corners, later: Corners, k: int) -> Vec3:
        """What lies across an edge of the hull: of the four that corners sweep, and of the sides at either end."""
        corner = k % 4
        at = later
        if k < 8:
            at = c
        # each corner with another side; a triangle has three
        w = at.w00
        edge = at.w01 - at.w00
        moved = later.w00 - c.w00
        if corner == 1:
            w = at.w01
            edge = at.w11 - at.w01
            moved = later.w01 - c.w01
        if corner == 2:
            w = at.w10
            edge = at.w10 - at.w00
            moved = later.w10 - c.w10
        if corner == 3:
            w = at.w11
            edge = at.w11 - at.w10
            moved = later.w11 - c.w11
        if k < 4:
            edge = moved
        return across(across(w, edge), edge)

    @simd.func
    def of_shape(c: Corners, later: Corners, k: int, is_face: bool) -> Vec3:
        """A direction in which the hull is nearest at an edge or a corner."""
        d = across_edge(c, later, k)
        if k == 12:
            d = closest(later, is_face).d
        return d

else:

    @simd.func
    def of_shape(c: Corners, later: Corners, k: int, is_face: bool) -> Vec3:
        """A direction in which an edge or a corner of the box is nearest: an axis, or one with an edge of the hull."""
        d = axis_of(k % 3)
        if k >= 3:
            edge = later.w00 - c.w00
            if k >= 6:
                edge = side_of(c, k / 3 - 2)
            d = cross(edge, d)
        return d


@simd.func
def clip_passing(
    t0: Corners, t1: Corners, error: Vec3, separation: Vec3, is_face: bool, lanes: wp.uint32, t: Lanes, end: Lanes
) -> Lanes:
    """Time up to which one of the directions separates the given lanes: at least t, 2 if until the end.

    t0 and t1 are the corners at both ends of the step, of which the part from t to ``end`` is left.
    """
    c = corners_at(t0, t1, t)
    later = corners_at(t0, t1, end)
    s = t
    for k in range(_COUNT):
        d = later.w00 - c.w00
        if k == 3:
            d = side_of(c, 1)
        if k < 4:
            d = normal_of(side_of(c, k % 3), d)
        else:
            d = of_shape(c, later, k - 4, is_face)
        d = (one / greatest_of(magnitude(d))) * d
        d = select(is_less(dot(d, c.w00), zero), minus(d), d)
        s = greatest(s, clip_beyond(d, offset(d, error, separation), t, t0, t1, is_face))
        if (bits_of(is_at_most(s, end)) & lanes) == _NONE:
            break
    return s
