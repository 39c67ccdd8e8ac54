"""The distance of a pair at one time: its closest points, and a lower bound of their distance that is proved.

The closest point of a patch to the origin is the foot of the perpendicular, where that lies inside the patch, or the
closest point of one of its edges, ends included. All of these are computed, and the nearest one is taken; so a sliver,
parallel edges or a face without area need no case of their own. The longer side and the part of the shorter one across
it (Gram-Schmidt, twice) carry the foot, and its difference vector is made orthogonal to its feature a second time after
the cancellation. A computed point is therefore a point of the patch to within a few roundings of the size of the pair,
and no point is nearer by more than that: so accurate is the distance.

The decision does not rest on it. As everywhere, any direction is a proof: along the difference vector, whatever it is
worth, all corners lie beyond the bound that is reported (rounding, step 15). Near its minimum the distance changes by
the square of what the direction changes by, so where rounding hides which feature is the nearest, the distance is right
and the direction may not be: then it is turned until no corner lies below the closest point.

It is written over lanes (`simd`), a pair in each; what few pairs need is done where a lane needs it.
"""

import warp as wp

from ..pair import simd
from ..pair.lane_scale import inverse_power_of_two, to_unit_size
from ..pair.points import Points, corners, largest, scaled, total
from ..pair.rounding import LARGEST, PROJECTION_ROOT, RELATIVE, TINY, UNIT_ROUNDOFF
from ..pair.simd import (
    Lanes,
    Mask,
    Vec3,
    bits_of,
    dot,
    greatest,
    greatest_of,
    is_at_most,
    is_less,
    least,
    magnitude,
    minus,
    opposite,
    select,
    spread,
    square_root,
    vec,
)
from ..pair_kind import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE
from ..parameters import real

zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
projection = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
tiny = wp.constant(real(TINY[real]))
overflowing = wp.constant(real(LARGEST))
shrunk = wp.constant(real(2.0**-10))
restored_by = wp.constant(real(2.0**10))
# In scaled units, beside which a corner counts as lower than the closest point.
turn = wp.constant(real(-UNIT_ROUNDOFF[real]))
largest_finite = wp.constant(real(1.7976931348623157e308))
not_a_number = wp.constant(real(float("nan")))
# More than a number can lose where it becomes subnormal.
UNDERFLOW = wp.constant(real(2.0**-1070))

# The vertices of a pair that span its closest features, as bits: those of v, f0, f1, f2, or ea0, ea1, eb0, eb1; of a
# point and a segment, or another point, the first and the last two, or the third. Lanes hold them as numbers.
first = wp.constant(real(1.0))
second = wp.constant(real(2.0))
third = wp.constant(real(4.0))
fourth = wp.constant(real(8.0))
first_and_third = wp.constant(real(5.0))
all_four = wp.constant(real(15.0))
_NONE = wp.constant(wp.uint32(0))


@wp.struct
class PairDistance:
    """What is known of the distance of a pair."""

    distance: Lanes  # of the two points, a length
    least: Lanes  # a lower bound of the distance, NaN where a coordinate is not finite
    direction: Vec3  # unit, from the second primitive to the first; 0 where they have a common point
    u: Lanes  # parameters of the closest points
    v: Lanes
    features: Lanes


@wp.struct
class Closest:
    """A point of a patch, in scaled units."""

    d: Vec3
    squared: Lanes
    u: Lanes
    v: Lanes
    features: Lanes


@wp.struct
class Side:
    """A side, and its square with the reciprocal of that, which is infinite where the square underflows."""

    vector: Vec3
    squared: Lanes
    inverse: Lanes


@wp.struct
class OnSide:
    """The closest point of a side, with the weights of its ends; of an end the other weight is exactly 0."""

    d: Vec3
    squared: Lanes
    of_a: Lanes
    of_b: Lanes


@wp.struct
class Foot:
    """The foot of the perpendicular on the plane w + x·q + y·r."""

    d: Vec3
    squared: Lanes
    x: Lanes
    y: Lanes


@simd.func
def side_of(vector: Vec3) -> Side:
    """A side and what others need of it."""
    r = Side()
    r.vector = vector
    r.squared = dot(vector, vector)
    r.inverse = one / r.squared
    return r


@simd.func
def on_side(a: Vec3, b: Vec3, side: Side) -> OnSide:
    """Closest point to the origin of the segment from a to b = a + side, reckoned from its nearer end."""
    is_from_b = is_less(dot(b, b), dot(a, a))
    near = select(is_from_b, b, a)
    far = select(is_from_b, a, b)
    e = select(is_from_b, minus(side.vector), side.vector)
    # 0 or 1 where the reciprocal is infinite, 0 if the product with it is NaN
    t = least(greatest(minus(dot(near, e)) * side.inverse, zero), one)
    d = near + t * e
    d = d - (dot(d, e) * side.inverse) * e
    r = OnSide()
    # the far end only if rounding hides which end is nearer
    r.d = select(is_less(zero, t), select(is_less(t, one), d, far), near)
    rest = one - t
    r.of_a = select(is_from_b, t, rest)
    r.of_b = select(is_from_b, rest, t)
    r.squared = dot(r.d, r.d)
    return r


