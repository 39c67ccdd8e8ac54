"""Which bodies are below each box: the lowest and the highest of their groups (`collision_filter`), level by level."""

import warp as wp

from .half_warp import HALF_WARP as WIDTH

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_BLOCK_CORNERS = wp.constant(3 * WIDTH)
_NO_GROUP = wp.constant(0x7FFFFFFF)


@wp.func
def groups_of_block(corners: wp.array[wp.int32], vertex_group: wp.array[wp.int32], block: int) -> wp.vec2i:
    """The lowest and the highest group of the bodies of a block of primitives."""
    low = wp.int32(_NO_GROUP)
    high = int(-1)
    for lane in range(WIDTH):
        v = corners[block * _BLOCK_CORNERS + lane]
        if v >= 0:
            low = wp.min(low, vertex_group[v])
            high = wp.max(high, vertex_group[v])
    return wp.vec2i(low, high)


@wp.kernel
def unite_groups(
    begin: int,
    # in
    corners: wp.array[wp.int32],
    vertex_group: wp.array[wp.int32],
    below: int,  # place of the first box of the level below; -1 of the primitives
    at: int,  # place of the first box of the level
    # out
    groups: wp.array[wp.vec2i],  # at first those of no group, which end with -1
):
    """Write the groups of box n of a level."""
    n = begin + wp.tid()
    united = wp.vec2i(_NO_GROUP, -1)
    if below < 0:
        united = groups_of_block(corners, vertex_group, n)
    else:
        for lane in range(WIDTH):
            of_box = groups[below + n * WIDTH + lane]
            if of_box[1] >= 0:
                united = wp.vec2i(wp.min(united[0], of_box[0]), wp.max(united[1], of_box[1]))
    groups[at + n] = united
