"""The search for pairs of overlapping boxes in two trees, with the collision filter and the cull in its inner loop.

An item takes sixteen query boxes (one on CUDA), traverses the tree of the targets with their union, and at each leaf
block tests the queries that overlap it, sixteen boxes at a time. Within one set, a query is tested only against the
blocks and lanes after its own, so that each pair is found once.

A pair whose boxes overlap, and which the collision filter does not exclude, is a **candidate**. In a search with the
cull, boxes count as overlapping unless an axis separates the quantized endpoint AABBs in the same order at both ends of
the step. An item collects its candidates until there is one for each lane, and culls them together; what is left at its
end fills some of the lanes. Each candidate that the cull does not discard is written as a key (first << 32) | second.
An item counts every pair that it finds and writes as many as the capacity allows. A count beyond the capacity tells the
caller to search the items again, with more capacity or in smaller parts, so no pair is lost. Where no caller checks the
count, the toi of a pair beyond the capacity is lowered to 0.
"""

import warp as wp

from .atomics import claim
from .box_tree import WIDTH, BoxTree, box_corners, vec8i, vec8u
from .collected import collect, cull_rest
from .collected import size as num_collected
from .collision_filter import CollisionFilter, are_bodies_listed, is_excluded, is_listed
from .exact_boxes import boxes_apart, thick_boxes_apart
from .interrupts import is_stopped
from .lanes import lowest_bit, moving_overlap_mask, number_of_bits, overlap_mask, shared_vertex_mask
from .minima import CANDIDATES, FOUND, Minima
from .pair_lanes import append_keys
from .parameters import end, is_thick, width, with_lists
from .search_types import BOXES, CULL, SearchOptions, SearchRange, TreePair, is_turned
from .simd import fingerprint

_LANES = wp.constant(wp.uint32(0xFFFF))
_NONE = wp.constant(wp.uint32(0))


@wp.func
def lanes_after(lane: int) -> wp.uint32:
    """Mask of the lanes after a lane."""
    return (_LANES << wp.uint32(lane + 1)) & _LANES


@wp.func
def lanes_before(count: int) -> wp.uint32:
    """Mask of the first ``count`` lanes, at most all."""
    if count >= WIDTH:
        return _LANES
    return (wp.uint32(1) << wp.uint32(count)) - wp.uint32(1)


@wp.func
def without_preceding(mask: wp.uint32, within: int, query_block: int, level: int, block: int) -> wp.uint32:
    """Remove the boxes of an inner block all of whose primitives precede the query's block.

    Their pairs with the query are found when they are the queries. Boxes of another set are all kept.
    """
    if within == 0:
        return mask
    first = query_block
    for _k in range(level - 1):
        first = first / WIDTH
    behind = first - block * WIDTH
    if behind >= WIDTH:
        return _NONE
    if behind > 0:
        return mask & lanes_after(behind - 1)
    return mask


@wp.func
def is_pair_listed(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    collision_filter: CollisionFilter,
    q: int,
    p: int,
    a: wp.vec3i,  # vertices of the query
    b: wp.vec3i,
) -> bool:
    """Whether the mesh lists a pair of boxes, given by their places, or the pair of their bodies."""
    if are_bodies_listed(collision_filter.vertex_body[a[0]], collision_filter.vertex_body[b[0]], collision_filter):
        return True
    if collision_filter.by_listed_pair != 0:
        i = query.primitive[q]
        j = target.primitive[p]
        if is_turned(tree_pair, i, j):
            return is_listed(tree_pair.kind, j, i, collision_filter)
        return is_listed(tree_pair.kind, i, j, collision_filter)
    return False


with_cull = end != BOXES
lists = ".lists" if with_lists else ""
thick = ".thick" if is_thick else ""
module = wp.get_module(f"ccd_warp.pair_search.{end}{lists}{thick}.{width}.{fingerprint()}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)
# the trees of a search for contacts hold endpoint AABBs
overlaps = moving_overlap_mask if end == CULL else overlap_mask
apart = thick_boxes_apart if is_thick else boxes_apart


@wp.func
def is_left_out(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    collision_filter: CollisionFilter,
    q: int,
    p: int,
    a: wp.vec3i,  # vertices of the query
) -> bool:
    """Whether the mesh excludes a pair of boxes, given by their places."""
    b = box_corners(target, p)
    if is_excluded(a, b, collision_filter):
        return True
    if wp.static(with_lists):
        return is_pair_listed(query, target, tree_pair, collision_filter, q, p, a, b)
    return False


@wp.func
def partners_of(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    collision_filter: CollisionFilter,
    q: int,
    block: int,
    overlapping: wp.uint32,
) -> wp.uint32:
    """Those of the boxes of a block that exist and that the mesh does not exclude as partners of a query."""
    if q >= query.num_boxes:
        return _NONE  # an empty place overlaps only a box that is infinite in quantized coordinates
    mask = overlapping & lanes_before(target.num_boxes - block * WIDTH)
    if collision_filter.applies != 0:
        a = box_corners(query, q)
        left = wp.uint32(mask)
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - wp.uint32(1))
            if is_left_out(query, target, tree_pair, collision_filter, q, block * WIDTH + lane, a):
                mask = mask & ~(wp.uint32(1) << wp.uint32(lane))
    return mask


