"""Operations that are atomic between threads on the CPU as well, where Warp's own are not."""

import warp as wp


@wp.func_native(
    """
    long long* p = (long long*)values.data + index;
#if defined(__CUDA_ARCH__)
    if (*(volatile long long*)p > value)
        atomicMin(p, (long long)value);
#else
    long long seen = __atomic_load_n(p, __ATOMIC_RELAXED);
    while (value < seen && !__atomic_compare_exchange_n(p, &seen, (long long)value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    }
#endif
"""  # noqa: E501
)
def atomic_min_int64(values: wp.array[wp.int64], index: int, value: wp.int64):
    """values[index] = min(values[index], value); a plain read before it saves most of the atomic writes."""
    ...


@wp.func_native(
    """
    int* p = (int*)values.data + index;
#if defined(__CUDA_ARCH__)
    if (*(volatile int*)p > value)
        atomicMin(p, value);
#else
    int seen = __atomic_load_n(p, __ATOMIC_RELAXED);
    while (value < seen && !__atomic_compare_exchange_n(p, &seen, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    }
#endif
"""
)
def atomic_min_int32(values: wp.array[wp.int32], index: int, value: int):
    """values[index] = min(values[index], value)."""
    ...


@wp.func_native(
    """
    int* p = (int*)values.data + index;
#if defined(__CUDA_ARCH__)
    if ((*(volatile int*)p & bits) != bits)
        atomicOr(p, bits);
#else
    __atomic_fetch_or(p, bits, __ATOMIC_RELAXED);
#endif
"""
)
def set_bits(values: wp.array[wp.int32], index: int, bits: int):
    """values[index] |= bits."""
    ...


_CLAIM = """
    long long* p = (long long*)((char*)values.data + (long long)row * values.strides[0]) + column;
#if defined(__CUDA_ARCH__)
    return (wp::int64)atomicAdd((unsigned long long*)p, (unsigned long long)count);
#else
    return (wp::int64)__atomic_fetch_add(p, (long long)count, __ATOMIC_RELAXED);
#endif
"""


@wp.func_native(_CLAIM)
def claim(values: wp.array2d[wp.int64], row: int, column: int, count: int) -> wp.int64:
    """Add ``count`` to values[row, column] and return the value before: the first of so many indices of its own."""
    ...


@wp.func_native(_CLAIM)
def claim(values: wp.array2d[wp.int64], row: int, column: int, count: wp.int64) -> wp.int64:  # noqa: F811
    ...


@wp.func_native(
    """
    int* p = (int*)values.data + index;
#if defined(__CUDA_ARCH__)
    return atomicAdd(p, count);
#else
    return __atomic_fetch_add(p, count, __ATOMIC_RELAXED);
#endif
"""
)
def claim_int(values: wp.array[wp.int32], index: int, count: int) -> int:
    """Add ``count`` to values[index] and return the value before: the first of so many indices of its own."""
    ...
