"""A window in the frame of a body: of a pair whose bodies share most of their turn, hardly anything moves there.

Two bodies that turn together stay as they are to each other, but on chords of the world they would have to come closer
by their sagittas. So where both spins are alike, the window is that of an observer who turns with the second body by ω
and stays beside one of its points, q. The points of that body are at rest, and a point x of the first is at

    y(t) = q(t₀) + Rot(−(t − t₀)ω)·z(t),   z = x − q.

With the parts V of the velocities that turn, the straight parts v, u = ω' − ω for the spin ω' of the first body, and
Δv = v' − v, its acceleration there has the length of

    y'' = u×V' − ω×e − 2ω×Δv,   e = V' − V − ω×z,   e' = u×V' − ω×Δv,

which vanishes for a common screw. So over a time h |y''| ≤ |u||V'| + |ω|(|e| + h·w) + 2|ω||Δv|, with e at the begin of
the window and w = |u||V'| + |ω||Δv|. A turn changes no Euclidean distance, so the answer of the window is that of the
world for balls, and in the maximum norm where the distance is 0.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE
from ..parameters import norm, width
from ..template import specialised
from .arcs import Arcs, cosine_series, eighth_up, one, sine_series, squared
from .points import Points
from .rounding import FRAME, UNIT_ROUNDOFF

simd = specialised("pair.simd", width=width)
Lanes = simd.Lanes
Vec3 = simd.Vec3

zero = wp.constant(wp.float64(0.0))
two = wp.constant(wp.float64(2.0))
quarter = wp.constant(wp.float64(0.25))
corotating_error = wp.constant(wp.float64(FRAME * UNIT_ROUNDOFF[wp.float64]))
# How much longer a vector may be, in the maximum norm, that is turned by at most a slice.
longest_turned = wp.constant(wp.float64(1.75))


@wp.struct
class CorotatingWindow:
    """A window in the frame of the second body."""

    at_end: Points
    sagitta: Lanes
    error: Lanes  # beyond that of two points on arcs (rounding, step 17)


@wp.struct
class Flow:
    """How a point moves at a time."""

    turning: Vec3  # the part of its velocity that turns
    straight: Vec3


@simd.func
def are_alike(arcs: Arcs) -> simd.Mask:
    """Whether the bodies of a pair share most of their turn."""
    u = arcs.spin_a - arcs.spin_b
    return simd.is_less(simd.dot(u, u), quarter * simd.dot(arcs.spin_b, arcs.spin_b))


@simd.func
def may_turn(minimum_separation: Lanes) -> simd.Mask:
    """Whether a separation is the same in a frame that turns."""
    if wp.static(norm.is_ball):
        return simd.is_at_most(minimum_separation, minimum_separation)
    return simd.is_at_most(minimum_separation, zero)


@simd.func
def turned(x: Vec3, spin: Vec3, t: Lanes) -> Vec3:
    """Rot(t·spin)·x."""
    w = simd.dot(spin, spin) * t * t
    across = simd.cross(spin, x)
    return x + (t * (one + sine_series(w)) * across + (t * t * cosine_series(w)) * simd.cross(spin, across))


@simd.func
def flow_of(a: Vec3, b: Vec3, v: Vec3, spin: Vec3, t: Lanes) -> Flow:
    """How a point moves at a time of the slice, between whose ends it goes from a to b."""
    z = simd.dot(spin, spin)
    r = Flow()
    r.straight = (b - a) - ((one + sine_series(z)) * v + cosine_series(z) * simd.cross(spin, v))
    r.turning = turned(v, spin, t)
    return r


@simd.func
def length(a: Vec3) -> Lanes:
    """|a|, not less."""
    return simd.square_root(squared(a))


@simd.func
def acceleration(of_x: Flow, of_q: Flow, z: Vec3, arcs: Arcs, h: Lanes) -> Lanes:
    """Upper bound of |y''| over a window, but for its rounding."""
    u = length(arcs.spin_a - arcs.spin_b)
    omega = length(arcs.spin_b)
    e = length(of_x.turning - of_q.turning - simd.cross(arcs.spin_b, z))
    apart = length(of_x.straight - of_q.straight)
    of_u = u * length(of_x.turning)
    return of_u + omega * (e + h * (of_u + omega * apart)) + two * omega * apart


@simd.func
def corotating_point(q: Vec3, z: Vec3, spin: Vec3, h: Lanes) -> Vec3:
    """y at the end of a window."""
    return q + turned(z, simd.minus(spin), h)


@simd.func
def corotating_window(
    kind: int, a: Points, b: Points, arcs: Arcs, at_begin: Points, at_end: Points, begin: Lanes, h: Lanes
) -> CorotatingWindow:
    """A window in the frame of the second body, from the points at its ends in the world."""
    r = CorotatingWindow()
    r.at_end = at_begin
    q = at_begin.p1
    q_end = at_end.p1
    of_q = Flow()
    if kind == EDGE_EDGE:
        q = at_begin.p2
        q_end = at_end.p2
        of_q = flow_of(a.p2, b.p2, arcs.v2, arcs.spin_b, begin)
    else:
        of_q = flow_of(a.p1, b.p1, arcs.v1, arcs.spin_b, begin)
    of_x = flow_of(a.p0, b.p0, arcs.v0, arcs.spin_a, begin)
    z = at_begin.p0 - q
    z_end = at_end.p0 - q_end
    r.at_end.p0 = corotating_point(q, z_end, arcs.spin_b, h)
    most = acceleration(of_x, of_q, z, arcs, h)
    size = simd.greatest(squared(z), squared(z_end))
    if kind == EDGE_EDGE:
        of_x = flow_of(a.p1, b.p1, arcs.v1, arcs.spin_a, begin)
        z = at_begin.p1 - q
        z_end = at_end.p1 - q_end
        r.at_end.p1 = corotating_point(q, z_end, arcs.spin_b, h)
        most = simd.greatest(most, acceleration(of_x, of_q, z, arcs, h))
        size = simd.greatest(size, simd.greatest(squared(z), squared(z_end)))
    r.sagitta = eighth_up * h * h * most
    r.error = corotating_error * simd.square_root(size) + two * arcs.slack
    return r


@simd.func
def selected(m: simd.Mask, a: Points, b: Points) -> Points:
    """The first points where the mask is set, the second elsewhere."""
    r = Points()
    r.p0 = simd.select(m, a.p0, b.p0)
    r.p1 = simd.select(m, a.p1, b.p1)
    r.p2 = simd.select(m, a.p2, b.p2)
    r.p3 = simd.select(m, a.p3, b.p3)
    return r
