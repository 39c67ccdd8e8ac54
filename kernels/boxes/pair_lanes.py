"""Operations of a search for overlapping boxes on up to sixteen pairs of one query at once, in C++.

One pair at a time, most of the time was spent on branches that the processor cannot predict: which sides are tied, and
whether there is capacity for a key. Blocks are laid out as in `box_tree`.
"""

import warp as wp

from .lanes import chosen

_INFLATED = """
    union Number { double x; long long bits; };
    // a lower bound minus the inflation, rounded down, as `inflated_below` in `boxes`
    const auto inflated_below = [=](double x) {
        const double largest = 1.7976931348623157e308;
        Number n;
        n.x = x - inflation;
        if (n.x == 0.0)
            n.bits = -9223372036854775807LL;
        else if (n.x > 0.0)
            n.bits -= 1;
        else if (n.bits != -4503599627370496LL)
            n.bits += 1;
        return n.x > -largest ? n.x : -largest;
    };
    const double* start = (const double*)vertices_t0.data;
    const double* end = (const double*)vertices_t1.data;
    const int* c = corners.data + (long long)block * 48;
    const int* q = query_corners.data + (long long)query_block * 48 + query_lane;
    unsigned apart = 0;
"""

SEPARATED = {
    "scalar": _INFLATED
    + """
    // lower corner and negated upper corner of the swept AABB
    const auto make_box = [=](const int* c, int n, double* box) {
        for (int k = 0; k < 3; ++k) {
            box[k] = start[3LL * c[0] + k];
            box[k + 3] = -box[k];
        }
        for (int i = 0; i < n; ++i) {
            const double* a = start + 3LL * c[16 * i];
            const double* b = end + 3LL * c[16 * i];
            for (int k = 0; k < 3; ++k) {
                const double low = a[k] < b[k] ? a[k] : b[k], high = a[k] < b[k] ? -b[k] : -a[k];
                box[k] = low < box[k] ? low : box[k];
                box[k + 3] = high < box[k + 3] ? high : box[k + 3];
            }
        }
        if (inflation > 0.0)
            for (int k = 0; k < 6; ++k)
                box[k] = inflated_below(box[k]);
    };
    double query[6], target[6];
    make_box(q, num_query_corners, query);
    for (int k = 0; k < 16; ++k) {
        if (((undecided >> k) & 1u) == 0)
            continue;
        make_box(c + k, num_corners, target);
        bool meets = true;
        for (int m = 0; m < 3; ++m)
            meets = meets && target[m] <= -query[m + 3] && query[m] <= -target[m + 3];
        apart |= (unsigned)!meets << k;
    }
    return apart;
""",
    "vector": _INFLATED
    + """
    typedef double Point __attribute__((ext_vector_type(4)));
    // the fourth number repeats the third: a load of four would reach beyond the last vertex
    const auto point = [](const double* x) { return (Point){x[0], x[1], x[2], x[2]}; };
    const auto make_box = [=](const int* c, int n, Point& lower, Point& upper) {
        const Point a = point(start + 3LL * c[0]), b = point(end + 3LL * c[0]);
        lower = a < b ? a : b;
        upper = a < b ? b : a;
        for (int i = 1; i < n; ++i) {
            const Point d = point(start + 3LL * c[16 * i]), e = point(end + 3LL * c[16 * i]);
            lower = d < lower ? d : lower;
            upper = d > upper ? d : upper;
            lower = e < lower ? e : lower;
            upper = e > upper ? e : upper;
        }
        if (inflation > 0.0)
            for (int k = 0; k < 4; ++k) {
                lower[k] = inflated_below(lower[k]);
                upper[k] = -inflated_below(-upper[k]);
            }
    };
    Point query_lower, query_upper, lower, upper;
    make_box(q, num_query_corners, query_lower, query_upper);
    for (; undecided != 0; undecided &= undecided - 1) {
        const int k = __builtin_ctz(undecided);
        make_box(c + k, num_corners, lower, upper);
        const auto meets = (lower <= query_upper) & (query_lower <= upper);
        apart |= (unsigned)(__builtin_reduce_and(meets) == 0) << k;
    }
    return apart;
""",
}


@wp.func_native(chosen(SEPARATED))
def separated_mask(
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    inflation: wp.float64,
    corners: wp.array[wp.int32],
    block: int,
    num_corners: int,
    query_corners: wp.array[wp.int32],
    query_block: int,
    query_lane: int,
    num_query_corners: int,
    undecided: wp.uint32,
) -> wp.uint32:
    """Mask of the ``undecided`` boxes of a block that do not overlap the query's in float64.

    The boxes are exactly the unions of those that `fill_vertex_aabbs` quantizes for ``t_end`` = 1.
    """
    ...


