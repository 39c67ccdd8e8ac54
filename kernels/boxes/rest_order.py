"""The order of a mesh's primitives in the rest configuration: repeated halving across the longest side.

The length of a segment is sixteen times a power of two, so the last splits yield the blocks of the tree. On surfaces a
search visits a third fewer blocks in this order than in that of the Morton curve. The order is computed once.

On the CPU each level of the recursion is one launch with one item for each segment, which selects its median; that
takes half a microsecond for each primitive in all. On CUDA, where the first level would be a single thread, each level
sorts all primitives by the number of their segment and their coordinate along its longest side (`fill_keys`).

References: Hoare 1961, "Algorithm 65: Find" (selection); Wald 2007, "On fast construction of SAH-based bounding volume
hierarchies" (splits by the extent of the centroids).
"""

import warp as wp

from ..atomics import atomic_min_int32
from .half_warp import HALF_WARP as WIDTH
from .lanes import united_vertex_aabbs

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Rounds of one selection; a segment that needs more is left as it is, which affects speed only.
_MAX_ROUNDS = wp.constant(200)
# What a bound of a segment is before it is known.
UNBOUNDED = 0x7FFFFFFF
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
def longest_axis(side: wp.vec4f, size: int) -> int:
    """The axis along which a segment with a box of these sides is halved: 3 stands for the bodies.

    A short segment with several bodies is split between the bodies, since they may move apart.
    """
    axis = wp.where(side[1] > side[0], 1, 0)
    axis = wp.where(side[2] > wp.where(axis == 1, side[1], side[0]), 2, axis)
    if size <= _ONE_BODY and side[3] > wp.float32(0.0):
        axis = 3
    return axis


@wp.func
def coordinate(centres: wp.array[wp.vec4f], order: wp.array[wp.int64], place: int, axis: int) -> wp.float32:
    """The coordinate by which the primitive at a place of the order is compared."""
    return centres[wp.int32(order[place])][axis]


@wp.func
def is_mixed(centres: wp.array[wp.vec4f], body_group: wp.array[wp.int32], first: int, last: int) -> bool:
    """Whether two primitives, the first and the last of a segment sorted by group, are of different groups."""
    if body_group.shape[0] == 0:
        return False
    return body_group[wp.int32(centres[first][3])] != body_group[wp.int32(centres[last][3])]


@wp.kernel
def split_segments(
    begin: int,
    # in
    centres: wp.array[wp.vec4f],
    body_group: wp.array[wp.int32],  # where segments of several groups stay as they are, sorted by group; or empty
    size: int,
    # in and out
    order: wp.array[wp.int64],
):
    """Partition a segment at its middle, by the coordinate along its longest side.

    No primitive of the first half then has a larger coordinate than one of the second.
    """
    first = (begin + wp.tid()) * size
    last = wp.min(first + size, order.shape[0]) - 1
    middle = first + size / 2
    if last < middle or is_mixed(centres, body_group, wp.int32(order[first]), wp.int32(order[last])):
        return
    lower = centres[wp.int32(order[first])]
    upper = lower
    for k in range(first + 1, last + 1):
        centre = centres[wp.int32(order[k])]
        lower = wp.min(lower, centre)
        upper = wp.max(upper, centre)
    axis = longest_axis(upper - lower, size)
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


@wp.func
def ordered_bits(x: wp.float32) -> int:
    """An integer that compares as a number does; the function is its own inverse on bits."""
    bits = wp.cast(x, wp.int32)
    return bits ^ ((bits >> 31) & 0x7FFFFFFF)


@wp.func
def bound_of(bits: int) -> wp.float32:
    """The number of `ordered_bits`."""
    return wp.cast(bits ^ ((bits >> 31) & 0x7FFFFFFF), wp.float32)


@wp.kernel
def bound_segments(
    begin: int,
    # in
    centres: wp.array[wp.vec4f],
    count: int,
    size: int,
    index_mask: wp.int64,
    order: wp.array[wp.int64],
    # in and out
    bounds: wp.array[wp.int32],  # for each segment: least coordinates, and complements of the greatest
):
    """Extend the bounds of a segment by sixteen of its primitives."""
    first = (begin + wp.tid()) * WIDTH
    lower = centres[wp.int32(order[first] & index_mask)]
    upper = lower
    for k in range(first + 1, wp.min(first + WIDTH, count)):
        centre = centres[wp.int32(order[k] & index_mask)]
        lower = wp.min(lower, centre)
        upper = wp.max(upper, centre)
    for axis in range(4):
        atomic_min_int32(bounds, first / size * 8 + axis, ordered_bits(lower[axis]))
        atomic_min_int32(bounds, first / size * 8 + axis + 4, ~ordered_bits(upper[axis]))


@wp.kernel
def fill_keys(
    begin: int,
    # in
    centres: wp.array[wp.vec4f],
    bounds: wp.array[wp.int32],
    body_group: wp.array[wp.int32],
    size: int,
    index_mask: wp.int64,
    index_bits: int,
    bits: int,  # of a coordinate
    # in and out
    order: wp.array[wp.int64],
):
    """Key of the primitive at a place: segment, coordinate along its longest side, index. Rounding does not matter."""
    place = begin + wp.tid()
    index = order[place] & index_mask
    segment = place / size
    lower = wp.vec4f()
    side = wp.vec4f()
    for k in range(4):
        lower[k] = bound_of(bounds[segment * 8 + k])
        side[k] = bound_of(~bounds[segment * 8 + k + 4]) - lower[k]
    axis = longest_axis(side, size)
    largest = wp.float32((1 << bits) - 1)
    centre = centres[wp.int32(index)]
    x = wp.float32(0.0)
    for k in range(4):  # not by a number that is not known in advance, which would need memory
        if k == axis:
            x = (centre[k] - lower[k]) / side[k] * largest
    first = segment * size
    last = wp.min(first + size, centres.shape[0]) - 1
    if is_mixed(centres, body_group, wp.int32(order[first] & index_mask), wp.int32(order[last] & index_mask)):
        x = wp.float32(place - first) / wp.float32(size) * largest
    x = wp.where(x > wp.float32(0.0), wp.where(x < largest, x, largest), wp.float32(0.0))
    order[place] = (((wp.int64(segment) << wp.int64(bits)) | wp.int64(x)) << wp.int64(index_bits)) | index
