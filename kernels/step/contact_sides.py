"""What the normal of a contact is made of, for one pair or for one in each lane: the gap, the sides and the velocity.

All of it is at toi, in float64. `contact_normal` makes the normal of any contact of it. In lanes there are the normals
of contacts without a gap whose sides have one: most of those that ask for no distance.
"""

import warp as wp

from ..pair.lane_scale import inverse_power_of_two, to_unit_size
from ..pair.patch import corners_at
from ..pair.points import Points, corners, largest
from ..pair.rounding import UNIT_ROUNDOFF
from ..pair_kind import EDGE_EDGE
from ..parameters import width
from ..template import specialised

# Roundings of the largest corners up to which a gap counts as zero.
NOISE = 32.0
# Slacks of two primitives on arcs up to which a gap counts as zero, beside its own rounding.
ARC_NOISE = 30.0
# Sine below which two sides count as parallel, so that their cross product is not used as a direction.
PARALLEL = wp.constant(wp.float64(1.0e-12))

zero = wp.constant(wp.float64(0.0))
one = wp.constant(wp.float64(1.0))
least_square = wp.constant(wp.float64((NOISE * UNIT_ROUNDOFF[wp.float64]) ** 2))
least_square_of_arcs = wp.constant(wp.float64(ARC_NOISE**2))

simd = specialised("pair.simd", width=width)
Corners = specialised("pair.patch", width=width).Corners
foot_weights = specialised("pair.foot", width=width).foot_weights


@simd.func
def position(p_t0: simd.Vec3, p_t1: simd.Vec3, t: simd.Lanes) -> simd.Vec3:
    """Position of a point at time t."""
    return (one - t) * p_t0 + t * p_t1


@wp.struct
class GapAt:
    """The gap of two points of a pair at one time, in units in which the corners of the step are at most 1."""

    gap: simd.Vec3
    noise: simd.Lanes  # its square counts as rounding up to here
    corners: Corners  # with sides from their own points, as lengths: beside the corners they may be small


@simd.func
def gap_at(kind: int, x0: Points, x1: Points, t: simd.Lanes, u: simd.Lanes, v: simd.Lanes, slack: simd.Lanes) -> GapAt:
    """The gap of the points (u, v) at time t; the slack is that of the points themselves on each axis."""
    c0 = corners(kind, x0)
    c1 = corners(kind, x1)
    size = simd.greatest(largest(c0), largest(c1))
    unit = inverse_power_of_two(simd.greatest_of(size))
    size = unit * size
    r = GapAt()
    r.noise = least_square * simd.dot(size, size) + least_square_of_arcs * (unit * slack) * (unit * slack)
    c = corners_at(c0, c1, t)
    c.w00 = unit * c.w00
    c.w01 = unit * c.w01
    c.w10 = unit * c.w10
    c.w11 = unit * c.w11
    along_q = u
    along_r = v
    if kind == EDGE_EDGE:
        along_q = v
        along_r = u
    r.gap = c.w00 + along_q * (c.w01 - c.w00) + along_r * (c.w10 - c.w00)
    c.q = position(c0.q, c1.q, t)
    c.r = position(c0.r, c1.r, t)
    r.corners = c
    return r


@simd.func
def foot_gap(c: Corners, is_face: bool):
    """The gap at the foot of the perpendicular, as `closest_weights` finds it, and whether that lies in the patch."""
    none = simd.spread(zero)
    whole = simd.spread(one)
    v, u, is_inside = foot_weights(c.w00, c.w01 - c.w00, c.w10 - c.w00)
    is_inside = is_inside & simd.is_at_most(none, u) & simd.is_at_most(none, v)
    origin = c.w00
    if is_face:
        is_inside = is_inside & simd.is_at_most(u + v - whole, none)
    else:
        is_inside = is_inside & simd.is_at_most(u, whole) & simd.is_at_most(v - whole, none)
        from_w11 = simd.is_less(whole, u + v)
        origin = simd.select(from_w11, c.w11, c.w00)
        v, u = simd.select(from_w11, whole - u, v), simd.select(from_w11, whole - v, u)
    return origin + v * (c.w01 - origin) + u * (c.w10 - origin), is_inside


@wp.struct
class Sides:
    """Two sides of a pair at one time, and how its points in contact move to each other over the step."""

    q: simd.Vec3
    r: simd.Vec3
    velocity: simd.Vec3


@simd.func
def sides_at(kind: int, x0: Points, x1: Points, t: simd.Lanes, u: simd.Lanes, v: simd.Lanes) -> Sides:
    """The edges of two edges; else two sides of a face, of which a segment has the first and a point none."""
    s = Sides()
    p1 = position(x0.p1, x1.p1, t)
    if kind == EDGE_EDGE:
        s.q = p1 - position(x0.p0, x1.p0, t)
        s.r = position(x0.p3, x1.p3, t) - position(x0.p2, x1.p2, t)
        first = (one - u) * (x1.p0 - x0.p0) + u * (x1.p1 - x0.p1)
        s.velocity = first - ((one - v) * (x1.p2 - x0.p2) + v * (x1.p3 - x0.p3))
    else:
        s.q = position(x0.p2, x1.p2, t) - p1
        s.r = position(x0.p3, x1.p3, t) - p1
        second = (one - u - v) * (x1.p1 - x0.p1) + u * (x1.p2 - x0.p2) + v * (x1.p3 - x0.p3)
        s.velocity = x1.p0 - x0.p0 - second
    return s


@simd.func
def normal_of_sides(s: Sides):
    """The unit normal of two sides that is against the velocity, and whether they determine one."""
    a = to_unit_size(s.q)
    b = to_unit_size(s.r)
    n = simd.cross(a, b)
    length = simd.square_root(simd.dot(n, n))
    limit = PARALLEL * simd.square_root(simd.dot(a, a)) * simd.square_root(simd.dot(b, b))
    n = simd.vec(n.x / length, n.y / length, n.z / length)
    n = simd.select(simd.is_less(zero, simd.dot(n, to_unit_size(s.velocity))), simd.minus(n), n)
    return n, simd.is_less(limit, length)
