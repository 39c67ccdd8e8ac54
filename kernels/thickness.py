"""Thickness: every vertex has a radius, and a primitive takes the largest of its vertices'.

A pair counts as touching once its Euclidean distance is the minimum distance plus the radii of its two primitives.
"""

import warp as wp


@wp.func
def radius_of(radius: wp.array[wp.float64], corners: wp.vec3i) -> wp.float64:
    """Radius of a primitive from its vertices, of which one repeats where there are fewer than three.

    It is 0 where no vertex has a radius: then the array is empty.
    """
    if radius.shape[0] == 0:
        return wp.float64(0.0)
    return wp.max(radius[corners[0]], wp.max(radius[corners[1]], radius[corners[2]]))
