"""The boxes of trees on CUDA: half a warp fills a block, and neighbouring threads write neighbouring numbers.

The boxes are those of `box_tree`. There an item fills a whole block, which suits the caches of a CPU; threads of CUDA
that did the same would store 768 bytes apart. One launch fills all levels of several trees: of the half warps that have
written the boxes of an inner block, the last unites them and goes up a level. Kernels take ``only_if``: empty, or a
flag without which they do nothing, so that a graph can contain the refresh of boxes that rarely change.

Reference: Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (who arrives last
at a node goes up).
"""

import warp as wp

from .box_tree import BLOCK_CORNERS, BLOCK_FLOATS, WIDTH, BoxTree, is_needed, node_place
from .half_warp import least_together
from .lanes import vec8f

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_INFINITY = wp.constant(wp.float32(wp.inf))

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
    """
    const float* p = nodes.data + at;
    wp::vec_t<8, wp::float32> box(0.0f);
    for (int k = 0; k < 3; ++k) {
        box[k] = p[16 * k];
        box[4 + k] = -p[48 + 16 * k];
    }
    return box;
"""
)
def read_box(nodes: wp.array[wp.float32], at: int) -> vec8f:
    """A box from its place of a block, in the form of a vertex AABB."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned threads = 0xFFFFu << (threadIdx.x & 16);
    int before = 0;
    __syncwarp(threads);
    if ((threadIdx.x & 15) == 0) {
        __threadfence();  // whoever finds the count finds what the half warp has written, too
        before = (int)atomicInc((unsigned*)arrivals.data + place, (unsigned)(count - 1));
        if (before == count - 1)
            __threadfence();  // and what is read now is not older than the count
    }
    before = __shfl_sync(threads, before, 0, 16);
    __syncwarp(threads);
    return before == count - 1;
#else
    return false;
#endif
"""
)
def is_last(arrivals: wp.array[wp.int32], place: int, count: int) -> bool:
    """Whether a half warp is the last of ``count`` that arrive at a place, which is then 0 again as it was before."""
    ...


@wp.struct
class TreeToFill:
    """A tree among those of a launch."""

    end: int  # the thread after its last one; those of the trees before it come first
    num_corners: int  # of a primitive
    tree: BoxTree
    arrivals: wp.array[wp.int32]  # for each AABB of the inner blocks below the top: its boxes that are written so far


@wp.func
def fill_tree(of: TreeToFill, vertex_aabbs: wp.array[wp.float32], thread: int):
    """Fill an AABB of a block of level 0 from those of its vertices, and all blocks above that are complete with it."""
    tree = of.tree
    lane = thread % WIDTH
    n = thread / WIDTH / tree.num_aabbs
    aabb = thread / WIDTH % tree.num_aabbs
    box = vec8f(_INFINITY)
    if n * WIDTH + lane < tree.num_boxes:
        box = leaf_box(vertex_aabbs, tree.num_aabbs, tree.corners, of.num_corners, n, aabb, lane)
    write_box(tree.nodes, node_place(tree, 0, n * WIDTH + lane, aabb), box)
    count = (tree.num_boxes + WIDTH - 1) / WIDTH  # of the boxes of the level above, of which box n is the union
    level = int(1)
    begin = int(0)  # of the level among the inner blocks
    while True:
        union = least_together(box)
        block = n / WIDTH
        at = ((tree.block_begin[1] + begin + block) * tree.num_aabbs + aabb) * BLOCK_FLOATS
        if lane == 0:
            write_box(tree.nodes, at + n % WIDTH, union)
        if n == count - 1 and lane > n % WIDTH:  # the other boxes of its block are empty
            write_box(tree.nodes, at + lane, vec8f(_INFINITY))
        level += 1
        if level == tree.num_levels:
            return
        if not is_last(of.arrivals, (begin + block) * tree.num_aabbs + aabb, wp.min(WIDTH, count - block * WIDTH)):
            return
        box = read_box(tree.nodes, at + lane)
        count = (count + WIDTH - 1) / WIDTH
        begin += count
        n = block


@wp.kernel
def fill_trees(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    vertex_aabbs: wp.array[wp.float32],
    # out
    a: TreeToFill,
    b: TreeToFill,
    c: TreeToFill,
):
    """Fill all levels of up to three trees: half a warp for each AABB of a block of level 0."""
    thread = begin + wp.tid()
    if is_needed(only_if):
        if thread < a.end:
            fill_tree(a, vertex_aabbs, thread)
        elif thread < b.end:
            fill_tree(b, vertex_aabbs, thread - a.end)
        elif thread < c.end:
            fill_tree(c, vertex_aabbs, thread - b.end)


@wp.kernel
def count_large_blocks(
    begin: int,
    # in
    places: wp.array3d[wp.int32],
    largest: wp.float32,
    cell: int,
    # in/out
    counters: wp.array[wp.int64],
    tree: BoxTree,
):
    """Count the blocks of a sample that have a side above ``largest``.

    ``places`` are those of the boxes around them among the nodes: of both corners, on each axis of each AABB.
    """
    block = begin + wp.tid()
    is_small = bool(True)
    for axis in range(places.shape[1]):
        side = tree.nodes[places[1, axis, block]] - tree.nodes[places[0, axis, block]]
        is_small = is_small and side <= largest
    if not is_small:
        wp.atomic_add(counters, cell, wp.int64(1))


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
