"""The candidates that an item of a search collects until there is one for each lane of the cull.

In lanes, an item has an array of `num_collected` numbers: four rows of vertices, those of the points of a pair, two
rows of primitives, and the number of candidates collected; from `partners_at` on, a mask of partners for each query.
With a width of 1 each candidate is culled as it is found, and only these masks are in memory. The pairs that the cull
leaves open are the same; their order depends on the width.
"""

import warp as wp

from ..atomics import claim
from ..boxes.box_tree import WIDTH, box_corners
from ..boxes.lanes import lowest_bit, number_of_bits
from ..boxes.pair_lanes import collect_pairs
from ..boxes.thickness import distance_of
from ..pair.points import corners as corners_of_lanes
from ..pair.simd import Lanes
from ..pair_kind import EDGE_EDGE
from ..parameters import is_thick, width
from ..step.minima import FOUND
from ..template import specialised
from .cull import free_lanes, has_volume
from .lane_points import points_at
from .search_types import Search, SearchOptions, is_turned, write_pair

_NONE = wp.constant(wp.uint32(0))


capacity = wp.constant(width - 1 + WIDTH)
lanes = wp.constant(width)
number_at = wp.constant(6 * (width - 1 + WIDTH))

if width > 1:

    @wp.func
    def corners_of(kind: int, collected: wp.array[wp.int32], k: int):
        """The vertices of both primitives of a collected candidate."""
        v0 = collected[k]
        v1 = collected[k + capacity]
        v2 = collected[k + 2 * capacity]
        v3 = collected[k + 3 * capacity]
        a = wp.vec3i(v0, v0, v0)
        b = wp.vec3i(v1, v2, v3)
        if kind == EDGE_EDGE:
            a = wp.vec3i(v0, v1, v1)
            b = wp.vec3i(v2, v3, v3)
        return a, b

    @wp.func
    def distances(kind: int, options: SearchOptions, collected: wp.array[wp.int32], begin: int) -> Lanes:
        """The distance at which the candidate in each lane counts as touching."""
        r = Lanes()
        for k in range(lanes):
            a, b = corners_of(kind, collected, begin + k)
            r[k] = distance_of(options.separation, options.radius, a, b)
        return r

    @wp.func
    def cull(search: Search, collected: wp.array[wp.int32], begin: int, count: int):
        """Cull ``count`` candidates from ``begin`` on, at most one a lane, and write those that stay open.

        Lanes without a candidate hold one from before, or vertex 0; their results are ignored.
        """
        kind = search.tree_pair.kind
        options = search.options
        left = (wp.uint32(1) << wp.uint32(count)) - wp.uint32(1)
        if has_volume(kind):
            c0 = corners_of_lanes(kind, points_at(search.step.vertices_t0, collected, begin, capacity))
            c1 = corners_of_lanes(kind, points_at(search.step.vertices_t1, collected, begin, capacity))
            if wp.static(is_thick):
                separations = distances(kind, options, collected, begin)
                left = left & ~free_lanes(kind, c0, c1, separations, options.is_euclidean, options.t_end, left)
            else:
                separation = options.separation
                left = left & ~free_lanes(kind, c0, c1, separation, options.is_euclidean, options.t_end, left)
        if left != _NONE:
            n = claim(search.step.counts, search.part.row, FOUND, number_of_bits(left))
            while left != _NONE:
                k = begin + lowest_bit(left)
                left = left & (left - wp.uint32(1))
                a, b = corners_of(kind, collected, k)
                first, second = collected[k + 4 * capacity], collected[k + 5 * capacity]
                write_pair(first, second, a, b, n, search.part, search.keys, search.step.minima)
                n += wp.int64(1)

    @wp.func
    def collect(search: Search, q: int, block: int, mask: wp.uint32, collected: wp.array[wp.int32]):
        """Collect the candidates of a query and the boxes of a block in a mask; cull while they fill the lanes."""
        count = collect_pairs(
            search.query.primitive,
            search.query.corners,
            q,
            search.target.primitive,
            search.target.corners,
            block,
            mask,
            wp.where(search.tree_pair.symmetric != 0, 2, search.tree_pair.swapped),
            wp.where(search.tree_pair.kind == EDGE_EDGE, 2, 1),
            collected[number_at],
            capacity,
            collected,
        )
        while count >= lanes:
            count -= lanes
            cull(search, collected, count, lanes)
        collected[number_at] = count

    @wp.func
    def cull_rest(search: Search, collected: wp.array[wp.int32]):
        """Cull what is left of the candidates at the end of an item."""
        count = collected[number_at]
        if count > 0:
            cull(search, collected, 0, count)

else:
    is_discarded = specialised("search.candidate_cull", is_thick=is_thick).is_discarded

    @wp.func
    def collect(search: Search, q: int, block: int, mask: wp.uint32, collected: wp.array[wp.int32]):
        """Cull the candidates of a query and the boxes of a block in a mask, and write those that stay open."""
        left = wp.uint32(mask)
        while left != _NONE:
            place = block * WIDTH + lowest_bit(left)
            left = left & (left - wp.uint32(1))
            a = box_corners(search.query, q)
            b = box_corners(search.target, place)
            i = search.query.primitive[q]
            j = search.target.primitive[place]
            if is_turned(search.tree_pair, i, j):
                a, b = b, a
                i, j = j, i
            if not is_discarded(search.tree_pair.kind, a, b, search.step, search.options):
                n = claim(search.step.counts, search.part.row, FOUND, 1)
                write_pair(i, j, a, b, n, search.part, search.keys, search.step.minima)

    @wp.func
    def cull_rest(search: Search, collected: wp.array[wp.int32]):
        """Nothing is left, since each candidate is culled as it is found."""


_num_numbers = 6 * (width - 1 + WIDTH) + 1 if width > 1 else 0
partners_at = wp.constant(_num_numbers)
num_collected = wp.constant(_num_numbers + WIDTH)
