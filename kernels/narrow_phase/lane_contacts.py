"""Contacts of a list recorded several at once, on the CPU: those of pairs that ask for no distance.

The rounds leave them in lanes that are scattered, so they wait until there is one for each lane, and their points are
gathered again. What few of them need is left to `pair_contacts`, which records any contact: a toi near 0, and rounds in
which a pair may touch as long as it stays in place. So is the normal where the sides have none, or a gap is more than
rounding. Both have equal bits.
"""

import warp as wp

from ..atomics import claim_int
from ..boxes.lanes import lowest_bit
from ..pair.lane_solver import LaneAnswer
from ..pair.pair_options import row_in
from ..pair.points import Points
from ..pair.query import Options
from ..pair.single_points import points_of
from ..pair.status import STATUS_COLLISION
from ..pair_kind import EDGE_EDGE, VERTEX_FACE
from ..parameters import width
from ..step.minima import CONTACTS_OVERFLOW, Minima, flag_world
from ..step.pair_list import PairList, Round, vertices_of_pair
from ..step.step import ContactList
from ..template import specialised
from .lane_rows import (
    Index,
    LaneVertices,
    Numbers,
    Rows,
    index_of,
    number,
    numbers_of,
    of_vertex,
    points_of_vertices,
    put,
    put_pairs,
    put_vec2,
    put_vec3,
    rows_from,
    rows_of,
    vertices_of_pairs,
)
from .pair_contacts import contact_of_pair
from .raised_toi import LOST_TOI

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_ZERO = wp.constant(wp.float64(0.0))

simd = specialised("pair.simd", width=width)
sides = specialised("step.contact_sides", width=width)
lanes = wp.constant(width)
collision = wp.constant(wp.float64(int(STATUS_COLLISION)))


@wp.struct
class Unrecorded:
    """Contacts that wait until there are enough of them for all lanes."""

    count: int
    rows: Rows  # of their pairs in the list
    t: Numbers
    u: Numbers
    v: Numbers
    gap: Numbers


@simd.func
def ordinary(answer: LaneAnswer, options: Options, round: Round) -> wp.uint32:
    """The lanes that have found a contact of which nothing but its place and normal is to be found."""
    if round.only_moving != 0:
        return _NONE
    t = answer.t
    return answer.contact & simd.bits_of(simd.is_less(LOST_TOI, t) & simd.is_at_most(t, simd.spread(options.t_max)))


# what is lowered is known of all lanes before the first is, so that none waits for another's memory
lower_snippet = f"""
    unsigned less = 0;
    const auto at = [&](int k) {{ return (long long*)values.data + {index_of}; }};
    const auto bits = [&](int k) {{ const double a = {number.format("t")}; return __builtin_bit_cast(long long, a); }};
    for (int k = 0; k < {width}; ++k)
        less |= (k < count && bits(k) < __atomic_load_n(at(k), __ATOMIC_RELAXED) ? 1u : 0u) << k;
    for (; less != 0; less &= less - 1) {{
        const int k = __builtin_ctz(less);
        const int order = __ATOMIC_RELAXED;
        long long seen = __atomic_load_n(at(k), order);
        while (bits(k) < seen && !__atomic_compare_exchange_n(at(k), &seen, bits(k), true, order, order)) {{
        }}
    }}
"""


@wp.func_native(lower_snippet)
def lower(values: wp.array[wp.int64], i: Index, t: simd.Lanes, count: int):
    """Lower the toi of what has the numbers i in the first lanes, as `atomic_min_int64` does."""
    ...


@wp.func
def lower_pairs(minima: Minima, kind: int, i: LaneVertices, t: simd.Lanes, count: int):
    """`lower_pair` for the first lanes."""
    lower(minima.vertex, i.i0, t, count)
    lower(minima.vertex, i.i1, t, count)
    lower(minima.vertex, i.i2, t, count)
    lower(minima.vertex, i.i3, t, count)
    lower(minima.body, of_vertex(minima.vertex_body, i.i0), t, count)
    second = i.i1
    if kind == EDGE_EDGE:
        second = i.i2
    lower(minima.body, of_vertex(minima.vertex_body, second), t, count)
    first_one = rows_from(0, 1)
    world = first_one
    if minima.vertex_world.shape[0] > 0:
        world = of_vertex(minima.vertex_world, i.i0)
    lower(minima.world, world, t, count)
    lower(minima.scene, first_one, t, count)


