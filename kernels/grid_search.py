"""The search for pairs of overlapping boxes in two spatial hashes, with the filter and the cull of `pair_search`.

An item takes sixteen query boxes (one on CUDA), which stand one after another in the order of the buckets. Those that
stand in one row of cells look up the cells of the targets together: every row in which partners of one of them may
stand, as `hash_grid` says. In a row the boxes around sixteen blocks are tested at a time against that around the
queries, then sixteen queries against the box around a block, and then single queries against its sixteen boxes.

A box may be reached through several rows that share its bucket, and counts in its own row alone. Of two boxes of one
set and one level, the one that comes first finds the other.
"""

import warp as wp

from . import pair_search as functions
from .atomics import claim
from .box_tree import WIDTH, BoxTree
from .collision_filter import CollisionFilter
from .hash_grid import (
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
from .interrupts import is_stopped
from .lanes import chosen, lowest_bit
from .minima import CANDIDATES, Minima
from .pair_search import lanes_before
from .parameters import end, is_thick, width, with_lists
from .search_types import BOXES, SearchOptions, SearchRange, TreePair
from .simd import fingerprint

_NONE = wp.constant(wp.uint32(0))
_LANES = wp.constant(wp.uint32(0xFFFF))

IN_CELLS = {
    "scalar": """
    const wp::uint64* c = cells.data + 16LL * block;
    unsigned result = 0;
    for (int k = 0; k < 16; ++k)
        if ((mask >> k & 1u) != 0)
            result |= (unsigned)(c[k] >= first && c[k] <= last) << k;
    return result;
""",
    "vector": """
    typedef unsigned long long Cells __attribute__((ext_vector_type(16), aligned(8)));
    typedef bool Bits __attribute__((ext_vector_type(16)));
    const Cells c = *(const Cells*)(cells.data + 16LL * block);
    const Bits inside = __builtin_convertvector((c >= (Cells)first) & (c <= (Cells)last), Bits);
    unsigned short result;
    __builtin_memcpy(&result, &inside, 2);
    return mask & result;
""",
}

CORNERS_OF = {
    "scalar": """
    wp::vec_t<8, wp::float32> r;
    for (int k = 0; k < 6; ++k)
        r[k] = k < 3 ? INFINITY : -INFINITY;
    for (int f = 0; f < num_aabbs; ++f)
        for (unsigned left = mask; left != 0; left &= left - 1) {
#if defined(__CUDA_ARCH__)
            const int lane = __ffs((int)left) - 1;
#else
            const int lane = __builtin_ctz(left);
#endif
            const float* b = nodes.data + ((long long)block * num_aabbs + f) * 96 + lane;
            for (int k = 0; k < 6; ++k)
                r[k] = k < 3 ? (b[16 * k] < r[k] ? b[16 * k] : r[k]) : (b[16 * k] > r[k] ? b[16 * k] : r[k]);
        }
    return r;
""",
    "vector": """
    typedef float Lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int Mask __attribute__((ext_vector_type(16)));
    const Mask bit = {1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    const Mask chosen = ((Mask)(int)mask & bit) != (Mask)0;
    wp::vec_t<8, wp::float32> r;
    for (int k = 0; k < 6; ++k) {
        Lanes least = (Lanes)__builtin_inff();
        for (int f = 0; f < num_aabbs; ++f) {
            const Lanes row = ((const Lanes*)(nodes.data + ((long long)block * num_aabbs + f) * 96))[k];
            const Lanes x = chosen ? (k < 3 ? row : -row) : (Lanes)__builtin_inff();
            least = x < least ? x : least;
        }
        const float x = __builtin_reduce_min(least);
        r[k] = k < 3 ? x : -x;
    }
    return r;
""",
}

vec8f = wp.types.vector(length=8, dtype=wp.float32)


@wp.func_native(chosen(IN_CELLS))
def in_cells(cells: wp.array[wp.uint64], block: int, mask: wp.uint32, first: wp.uint64, last: wp.uint64) -> wp.uint32:
    """Those of the boxes of a block in a mask that stand in the cells from the first to the last of a row."""
    ...


@wp.func_native(chosen(CORNERS_OF))
def corners_of(nodes: wp.array[wp.float32], num_aabbs: int, block: int, mask: wp.uint32) -> vec8f:
    """The lower and the upper corner, three numbers each, of the box around those boxes of a block in a mask."""
    ...


@wp.func
def lanes_between(mask: wp.uint32, first: int, last: int, block: int) -> wp.uint32:
    """Those lanes of a block in a mask whose places are from ``first`` on and before ``last``."""
    result = mask & lanes_before(last - block * WIDTH)
    if first > block * WIDTH:
        result = result & ~lanes_before(first - block * WIDTH)
    return result


with_cull = end != BOXES
lists = ".lists" if with_lists else ""
thick = ".thick" if is_thick else ""
module = wp.get_module(f"ccd_warp.grid_search.{end}{lists}{thick}.{width}.{fingerprint()}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)
overlaps, search_block = functions.overlaps, functions.search_block
cull_rest, num_collected = functions.cull_rest, functions.num_collected


@wp.func
def search_run(
    query: BoxTree,
    target: BoxTree,
    target_grid: HashGrid,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    item_block: int,
    item_lane: int,
    query_block: int,
    queries: wp.uint32,  # lanes of the query block
    own_block: int,  # the query block among blocks of the same boxes, otherwise -1
    first: int,  # place
    last: int,  # place after the last one
    first_cell: wp.uint64,
    last_cell: wp.uint64,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
    collected: wp.array[wp.int32],
) -> int:
    """Search a run of places in a row of cells for partners of queries; returns the number of candidates."""
    num_candidates = int(0)
    parent = int(first / (WIDTH * WIDTH))
    while parent * WIDTH * WIDTH < last:
        if is_stopped(options.stop):
            break
        parent_block = target.block_begin[1] + parent
        blocks = overlaps(target.nodes, parent_block, query.nodes, item_block, item_lane, 0)
        blocks = lanes_between(blocks, first / WIDTH, (last + WIDTH - 1) / WIDTH, parent)
        while blocks != _NONE:
            lane = lowest_bit(blocks)
            blocks = blocks & (blocks - wp.uint32(1))
            block = parent * WIDTH + lane
            targets = lanes_between(_LANES, first, last, block)
            targets = in_cells(target_grid.cells, block, targets, first_cell, last_cell)
            if targets != _NONE:
                near = wp.uint32(queries)
                if part.level == 1:
                    near = near & overlaps(query.nodes, query_block, target.nodes, parent_block, lane, 0)
                num_candidates += search_block(
                    query,
                    target,
                    tree_pair,
                    options,
                    collision_filter,
                    vertices_t0,
                    vertices_t1,
                    query_block,
                    near,
                    block,
                    targets,
                    own_block,
                    part,
                    counts,
                    keys,
                    minima,
                    collected,
                )
        parent += 1
    return num_candidates


@wp.func
def search_level(
    query: BoxTree,
    target: BoxTree,
    target_grid: HashGrid,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    item_block: int,
    item_lane: int,
    query_block: int,
    queries: wp.uint32,  # lanes of the query block
    own_block: int,
    level: int,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
    collected: wp.array[wp.int32],
) -> int:
    """Search the cells of a level in which partners of the queries may stand; returns the number of candidates."""
    num_candidates = int(0)
    corners = corners_of(query.nodes, query.num_aabbs, query_block, queries)
    density = density_of(level, target_grid.cells_per_unit)
    low = cell_at(wp.vec3f(corners[0], corners[1], corners[2]), level, density)
    high = cell_at(wp.vec3f(corners[3], corners[4], corners[5]), level, density)
    if level < LAST_LEVEL:
        low = low - wp.vec3i(PARTS, 1, 1)
    num_buckets = 1 << target_grid.bucket_bits
    for z in range(low[2], high[2] + 1):
        for y in range(low[1], high[1] + 1):
            first_cell = cell_key(level, low[0], y, z)
            last_cell = cell_key(level, high[0], y, z)
            bucket = bucket_of(first_cell, target_grid.bucket_bits)
            # a small table has fewer buckets than a row has cells
            left = wp.min(high[0] - low[0] + 1, num_buckets)
            while left > 0:
                # up to the last bucket, and then from the first one on
                count = wp.min(left, num_buckets - bucket)
                # what comes before the queries in their own set has found them
                first = wp.max(target_grid.bucket_begin[bucket], own_block * WIDTH)
                last = target_grid.bucket_begin[bucket + count]
                left -= count
                bucket = 0
                if first < last:
                    num_candidates += search_run(
                        query,
                        target,
                        target_grid,
                        tree_pair,
                        options,
                        collision_filter,
                        vertices_t0,
                        vertices_t1,
                        item_block,
                        item_lane,
                        query_block,
                        queries,
                        own_block,
                        first,
                        last,
                        first_cell,
                        last_cell,
                        part,
                        counts,
                        keys,
                        minima,
                        collected,
                    )
    return num_candidates


@wp.kernel(module=module)
def search_grid(
    begin: int,
    # in
    part: SearchRange,
    query: BoxTree,
    target: BoxTree,
    query_grid: HashGrid,
    target_grid: HashGrid,
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
    item_block = query.block_begin[part.level] + item / WIDTH
    item_lane = item % WIDTH
    query_block = item
    pending = lanes_before(query.num_boxes - item * WIDTH)
    if part.level == 0:
        query_block = item / WIDTH
        pending = wp.uint32(1) << wp.uint32(item_lane)
    num_candidates = int(0)
    collected = wp.zeros(shape=num_collected, dtype=wp.int32)
    while pending != _NONE:
        own = query_grid.cells[query_block * WIDTH + lowest_bit(pending)]
        if own == NO_CELL:
            break  # as are all that follow
        if is_stopped(options.stop):
            return
        queries = in_cells(query_grid.cells, query_block, pending, first_of_row(own), last_of_row(own))
        own_level = level_of_cell(own)
        if own_level < LAST_LEVEL and is_at_an_end(own):
            queries = queries & (~queries + wp.uint32(1))  # one alone: the box around several may cover any number
        pending = pending & ~queries
        levels = (wp.uint32(target_grid.levels[0]) >> wp.uint32(own_level)) >> wp.uint32(tree_pair.rise)
        level = int(own_level + tree_pair.rise)
        while levels != _NONE:
            if (levels & wp.uint32(1)) != _NONE:
                num_candidates += search_level(
                    query,
                    target,
                    target_grid,
                    tree_pair,
                    options,
                    collision_filter,
                    vertices_t0,
                    vertices_t1,
                    item_block,
                    item_lane,
                    query_block,
                    queries,
                    wp.where(tree_pair.within != 0 and level == own_level, query_block, -1),
                    level,
                    part,
                    counts,
                    keys,
                    minima,
                    collected,
                )
            levels = levels >> wp.uint32(1)
            level += 1
    if wp.static(with_cull):
        cull_rest(tree_pair, options, vertices_t0, vertices_t1, part, counts, keys, minima, collected)
    if num_candidates > 0:
        claim(counts, part.row, CANDIDATES, num_candidates)
