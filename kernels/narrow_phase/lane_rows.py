"""Rows of arrays in lanes: the points of several pairs are gathered, and what is known of the pairs is written.

A row is a pair: of an array of points, or in a list of keys. Rows need not follow each other: those that the first
rounds of the narrow phase leave open are packed together.
"""

from typing import Any

import warp as wp

from ..pair.points import Points
from ..pair.turns import Turns
from ..pair_kind import EDGE_EDGE
from ..parameters import norm, width
from ..step.pair_list import PairList
from ..template import specialised

simd = specialised("pair.simd", width=width)
lane_points = specialised("search.lane_points", width=width)
Index: Any = wp.types.vector(length=width, dtype=wp.int32) if width > 1 else wp.int32
# lists in which pairs wait until they fill the lanes
most_pending = 2 * width if width > 1 else 1
Rows: Any = wp.types.vector(length=most_pending, dtype=wp.int32)
Numbers: Any = wp.types.vector(length=most_pending, dtype=wp.float64)
# of the C++ below
index_of = "i" if width == 1 else "i[k]"
out64 = "double r[1]" if width == 1 else f"wp::vec_t<{width}, double> r"
out_index = "int r[1]" if width == 1 else f"wp::vec_t<{width}, wp::int32> r"
returned = "r[0]" if width == 1 else "r"

gathered_row_snippet = f"""
    {out64};
    const int column = point < x.shape[1] ? point : x.shape[1] - 1;
    for (int k = 0; k < {width}; ++k)
        r[k] = ((const double*)&wp::index(x, {index_of}, column))[axis];
    return {returned};
"""


@wp.func_native(gathered_row_snippet)
def gathered_row(x: wp.array2d[wp.vec3d], i: Index, point: int, axis: int) -> simd.Lanes:
    """A coordinate of one point of a row for each lane; missing points repeat the last one."""
    ...


of_vertex_snippet = f"""
    {out_index};
    for (int k = 0; k < {width}; ++k)
        r[k] = x.data[{index_of}];
    return {returned};
"""


@wp.func_native(of_vertex_snippet)
def of_vertex(x: wp.array[wp.int32], i: Index) -> Index:
    """A whole number of a vertex for each lane."""
    ...


gathered_number_snippet = f"""
    {out64};
    for (int k = 0; k < {width}; ++k)
        r[k] = x.data[{index_of}];
    return {returned};
"""


@wp.func_native(gathered_number_snippet)
def gathered_number(x: wp.array[wp.float64], i: Index) -> simd.Lanes:
    """A number for each lane."""
    ...


corner_of_snippet = f"""
    {out_index};
    for (int k = 0; k < {width}; ++k) {{
        const long long written = keys.data[{index_of}], key = written < 0 ? ~written : written;
        const long long primitive = is_second != 0 ? key & 0xFFFFFFFFLL : key >> 32;
        r[k] = ((const int*)corners.data)[3LL * primitive + corner];
    }}
    return {returned};
"""


@wp.func_native(corner_of_snippet)
def corner_of(keys: wp.array[wp.int64], i: Index, is_second: int, corners: wp.array[wp.vec3i], corner: int) -> Index:
    """A vertex of a primitive of a pair for each lane; the key of an open pair is its complement."""
    ...


# the search lists the pairs of a query one after another, so the first primitives need no help
fetch_ahead_snippet = f"""
    const long long end = first + {width}LL < count ? first + {width}LL : count;
    const auto corners = [&](long long k) {{
        const long long written = keys.data[k], key = written < 0 ? ~written : written;
        return (const int*)second_corners.data + 3LL * (key & 0xFFFFFFFFLL);
    }};
    for (long long k = first; k < end; ++k) {{
        if (k + {width} < count)
            __builtin_prefetch(corners(k + {width}));
        const int* c = corners(k);
        for (int j = 0; j < 3; ++j) {{
            __builtin_prefetch(x_t0.data + c[j]);
            __builtin_prefetch(x_t1.data + c[j]);
        }}
    }}
"""


@wp.func_native(fetch_ahead_snippet)
def fetch_ahead(
    keys: wp.array[wp.int64],
    first: wp.int64,
    count: wp.int64,
    second_corners: wp.array[wp.vec3i],
    x_t0: wp.array[wp.vec3d],
    x_t1: wp.array[wp.vec3d],
):
    """Let the memory bring what the pairs of a block need, and the corners of those of the block after it."""
    ...