@simd.func
def foot(w: Vec3, q: Side, r: Side) -> Foot:
    """The foot of the perpendicular; where the sides are parallel its weights are infinite or NaN, so not inside."""
    is_swapped = is_less(q.squared, r.squared)
    longer = select(is_swapped, r.vector, q.vector)
    shorter = select(is_swapped, q.vector, r.vector)
    inverse = select(is_swapped, r.inverse, q.inverse)
    lean = dot(shorter, longer) * inverse
    across = shorter - lean * longer
    width = side_of(across - (dot(across, longer) * inverse) * longer)
    across = width.vector
    along = minus(dot(w, longer)) * inverse
    d = w + along * longer
    y = minus(dot(d, across)) * width.inverse
    d = d + y * across
    d = d - (dot(d, longer) * inverse) * longer
    x = along - lean * y
    f = Foot()
    f.d = d - (dot(d, across) * width.inverse) * across
    f.squared = dot(f.d, f.d)
    f.x = select(is_swapped, y, x)
    f.y = select(is_swapped, x, y)
    return f


@simd.func
def is_inside(x: Lanes) -> Mask:
    """Whether a weight is strictly between 0 and 1."""
    return is_less(zero, x) & is_less(x, one)


@simd.func
def span(side: OnSide, a: real, b: real) -> Lanes:
    """The ends of a side that span its closest feature."""
    none = spread(zero)
    return select(is_less(zero, side.of_a), a, none) + select(is_less(zero, side.of_b), b, none)


@simd.func
def nearer(c: Closest, d: Vec3, squared: Lanes, u: Lanes, v: Lanes, features: Lanes, among: Mask) -> Closest:
    """The nearer of two points, of two that are as near the first; the second only among some lanes."""
    is_nearer = is_less(squared, c.squared) & among
    r = Closest()
    r.d = select(is_nearer, d, c.d)
    r.squared = select(is_nearer, squared, c.squared)
    r.u = select(is_nearer, u, c.u)
    r.v = select(is_nearer, v, c.v)
    r.features = select(is_nearer, features, c.features)
    return r


@simd.func
def of_side(side: OnSide, u: Lanes, v: Lanes, features: Lanes) -> Closest:
    """The closest point of a side as that of the patch."""
    r = Closest()
    r.d = side.d
    r.squared = side.squared
    r.u = u
    r.v = v
    r.features = features
    return r


@simd.func
def closest_of_face(w0: Vec3, w1: Vec3, w2: Vec3, q: Side, r: Side, side: Side) -> Closest:
    """Closest point of the triangle w0, w1 = w0 + q, w2 = w0 + r = w1 + side, whose corners are v less f0, f1, f2."""
    none = spread(zero)
    every = is_at_most(none, none)
    s = on_side(w0, w1, q)
    c = of_side(s, s.of_b, none, first + span(s, second, third))
    s = on_side(w0, w2, r)
    c = nearer(c, s.d, s.squared, none, s.of_b, first + span(s, second, fourth), every)
    s = on_side(w1, w2, side)
    c = nearer(c, s.d, s.squared, s.of_a, s.of_b, first + span(s, third, fourth), every)
    f = foot(w0, q, r)
    among = is_less(zero, f.x) & is_less(zero, f.y) & is_less(f.x + f.y, one)
    return nearer(c, f.d, f.squared, f.x, f.y, spread(all_four), among)


@simd.func
def closest_of_edges(w00: Vec3, w01: Vec3, w10: Vec3, w11: Vec3, q: Side, r: Side) -> Closest:
    """Closest point of the parallelogram w00 + u·r + v·q, whose corners are the ends of one edge less the other's."""
    none = spread(zero)
    whole = spread(one)
    every = is_at_most(none, none)
    s = on_side(w00, w01, q)
    c = of_side(s, none, s.of_b, first + span(s, third, fourth))
    s = on_side(w10, w11, q)
    c = nearer(c, s.d, s.squared, whole, s.of_b, second + span(s, third, fourth), every)
    s = on_side(w00, w10, r)
    c = nearer(c, s.d, s.squared, s.of_b, none, third + span(s, first, second), every)
    s = on_side(w01, w11, r)
    c = nearer(c, s.d, s.squared, s.of_b, whole, fourth + span(s, first, second), every)
    f = foot(w00, q, r)
    among = is_inside(f.x) & is_inside(f.y)
    return nearer(c, f.d, f.squared, f.y, f.x, spread(all_four), among)


@simd.func
def lowest(n: Vec3, w00: Vec3, w01: Vec3, w10: Vec3, w11: Vec3):
    """The corner that is least far along n, and how far that is."""
    w = w00
    along = dot(n, w00)
    other = dot(n, w01)
    w = select(is_less(other, along), w01, w)
    along = select(is_less(other, along), other, along)
    other = dot(n, w10)
    w = select(is_less(other, along), w10, w)
    along = select(is_less(other, along), other, along)
    other = dot(n, w11)
    w = select(is_less(other, along), w11, w)
    along = select(is_less(other, along), other, along)
    return w, along


