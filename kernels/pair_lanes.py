"""What a search for overlapping boxes does with up to sixteen pairs of one query at once, in C++.

A pair at a time, a tie cost 34 ns and a key 12: loads of a vertex at a time behind branches that nothing predicts, and a
count in memory. Both functions are plain C++ for every machine, and read blocks as `box_tree` lays them out.
"""

import warp as wp


@wp.func_native(
    """
    union Number { double x; long long bits; };
    const double largest = 1.7976931348623157e308;
    // a lower bound less the inflation, rounded down, as `inflated_below` in `boxes`
    const auto inflated_below = [=](double x) {
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
    const double* start = (const double*)x_t0.data;
    const double* end = (const double*)x_t1.data;
    // lower corner and minus upper corner of the swept box
    const auto make_box = [=](const int* c, int n, double* box) {
        for (int k = 0; k < 3; ++k) {
            const double x = start[3LL * c[0] + k];
            box[k] = x;
            box[k + 3] = -x;
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
    const int* c = corners.data + (long long)block * 48;
    const int* q = query_corners.data + (long long)query_block * 48 + query_lane;
    double query[6], target[6];
    make_box(q, num_query_corners, query);
    unsigned apart = 0;
    for (int k = 0; k < 16; ++k) {
        if (((tied >> k) & 1u) == 0)
            continue;
        make_box(c + k, num_corners, target);
        unsigned meets = 1;
        for (int m = 0; m < 3; ++m)
            meets &= (unsigned)(target[m] <= -query[m + 3]) & (unsigned)(query[m] <= -target[m + 3]);
        apart |= (meets ^ 1u) << k;
    }
    return apart;
"""
)
def separated_mask(
    x_t0: wp.array[wp.vec3d],
    x_t1: wp.array[wp.vec3d],
    inflation: wp.float64,
    corners: wp.array[wp.int32],
    block: int,
    num_corners: int,
    query_corners: wp.array[wp.int32],
    query_block: int,
    query_lane: int,
    num_query_corners: int,
    tied: wp.uint32,
) -> wp.uint32:
    """Which of the ``tied`` boxes of a block do not meet a query's in float64: exactly the boxes of `fill_records`."""
    ...


@wp.func_native(
    """
    const long long i = query_primitive.data[query];
    const int* targets = target_primitive.data + 16LL * block;
    long long* found = (long long*)((char*)counts.data + (long long)counts.strides[0] * row) + column;
    int number = 0;
    for (unsigned left = mask; left != 0; left &= left - 1)
        ++number;
#if defined(__CUDA_ARCH__)
    const long long first = (long long)atomicAdd((unsigned long long*)found, (unsigned long long)number);
#else
    const long long first = *found;
    *found = first + number;
#endif
    long long n = first;
    for (int k = 0; k < 16 && n < capacity; ++k) {
        if (((mask >> k) & 1u) == 0)
            continue;
        const long long j = targets[k];
        const bool is_turned = order == 1 || (order == 2 && j < i);
        keys.data[first_key + n] = is_turned ? (j << 32 | i) : (i << 32 | j);
        ++n;
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
    """Write the keys of a query and the boxes of a block that a mask names, as far as there is capacity; their number.

    The first index is the query's with order 0, the target's with 1, and the lower of the two with 2.
    """
    ...
