"""Sixteen threads of CUDA that work together, half a warp: as many as a block of a tree has boxes.

Each thread takes one lane. All sixteen take the same branches up to an operation of this file that combines their
lanes, so a walk through a tree goes the same way for all of them, and the boxes of a block are read in whole lines of
memory. The CPU has no such operations: there one thread takes all lanes, and what it has set is what all have.

Reference: NVIDIA, "CUDA C++ programming guide", "Warp vote functions" and "Warp shuffle functions".
"""

import warp as wp

from .lanes import vec8f

HALF_WARP = wp.constant(16)


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
