"""A grid of boxes in layers, hashed by row, and the search for overlapping boxes in it.

Every box is stored once: in the layer of its size (and of its body's being static or moving), in the cell of its lower
corner. A query visits the cells in which the lower corner of an overlapping box can lie, so each pair is found once
and nothing has to be deduplicated.

**Cells are integers.** On a layer with quantum q, a power of two, a coordinate x becomes Q(x) = floor((x - origin) / q)
clamped to ±2^36, and a cell is Q shifted right. The difference, the product with a power of two, floor and clamp are
each monotone in floating point whatever they round, so a <= b implies Q(a) <= Q(b), for any finite input. Take two
boxes i and j that overlap (closed: lower_j <= upper_i and lower_i <= upper_j), and let ``span`` be the largest
Q(upper) - Q(lower) in the layer of j. Then Q(lower_j) <= Q(upper_i), and Q(lower_j) >= Q(upper_j) - span >=
Q(lower_i) - span. The window [Q(lower_i) - span, Q(upper_i)] holds every partner: rounding, clamping and overflow can
only add tests. A box is no longer than a cell of its layer, so the window is a few cells wide.

**Rows.** The cells (x, y, z) of one row (y, z) follow each other in the table, from hash(y, z) on and modulo the size
of the table, so the window is one range of boxes per row. Other rows may be hashed to the same place; a box counts only
where its own row, read from its words, is the visited one.

**Words.** Q(lower) and Q(upper) modulo 2^21 per axis sit in one 64-bit word each; comparing these words first settles
most tests with a dozen integer operations. Differences of overlapping boxes are far below 2^20, so the modulo can only
let too many through, and these meet the exact float64 test.
"""

import warp as wp

from .boxes import vec3_max, vec3_min

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

CELL_SHIFT = wp.constant(wp.int64(6))  # a cell is 2^6 quanta long in y and z …
BUCKET_SHIFT = wp.constant(wp.int64(4))  # … and 2^4 in x, where a finer window costs nothing
QUANTUM_LIMIT = wp.constant(wp.float64(68719476736.0))  # 2^36: cells fit 32 bits with room to spare
NUM_RAW_LAYERS = wp.constant(64)  # 32 sizes, each moving and static

HASH_Y = wp.constant(wp.uint32(0x9E3779B1))
HASH_Z = wp.constant(wp.uint32(0x85EBCA77))
HASH_MIX = wp.constant(wp.uint32(0x2C1B3C6D))

FIELD_MASK = wp.constant(wp.int64((1 << 21) - 1))
SIGN_BITS = wp.constant(wp.uint64((1 << 20) | (1 << 41) | (1 << 62)))
OTHER_BITS = wp.constant(wp.uint64(((1 << 63) - 1) & ~((1 << 20) | (1 << 41) | (1 << 62))))
ROW_BITS = wp.constant(wp.uint64((0x1FFFC0 << 21) | (0x1FFFC0 << 42)))  # the cell in y and z, modulo 2^15
BUCKET_FIELD_MASK = wp.constant(wp.int64((1 << 17) - 1))  # a bucket modulo 2^(21 - BUCKET_SHIFT)
BUCKET_FIELD_HALF = wp.constant(wp.int64(1 << 16))

# Which set queries which. Of two sets the first holds the small primitives (vertices, loose points), the second the
# large ones (faces, loose edges).
WITHIN_SET = wp.constant(0)
SECOND_TO_FIRST = wp.constant(1)
FIRST_TO_SECOND = wp.constant(2)
SECOND_HEADROOM = wp.constant(1)

vec3l = wp.types.vector(length=3, dtype=wp.int64)
vec2ul = wp.types.vector(length=2, dtype=wp.uint64)


@wp.struct
class Grid:
    """Boxes of one kind of primitive, sorted by bucket."""

    num_layers: int
    layers: wp.array[wp.int32]  # raw ids of the layers that occur
    inverse_quantum: wp.array[wp.float64]  # per raw layer, as the next three
    bucket_begin: wp.array[wp.int32]
    bucket_mask: wp.array[wp.int32]
    span: wp.array[vec3l]
    entry_begin: wp.array[wp.int32]  # per bucket, one more at the end
    layer: wp.array[wp.int32]  # per entry, as all that follow
    primitive: wp.array[wp.int32]
    words: wp.array[vec2ul]
    box_lower: wp.array[wp.vec3d]
    box_upper: wp.array[wp.vec3d]


