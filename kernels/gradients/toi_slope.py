"""How the time of impact of a pair changes with its points and its distance, to first order.

A pair with gap G(t) and distance D touches where G = D. With the direction n along which points change the gap, and the
weights w of the points in the difference of the closest ones (`pair_gap`), the implicit function theorem gives

    dt = −[Σ w_i n·((1−t) da_i + t db_i) − dD] / G',    G' = n·Σ w_i (b_i − a_i),

for moves da of the points at the start of the step and db at its end. So four weights, a time, the **slope** n / G' and
1 / G' say all; no iteration is differentiated.

A reported toi may be early by the tolerance, or by the roundings of float32. A few steps of Newton's method lead from
it to the root, at which all of this is evaluated. **A pair is regular** where that root is certain: with M the vector
of the largest |corner| on each axis and u = 2^-53, a gap is known to within NOISE = 32 u·|M| (`contact_normal`), so its
root to within NOISE / |G'|. It must be reached, be that far from both ends of the step, be no earlier than the toi, and
G' must be the same at both ends of that range, to one part in 1,024; where the two graze each other it is not. Without
a distance the point of contact has to lie on both primitives, or the pair passes by within its tolerance.
"""

import warp as wp

from ..pair.patch import Corners, corners_at
from ..pair.rounding import UNIT_ROUNDOFF, inverse_power_of_two
from ..pair.single_points import Points, corners, largest
from ..pair.status import STATUS_COLLISION
from ..pair_kind import EDGE_EDGE, POINT_POINT, POINT_SEGMENT, VERTEX_FACE, VERTEX_PLANE
from ..step.contact_sides import NOISE
from ..step.pair_gap import TOUCH, gap_of, patch_point

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

vec3d = wp.vec3d

_NOISE = wp.constant(wp.float64(NOISE * UNIT_ROUNDOFF[wp.float64]))
_SAME = wp.constant(wp.float64(2.0**-10))
_ROUNDINGS = wp.constant(wp.float64(2.0**-48))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_FOUR = wp.constant(wp.float64(4.0))
_MOST_STEPS = wp.constant(16)


@wp.struct
class Query:
    """What counts as touching, for all pairs of a table."""

    norm: int  # TOUCH, BALL or BOX
    separation: wp.float64  # a length, where no pair has a distance of its own
    by_size: int  # whether it is a multiple of the longest side of the box around each pair's motion
    is_planar: int
    t_max: wp.float64


@wp.struct
class Table:
    """Pairs of a table, whose tois change."""

    kinds: wp.array[wp.int32]  # empty where all are of one kind
    points_t0: wp.array2d[vec3d]
    points_t1: wp.array2d[vec3d]
    toi: wp.array[wp.float64]
    status: wp.array[wp.int32]
    distances: wp.array[wp.float64]  # of each pair; empty: the separation of all
    planes: wp.array[vec3d]  # unit normal for pairs of vertices and planes; empty where there are none
    toi_gradient: wp.array[wp.float64]  # of a result by the toi; rows of 0 are not wanted; empty: all are


@wp.struct
class Slopes:
    """How the toi of each pair of a table changes; the columns of pairs without a gradient are 0."""

    slope: wp.array[vec3d]  # its direction over the rate at which the gap closes
    distance: wp.array[wp.float64]  # d toi / d distance
    weights: wp.array[wp.vec4d]  # of the columns v, f0, f1, f2; ea0, ea1, eb0, eb1; p, p, a, b; p, p, q, q; v, v, v, p
    time: wp.array[wp.float64]
    is_regular: wp.array[wp.bool]


@wp.func
def scaled_corners(c: Corners, s: wp.float64) -> Corners:
    """Corners and sides in another unit."""
    r = Corners()
    r.w00 = s * c.w00
    r.w01 = s * c.w01
    r.w10 = s * c.w10
    r.w11 = s * c.w11
    r.q = s * c.q
    r.r = s * c.r
    return r


