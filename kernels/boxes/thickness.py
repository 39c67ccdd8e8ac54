"""Thickness: every vertex has a radius, and a primitive takes the largest of its vertices'.

A pair counts as touching once its Euclidean distance is the minimum distance plus the radii of its two primitives. The
sum is rounded up, so that it is never less than what is asked for; where it needs no rounding it is exact, and pairs
without a radius keep the minimum distance itself. A sum beyond the largest number is infinite, which is beyond every
distance.

Boxes grow by radii, too. The box of a primitive is the union of those of its vertices, each of which grows by the
largest radius of the primitives around it: that of the vertex and of those that share an edge with it. So a primitive's
box holds all that is within its radius, and a thick body enlarges no other body's boxes.
"""

import warp as wp

from ..step.minima import INVALID_INPUT, Minima, flag_world
from .boxes import next_below

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))
_ZERO = wp.constant(wp.float64(0.0))


@wp.func
def radius_of(radius: wp.array[wp.float64], corners: wp.vec3i) -> wp.float64:
    """Radius of a primitive from its vertices, of which one repeats where there are fewer than three.

    It is 0 where no vertex has a radius: then the array is empty.
    """
    if radius.shape[0] == 0:
        return _ZERO
    return wp.max(radius[corners[0]], wp.max(radius[corners[1]], radius[corners[2]]))


@wp.func
def add_rounded_up(a: wp.float64, b: wp.float64) -> wp.float64:
    """a + b of numbers that are not negative, rounded up; exact where no rounding is needed (rounding, step 14)."""
    s = a + b
    if not s <= _LARGEST_FINITE:
        return s
    c = s - a
    error = (a - (s - c)) + (b - c)
    if error > _ZERO:
        s = -next_below(-s)
    return s


@wp.func
def distance_of(minimum: wp.float64, radius: wp.array[wp.float64], first: wp.vec3i, second: wp.vec3i) -> wp.float64:
    """Distance at which a pair counts as touching, from the vertices of its primitives, rounded up."""
    return add_rounded_up(minimum, add_rounded_up(radius_of(radius, first), radius_of(radius, second)))


@wp.kernel
def fill_box_radius(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    radius: wp.array[wp.float64],
    neighbour_begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    # out
    box_radius: wp.array[wp.float64],
    is_changed: wp.array[wp.int32],
    minima: Minima,
):
    """Write the largest radius around each of these vertices, and whether one of them has changed.

    A radius that is negative or not finite flags its world, whose toi is then 0, and counts as 0 here.
    """
    v = vertices[begin + wp.tid()]
    largest = _ZERO
    if radius[v] >= _ZERO and radius[v] <= _LARGEST_FINITE:
        largest = radius[v]
    else:
        flag_world(minima, v, INVALID_INPUT)
    for k in range(neighbour_begin[v], neighbour_begin[v + 1]):
        r = radius[neighbours[k]]
        if r > largest and r <= _LARGEST_FINITE:
            largest = r
    if largest != box_radius[v]:
        box_radius[v] = largest
        is_changed[0] = 1
