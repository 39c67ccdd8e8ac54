"""The order of a mesh's primitives in the rest configuration: repeated halving across the longest side.

Each level of the recursion is one launch with one item for each segment. The length of a segment is sixteen times a
power of two, so the last splits yield the blocks of the tree. On surfaces a search visits a third fewer blocks in this
order than in that of the Morton curve. The order is computed once, in half a microsecond for each primitive.

References: Hoare 1961, "Algorithm 65: Find" (selection); Wald 2007, "On fast construction of SAH-based bounding volume
hierarchies" (splits by the extent of the centroids).
"""

import warp as wp

from .lanes import united_vertex_aabbs

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Rounds of one selection; a segment that needs more is left as it is, which affects speed only.
_MAX_ROUNDS = wp.constant(200)
# Length of a segment up to which it is split between bodies first.
_ONE_BODY = wp.constant(512)


@wp.kernel
def fill_centres(
    begin: int,
    # in
    corners: wp.array[wp.vec3i],
    vertex_body: wp.array[wp.int32],
    vertex_aabbs: wp.array[wp.float32],
    # out
    centres: wp.array[wp.vec4f],
    order: wp.array[wp.int64],
):
    """Twice the centre of each primitive's box in quantized coordinates, its body, and the initial order."""
    i = begin + wp.tid()
    c = corners[i]
    r = united_vertex_aabbs(vertex_aabbs, c[0], c[1], c[2])
    centres[i] = wp.vec4f(r[0] - r[4], r[1] - r[5], r[2] - r[6], wp.float32(vertex_body[c[0]]))
    order[i] = wp.int64(i)


@wp.func
def coordinate(centres: wp.array[wp.vec4f], order: wp.array[wp.int64], place: int, axis: int) -> wp.float32:
    """The coordinate by which the primitive at a place of the order is compared."""
    return centres[wp.int32(order[place])][axis]


@wp.kernel
def split_segments(
    begin: int,
    # in
    centres: wp.array[wp.vec4f],
    size: int,
    # in and out
    order: wp.array[wp.int64],
):
    """Partition a segment at its middle, by the coordinate along its longest side.

    No primitive of the first half then has a larger coordinate than one of the second. A short segment with several
    bodies is split between the bodies instead, since they may move apart.
    """
    first = (begin + wp.tid()) * size
    last = wp.min(first + size, order.shape[0]) - 1
    middle = first + size / 2
    if last < middle:
        return
    lower = centres[wp.int32(order[first])]
    upper = lower
    for k in range(first + 1, last + 1):
        centre = centres[wp.int32(order[k])]
        lower = wp.min(lower, centre)
        upper = wp.max(upper, centre)
    side = upper - lower
    axis = wp.where(side[1] > side[0], 1, 0)
    axis = wp.where(side[2] > side[axis], 2, axis)
    if size <= _ONE_BODY and side[3] > wp.float32(0.0):
        axis = 3
    rounds = int(0)
    while first < last and rounds < _MAX_ROUNDS:
        rounds += 1
        # the median of the first, the middle and the last coordinate is a good pivot for a sorted segment, too
        a = coordinate(centres, order, first, axis)
        b = coordinate(centres, order, first + (last - first) / 2, axis)
        c = coordinate(centres, order, last, axis)
        pivot = wp.max(wp.min(a, b), wp.min(wp.max(a, b), c))
        i = wp.int32(first)
        j = wp.int32(last)
        while i <= j:
            while coordinate(centres, order, i, axis) < pivot:
                i += 1
            while pivot < coordinate(centres, order, j, axis):
                j -= 1
            if i <= j:
                exchanged = order[i]
                order[i] = order[j]
                order[j] = exchanged
                i += 1
                j -= 1
        if middle <= j:
            last = j
        elif middle >= i:
            first = i
        else:
            first = last
