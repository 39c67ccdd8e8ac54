"""The flag by which the host ends kernels that may run for a long time: Python cannot interrupt them.

A kernel that finds the flag set leaves the rest of its work undone, and the host discards its results. On CUDA the flag
is not read.
"""

import warp as wp


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return false;
#else
    return stop.data != nullptr && __atomic_load_n((int*)stop.data, __ATOMIC_RELAXED) != 0;
#endif
"""
)
def is_stopped(stop: wp.array[wp.int32]) -> bool:
    """Whether the host wants the kernel to end; always false for an empty array."""
    ...