@wp.func
def quantum_index(x: wp.vec3d, origin: wp.vec3d, inverse_quantum: wp.float64) -> vec3l:
    """Integer coordinates; monotone in every component of x."""
    q = vec3l()
    for k in range(3):
        # Halves, so that the difference of two finite numbers is finite.
        s = wp.floor((wp.float64(0.5) * x[k] - wp.float64(0.5) * origin[k]) * (inverse_quantum + inverse_quantum))
        q[k] = wp.int64(wp.clamp(s, -QUANTUM_LIMIT, QUANTUM_LIMIT))
    return q


@wp.func
def pack(q: vec3l) -> wp.uint64:
    """Three coordinates modulo 2^21 in one word."""
    x = q[0] & FIELD_MASK
    y = (q[1] & FIELD_MASK) << wp.int64(21)
    z = (q[2] & FIELD_MASK) << wp.int64(42)
    return wp.uint64(x | y | z)


@wp.func
def row_hash(y: wp.int64, z: wp.int64) -> wp.int32:
    """Place of the cell (0, y, z) before the modulo; mixed so that near rows do not lie side by side."""
    h = wp.uint32(y) * HASH_Y + wp.uint32(z) * HASH_Z
    h = (h ^ (h >> wp.uint32(15))) * HASH_MIX
    h = h ^ (h >> wp.uint32(13))
    return wp.int32(h & wp.uint32(1073741823))


@wp.func
def longest_extent(lower: wp.vec3d, upper: wp.vec3d) -> wp.float64:
    """Longest side of a box, to rounding; infinite where it overflows."""
    return wp.max(upper[0] - lower[0], wp.max(upper[1] - lower[1], upper[2] - lower[2]))


@wp.func
def exponent_above(x: wp.float64) -> wp.int32:
    """Smallest e with x <= 2^e for normal x >= 0; -1022 or less below that, and never more than 1023."""
    bits = wp.cast(x, wp.int64)
    e = wp.int32(bits >> wp.int64(52)) - 1023
    if (bits & wp.int64(0xFFFFFFFFFFFFF)) != wp.int64(0):
        e += 1
    return wp.min(e, 1023)


@wp.kernel
def sample_boxes(
    begin: int,
    # in
    box_lower: wp.array[wp.vec3d],
    box_upper: wp.array[wp.vec3d],
    stride: int,
    # out
    sample_lower: wp.array[wp.vec3d],
    sample_extent: wp.array[wp.float64],
):
    """Every ``stride``-th box, for the choice of origin and cell size."""
    s = begin + wp.tid()
    i = s * stride
    sample_lower[s] = box_lower[i]
    sample_extent[s] = longest_extent(box_lower[i], box_upper[i])


@wp.kernel
def chunk_longest_extent(
    begin: int,
    # in
    box_lower: wp.array[wp.vec3d],
    box_upper: wp.array[wp.vec3d],
    chunk: int,
    # out
    longest: wp.array[wp.float64],
):
    """Longest extent in a chunk of boxes: a reduction without atomics, which the CPU does not have."""
    c = begin + wp.tid()
    result = wp.float64(0.0)
    for i in range(c * chunk, wp.min((c + 1) * chunk, box_lower.shape[0])):
        result = wp.max(result, longest_extent(box_lower[i], box_upper[i]))
    longest[c] = result


@wp.kernel
def assign_layers(
    begin: int,
    # in
    box_lower: wp.array[wp.vec3d],
    box_upper: wp.array[wp.vec3d],
    is_static: wp.array[wp.int32],
    origin: wp.vec3d,
    inverse_quantum: wp.array[wp.float64],
    base_exponent: int,
    level_step: int,
    chunk: int,
    # out
    layer: wp.array[wp.int32],
    chunk_count: wp.array2d[wp.int32],
    chunk_span: wp.array2d[vec3l],
):
    """Layer of each box (2 level + static) and, per chunk, how many boxes each layer holds and their largest span."""
    c = begin + wp.tid()
    for i in range(c * chunk, wp.min((c + 1) * chunk, box_lower.shape[0])):
        lower = box_lower[i]
        upper = box_upper[i]
        e = exponent_above(longest_extent(lower, upper))
        raw = is_static[i]
        if e > base_exponent:
            raw += 2 * wp.min((e - base_exponent + level_step - 1) / level_step, NUM_RAW_LAYERS / 2 - 1)
        layer[i] = raw
        chunk_count[c, raw] = chunk_count[c, raw] + 1
        s = quantum_index(upper, origin, inverse_quantum[raw]) - quantum_index(lower, origin, inverse_quantum[raw])
        t = chunk_span[c, raw]
        chunk_span[c, raw] = vec3l(wp.max(s[0], t[0]), wp.max(s[1], t[1]), wp.max(s[2], t[2]))


