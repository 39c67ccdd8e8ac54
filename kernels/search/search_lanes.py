"""The queries of a search on the CPU: an item takes the boxes of a block, and tests sixteen boxes at a time with each.

An item collects its candidates until there is one for each lane of the cull, and culls them together; what is left at
its end fills some of the lanes (`collected`). A search of boxes reports them as they are; there the exact boxes decide
where two sides are equal in quantized coordinates.
"""

import warp as wp

from ..atomics import claim
from ..boxes.box_tree import WIDTH, box_corners
from ..boxes.exact_boxes import boxes_apart
from ..boxes.hash_grid import Extent
from ..boxes.lanes import (
    lanes_before,
    lowest_bit,
    moving_overlap_mask,
    moving_partner_masks,
    number_of_bits,
    overlap_mask,
    partner_masks,
)
from ..boxes.pair_lanes import append_keys
from ..pair.simd import build_options, fingerprint
from ..parameters import end, is_thick, width, with_lists
from ..step.minima import CANDIDATES, FOUND
from .collected import collect, cull_rest, partners_at
from .hash_lanes import corners_of, in_cells
from .search_filter import groups_of, is_left_out
from .search_types import BOXES, Search

_EVERY = wp.constant(wp.uint32(0xFFFF))
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

with_cull = end != BOXES
most_registers = hash_registers = None  # the CPU has no limit
are_two = False  # searches of a launch


def module_of(walk: str):
    """The module of the kernel of a walk."""
    lists, thick = ".lists" if with_lists else "", ".thick" if is_thick else ""
    module = wp.get_module(f"ccd_warp.{walk}.{end}{lists}{thick}.{width}.{fingerprint()}")
    options = {"enable_backward": False, "fuse_fp": False, "extra_build_options": build_options}
    wp.set_module_options(options, module=module)
    return module


@wp.struct
class Item:
    """Query boxes of one block, and the box around them."""

    first: int  # place of the first query
    after: int  # place in the targets that its partners come after: its own, or -1 where these are other boxes
    queries: wp.uint32  # lanes of their block
    around: int  # place of the box around the block of queries; of a single query its own
    is_block: int  # 1: the boxes of a block; 0: a single box
    groups: wp.vec2i  # the lowest and the highest of the bodies of the queries
    collected: wp.array[wp.int32]


@wp.func
def overlaps(
    num_aabbs: int,
    nodes: wp.array[wp.float32],
    block: int,
    query_nodes: wp.array[wp.float32],
    query_block: int,
    query_lane: int,
) -> wp.uint32:
    """Mask of the sixteen boxes of a block that overlap a query box."""
    if wp.static(end == BOXES):
        return overlap_mask(nodes, block, query_nodes, query_block, query_lane, 0)
    else:
        return moving_overlap_mask(nodes, block, query_nodes, query_block, query_lane, num_aabbs)


@wp.func
def items_of(search: Search, thread: int) -> wp.vec3i:
    """The items of a thread: the first, the one after the last, and the distance between two."""
    item = search.part.first + thread * search.part.stride
    return wp.vec3i(item, item + 1, 1)


@wp.func
def item_at(search: Search, number: int, thread: int) -> Item:
    """An item: the boxes of a block (level 1), or a single box (level 0)."""
    item = Item()
    item.around = number
    item.first = number
    item.queries = _ONE << wp.uint32(number % WIDTH)
    if search.part.level == 1:
        item.is_block = 1
        item.around = search.query.block_begin[1] * WIDTH + number
        item.first = number * WIDTH
        item.queries = lanes_before(search.query.num_boxes - item.first)
    item.groups = groups_of(search, item.first, item.is_block)
    return item


@wp.func
def with_collected(item: Item, collected: wp.array[wp.int32]) -> Item:
    """The item, with an array for its candidates."""
    item.collected = collected
    return item


@wp.func
def place_of(item: Item, number: int) -> int:
    """Place of a query by its number, that of its lane."""
    return item.first / WIDTH * WIDTH + number


@wp.func
def of_queries(search: Search, item: Item, queries: wp.uint32) -> Item:
    """The item with some of its queries alone."""
    item.queries = queries
    return item


@wp.func
def queries_in_cells(
    cells: wp.array[wp.uint64], item: Item, queries: wp.uint32, first: wp.uint64, last: wp.uint64
) -> wp.uint32:
    """Those of some queries that stand in the cells from the first to the last of a row."""
    return in_cells(cells, item.first / WIDTH, queries, first, last)


