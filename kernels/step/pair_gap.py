"""The gap of a pair at one time, in the norm of its distance, and the direction along which points change it.

In float64, in units in which the corners of the pair are at most 1. Nothing here carries a guarantee; where a gap has
no direction, it says so. By the envelope theorem a gap changes only as its points move along its direction: how the
closest points slide on the primitives does not count, to first order.

**Without a distance** the gap is that along the normal of the sides, with a sign: the direction opposes the motion.
**With a Euclidean distance** it is the length of the gap, and its direction that of the gap, orthogonal to the sides on
which the closest points lie. **In the maximum norm** it is the largest of n·W / |n|₁ over the corners W of the patch,
at the nearest of them, for the normals n of the facets that a patch and a box can have between them: an axis (a corner
of the patch meets a face of the box), a side of the patch times an axis (a side meets an edge), both sides (the patch
meets a corner). Every n is a lower bound, so one that rounding has bent does no harm. Where several decide alike, as in
scenes along the axes, or a facet lies along a side, the points are those of the first place at a corner of what meets:
what follows from it is a one-sided derivative, as on the border of a face.
"""

import warp as wp

from ..pair.closest_point import closest_weights
from ..pair.lane_scale import to_unit_size
from ..pair.patch import Corners, num_sides, side_of
from ..pair.rounding import UNIT_ROUNDOFF
from ..pair_kind import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE, VERTEX_PLANE
from .contact_normal import across_sides, is_inner

vec3d = wp.vec3d

_PARALLEL = wp.constant(wp.float64(1.0e-12))  # sine below which two sides have no normal
_SUM = wp.constant(wp.float64(1.0 - 4.0 * UNIT_ROUNDOFF[wp.float64]))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
# What a gap is measured against.
TOUCH = wp.constant(0)  # no distance
BALL = wp.constant(1)
BOX = wp.constant(2)
_NUM_NORMALS = 13  # of a patch and a box
_NUM_CHOICES = 8


@wp.struct
class PairGap:
    """A gap, and its first-order change."""

    is_known: bool
    size: wp.float64
    along: vec3d  # the gap grows by along·dx where the difference of the closest points grows by dx
    at: wp.vec2d  # the place of the closest point on the patch: along w00 to w01, and along w00 to w10


@wp.func
def patch_point(c: Corners, at: wp.vec2d, is_face: bool) -> vec3d:
    """A point of a patch, or the velocity of one from those of the corners."""
    if is_face:
        return c.w00 + at[0] * (c.w01 - c.w00) + at[1] * (c.w10 - c.w00)
    near = (_ONE - at[0]) * c.w00 + at[0] * c.w01
    far = (_ONE - at[0]) * c.w10 + at[0] * c.w11
    return (_ONE - at[1]) * near + at[1] * far


@wp.func
def closest_to(c: Corners, x: vec3d, is_face: bool) -> wp.vec2d:
    """The place of the point of a patch that is closest to x."""
    b, a, from_w11 = closest_weights(c.w00 - x, c.w01 - x, c.w10 - x, c.w11 - x, is_face)
    if from_w11:
        return wp.vec2d(_ONE - a, _ONE - b)
    return wp.vec2d(b, a)


@wp.func
def touch_gap(kind: int, c: Corners, velocity: Corners, is_planar: bool) -> PairGap:
    """The gap along the normal of both sides, or across a segment in the plane."""
    g = PairGap()
    is_face = kind == VERTEX_FACE
    a = to_unit_size(c.q)
    b = to_unit_size(c.r)
    n = vec3d()
    if kind == VERTEX_FACE or kind == EDGE_EDGE:
        n = wp.cross(a, b)
        g.is_known = wp.length(n) > _PARALLEL * wp.length(a) * wp.length(b)
    elif kind == POINT_SEGMENT and is_planar:
        n = vec3d(-a[1], a[0], _ZERO)
        g.is_known = wp.length(n) > _ZERO
    g.at = closest_to(c, vec3d(), is_face)
    g.along = wp.normalize(n)
    if wp.dot(g.along, patch_point(velocity, g.at, is_face)) > _ZERO:
        g.along = -g.along
    g.size = wp.dot(g.along, patch_point(c, g.at, is_face))
    return g


@wp.func
def ball_gap(kind: int, c: Corners, noise: wp.float64) -> PairGap:
    """The Euclidean gap; none where it may be rounding."""
    g = PairGap()
    is_face = kind == VERTEX_FACE
    g.at = closest_to(c, vec3d(), is_face)
    gap = patch_point(c, g.at, is_face)
    if wp.length(gap) > noise:
        q = c.q
        r = c.r
        if is_face and g.at[0] + g.at[1] >= _SUM:
            q = q - r
            r = vec3d()
        if not is_inner(g.at[0]):
            q = vec3d()
        if not is_inner(g.at[1]):
            r = vec3d()
        g.is_known = True
        g.along = wp.normalize(across_sides(gap, q, r))
        g.size = wp.dot(g.along, gap)
    return g