@wp.func_native(
    """
    const long long i = query_primitive.data[query];
    const int* targets = target_primitive.data + 16LL * block;
    long long* found = (long long*)((char*)counts.data + (long long)counts.strides[0] * row) + column;
#if defined(__CUDA_ARCH__)
    const int number = __popc(mask);
    const long long first = (long long)atomicAdd((unsigned long long*)found, (unsigned long long)number);
#else
    const int number = __builtin_popcount(mask);
    const long long first = *found;
    *found = first + number;
#endif
    for (long long n = first; mask != 0 && n < capacity; mask &= mask - 1, ++n) {
#if defined(__CUDA_ARCH__)
        const long long j = targets[__ffs((int)mask) - 1];
#else
        const long long j = targets[__builtin_ctz(mask)];
#endif
        const long long least = j < i ? j : i;
        const long long upper = order == 2 ? least : order == 1 ? j : i;
        keys.data[first_key + n] = upper << 32 | (i + j - upper);
    }
    return number;
"""
)
def append_keys(
    query_primitive: wp.array[wp.int32],
    query: int,
    target_primitive: wp.array[wp.int32],
    block: int,
    mask: wp.uint32,
    order: int,
    counts: wp.array2d[wp.int64],
    row: int,
    column: int,
    capacity: int,
    first_key: int,
    keys: wp.array[wp.int64],
) -> int:
    """Write the keys of a query and the boxes of a block in a mask, up to the capacity; returns the number in the mask.

    The first index of a key is the query's with order 0, the target's with 1, and the lower of the two with 2. On the
    CPU a row of the counts belongs to one thread, so its count needs no atomic operation there.
    """
    ...


_PAIRS = """
    const int i = query_primitive.data[query];
    const int* targets = target_primitive.data + 16LL * block;
    const int* q = query_corners.data + (long long)(query / 16) * 48 + query % 16;
    const int* t = target_corners.data + 48LL * block;
    const int q0 = q[0], q1 = q[16], q2 = q[32];
"""

COLLECT = {
    "avx512": _PAIRS
    + """
    typedef int Row __attribute__((vector_size(64)));
    const Row nothing = {};
    const auto load = [=](const int* x) { return (Row)__builtin_ia32_loaddqusi512_mask(x, nothing, mask); };
    const auto put = [=](int row, Row x) {
        const Row packed = (Row)__builtin_ia32_compresssi512_mask(x, nothing, mask);
        // all of it: a row has a place for each lane beyond those that wait
        __builtin_memcpy(collected.data + row * capacity + count, &packed, sizeof(packed));
    };
    const Row j = load(targets), t0 = load(t), t1 = load(t + 16), t2 = load(t + 32);
    const Row turned = order == 2 ? (Row)(j < nothing + i) : nothing - (order == 1);
    const auto first_of = [=](int of_query, Row of_target) { return turned ? of_target : nothing + of_query; };
    const auto second_of = [=](int of_query, Row of_target) { return turned ? nothing + of_query : of_target; };
    put(0, first_of(q0, t0));
    put(1, of_first == 2 ? first_of(q1, t1) : second_of(q0, t0));
    put(2, of_first == 2 ? second_of(q0, t0) : second_of(q1, t1));
    put(3, of_first == 2 ? second_of(q1, t1) : second_of(q2, t2));
    put(4, first_of(i, j));
    put(5, second_of(i, j));
    return count + __builtin_popcount(mask);
""",
    "vector": _PAIRS
    + """
    for (; mask != 0; mask &= mask - 1, ++count) {
        const int lane = __builtin_ctz(mask);
        const int j = targets[lane], t0 = t[lane], t1 = t[lane + 16], t2 = t[lane + 32];
        const bool turned = order == 2 ? j < i : order == 1;
        const int b0 = turned ? q0 : t0, b1 = turned ? q1 : t1, b2 = turned ? q2 : t2;
        int* c = collected.data + count;
        c[0] = turned ? t0 : q0;
        c[capacity] = of_first == 2 ? (turned ? t1 : q1) : b0;
        c[2 * capacity] = of_first == 2 ? b0 : b1;
        c[3 * capacity] = of_first == 2 ? b1 : b2;
        c[4 * capacity] = turned ? j : i;
        c[5 * capacity] = turned ? i : j;
    }
    return count;
""",
}
COLLECT["scalar"] = COLLECT["vector"]


@wp.func_native(chosen(COLLECT))
def collect_pairs(
    query_primitive: wp.array[wp.int32],
    query_corners: wp.array[wp.int32],
    query: int,
    target_primitive: wp.array[wp.int32],
    target_corners: wp.array[wp.int32],
    block: int,
    mask: wp.uint32,
    order: int,
    of_first: int,
    count: int,
    capacity: int,
    collected: wp.array[wp.int32],
) -> int:
    """Add the pairs of a query and the boxes of a block in a mask to ``count`` others; returns their number.

    Each fills a place of six rows of ``capacity`` numbers: four vertices, of which one or two, ``of_first``, belong to
    the first primitive, and the two primitives. The order is that of `append_keys`. Sixteen places from ``count`` on
    may be written. Only the CPU collects pairs.
    """
    ...
