"""The search for pairs of overlapping boxes in two spatial hashes, whose contract is that of `search_trees`.

The queries of an item stand one after another in the order of the buckets. Those that stand in one row of cells look up
the cells of the targets together: every row in which partners of one of them may stand, as `hash_grid` says. In a row
the boxes around sixteen blocks are tested at a time with that around the item, and then its queries with the boxes of
each block that is left.

A box may be reached through several rows that share its bucket, and counts in its own row alone. Of two boxes of one
set and one level, the one that comes first finds the other.
"""

import warp as wp

from ..boxes.box_tree import WIDTH, BoxTree
from ..boxes.half_warp import united
from ..boxes.hash_grid import (
    LAST_LEVEL,
    NO_CELL,
    PARTS,
    HashGrid,
    bucket_of,
    cell_at,
    cell_key,
    density_of,
    first_of_row,
    is_at_an_end,
    last_of_row,
    level_of_cell,
)
from ..boxes.lanes import lanes_between, lowest_bit
from ..interrupts import is_stopped
from ..parameters import in_warps
from ..step.step import Step
from .collision_filter import CollisionFilter
from .hash_lanes import in_cells
from .search_filter import has_partners, with_partners
from .search_types import Search, SearchOptions, SearchRange, TreePair

if in_warps:
    from . import search_warp as queries
else:
    from . import search_lanes as queries
    from .collected import num_collected

_NONE = wp.constant(wp.uint32(0))

module = queries.module_of("search_hashes")


@wp.func
def search_run(
    search: Search,
    grid: HashGrid,
    item: queries.Item,
    first: int,  # place
    last: int,  # place after the last one
    first_cell: wp.uint64,
    last_cell: wp.uint64,
    before: int,
) -> int:
    """Search a run of places in a row of cells for partners of an item; returns the number of candidates."""
    num_candidates = wp.int32(before)
    num_blocks = search.target.block_begin[1]
    above = (num_blocks + WIDTH - 1) / WIDTH * WIDTH  # groups of the boxes around sixteen blocks come after those
    parent = int(first / (WIDTH * WIDTH))
    while parent * WIDTH * WIDTH < last:
        if is_stopped(search.options.stop):
            break
        blocks = wp.uint32(_NONE)
        if has_partners(search, item.groups, above + parent):
            blocks = queries.overlapping(search, item, num_blocks + parent)
            blocks = lanes_between(blocks, first / WIDTH, (last + WIDTH - 1) / WIDTH, parent)
            blocks = united(with_partners(search, item.groups, num_blocks + parent, blocks))
        while blocks != _NONE:
            block = parent * WIDTH + lowest_bit(blocks)
            blocks = blocks & (blocks - wp.uint32(1))
            targets = lanes_between(queries.lanes_of(item), first, last, block)
            targets = in_cells(grid.cells, block, targets, first_cell, last_cell)
            if united(targets) != _NONE:
                num_candidates = queries.search_leaf(search, item, block, targets, num_candidates)
        parent += 1
    return num_candidates


@wp.func
def search_level(search: Search, grid: HashGrid, item: queries.Item, level: int, before: int) -> int:
    """Search the cells of a level in which partners of an item may stand; returns the number of candidates."""
    num_candidates = wp.int32(before)
    extent = queries.extent_of(search, item)
    density = density_of(level, grid.cells_per_unit)
    low = cell_at(extent.lower, level, density)
    high = cell_at(extent.upper, level, density)
    if level < LAST_LEVEL:
        low = low - wp.vec3i(PARTS, 1, 1)
    num_buckets = 1 << grid.bucket_bits
    for z in range(low[2], high[2] + 1):
        for y in range(low[1], high[1] + 1):
            first_cell = cell_key(level, low[0], y, z)
            last_cell = cell_key(level, high[0], y, z)
            bucket = bucket_of(first_cell, grid.bucket_bits)
            # a small table has fewer buckets than a row has cells
            left = wp.min(high[0] - low[0] + 1, num_buckets)
            while left > 0:
                # up to the last bucket, and then from the first one on
                count = wp.min(left, num_buckets - bucket)
                # what comes before the queries in their own set has found them
                first = wp.max(grid.bucket_begin[bucket], item.after + 1)
                last = grid.bucket_begin[bucket + count]
                left -= count
                bucket = 0
                if first < last:
                    num_candidates = search_run(search, grid, item, first, last, first_cell, last_cell, num_candidates)
    return num_candidates


@wp.func
def search_levels(search: Search, grid: HashGrid, item: queries.Item, query_level: int, before: int) -> int:
    """Search the levels that are no finer than that of the queries; returns the number of candidates."""
    num_candidates = wp.int32(before)
    rise = search.tree_pair.rise
    levels = (wp.uint32(grid.levels[0]) >> wp.uint32(query_level)) >> wp.uint32(rise)
    level = int(query_level + rise)
    while levels != _NONE:
        if (levels & wp.uint32(1)) != _NONE:
            item.after = wp.where(search.tree_pair.within != 0 and level == query_level, item.first, -1)
            num_candidates = search_level(search, grid, item, level, num_candidates)
        levels = levels >> wp.uint32(1)
        level += 1
    return num_candidates


@wp.func
def search_hash(search: Search, query_grid: HashGrid, target_grid: HashGrid, item: queries.Item) -> int:
    """Look up the cells of an item; returns the number of candidates that are still to be counted, or decided."""
    num_candidates = int(0)
    pending = wp.uint32(item.queries)
    while pending != _NONE:
        cell = query_grid.cells[queries.place_of(item, lowest_bit(pending))]
        if cell == NO_CELL:
            break  # as are all that follow
        if is_stopped(search.options.stop):
            break
        in_row = queries.queries_in_cells(query_grid.cells, item, pending, first_of_row(cell), last_of_row(cell))
        query_level = level_of_cell(cell)
        if query_level < LAST_LEVEL and is_at_an_end(cell):
            in_row = in_row & (~in_row + wp.uint32(1))  # one alone: the box around several may cover any number
        pending = pending & ~in_row
        of_row = queries.of_queries(search, item, in_row)
        num_candidates = search_levels(search, target_grid, of_row, query_level, num_candidates)
    return num_candidates


@wp.kernel(module=module, grid_stride=False, cuda_max_registers=queries.hash_registers)
def search_hashes(
    begin: int,
    # in
    part: SearchRange,
    query: BoxTree,
    query_grid: HashGrid,
    target: BoxTree,
    target_grid: HashGrid,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    # in and out
    step: Step,
    # out
    keys: wp.array[wp.int64],
):
    """Find the pairs of the items of a thread."""
    search = Search(part, query, target, tree_pair, options, collision_filter, step, keys)
    thread = begin + wp.tid()
    items = queries.items_of(search, thread)
    for number in range(items[0], items[1], items[2]):
        item = queries.item_at(search, number, thread)
        if wp.static(not in_warps):
            item = queries.with_collected(item, wp.zeros(shape=num_collected, dtype=wp.int32))
        queries.finish(search, item, search_hash(search, query_grid, target_grid, item))
