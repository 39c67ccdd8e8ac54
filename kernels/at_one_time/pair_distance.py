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
"""

import warp as wp

from ..pair.rounding import LARGEST, PROJECTION_ROOT, RELATIVE, TINY, UNIT_ROUNDOFF, inverse_power_of_two
from ..pair.single_points import Points, corners, largest, scaled, total
from ..pair_kind import EDGE_EDGE, POINT_SEGMENT, VERTEX_FACE
from ..step.contact_normal import to_unit_size

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_PROJECTION = wp.constant(wp.float64(PROJECTION_ROOT * UNIT_ROUNDOFF[wp.float64]))
_DOWN = wp.constant(wp.float64(1.0 - RELATIVE * UNIT_ROUNDOFF[wp.float64]))
_TINY = wp.constant(wp.float64(TINY[wp.float64]))
_SHRUNK = wp.constant(wp.float64(2.0**-10))
_RESTORED = wp.constant(wp.float64(2.0**10))
# In scaled units, beside which a corner counts as lower than the closest point.
_TURN = wp.constant(wp.float64(UNIT_ROUNDOFF[wp.float64]))
_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))
# More than a number can lose where it becomes subnormal.
UNDERFLOW = wp.constant(wp.float64(2.0**-1070))

# The vertices of a pair that span its closest features, as bits: those of v, f0, f1, f2, or ea0, ea1, eb0, eb1; of a
# point and a segment, or another point, the first and the last two, or the third.
_FIRST = wp.constant(1)
_SECOND = wp.constant(2)
_THIRD = wp.constant(4)
_FOURTH = wp.constant(8)
_ALL = wp.constant(15)


@wp.struct
class PairDistance:
    """What is known of the distance of a pair."""

    distance: wp.float64  # of the two points, a length
    least: wp.float64  # a lower bound of the distance, NaN where a coordinate is not finite
    direction: wp.vec3d  # unit, from the second primitive to the first; 0 where they have a common point
    parameters: wp.vec2d  # (u, v) of the closest points
    features: int


@wp.struct
class Closest:
    """A point of a patch, in scaled units."""

    d: wp.vec3d
    squared: wp.float64
    u: wp.float64
    v: wp.float64
    features: int


@wp.struct
class OnSide:
    """The closest point of a side, with the weights of its ends; of an end the other weight is exactly 0."""

    d: wp.vec3d
    squared: wp.float64
    of_a: wp.float64
    of_b: wp.float64


@wp.struct
class Foot:
    """The foot of the perpendicular on the plane w + x·q + y·r."""

    d: wp.vec3d
    x: wp.float64
    y: wp.float64
    exists: bool


@wp.func
def on_side(a: wp.vec3d, b: wp.vec3d, side: wp.vec3d) -> OnSide:
    """Closest point to the origin of the segment from a to b = a + side, reckoned from its nearer end."""
    near = a
    far = b
    e = side
    is_from_b = wp.dot(b, b) < wp.dot(a, a)
    if is_from_b:
        near = b
        far = a
        e = -side
    r = OnSide()
    r.d = near
    t = _ZERO
    squared = wp.dot(e, e)
    if squared > _ZERO:
        t = wp.clamp(-wp.dot(near, e) / squared, _ZERO, _ONE)
        if t == _ONE:
            r.d = far  # only if rounding hides which end is nearer
        elif t > _ZERO:
            d = near + t * e
            r.d = d - (wp.dot(d, e) / squared) * e
    r.of_a = _ONE - t
    r.of_b = t
    if is_from_b:
        r.of_a = t
        r.of_b = _ONE - t
    r.squared = wp.dot(r.d, r.d)
    return r


@wp.func
def foot(w: wp.vec3d, q: wp.vec3d, r: wp.vec3d) -> Foot:
    """The foot of the perpendicular; there is none where the sides are parallel."""
    f = Foot()
    longer = q
    shorter = r
    is_swapped = wp.dot(r, r) > wp.dot(q, q)
    if is_swapped:
        longer = r
        shorter = q
    length_squared = wp.dot(longer, longer)
    if length_squared > _ZERO:
        lean = wp.dot(shorter, longer) / length_squared
        across = shorter - lean * longer
        across = across - (wp.dot(across, longer) / length_squared) * longer
        width_squared = wp.dot(across, across)
        if width_squared > _ZERO:
            f.exists = True
            along = -wp.dot(w, longer) / length_squared
            d = w + along * longer
            y = -wp.dot(d, across) / width_squared
            d = d + y * across
            d = d - (wp.dot(d, longer) / length_squared) * longer
            f.d = d - (wp.dot(d, across) / width_squared) * across
            x = along - lean * y
            f.x = wp.where(is_swapped, y, x)
            f.y = wp.where(is_swapped, x, y)
    return f


@wp.func
def is_inside(x: wp.float64) -> bool:
    """Whether a weight is strictly between 0 and 1."""
    return x > _ZERO and x < _ONE


@wp.func
def span(side: OnSide, first: int, second: int) -> int:
    """The ends of a side that span its closest feature."""
    ends = int(0)
    if side.of_a > _ZERO:
        ends = first
    if side.of_b > _ZERO:
        ends = ends + second
    return ends


@wp.func
def nearer(c: Closest, d: wp.vec3d, squared: wp.float64, u: wp.float64, v: wp.float64, features: int) -> Closest:
    """The nearer of two points, of two that are as near the first."""
    if squared < c.squared:
        c = Closest(d, squared, u, v, features)
    return c


@wp.func
def closest_of_face(w0: wp.vec3d, w1: wp.vec3d, w2: wp.vec3d, q: wp.vec3d, r: wp.vec3d, third: wp.vec3d) -> Closest:
    """Closest point of the triangle w0, w1 = w0 + q, w2 = w0 + r = w1 + third, whose corners are v less f0, f1, f2."""
    s = on_side(w0, w1, q)
    c = Closest(s.d, s.squared, s.of_b, _ZERO, _FIRST + span(s, _SECOND, _THIRD))
    s = on_side(w0, w2, r)
    c = nearer(c, s.d, s.squared, _ZERO, s.of_b, _FIRST + span(s, _SECOND, _FOURTH))
    s = on_side(w1, w2, third)
    c = nearer(c, s.d, s.squared, s.of_a, s.of_b, _FIRST + span(s, _THIRD, _FOURTH))
    f = foot(w0, q, r)
    if f.exists and f.x > _ZERO and f.y > _ZERO and f.x + f.y < _ONE:
        c = nearer(c, f.d, wp.dot(f.d, f.d), f.x, f.y, _ALL)
    return c


@wp.func
def closest_of_edges(w00: wp.vec3d, w01: wp.vec3d, w10: wp.vec3d, w11: wp.vec3d, q: wp.vec3d, r: wp.vec3d) -> Closest:
    """Closest point of the parallelogram w00 + u·r + v·q, whose corners are the ends of one edge less the other's."""
    s = on_side(w00, w01, q)
    c = Closest(s.d, s.squared, _ZERO, s.of_b, _FIRST + span(s, _THIRD, _FOURTH))
    s = on_side(w10, w11, q)
    c = nearer(c, s.d, s.squared, _ONE, s.of_b, _SECOND + span(s, _THIRD, _FOURTH))
    s = on_side(w00, w10, r)
    c = nearer(c, s.d, s.squared, s.of_b, _ZERO, _THIRD + span(s, _FIRST, _SECOND))
    s = on_side(w01, w11, r)
    c = nearer(c, s.d, s.squared, s.of_b, _ONE, _FOURTH + span(s, _FIRST, _SECOND))
    f = foot(w00, q, r)
    if f.exists and is_inside(f.x) and is_inside(f.y):
        c = nearer(c, f.d, wp.dot(f.d, f.d), f.y, f.x, _ALL)
    return c