@wp.func
def box_normal(c: Corners, k: int, is_face: bool) -> vec3d:
    """The normal with number k, with Σ|n_k| = 1 and the patch on its positive side; 0 where there is none.

    First the one of both sides, then sides times axes, then axes.
    """
    n = vec3d()
    if k == 0:
        a = to_unit_size(c.q)
        b = to_unit_size(c.r)
        n = wp.cross(a, b)
        if wp.length(n) <= _PARALLEL * wp.length(a) * wp.length(b):
            n = vec3d()
    elif k < 10:
        side = (k - 1) / 3
        axis = vec3d()
        axis[(k - 1) % 3] = _ONE
        if side < num_sides(is_face):
            n = wp.cross(to_unit_size(side_of(c, side)), axis)
    else:
        n[k - 10] = _ONE
    total = wp.abs(n[0]) + wp.abs(n[1]) + wp.abs(n[2])
    if total > _ZERO:
        n = n / total
        if wp.dot(n, c.w00 + c.w01 + c.w10 + c.w11) < _ZERO:
            n = -n
    return n


@wp.func
def least_along(n: vec3d, c: Corners) -> wp.float64:
    """The least product with a corner."""
    return wp.min(wp.min(wp.dot(n, c.w00), wp.dot(n, c.w01)), wp.min(wp.dot(n, c.w10), wp.dot(n, c.w11)))


@wp.struct
class PatchPlace:
    """A place on a patch, and whether it is where a facet meets it."""

    is_met: bool
    at: wp.vec2d


@wp.func
def corner_of_square(k: int) -> wp.vec2d:
    """One of four places."""
    return wp.vec2d(wp.float64(k & 1), wp.float64((k >> 1) & 1))


@wp.func
def box_place(
    c: Corners, k: int, choice: int, n: vec3d, size: wp.float64, noise: wp.float64, is_face: bool
) -> PatchPlace:
    """Where a patch meets the facet of a box of this half side whose normal has number k.

    Where the facet lies along an axis, or several corners or sides are as near, there are eight choices, a bit each for
    the sign on an axis, or for the corner or side.
    """
    place = PatchPlace()
    x = vec3d()
    for j in range(3):
        x[j] = size * wp.sign(n[j])
        if wp.abs(n[j]) <= noise:
            x[j] = size * (_ONE - wp.float64(2 * ((choice >> j) & 1)))
    if k >= 10:
        place.at = corner_of_square(choice)
        place.is_met = not (is_face and choice % 4 == 3)
        return place
    if k == 0:
        place.at = closest_to(c, x, is_face)
        place.is_met = wp.max(wp.abs(patch_point(c, place.at, is_face) - x)) <= noise
        return place
    # a side meets an edge of the box along an axis: of two sides that are parallel the bit of that axis chooses one
    side = (k - 1) / 3
    axis = (k - 1) % 3
    begin = wp.vec2d()
    step = wp.vec2d(_ONE, _ZERO)
    if side == 1:
        step = wp.vec2d(_ZERO, _ONE)
    if side == 2:
        begin = wp.vec2d(_ONE, _ZERO)
        step = wp.vec2d(-_ONE, _ONE)
    elif not is_face and ((choice >> axis) & 1) == 1:
        begin = wp.vec2d(step[1], step[0])
    a = patch_point(c, begin, is_face)
    s = patch_point(c, begin + step, is_face) - a
    x = x - a
    s[axis] = _ZERO
    x[axis] = _ZERO
    share = _ZERO
    if wp.dot(s, s) > _ZERO:
        share = wp.clamp(wp.dot(x, s) / wp.dot(s, s), _ZERO, _ONE)
    place.at = begin + share * step
    place.is_met = wp.max(wp.abs(share * s - x)) <= noise
    return place


@wp.func
def box_gap(kind: int, c: Corners, noise: wp.float64) -> PairGap:
    """The gap in the maximum norm; none where no facet decides with points that are within it."""
    g = PairGap()
    is_face = kind == VERTEX_FACE
    g.size = -_ONE
    count = int(_NUM_NORMALS)  # variables, so that the loops stay loops
    choices = int(_NUM_CHOICES)
    for k in range(count):
        n = box_normal(c, k, is_face)
        if wp.dot(n, n) > _ZERO:
            g.size = wp.max(g.size, least_along(n, c))
    for k in range(count):
        n = box_normal(c, k, is_face)
        if not g.is_known and wp.dot(n, n) > _ZERO and least_along(n, c) >= g.size - wp.float64(0.25) * noise:
            for choice in range(choices):
                if not g.is_known:
                    place = box_place(c, k, choice, n, g.size, noise, is_face)
                    if place.is_met and wp.max(wp.abs(patch_point(c, place.at, is_face))) <= g.size + noise:
                        g.is_known = True
                        g.along = n
                        g.at = place.at
    return g


@wp.func
def gap_of(
    kind: int, norm: int, c: Corners, velocity: Corners, plane: vec3d, noise: wp.float64, planar: bool
) -> PairGap:
    """The gap of a pair with these corners and sides at one time; of a vertex and a plane along the plane's normal."""
    if kind == VERTEX_PLANE:
        g = PairGap()
        g.is_known = True
        g.along = plane
        if norm == BOX:
            g.along = plane / (wp.abs(plane[0]) + wp.abs(plane[1]) + wp.abs(plane[2]))
        g.size = wp.dot(g.along, c.w00)
        return g
    if norm == TOUCH:
        return touch_gap(kind, c, velocity, planar)
    if norm == BALL:
        return ball_gap(kind, c, noise)
    return box_gap(kind, c, noise)
