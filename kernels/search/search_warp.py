"""The queries of a search on CUDA: a warp takes up to sixteen neighbours, and walks with the box around them.

On the way a block of sixteen boxes is tested with the box around the queries: each thread loads one box, so that
neighbouring threads load neighbouring numbers, and tests it without a branch. Both halves of the warp do the same. At a
leaf each half takes another query, and each of its threads another box of the block. Few of these pairs overlap, so
what does waits in a queue until there is one for each thread of the warp; then all of them decide at once about a pair
each, and one atomic operation claims places for what is left. Where too few queries would keep the device busy, some
warps walk with the same ones, and each takes its share of the leaves; in a hash, whose walk takes longer, each warp has
fewer queries. All threads of a warp take the same branches up to an operation that combines them.

A search for contacts lists its **candidates**: pairs whose boxes overlap and which the mesh does not exclude. The
kernel of `candidate_cull` culls them afterwards. If the list was too short for them and no caller makes a longer one, a
second search culls each candidate as it leaves the queue, and nothing is lost but time. Its queries are shared by so
few warps that it costs little where it is not needed.

The CPU has no such operations, and runs `search_lanes`.

References: NVIDIA, "CUDA C++ programming guide", "Warp vote functions" and "Warp shuffle functions"; Adinets 2014,
"CUDA pro tip: optimized filtering with warp-aggregated atomics"; Aila and Laine 2009, "Understanding the efficiency of
ray traversal on GPUs" (what waits for a full warp).
"""

import warp as wp

from ..boxes.box_tree import WIDTH, box_corners
from ..boxes.exact_boxes import boxes_apart
from ..boxes.hash_grid import Extent
from ..boxes.lanes import lanes_before, lowest_bit, number_of_bits
from ..narrow_phase.whole_warp import WARP, claim_for, number_in_warp, threads_where
from ..pair_key import pair_key
from ..parameters import end, is_thick, with_lists
from ..step.minima import CANDIDATES, FOUND
from .candidate_cull import is_discarded
from .search_filter import groups_of, is_left_out
from .search_types import BOXES, LIST, Search, SearchRange, is_turned, write_pair

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_PER_WARP = wp.constant(WARP)
_AROUND = wp.constant(16)  # number of the box around the queries of a warp
_LOW_HALF = wp.constant(wp.int64(0xFFFFFFFF))

# Nothing spills with so few, and 20 of 64 warps fit on a multiprocessor. With 64 to 80 there are more, and spills, and
# a search of crumpled cloth takes as long or longer on an H100. The second search, with its cull, is rare.
_FEW_REGISTERS = 96
_MANY_REGISTERS = 168
# Walks differ in length, and a block keeps its place until the last of its walks has ended: a warp each.
_BLOCK_DIM = WARP

vec12f = wp.types.vector(length=12, dtype=wp.float32)

of_boxes = end == BOXES
is_listing = end == LIST
is_second = not of_boxes and not is_listing
are_two = not of_boxes  # searches of a launch, as many as spill little; a search of boxes is launched part by part
column = CANDIDATES if is_listing else FOUND
most_registers = hash_registers = _MANY_REGISTERS if is_second else _FEW_REGISTERS

# The trees of a search for contacts hold endpoint AABBs; boxes overlap there unless an axis separates them in the same
# order at both ends.
num_floats = 6 if of_boxes else 12
_CLOSED = " & ".join(f"(a[{n}] <= b[{n + 3}]) & (a[{n + 3}] >= b[{n}])" for n in range(3))
_MOVING = " & ".join(
    f"((a[{n}] <= b[{n + 3}]) | (a[{n + 6}] <= b[{n + 9}])) & ((a[{n + 3}] >= b[{n}]) | (a[{n + 9}] >= b[{n + 6}]))"
    for n in range(3)
)


def module_of(walk: str):
    """The module of the kernel of a walk."""
    lists, thick = ".lists" if with_lists else "", ".thick" if is_thick else ""
    module = wp.get_module(f"ccd_warp.warp_{walk}.{end}{lists}{thick}")
    options = {"enable_backward": False, "fuse_fp": False, "block_dim": _BLOCK_DIM}
    wp.set_module_options(options, module=module)
    return module


# ---- Boxes, and the threads of a warp --------------------------------------------------------------------------------