@simd.func
def without(d: Vec3, a: Vec3) -> Vec3:
    """The part of d across a; a second time, after the cancellation."""
    squared = dot(a, a)
    e = d - (dot(d, a) / squared) * a
    e = e - (dot(e, a) / squared) * a
    return select(is_less(zero, squared), e, d)


@simd.func
def turned(d: Vec3, w00: Vec3, w01: Vec3, w10: Vec3, w11: Vec3) -> Vec3:
    """A direction near that of the closest point d, along which the patch begins there.

    Where a foot lies so near the end of a side that rounding hides it, the distance does not tell, and the direction is
    off by as much: it is made orthogonal to what leads from there to the lowest corner, and then to a second one.
    """
    w, _along = lowest(to_unit_size(d), w00, w01, w10, w11)
    a = w - d
    e = without(d, a)
    n = to_unit_size(e)
    w, _along = lowest(n, w00, w01, w10, w11)
    b = without(w - d, a)
    n = to_unit_size(select(is_less(dot(n, b), turn), without(without(e, b), a), e))
    # of sides that are nearly parallel b is nearly along d: then the second corner alone
    m = to_unit_size(without(d, w - d))
    _w, along_n = lowest(n, w00, w01, w10, w11)
    _w, along_m = lowest(m, w00, w01, w10, w11)
    length_n = square_root(dot(n, n))
    length_m = square_root(dot(m, m))
    return select(is_less(along_n * length_m, along_m * length_n) | is_at_most(length_n, spread(zero)), m, n)


@simd.func
def measured(kind: int, points: Points, only_least: bool) -> PairDistance:
    """The distance of a pair; invariant: no two of its points are closer than ``least`` (rounding, step 15).

    With ``only_least`` the distance and the direction are left out.
    """
    p = points
    c = corners(kind, p)
    restored = spread(one)
    of_sizes = total(c)
    sizes = of_sizes.x + of_sizes.y + of_sizes.z
    is_large = opposite(is_less(sizes, overflowing))
    if bits_of(is_large) != _NONE:
        factor = select(is_large, shrunk, spread(one))
        p = scaled(p, vec(factor, factor, factor))
        c = corners(kind, p)
        restored = select(is_large, restored_by, restored)
    size = largest(c)
    s = inverse_power_of_two(greatest_of(size))
    w00 = s * c.w00
    w01 = s * c.w01
    w10 = s * c.w10
    w11 = s * c.w11
    none = spread(zero)
    closest = Closest()
    closest.d = w00
    closest.u = none
    closest.v = none
    closest.features = spread(first_and_third)
    if kind == VERTEX_FACE:
        closest = closest_of_face(w00, w01, w10, side_of(s * c.q), side_of(s * c.r), side_of(s * (p.p2 - p.p3)))
    elif kind == EDGE_EDGE:
        closest = closest_of_edges(w00, w01, w10, w11, side_of(s * c.q), side_of(s * c.r))
    elif kind == POINT_SEGMENT:
        side = on_side(w00, w01, side_of(s * c.q))
        closest = of_side(side, side.of_b, none, first + span(side, third, fourth))
    # corners that repeat do no harm
    n = to_unit_size(closest.d)
    _w, along = lowest(n, w00, w01, w10, w11)
    error = projection * s * dot(magnitude(n), size)
    length = square_root(dot(n, n))
    is_low = is_less(error, dot(n, closest.d) - along)
    if bits_of(is_low) != _NONE:
        m = to_unit_size(turned(closest.d, w00, w01, w10, w11))
        _w, along_m = lowest(m, w00, w01, w10, w11)
        length_m = square_root(dot(m, m))
        # of two directions that are as good as each other, the one that proves more
        is_better = is_low & is_less(along * length_m, along_m * length)
        n = select(is_better, m, n)
        along = select(is_better, along_m, along)
        length = select(is_better, length_m, length)
        error = projection * s * dot(magnitude(n), size)
    along = along - (error + tiny)
    r = PairDistance()
    r.u = closest.u
    r.v = closest.v
    r.features = closest.features
    of_scale = one / s  # exact
    bound = greatest(least(along / length * down * of_scale * restored, largest_finite) - spread(UNDERFLOW), zero)
    bound = select(is_less(zero, along), bound, none)
    r.distance = none
    r.direction = vec(none, none, none)
    if not only_least:
        has_length = is_less(zero, length)
        r.direction = select(has_length, (one / length) * n, r.direction)
        unit = inverse_power_of_two(greatest_of(magnitude(closest.d)))
        of_unit_size = unit * closest.d
        r.distance = select(has_length, square_root(dot(of_unit_size, of_unit_size)) / unit * of_scale * restored, none)
    is_finite = is_at_most(sizes, sizes) & is_at_most(greatest_of(size), largest_finite)
    r.least = select(is_finite, bound, spread(not_a_number))
    return r