@wp.func
def motion_of(a: Corners, b: Corners) -> Corners:
    """Velocities of corners and sides."""
    r = Corners()
    r.w00 = b.w00 - a.w00
    r.w01 = b.w01 - a.w01
    r.w10 = b.w10 - a.w10
    r.w11 = b.w11 - a.w11
    r.q = b.q - a.q
    r.r = b.r - a.r
    return r


@wp.func
def weights_of(kind: int, at: wp.vec2d) -> wp.vec4d:
    """Weights of the four columns in the difference of the closest points, from a place on the patch."""
    if kind == VERTEX_FACE:
        return wp.vec4d(_ONE, at[0] + at[1] - _ONE, -at[0], -at[1])
    if kind == EDGE_EDGE:
        return wp.vec4d(_ONE - at[1], at[1], at[0] - _ONE, -at[0])
    if kind == POINT_SEGMENT:
        return wp.vec4d(_ONE, _ZERO, at[0] - _ONE, -at[0])
    if kind == POINT_POINT:
        return wp.vec4d(_ONE, _ZERO, -_ONE, _ZERO)
    return wp.vec4d(_ONE, _ZERO, _ZERO, -_ONE)


@wp.struct
class Closing:
    """A gap at a time, and how fast it changes."""

    is_known: bool
    size: wp.float64
    rate: wp.float64
    along: vec3d
    at: wp.vec2d
    point: vec3d
    speed: wp.float64  # of the difference of the closest points


@wp.struct
class ScaledPair:
    """A pair whose lengths are multiplied by a power of two, so that its largest coordinate is near 1."""

    kind: int
    norm: int  # TOUCH where it has no distance
    is_planar: bool
    plane: vec3d  # the unit normal for a vertex and a plane
    c0: Corners
    c1: Corners
    unit: wp.float64
    noise: wp.float64  # to which a gap is known
    distance: wp.float64


@wp.func
def closing_at(p: ScaledPair, t: wp.float64) -> Closing:
    """The gap of a pair at a time."""
    velocity = motion_of(p.c0, p.c1)
    c = corners_at(p.c0, p.c1, t)
    c.q = (_ONE - t) * p.c0.q + t * p.c1.q
    c.r = (_ONE - t) * p.c0.r + t * p.c1.r
    g = gap_of(p.kind, p.norm, c, velocity, p.plane, p.noise, p.is_planar)
    v = patch_point(velocity, g.at, p.kind == VERTEX_FACE)
    r = Closing()
    r.size = g.size
    r.rate = wp.dot(g.along, v)
    r.is_known = g.is_known and r.rate < _ZERO
    r.along = g.along
    r.at = g.at
    r.point = patch_point(c, g.at, p.kind == VERTEX_FACE)
    r.speed = wp.length(v)
    return r


@wp.func
def table_points(kind: int, x: wp.array2d[vec3d], i: int) -> Points:
    """Points of a row, as the patch takes them: four columns, or the points of a pair function."""
    skipped = 0
    if x.shape[1] == 4 and kind != VERTEX_FACE and kind != EDGE_EDGE:
        skipped = 1  # the first point stands there twice
    last = x.shape[1] - 1
    p = Points()
    p.p0 = x[i, 0]
    p.p1 = x[i, 1 + skipped]
    p.p2 = x[i, wp.min(2 + skipped, last)]
    p.p3 = x[i, last]
    if kind == VERTEX_PLANE:
        p.p1 = x[i, last]
        p.p2 = p.p1
    return p


@wp.func
def largest_side(a: Points, b: Points) -> wp.float64:
    """Longest side of the box around the points at both ends of the step."""
    low_a = wp.min(wp.min(a.p0, a.p1), wp.min(a.p2, a.p3))
    low_b = wp.min(wp.min(b.p0, b.p1), wp.min(b.p2, b.p3))
    high_a = wp.max(wp.max(a.p0, a.p1), wp.max(a.p2, a.p3))
    high_b = wp.max(wp.max(b.p0, b.p1), wp.max(b.p2, b.p3))
    return wp.max(wp.max(high_a, high_b) - wp.min(low_a, low_b))


