"""The foot of the perpendicular from the origin on the plane of a patch, for one pair or for one in each lane."""

import warp as wp

from ..parameters import real
from .simd import Vec3, dot, func, is_less, minus, select

zero = wp.constant(real(0.0))


@func
def foot_weights(w00: Vec3, q: Vec3, r: Vec3):
    """The weights of two sides q and r from w00 at the foot, and whether there is one: both sides span a plane.

    The shorter side is resolved into its parts along and across the longer one (Gram-Schmidt), so a rounding error
    moves the foot along a sliver by no more than a rounding error.
    """
    is_swapped = is_less(dot(q, q), dot(r, r))
    longer = select(is_swapped, r, q)
    shorter = select(is_swapped, q, r)
    length_squared = dot(longer, longer)
    lean = dot(shorter, longer) / length_squared
    across = shorter - lean * longer
    width_squared = dot(across, across)
    along = minus(dot(w00, longer)) / length_squared
    other = minus(dot(w00 + along * longer, across)) / width_squared
    along = along - lean * other
    exists = is_less(zero, length_squared) & is_less(zero, width_squared)
    return select(is_swapped, other, along), select(is_swapped, along, other), exists
