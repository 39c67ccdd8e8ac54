"""The normal of a contact and its closest points at toi: the direction from the second of them to the first.

All of it in float64, from the positions of the vertices, whatever the precision of the iteration. Nothing here carries
a guarantee.

**When a direction is more than rounding.** Let M be the vector of the largest |corner| on each axis, of the patch at
both ends of the step, and u = 2^-53. A corner at toi is a difference (u) interpolated between the ends (3u more, step 8
of `rounding`), so it is off by at most 4.1 u·M_k. The computed gap is a convex combination of three corners; its
differences, products and sums add 10 u·M_k. So it is the gap of two true points to within 15 u·|M|. A gap longer than
NOISE = 32 u·|M| is therefore certain to be one, with a direction less than 30 degrees from theirs; a shorter one counts
as none. Measured, against rational arithmetic, the sine of the angle to the direction of the exact gap is at most
1.2 u·|M| / gap for every family of hard cases. On arcs the points themselves are rounded, and may bring two primitives
closer by less than 2.75 times their slack on each axis (steps 17 and 18): a gap is certain where its square is above
those of 32 u·|M| and of ARC_NOISE = 30 slacks together.

The gap is orthogonal to every side within which a closest point lies. Removing the rest of it along these sides, or
taking their cross product, makes the direction as accurate as the sides are, however small the gap is beside them.

Without a gap the normal is that of the sides, against the relative velocity; where they give none it is against the
velocity itself.
"""

import warp as wp

from ..pair.answer import parameters as parameters_of
from ..pair.closest_point import closest_weights
from ..pair.lane_scale import to_unit_size
from ..pair.rounding import UNIT_ROUNDOFF
from ..pair.single_points import Points
from ..pair_kind import EDGE_EDGE, VERTEX_FACE
from .contact_sides import PARALLEL, Sides, gap_at, normal_of_sides, position, sides_at

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
# Weights whose sum is off from 1 by their rounding only.
_SUM = wp.constant(wp.float64(1.0 - 4.0 * UNIT_ROUNDOFF[wp.float64]))

vec3d = wp.vec3d


@wp.struct
class ContactGap:
    """The gap of a pair at one time."""

    is_gap: bool  # whether it is more than rounding
    direction: vec3d  # unit vector from the second primitive to the first
    parameters: wp.vec2d  # of the closest points; without a gap those that were given


@wp.func
def across(w: vec3d, side: vec3d) -> vec3d:
    """The part of w orthogonal to a side, 0 if it consists of rounding only; all of w if the side has no length."""
    s = to_unit_size(side)
    n = to_unit_size(w)
    if wp.dot(s, s) > _ZERO:
        n = n - (wp.dot(n, s) / wp.dot(s, s)) * s
        if wp.length(n) <= PARALLEL:
            n = vec3d(_ZERO, _ZERO, _ZERO)
    return n


@wp.func
def is_inner(w: wp.float64) -> bool:
    """Whether a weight is at neither end of its range."""
    return w > _ZERO and w < _ONE


@wp.func
def across_sides(gap: vec3d, q: vec3d, r: vec3d) -> vec3d:
    """A vector along the part of a gap orthogonal to both sides, of which either may be 0."""
    a = to_unit_size(q)
    b = to_unit_size(r)
    n = wp.cross(a, b)
    if wp.length(n) > PARALLEL * wp.length(a) * wp.length(b):
        if wp.dot(n, gap) < _ZERO:
            n = -n
        return n
    longer = q
    if wp.max(wp.abs(r)) > wp.max(wp.abs(q)):
        longer = r
    return across(gap, longer)