@wp.func
def lowest(n: wp.vec3d, w00: wp.vec3d, w01: wp.vec3d, w10: wp.vec3d, w11: wp.vec3d) -> wp.vec3d:
    """The corner that is least far along n."""
    w = w00
    if wp.dot(n, w01) < wp.dot(n, w):
        w = w01
    if wp.dot(n, w10) < wp.dot(n, w):
        w = w10
    if wp.dot(n, w11) < wp.dot(n, w):
        w = w11
    return w


@wp.func
def bound_along(
    n: wp.vec3d, w00: wp.vec3d, w01: wp.vec3d, w10: wp.vec3d, w11: wp.vec3d, size: wp.vec3d, norm: wp.float64
) -> wp.float64:
    """A lower bound of the distance of the patch in the norm dual to that of n, rounding included (step 15)."""
    along = wp.dot(n, lowest(n, w00, w01, w10, w11)) - (_PROJECTION * wp.dot(wp.abs(n), size) + _TINY)
    return along / norm * _DOWN


@wp.func
def without(d: wp.vec3d, a: wp.vec3d) -> wp.vec3d:
    """The part of d across a; a second time, after the cancellation."""
    squared = wp.dot(a, a)
    if squared > _ZERO:
        d = d - (wp.dot(d, a) / squared) * a
        d = d - (wp.dot(d, a) / squared) * a
    return d


