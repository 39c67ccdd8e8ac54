"""The order of a mesh's primitives at rest: split in halves across the longest side, again and again.

A level launches one item a segment. Segments are sixteen times a power of two long, so the last splits leave the blocks
of the tree. On surfaces it visits a third fewer blocks than the Morton curve, for half a microsecond a primitive, once.

References: Hoare 1961, "Algorithm 65: Find" (selection); Wald 2007, "On fast construction of SAH-based bounding volume
hierarchies" (splits by the extent of the centroids).
"""

import warp as wp

from .lanes import united_vertex_aabbs

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Rounds of one selection; a segment that needs more is left as it is, which costs speed alone.
_MAX_ROUNDS = wp.constant(200)
# Length of a segment from which on bodies are kept apart.
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
    """Centre of each primitive's box in the image and its body, and the order to start from."""
    i = begin + wp.tid()
    c = corners[i]
    r = united_vertex_aabbs(vertex_aabbs, c[0], c[1], c[2])
    centres[i] = wp.vec4f(r[0] - r[4], r[1] - r[5], r[2] - r[6], wp.float32(vertex_body[c[0]]))
    order[i] = wp.int64(i)


@wp.func
def coordinate(centres: wp.array[wp.vec4f], order: wp.array[wp.int64], place: int, axis: int) -> wp.float32:
    """What a place is compared by."""
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
    """Split a segment in halves across its longest side: none of the first is beyond any of the second.

    A short one of several bodies is split between bodies: they will not stay together.
    """
    first = (begin + wp.tid()) * size
    last = wp.min(first + size, order.shape[0]) - 1
    middle = first + size / 2
    if last >= middle:
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
            # the middle of three, of which two may be at the ends of a sorted segment
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
                    held = order[i]
                    order[i] = order[j]
                    order[j] = held
                    i += 1
                    j -= 1
            if middle <= j:
                last = j
            elif middle >= i:
                first = i
            else:
                first = last