rows_from_snippet = f"""
    {out_index};
    for (int k = 0; k < {width}; ++k)
        r[k] = first + (k < count ? k : 0);
    return {returned};
"""


@wp.func_native(rows_from_snippet)
def rows_from(first: int, count: int) -> Index:
    """The rows from ``first`` on, one in each lane; lanes beyond ``count`` repeat the first."""
    ...


rows_of_snippet = f"""
    {out_index};
    for (int k = 0; k < {width}; ++k)
        r[k] = list[first + (k < count ? k : 0)];
    return {returned};
"""
numbers_of_snippet = f"""
    {out64};
    for (int k = 0; k < {width}; ++k)
        r[k] = list[first + (k < count ? k : 0)];
    return {returned};
"""


@wp.func_native(rows_of_snippet)
def rows_of(list: Rows, first: int, count: int) -> Index:
    """Rows of a list, one in each lane; lanes beyond ``count`` repeat the first."""
    ...


@wp.func_native(numbers_of_snippet)
def numbers_of(list: Numbers, first: int, count: int) -> simd.Lanes:
    """Numbers of a list, one in each lane; those beyond ``count`` repeat the first."""
    ...


number = "{0}" if width == 1 else "{0}[k]"
put_snippet = f"""
    for (int k = 0; k < {width}; ++k)
        if (k < count)
            x.data[{index_of}] = {{0}};
"""


@wp.func_native(put_snippet.format(number.format("a")))
def put(x: wp.array[wp.float64], i: Index, a: simd.Lanes, count: int):
    """x[i] = a in the first ``count`` lanes."""
    ...


@wp.func_native(put_snippet.format("(int)" + number.format("a")))
def put(x: wp.array[wp.int32], i: Index, a: simd.Lanes, count: int):  # noqa: F811
    ...


@wp.func_native(put_snippet.format(f"wp::vec_t<2, double>({number.format('a')}, {number.format('b')})"))
def put_vec2(x: wp.array[wp.vec2d], i: Index, a: simd.Lanes, b: simd.Lanes, count: int):
    """x[i] = (a, b) in the first ``count`` lanes."""
    ...


@wp.func_native(put_snippet.format(f"wp::vec_t<3, double>({', '.join(map(number.format, 'abc'))})"))
def put_vec3(x: wp.array[wp.vec3d], i: Index, a: simd.Lanes, b: simd.Lanes, c: simd.Lanes, count: int):
    """x[i] = (a, b, c) in the first ``count`` lanes."""
    ...


put_pairs_snippet = f"""
    for (int k = 0; k < {width}; ++k)
        if (k < count) {{
            const long long written = keys.data[{"rows" if width == 1 else "rows[k]"}];
            const long long key = written < 0 ? ~written : written;
            x.data[{index_of}] = wp::vec_t<2, wp::int32>((int)(key >> 32), (int)(key & 0xFFFFFFFFLL));
        }}
"""


@wp.func_native(put_pairs_snippet)
def put_pairs(x: wp.array[wp.vec2i], i: Index, keys: wp.array[wp.int64], rows: Index, count: int):
    """x[i] is the pair of a row in the first ``count`` lanes; the key of an open pair is its complement."""
    ...


if width > 1:
    row = lane_points.row

    @wp.func_native(lane_points.gather(width, "vertices[k]"))
    def gathered(x: wp.array[wp.vec3d], vertices: Index) -> lane_points.Rows:
        """The coordinates of a point for each lane, as rows."""
        ...

    @wp.func
    def gathered_point(x: wp.array[wp.vec3d], i: Index) -> simd.Vec3:
        """A point for each lane."""
        rows = gathered(x, i)
        return simd.vec(row(rows, 0), row(rows, 1), row(rows, 2))

else:

    @wp.func
    def gathered_point(x: wp.array[wp.vec3d], i: Index) -> simd.Vec3:
        """A point for each lane."""
        return x[i]


