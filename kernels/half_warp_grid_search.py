"""The search for pairs of overlapping boxes in two spatial hashes on CUDA: half a warp takes a query, as in trees.

It looks up the cells of `hash_grid` for single queries, with the contract of `grid_search`, and tests blocks, lists
candidates and culls the rest as `half_warp_search` does.
"""

import warp as wp

from . import half_warp_search as functions
from .box_tree import WIDTH, BoxTree
from .collision_filter import CollisionFilter
from .grid_search import in_cells, lanes_between
from .half_warp import HALF_WARP, end_lane, first_lane, united
from .half_warp_search import box_at, vec12f
from .hash_grid import LAST_LEVEL, NO_CELL, PARTS, HashGrid, bucket_of, cell_at, cell_key, density_of, level_of_cell
from .interrupts import is_stopped
from .lanes import lowest_bit
from .minima import CANDIDATES, Minima
from .pair_search import lanes_before
from .parameters import end, is_thick, with_lists
from .search_types import BOXES, LIST, SearchOptions, SearchRange, TreePair

_NONE = wp.constant(wp.uint32(0))
_BLOCK_DIM = 64  # as few as in `half_warp_search`, as the searches of queries differ in length


@wp.func
def corner_of(box: vec12f, num_aabbs: int, upper: int) -> wp.vec3f:
    """The lower or the upper corner of a box, the union of its AABBs."""
    corner = wp.vec3f(box[3 * upper], box[3 * upper + 1], box[3 * upper + 2])
    if num_aabbs == 2:
        other = wp.vec3f(box[3 * upper + 6], box[3 * upper + 7], box[3 * upper + 8])
        corner = wp.where(upper != 0, wp.max(corner, other), wp.min(corner, other))
    return corner


lists = ".lists" if with_lists else ""
thick = ".thick" if is_thick else ""
module = wp.get_module(f"ccd_warp.half_warp_grid_search.{end}{lists}{thick}")
options = {"enable_backward": False, "fuse_fp": False, "block_dim": _BLOCK_DIM}
wp.set_module_options(options, module=module)
search_leaf, overlaps = functions.search_leaf, functions.overlaps
is_second = end not in (BOXES, LIST)


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
    q: int,
    box: vec12f,
    after: int,  # place after which the partners are
    begin: int,  # place
    stop: int,  # place after the last one
    first_cell: wp.uint64,
    last_cell: wp.uint64,
    first: int,  # lane of the thread
    last: int,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Search a run of places in a row of cells for partners of a query."""
    own_lanes = lanes_before(last) & ~lanes_before(first)
    parent = int(begin / (WIDTH * WIDTH))
    while parent * WIDTH * WIDTH < stop:
        if is_stopped(options.stop):
            break
        parent_block = target.block_begin[1] + parent
        blocks = united(overlaps(target.nodes, parent_block, box, first, last))
        blocks = lanes_between(blocks, begin / WIDTH, (stop + WIDTH - 1) / WIDTH, parent)
        while blocks != _NONE:
            block = parent * WIDTH + lowest_bit(blocks)
            blocks = blocks & (blocks - wp.uint32(1))
            lanes = lanes_between(own_lanes, begin, stop, block)
            search_leaf(
                query,
                target,
                tree_pair,
                options,
                collision_filter,
                vertices_t0,
                vertices_t1,
                q,
                box,
                block,
                in_cells(target_grid.cells, block, lanes, first_cell, last_cell),
                after,
                first,
                last,
                part,
                counts,
                keys,
                minima,
            )
        parent += 1


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
    q: int,
    box: vec12f,
    level: int,
    after: int,
    first: int,  # lane of the thread
    last: int,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Search the cells of a level in which partners of a query may stand."""
    density = density_of(level, target_grid.cells_per_unit)
    low = cell_at(corner_of(box, query.num_aabbs, 0), level, density)
    high = cell_at(corner_of(box, query.num_aabbs, 1), level, density)
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
                begin = wp.max(target_grid.bucket_begin[bucket], after + 1)
                stop = target_grid.bucket_begin[bucket + count]
                left -= count
                bucket = 0
                if begin < stop:
                    search_run(
                        query,
                        target,
                        target_grid,
                        tree_pair,
                        options,
                        collision_filter,
                        vertices_t0,
                        vertices_t1,
                        q,
                        box,
                        after,
                        begin,
                        stop,
                        first_cell,
                        last_cell,
                        first,
                        last,
                        part,
                        counts,
                        keys,
                        minima,
                    )


@wp.func
def search_query(
    query: BoxTree,
    target: BoxTree,
    query_grid: HashGrid,
    target_grid: HashGrid,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    q: int,
    first: int,  # lane of the thread
    last: int,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Find the pairs of a query box."""
    own = query_grid.cells[q]
    if own == NO_CELL:
        return
    own_level = level_of_cell(own)
    level = int(own_level + tree_pair.rise)
    levels = (wp.uint32(target_grid.levels[0]) >> wp.uint32(own_level)) >> wp.uint32(tree_pair.rise)
    box = box_at(query.nodes, query.num_aabbs, q)
    while levels != _NONE:
        if (levels & wp.uint32(1)) != _NONE:
            search_level(
                query,
                target,
                target_grid,
                tree_pair,
                options,
                collision_filter,
                vertices_t0,
                vertices_t1,
                q,
                box,
                level,
                wp.where(tree_pair.within != 0 and level == own_level, q, -1),
                first,
                last,
                part,
                counts,
                keys,
                minima,
            )
        levels = levels >> wp.uint32(1)
        level += 1


@wp.kernel(module=module, grid_stride=False)
def search_cells(
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
    keys: wp.array[wp.int64],  # or candidates, of a search that lists them
    minima: Minima,
):
    """Find the pairs of a query box; a search that culls is the second one, as in `half_warp_search`."""
    thread = begin + wp.tid()
    first = first_lane(thread)
    last = end_lane(thread)
    if last == 0:
        return
    if wp.static(not is_second):
        search_query(
            query,
            target,
            query_grid,
            target_grid,
            tree_pair,
            options,
            collision_filter,
            vertices_t0,
            vertices_t1,
            part.first + thread / HALF_WARP * part.stride,
            first,
            last,
            part,
            counts,
            keys,
            minima,
        )
    elif counts[part.row, CANDIDATES] > wp.int64(part.capacity):
        for item in range(thread / HALF_WARP, query.num_boxes, part.stride):
            search_query(
                query,
                target,
                query_grid,
                target_grid,
                tree_pair,
                options,
                collision_filter,
                vertices_t0,
                vertices_t1,
                item,
                first,
                last,
                part,
                counts,
                keys,
                minima,
            )