@wp.func
def scaled_pair(kind: int, query: Query, pairs: Table, i: int) -> ScaledPair:
    """A row of a table."""
    a = table_points(kind, pairs.points_t0, i)
    b = table_points(kind, pairs.points_t1, i)
    c0 = corners(kind, a)
    c1 = corners(kind, b)
    size = wp.max(largest(c0), largest(c1))
    p = ScaledPair()
    p.kind = kind
    p.is_planar = query.is_planar != 0
    if kind == VERTEX_PLANE:
        p.plane = pairs.planes[i]
    p.unit = inverse_power_of_two(wp.max(size))
    p.c0 = scaled_corners(c0, p.unit)
    p.c1 = scaled_corners(c1, p.unit)
    p.noise = _NOISE * wp.length(p.unit * size)
    distance = query.separation
    if query.by_size != 0:
        distance = distance * largest_side(a, b)
    if pairs.distances.shape[0] > 0:
        distance = pairs.distances[i]
    p.distance = p.unit * distance
    p.norm = query.norm
    if not p.distance > _ZERO:
        p.norm = TOUCH
    return p


@wp.func
def root_from(p: ScaledPair, toi: wp.float64):
    """The time of the root to which Newton's method leads from a toi, and the gap there."""
    t = toi
    g = Closing()
    steps = int(0)
    while steps <= _MOST_STEPS:
        if steps > 0:
            t = t + (p.distance - g.size) / g.rate
        g = closing_at(p, t)
        steps += 1
        if not g.is_known or wp.abs(g.size - p.distance) <= p.noise / wp.float64(32.0):
            break
    return t, g


@wp.func
def is_certain(p: ScaledPair, t: wp.float64, g: Closing, toi: wp.float64, t_max: wp.float64) -> bool:
    """Whether a root is certain, which makes a pair regular."""
    if not g.is_known or not wp.abs(g.size - p.distance) <= p.noise:
        return False
    uncertain = p.noise / -g.rate
    if not (t - uncertain > _ZERO and t + uncertain < t_max * (_ONE - _ROUNDINGS)):
        return False
    if t < toi - _FOUR * uncertain - _ROUNDINGS:
        return False
    if p.norm == TOUCH and p.kind != VERTEX_PLANE:
        if not wp.length(g.point) <= _FOUR * (p.noise + g.speed * uncertain):
            return False
    side = int(-1)
    while side <= 1:
        beside = closing_at(p, t + wp.float64(side) * uncertain)
        if not beside.is_known or wp.abs(beside.rate - g.rate) > -_SAME * g.rate:
            return False
        side += 2
    return True


@wp.kernel
def fill_slopes(
    begin: int,
    # in
    query: Query,
    kind_of_all: int,  # -1: each pair has its own
    pairs: Table,
    # out
    out: Slopes,
):
    """How the toi of each pair changes."""
    i = begin + wp.tid()
    out.slope[i] = vec3d()
    out.distance[i] = _ZERO
    out.weights[i] = wp.vec4d()
    out.time[i] = _ZERO
    out.is_regular[i] = False
    if pairs.toi_gradient.shape[0] > 0:
        if pairs.toi_gradient[i] == _ZERO:
            return
    if pairs.status[i] != STATUS_COLLISION or not wp.isfinite(pairs.toi[i]):
        return
    kind = kind_of_all
    if kind < 0:
        kind = pairs.kinds[i]
    p = scaled_pair(kind, query, pairs, i)
    t, g = root_from(p, pairs.toi[i])
    if is_certain(p, t, g, pairs.toi[i], query.t_max):
        per_length = p.unit / g.rate
        out.slope[i] = per_length * g.along
        out.distance[i] = per_length
        out.weights[i] = weights_of(kind, g.at)
        out.time[i] = t
        out.is_regular[i] = True