@wp.func
def points_of_rows(x: wp.array2d[wp.vec3d], rows: Index) -> Points:
    """The points of a row for each lane."""
    p = Points()
    p.p0 = simd.vec(gathered_row(x, rows, 0, 0), gathered_row(x, rows, 0, 1), gathered_row(x, rows, 0, 2))
    p.p1 = simd.vec(gathered_row(x, rows, 1, 0), gathered_row(x, rows, 1, 1), gathered_row(x, rows, 1, 2))
    p.p2 = simd.vec(gathered_row(x, rows, 2, 0), gathered_row(x, rows, 2, 1), gathered_row(x, rows, 2, 2))
    p.p3 = simd.vec(gathered_row(x, rows, 3, 0), gathered_row(x, rows, 3, 1), gathered_row(x, rows, 3, 2))
    return p


@wp.func
def points_of_vertices(x: wp.array[wp.vec3d], i0: Index, i1: Index, i2: Index, i3: Index) -> Points:
    """Four vertices of a mesh for each lane."""
    p = Points()
    p.p0 = gathered_point(x, i0)
    p.p1 = gathered_point(x, i1)
    p.p2 = gathered_point(x, i2)
    p.p3 = gathered_point(x, i3)
    return p


@wp.struct
class LaneVertices:
    """The vertices of a pair of primitives for each lane."""

    i0: Index
    i1: Index
    i2: Index
    i3: Index


@wp.func
def vertices_of_pairs(pairs: PairList, rows: Index) -> LaneVertices:
    """The vertices of a pair of primitives of a mesh for each lane, in the order of its points."""
    r = LaneVertices()
    r.i0 = corner_of(pairs.keys, rows, 0, pairs.first_corners, 0)
    r.i1 = corner_of(pairs.keys, rows, 1, pairs.second_corners, 0)
    r.i2 = corner_of(pairs.keys, rows, 1, pairs.second_corners, 1)
    r.i3 = corner_of(pairs.keys, rows, 1, pairs.second_corners, 2)
    if pairs.kind == EDGE_EDGE:
        r.i3 = r.i2
        r.i2 = r.i1
        r.i1 = corner_of(pairs.keys, rows, 0, pairs.first_corners, 1)
    return r


@wp.func
def points_of_pairs(pairs: PairList, rows: Index):
    """The points of a pair of primitives of a mesh for each lane, at both ends of the step."""
    i = vertices_of_pairs(pairs, rows)
    a = points_of_vertices(pairs.vertices_t0, i.i0, i.i1, i.i2, i.i3)
    return a, points_of_vertices(pairs.vertices_t1, i.i0, i.i1, i.i2, i.i3)


if norm.has_arcs:
    arcs = specialised("pair.arcs", norm=norm, width=width)
    Arcs = arcs.Arcs
    turns_anywhere = arcs.turns_anywhere

    @simd.func
    def arcs_of_pairs(pairs: PairList, rows: Index, turns: Turns) -> Arcs:
        """How the points of a pair of primitives of a mesh turn, for each lane."""
        i = vertices_of_pairs(pairs, rows)
        r = Arcs()
        body = of_vertex(turns.vertex_body, i.i0)
        r.t_begin = gathered_number(turns.t_begin, body)
        r.t_length = gathered_number(turns.t_end, body) - r.t_begin
        r.spin_a = r.t_length * gathered_point(turns.omega, body)
        r.spin_b = r.t_length * gathered_point(turns.omega, of_vertex(turns.vertex_body, i.i3))
        if turns_anywhere(r):
            r.v0 = gathered_point(turns.velocity, i.i0)
            r.v1 = gathered_point(turns.velocity, i.i1)
            r.v2 = gathered_point(turns.velocity, i.i2)
            r.v3 = gathered_point(turns.velocity, i.i3)
        of_a = gathered_number(turns.slack, i.i0)
        of_b = simd.greatest(gathered_number(turns.slack, i.i2), gathered_number(turns.slack, i.i3))
        of_second = gathered_number(turns.slack, i.i1)
        if pairs.kind == EDGE_EDGE:
            of_a = simd.greatest(of_a, of_second)
        else:
            of_b = simd.greatest(of_b, of_second)
        r.slack = of_a + of_b
        of_both = gathered_number(turns.excess, body)
        r.excess = of_both + gathered_number(turns.excess, of_vertex(turns.vertex_body, i.i3))
        return r