@wp.func
def keep(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    options: SearchOptions,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    query_block: int,
    query_lane: int,
    block: int,
    partners: wp.uint32,
    tied: wp.uint32,  # boxes for which the exact float64 test decides
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
) -> int:
    """Keep the partners of a query in a block whose boxes overlap its own in float64; returns their number."""
    q = query_block * WIDTH + query_lane
    mask = wp.uint32(partners)
    if (mask & tied) != _NONE:
        mask = mask & ~apart(
            query, target, tree_pair, options, vertices_t0, vertices_t1, query_block, query_lane, block, mask & tied
        )
    if mask == _NONE:
        return 0
    order = wp.where(tree_pair.symmetric != 0, 2, tree_pair.swapped)
    return append_keys(
        query.primitive,
        q,
        target.primitive,
        block,
        mask,
        order,
        counts,
        part.row,
        FOUND,
        part.capacity,
        part.first_key,
        keys,
    )


@wp.func
def search_block(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    query_block: int,
    queries: wp.uint32,  # lanes of the query block
    block: int,
    targets: wp.uint32,  # lanes of the block
    own_block: int,  # the query block among blocks of the same boxes, otherwise -1
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
    collected: wp.array[wp.int32],
) -> int:
    """Search some boxes of a block for partners of several queries; returns the number of candidates."""
    num_candidates = int(0)
    left = wp.uint32(queries)
    while left != _NONE:
        query_lane = lowest_bit(left)
        left = left & (left - wp.uint32(1))
        both = overlaps(target.nodes, block, query.nodes, query_block, query_lane, 1)
        mask = both & targets
        if block == own_block:
            mask = mask & lanes_after(query_lane)
        if mask != _NONE:
            mask = mask & ~shared_vertex_mask(
                target.corners,
                block,
                tree_pair.num_target_corners,
                query.corners,
                query_block,
                query_lane,
                tree_pair.num_query_corners,
            )
        if mask != _NONE:
            q = query_block * WIDTH + query_lane
            mask = partners_of(query, target, tree_pair, collision_filter, q, block, mask)
            if wp.static(with_cull):
                if mask != _NONE:
                    num_candidates += number_of_bits(mask)
                    collect(
                        query,
                        target,
                        tree_pair,
                        options,
                        vertices_t0,
                        vertices_t1,
                        q,
                        block,
                        mask,
                        part,
                        counts,
                        keys,
                        minima,
                        collected,
                    )
            else:
                num_candidates += keep(
                    query,
                    target,
                    tree_pair,
                    options,
                    vertices_t0,
                    vertices_t1,
                    query_block,
                    query_lane,
                    block,
                    mask,
                    ~(both >> wp.uint32(WIDTH)),
                    part,
                    counts,
                    keys,
                )
    return num_candidates


@wp.kernel(module=module)
def search_pairs(
    begin: int,
    # in
    part: SearchRange,
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    # out
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Find the pairs of the query boxes of an item: the boxes of a block (level 1), or a single box (level 0)."""
    # the item is box `item` of its level
    item = part.first + (begin + wp.tid()) * part.stride
    item_level = part.level
    item_block = query.block_begin[item_level] + item / WIDTH
    item_lane = item % WIDTH
    query_block = item
    if item_level == 0:
        query_block = item / WIDTH
    own_block = wp.where(tree_pair.within != 0, query_block, -1)
    num_candidates = int(0)
    collected = wp.zeros(shape=num_collected, dtype=wp.int32)
    pending = vec8u()
    node = vec8i()
    top = target.num_levels - 1
    level = wp.int32(top)
    node[top] = 0
    mask = overlaps(target.nodes, target.block_begin[top], query.nodes, item_block, item_lane, 0)
    pending[top] = without_preceding(mask, tree_pair.within, query_block, top, 0)
    # branches here and in `search_block`, no early `continue`s, with which a search of boxes takes 6 to 10 % longer
    while level <= top:
        if pending[level] == _NONE:
            level += 1
        else:
            # box `child` of this level is block `child` of the level below
            lane = lowest_bit(pending[level])
            pending[level] = pending[level] & (pending[level] - wp.uint32(1))
            child = node[level] * WIDTH + lane
            if child >= target.block_begin[level] - target.block_begin[level - 1]:
                continue  # an empty place overlaps only a box that is infinite in quantized coordinates
            if level > 1:
                if is_stopped(options.stop):  # tested at every leaf, it would cost 3 % of a search
                    return
                level -= 1
                block = target.block_begin[level] + child
                mask = overlaps(target.nodes, block, query.nodes, item_block, item_lane, 0)
                node[level] = child
                pending[level] = without_preceding(mask, tree_pair.within, query_block, level, child)
            else:
                queries = wp.uint32(1) << wp.uint32(item_lane)
                if item_level == 1:
                    parent = target.block_begin[1] + node[1]
                    queries = overlaps(query.nodes, query_block, target.nodes, parent, lane, 0)
                num_candidates += search_block(
                    query,
                    target,
                    tree_pair,
                    options,
                    collision_filter,
                    vertices_t0,
                    vertices_t1,
                    query_block,
                    queries,
                    child,
                    _LANES,
                    own_block,
                    part,
                    counts,
                    keys,
                    minima,
                    collected,
                )
    if wp.static(with_cull):
        cull_rest(tree_pair, options, vertices_t0, vertices_t1, part, counts, keys, minima, collected)
    if num_candidates > 0:
        claim(counts, part.row, CANDIDATES, num_candidates)
