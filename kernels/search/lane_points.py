"""The points of several pairs at once, one pair in each lane, from the vertices that the cull has collected."""

from typing import Any

import warp as wp

from ..pair.points import Points
from ..pair.simd import Lanes, Vec3, header, vec
from ..parameters import width


def gather(width: int, vertex: str) -> str:
    """C++ that loads the point of a vertex, an expression in k, for each lane, as rows of x, y and z.

    x and y are loaded together and then sorted into rows, which takes fewer instructions than to insert each number; a
    load of four numbers would reach beyond the last vertex.
    """
    even, odd = ([f"load({k})" for k in range(first, width, 2)] for first in (0, 1))
    while len(even) > 1:  # two vectors of a size are joined to one of twice the size
        places = ", ".join(map(str, range(2 * width // len(even))))
        even, odd = (
            [f"__builtin_shufflevector({a}, {b}, {places})" for a, b in zip(v[::2], v[1::2], strict=True)]
            for v in (even, odd)
        )
    x_places, y_places = (", ".join(f"{k + c}, {k + c + width}" for k in range(0, width, 2)) for c in (0, 1))
    return (
        header(wp.float64, width)
        + f"""
    typedef double Two __attribute__((ext_vector_type(2)));
    typedef double Loaded __attribute__((ext_vector_type(2), aligned(8)));
    const auto at = [&](int k) {{ return (const double*)x.data + 3LL * {vertex}; }};
    const auto load = [&](int k) {{ return (Two)*(const Loaded*)at(k); }};
    const Lanes even = {even[0]};
    const Lanes odd = {odd[0]};
    const Lanes rows[3] = {{
        __builtin_shufflevector(even, odd, {x_places}),
        __builtin_shufflevector(even, odd, {y_places}),
        {{{", ".join(f"at({k})[2]" for k in range(width))}}},
    }};
    wp::vec_t<{3 * width}, double> r;
    __builtin_memcpy(&r, &rows, sizeof(rows));
    return r;
"""
    )


_ROW = """
    wp::vec_t<{width}, double> r;
    __builtin_memcpy(&r, &rows.c[{width} * axis], sizeof(r));
    return r;
"""


if width > 1:
    Rows: Any = wp.types.vector(length=3 * width, dtype=wp.float64)

    @wp.func_native(gather(width, "vertices.data[first + k]"))
    def gathered(x: wp.array[wp.vec3d], vertices: wp.array[wp.int32], first: int) -> Rows:
        """The coordinates of the points of all lanes, as rows."""
        ...

    @wp.func_native(_ROW.format(width=width))
    def row(rows: Rows, axis: int) -> Lanes:
        """A row of the coordinates."""
        ...

    @wp.func
    def point_at(x: wp.array[wp.vec3d], vertices: wp.array[wp.int32], first: int) -> Vec3:
        """The point of a vertex for each lane; that of lane k is ``vertices[first + k]``."""
        rows = gathered(x, vertices, first)
        return vec(row(rows, 0), row(rows, 1), row(rows, 2))

else:

    @wp.func
    def point_at(x: wp.array[wp.vec3d], vertices: wp.array[wp.int32], first: int) -> Vec3:
        """The point of a vertex."""
        return x[vertices[first]]


@wp.func
def points_at(x: wp.array[wp.vec3d], vertices: wp.array[wp.int32], first: int, stride: int) -> Points:
    """The points of a pair for each lane; the vertices of lane k are ``vertices[first + k + n * stride]``."""
    p = Points()
    p.p0 = point_at(x, vertices, first)
    p.p1 = point_at(x, vertices, first + stride)
    p.p2 = point_at(x, vertices, first + 2 * stride)
    p.p3 = point_at(x, vertices, first + 3 * stride)
    return p