@wp.func_native(
    f"""
    wp::vec_t<12, wp::float32> box;
    const unsigned p = (unsigned)place;
    const float* b = nodes.data + (size_t)(p >> 4) * {16 * num_floats} + (p & 15u);
    for (int k = 0; k < 12; ++k)
        box[k] = k < {num_floats} ? b[16 * k] : 0.0f;
    return box;
"""
)
def box_at(nodes: wp.array[wp.float32], place: int) -> vec12f:
    """The AABBs of a box at a place among those of all levels, each with its lower and its upper corner."""
    ...


@wp.func_native(f"return {_CLOSED if of_boxes else _MOVING};")
def overlap(a: vec12f, b: vec12f) -> bool:
    """Whether two boxes overlap, as closed boxes."""
    ...


@wp.func_native(f"return {_CLOSED.replace('=', '')};")
def overlap_openly(a: vec12f, b: vec12f) -> bool:
    """Whether two boxes overlap, as open boxes."""
    ...


@wp.func_native(
    f"""
    struct alignas(16) Four {{ float x, y, z, w; }};
#if defined(__CUDA_ARCH__)
    __shared__ Four kept[{_BLOCK_DIM // WARP}][17][3];
    Four* fours = kept[threadIdx.x >> 5][number];
    if (is_new) {{
        __syncwarp();
        if (is_own)
            for (int k = 0; k < 3; ++k)
                fours[k] = {{box[4 * k], box[4 * k + 1], box[4 * k + 2], box[4 * k + 3]}};
        __syncwarp();
        return box;
    }}
    wp::vec_t<12, wp::float32> r;
    for (int k = 0; k < 3; ++k) {{
        const Four four = 4 * k < {num_floats} ? fours[k] : Four{{}};
        r[4 * k] = four.x;
        r[4 * k + 1] = four.y;
        r[4 * k + 2] = four.z;
        r[4 * k + 3] = four.w;
    }}
    return r;
#else
    return box;
#endif
"""
)
def kept_box(number: int, is_new: bool, is_own: bool, box: vec12f) -> vec12f:
    """A box that the warp keeps in shared memory: that of a query by its number, or as number 16 that around them.

    A new one is written by the threads for which it is their own; all threads of the warp call this together then.
    """
    ...


@wp.func_native(
    f"""
    wp::vec_t<12, wp::float32> r;
    for (int k = 0; k < 12; ++k) {{
        const bool is_lower = k % 6 < 3;
        float x = takes_part ? box[k] : is_lower ? INFINITY : -INFINITY;
        for (int bits = 8; k < {num_floats} && bits > 0; bits >>= 1) {{
            const float other = __shfl_xor_sync(0xFFFFFFFFu, x, bits);
            x = (is_lower ? other < x : other > x) ? other : x;
        }}
        r[k] = x;
    }}
    return r;
"""
)
def box_around(box: vec12f, takes_part: bool) -> vec12f:
    """The box around those of some threads, which are the same in both halves of the warp."""
    ...