@wp.kernel
def bucket_keys(
    begin: int,
    # in
    box_lower: wp.array[wp.vec3d],
    layer: wp.array[wp.int32],
    origin: wp.vec3d,
    inverse_quantum: wp.array[wp.float64],
    bucket_begin: wp.array[wp.int32],
    bucket_mask: wp.array[wp.int32],
    # out
    keys: wp.array[wp.int64],
):
    """Sort key of each box: its bucket, then its index."""
    i = begin + wp.tid()
    raw = layer[i]
    q = quantum_index(box_lower[i], origin, inverse_quantum[raw])
    h = row_hash(q[1] >> CELL_SHIFT, q[2] >> CELL_SHIFT) + wp.int32(q[0] >> BUCKET_SHIFT)
    bucket = bucket_begin[raw] + (h & bucket_mask[raw])
    keys[i] = (wp.int64(bucket) << wp.int64(32)) | wp.int64(i)


@wp.kernel
def fill_grid(
    begin: int,
    # in
    keys: wp.array[wp.int64],
    count: int,
    num_buckets: int,
    box_lower: wp.array[wp.vec3d],
    box_upper: wp.array[wp.vec3d],
    layer: wp.array[wp.int32],
    origin: wp.vec3d,
    # out
    grid: Grid,
):
    """Write each box to its sorted place, and where every bucket begins."""
    k = begin + wp.tid()
    bucket = wp.int32(keys[k] >> wp.int64(32))
    first = 0
    if k > 0:
        first = wp.int32(keys[k - 1] >> wp.int64(32)) + 1
    for b in range(first, bucket + 1):
        grid.entry_begin[b] = k
    if k == count - 1:
        for b in range(bucket + 1, num_buckets + 1):
            grid.entry_begin[b] = count
    i = wp.int32(keys[k] & wp.int64(0xFFFFFFFF))
    raw = layer[i]
    lower = box_lower[i]
    upper = box_upper[i]
    grid.layer[k] = raw
    grid.primitive[k] = i
    grid.box_lower[k] = lower
    grid.box_upper[k] = upper
    word_lower = pack(quantum_index(lower, origin, grid.inverse_quantum[raw]))
    word_upper = pack(quantum_index(upper, origin, grid.inverse_quantum[raw]))
    grid.words[k] = vec2ul(word_lower, word_upper)


@wp.func
def overlap_bits(lower_i: wp.uint64, upper_i: wp.uint64, words_j: vec2ul) -> wp.uint64:
    """All SIGN_BITS for boxes that overlap: the inverted sign of upper - lower, per axis, modulo 2^21, both ways."""
    # With the sign bits of the minuend set and those of the subtrahend cleared no borrow leaves its field; the two
    # sign bits taken away are put back by the exclusive or.
    d0 = ((upper_i | SIGN_BITS) - (words_j[0] & OTHER_BITS)) ^ (upper_i ^ words_j[0])
    d1 = ((words_j[1] | SIGN_BITS) - (lower_i & OTHER_BITS)) ^ (words_j[1] ^ lower_i)
    return d0 & d1 & SIGN_BITS


@wp.func
def boxes_overlap(lower_i: wp.vec3d, upper_i: wp.vec3d, lower_j: wp.vec3d, upper_j: wp.vec3d) -> bool:
    """Closed boxes share a point: exact."""
    lower = vec3_max(lower_i, lower_j)
    upper = vec3_min(upper_i, upper_j)
    return lower[0] <= upper[0] and lower[1] <= upper[1] and lower[2] <= upper[2]


@wp.func
def share_vertex(a: wp.vec3i, b: wp.vec3i) -> bool:
    """True if two primitives have a vertex in common."""
    return (
        (a[0] == b[0] or a[0] == b[1] or a[0] == b[2])
        or (a[1] == b[0] or a[1] == b[1] or a[1] == b[2])
        or (a[2] == b[0] or a[2] == b[1] or a[2] == b[2])
    )


