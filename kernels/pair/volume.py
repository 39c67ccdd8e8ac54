"""The volume f(t) = P·(Q×R) as an inclusion function: as long as it keeps its sign there is no contact.

A contact makes P, Q, R linearly dependent, so f = 0 is necessary for a contact anywhere on the patch. With a separation
box, n·F = f for the moving normal n = Q×R, so |f| ≤ Σ separation_k·|n_k| is necessary; with a ball of radius D,
|f| ≤ D·|n| is. f is a cubic in t. The convex hull of its Bernstein coefficients bounds it on any interval, and a clip
ends before the hull falls to zero: where the steepest line from the first coefficient to another does. That is the
first crossing of the hull itself wherever the other coefficient is beyond zero, no later elsewhere, and takes one
division. It converges quadratically to a simple
root, from below. No root is ever *computed* here: the univariate method decides by the roots and misses collisions,
whereas this one only skips times at which f is certainly not zero. Where f vanishes identically (motion in one plane)
it skips nothing, and the directions of `inclusion` make the progress.
"""

import warp as wp

from ..parameters import real
from . import simd
from .patch import Corners, Volume
from .rounding import CROSSING, RELATIVE, RESTRICTION, TINY, UNIT_ROUNDOFF, VOLUME
from .simd import Lanes, Vec3, cross, dot, greatest, is_at_most, is_less, least, magnitude, minus, select, vec
from .support import support

# float32 rounds coefficients that are computed in float64, and restricts them.
coefficient_bound = wp.constant(real(VOLUME * UNIT_ROUNDOFF[wp.float64]))
restriction_bound = wp.constant(real(RESTRICTION * UNIT_ROUNDOFF[real]))
normal_bound = wp.constant(real(VOLUME * UNIT_ROUNDOFF[real]))
tiny = wp.constant(real(TINY[real]))
zero = wp.constant(real(0.0))
half = wp.constant(real(0.5))
third = wp.constant(real(1.0 / 3.0))
one = wp.constant(real(1.0))
one_and_half = wp.constant(real(1.5))
three = wp.constant(real(3.0))
four = wp.constant(real(4.0))
round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
fraction_down = wp.constant(real(1.0 - CROSSING * UNIT_ROUNDOFF[real]))


@wp.struct
class Hull:
    """Four control points of a cubic on an interval."""

    c0: Lanes
    c1: Lanes
    c2: Lanes
    c3: Lanes


if real == wp.float64:

    @simd.func
    def coefficients_of(t0: Corners, t1: Corners) -> Volume:
        """The Bernstein coefficients of f and of Q×R on [0, 1], which float32 takes from here, too."""
        f = Volume()
        n0 = cross(t0.q, t0.r)
        n1 = cross(t1.q, t1.r)
        nm = half * (cross(t0.q, t1.r) + cross(t1.q, t0.r))
        m0 = dot(t0.w00, nm)
        m1 = dot(t1.w00, nm)
        f.b0 = dot(t0.w00, n0)
        f.b1 = third * (dot(t1.w00, n0) + m0 + m0)
        f.b2 = third * (dot(t0.w00, n1) + m1 + m1)
        f.b3 = dot(t1.w00, n1)
        f.normal_t0 = n0
        f.normal_mid = nm
        f.normal_t1 = n1
        return f


@simd.func
def bounded(f: Volume, t0: Corners, t1: Corners, separation: Vec3, has_separation: bool) -> Volume:
    """The volume of these coefficients, in float32 rounded ones, with the bound below which |f| proves nothing."""
    r = f
    p = greatest(magnitude(t0.w00), magnitude(t1.w00))
    q = greatest(magnitude(t0.q), magnitude(t1.q))
    s = greatest(magnitude(t0.r), magnitude(t1.r))
    # the sums of the magnitudes of the products of Q×R, and of the determinant
    n = vec(q.y * s.z + q.z * s.y, q.z * s.x + q.x * s.z, q.x * s.y + q.y * s.x)
    largest = greatest(greatest(magnitude(r.b0), magnitude(r.b1)), greatest(magnitude(r.b2), magnitude(r.b3)))
    r.bound = coefficient_bound * dot(p, n) + tiny
    if wp.static(real == wp.float32):
        r.bound = r.bound + restriction_bound * largest
    if has_separation:
        r.bound = r.bound + normal_bound * dot(separation, n)
    r.is_flat = is_at_most(largest, r.bound)
    return r


@simd.func
def restrict(f: Volume, t: Lanes, x: Lanes) -> Hull:
    """Bernstein coefficients on [t, x]: the blossom of those on [0, 1]."""
    ct = one - t
    cx = one - x
    t0 = ct * f.b0 + t * f.b1
    t1 = ct * f.b1 + t * f.b2
    t2 = ct * f.b2 + t * f.b3
    x0 = cx * f.b0 + x * f.b1
    x1 = cx * f.b1 + x * f.b2
    x2 = cx * f.b2 + x * f.b3
    tt0 = ct * t0 + t * t1
    tt1 = ct * t1 + t * t2
    tx0 = cx * t0 + x * t1
    tx1 = cx * t1 + x * t2
    xx0 = cx * x0 + x * x1
    xx1 = cx * x1 + x * x2
    r = Hull()
    r.c0 = ct * tt0 + t * tt1
    r.c1 = cx * tt0 + x * tt1
    r.c2 = cx * tx0 + x * tx1
    r.c3 = cx * xx0 + x * xx1
    return r


