"""The queries of a search on CUDA: half a warp takes a single box, and tests a block of boxes at once with it.

Each of its sixteen threads loads one box of a block, so that neighbouring threads load neighbouring numbers, and tests
it without a branch. In a block at a leaf every thread decides about its own box; then one atomic operation claims
places for all pairs of the block.

A search for contacts lists its **candidates**: pairs whose boxes overlap and which the mesh does not exclude. The
kernel of `candidate_cull` culls them afterwards, one in each thread, because in a walk few of the threads of a warp
find one at the same time. If the list was too short for them and no caller makes a longer one, a second search culls
each candidate where it finds it, and nothing is lost but time. Its queries are shared by so few half warps that it
costs little where it is not needed.
"""

import warp as wp

from ..boxes.box_tree import WIDTH, box_corners
from ..boxes.exact_boxes import boxes_apart
from ..boxes.half_warp import HALF_WARP, claim_together, end_lane, first_lane, number_before, united
from ..boxes.hash_grid import Extent
from ..boxes.lanes import lanes_before, lowest_bit
from ..pair_key import pair_key
from ..parameters import end, is_thick, with_lists
from ..step.minima import CANDIDATES, FOUND
from .candidate_cull import is_discarded
from .search_filter import groups_of, is_left_out
from .search_types import BOXES, LIST, Search, is_turned, write_pair

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

# A walk waits for memory, so that the number of warps at work counts: 24 of 64 on a multiprocessor in place of 16, for
# 28 bytes of spills. The second search, with its cull, is rare.
_FEW_REGISTERS = 80
_MANY_REGISTERS = 168
# Nothing spills with so few in a search of spatial hashes, and 21 warps fit; without a limit the compiler takes 122.
_HASH_REGISTERS = 96
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
def closed_overlap(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose boxes in a block overlap a box, as closed boxes."""
    ...


@wp.func_native(_overlapping(_OPEN, 96))
def open_overlap(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose boxes in a block overlap a box, as open boxes."""
    ...


@wp.func_native(_overlapping(_MOVING, 192))
def moving_overlap(nodes: wp.array[wp.float32], block: int, box: vec12f, first: int, end: int) -> wp.uint32:
    """Those lanes of a thread whose endpoint AABBs no axis separates from a box in the same order at both ends."""
    ...


of_boxes = end == BOXES
is_listing = end == LIST
is_second = not of_boxes and not is_listing
# the trees of a search for contacts hold endpoint AABBs
overlaps = closed_overlap if of_boxes else moving_overlap
column = CANDIDATES if is_listing else FOUND
most_registers = _MANY_REGISTERS if is_second else _FEW_REGISTERS
hash_registers = None if is_second or is_thick else _HASH_REGISTERS


def module_of(walk: str):
    """The module of the kernel of a walk."""
    lists, thick = ".lists" if with_lists else "", ".thick" if is_thick else ""
    module = wp.get_module(f"ccd_warp.half_warp_{walk}.{end}{lists}{thick}")
    options = {"enable_backward": False, "fuse_fp": False, "block_dim": _BLOCK_DIM}
    wp.set_module_options(options, module=module)
    return module


@wp.struct
class Item:
    """A query box, and the lanes of a thread."""

    first: int  # place of the query
    own: int  # place in the targets that its partners come after: its own, or -1 where these are other boxes
    box: vec12f
    groups: wp.vec2i  # that of the body of the query, twice
    first_lane: int
    end_lane: int


@wp.func
def items_of(search: Search, thread: int) -> wp.vec3i:
    """The items of a thread: the first, the one after the last, and the distance between two."""
    items = wp.vec3i(0, 0, 1)
    if end_lane(thread) > 0:
        if wp.static(is_second):
            if search.step.counts[search.part.row, CANDIDATES] > wp.int64(search.part.capacity):
                items = wp.vec3i(thread / HALF_WARP, search.query.num_boxes, search.part.stride)
        else:
            item = search.part.first + thread / HALF_WARP * search.part.stride
            items = wp.vec3i(item, item + 1, 1)
    return items


@wp.func
def item_at(search: Search, number: int, thread: int) -> Item:
    """An item: the query box at a place."""
    item = Item()
    item.first = number
    item.box = box_at(search.query.nodes, search.query.num_aabbs, number)
    item.groups = groups_of(search, number, 0)
    item.first_lane = first_lane(thread)
    item.end_lane = end_lane(thread)
    return item


@wp.func
def lanes_of(item: Item) -> wp.uint32:
    """The lanes of a block of targets that a thread tests."""
    return lanes_before(item.end_lane) & ~lanes_before(item.first_lane)


@wp.func
def overlapping(search: Search, item: Item, block: int) -> wp.uint32:
    """Those lanes of a thread whose boxes in a block overlap the query."""
    return overlaps(search.target.nodes, block, item.box, item.first_lane, item.end_lane)


@wp.func
def extent_of(search: Search, item: Item) -> Extent:
    """The box of the query over the whole step."""
    extent = Extent()
    extent.lower = wp.vec3f(item.box[0], item.box[1], item.box[2])
    extent.upper = wp.vec3f(item.box[3], item.box[4], item.box[5])
    if search.query.num_aabbs == 2:
        extent.lower = wp.min(extent.lower, wp.vec3f(item.box[6], item.box[7], item.box[8]))
        extent.upper = wp.max(extent.upper, wp.vec3f(item.box[9], item.box[10], item.box[11]))
    return extent


@wp.func
def shares_vertex(a: wp.vec3i, b: wp.vec3i) -> bool:
    """Whether two primitives have a common vertex."""
    first = a[0] == b[0] or a[0] == b[1] or a[0] == b[2]
    second = a[1] == b[0] or a[1] == b[1] or a[1] == b[2]
    return first or second or a[2] == b[0] or a[2] == b[1] or a[2] == b[2]


@wp.func
def is_partner(search: Search, q: int, p: int, a: wp.vec3i) -> bool:
    """Whether a target stays a partner of a query whose box it overlaps, both given by their places."""
    b = box_corners(search.target, p)
    if shares_vertex(a, b):
        return False
    if search.collision_filter.applies != 0:
        if is_left_out(search, q, p, a, b):
            return False
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
def search_leaf(search: Search, item: Item, block: int, targets: wp.uint32) -> int:
    """Write the pairs of a query and some boxes of a block; each thread decides about those of its lanes.

    Returns 0, as all candidates are counted.
    """
    near = overlapping(search, item, block) & targets
    lanes = wp.uint32(_NONE)
    a = box_corners(search.query, item.first)
    while near != _NONE:
        lane = lowest_bit(near)
        near = near & (near - _ONE)
        p = block * WIDTH + lane
        # an empty place overlaps only a box that is infinite in quantized coordinates
        if p < search.target.num_boxes and p > item.own:
            if is_partner(search, item.first, p, a):
                lanes = lanes | (_ONE << wp.uint32(lane))
    if wp.static(of_boxes):
        # where two sides are equal in quantized coordinates, the exact boxes decide
        tied = lanes & ~open_overlap(search.target.nodes, block, item.box, item.first_lane, item.end_lane)
        if tied != _NONE:
            lanes = lanes & ~boxes_apart(search, item.first, block, tied)
    every = united(lanes)
    if every != _NONE:
        begin = claim_together(search.step.counts, search.part.row, column, every)
        while lanes != _NONE:
            lane = lowest_bit(lanes)
            lanes = lanes & (lanes - _ONE)
            write(search, item.first, block * WIDTH + lane, begin + wp.int64(number_before(every, lane)))
    return 0