@simd.func
def is_rounding(gap: simd.Vec3, noise: simd.Lanes) -> simd.Mask:
    """Whether a gap may be none."""
    return simd.is_at_most(simd.dot(gap, gap), noise)


@simd.func
def normals(kind: int, a: Points, b: Points, t: simd.Lanes, u: simd.Lanes, v: simd.Lanes):
    """The normals of contacts without a gap whose sides have one, and for which lanes they are."""
    at_toi = sides.gap_at(kind, a, b, t, u, v, simd.spread(_ZERO))
    foot, is_inside = sides.foot_gap(at_toi.corners, kind == VERTEX_FACE)
    touches = is_rounding(at_toi.gap, at_toi.noise) | (is_inside & is_rounding(foot, at_toi.noise))
    n, is_regular = sides.normal_of_sides(sides.sides_at(kind, a, b, t, u, v))
    known = simd.bits_of(touches & is_regular)
    if kind != VERTEX_FACE and kind != EDGE_EDGE:
        known = _NONE
    nothing = simd.spread(_ZERO)
    return n + simd.vec(nothing, nothing, nothing), known  # -0 + 0 is 0


@simd.func
def record_lanes(unrecorded: Unrecorded, pairs: PairList, minima: Minima, contacts: ContactList) -> int:
    """Lower the minima by as many contacts as there are lanes, or are left, and list them; returns how many remain."""
    size = wp.min(lanes, unrecorded.count)
    first = unrecorded.count - size
    rows = rows_of(unrecorded.rows, first, size)
    t = numbers_of(unrecorded.t, first, size)
    u = numbers_of(unrecorded.u, first, size)
    v = numbers_of(unrecorded.v, first, size)
    kind = pairs.kind
    i = vertices_of_pairs(pairs, rows)
    a = points_of_vertices(pairs.vertices_t0, i.i0, i.i1, i.i2, i.i3)
    b = points_of_vertices(pairs.vertices_t1, i.i0, i.i1, i.i2, i.i3)
    n, known = normals(kind, a, b, t, u, v)
    lower_pairs(minima, kind, i, t, size)
    begin = claim_int(contacts.count, 0, size)
    listed = wp.clamp(contacts.toi.shape[0] - begin, 0, size)
    at = rows_from(begin, size)
    put(contacts.kind, at, simd.spread(wp.float64(kind)), listed)
    put(contacts.toi, at, t, listed)
    put(contacts.status, at, simd.spread(collision), listed)
    put(contacts.gap, at, numbers_of(unrecorded.gap, first, size), listed)
    put(contacts.width, at, simd.spread(_ZERO), listed)
    put_vec2(contacts.parameters, at, u, v, listed)
    put_vec3(contacts.normal, at, n.x, n.y, n.z, listed)
    put_pairs(contacts.primitives, at, pairs.keys, rows, listed)
    for k in range(listed, size):
        flag_world(minima, row_in(i.i0, k), CONTACTS_OVERFLOW)
    left = ((_ONE << wp.uint32(listed)) - _ONE) & ~known
    while left != _NONE:
        k = lowest_bit(left)
        left = left & (left - _ONE)
        vertices = vertices_of_pair(pairs, row_in(rows, k))
        x0 = points_of(kind, vertices.first, vertices.second, pairs.vertices_t0)
        x1 = points_of(kind, vertices.first, vertices.second, pairs.vertices_t1)
        uv = wp.vec2d(simd.lane_of(u, k), simd.lane_of(v, k))
        at_toi = contact_of_pair(kind, x0, x1, simd.lane_of(t, k), uv, _ZERO)
        contacts.parameters[begin + k] = at_toi.parameters
        contacts.normal[begin + k] = at_toi.direction
    return first
