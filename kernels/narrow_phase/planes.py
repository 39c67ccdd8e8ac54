"""When a vertex meets the plane of a half-space, in closed form, and why the answer is never late.

The solid is where (x - p)·n < 0. A vertex moves on a straight line, so f(t) = (x(t) - p)·n is linear, and f at both
ends of the step says all: edges and faces are hulls of their vertices, and meet the plane with one of these first.
There is nothing to iterate, so the tolerance plays no part.

The point of a plane may move, too, on a straight line from p0 to p1, while its normal stays. Then x(t) - p(t) is linear
in t, and f(t) = (x(t) - p(t))·n is, so all of the following holds with p0 for p at the start and p1 at the end: each
difference is formed of two given numbers.

Rounding, with u = 2^-53. All numbers of the input are exact, those of the normal and the point too.

1. **Scale.** Coordinates, those of the vertex and of the point at both ends, are multiplied by 2^-16 if one exceeds
   2^1000, so that nothing overflows, and by 2^600 if all are below 2^-400, so that no product is subnormal: exact, but
   for 2^-1075 where small ones lose bits beside those above 2^1000. The normal is multiplied by the power of two with
   which its largest component is in [1, 2): exact, but for 2^-1075 where a component becomes subnormal. ``lost`` is
   then 2^-1070, and 0 for all other normals.
2. **Value.** F = fl(Σ n_k (x_k - p_k)): each term has the roundings of a difference, a product and two sums, so |F -
   f| ≤ 4.01u Σ|n_k (x_k - p_k)|. S, that sum as it is computed, is at most 4.01u less, so E = 4.5u S covers the error.
   What step 1 and products lose by underflow is covered by ABSOLUTE = 2^-1000, and where a component of the normal has
   lost bits, by lost·Σ|x_k - p_k|. Where step 1 has lost nothing and each term has a factor 0, f is 0, and so is E.
3. **Distance.** A point is within a distance D of the half-space where f ≤ D·|n|, with the Euclidean length of n, or
   the sum of its magnitudes if D is in the maximum norm: the largest d·n of a vector d of that length. D is the sum of
   the distance asked for and the largest radius of the primitives around the vertex, if there are radii. |n| is rounded
   up on the host by 4u or more, so θ = D·|n|·(1 + 4u), with three roundings, is an upper bound. A
   ``start_gap_fraction`` reduces θ to that fraction of F - E at the start, which is no more than the gap there.
4. **Time.** Let L = fl(F - (E + θ)(1 + 4u)) at both ends. The sum in parentheses is an upper bound of E + θ, so the
   exact difference is a lower bound of f - θ, and L has its sign. If L ≤ 0 at the start, toi is 0. If L > 0 at both
   ends, the vertex is free. Otherwise the exact f - θ is above the line through both differences, which vanishes at
   a/(a - b) with a > 0 ≥ b. Computed from L, with both and their difference rounded once each, and the quotient, it is
   within 4.01u of that; times (1 - 6u), the rounding of the product included, it is a lower bound. A quotient below
   2^-1000 becomes 0, as its own roundings are not relative.

5. **Most vertices** stay far from a plane. Where S is between 2^-300 and 2^900 at both ends, and the normal has lost
   nothing, nothing can have overflowed, and what products lose by underflow is far below the slack of E, which is
   0.4u S. So L > 0 at both ends, computed without a scale and ABSOLUTE, already shows that a vertex is free.

6. **Start distance.** With ``keeps_start_distance``, a vertex that starts within its distance parts and slides, and
   comes no closer (`start_distance`); so does one beyond it by no more than 16 (E + E at the end), which rounding alone
   may bring there. The change of f over the step is (x1 - x0)·n - (p1 - p0)·n, each part with the error of step 2; 1.25
   times both cover their difference as well. If it is certainly not negative, the vertex is free, also in the solid: a
   half-space has a side to leave by, and f is nowhere less than at the start. Otherwise the vertex keeps h = F - E at
   the start, less 16 (E + E at the end), so that the roundings of a slide are no contact, and 0 at least: it does not
   enter the solid; and no more than its distance. L > 0 at both ends shows, as in step 4, that it is free. If not, f
   falls by more than these roundings: toi is 0 within the distance, and that of step 4 beyond it.

So toi is early by the roundings alone, E over the speed and some 6u of itself. The gap that is reported is an upper
bound in the same way, with a slack of 8u of all its terms.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_U = 2.0**-53
_LARGE = wp.constant(wp.float64(2.0**1000))
_SMALL = wp.constant(wp.float64(2.0**-400))
_SHRINK = wp.constant(wp.float64(2.0**-16))
_GROW = wp.constant(wp.float64(2.0**600))
_LEAST_CLEAR = wp.constant(wp.float64(2.0**-300))
_MOST_CLEAR = wp.constant(wp.float64(2.0**900))
# Beyond any value of f, so that no distance is infinite.
_FAR = wp.constant(wp.float64(2.0**1015))
_VALUE = wp.constant(wp.float64(4.5 * _U))
_ABSOLUTE = wp.constant(wp.float64(2.0**-1000))
_UP = wp.constant(wp.float64(1.0 + 4.0 * _U))
_DOWN = wp.constant(wp.float64(1.0 - 6.0 * _U))
_GAP = wp.constant(wp.float64(8.0 * _U))
_GAP_UP = wp.constant(wp.float64(1.0 + 32.0 * _U))
_MARGIN = wp.constant(wp.float64(16.0))
_SURE = wp.constant(wp.float64(1.25))
_LEAST_TOI = wp.constant(wp.float64(2.0**-1000))
_LEAST_GAP = wp.constant(wp.float64(2.0**-1074))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.struct
class Planes:
    """The planes of all half-spaces, in space; those of a mesh in the plane have z = 0."""

    point: wp.array[wp.vec3d]  # of those that do not move
    vertex: wp.array[wp.int32]  # the vertex that is the point of one that moves, or -1; empty: none moves
    world_begin: wp.array[wp.int32]  # first entry of each world in the next array, and the end; empty: all meet all
    of_world: wp.array[wp.int32]  # the planes that the vertices of each world meet
    normal: wp.array[wp.vec3d]  # times a power of two: the largest component is in [1, 2)
    lost: wp.array[wp.float64]  # step 1
    length: wp.array[wp.float64]  # of the normal, Euclidean, rounded up
    sum: wp.array[wp.float64]  # of its magnitudes, rounded up
    unit: wp.array[wp.vec3d]  # the unit normal
    body: wp.array[wp.int32]
    meets: wp.array2d[wp.uint8]  # whether the collision filter leaves a plane (row) and a body (column)
    excluded: wp.array[wp.int64]  # keys of excluded pairs of a vertex and a plane, ascending


@wp.struct
class PlaneQuery:
    """What vertices and planes are asked for."""

    distance: wp.float64  # at which they count as touching, a length
    is_euclidean: int  # 1: it is Euclidean, as radii are; 0: in the maximum norm
    start_gap_fraction: wp.float64  # 0: the distance applies to every pair
    keeps_start_distance: int  # 1: a vertex that starts within its distance may part and slide
    t_max: wp.float64
    most_gap: wp.float64  # beyond the distance at toi 0, above which rounding hides whether there is one, a length


@wp.struct
class PlaneMeeting:
    """When a vertex meets a plane."""

    toi: wp.float64  # inf: not in [0, t_max]
    gap: wp.float64  # upper bound of the gap beyond the distance at toi, a length


@wp.struct
class Value:
    """f at a time, and the bound of its error."""

    f: wp.float64
    error: wp.float64


@wp.func
def value_of(x: wp.vec3d, p: wp.vec3d, n: wp.vec3d, is_exact: bool, lost: wp.float64) -> Value:
    """(x - p)·n of scaled coordinates, within its error (step 2)."""
    d = x - p
    v = Value()
    if is_exact:
        if (n[0] == _ZERO or d[0] == _ZERO) and (n[1] == _ZERO or d[1] == _ZERO) and (n[2] == _ZERO or d[2] == _ZERO):
            return v
    a = n[0] * d[0]
    b = n[1] * d[1]
    c = n[2] * d[2]
    v.f = a + b + c
    v.error = _VALUE * (wp.abs(a) + wp.abs(b) + wp.abs(c)) + _ABSOLUTE
    if lost > _ZERO:
        v.error += lost * (wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]))
    return v


@wp.func
def scale_of(largest: wp.float64) -> wp.float64:
    """The power of two by which coordinates up to ``largest`` are multiplied (step 1)."""
    if largest > _LARGE:
        return _SHRINK
    if largest < _SMALL:
        return _GROW
    return _ONE


@wp.func
def largest_coordinate(x0: wp.vec3d, x1: wp.vec3d, p0: wp.vec3d, p1: wp.vec3d) -> wp.float64:
    """The largest magnitude of a coordinate of a vertex and of a point, each at both ends."""
    of_vertex = wp.max(wp.max(wp.abs(x0)), wp.max(wp.abs(x1)))
    return wp.max(of_vertex, wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(p1))))


@wp.func
def is_finite(x: wp.vec3d) -> bool:
    """Whether all coordinates are finite."""
    return wp.isfinite(x[0]) and wp.isfinite(x[1]) and wp.isfinite(x[2])


@wp.func
def is_clear(x: wp.vec3d, p: wp.vec3d, n: wp.vec3d, reach: wp.float64) -> bool:
    """Whether a position is certainly beyond the reach of a plane whose normal has lost nothing (step 5)."""
    d = x - p
    a = n[0] * d[0]
    b = n[1] * d[1]
    c = n[2] * d[2]
    s = wp.abs(a) + wp.abs(b) + wp.abs(c)
    return s > _LEAST_CLEAR and s < _MOST_CLEAR and a + b + c > (_VALUE * s + reach) * _UP


@wp.func
def point_of(planes: Planes, k: int, x: wp.array[wp.vec3d]) -> wp.vec3d:
    """A point of a plane, where vertices are at positions ``x``."""
    if planes.vertex.shape[0] > 0:
        v = planes.vertex[k]
        if v >= 0:
            return x[v]
    return planes.point[k]


@wp.func
def length_of_normal(planes: Planes, k: int, query: PlaneQuery) -> wp.float64:
    """Upper bound of the length of a normal in the norm that is dual to that of the distance (step 3)."""
    if query.is_euclidean != 0:
        return planes.length[k]
    return planes.sum[k]


@wp.func
def first_plane(planes: Planes, world: int) -> int:
    """The first of the planes that the vertices of a world meet, as a number for `nth_plane`."""
    if planes.world_begin.shape[0] > 0:
        return planes.world_begin[world]
    return 0


@wp.func
def end_of_planes(planes: Planes, world: int) -> int:
    """The end of these numbers."""
    if planes.world_begin.shape[0] > 0:
        return planes.world_begin[world + 1]
    return planes.body.shape[0]


@wp.func
def nth_plane(planes: Planes, n: int) -> int:
    """The plane of such a number."""
    if planes.world_begin.shape[0] > 0:
        return planes.of_world[n]
    return n


@wp.struct
class Bounds:
    """f at both ends of the step in scaled coordinates, and how far beyond them the vertex has to be."""

    start: Value
    end: Value
    reach: wp.float64
    a: wp.float64  # f less its error and the reach, at the start
    b: wp.float64  # at the end
    is_free: bool  # it meets nothing, as it parts from where it starts within its distance


@wp.func
def by_start_distance(r: Bounds, change: Value, of_plane: Value) -> Bounds:
    """What starts within its distance parts and slides, and comes no closer (step 6)."""
    both = r.start.error + r.end.error
    if change.f - of_plane.f >= _SURE * (change.error + of_plane.error):
        r.is_free = True
        return r
    kept = wp.min(r.reach, wp.max(r.start.f - r.start.error - _MARGIN * both, _ZERO))
    if r.end.f - (r.end.error + kept) * _UP > _ZERO and r.start.f - (r.start.error + kept) * _UP > _ZERO:
        r.is_free = True
    elif not r.a > _ZERO:
        r.reach = kept
        r.b = r.end.f - (r.end.error + r.reach) * _UP
    return r


@wp.func
def gap_at(r: Bounds, t: wp.float64) -> wp.float64:
    """Upper bound of f beyond the reach at a time, in scaled coordinates."""
    before = _ONE - t
    beyond = before * (r.start.f + r.start.error) - r.reach
    terms = before * (wp.abs(r.start.f) + r.start.error) + r.reach
    if t > _ZERO:
        beyond += t * (r.end.f + r.end.error)
        terms += t * (wp.abs(r.end.f) + r.end.error)
    return (beyond + _GAP * terms) * _GAP_UP


@wp.func
def meeting_of(
    x0: wp.vec3d,
    x1: wp.vec3d,
    p0: wp.vec3d,
    p1: wp.vec3d,
    radius: wp.float64,
    planes: Planes,
    k: int,
    query: PlaneQuery,
) -> PlaneMeeting:
    """When a vertex that moves from x0 to x1 comes within its distance of a half-space; its toi is never late.

    The point of plane k moves from p0 to p1. A position that is not finite meets nothing: its world has toi 0 for that.
    """
    meeting = PlaneMeeting()
    meeting.toi = wp.float64(wp.inf)
    n = planes.normal[k]
    size = length_of_normal(planes, k, query)
    lost = planes.lost[k]
    distance = query.distance + radius
    if lost == _ZERO:
        reach = distance * size * _UP
        if is_clear(x0, p0, n, reach) and is_clear(x1, p1, n, reach):
            return meeting
    if not (is_finite(x0) and is_finite(x1) and is_finite(p0) and is_finite(p1)):
        return meeting
    s = scale_of(largest_coordinate(x0, x1, p0, p1))
    if s != _ONE:
        x0 = s * x0
        x1 = s * x1
        p0 = s * p0
        p1 = s * p1
    is_exact = s >= _ONE and lost == _ZERO
    r = Bounds()
    r.start = value_of(x0, p0, n, is_exact, lost)
    r.end = value_of(x1, p1, n, is_exact, lost)
    r.reach = wp.min(distance * s * size * _UP, _FAR)
    if query.start_gap_fraction > _ZERO:
        r.reach = wp.min(r.reach, query.start_gap_fraction * wp.max(r.start.f - r.start.error, _ZERO))
    r.a = r.start.f - (r.start.error + r.reach) * _UP
    r.b = r.end.f - (r.end.error + r.reach) * _UP
    if query.keeps_start_distance != 0 and not r.a > _MARGIN * (r.start.error + r.end.error):
        r = by_start_distance(r, value_of(x1, x0, n, is_exact, lost), value_of(p1, p0, n, is_exact, lost))
    if r.is_free or (r.a > _ZERO and r.b > _ZERO):
        return meeting
    t = _ZERO
    if r.a > _ZERO:
        t = r.a / (r.a - r.b) * _DOWN
        if t < _LEAST_TOI:
            t = _ZERO
    if t > query.t_max:
        return meeting
    meeting.toi = t
    gap = gap_at(r, t)
    if gap > _ZERO:
        meeting.gap = gap / size / s
        if s > _ONE:
            meeting.gap += _LEAST_GAP
    return meeting
