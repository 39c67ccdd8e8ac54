"""The search for pairs of overlapping boxes on CUDA: half a warp takes a query and tests a block of boxes at once.

Each of its sixteen threads loads one box of a block, so that neighbouring threads load neighbouring numbers, and tests
it without a branch. The walk is that of `pair_search`, with its contract, for single queries. What it knows about its
way fits into registers: going up from a block is a division of its number by sixteen, and the lanes still to visit on
each level are pushed and popped as sixteen bits of two words. At a leaf every thread decides about its own box; then
one atomic operation claims places for all pairs of the block.

A search for contacts lists its **candidates**: pairs whose boxes overlap and which the mesh does not exclude. The
kernel of `candidate_cull` culls them afterwards, one in each thread, because in a walk few of the threads of a warp
find one at the same time. If the list was too short for them and no caller makes a longer one, a second search culls
each candidate where it finds it, and nothing is lost but time.

References: Karras 2012, "Thinking parallel, part II: tree traversal on the GPU"; Ylitie et al. 2017, "Efficient
incoherent ray traversal on GPUs through compressed wide BVHs" (a stack of masks).
"""

import warp as wp

from .box_tree import WIDTH, BoxTree, box_corners
from .candidate_cull import is_discarded, write_pair
from .collision_filter import CollisionFilter, is_excluded
from .exact_boxes import boxes_apart, thick_boxes_apart
from .half_warp import HALF_WARP, claim_together, end_lane, first_lane, number_before, united
from .interrupts import is_stopped
from .lanes import lowest_bit
from .minima import CANDIDATES, FOUND, Minima
from .pair_key import pair_key
from .pair_search import is_pair_listed, lanes_after
from .parameters import end, is_thick, with_lists
from .search_types import BOXES, LIST, SearchOptions, SearchRange, TreePair, is_turned

_LANES = wp.constant(wp.uint64(0xFFFF))
_NOTHING = wp.constant(wp.uint64(0))
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_EVERY = wp.constant(wp.uint32(0xFFFF))
_BITS = wp.constant(wp.uint64(16))
_REST = wp.constant(wp.uint64(48))

# A walk waits for memory, so that the number of warps at work counts: 24 of 64 on a multiprocessor in place of 16, for
# 28 bytes of spills. The second search, with its cull, is rare.
_FEW_REGISTERS = 80
_MANY_REGISTERS = 168
# Walks differ in length, and a block keeps its place until the last of its walks has ended.
_BLOCK_DIM = 64

vec12f = wp.types.vector(length=12, dtype=wp.float32)


def _overlapping(meets: str, floats: int) -> str:
    """C++ source of the lanes whose boxes pass a test, all of whose numbers are loaded before the first is needed."""
    return f"""
    unsigned lanes = 0;
    for (int k = first; k < end; ++k) {{
        const float* b = nodes.data + (long long)block * {floats} + k;
        lanes |= (unsigned)({meets}) << k;
    }}
    return lanes;
"""


_CLOSED = " & ".join(f"(b[{16 * n}] <= box[{n + 3}]) & (b[{16 * n + 48}] >= box[{n}])" for n in range(3))
_OPEN = _CLOSED.replace("=", "")
_MOVING = " & ".join(
    f"((b[{16 * n}] <= box[{n + 3}]) | (b[{16 * n + 96}] <= box[{n + 9}]))"
    f" & ((b[{16 * n + 48}] >= box[{n}]) | (b[{16 * n + 144}] >= box[{n + 6}]))"
    for n in range(3)
)


@wp.func_native(
    """
    wp::vec_t<12, wp::float32> box;
    for (int k = 0; k < 12; ++k)
        box[k] = k < 6 * num_aabbs ? nodes.data[((long long)(place / 16) * num_aabbs + k / 6) * 96 + k % 6 * 16 + place % 16] : 0.0f;
    return box;
"""  # noqa: E501
)
def box_at(nodes: wp.array[wp.float32], num_aabbs: int, place: int) -> vec12f:
    """The AABBs of a box of level 0, each with its lower and its upper corner."""
    ...


