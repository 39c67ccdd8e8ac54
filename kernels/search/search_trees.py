"""The search for pairs of overlapping boxes in two trees: each item of queries traverses the tree of the targets.

An item is what a thread takes, or a warp on CUDA: the boxes of a block on the CPU (`search_lanes`), or up to as many
neighbours on CUDA (`search_warp`). The box around it is tested with sixteen boxes at a time from the top of the tree
down, and its queries with the boxes of each block at the leaves that it reaches. Within one set a query is tested only
with the boxes after its own, so that each pair is found once.

A pair whose boxes overlap, and which the collision filter does not exclude, is a **candidate**. In a search for
contacts, boxes count as overlapping unless an axis separates the quantized endpoint AABBs in the same order at both
ends of the step. Each candidate that the cull does not discard is written as a key (first << 32) | second. An item
counts every pair that it finds and writes as many as the capacity allows. A count beyond the capacity tells the caller
to search the items again, with more capacity or in smaller parts, so no pair is lost. Where no caller checks the count,
the toi of a pair beyond the capacity is lowered to 0.

What a walk knows about its way fits into registers: going up from a block is a division of its number by sixteen, and
the lanes still to visit on each level are pushed and popped as sixteen bits of two words.

References: Karras 2012, "Thinking parallel, part II: tree traversal on the GPU"; Ylitie et al. 2017, "Efficient
incoherent ray traversal on GPUs through compressed wide BVHs" (a stack of masks).
"""

import warp as wp

from ..boxes.box_tree import WIDTH, BoxTree
from ..boxes.half_warp import united
from ..boxes.lanes import lanes_after, lowest_bit
from ..interrupts import is_stopped
from ..parameters import in_warps
from ..step.step import Step
from .collision_filter import CollisionFilter
from .search_filter import with_partners
from .search_types import Search, Searched, SearchOptions, SearchRange, TreePair, search_of

if in_warps:
    from . import search_warp as queries
else:
    from . import search_lanes as queries
    from .collected import num_collected

_LANES = wp.constant(wp.uint64(0xFFFF))
_NOTHING = wp.constant(wp.uint64(0))
_NONE = wp.constant(wp.uint32(0))
_EVERY = wp.constant(wp.uint32(0xFFFF))
_BITS = wp.constant(wp.uint64(16))
_REST = wp.constant(wp.uint64(48))

module = queries.module_of("search_trees")


@wp.func
def num_blocks(tree: BoxTree, level: int) -> int:
    """Number of blocks of a level: a place of `block_begin` that is not known in advance would not be in a register."""
    return ((tree.num_boxes - 1) >> (4 * level + 4)) + 1


@wp.func
def without_preceding(lanes: wp.uint32, after: int, level: int, block: int) -> wp.uint32:
    """Remove the boxes of an inner block all of whose primitives precede the block of a query, ``own``.

    Their pairs with the query are found when they are the queries. Boxes of another set are all kept.
    """
    behind = (after >> (4 * level)) - block * WIDTH
    if after < 0 or behind <= 0:
        return lanes
    if behind >= WIDTH:
        return _NONE
    return lanes & lanes_after(behind - 1)


@wp.func
def search_tree(search: Search, item: queries.Item) -> int:
    """Traverse the tree of the targets; returns the number of candidates that are still to be counted, or decided."""
    num_candidates = int(0)
    top = search.target.num_levels - 1
    level_begin = int(0)  # the first block of the level
    for k in range(top):
        level_begin += num_blocks(search.target, k)
    level = wp.int32(top)
    node = int(0)  # the block of this level on the way down
    lanes = united(with_partners(search, item.groups, level_begin, queries.overlapping(search, item, level_begin)))
    # the lanes still to visit: of this level in the lowest bits, then of those above
    pending = wp.uint64(without_preceding(lanes, item.after, top, 0))
    above = wp.uint64(0)
    # branches here and in `search_leaf`, no early `continue`s, with which a search of boxes takes 6 to 10 % longer
    while level <= top:
        if (pending & _LANES) == _NOTHING:
            level_begin += num_blocks(search.target, level)
            level += 1
            node = node >> 4  # WIDTH is 16
            pending = (pending >> _BITS) | (above << _REST)
            above = above >> _BITS
        else:
            # box `child` of this level is block `child` of the level below
            child = node * WIDTH + lowest_bit(wp.uint32(pending & _LANES))
            pending = pending & (pending - wp.uint64(1))
            below = num_blocks(search.target, level - 1)
            if child < below:  # an empty place overlaps only a box that is infinite in quantized coordinates
                if level > 1:
                    if is_stopped(search.options.stop):  # tested at every leaf, it would cost 3 % of a search
                        return num_candidates
                    block = level_begin - below + child
                    lanes = united(with_partners(search, item.groups, block, queries.overlapping(search, item, block)))
                    lanes = without_preceding(lanes, item.after, level - 1, child)
                    if lanes != _NONE:
                        level -= 1
                        level_begin -= below
                        node = child
                        above = (above << _BITS) | (pending >> _REST)
                        pending = (pending << _BITS) | wp.uint64(lanes)
                else:
                    num_candidates = queries.search_leaf(search, item, child, _EVERY, num_candidates)
    return num_candidates


if queries.are_two:

    @wp.func
    def search_items(search: Search, thread: int):
        """Find the pairs of the items of a warp."""
        items = queries.items_of(search, thread)
        for number in range(items[0], items[1], items[2]):
            item = queries.item_at(search, number, thread)
            item.after = wp.where(search.tree_pair.within != 0, item.first, -1)
            queries.finish(search, item, search_tree(search, item))

    @wp.kernel(module=module, grid_stride=False, cuda_max_registers=queries.most_registers)
    def search_trees(
        begin: int,
        # in
        options: SearchOptions,
        collision_filter: CollisionFilter,
        a: Searched,
        b: Searched,
        # in and out
        step: Step,
    ):
        """Find the pairs of two tree pairs, by warps of each."""
        thread = begin + wp.tid()
        num_threads = queries.num_threads(a.part)
        if thread < num_threads:
            search_items(search_of(a, options, collision_filter, step), thread)
        else:
            search_items(search_of(b, options, collision_filter, step), thread - num_threads)

else:

    @wp.kernel(module=module, grid_stride=False, cuda_max_registers=queries.most_registers)
    def search_trees(
        begin: int,
        # in
        part: SearchRange,
        query: BoxTree,
        target: BoxTree,
        tree_pair: TreePair,
        options: SearchOptions,
        collision_filter: CollisionFilter,
        # in and out
        step: Step,
        # out
        keys: wp.array[wp.int64],
    ):
        """Find the pairs of the items of a thread, or of a warp."""
        search = Search(part, query, target, tree_pair, options, collision_filter, step, keys)
        thread = begin + wp.tid()
        items = queries.items_of(search, thread)
        for number in range(items[0], items[1], items[2]):
            item = queries.item_at(search, number, thread)
            item.after = wp.where(tree_pair.within != 0, item.first, -1)
            if wp.static(not in_warps):
                item = queries.with_collected(item, wp.zeros(shape=num_collected, dtype=wp.int32))
            queries.finish(search, item, search_tree(search, item))
