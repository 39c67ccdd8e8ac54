"""The AABBs of slender bodies for the search among their own primitives, each in a frame that moves with the body.

What is long and oblique to the axes has a large AABB, however thin it is, so n needles side by side have n² AABBs that
overlap. The search for pairs *within* a body may compare them in any frame. Here the origin is a vertex of the body at
either end of the step, so what the body shares of its motion cancels, and the size of the AABBs is not lost in the
rounding of coordinates far from the origin of the scene. The first axis is along an edge from there, at either end, so
the frame turns with the body; the second one is perpendicular to the edge at both ends and stays, and the third one is
perpendicular to both others. Needles parallel to the edge are thin along these two, at every time of the step.

**No pair is lost.** Let a_k(t) = (1-t)·a_k(0) + t·a_k(1) be an axis, of whatever vectors were computed, and o(t) the
position of the origin, the same for all of a body; t runs from 0 to 1 over the part of the step that is searched. Where
two points x and y of the body meet, c_x = a_k·(x - o) and c_y = a_k·(y - o) are equal. Each is a quadratic function of
time, whose Bernstein coefficients, a_k(0)·(x - o)(0), (a_k(0)·(x - o)(1) + a_k(1)·(x - o)(0))/2 and a_k(1)·(x - o)(1),
are linear in the point: those of a primitive's points lie between those of its vertices. So if all three of one
primitive are less than those of another, the two never meet. The first AABB holds the first coefficient, and the second
one the others, if the edge turns by much. Else it holds the last alone: the middle one is the mean of the others less
(a_k(1) - a_k(0))·((x - o)(1) - (x - o)(0))/2, by whose magnitude both AABBs then grow, so that the mean of what is
apart in both is apart by what the middle coefficients may differ from it. It is the square of the angle in a turn, and
nothing along an axis that stays. Primitives that come within d of each other along all axes of the scene, or in any
direction, differ by at most d·Σ|a_ki(t)|; |a_ki(t)| is at most A_i, the larger of its values at both ends, so each AABB
grows by its share of d times ΣA_i.

**Rounding** (u = 2^-53). All is in quarters, so that no sum of products overflows: axes have a length of 1 but for 8u,
and coordinates are below 2^1024, so sums of |a_ki|·|x_i - o_i|/4 are below √3·(1 + 8u)·2^1023, a finite number, and so
is half the sum of two. The quarter of a number is exact, or off by 2^-1075 where it is subnormal. h = x/4 - o/4 rounds
once, u·|h|; at the end of a shorter step (1 - t)·h_0 + t·h_1 is off by another 3.1u·m and 2^-1073, m the larger of
|h_0| and |h_1| (rounding, step 12). Three products with a_ki and two sums add 3.1u·ΣA_i·m_i and 2^-1073, the mean of
two of them u, in all less than 8.5u·ΣA_i·m_i + 2^-1070. The growth is off by another 19u·ΣA_i·m_i at most, as its two
differences are at most 2A_i and 2m_i, off by 2u·A_i and 10.4u·m_i: ERROR = 32 and 2^-1060 are taken. Each term of the
half side is positive and passes at most ten roundings, which the factor 1 + 16u covers. The last subtraction rounds to
nearest, and its neighbour bounds the exact value (`inflated_below`). Where it overflows, as for a growth near the
largest number, the largest finite number takes its place there, beyond which no coordinate lies. What follows, a power
of two, float32 and the cell of the body (`in_cell`), is monotone, so AABBs that meet in exact numbers meet in quantized
ones.

References: Redon, Kheddar, Coquillart 2002, "Fast continuous collision detection between rigid bodies" (boxes that turn
with the bodies).
"""

import warp as wp

from ..pair.simd import cross, dot, magnitude
from .box_tree import BodyFrames, in_cell, write_vertex_aabb
from .boxes import inflated_below
from .lanes import vec8f

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_UNIT_ROUNDOFF = 2.0**-53
_ERROR = wp.constant(wp.float64(32.0 * _UNIT_ROUNDOFF))
_UP = wp.constant(wp.float64(1.0 + 16.0 * _UNIT_ROUNDOFF))
_UNDERFLOW = wp.constant(wp.float64(2.0**-1060))
_HALF = wp.constant(wp.float64(0.5))
_QUARTER = wp.constant(wp.float64(0.25))
# Sines of angles: of one that rounding does not hide, and of one whose square is no longer small.
_LEAST_SINE = wp.constant(wp.float64(2.0**-20))
_LARGE_SINE = wp.constant(wp.float64(2.0**-6))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_INFINITY = wp.constant(wp.float32(wp.inf))


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
def sine_between(d: wp.vec3d, e: wp.vec3d) -> wp.float64:
    """The largest component of the cross product of two unit vectors, some 0.6 to 1 of the sine of their angle."""
    normal = magnitude(cross(d, e))
    return wp.max(normal[0], wp.max(normal[1], normal[2]))


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