@wp.func
def lanes_of(item: Item) -> wp.uint32:
    """The lanes of a block of targets that a thread tests: all."""
    return _EVERY


@wp.func
def overlapping(search: Search, item: Item, block: int) -> wp.uint32:
    """The lanes of a block whose boxes overlap the box around the item."""
    num_aabbs, query = search.target.num_aabbs, item.around
    return overlaps(num_aabbs, search.target.nodes, block, search.query.nodes, query / WIDTH, query % WIDTH)


@wp.func
def extent_of(search: Search, item: Item) -> Extent:
    """The box around the queries, over the whole step."""
    corners = corners_of(search.query.nodes, search.query.num_aabbs, item.first / WIDTH, item.queries)
    extent = Extent()
    extent.lower = wp.vec3f(corners[0], corners[1], corners[2])
    extent.upper = wp.vec3f(corners[3], corners[4], corners[5])
    return extent


@wp.func
def partners_of(search: Search, q: int, block: int, partners: wp.uint32) -> wp.uint32:
    """Those of the partners of a query, boxes of a block, that the mesh does not exclude."""
    mask = wp.uint32(partners)
    if search.collision_filter.applies != 0:
        a = box_corners(search.query, q)
        left = wp.uint32(mask)
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            p = block * WIDTH + lane
            if is_left_out(search, q, p, a, box_corners(search.target, p)):
                mask = mask & ~(_ONE << wp.uint32(lane))
    return mask


@wp.func
def keep(search: Search, q: int, block: int, partners: wp.uint32, undecided: wp.uint32) -> int:
    """Keep the partners of a query whose boxes overlap its own in float64; returns their number.

    Args:
        search: The search.
        q: Place of the query.
        block: Block of the partners.
        partners: Their lanes.
        undecided: Lanes of partners for which the exact float64 test decides.
    """
    mask = wp.uint32(partners)
    if undecided != _NONE:
        mask = mask & ~boxes_apart(search, q, block, undecided)
    if mask == _NONE:
        return 0
    return append_keys(
        search.query.primitive,
        q,
        search.target.primitive,
        block,
        mask,
        wp.where(search.tree_pair.symmetric != 0, 2, search.tree_pair.swapped),
        search.step.counts,
        search.part.row,
        FOUND,
        search.part.capacity,
        search.part.first_key,
        search.keys,
    )


masks_of = partner_masks if end == BOXES else moving_partner_masks


@wp.func
def search_leaf(search: Search, item: Item, block: int, targets: wp.uint32, before: int) -> int:
    """Search some boxes of a block for partners of the queries; returns the number of candidates with those before."""
    num_candidates = wp.int32(before)
    num_aabbs = search.target.num_aabbs
    query_block = item.first / WIDTH
    left = wp.uint32(item.queries)
    if item.is_block != 0:
        parent = search.target.block_begin[1] + block / WIDTH
        lane = block % WIDTH
        left = left & overlaps(num_aabbs, search.query.nodes, query_block, search.target.nodes, parent, lane)
    if left != _NONE:
        left = masks_of(
            search.target.nodes,
            search.target.corners,
            block,
            search.tree_pair.num_target_corners,
            search.query.nodes,
            search.query.corners,
            query_block,
            search.tree_pair.num_query_corners,
            left,
            # an empty place overlaps only a box that is infinite in quantized coordinates
            targets & lanes_before(search.target.num_boxes - block * WIDTH),
            item.after >> 4,  # WIDTH is 16
            num_aabbs,
            item.collected,
            partners_at,
        )
    while left != _NONE:
        query_lane = lowest_bit(left)
        left = left & (left - _ONE)
        q = query_block * WIDTH + query_lane
        both = wp.uint32(item.collected[partners_at + query_lane])
        mask = partners_of(search, q, block, both & _EVERY)
        if mask != _NONE:
            if wp.static(with_cull):
                num_candidates += number_of_bits(mask)
                collect(search, q, block, mask, item.collected)
            else:
                num_candidates += keep(search, q, block, mask, mask & ~(both >> wp.uint32(WIDTH)))
    return num_candidates


@wp.func
def finish(search: Search, item: Item, num_candidates: int):
    """Cull what is left of the candidates of an item, and count all of them."""
    if wp.static(with_cull):
        cull_rest(search, item.collected)
    if num_candidates > 0:
        claim(search.step.counts, search.part.row, CANDIDATES, num_candidates)
