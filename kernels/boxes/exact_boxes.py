"""Boxes in float64: where two sides are equal in quantized coordinates, these decide whether they overlap.

The boxes are exactly those of which `fill_vertex_aabbs` quantizes the parts for ``t_end`` = 1: without radii by
`pair_lanes`, and with radii, by which the box of each vertex grows, one box after another.
"""

import warp as wp

from ..parameters import is_thick
from ..search.search_types import Search
from .box_tree import WIDTH, box_corners
from .boxes import Box, inflated, point_box, united
from .lanes import lowest_bit
from .pair_lanes import separated_mask

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))


@wp.func(inline=False)  # for few boxes: it would take registers of the search, and its struct memory of a thread
def thick_box(
    corners: wp.vec3i,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    inflation: wp.float64,
    radius: wp.array[wp.float64],
) -> Box:
    """The box of a primitive over the whole step."""
    box = Box()
    for k in range(3):
        v = corners[k]
        part = inflated(united(point_box(vertices_t0[v]), point_box(vertices_t1[v])), inflation)
        part = inflated(part, radius[v])
        if k == 0:
            box = part
        else:
            box = united(box, part)
    return box


@wp.func
def are_apart(a: Box, b: Box) -> bool:
    """Whether an axis separates two closed boxes."""
    x = a.lower[0] > b.upper[0] or b.lower[0] > a.upper[0]
    y = a.lower[1] > b.upper[1] or b.lower[1] > a.upper[1]
    return x or y or a.lower[2] > b.upper[2] or b.lower[2] > a.upper[2]


if is_thick:

    @wp.func
    def boxes_apart(search: Search, q: int, block: int, undecided: wp.uint32) -> wp.uint32:
        """Mask of the ``undecided`` boxes of a block that do not overlap the query's."""
        x0 = search.step.vertices_t0
        x1 = search.step.vertices_t1
        inflation = search.options.inflation
        radius = search.options.box_radius
        box = thick_box(box_corners(search.query, q), x0, x1, inflation, radius)
        mask = wp.uint32(0)
        left = wp.uint32(undecided)
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            corners = box_corners(search.target, block * WIDTH + lane)
            if are_apart(box, thick_box(corners, x0, x1, inflation, radius)):
                mask = mask | (_ONE << wp.uint32(lane))
        return mask

else:

    @wp.func
    def boxes_apart(search: Search, q: int, block: int, undecided: wp.uint32) -> wp.uint32:
        """Mask of the ``undecided`` boxes of a block that do not overlap the query's."""
        return separated_mask(
            search.step.vertices_t0,
            search.step.vertices_t1,
            search.options.inflation,
            search.target.corners,
            block,
            search.tree_pair.num_target_corners,
            search.query.corners,
            q / WIDTH,
            q % WIDTH,
            search.tree_pair.num_query_corners,
            undecided,
        )
