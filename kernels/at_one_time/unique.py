"""Of all pairs with the same two closest features the first, by kind and pair, and how many they are.

The features that several pairs may have are two vertices, a vertex and an edge, or a vertex and the inside of a face
that is in the mesh several times, by the same vertices. Pairs are sorted by a key of the vertex, so that those near
each other stay so, a hash of the rest, and the row of the pair. Those with one hash are neighbours then, nearly always
with the same features; in a list that is in order the first of them comes first.
"""

import warp as wp

from ..pair_kind import EDGE_EDGE, POINT_POINT, VERTEX_FACE, VERTEX_PLANE
from ..step.contacts import sort_key

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Bits of the features of a pair that spans the inside of a face, or of both edges, and that no other pair has.
_INSIDE = wp.constant(15)
# Key of a row that needs no other, which sorts last.
_NO_KEY = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))
_KEY_BITS = wp.constant(63)
# Odd numbers without a pattern (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators").
_MIX = wp.constant(wp.uint64(0xBF58476D1CE4E5B9))
_MIX_MORE = wp.constant(wp.uint64(0x94D049BB133111EB))
_NO_VERTEX = wp.constant(2147483647)
# So many places before they are needed rows are fetched from memory, in which they lie at random.
_AHEAD = wp.constant(16)


@wp.struct
class FeaturePairs:
    """Pairs of primitives by their closest features."""

    count: wp.array[wp.int32]  # more than there are rows where the list is full
    kind: wp.array[wp.int32]
    primitives: wp.array[wp.vec2i]
    features: wp.array[wp.int32]
    edge_corners: wp.array[wp.vec3i]
    face_corners: wp.array[wp.vec3i]
    face_copies: wp.array[wp.int32]  # the first face with the vertices of each, -1 where it is alone; or empty


@wp.func
def features_of(pairs: FeaturePairs, n: int):
    """The two closest features of a pair: a vertex, and both ends of an edge, or twice the larger of two vertices.

    Of a face with copies -1, and the first of these. Of a pair whose features no other has: -1. Three numbers, as a
    vector would go through memory.
    """
    bits = pairs.features[n]
    kind = pairs.kind[n]
    pair = pairs.primitives[n]
    if bits == _INSIDE or kind == VERTEX_PLANE:
        if kind == VERTEX_FACE and pairs.face_copies.shape[0] > 0:
            if pairs.face_copies[pair[1]] >= 0:
                return pair[0], -1, pairs.face_copies[pair[1]]
        return -1, -1, -1
    first = wp.vec3i(pair[0], pair[0], 0)
    second = wp.vec3i(pair[1], pair[1], 0)
    shift = int(2)
    if kind == EDGE_EDGE:
        first = pairs.edge_corners[pair[0]]
    if kind == VERTEX_FACE:
        second = pairs.face_corners[pair[1]]
        shift = 1
    elif kind != POINT_POINT:
        second = pairs.edge_corners[pair[1]]
    low_a = int(_NO_VERTEX)
    low_b = int(_NO_VERTEX)
    high_a = int(-1)
    high_b = int(-1)
    for k in range(3):
        if k < shift and (bits & (1 << k)) != 0:
            low_a = wp.min(low_a, first[k])
            high_a = wp.max(high_a, first[k])
        if (bits & (1 << (k + shift))) != 0:
            low_b = wp.min(low_b, second[k])
            high_b = wp.max(high_b, second[k])
    if low_a != high_a or (low_b == high_b and low_b < low_a):
        return low_b, low_a, high_a
    return low_a, low_b, high_b


@wp.func
def mixed(x: wp.uint64) -> wp.uint64:
    """A number each of whose bits depends on all bits of another."""
    y = (x ^ (x >> wp.uint64(30))) * _MIX
    y = (y ^ (y >> wp.uint64(27))) * _MIX_MORE
    return y ^ (y >> wp.uint64(31))


@wp.kernel
def fill_feature_keys(
    begin: int,
    # in
    pairs: FeaturePairs,
    vertex_bits: int,  # of a feature key: those of the vertex, at the top
    row_bits: int,  # those of the row, at the bottom; between the two is the hash
    # out
    keys: wp.array[wp.int64],
    others: wp.array[wp.vec2i],
    pair_keys: wp.array[wp.int64],
    is_unique: wp.array[wp.bool],
    shared_by: wp.array[wp.int32],
):
    """Compute the key of a pair by its features, unless no other has them, and its own where that counts."""
    n = begin + wp.tid()
    keys[n] = _NO_KEY
    is_unique[n] = False
    if n < pairs.count[0]:
        if pair_keys.shape[0] > 0:
            pair_keys[n] = sort_key(pairs.kind[n], pairs.primitives[n])
        vertex, second, third = features_of(pairs, n)
        if vertex < 0:
            is_unique[n] = True
            shared_by[n] = 1
        else:
            others[n] = wp.vec2i(second, third)
            hash_bits = _KEY_BITS - vertex_bits - row_bits
            h = wp.int64(mixed((wp.uint64(second) << wp.uint64(32)) | wp.uint64(third)) >> wp.uint64(64 - hash_bits))
            keys[n] = (((wp.int64(vertex) << wp.int64(hash_bits)) | h) << wp.int64(row_bits)) | wp.int64(n)


@wp.func_native(
    """
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(others.data + row);
    __builtin_prefetch(pair_keys.data + row);
#endif
"""
)
def fetch_row(others: wp.array[wp.vec2i], pair_keys: wp.array[wp.int64], row: int):
    """Have the processor load a row that is needed soon; on the CPU, and of an empty array nothing."""
    ...


@wp.kernel
def mark_unique(
    begin: int,
    # in
    row_bits: int,
    keys: wp.array[wp.int64],  # ascending
    others: wp.array[wp.vec2i],  # by row: the features but for the vertex
    pair_keys: wp.array[wp.int64],  # by row: what orders pairs; empty where the rows are in order
    # out
    is_unique: wp.array[wp.bool],
    shared_by: wp.array[wp.int32],
):
    """Mark the first pair of each two features with one hash, where the keys of these begin."""
    i = begin + wp.tid()
    key = keys[i]
    if key == _NO_KEY:
        return
    mask = (wp.int64(1) << wp.int64(row_bits)) - wp.int64(1)
    fetch_row(others, pair_keys, wp.int32(keys[wp.min(i + _AHEAD, keys.shape[0] - 1)] & mask))
    h = key >> wp.int64(row_bits)
    if i > 0:
        if (keys[i - 1] >> wp.int64(row_bits)) == h:
            return
    first = wp.int32(key & mask)
    end = int(i + 1)
    while end < keys.shape[0] and (keys[end] >> wp.int64(row_bits)) == h:
        end += 1
    if end == i + 1:
        is_unique[first] = True
        shared_by[first] = 1
        return
    k = int(i)
    left = end - i
    while left > 0:
        first = wp.int32(keys[k] & mask)
        f = others[first]
        # other features may happen to have this hash; those that have come before are done
        is_new = bool(True)
        for j in range(i, k):
            if others[wp.int32(keys[j] & mask)] == f:
                is_new = False
        if is_new:
            count = int(1)
            for j in range(k + 1, end):
                n = wp.int32(keys[j] & mask)
                if others[n] == f:
                    count += 1
                    if pair_keys.shape[0] > 0:
                        if pair_keys[n] < pair_keys[first]:
                            first = n
            is_unique[first] = True
            shared_by[first] = count
            left -= count
        k += 1