@wp.func
def layer_is_visited(kind: int, own: int, other: int, skip_moving: int) -> bool:
    """Which of two layers queries the other: exactly one, none if both are static.

    Fine queries coarse, so a giant box does not walk through a million cells; a face may be SECOND_HEADROOM levels
    above a vertex and still query it, because its window ends at its own size while a vertex would look a whole cell
    around. Within one level and set moving boxes query static ones.
    """
    own_static = own & 1
    other_static = other & 1
    if own_static == other_static and (own_static == 1 or skip_moving == 1):
        return False
    own_level = own >> 1
    other_level = other >> 1
    if kind == SECOND_TO_FIRST:
        return own_level <= other_level + SECOND_HEADROOM
    if kind == FIRST_TO_SECOND:
        return other_level > own_level + SECOND_HEADROOM
    if own_level != other_level:
        return own_level < other_level
    return own_static <= other_static


@wp.func
def sees_ahead(own: wp.uint64, other: wp.uint64, own_place: int, other_place: int, mask: int) -> bool:
    """Which of two overlapping boxes of one layer reports the pair: the one whose row, bucket or place comes first.

    Queries visit only their own row and later ones, so rows are settled where they differ.
    """
    behind = other_place <= own_place
    if mask != 0:
        if ((own ^ other) & ROW_BITS) != wp.uint64(0):
            return True
        ahead = ((wp.int64(other) >> BUCKET_SHIFT) - (wp.int64(own) >> BUCKET_SHIFT)) & BUCKET_FIELD_MASK
        if ahead != wp.int64(0):
            return ahead < BUCKET_FIELD_HALF
    return not behind


@wp.func
def scan_range(
    k_begin: int,
    k_end: int,
    words: wp.array[vec2ul],
    word_lower: wp.uint64,
    word_upper: wp.uint64,
    row: wp.uint64,
    row_bits: wp.uint64,
    scratch: wp.array[wp.int32],
    scratch_end: int,
) -> int:
    """Append the boxes of a range that pass the word test and lie in the row; returns the new end of the scratch."""
    # Always written, kept only where the test holds: a branch here would be mispredicted at every hit.
    # A while loop: the iterator of a range took as many instructions as the test.
    n = wp.int32(scratch_end)
    k = wp.int32(k_begin)
    while k < k_end:
        w = words[k]
        scratch[n] = k
        misses = (w[0] ^ row) & row_bits | (overlap_bits(word_lower, word_upper, w) ^ SIGN_BITS)
        n += wp.where(misses == wp.uint64(0), 1, 0)
        k += 1
    return n


