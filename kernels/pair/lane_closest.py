"""The closest point of a patch to the origin in lanes: `closest_point`, without a branch of a lane's own.

Nothing here carries a guarantee. The products of the sides replace cross products, so that a triangle takes five
divisions and a parallelogram four; what a sliver loses by that, its pair makes up for in the solver for single pairs.
"""

import warp as wp

from ..parameters import real
from . import simd
from .patch import Corners
from .rounding import TINY, UNIT_ROUNDOFF
from .simd import Lanes, Mask, Vec3, cross, dot, greatest, is_at_most, is_less, least, minus, select, spread

tiny = wp.constant(real(TINY[real]))
quarter = wp.constant(real(0.25))
rounding = wp.constant(real((64.0 * UNIT_ROUNDOFF[real]) ** 2))
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
# Square of the sine between the sides above which the weights lose a third of the digits at most.
regular = wp.constant(real(1.0e-3))


@wp.struct
class LaneClosest:
    """The closest point of the patch to the origin in each lane."""

    d: Vec3  # its direction, of any length where it lies inside the patch
    u: Lanes
    v: Lanes
    point: Vec3
    is_regular: Mask  # whether its weights are as accurate as those of `closest_point`, but for a few digits


@simd.func
def unit_interval(x: Lanes) -> Lanes:
    """x clamped to [0, 1], 0 for NaN."""
    return least(greatest(x, zero), one)


@simd.func
def closest_in_triangle(a: Vec3, ab: Vec3, ac: Vec3):
    """Weights v of b and u of c of the closest point, and whether it lies inside; from the products of the sides.

    Where nothing lies inside, the closest of the closest points of the three sides.
    """
    nothing = spread(zero)
    bb = dot(ab, ab)
    cc = dot(ac, ac)
    bc = dot(ab, ac)
    d1 = minus(dot(a, ab))
    d2 = minus(dot(a, ac))
    det = bb * cc - bc * bc
    v = d1 * cc - d2 * bc
    u = d2 * bb - d1 * bc
    inside = is_less(nothing, v) & is_less(nothing, u) & is_less(u + v, det)
    inside = inside & is_less(tiny, det)  # beside it the quotients overflow
    # squared distance of a + s·e, less that of a
    sb = unit_interval(d1 / bb)
    qb = sb * (sb * bb - (d1 + d1))
    sc = unit_interval(d2 / cc)
    qc = sc * (sc * cc - (d2 + d2))
    ee = bb + cc - (bc + bc)
    de = d2 - d1 + bb - bc
    se = unit_interval(de / ee)
    qe = (bb - (d1 + d1)) + se * (se * ee - (de + de))
    side_v = sb
    side_u = nothing
    q = qb
    nearer = is_less(qc, q)
    side_v = select(nearer, nothing, side_v)
    side_u = select(nearer, sc, side_u)
    q = select(nearer, qc, q)
    nearer = is_less(qe, q)
    side_v = select(nearer, one - se, side_v)
    side_u = select(nearer, se, side_u)
    e = select(nearer, ac - ab, select(is_less(nothing, side_u), ac, ab))
    inverse = one / det
    is_regular = is_less(regular * (bb * cc), det)
    return select(inside, v * inverse, side_v), select(inside, u * inverse, side_u), inside, e, is_regular


@simd.func
def closest_in_parallelogram(a: Vec3, ab: Vec3, ac: Vec3):
    """Weights v and u along both sides of the closest point, and whether it lies inside (Ericson 2005, 5.1.9)."""
    nothing = spread(zero)
    bb = dot(ab, ab)
    cc = dot(ac, ac)
    bc = dot(ab, ac)
    d1 = minus(dot(a, ab))
    d2 = minus(dot(a, ac))
    det = bb * cc - bc * bc
    v = unit_interval((d1 * cc - d2 * bc) / det)
    u = unit_interval((d2 - bc * v) / cc)
    v = unit_interval((d1 - bc * u) / bb)
    inner_v = is_less(nothing, v) & is_less(v, one)
    inner_u = is_less(nothing, u) & is_less(u, one)
    return v, u, inner_v & inner_u, select(inner_v, ab, ac), is_less(regular * (bb * cc), det)


@simd.func
def closest(c: Corners, is_triangle: bool) -> LaneClosest:
    """The closest point; nothing here carries a guarantee, as in `closest_point`."""
    r = LaneClosest()
    ab = c.w01 - c.w00
    ac = c.w10 - c.w00
    if is_triangle:
        v, u, inside, e, is_regular = closest_in_triangle(c.w00, ab, ac)
        r.is_regular = is_regular
        r.u = u
        r.v = v
        r.point = c.w00 + v * ab + u * ac
    else:
        v, u, inside, e, is_regular = closest_in_parallelogram(c.w00, ab, ac)
        r.is_regular = is_regular
        r.u = u
        r.v = v
        cu = one - u
        cv = one - v
        r.point = cu * (cv * c.w00 + v * c.w01) + u * (cv * c.w10 + v * c.w11)
    # keep the direction where the gap is far smaller than the patch: orthogonal to the side, or to both
    normal = cross(ab, ac)
    along_normal = (dot(normal, c.w00) / dot(normal, normal)) * normal
    along_side = r.point - (dot(r.point, e) / (dot(e, e) + tiny)) * e
    # of a sliver the weights, or the normal, may be rounding only: then the point is not the foot of the normal
    off = r.point - along_normal
    size = dot(c.w00, c.w00) + dot(ab, ab) + dot(ac, ac)
    trusted = quarter * dot(along_normal, along_normal) + rounding * size
    inside = inside & is_at_most(dot(off, off), trusted)
    is_corner = is_at_most(r.u, zero) | is_at_most(one, r.u)
    is_corner = is_corner & (is_at_most(r.v, zero) | is_at_most(one, r.v))
    r.d = select(inside, along_normal, select(is_corner, r.point, along_side))
    return r