@wp.func_native(
    """
    for (int bits = 8; bits > 0; bits >>= 1) {
        const int other = __shfl_xor_sync(0xFFFFFFFFu, x, bits);
        x = other < x ? other : x;
    }
    return x;
"""
)
def least_of_half(x: int) -> int:
    """The least number of the threads of half a warp."""
    ...


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
    __shared__ long long queues[{_BLOCK_DIM // WARP}][{2 * WARP}];
    long long* queue = queues[threadIdx.x >> 5];
    const int number = threadIdx.x & 31;
    __syncwarp();
    if (new_ones >> number & 1u)
        queue[waiting + __popc(new_ones & ((1u << number) - 1u))] = pair;
    __syncwarp();
    const int count = waiting + __popc(new_ones);
    const int place = number + (count > 32 ? count - 32 : 0);
    return place < count ? queue[place] : -1;
#else
    return -1;
#endif
"""
)
def queued(new_ones: wp.uint32, pair: wp.int64, waiting: int) -> wp.int64:
    """Queue the pairs of some threads of the warp behind those that wait, fewer than 32.

    Returns one of the last 32 pairs of the queue for each thread, or -1.
    """
    ...


# ---- Items: the queries of a warp ------------------------------------------------------------------------------------


@wp.struct
class Item:
    """Some queries that follow each other, at most sixteen, whose boxes the warp keeps."""

    share: int  # number of the warp among those that take these queries
    first: int  # place of the first query
    after: int  # place in the targets that its partners come after: its own, or -1 where these are other boxes
    queries: wp.uint32  # by their numbers from the first on
    groups: wp.vec2i  # the lowest and the highest of the bodies of the queries


@wp.func
def box_of(number: int) -> vec12f:
    """The box of a query by its number, or that around them."""
    return kept_box(number, False, False, vec12f())


@wp.func
def num_threads(part: SearchRange) -> int:
    """The threads of a search."""
    return part.num_warps * _PER_WARP


@wp.func
def items_of(search: Search, thread: int) -> wp.vec3i:
    """The items of a warp: the first, the one after the last, and the distance between two."""
    part = search.part
    if wp.static(is_second):
        if search.step.counts[part.row, CANDIDATES] <= wp.int64(part.capacity):
            return wp.vec3i(0, 0, 1)
    num_items = (part.end - part.first + part.stride - 1) / part.stride
    return wp.vec3i(thread / _PER_WARP, num_items * part.shares, part.num_warps)


@wp.func
def item_at(search: Search, number: int, thread: int) -> Item:
    """An item by its number, which counts it once for each warp that takes it."""
    item = Item()
    item.share = number % search.part.shares
    item.first = search.part.first + number / search.part.shares * search.part.stride
    count = wp.min(search.part.stride, search.part.end - item.first)
    query = wp.min(number_in_warp() % WIDTH, count - 1)
    kept_box(number_in_warp() % WIDTH, True, number_in_warp() < WIDTH, box_at(search.query.nodes, item.first + query))
    item.groups = groups_of(search, item.first + query, 0)
    if search.tree_pair.prunes != 0:
        item.groups = wp.vec2i(least_of_half(item.groups[0]), -least_of_half(-item.groups[1]))
    return of_queries(search, item, lanes_before(count))


@wp.func
def place_of(item: Item, number: int) -> int:
    """Place of a query by its number."""
    return item.first + number


@wp.func
def of_queries(search: Search, item: Item, queries: wp.uint32) -> Item:
    """The item with some of its queries alone."""
    item.queries = queries
    takes_part = (queries >> wp.uint32(number_in_warp() % WIDTH) & _ONE) != _NONE
    kept_box(_AROUND, True, number_in_warp() == 0, box_around(box_of(number_in_warp() % WIDTH), takes_part))
    return item


@wp.func
def queries_in_cells(
    cells: wp.array[wp.uint64], item: Item, queries: wp.uint32, first: wp.uint64, last: wp.uint64
) -> wp.uint32:
    """Those of some queries that stand in the cells from the first to the last of a row."""
    number = number_in_warp() % WIDTH
    is_within = (queries >> wp.uint32(number) & _ONE) != _NONE
    if is_within:
        cell = cells[item.first + number]
        is_within = cell >= first and cell <= last
    return queries & threads_where(is_within)


@wp.func
def lanes_of(item: Item) -> wp.uint32:
    """The lane of a block of targets that a thread tests."""
    return _ONE << wp.uint32(number_in_warp() % WIDTH)


@wp.func
def overlapping(search: Search, item: Item, block: int) -> wp.uint32:
    """The lane of a thread, if its box in a block overlaps the box around the queries."""
    if overlap(box_at(search.target.nodes, block * WIDTH + number_in_warp() % WIDTH), box_of(_AROUND)):
        return lanes_of(item)
    return _NONE


@wp.func
def extent_of(search: Search, item: Item) -> Extent:
    """The box around the queries, over the whole step."""
    box = box_of(_AROUND)
    extent = Extent()
    extent.lower = wp.vec3f(box[0], box[1], box[2])
    extent.upper = wp.vec3f(box[3], box[4], box[5])
    if wp.static(not of_boxes):
        extent.lower = wp.min(extent.lower, wp.vec3f(box[6], box[7], box[8]))
        extent.upper = wp.max(extent.upper, wp.vec3f(box[9], box[10], box[11]))
    return extent


# ---- Pairs -----------------------------------------------------------------------------------------------------------


@wp.func
def shares_vertex(a: wp.vec3i, b: wp.vec3i) -> bool:
    """Whether two primitives have a common vertex."""
    first = a[0] == b[0] or a[0] == b[1] or a[0] == b[2]
    second = a[1] == b[0] or a[1] == b[1] or a[1] == b[2]
    return first or second or a[2] == b[0] or a[2] == b[1] or a[2] == b[2]


@wp.func
def is_partner(search: Search, q: int, p: int) -> bool:
    """Whether a target stays a partner of a query whose box it overlaps, both given by their places."""
    a = box_corners(search.query, q)
    b = box_corners(search.target, p)
    if shares_vertex(a, b):
        return False
    if search.collision_filter.applies != 0:
        if is_left_out(search, q, p, a, b):
            return False
    if wp.static(of_boxes):
        # where two sides are equal in quantized coordinates, the exact boxes decide
        if not overlap_openly(box_at(search.target.nodes, p), box_at(search.query.nodes, q)):
            return boxes_apart(search, q, p / WIDTH, _ONE << wp.uint32(p % WIDTH)) == _NONE
    if wp.static(is_second):
        turned = is_turned(search.tree_pair, search.query.primitive[q], search.target.primitive[p])
        c = wp.where(turned, b, a)
        d = wp.where(turned, a, b)
        return not is_discarded(search.tree_pair.kind, c, d, search.step, search.options)
    return True


@wp.func
def write(search: Search, q: int, p: int, n: wp.int64):
    """Write pair n, of a query and a target, given by their places."""
    i = search.query.primitive[q]
    j = search.target.primitive[p]
    turned = is_turned(search.tree_pair, i, j)
    first = wp.where(turned, j, i)
    second = wp.where(turned, i, j)
    if wp.static(of_boxes):
        if n < wp.int64(search.part.capacity):
            search.keys[search.part.first_key + wp.int32(n)] = pair_key(first, second)
    elif wp.static(is_listing):
        if n < wp.int64(search.keys.shape[0]):
            search.keys[n] = pair_key(first, second)
    else:
        a = box_corners(search.query, q)
        b = box_corners(search.target, p)
        c = wp.where(turned, b, a)
        write_pair(first, second, c, wp.where(turned, a, b), n, search.part, search.keys, search.step.minima)


@wp.func
def settle(search: Search, pair: wp.int64):
    """Decide about pairs from the queue, one of each thread or none, -1, and write those that stay."""
    q = wp.int32(pair >> wp.int64(32))
    p = wp.int32(pair & _LOW_HALF)
    is_kept = pair >= wp.int64(0)
    if is_kept:
        is_kept = is_partner(search, q, p)
    threads = threads_where(is_kept)
    if threads != _NONE:
        n = claim_for(threads, search.step.counts, search.part.row, column)
        if is_kept:
            write(search, q, p, n)


@wp.func
def search_leaf(search: Search, item: Item, block: int, targets: wp.uint32, waiting: int) -> int:
    """Queue the pairs of queries and some boxes of a block that overlap; returns how many then wait."""
    if block % search.part.shares != item.share:
        return waiting
    parent = box_at(search.target.nodes, search.target.block_begin[1] * WIDTH + block)
    queries = item.queries & threads_where(overlap(parent, box_of(number_in_warp() % WIDTH)))
    lane = number_in_warp() % WIDTH
    place = block * WIDTH + lane
    # an empty place overlaps only a box that is infinite in quantized coordinates
    is_target = place < search.target.num_boxes and (targets >> wp.uint32(lane) & _ONE) != _NONE
    target = box_at(search.target.nodes, place)
    num_waiting = wp.int32(waiting)
    while queries != _NONE:
        query = lowest_bit(queries)
        queries = queries & (queries - _ONE)
        is_near = is_target
        if number_in_warp() >= WIDTH:  # the upper half takes the next query, or none
            is_near = is_near and queries != _NONE
            if queries != _NONE:
                query = lowest_bit(queries)
        queries = queries & (queries - _ONE)
        is_near = is_near and (item.after < 0 or place > item.first + query)
        is_near = overlap(target, box_of(query)) and is_near
        new_ones = threads_where(is_near)
        if new_ones != _NONE:
            pair = queued(new_ones, wp.int64(item.first + query) << wp.int64(32) | wp.int64(place), num_waiting)
            num_waiting += number_of_bits(new_ones)
            if num_waiting >= _PER_WARP:
                num_waiting -= _PER_WARP
                settle(search, pair)
    return num_waiting


@wp.func
def finish(search: Search, item: Item, waiting: int):
    """Decide about the pairs that wait at the end of an item."""
    if waiting > 0:
        settle(search, queued(_NONE, wp.int64(0), waiting))