@wp.func
def turned(d: wp.vec3d, w00: wp.vec3d, w01: wp.vec3d, w10: wp.vec3d, w11: wp.vec3d) -> wp.vec3d:
    """A direction near that of the closest point d, along which the patch begins there.

    Where a foot lies so near the end of a side that rounding hides it, the distance does not tell, and the direction is
    off by as much: it is made orthogonal to what leads from there to the lowest corner, and then to a second one.
    """
    a = lowest(to_unit_size(d), w00, w01, w10, w11) - d
    e = without(d, a)
    n = to_unit_size(e)
    b = without(lowest(n, w00, w01, w10, w11) - d, a)
    if wp.dot(n, b) < -_TURN:
        e = without(without(e, b), a)
    return e


@wp.func
def measured(kind: int, points: Points, only_least: bool) -> PairDistance:
    """The distance of a pair; invariant: no two of its points are closer than ``least`` (rounding, step 15).

    With ``only_least`` the distance and the direction are left out.
    """
    p = points
    c = corners(kind, p)
    restored = _ONE
    t = total(c)
    if not (t[0] + t[1] + t[2] < LARGEST):
        p = scaled(p, wp.vec3d(_SHRUNK, _SHRUNK, _SHRUNK))
        c = corners(kind, p)
        restored = _RESTORED
    size = largest(c)
    s = inverse_power_of_two(wp.max(size))
    w00 = s * c.w00
    w01 = s * c.w01
    w10 = s * c.w10
    w11 = s * c.w11
    closest = Closest()
    closest.d = w00
    closest.features = _FIRST + _THIRD
    if kind == VERTEX_FACE:
        closest = closest_of_face(w00, w01, w10, s * c.q, s * c.r, s * (p.p2 - p.p3))
    elif kind == EDGE_EDGE:
        closest = closest_of_edges(w00, w01, w10, w11, s * c.q, s * c.r)
    elif kind == POINT_SEGMENT:
        side = on_side(w00, w01, s * c.q)
        closest.d = side.d
        closest.u = side.of_b
        closest.features = _FIRST + span(side, _THIRD, _FOURTH)
    # corners that repeat do no harm
    n = to_unit_size(closest.d)
    along = wp.dot(n, lowest(n, w00, w01, w10, w11))
    error = _PROJECTION * s * wp.dot(wp.abs(n), size)
    if wp.dot(n, closest.d) - along > error:
        e = turned(closest.d, w00, w01, w10, w11)
        m = to_unit_size(e)
        # of two directions that are as good as each other, the one that proves more
        if wp.dot(m, lowest(m, w00, w01, w10, w11)) * wp.length(n) > along * wp.length(m):
            n = m
            along = wp.dot(n, lowest(n, w00, w01, w10, w11))
            error = _PROJECTION * s * wp.dot(wp.abs(n), size)
    along = along - (error + _TINY)
    length = wp.sqrt(wp.dot(n, n))
    r = PairDistance()
    r.parameters = wp.vec2d(closest.u, closest.v)
    r.features = closest.features
    if along > _ZERO:
        least = along / length * _DOWN
        r.least = wp.max(wp.min(least / s * restored, _LARGEST_FINITE) - UNDERFLOW, _ZERO)
    if length > _ZERO and not only_least:
        r.direction = n / length
        of_unit_size = to_unit_size(closest.d)
        r.distance = wp.length(of_unit_size) / inverse_power_of_two(wp.max(wp.abs(closest.d))) / s * restored
    if not (t[0] + t[1] + t[2] == t[0] + t[1] + t[2]) or not wp.isfinite(wp.max(size)):
        r.least = wp.float64(wp.nan)
    return r
