"""The cull: inclusion tests over the whole step, which discard most candidates of a broad phase.

The first test is the hull of the volume (`volume`) in float64, on the corners without normalisation: about 90 flops, no
division, no branch. The bound is that of `rounding`, step 9, with sums of magnitudes where `volume` takes maxima.
Underflow is covered by an absolute term that grows with P, so the scales of the axes may differ arbitrarily. Where a
product of three lengths comes near overflow, or is so small that the absolute term exceeds it (lengths far below
2^-250), the test proves nothing and the pair is passed on to the solver, which normalises.

A pair in one plane has no volume. For it there is a second test, along the directions in that plane across each side:
no other directions are needed to separate two convex figures in a plane. Its bound is that of `rounding`, step 11.

Several candidates are culled at once, one in each lane (`simd`). The second test runs if the first leaves a lane open.
A separation is a box, or with ``is_euclidean`` a ball. A comparison with NaN is false, and only comparisons prove
anything, so a pair with a number that is not finite stays open.
"""

import warp as wp

from ..pair import simd
from ..pair.norm import Norm
from ..pair.patch import Corners
from ..pair.rounding import NORMAL, SIDES, SQUARE_UNDERFLOW, UNIT_ROUNDOFF, VOLUME
from ..pair.simd import (
    Lanes,
    Mask,
    Vec3,
    bits_of,
    cross,
    dot,
    greatest,
    is_less,
    magnitude,
    minus,
    select,
    spread,
    square_root,
    vec,
)
from ..pair_kind import EDGE_EDGE, VERTEX_FACE
from ..parameters import is_thick, width
from ..template import specialised

_BOUND = wp.constant(wp.float64((VOLUME + 1.0) * UNIT_ROUNDOFF[wp.float64]))
_SEPARATION_UP = wp.constant(wp.float64(1.0 + 32.0 * UNIT_ROUNDOFF[wp.float64]))
_NORMAL = wp.constant(wp.float64(NORMAL * UNIT_ROUNDOFF[wp.float64]))
_GUARD = wp.constant(wp.float64(2.0**-800))
_LARGEST = wp.constant(wp.float64(2.0**750))
_SIDES = wp.constant(wp.float64(SIDES * UNIT_ROUNDOFF[wp.float64]))
_SIDES_UNDERFLOW = wp.constant(wp.float64(2.0**-1060))
_SQUARE_UNDERFLOW = wp.constant(wp.float64(SQUARE_UNDERFLOW[wp.float64]))
_QUARTER = wp.constant(wp.float64(0.25))
_THIRD = wp.constant(wp.float64(1.0 / 3.0))
_ONE = wp.constant(wp.float64(1.0))
_ZERO = wp.constant(wp.float64(0.0))
_NONE = wp.constant(wp.uint32(0))


length = specialised("pair.support", width=width, norm=Norm.EUCLIDEAN).length
Separation = Lanes if is_thick else wp.float64

if is_thick:

    @wp.func
    def has_separation(separation: Separation) -> bool:
        """Whether a lane may have a separation."""
        return True

    @simd.func
    def with_one(separation: Separation) -> Lanes:
        """One more than the separation."""
        return _ONE + separation

    @simd.func
    def enlarged(separation: Separation) -> Separation:
        """The separation, enlarged by more than the roundings of its products."""
        return _SEPARATION_UP * separation

else:

    @wp.func
    def has_separation(separation: Separation) -> bool:
        """Whether there is a separation."""
        return separation > _ZERO

    @wp.func
    def with_one(separation: Separation) -> Lanes:
        """One more than the separation."""
        return spread(_ONE + separation)

    @wp.func
    def enlarged(separation: Separation) -> Separation:
        """The separation, enlarged by more than the roundings of its products."""
        return separation * _SEPARATION_UP