@wp.kernel
def find_pairs(
    begin: int,
    # in
    kind: int,
    query: Grid,
    target: Grid,
    target_words: wp.array[vec2ul],
    target_entry_begin: wp.array[wp.int32],
    query_corners: wp.array[wp.vec3i],
    target_corners: wp.array[wp.vec3i],
    query_body: wp.array[wp.int32],
    target_body: wp.array[wp.int32],
    body_self_collision: wp.array[wp.int32],
    filter_bodies: int,
    skip_moving: int,
    origin: wp.vec3d,
    num_queries: int,
    block: int,
    item_first: int,
    item_stride: int,
    pair_begin: wp.array[wp.int64],
    scratch: wp.array[wp.int32],
    scratch_size: int,
    # out
    pair_count: wp.array[wp.int64],
    keys: wp.array[wp.int64],
):
    """Find the partners of the query boxes in blocks of ``block`` that are ``item_stride`` blocks apart.

    Item t owns keys[pair_begin[t]:pair_begin[t + 1]]. It counts all its pairs and writes those that fit, so a launch
    with no room is a count, and one with room enough needs no second. A key is (first << 32) | second.
    """
    t = begin + wp.tid()
    out = pair_begin[t]
    room = pair_begin[t + 1] - out
    found = wp.int64(0)
    hits_begin = t * scratch_size
    hits_end = wp.int32(hits_begin)
    block_begin = (item_first + t) * block
    while block_begin < num_queries:
        for p in range(block_begin, wp.min(block_begin + block, num_queries)):
            own = query.layer[p]
            i = query.primitive[p]
            lower = query.box_lower[p]
            upper = query.box_upper[p]
            corners = query_corners[i]
            for n in range(target.num_layers):
                other = target.layers[n]
                if layer_is_visited(kind, own, other, skip_moving):
                    half = kind == WITHIN_SET and own == other
                    q_lower = quantum_index(lower, origin, target.inverse_quantum[other])
                    q_upper = quantum_index(upper, origin, target.inverse_quantum[other])
                    word_lower = pack(q_lower)
                    word_upper = pack(q_upper)
                    q_begin = q_lower - target.span[other]
                    mask = target.bucket_mask[other]
                    table = target.bucket_begin[other]
                    own_y = q_lower[1] >> CELL_SHIFT
                    own_z = q_lower[2] >> CELL_SHIFT
                    row_bits = ROW_BITS
                    y_begin = q_begin[1] >> CELL_SHIFT
                    y_end = (q_upper[1] >> CELL_SHIFT) + wp.int64(1)
                    z = q_begin[2] >> CELL_SHIFT
                    z_end = (q_upper[2] >> CELL_SHIFT) + wp.int64(1)
                    if half:
                        z = own_z  # partners in earlier rows find this box themselves
                    if mask == 0:
                        z = z_end - wp.int64(1)  # a handful of boxes in a single bucket: rows do not count, visit once
                        y_begin = y_end - wp.int64(1)
                        row_bits = wp.uint64(0)
                    while z < z_end:
                        y = y_begin
                        if half and z == own_z and mask != 0:
                            y = own_y
                        while y < y_end:
                            x_begin = q_begin[0] >> BUCKET_SHIFT
                            if half and z == own_z and y == own_y:
                                x_begin = q_lower[0] >> BUCKET_SHIFT
                            length = wp.int32((q_upper[0] >> BUCKET_SHIFT) - x_begin) + 1
                            first = wp.int32(0)
                            if length <= mask:
                                first = (row_hash(y, z) + wp.int32(x_begin)) & mask
                            else:
                                length = mask + 1
                            rest = first + length - (mask + 1)  # part of the range that wraps around
                            k = target_entry_begin[table + first]
                            k_end = target_entry_begin[table + first + wp.min(length, mask + 1 - first)]
                            row = pack(vec3l(wp.int64(0), y << CELL_SHIFT, z << CELL_SHIFT))
                            last_row = z + wp.int64(1) == z_end and y + wp.int64(1) == y_end
                            open_range = wp.int32(1)
                            while open_range == 1:
                                k_stop = wp.min(k_end, k + scratch_size / 2)
                                hits_end = scan_range(
                                    k, k_stop, target_words, word_lower, word_upper, row, row_bits, scratch, hits_end
                                )
                                k = k_stop
                                if k >= k_end:
                                    if rest > 0:
                                        k = target_entry_begin[table]
                                        k_end = target_entry_begin[table + rest]
                                        rest = wp.int32(0)
                                    else:
                                        open_range = wp.int32(0)
                                if hits_end - hits_begin > scratch_size / 2 or (last_row and open_range == 0):
                                    for s in range(hits_begin, hits_end):
                                        hit = scratch[s]
                                        j = target.primitive[hit]
                                        accept = boxes_overlap(
                                            lower, upper, target.box_lower[hit], target.box_upper[hit]
                                        )
                                        accept = accept and not share_vertex(corners, target_corners[j])
                                        if half:
                                            accept = accept and sees_ahead(
                                                word_lower, target_words[hit][0], p, hit, mask
                                            )
                                        if filter_bodies == 1 and accept:
                                            body = query_body[i]
                                            accept = body != target_body[j] or body_self_collision[body] == 1
                                        if accept:
                                            if found < room:
                                                a = i
                                                b = j
                                                if kind == SECOND_TO_FIRST or (kind == WITHIN_SET and j < i):
                                                    a = j
                                                    b = i
                                                keys[wp.int32(out + found)] = (wp.int64(a) << wp.int64(32)) | wp.int64(
                                                    b
                                                )
                                            found += wp.int64(1)
                                    hits_end = hits_begin
                            y += wp.int64(1)
                        z += wp.int64(1)
        block_begin += item_stride * block
    pair_count[t] = found


@wp.kernel
def unpack_pairs(
    begin: int,
    # in
    keys: wp.array[wp.int64],
    # out
    pairs: wp.array[wp.vec2i],
):
    """Split each key into its two indices."""
    k = begin + wp.tid()
    pairs[k] = wp.vec2i(wp.int32(keys[k] >> wp.int64(32)), wp.int32(keys[k] & wp.int64(0xFFFFFFFF)))


@wp.kernel
def unpack_subset_pairs(
    begin: int,
    # in
    keys: wp.array[wp.int64],
    first_ids: wp.array[wp.int32],
    second_ids: wp.array[wp.int32],
    # out
    pairs: wp.array[wp.vec2i],
):
    """The same where the sets are subsets: indices into them become ids of the mesh; ascending ids keep the order."""
    k = begin + wp.tid()
    i = wp.int32(keys[k] >> wp.int64(32))
    j = wp.int32(keys[k] & wp.int64(0xFFFFFFFF))
    pairs[k] = wp.vec2i(first_ids[i], second_ids[j])
