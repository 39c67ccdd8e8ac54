"""Operations of a search of spatial hashes on the sixteen boxes of a block at once, in C++ (see `lanes`)."""

import warp as wp

from ..boxes.lanes import chosen, vec8f

IN_CELLS = {
    "scalar": """
    const wp::uint64* c = cells.data + 16LL * block;
    unsigned result = 0;
    for (int k = 0; k < 16; ++k)
        if ((mask >> k & 1u) != 0)
            result |= (unsigned)(c[k] >= first && c[k] <= last) << k;
    return result;
""",
    "vector": """
    typedef unsigned long long Cells __attribute__((ext_vector_type(16), aligned(8)));
    typedef bool Bits __attribute__((ext_vector_type(16)));
    const Cells c = *(const Cells*)(cells.data + 16LL * block);
    const Bits inside = __builtin_convertvector((c >= (Cells)first) & (c <= (Cells)last), Bits);
    unsigned short result;
    __builtin_memcpy(&result, &inside, 2);
    return mask & result;
""",
}

CORNERS_OF = {
    "scalar": """
    wp::vec_t<8, wp::float32> r;
    for (int k = 0; k < 6; ++k)
        r[k] = k < 3 ? INFINITY : -INFINITY;
    for (int f = 0; f < num_aabbs; ++f)
        for (unsigned left = mask; left != 0; left &= left - 1) {
#if defined(__CUDA_ARCH__)
            const int lane = __ffs((int)left) - 1;
#else
            const int lane = __builtin_ctz(left);
#endif
            const float* b = nodes.data + ((long long)block * num_aabbs + f) * 96 + lane;
            for (int k = 0; k < 6; ++k)
                r[k] = k < 3 ? (b[16 * k] < r[k] ? b[16 * k] : r[k]) : (b[16 * k] > r[k] ? b[16 * k] : r[k]);
        }
    return r;
""",
    "vector": """
    typedef float Lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int Mask __attribute__((ext_vector_type(16)));
    const Mask bit = {1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    const Mask chosen = ((Mask)(int)mask & bit) != (Mask)0;
    wp::vec_t<8, wp::float32> r;
    for (int k = 0; k < 6; ++k) {
        Lanes least = (Lanes)__builtin_inff();
        for (int f = 0; f < num_aabbs; ++f) {
            const Lanes row = ((const Lanes*)(nodes.data + ((long long)block * num_aabbs + f) * 96))[k];
            const Lanes x = chosen ? (k < 3 ? row : -row) : (Lanes)__builtin_inff();
            least = x < least ? x : least;
        }
        const float x = __builtin_reduce_min(least);
        r[k] = k < 3 ? x : -x;
    }
    return r;
""",
}


@wp.func_native(chosen(IN_CELLS))
def in_cells(cells: wp.array[wp.uint64], block: int, mask: wp.uint32, first: wp.uint64, last: wp.uint64) -> wp.uint32:
    """Those of the boxes of a block in a mask that stand in the cells from the first to the last of a row."""
    ...


@wp.func_native(chosen(CORNERS_OF))
def corners_of(nodes: wp.array[wp.float32], num_aabbs: int, block: int, mask: wp.uint32) -> vec8f:
    """The lower and the upper corner, three numbers each, of the box around those boxes of a block in a mask."""
    ...