@simd.func
def is_free_by_volume(c0: Corners, c1: Corners, separation: Separation, is_euclidean: int, t_end: wp.float64) -> Mask:
    """Whether the volume keeps its sign on [0, t_end], with a magnitude that excludes a contact."""
    n0 = cross(c0.q, c0.r)
    n1 = cross(c1.q, c1.r)
    nm = cross(c0.q, c1.r) + cross(c1.q, c0.r)  # twice the middle coefficient of Q×R
    b0 = dot(c0.w00, n0)
    b1 = _THIRD * (dot(c1.w00, n0) + dot(c0.w00, nm))
    b2 = _THIRD * (dot(c0.w00, n1) + dot(c1.w00, nm))
    b3 = dot(c1.w00, n1)
    p = magnitude(c0.w00) + magnitude(c1.w00)
    q = magnitude(c0.q) + magnitude(c1.q)
    r = magnitude(c0.r) + magnitude(c1.r)
    n = vec(q.y * r.z + q.z * r.y, q.z * r.x + q.x * r.z, q.x * r.y + q.y * r.x)
    size = dot(p, n)
    # an underflow in Q×R is multiplied by P and by the separation
    bound = _BOUND * size + _GUARD * (with_one(separation) + p.x + p.y + p.z)
    if has_separation(separation):
        if is_euclidean != 0:
            # the length of the normal at any time is at most those of its coefficients (rounding, step 13)
            squared = greatest(greatest(dot(n0, n0), dot(n1, n1)), _QUARTER * dot(nm, nm))
            longest = square_root(squared + _SQUARE_UNDERFLOW) + _NORMAL * (n.x + n.y + n.z)
            bound = bound + enlarged(separation) * longest
        else:
            # |n_k| of the normal at any time is at most n_k, so this bounds the sum of separation and rounding
            bound = bound + enlarged(separation) * (n.x + n.y + n.z)
    if t_end < _ONE:
        # the blossom on [0, t_end]
        s = _ONE - t_end
        t0 = s * b0 + t_end * b1
        t1 = s * b1 + t_end * b2
        t2 = s * b2 + t_end * b3
        b1 = t0
        b2 = s * t0 + t_end * t1
        b3 = s * b2 + t_end * (s * t1 + t_end * t2)
    is_negative = is_less(b0, _ZERO)
    b1 = select(is_negative, minus(b1), b1)
    b2 = select(is_negative, minus(b2), b2)
    b3 = select(is_negative, minus(b3), b3)
    beyond = is_less(bound, magnitude(b0)) & is_less(bound, b1)
    beyond = beyond & is_less(bound, b2) & is_less(bound, b3)
    limit = spread(_LARGEST)
    return beyond & is_less(size, limit) & is_less(bound, limit)


@simd.func
def later(a: Lanes, b: Lanes, t_end: wp.float64) -> Lanes:
    """A linear function at ``t_end`` from its values at 0 and 1."""
    if t_end < _ONE:
        b = (_ONE - t_end) * a + t_end * b
    return b


@simd.func
def is_free_along(
    d: Vec3,
    is_triangle: bool,
    c0: Corners,
    c1: Corners,
    size: Vec3,
    separation: Separation,
    is_euclidean: int,
    t_end: wp.float64,
) -> Mask:
    """Whether all corners stay on one side of the origin along d (rounding, step 11)."""
    m = magnitude(d)
    bound = _SIDES * dot(m, size) + _SIDES_UNDERFLOW
    if has_separation(separation):
        if is_euclidean != 0:
            bound = bound + enlarged(separation) * length(d)
        else:
            bound = bound + enlarged(separation) * (m.x + m.y + m.z)
    a = dot(d, c0.w00)
    # turned to the side of the first corner
    d = select(is_less(a, _ZERO), minus(d), d)
    a = magnitude(a)
    beyond = is_less(bound, a) & is_less(bound, later(a, dot(d, c1.w00), t_end))
    a = dot(d, c0.w01)
    beyond = beyond & is_less(bound, a) & is_less(bound, later(a, dot(d, c1.w01), t_end))
    a = dot(d, c0.w10)
    beyond = beyond & is_less(bound, a) & is_less(bound, later(a, dot(d, c1.w10), t_end))
    if not is_triangle:
        a = dot(d, c0.w11)
        beyond = beyond & is_less(bound, a) & is_less(bound, later(a, dot(d, c1.w11), t_end))
    return beyond & is_less(bound, _LARGEST)


@simd.func
def is_free_by_sides(
    kind: int, c0: Corners, c1: Corners, separation: Separation, is_euclidean: int, t_end: wp.float64
) -> Mask:
    """Whether a direction across a side, in the plane of both at the start, separates the pair on [0, t_end]."""
    n = cross(c0.q, c0.r)
    size = greatest(magnitude(c0.w00), magnitude(c1.w00))
    size = greatest(size, greatest(magnitude(c0.w01), magnitude(c1.w01)))
    size = greatest(size, greatest(magnitude(c0.w10), magnitude(c1.w10)))
    is_triangle = kind == VERTEX_FACE
    if not is_triangle:
        size = greatest(size, greatest(magnitude(c0.w11), magnitude(c1.w11)))
    free = is_free_along(cross(n, c0.q), is_triangle, c0, c1, size, separation, is_euclidean, t_end)
    free = free | is_free_along(cross(n, c0.r), is_triangle, c0, c1, size, separation, is_euclidean, t_end)
    if is_triangle:
        free = free | is_free_along(cross(n, c0.q - c0.r), is_triangle, c0, c1, size, separation, is_euclidean, t_end)
    return free


@wp.func
def has_volume(kind: int) -> bool:
    """Whether the cull has a test for a pair kind; the patches of other kinds have no volume."""
    return kind == EDGE_EDGE or kind == VERTEX_FACE


@wp.func
def free_lanes(
    kind: int,
    c0: Corners,
    c1: Corners,
    separation: Separation,
    is_euclidean: int,
    t_end: wp.float64,
    needed: wp.uint32,
) -> wp.uint32:
    """Bits of the lanes for which a test proves that there is no contact on [0, t_end]; others are not needed."""
    free = bits_of(is_free_by_volume(c0, c1, separation, is_euclidean, t_end))
    if (needed & ~free) != _NONE:
        free = free | bits_of(is_free_by_sides(kind, c0, c1, separation, is_euclidean, t_end))
    return free