@wp.func
def contact_gap(
    kind: int, points_t0: Points, points_t1: Points, t: wp.float64, uv: wp.vec2d, slack: wp.float64
) -> ContactGap:
    """The gap of a pair at time t; (u, v) are points that the narrow phase has found, mostly the closest already.

    The slack is by how much rounding of the points themselves may bring the two closer, on each axis.
    Most contacts without a separation leave no gap beyond rounding: if even these points do not, that is all.
    """
    contact = ContactGap()
    contact.parameters = uv
    at_toi = gap_at(kind, points_t0, points_t1, t, uv[0], uv[1], slack)
    noise = at_toi.noise
    if not wp.dot(at_toi.gap, at_toi.gap) > noise:
        return contact
    c = at_toi.corners
    wb, wc, from_w11 = closest_weights(c.w00, c.w01, c.w10, c.w11, kind == VERTEX_FACE)
    origin = c.w00
    along_q = wb
    along_r = wc
    if from_w11:  # w01 and w10 are its neighbours along r and along q
        origin = c.w11
        along_q = wc
        along_r = wb
    gap = origin + wb * (c.w01 - origin) + wc * (c.w10 - origin)
    if wp.dot(gap, gap) > noise:
        q = c.q
        r = c.r
        if kind == VERTEX_FACE and wb + wc >= _SUM:
            q = q - r
            r = vec3d(_ZERO, _ZERO, _ZERO)
        if not is_inner(along_q):
            q = vec3d(_ZERO, _ZERO, _ZERO)
        if not is_inner(along_r):
            r = vec3d(_ZERO, _ZERO, _ZERO)
        contact.is_gap = True
        contact.direction = wp.normalize(across_sides(gap, q, r))
        contact.parameters = parameters_of(kind, _ZERO, _ONE, _ZERO, _ONE, wb, wc, from_w11)
    return contact


@wp.func
def against(velocity: vec3d, side: vec3d) -> vec3d:
    """A vector against the part of a velocity across a side; against all of it where it has none; 0 where it is 0."""
    n = across(velocity, side)
    if wp.dot(n, n) == _ZERO:
        n = to_unit_size(velocity)
    return -n


@wp.func
def contact_normal(sides: Sides) -> vec3d:
    """Unit normal of two sides, directed against the relative velocity of the first primitive; 0 if there is none.

    Parallel or vanishing sides do not determine a normal: then the part of the velocity across the longer side is used,
    or the velocity itself, where it is along that side.
    """
    n, is_regular = normal_of_sides(sides)
    if not is_regular:
        longer = sides.q
        if wp.max(wp.abs(sides.r)) > wp.max(wp.abs(sides.q)):
            longer = sides.r
        w = to_unit_size(sides.velocity)
        n = wp.normalize(against(w, to_unit_size(longer)))
        if wp.dot(n, w) > _ZERO:
            n = -n
    return n


@wp.func
def point_normal(side: vec3d, velocity: vec3d, gap: vec3d) -> vec3d:
    """Unit normal of a point at a segment, or at a point if the side is 0, directed against the relative velocity.

    If the velocity has no part across the side, the normal is along what is left of the gap, and without a gap against
    the velocity itself. It is 0 if all of them vanish.
    """
    n = -across(velocity, side)
    if wp.dot(n, n) == _ZERO:
        n = across(gap, side)
    if wp.dot(n, n) == _ZERO:
        n = against(velocity, side)
    return wp.normalize(n)


@wp.func
def normal_without_gap(kind: int, x0: Points, x1: Points, t: wp.float64, uv: wp.vec2d) -> vec3d:
    """Unit normal of a contact without a gap, from the points of the pair at both ends of the step."""
    sides = sides_at(kind, x0, x1, t, uv[0], uv[1])
    if kind == VERTEX_FACE or kind == EDGE_EDGE:
        return contact_normal(sides)
    # missing points repeat the last one, so q is the segment, or 0 for a point
    gap = position(x0.p0, x1.p0, t) - position(x0.p1, x1.p1, t) - uv[0] * sides.q
    return point_normal(sides.q, sides.velocity, gap)


@wp.func
def contact_at(
    kind: int, points_t0: Points, points_t1: Points, t: wp.float64, uv: wp.vec2d, slack: wp.float64
) -> ContactGap:
    """Normal and closest points of a contact of two primitives, given by their points at both ends of a motion.

    Where there is no gap beyond rounding, the parameters are those that the narrow phase has found. Zeros are positive.
    """
    contact = contact_gap(kind, points_t0, points_t1, t, uv, slack)
    if not contact.is_gap:
        contact.direction = normal_without_gap(kind, points_t0, points_t1, t, uv)
    contact.direction = contact.direction + vec3d(_ZERO, _ZERO, _ZERO)  # -0 + 0 is 0
    return contact
