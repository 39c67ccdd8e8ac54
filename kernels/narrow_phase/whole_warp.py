"""A warp of CUDA that works on one pair: all its threads do the same, but each clips with other facets of the patch.

The solver for single pairs is one long chain of operations, most of them clips with one facet after another, of which
the latest counts. A warp that shares the facets takes a tenth of the time for a pair that is far from settled, and
waits for no other pair. All threads have the same numbers and take the same branches, so they meet in every operation
of this file. The CPU has no such operations: there one thread takes all facets.

Reference: NVIDIA, "CUDA C++ programming guide", "Warp shuffle functions".
"""

import warp as wp

WARP = 32
_SIZE = wp.constant(WARP)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return threadIdx.x & 31;
#else
    return 0;
#endif
"""
)
def number_in_warp() -> int:
    """The number of a thread in its warp: the first of the things that it takes, which are `num_shares` apart."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif
"""
)
def num_shares() -> int:
    """Number of threads that share what there is to do."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    for (int bits = 16; bits > 0; bits >>= 1) {
        const auto other = __shfl_xor_sync(0xFFFFFFFFu, t, bits);
        t = t < other ? other : t;
    }
#endif
    return t;
"""
)
def latest(t: wp.float64) -> wp.float64:
    """The latest of the times that the threads of the warp have found."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    for (int bits = 16; bits > 0; bits >>= 1) {
        const auto other = __shfl_xor_sync(0xFFFFFFFFu, t, bits);
        t = t < other ? other : t;
    }
#endif
    return t;
"""
)
def latest(t: wp.float32) -> wp.float32:  # noqa: F811
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncwarp();
    return __shfl_sync(0xFFFFFFFFu, (int)is_true, 0) != 0;
#else
    return is_true;
#endif
"""
)
def agreed(is_true: bool) -> bool:
    """What the first thread of the warp has found, where others change meanwhile what they look at.

    What the threads have read before is read when the first of them goes on, and may write there.
    """
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return true;
#else
    return thread % 32 == 0;
#endif
"""
)
def takes_part(thread: int) -> bool:
    """Whether a thread works on the item of its warp: on the CPU only the first one does."""
    ...


@wp.func
def item_of_warp(thread: int, count: int) -> int:
    """The item of the warp of a thread; ``count`` if the thread takes no part."""
    return wp.where(takes_part(thread), thread / _SIZE, count)


@wp.func
def is_first(thread: int) -> bool:
    """Whether a thread is the first of its warp, which writes for all."""
    return thread % _SIZE == 0


@wp.func_native("return __ballot_sync(0xFFFFFFFFu, is_true);")
def threads_where(is_true: bool) -> wp.uint32:
    """The threads of the warp for which something is true."""
    ...


@wp.func_native(
    """
    long long first = 0;
    if ((threadIdx.x & 31) == 0) {
        unsigned long long* p = (unsigned long long*)((char*)values.data + (long long)values.strides[0] * row) + column;
        first = (long long)atomicAdd(p, (unsigned long long)__popc(threads));
    }
    return (wp::int64)__shfl_sync(0xFFFFFFFFu, first, 0) + __popc(threads & ((1u << (threadIdx.x & 31)) - 1u));
"""
)
def claim_for(threads: wp.uint32, values: wp.array2d[wp.int64], row: int, column: int) -> wp.int64:
    """`claim` an index for each of some threads of the warp, by one atomic operation; returns that of the thread."""
    ...
