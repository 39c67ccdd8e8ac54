"""Arcs: where the points of a pair are at a time of a slice, and how far from their chords between two times.

A body that turns by ω in a slice of the step moves its points on arcs,

    x(t) = p + v·t + σ1(t)·V + σ2(t)·ω×V,   σ1(t) = sin(θt)/θ,   σ2(t) = (1 − cos(θt))/θ²,   θ = |ω|,

with a part v of the velocity that stays and a part V, across ω, that turns with the body: ω×(x − c) of a body that
turns about a point c. Written from the ends a = x(0) and b = x(1), the straight part needs no name,

    x(t) = a + t·(b − a) + f1(t)·V + f2(t)·ω×V,   f_k(t) = σ_k(t) − t·σ_k(1),

and points that do not turn are those with V = 0. Both functions are power series in (θt)², without a division, so that
a turn of 0 is no special case and the answers of all devices are equal. Their terms stop where the next is below u/8
for a turn of `LARGEST_TURN`; a step with a larger turn is cut into slices.

Any point of an arc is off its chord between two times by at most the **sagitta** h²/8·|x''|, h the time between them,
and |x''| = |ω|·|V| at every time. So a pair whose points move on arcs is free as long as its points are on the chords,
with the sagitta added to what separates them. Along an axis k the amplitude of x'' is |V| times the length of ω across
that axis. What is proved for chords is proved for arcs, and as the sagitta falls with the square of h, shorter and
shorter chords come to a contact as Newton's iteration does (`windows`). The rounding is step 17 of `rounding`.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE
from ..parameters import norm, width
from ..template import specialised
from .points import Points
from .rounding import ARC_MOTION, ARC_POINTS, EIGHTH_UP, SQUARE_UNDERFLOW, UNIT_ROUNDOFF

simd = specialised("pair.simd", width=width)
is_euclidean = norm.is_ball
# Largest turn of a slice, in radians.
LARGEST_TURN = 1.0 / 3.0

zero = wp.constant(wp.float64(0.0))
half = wp.constant(wp.float64(0.5))
one = wp.constant(wp.float64(1.0))
sine_1 = wp.constant(wp.float64(-1.0 / 6.0))
sine_2 = wp.constant(wp.float64(1.0 / 120.0))
sine_3 = wp.constant(wp.float64(-1.0 / 5040.0))
sine_4 = wp.constant(wp.float64(1.0 / 362880.0))
sine_5 = wp.constant(wp.float64(-1.0 / 39916800.0))
sine_6 = wp.constant(wp.float64(1.0 / 6227020800.0))
cosine_1 = wp.constant(wp.float64(-1.0 / 24.0))
cosine_2 = wp.constant(wp.float64(1.0 / 720.0))
cosine_3 = wp.constant(wp.float64(-1.0 / 40320.0))
cosine_4 = wp.constant(wp.float64(1.0 / 3628800.0))
cosine_5 = wp.constant(wp.float64(-1.0 / 479001600.0))
cosine_6 = wp.constant(wp.float64(1.0 / 87178291200.0))
eighth_up = wp.constant(wp.float64(EIGHTH_UP))
square_underflow = wp.constant(wp.float64(SQUARE_UNDERFLOW[wp.float64]))
point_error = wp.constant(wp.float64(ARC_POINTS * UNIT_ROUNDOFF[wp.float64]))
motion_error = wp.constant(wp.float64(ARC_MOTION * UNIT_ROUNDOFF[wp.float64]))


@wp.struct
class Arcs:
    """How the points of a pair turn in a slice."""

    v0: simd.Vec3  # velocities of the points that turn with their bodies; of bodies that do not turn they are not used
    v1: simd.Vec3
    v2: simd.Vec3
    v3: simd.Vec3
    spin_a: simd.Vec3  # rotation vectors of the bodies of the first primitive and of the second
    spin_b: simd.Vec3
    slack: simd.Lanes  # by how much rounding may bring the two closer
    excess: simd.Lanes  # and how far both may be from their arcs besides
    t_begin: simd.Lanes  # the slice as part of the step
    t_length: simd.Lanes


@wp.struct
class Bend:
    """f1 and f2 of a body at one time."""

    f1: simd.Lanes
    f2: simd.Lanes


@simd.func
def sine_series(w: simd.Lanes) -> simd.Lanes:
    """sin(√w)/√w − 1."""
    return w * (sine_1 + w * (sine_2 + w * (sine_3 + w * (sine_4 + w * (sine_5 + w * sine_6)))))


@simd.func
def cosine_series(w: simd.Lanes) -> simd.Lanes:
    """(1 − cos √w)/w."""
    return half + w * (cosine_1 + w * (cosine_2 + w * (cosine_3 + w * (cosine_4 + w * (cosine_5 + w * cosine_6)))))


@simd.func
def bend(spin: simd.Vec3, t: simd.Lanes) -> Bend:
    """How far the points of a body are from their chords over the slice, as factors of V and ω×V."""
    z = simd.dot(spin, spin)
    w = z * t * t
    r = Bend()
    r.f1 = t * (sine_series(w) - sine_series(z))
    r.f2 = t * (t * cosine_series(w) - cosine_series(z))
    return r


@simd.func
def point_at(a: simd.Vec3, b: simd.Vec3, v: simd.Vec3, spin: simd.Vec3, bent: Bend, t: simd.Lanes) -> simd.Vec3:
    """A point at a time of the slice."""
    return a + (t * (b - a) + (bent.f1 * v + bent.f2 * simd.cross(spin, v)))


@simd.func
def points_at(kind: int, a: Points, b: Points, arcs: Arcs, t: simd.Lanes) -> Points:
    """The points of a pair at a time of the slice, from those at its ends."""
    of_a = bend(arcs.spin_a, t)
    of_b = bend(arcs.spin_b, t)
    r = Points()
    r.p0 = point_at(a.p0, b.p0, arcs.v0, arcs.spin_a, of_a, t)
    if kind == EDGE_EDGE:
        r.p1 = point_at(a.p1, b.p1, arcs.v1, arcs.spin_a, of_a, t)
    else:
        r.p1 = point_at(a.p1, b.p1, arcs.v1, arcs.spin_b, of_b, t)
    r.p2 = point_at(a.p2, b.p2, arcs.v2, arcs.spin_b, of_b, t)
    r.p3 = point_at(a.p3, b.p3, arcs.v3, arcs.spin_b, of_b, t)
    return r


@simd.func
def bend_rate(spin: simd.Vec3, t: simd.Lanes) -> Bend:
    """The derivatives of f1 and f2."""
    z = simd.dot(spin, spin)
    w = z * t * t
    r = Bend()
    r.f1 = simd.minus(w * cosine_series(w) + sine_series(z))
    r.f2 = t * (one + sine_series(w)) - cosine_series(z)
    return r


@simd.func
def velocity_at(a: simd.Vec3, b: simd.Vec3, v: simd.Vec3, spin: simd.Vec3, rate: Bend) -> simd.Vec3:
    """The velocity of a point, as a displacement in the whole slice."""
    return (b - a) + (rate.f1 * v + rate.f2 * simd.cross(spin, v))


@simd.func
def velocities_at(kind: int, a: Points, b: Points, arcs: Arcs, t: simd.Lanes) -> Points:
    """The velocities of the points of a pair at a time of the slice."""
    of_a = bend_rate(arcs.spin_a, t)
    of_b = bend_rate(arcs.spin_b, t)
    r = Points()
    r.p0 = velocity_at(a.p0, b.p0, arcs.v0, arcs.spin_a, of_a)
    if kind == EDGE_EDGE:
        r.p1 = velocity_at(a.p1, b.p1, arcs.v1, arcs.spin_a, of_a)
    else:
        r.p1 = velocity_at(a.p1, b.p1, arcs.v1, arcs.spin_b, of_b)
    r.p2 = velocity_at(a.p2, b.p2, arcs.v2, arcs.spin_b, of_b)
    r.p3 = velocity_at(a.p3, b.p3, arcs.v3, arcs.spin_b, of_b)
    return r


@simd.func
def squared(a: simd.Vec3) -> simd.Lanes:
    """|a|², and more than it loses by underflow."""
    return simd.dot(a, a) + square_underflow


@simd.func
def across_axes(spin: simd.Vec3) -> simd.Vec3:
    """The length of a rotation vector across each axis; in the Euclidean norm its length, three times."""
    x = spin.x * spin.x
    y = spin.y * spin.y
    z = spin.z * spin.z
    if wp.static(is_euclidean):
        length = simd.square_root(x + y + z)
        return simd.vec(length, length, length)
    return simd.vec(simd.square_root(y + z), simd.square_root(x + z), simd.square_root(x + y))


@simd.func
def turns_anywhere(arcs: Arcs) -> bool:
    """Whether a body of any pair turns."""
    spin = simd.greatest_of(simd.greatest(simd.magnitude(arcs.spin_a), simd.magnitude(arcs.spin_b)))
    return simd.bits_of(simd.is_less(zero, spin)) != wp.uint32(0)


@simd.func
def amplitude(kind: int, arcs: Arcs) -> simd.Vec3:
    """Upper bound of |x''| of the first primitive and of the second, together, along each axis."""
    r = simd.vec(simd.spread(zero), simd.spread(zero), simd.spread(zero))
    if not turns_anywhere(arcs):
        return r
    of_a = squared(arcs.v0)
    of_b = simd.greatest(squared(arcs.v2), squared(arcs.v3))
    if kind == EDGE_EDGE:
        of_a = simd.greatest(of_a, squared(arcs.v1))
    else:
        of_b = simd.greatest(of_b, squared(arcs.v1))
    return simd.square_root(of_a) * across_axes(arcs.spin_a) + simd.square_root(of_b) * across_axes(arcs.spin_b)


@simd.func
def sagitta(amplitude: simd.Vec3, h: simd.Lanes) -> simd.Vec3:
    """How far the points of a pair may be from chords over a time h of the slice, together, along each axis."""
    return (eighth_up * h * h) * amplitude


@simd.func
def largest_coordinate(p: Points) -> simd.Lanes:
    """Largest magnitude of a coordinate."""
    m = simd.greatest(simd.magnitude(p.p0), simd.magnitude(p.p1))
    m = simd.greatest(m, simd.greatest(simd.magnitude(p.p2), simd.magnitude(p.p3)))
    return simd.greatest_of(m)


@simd.func
def largest_difference(a: Points, b: Points) -> simd.Lanes:
    """Largest magnitude of a coordinate of a difference of points."""
    m = simd.greatest(simd.magnitude(b.p0 - a.p0), simd.magnitude(b.p1 - a.p1))
    m = simd.greatest(m, simd.greatest(simd.magnitude(b.p2 - a.p2), simd.magnitude(b.p3 - a.p3)))
    return simd.greatest_of(m)


@simd.func
def error_of(a: Points, b: Points, slack: simd.Lanes, amplitude: simd.Vec3) -> simd.Lanes:
    """By how much the rounding of all points may bring a pair closer, along any axis (rounding, step 17)."""
    size = simd.greatest(largest_coordinate(a), largest_coordinate(b))
    motion = largest_difference(a, b) + simd.greatest_of(amplitude)
    return slack + (point_error * size + motion_error * motion)