@wp.func
def aabb_in_cell(lower: wp.vec3f, upper: wp.vec3f, cell: wp.vec4f, inner: wp.float32, is_seen: bool) -> vec8f:
    """An AABB in quantized coordinates as it is stored, empty if it is not to be seen."""
    if not is_seen:
        return vec8f(_INFINITY)
    low = in_cell(lower, cell, inner)
    high = in_cell(upper, cell, inner)
    zero = wp.float32(0.0)
    return vec8f(low[0], low[1], low[2], zero, -high[0], -high[1], -high[2], zero)


@wp.func
def at_end(h_t0: wp.vec3d, h_t1: wp.vec3d, t_end: wp.float64) -> wp.vec3d:
    """A vector at the end of the part of the step that is searched."""
    if t_end < _ONE:
        return (_ONE - t_end) * h_t0 + t_end * h_t1
    return h_t1


@wp.struct
class FrameAxes:
    """Two axes of the frame of a body, whose edge is along the first of them."""

    first: wp.vec3d  # at the start of the step
    turned: wp.vec3d  # at its end
    second: wp.vec3d  # across both
    sine: wp.float64  # of the angle between the first axis at both ends


@wp.func
def axes_along(edge_t0: wp.vec3d, edge_end: wp.vec3d) -> FrameAxes:
    """The axes of a body whose edge goes this way at both ends."""
    r = FrameAxes()
    r.first = unit_along(edge_t0)
    r.turned = unit_along(edge_end)
    r.sine = sine_between(r.first, r.turned)
    r.second = across(r.first)
    if r.sine > _LEAST_SINE:
        r.second = unit_along(cross(r.first, r.turned))
    else:
        r.turned = r.first
    return r


@wp.func
def axis(k: int, first: wp.vec3d, second: wp.vec3d) -> wp.vec3d:
    """One of three axes, of which the last is across the others."""
    if k == 0:
        return first
    if k == 1:
        return second
    return cross(first, second)


@wp.kernel(cuda_max_registers=128)
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
    """Write both AABBs of each vertex in the frame of its body, stored as by `fill_vertex_aabbs`."""
    v = vertices[begin + wp.tid()]
    frame = frames.of_vertex[v]
    cell = frames.cell[frame]
    scale = frames.scale[frame]
    edge = frames.edge[frame]
    o_t0 = _QUARTER * vertices_t0[edge[0]]
    o_t1 = _QUARTER * vertices_t1[edge[0]]
    along = _QUARTER * vertices_t0[edge[1]] - o_t0
    axes = axes_along(along, at_end(along, _QUARTER * vertices_t1[edge[1]] - o_t1, t_end))
    h = _QUARTER * vertices_t0[v] - o_t0
    h_t1 = _QUARTER * vertices_t1[v] - o_t1
    end = at_end(h, h_t1, t_end)
    m = wp.max(magnitude(h), magnitude(h_t1))
    reach = _QUARTER * inflation
    if box_radius.shape[0] > 0:
        reach += _QUARTER * box_radius[v]
    lower_t0 = wp.vec3f()
    upper_t0 = wp.vec3f()
    lower_t1 = wp.vec3f()
    upper_t1 = wp.vec3f()
    is_number = bool(True)
    for k in range(3):
        a = axis(k, axes.first, axes.second)
        b = axis(k, axes.turned, axes.second)
        largest = wp.max(magnitude(a), magnitude(b))
        half = _ERROR * dot(largest, m) + (largest[0] + largest[1] + largest[2]) * reach + _UNDERFLOW
        p = dot(a, h)
        low = dot(b, end)
        high = low
        is_number = is_number and p == p and low == low
        if k != 1 and axes.sine > _LARGE_SINE:
            middle = _HALF * (dot(a, end) + dot(b, h))
            is_number = is_number and middle == middle
            low = wp.min(low, middle)
            high = wp.max(high, middle)
        else:
            half += _HALF * wp.abs(dot(b - a, end - h))
        half = _UP * half
        lower_t0[k] = wp.float32(inflated_below(p, half) * scale)
        upper_t0[k] = wp.float32(-inflated_below(-p, half) * scale)
        lower_t1[k] = wp.float32(inflated_below(low, half) * scale)
        upper_t1[k] = wp.float32(-inflated_below(-high, half) * scale)
    is_seen = is_number and body_active[vertex_body[v]] != 0
    write_vertex_aabb(vertex_aabbs, 2 * v, aabb_in_cell(lower_t0, upper_t0, cell, frames.inner, is_seen))
    write_vertex_aabb(vertex_aabbs, 2 * v + 1, aabb_in_cell(lower_t1, upper_t1, cell, frames.inner, is_seen))
