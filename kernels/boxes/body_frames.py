"""The AABBs of slender bodies for the search among their own primitives, each in a frame that moves with the body.

What is long and oblique to the axes has a large AABB, however thin it is, so n needles side by side have n² AABBs that
overlap. The search for pairs *within* a body may compare them in any frame. Here the first axis is along an edge of the
body at the start of the step, so the frame turns with the body from step to step, and the origin is a vertex of that
edge at either end of the step, so what the body shares of its motion cancels, and the size of the AABBs is not lost in
the rounding of coordinates far from the origin of the scene.

**No pair is lost.** Let a_k be the three vectors as they were computed, whatever they are worth, and o(t) the position
of the origin, the same for all of a body. Where two points x and y of the body meet, a_k·(x - o) = a_k·(y - o), and
where their coordinates differ by at most d, these two numbers differ by at most d·Σ|a_ki|; a ball of radius d lies in
that box. These numbers are linear in the point and in time, so an AABB of the end points of a step that has them for
each vertex, grown by its share of d times Σ|a_ki|, proves what an AABB along the axes of the scene proves (`box_tree`).

**Rounding** (u = 2^-53). All is in quarters, so that no sum overflows: with |a_ki| ≤ 1 + 4u and coordinates below
2^1024 the sum of |a_ki|·|x_i - o_i|/4 is below 2^1023·√3·(1 + 8u), a finite number. The quarter of a number is exact, or
off by 2^-1075 where it is subnormal. h = x/4 - o/4 rounds once, u·|h|; at the end of a shorter step (1 - t)·h_0 + t·h_1
is off by another 3.1u·m and 2^-1073, m the larger of |h_0| and |h_1| (rounding, step 12). Three products with a_ki and
two sums add 3.1u·Σ|a_ki|·m_i and 2^-1073, in all less than 7.5u·Σ|a_ki|·m_i + 2^-1070: ERROR = 16 and 2^-1060 are taken.
Each term of the half side is positive and passes at most eight roundings, which the factor 1 + 16u covers. The last
subtraction rounds to nearest, and its neighbour bounds the exact value (`inflated_below`). What follows, a power of two,
float32 and the cell of the body (`in_cell`), is monotone, so AABBs that meet in exact numbers meet in quantized ones.
"""

import warp as wp

from ..pair.simd import cross, dot, magnitude
from .box_tree import in_cell, write_vertex_aabb
from .boxes import inflated_below
from .lanes import vec8f

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_UNIT_ROUNDOFF = 2.0**-53
_ERROR = wp.constant(wp.float64(16.0 * _UNIT_ROUNDOFF))
_UP = wp.constant(wp.float64(1.0 + 16.0 * _UNIT_ROUNDOFF))
_UNDERFLOW = wp.constant(wp.float64(2.0**-1060))
_QUARTER = wp.constant(wp.float64(0.25))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_INFINITY = wp.constant(wp.float32(wp.inf))


@wp.struct
class BodyFrames:
    """The frames of slender bodies, each with a cell of a lattice in quantized coordinates."""

    of_vertex: wp.array[wp.int32]  # whose frame each vertex is seen in
    edge: wp.array[wp.vec2i]  # its vertices: the origin, and where the first axis points to
    cell: wp.array[wp.vec4f]  # the middle of each cell; the fourth number is not used
    scale: wp.array[wp.float64]  # of quarters of coordinates, a power of two: most of the body maps to its cell
    inner: wp.float32  # half of half a cell


@wp.func
def unit_along(d: wp.vec3d) -> wp.vec3d:
    """d over its length, with components of at most 1 + 4u; the first axis if d vanishes or is no number."""
    size = magnitude(d)
    largest = wp.max(size[0], wp.max(size[1], size[2]))
    if not largest > _ZERO:
        return wp.vec3d(_ONE, _ZERO, _ZERO)
    d = wp.vec3d(d[0] / largest, d[1] / largest, d[2] / largest)
    length = wp.sqrt(dot(d, d))
    return wp.vec3d(d[0] / length, d[1] / length, d[2] / length)


@wp.func
def across(d: wp.vec3d) -> wp.vec3d:
    """A unit vector perpendicular to a unit vector, but for rounding."""
    size = magnitude(d)
    other = wp.vec3d(_ZERO, _ZERO, _ONE)
    if size[0] <= size[1] and size[0] <= size[2]:
        other = wp.vec3d(_ONE, _ZERO, _ZERO)
    elif size[1] <= size[2]:
        other = wp.vec3d(_ZERO, _ONE, _ZERO)
    return unit_along(cross(d, other))


@wp.kernel
def fill_frame_aabbs(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertex_body: wp.array[wp.int32],
    body_active: wp.array[wp.int32],
    frames: BodyFrames,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t_end: wp.float64,
    inflation: wp.float64,
    box_radius: wp.array[wp.float64],
    # out
    vertex_aabbs: wp.array[wp.float32],
):
    """Write both endpoint AABBs of each vertex in the frame of its body, stored as by `fill_vertex_aabbs`."""
    v = vertices[begin + wp.tid()]
    frame = frames.of_vertex[v]
    cell = frames.cell[frame]
    scale = frames.scale[frame]
    edge = frames.edge[frame]
    o_t0 = _QUARTER * vertices_t0[edge[0]]
    first = unit_along(_QUARTER * vertices_t0[edge[1]] - o_t0)
    second = across(first)
    third = cross(first, second)
    reach = _QUARTER * inflation
    if box_radius.shape[0] > 0:
        reach += _QUARTER * box_radius[v]
    h = _QUARTER * vertices_t0[v] - o_t0
    m = magnitude(h)
    for n in range(2):
        if n == 1:
            end = _QUARTER * vertices_t1[v] - _QUARTER * vertices_t1[edge[0]]
            size = magnitude(end)
            if t_end < _ONE:
                h = (_ONE - t_end) * h + t_end * end
                m = wp.max(m, size)
            else:
                h = end
                m = size
        aabb = vec8f(_INFINITY)
        p = wp.vec3d(dot(first, h), dot(second, h), dot(third, h))
        # a sum of what is no number is none
        if body_active[vertex_body[v]] != 0 and p[0] + p[1] + p[2] == p[0] + p[1] + p[2]:
            lower = wp.vec3f()
            upper = wp.vec3f()
            for k in range(3):
                a = magnitude(wp.where(k == 0, first, wp.where(k == 1, second, third)))
                half = _UP * (_ERROR * dot(a, m) + (a[0] + a[1] + a[2]) * reach + _UNDERFLOW)
                lower[k] = wp.float32(inflated_below(p[k], half) * scale)
                upper[k] = wp.float32(-inflated_below(-p[k], half) * scale)
            lower = in_cell(lower, cell, frames.inner)
            upper = in_cell(upper, cell, frames.inner)
            zero = wp.float32(0.0)
            aabb = vec8f(lower[0], lower[1], lower[2], zero, -upper[0], -upper[1], -upper[2], zero)
        write_vertex_aabb(vertex_aabbs, 2 * v + n, aabb)
