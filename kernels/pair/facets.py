"""The moving facets of a patch enlarged by a box: a complete set of separating directions.

The Minkowski sum of the patch and the separation box is a convex polytope whose facet normals are among the axes, the
cross products of the sides with the axes, and the normal of the patch. It contains the origin iff none of them
separates, so at every time before a contact one of them does. The axes are constant, the cross products of the sides
with the axes are linear in t, and the normal is quadratic in t (it is treated by `volume`). Clipping with a moving
facet, rather than with its normal at one time, converges quadratically however fast the pair rotates, even if the pair
lies in one plane, where the volume vanishes.

A facet has a number: 0, 1, 2 for the axes; 3, 4, 5 for the first side crossed with each axis, and so on. Each lane has
its own widest facet, and its direction at any time is chosen by the number.
"""

import warp as wp

from ..parameters import real
from . import simd
from .moving_clip import clip_along
from .patch import Corners, gap_along, num_sides, side_of
from .rounding import RELATIVE, TINY_DIRECTION, UNIT_ROUNDOFF
from .simd import (
    Lanes,
    Mask,
    Vec3,
    cross,
    dot,
    greatest,
    greatest_of,
    is_at_most,
    is_less,
    magnitude,
    minus,
    select,
    spread,
    vec,
)

zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
two = wp.constant(real(2.0))
three = wp.constant(real(3.0))
six = wp.constant(real(6.0))
nine = wp.constant(real(9.0))
one_percent = wp.constant(real(0.01))
round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
tiny_direction = wp.constant(real(TINY_DIRECTION[real]))
far_behind = wp.constant(real(-1.0e30))


@wp.struct
class Facet:
    """The facet with the largest slack at one time."""

    number: Lanes
    slack: Lanes  # distance from the enlarged patch along the direction, divided by the L1 norm of the direction
    floor_excess: Lanes  # largest slack beyond the separation and so many rounding bounds


@wp.func
def axis_of(axis: int) -> Vec3:
    """A unit vector in every lane."""
    x = spread(wp.where(axis == 0, one, zero))
    y = spread(wp.where(axis == 1, one, zero))
    return vec(x, y, spread(wp.where(axis == 2, one, zero)))


@simd.func
def is_first_side(number: Lanes) -> Mask:
    """Whether a facet is of the first side, or an axis."""
    return is_less(number, six)


@simd.func
def is_third_side(number: Lanes) -> Mask:
    """Whether a facet is of the third side."""
    return is_at_most(nine, number)


@simd.func
def is_axis(number: Lanes) -> Mask:
    """Whether a facet is an axis."""
    return is_less(number, three)


@simd.func
def chosen_side(number: Lanes, c: Corners) -> Vec3:
    """The side of each lane's facet."""
    of_others = select(is_third_side(number), side_of(c, 2), side_of(c, 1))
    return select(is_first_side(number), side_of(c, 0), of_others)


@simd.func
def direction(number: Lanes, c: Corners) -> Vec3:
    """Normal of each lane's facet, which is constant or linear in time."""
    nothing = spread(zero)
    s = chosen_side(number, c)
    of_others = select(is_third_side(number), spread(nine), spread(six))
    of_sides = select(is_first_side(number), three, of_others)
    axis = number - select(is_axis(number), nothing, of_sides)
    is_x = is_less(axis, one)
    is_z = is_at_most(two, axis)
    x = select(is_x, nothing, select(is_z, s.y, minus(s.z)))
    y = select(is_x, s.z, select(is_z, minus(s.x), nothing))
    z = select(is_x, minus(s.y), select(is_z, nothing, s.x))
    e_x = select(is_x, one, nothing)
    e_z = select(is_z, one, nothing)
    return select(is_axis(number), vec(e_x, one - e_x - e_z, e_z), vec(x, y, z))


@simd.func
def consider(facet: Facet, number: int, d: Vec3, c: Corners, separation: Vec3, error: Vec3, floor: real) -> Facet:
    """Keep the facet with the larger slack, and the largest excess; number -1 counts for the excess alone."""
    m = magnitude(d)
    size = m.x + m.y + m.z
    counts = is_less(tiny_direction, size)
    gap = gap_along(d, c) - dot(m, separation)
    excess = gap - floor * dot(m, error)
    facet.floor_excess = select(counts, greatest(facet.floor_excess, excess), facet.floor_excess)
    if number >= 0:
        # of two with similar slack the first is kept: axes are constant, whereas a side may vanish
        slack = gap / size
        is_wider = counts & is_less(facet.slack + one_percent * magnitude(facet.slack), slack)
        facet.slack = select(is_wider, slack, facet.slack)
        facet.number = select(is_wider, real(number), facet.number)
    return facet


@wp.func
def widest_facet(c: Corners, separation: Vec3, error: Vec3, is_face: bool, floor: real) -> Facet:
    """The facet that separates best at one time; ``floor`` is how many rounding bounds its excess leaves out."""
    facet = Facet()
    facet.number = spread(zero)
    facet.slack = spread(far_behind)
    facet.floor_excess = spread(far_behind)
    for axis in range(3):
        facet = consider(facet, axis, axis_of(axis), c, separation, error, floor)
    for side in range(num_sides(is_face)):
        s = side_of(c, side)
        for axis in range(3):
            facet = consider(facet, 3 * side + 3 + axis, cross(s, axis_of(axis)), c, separation, error, floor)
    # the normal is used for the excess only: clipping along it is left to the volume
    return consider(facet, -1, cross(side_of(c, 0), side_of(c, 1)), c, separation, error, floor)


@simd.func
def separation_share(c: Corners, d: Vec3, separation: Vec3, error: Vec3) -> Lanes:
    """Lower bound of the gap along one direction, as a share of the separation along it."""
    m = magnitude(d)
    along = dot(m, separation)
    counts = is_less(tiny_direction, greatest_of(m)) & is_less(zero, along)
    share = (gap_along(d, c) - dot(m, error) * round_up) / along
    return select(counts, share, zero)


@wp.func
def start_gap_share(c: Corners, is_face: bool, separation: Vec3, error: Vec3) -> Lanes:
    """Tight lower bound of the gap (L∞) at one time, as a share of the separation, from all directions."""
    share = separation_share(c, cross(side_of(c, 0), side_of(c, 1)), separation, error)
    for axis in range(3):
        share = greatest(share, separation_share(c, axis_of(axis), separation, error))
    for side in range(num_sides(is_face)):
        s = side_of(c, side)
        for axis in range(3):
            share = greatest(share, separation_share(c, cross(s, axis_of(axis)), separation, error))
    return share


@simd.func
def offset(d: Vec3, error: Vec3, separation: Vec3) -> Lanes:
    """Upper bound of the rounding errors and the separation along d (rounding, step 6)."""
    return dot(magnitude(d), separation + error) * round_up


clip_facet = clip_along(Lanes, direction, offset)