@simd.func
def support_above(separation: Vec3, n0: Vec3, nm: Vec3, n1: Vec3) -> Hull:
    """Bernstein coefficients of a cubic above the support of the separation along a normal, given by its own."""
    a = support(separation, n0)
    b = support(separation, nm)
    c = support(separation, n1)
    r = Hull()
    r.c0 = round_up * a
    r.c1 = round_up * (third * (a + b + b))
    r.c2 = round_up * (third * (b + b + c))
    r.c3 = round_up * c
    return r


@simd.func
def reach_of(f: Volume, separation: Vec3) -> Volume:
    """`support_above` of the whole step: a cubic to be restricted with f, tight where the normal hardly turns."""
    h = support_above(separation, f.normal_t0, f.normal_mid, f.normal_t1)
    r = Volume()
    r.b0 = h.c0
    r.b1 = h.c1
    r.b2 = h.c2
    r.b3 = h.c3
    return r


@simd.func
def separation_offset(f: Volume, separation: Vec3, t: Lanes, x: Lanes) -> Hull:
    """`support_above` on [t, x]."""
    ct = one - t
    cx = one - x
    t0 = ct * f.normal_t0 + t * f.normal_mid
    t1 = ct * f.normal_mid + t * f.normal_t1
    x0 = cx * f.normal_t0 + x * f.normal_mid
    x1 = cx * f.normal_mid + x * f.normal_t1
    return support_above(separation, ct * t0 + t * t1, cx * t0 + x * t1, cx * x0 + x * x1)


@simd.func
def crossing(h: Hull) -> Lanes:
    """Fraction of the interval, c0 > 0 and another not, at which the steepest line from c0 to another is zero."""
    slope = greatest(three * (h.c0 - h.c1), greatest(one_and_half * (h.c0 - h.c2), h.c0 - h.c3))
    return h.c0 / slope


@simd.func
def lowered(h: Hull, by: Hull) -> Hull:
    """The difference of two hulls."""
    h.c0 = h.c0 - by.c0
    h.c1 = h.c1 - by.c1
    h.c2 = h.c2 - by.c2
    h.c3 = h.c3 - by.c3
    return h


@simd.func
def whole(f: Volume) -> Hull:
    """What `restrict` gives on [0, 1], in every bit."""
    h = Hull()
    h.c0 = f.b0
    h.c1 = f.b1
    h.c2 = f.b2
    h.c3 = f.b3
    return h


@simd.func
def above_bound(f: Volume, h: Hull) -> Hull:
    """Coefficients of |f|, with the sign at the begin, less the bound, from those of f on an interval."""
    is_negative = is_less(h.c0, zero)
    h.c0 = select(is_negative, minus(h.c0), h.c0) - f.bound
    h.c1 = select(is_negative, minus(h.c1), h.c1) - f.bound
    h.c2 = select(is_negative, minus(h.c2), h.c2) - f.bound
    h.c3 = select(is_negative, minus(h.c3), h.c3) - f.bound
    return h


@simd.func
def beyond_bound(f: Volume, t: Lanes, x: Lanes) -> Hull:
    """`above_bound` of f on [t, x]."""
    return above_bound(f, restrict(f, t, x))


@simd.func
def clip_hull(h: Hull, t: Lanes, x: Lanes, end: Lanes):
    """The clip with a cubic on [t, x] that proves a pair free where it is above zero."""
    is_proof = is_less(zero, h.c0)
    is_clear = is_proof & is_less(zero, least(h.c1, least(h.c2, h.c3)))
    # the fraction of [t, x] is rounded down, so it never reaches the crossing
    s = (t + (x - t) * (crossing(h) * fraction_down)) * round_down
    s = select(is_clear, x, s)
    has_gained = is_proof & is_less(t, s)
    s = select(has_gained, s, t)
    step = s - t
    ahead = least(end, s + select(is_clear, four * step, step + step))
    return s, select(has_gained, ahead, end), is_clear & is_at_most(end, x)


@simd.func
def clip_with_reach(f: Volume, reach: Volume, t: Lanes, x: Lanes, end: Lanes):
    """`clip_volume` with the reach of the separation over the whole step (`reach_of`)."""
    return clip_hull(lowered(beyond_bound(f, t, x), restrict(reach, t, x)), t, x, end)


@simd.func
def clip_volume(f: Volume, separation: Vec3, has_separation: bool, t: Lanes, x: Lanes, end: Lanes):
    """One clip: with f on [t, x], the time up to which it keeps its sign, and the x of the next clip.

    The third result says which lanes are free until ``end``. A lane that gains nothing gets ``end`` for its next x.
    """
    h = beyond_bound(f, t, x)
    if has_separation:
        h = lowered(h, separation_offset(f, separation, t, x))
    return clip_hull(h, t, x, end)