@wp.func_native(_overlapping(_CLOSED, 96))
def overlapping(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose boxes in a block overlap a box, as closed boxes."""
    ...


@wp.func_native(_overlapping(_OPEN, 96))
def overlapping_inside(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose boxes in a block overlap a box, as open boxes."""
    ...


@wp.func_native(_overlapping(_MOVING, 192))
def moving_overlapping(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose endpoint AABBs no axis separates from a box in the same order at both ends."""
    ...


@wp.func
def num_blocks(tree: BoxTree, level: int) -> int:
    """Number of blocks of a level: a place of `block_begin` that is not known in advance would not be in a register."""
    return ((tree.num_boxes - 1) >> (4 * level + 4)) + 1


@wp.func
def without_preceding(lanes: wp.uint32, tree_pair: TreePair, q: int, level: int, block: int) -> wp.uint32:
    """Remove the boxes of an inner block all of whose primitives precede the query's block, as in `pair_search`."""
    behind = (q >> (4 * level)) - block * WIDTH
    if tree_pair.within == 0 or behind <= 0:
        return lanes
    if behind >= WIDTH:
        return _NONE
    return lanes & lanes_after(behind - 1)


@wp.func
def shares_vertex(a: wp.vec3i, b: wp.vec3i) -> bool:
    """Whether two primitives have a common vertex."""
    first = a[0] == b[0] or a[0] == b[1] or a[0] == b[2]
    second = a[1] == b[0] or a[1] == b[1] or a[1] == b[2]
    return first or second or a[2] == b[0] or a[2] == b[1] or a[2] == b[2]


of_boxes = end == BOXES
is_listing = end == LIST
lists = ".lists" if with_lists else ""
thick = ".thick" if is_thick else ""
module = wp.get_module(f"ccd_warp.half_warp_search.{end}{lists}{thick}")
options = {"enable_backward": False, "fuse_fp": False, "block_dim": _BLOCK_DIM}
wp.set_module_options(options, module=module)
# the trees of a search for contacts hold endpoint AABBs
overlaps = overlapping if of_boxes else moving_overlapping
column = CANDIDATES if is_listing else FOUND
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
    b: wp.vec3i,
) -> bool:
    """Whether a pair of boxes, given by their places, shares a vertex, or the mesh excludes it."""
    if shares_vertex(a, b):
        return True
    if collision_filter.applies != 0:
        if is_excluded(a, b, collision_filter):
            return True
        if wp.static(with_lists):
            return is_pair_listed(query, target, tree_pair, collision_filter, q, p, a, b)
    return False


@wp.func
def search_leaf(
    query: BoxTree,
    target: BoxTree,
    tree_pair: TreePair,
    options: SearchOptions,
    collision_filter: CollisionFilter,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    q: int,
    box: vec12f,
    block: int,
    allowed: wp.uint32,  # lanes
    after: int,  # place after which the partners are
    first: int,  # lane of the thread
    last: int,
    part: SearchRange,
    counts: wp.array2d[wp.int64],
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Write the pairs of a query and the boxes of a leaf block; each thread decides about those of its lanes."""
    near = overlaps(target.nodes, block, box, first, last) & allowed
    lanes = wp.uint32(_NONE)
    a = box_corners(query, q)
    while near != _NONE:
        lane = lowest_bit(near)
        near = near & (near - _ONE)
        p = block * WIDTH + lane
        # an empty place overlaps only a box that is infinite in quantized coordinates
        if p < target.num_boxes and p > after:
            b = box_corners(target, p)
            is_out = is_left_out(query, target, tree_pair, collision_filter, q, p, a, b)
            if wp.static(not of_boxes and not is_listing):
                if not is_out:
                    turned = is_turned(tree_pair, query.primitive[q], target.primitive[p])
                    c = wp.where(turned, b, a)
                    d = wp.where(turned, a, b)
                    is_out = is_discarded(tree_pair.kind, c, d, vertices_t0, vertices_t1, options)
            if not is_out:
                lanes = lanes | (_ONE << wp.uint32(lane))
    if wp.static(of_boxes):
        # where two sides are equal in quantized coordinates, the exact boxes decide
        tied = lanes & ~overlapping_inside(target.nodes, block, box, first, last)
        if tied != _NONE:
            lanes = lanes & ~apart(
                query, target, tree_pair, options, vertices_t0, vertices_t1, q / WIDTH, q % WIDTH, block, tied
            )
    every = united(lanes)
    if every == _NONE:
        return
    begin = claim_together(counts, part.row, column, every)
    i = query.primitive[q]
    while lanes != _NONE:
        lane = lowest_bit(lanes)
        lanes = lanes & (lanes - _ONE)
        p = block * WIDTH + lane
        j = target.primitive[p]
        n = begin + wp.int64(number_before(every, lane))
        turned = is_turned(tree_pair, i, j)
        e = wp.where(turned, j, i)
        f = wp.where(turned, i, j)
        if wp.static(of_boxes):
            if n < wp.int64(part.capacity):
                keys[part.first_key + wp.int32(n)] = pair_key(e, f)
        elif wp.static(is_listing):
            if n < wp.int64(keys.shape[0]):
                keys[n] = pair_key(e, f)
        else:
            b = box_corners(target, p)
            write_pair(e, f, wp.where(turned, b, a), wp.where(turned, a, b), n, part, keys, minima)


@wp.func
def search_query(
    query: BoxTree,
    target: BoxTree,
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
    box = box_at(query.nodes, query.num_aabbs, q)
    top = target.num_levels - 1
    level_begin = int(0)  # the first block of the level
    for k in range(top):
        level_begin += num_blocks(target, k)
    level = wp.int32(top)
    node = int(0)  # the block of this level on the way down
    lanes = united(overlaps(target.nodes, level_begin, box, first, last))
    # the lanes still to visit: of this level in the lowest bits, then of those above
    pending = wp.uint64(without_preceding(lanes, tree_pair, q, top, 0))
    above = wp.uint64(0)
    while level <= top:
        if (pending & _LANES) == _NOTHING:
            level_begin += num_blocks(target, level)
            level += 1
            node = node >> 4  # WIDTH is 16
            pending = (pending >> _BITS) | (above << _REST)
            above = above >> _BITS
        else:
            child = node * WIDTH + lowest_bit(wp.uint32(pending & _LANES))
            pending = pending & (pending - wp.uint64(1))
            below = num_blocks(target, level - 1)
            if child < below:  # an empty place overlaps only a box that is infinite in quantized coordinates
                if level > 1:
                    if is_stopped(options.stop):
                        return
                    lanes = united(overlaps(target.nodes, level_begin - below + child, box, first, last))
                    lanes = without_preceding(lanes, tree_pair, q, level - 1, child)
                    if lanes != _NONE:
                        level -= 1
                        level_begin -= below
                        node = child
                        above = (above << _BITS) | (pending >> _REST)
                        pending = (pending << _BITS) | wp.uint64(lanes)
                else:
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
                        child,
                        _EVERY,
                        wp.where(tree_pair.within != 0, q, -1),
                        first,
                        last,
                        part,
                        counts,
                        keys,
                        minima,
                    )


registers = _FEW_REGISTERS if of_boxes or is_listing else _MANY_REGISTERS


@wp.kernel(module=module, grid_stride=False, cuda_max_registers=registers)
def search_queries(
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
    keys: wp.array[wp.int64],  # or candidates, of a search that lists them
    minima: Minima,
):
    """Find the pairs of a query box.

    A search that culls its candidates is the second one, which is needed only if they exceeded ``part.capacity``.
    Its queries are shared by so few half warps that it costs little where it is not.
    """
    thread = begin + wp.tid()
    first = first_lane(thread)
    last = end_lane(thread)
    if last == 0:
        return
    if wp.static(of_boxes or is_listing):
        search_query(
            query,
            target,
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
