"""A point of the patch within the separation box, where the closest point is not, in lanes.

A patch that touches a box need not do so at its point closest to the origin. The facet that separates last, or the
normal of the patch, says which corner or edge of the box it touches. Nothing here carries a guarantee: a point that is
not within the box is not used (`contact_test` finds one for the solver of single pairs).
"""

import warp as wp

from ..parameters import real
from . import simd
from .facets import chosen_side, direction, is_axis, is_first_side, is_third_side
from .lane_closest import closest, unit_interval
from .patch import Corners, side_of
from .rounding import TINY
from .simd import (
    Lanes,
    Vec3,
    cross,
    dot,
    greatest,
    is_at_most,
    is_less,
    is_within,
    least,
    magnitude,
    minus,
    opposite,
    select,
    spread,
    vec,
)

zero = wp.constant(real(0.0))
tiny = wp.constant(real(TINY[real]))
flat = wp.constant(real(1.0e-5))  # component of a direction that counts as none


@simd.func
def toward(d: Lanes, size: Lanes, otherwise: Lanes) -> Lanes:
    """Coordinate of the corner of a box that lies farthest along d; where d vanishes, any other within the box."""
    inside = greatest(least(otherwise, size), minus(size))
    is_zero = is_at_most(magnitude(d), flat)
    return select(is_zero, inside, select(is_less(d, zero), minus(size), size))


@simd.func
def lower_end(d: Vec3, a: Vec3, b: Vec3) -> Vec3:
    """Of two points the one that is less far along d."""
    return select(is_less(dot(d, b), dot(d, a)), b, a)


@simd.func
def point_on_side(separation: Vec3, c: Corners, number: Lanes, near: Vec3) -> Vec3:
    """The point at which the side or corner of a facet touches the box: nearest, across the axis, to its edge."""
    nothing = spread(zero)
    d = direction(number, c)
    d = select(is_less(dot(d, c.w00), nothing), minus(d), d)
    side = chosen_side(number, c)  # not `e`, Warp's number e, on whose value the hash of a module would depend
    start = select(is_third_side(number), c.w01, lower_end(d, c.w00, c.w01))
    start = select(is_first_side(number), lower_end(d, c.w00, c.w10), start)
    b = vec(toward(d.x, separation.x, near.x), toward(d.y, separation.y, near.y), toward(d.z, separation.z, near.z))
    # the direction is across the axis, so along the axis it vanishes
    m = magnitude(d)
    along_x = is_at_most(m.x, nothing)
    along_y = opposite(along_x) & is_at_most(m.y, nothing)
    along_z = opposite(along_x | along_y) & is_at_most(m.z, nothing)
    across = vec(select(along_x, nothing, side.x), select(along_y, nothing, side.y), select(along_z, nothing, side.z))
    w = unit_interval(dot(b - start, across) / (dot(across, across) + tiny))
    corner = lower_end(d, lower_end(d, c.w00, c.w01), lower_end(d, c.w10, c.w11))
    return select(is_axis(number), corner, start + w * side)


@simd.rare
def touching_point(separation: Vec3, c: Corners, number: Lanes, near: Vec3, size: Vec3, is_triangle: bool) -> Vec3:
    """A point of the patch that may lie in [-size, size] where the closest point does not.

    It is on the side, or the corner, of the widest facet, or where the patch faces a corner of the separation box.
    """
    normal = cross(side_of(c, 0), side_of(c, 1))
    normal = select(is_less(dot(normal, c.w00), zero), minus(normal), normal)
    longest = greatest(magnitude(normal.x), greatest(magnitude(normal.y), magnitude(normal.z))) + tiny
    b = vec(
        toward(normal.x / longest, separation.x, near.x),
        toward(normal.y / longest, separation.y, near.y),
        toward(normal.z / longest, separation.z, near.z),
    )
    shifted = c
    shifted.w00 = c.w00 - b
    shifted.w01 = c.w01 - b
    shifted.w10 = c.w10 - b
    shifted.w11 = c.w11 - b
    at_corner = closest(shifted, is_triangle)
    facing = at_corner.point + b
    return select(is_within(facing, size), facing, point_on_side(separation, c, number, near))
