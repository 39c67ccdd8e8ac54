"""Which bodies may collide with another: a traversal of a tree of bodies' boxes that ends at the first overlap.

The tree consists of blocks of sixteen boxes, as in `box_tree`: level 0 holds one box for each body, and box k of a
level is the union of block k of the level below. These boxes are float32, by a monotone map, so no overlap is lost.
Boxes that overlap there are compared again in float64, as closed boxes: boxes that touch in a point overlap.
"""

import warp as wp

from ..interrupts import is_stopped
from ..search.collision_filter import CollisionFilter, are_bodies_excluded
from .box_tree import WIDTH, vec8i, vec8u
from .lanes import lowest_bit, overlap_mask

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_NONE = wp.constant(wp.uint32(0))


@wp.struct
class BodyTree:
    """The boxes of bodies in the order of the tree: in float32, with those of the inner levels, and in float64."""

    num_levels: int
    block_begin: vec8i  # first block of each level
    nodes: wp.array[wp.float32]  # a block: lower x, y, z, upper x, y, z of sixteen boxes; inf and -inf for none
    lower: wp.array[wp.vec3d]  # of each body
    upper: wp.array[wp.vec3d]
    body: wp.array[wp.int32]


@wp.func
def overlaps_one_of(query: int, mask: wp.uint32, first: int, tree: BodyTree, collision_filter: CollisionFilter) -> bool:
    """Whether the box at place ``query`` overlaps that of a partner among the places first + bits of a mask."""
    low = tree.lower[query]
    high = tree.upper[query]
    while mask != _NONE:
        place = first + lowest_bit(mask)
        mask = mask & (mask - wp.uint32(1))
        if place != query and not are_bodies_excluded(tree.body[query], tree.body[place], collision_filter):
            a = wp.max(low, tree.lower[place])
            b = wp.min(high, tree.upper[place])
            if a[0] <= b[0] and a[1] <= b[1] and a[2] <= b[2]:
                return True
    return False


@wp.func
def overlaps_another(query: int, tree: BodyTree, collision_filter: CollisionFilter) -> bool:
    """Whether the box at place ``query`` overlaps that of any possible partner."""
    block = query / WIDTH
    lane = query % WIDTH
    # neighbours first, among which most bodies that have a partner find one
    mask = overlap_mask(tree.nodes, block, tree.nodes, block, lane, 0)
    if overlaps_one_of(query, mask, block * WIDTH, tree, collision_filter):
        return True
    top = tree.num_levels - 1
    level = wp.int32(top)
    pending = vec8u()
    node = vec8i()
    pending[top] = overlap_mask(tree.nodes, tree.block_begin[top], tree.nodes, block, lane, 0)
    while level <= top:
        if level == 0:
            if overlaps_one_of(query, pending[0], node[0] * WIDTH, tree, collision_filter):
                return True
            level = 1
        elif pending[level] == _NONE:
            level += 1
        else:
            child = node[level] * WIDTH + lowest_bit(pending[level])
            pending[level] = pending[level] & (pending[level] - wp.uint32(1))
            level -= 1
            node[level] = child
            pending[level] = overlap_mask(tree.nodes, tree.block_begin[level] + child, tree.nodes, block, lane, 0)
    return False


@wp.kernel
def mark_bodies_near(
    begin: int,
    # in
    queries: wp.array[wp.int32],  # places in the tree
    tree: BodyTree,
    collision_filter: CollisionFilter,
    stop: wp.array[wp.int32],
    # out
    is_near: wp.array[wp.int32],  # per body
):
    """Mark the bodies whose box overlaps that of another body with which they may collide."""
    if is_stopped(stop):
        return
    query = queries[begin + wp.tid()]
    if overlaps_another(query, tree, collision_filter):
        is_near[tree.body[query]] = 1
