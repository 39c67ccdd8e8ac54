"""Sixteen threads of CUDA that work together, half a warp: as many as a block of a tree has boxes.

Each thread takes one lane. All sixteen take the same branches up to an operation of this file that combines their
lanes, so a walk through a tree goes the same way for all of them, and the boxes of a block are read in whole lines of
memory. The CPU has no such operations. There the first thread of a half warp takes all sixteen lanes one after another,
and the others none, so that the same kernels run on it, too. The lanes of a thread are those from `first_lane` to
`end_lane`.

References: NVIDIA, "CUDA C++ programming guide", "Warp vote functions" and "Warp shuffle functions"; Adinets 2014,
"CUDA pro tip: optimized filtering with warp-aggregated atomics".
"""

import warp as wp

from .lanes import vec8f

HALF_WARP = wp.constant(16)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return thread & 15;
#else
    return 0;
#endif
"""
)
def first_lane(thread: int) -> int:
    """The first lane that a thread takes; the number of threads in a launch is a multiple of sixteen."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return (thread & 15) + 1;
#else
    return (thread & 15) == 0 ? 16 : 0;
#endif
"""
)
def end_lane(thread: int) -> int:
    """The lane after the last one that a thread takes; 0 if it takes none."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned shift = threadIdx.x & 16;
    return __ballot_sync(0xFFFFu << shift, lanes != 0) >> shift & 0xFFFFu;
#else
    return lanes;
#endif
"""
)
def united(lanes: wp.uint32) -> wp.uint32:
    """The lanes that any thread of the half warp has set, given those that this one has set among its own."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned shift = threadIdx.x & 16;
    const int leader = __ffs((int)lanes) - 1;
    long long first = 0;
    if ((int)(threadIdx.x & 15) == leader) {
        unsigned long long* p = (unsigned long long*)((char*)values.data + (long long)values.strides[0] * row) + column;
        first = (long long)atomicAdd(p, (unsigned long long)__popc(lanes));
    }
    return (wp::int64)__shfl_sync(0xFFFFu << shift, first, leader, 16);
#else
    long long* p = (long long*)((char*)values.data + (long long)values.strides[0] * row) + column;
    return (wp::int64)__atomic_fetch_add(p, (long long)__builtin_popcount(lanes), __ATOMIC_RELAXED);
#endif
"""
)
def claim_together(values: wp.array2d[wp.int64], row: int, column: int, lanes: wp.uint32) -> wp.int64:
    """`claim` one index for each of the united lanes, of which there is at least one, by a single atomic operation.

    Every thread of the half warp calls it, and gets the index of the first lane.
    """
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __popc(lanes & ((1u << lane) - 1u));
#else
    return __builtin_popcount(lanes & ((1u << lane) - 1u));
#endif
"""
)
def number_before(lanes: wp.uint32, lane: int) -> int:
    """Number of lanes that are set before a lane."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned threads = 0xFFFFu << (threadIdx.x & 16);
    wp::vec_t<8, wp::float32> r = x;
    for (int distance = 8; distance > 0; distance >>= 1)
        for (int k = 0; k < 8; ++k) {
            const float other = __shfl_xor_sync(threads, r[k], distance, 16);
            r[k] = other < r[k] ? other : r[k];
        }
    return r;
#else
    return x;
#endif
"""
)
def least_together(x: vec8f) -> vec8f:
    """The least of each number among the threads of the half warp, all of which call it."""
    ...
