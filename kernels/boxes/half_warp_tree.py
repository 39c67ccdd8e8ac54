"""The boxes of a tree on CUDA: half a warp fills a block, and neighbouring threads write neighbouring numbers.

The boxes are those of `box_tree`. There an item fills a whole block, which suits the caches of a CPU; threads of CUDA
that did the same would store 768 bytes apart. Kernels take ``only_if``: empty, or a flag without which they do nothing,
so that a graph can contain the refresh of boxes that rarely change.
"""

import warp as wp

from .box_tree import BLOCK_CORNERS, BLOCK_FLOATS, WIDTH, BoxTree, node_place
from .half_warp import end_lane, first_lane, least_together
from .lanes import vec8f

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY = wp.constant(wp.float32(wp.inf))
_ONE = wp.constant(wp.float32(1.0))
_ROWS = wp.constant(6)  # of an AABB

# An AABB of a vertex and a row of a block lie at multiples of 16 bytes, so four numbers are one load.
_FOUR = """
    struct alignas(16) Four { float x, y, z, w; };
    const auto least = [](float a, float b) { return b < a ? b : a; };
"""


@wp.func_native(
    _FOUR
    + """
    wp::vec_t<8, wp::float32> box(INFINITY);
    const int* c = corners.data + 48LL * block + lane;
    for (int n = 0; n < num_corners; ++n) {
        const Four* v = (const Four*)vertex_aabbs.data + 2 * ((long long)num_aabbs * c[16 * n] + aabb);
        const Four lower = v[0], upper = v[1];
        box[0] = least(box[0], lower.x);
        box[1] = least(box[1], lower.y);
        box[2] = least(box[2], lower.z);
        box[4] = least(box[4], upper.x);
        box[5] = least(box[5], upper.y);
        box[6] = least(box[6], upper.z);
    }
    return box;
"""
)
def leaf_box(
    vertex_aabbs: wp.array[wp.float32],
    num_aabbs: int,
    corners: wp.array[wp.int32],
    num_corners: int,
    block: int,
    aabb: int,
    lane: int,
) -> vec8f:
    """The union of the AABBs of the vertices of a primitive, in the form of a vertex AABB."""
    ...


@wp.func_native(
    """
    wp::vec_t<8, wp::float32> r = a;
    for (int k = 0; k < 8; ++k)
        r[k] = b[k] < r[k] ? b[k] : r[k];
    return r;
"""
)
def least_of(a: vec8f, b: vec8f) -> vec8f:
    """The union of two vertex AABBs."""
    ...


@wp.func_native(
    """
    float* p = nodes.data + at;
    p[0] = box[0];
    p[16] = box[1];
    p[32] = box[2];
    p[48] = -box[4];
    p[64] = -box[5];
    p[80] = -box[6];
"""
)
def write_box(nodes: wp.array[wp.float32], at: int, box: vec8f):
    """Write a box in the form of a vertex AABB to its place of a block."""
    ...


@wp.func_native(
    _FOUR
    + """
    const Four* row = (const Four*)(nodes.data + at);
    float r = INFINITY;
    for (int k = 0; k < 4; ++k) {
        const Four four = row[k];
        r = least(r, least(least(sign * four.x, sign * four.y), least(sign * four.z, sign * four.w)));
    }
    return sign * r;
"""
)
def row_union(nodes: wp.array[wp.float32], at: int, sign: wp.float32) -> wp.float32:
    """The least of sixteen coordinates with the sign 1, the greatest with -1."""
    ...


@wp.func
def is_needed(only_if: wp.array[wp.int32]) -> bool:
    """Whether there is no flag, or it is set."""
    if only_if.shape[0] > 0:
        return only_if[0] != 0
    return True


@wp.kernel
def fill_leaves(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    vertex_aabbs: wp.array[wp.float32],
    num_corners: int,
    # out
    tree: BoxTree,
):
    """Fill an AABB of a block of level 0 from those of its vertices, and write its union to level 1: a half warp."""
    thread = begin + wp.tid()
    first = first_lane(thread)
    last = end_lane(thread)
    if last == 0 or not is_needed(only_if):
        return
    block = thread / WIDTH / tree.num_aabbs
    aabb = thread / WIDTH % tree.num_aabbs
    union = vec8f(_INFINITY)
    for lane in range(first, last):
        n = block * WIDTH + lane
        box = vec8f(_INFINITY)
        if n < tree.num_boxes:
            box = leaf_box(vertex_aabbs, tree.num_aabbs, tree.corners, num_corners, block, aabb, lane)
        write_box(tree.nodes, node_place(tree, 0, n, aabb), box)
        union = least_of(union, box)
    union = least_together(union)
    if first == 0:
        write_box(tree.nodes, node_place(tree, 1, block, aabb), union)
    # after the last box of level 1 its block is filled with empty boxes
    count = (tree.num_boxes + WIDTH - 1) / WIDTH
    if block == count - 1:
        for lane in range(first, last):
            if lane > block % WIDTH:
                write_box(tree.nodes, node_place(tree, 1, block - block % WIDTH + lane, aabb), vec8f(_INFINITY))


@wp.kernel
def unite_rows(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    below: int,  # first block of the level below
    level: int,  # first block of the level
    count: int,  # of its boxes, and of the blocks of the level below
    # out
    tree: BoxTree,
):
    """Compute one number of a level from a row of a block of the level below."""
    k = begin + wp.tid()
    if not is_needed(only_if):
        return
    rows = _ROWS * tree.num_aabbs
    row = k / WIDTH % rows
    n = k / (rows * WIDTH) * WIDTH + k % WIDTH
    sign = wp.where(row % _ROWS < 3, _ONE, -_ONE)
    value = sign * _INFINITY
    if n < count:
        value = row_union(tree.nodes, ((below + n) * rows + row) * WIDTH, sign)
    tree.nodes[level * tree.num_aabbs * BLOCK_FLOATS + k] = value


@wp.kernel
def order_places(
    begin: int,
    # in
    order: wp.array[wp.int64],
    index_mask: wp.int64,
    ids: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    # out
    primitive: wp.array[wp.int32],
    block_corners: wp.array[wp.int32],
):
    """`apply_order` for one place of a block."""
    place = begin + wp.tid()
    c = wp.vec3i(-1, -1, -1)
    if place < ids.shape[0]:
        i = wp.int32(order[place] & index_mask)
        c = corners[i]
        primitive[place] = ids[i]
    for k in range(3):
        block_corners[place / WIDTH * BLOCK_CORNERS + place % WIDTH + k * WIDTH] = c[k]
