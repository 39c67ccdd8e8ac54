// What CUDA declares for every kernel and g++ does not know: keywords, indices, atomics, bits, arithmetic.
//
// Included before Warp's headers, so that their branches for CUDA find what they call. The types for which CUDA has an
// operation are not checked here; the tests compile every kernel with NVRTC as well.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <type_traits>

#define __global__
#define __device__
#define __host__
#define __constant__
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __cluster_dims__(...)
#define __align__(n) alignas(n)
// a block runs on one thread of the system, and the next block there finds what this one has left, as on a device
#define __shared__ static thread_local

struct dim3 {
    unsigned x, y, z;
};
extern thread_local dim3 blockIdx, threadIdx, blockDim, gridDim;
static constexpr int warpSize = 32;

// End the launch with a message, which the host raises as an error; defined in grid.cpp, as what else is only declared.
[[noreturn]] void fail_launch(const char* format, ...);
[[noreturn]] inline void __trap() { fail_launch("__trap() was called"); }
#define assert(condition) ((condition) ? (void)0 : fail_launch("%s is not true: an index beyond an array", #condition))

// --- atomics: relaxed, as on the device ---

template <class T> using Same = std::common_type_t<T>;  // keeps an argument out of the deduction of the type
template <class T>
using Bits = std::conditional_t<
    sizeof(T) == 8, uint64_t, std::conditional_t<sizeof(T) == 4, uint32_t, std::conditional_t<sizeof(T) == 2, uint16_t, uint8_t>>>;

template <class To, class From> inline To bits_as(From value)
{
    static_assert(sizeof(To) == sizeof(From));
    To result;
    memcpy(&result, &value, sizeof(To));
    return result;
}

// Replace a value by a function of it, and return the value before.
template <class T, class Function> inline T replace_atomically(T* place, Function function)
{
    Bits<T>* bits = reinterpret_cast<Bits<T>*>(place);
    Bits<T> seen = __atomic_load_n(bits, __ATOMIC_RELAXED);
    while (!__atomic_compare_exchange_n(
        bits, &seen, bits_as<Bits<T>>(static_cast<T>(function(bits_as<T>(seen)))), true, __ATOMIC_RELAXED, __ATOMIC_RELAXED
    ))
        ;
    return bits_as<T>(seen);
}

#define DEVICE_ATOMIC(name, expression)                                                                                \
    template <class T> inline T name(T* place, Same<T> value)                                                          \
    {                                                                                                                  \
        return replace_atomically(place, [=](T old) { return expression; });                                           \
    }                                                                                                                  \
    template <class T> inline T name##_block(T* place, Same<T> value) { return name(place, value); }                   \
    template <class T> inline T name##_system(T* place, Same<T> value) { return name(place, value); }
DEVICE_ATOMIC(atomicAdd, old + value)
DEVICE_ATOMIC(atomicSub, old - value)
DEVICE_ATOMIC(atomicMin, value < old ? value : old)
DEVICE_ATOMIC(atomicMax, value > old ? value : old)
DEVICE_ATOMIC(atomicAnd, old & value)
DEVICE_ATOMIC(atomicOr, old | value)
DEVICE_ATOMIC(atomicXor, old ^ value)
DEVICE_ATOMIC(atomicExch, ((void)old, value))
DEVICE_ATOMIC(atomicInc, old >= value ? 0 : old + 1)
DEVICE_ATOMIC(atomicDec, old == 0 || old > value ? value : old - 1)
#undef DEVICE_ATOMIC

template <class T> inline T atomicCAS(T* place, Same<T> expected, Same<T> value)
{
    Bits<T> seen = bits_as<Bits<T>>(static_cast<T>(expected));
    __atomic_compare_exchange_n(
        reinterpret_cast<Bits<T>*>(place), &seen, bits_as<Bits<T>>(static_cast<T>(value)), false, __ATOMIC_RELAXED, __ATOMIC_RELAXED
    );
    return bits_as<T>(seen);
}

inline void __threadfence_block() { std::atomic_thread_fence(std::memory_order_seq_cst); }
inline void __threadfence() { std::atomic_thread_fence(std::memory_order_seq_cst); }
inline void __threadfence_system() { std::atomic_thread_fence(std::memory_order_seq_cst); }

// --- bits ---

inline int __ffs(int x) { return __builtin_ffs(x); }
inline int __ffsll(long long x) { return __builtin_ffsll(x); }
inline int __popc(unsigned x) { return __builtin_popcount(x); }
inline int __popcll(unsigned long long x) { return __builtin_popcountll(x); }
inline int __clz(int x) { return x == 0 ? 32 : __builtin_clz((unsigned)x); }
inline int __clzll(long long x) { return x == 0 ? 64 : __builtin_clzll((unsigned long long)x); }
inline unsigned __brev(unsigned x)
{
    unsigned result = 0;
    for (int k = 0; k < 32; ++k)
        result |= (x >> k & 1u) << (31 - k);
    return result;
}
inline unsigned long long __brevll(unsigned long long x)
{
    return (unsigned long long)__brev((unsigned)x) << 32 | __brev((unsigned)(x >> 32));
}
inline int __float_as_int(float x) { return bits_as<int>(x); }
inline unsigned __float_as_uint(float x) { return bits_as<unsigned>(x); }
inline float __int_as_float(int x) { return bits_as<float>(x); }
inline float __uint_as_float(unsigned x) { return bits_as<float>(x); }
inline long long __double_as_longlong(double x) { return bits_as<long long>(x); }
inline double __longlong_as_double(long long x) { return bits_as<double>(x); }

// --- arithmetic where the device differs from C on a CPU ---

// -0 is less than 0, and a NaN is left out: min.f64 and max.f64 of PTX. Compiled with -fno-builtin, so that it is called.
template <class T> inline T least_of(T a, T b)
{
    if (a != a || b != b)
        return a != a ? b : a;
    return a == b ? (std::signbit(a) ? a : b) : (a < b ? a : b);
}
template <class T> inline T largest_of(T a, T b)
{
    if (a != a || b != b)
        return a != a ? b : a;
    return a == b ? (std::signbit(a) ? b : a) : (a > b ? a : b);
}
extern "C" {
inline __attribute__((used)) double fmin(double a, double b) noexcept { return least_of(a, b); }
inline __attribute__((used)) double fmax(double a, double b) noexcept { return largest_of(a, b); }
inline __attribute__((used)) float fminf(float a, float b) noexcept { return least_of(a, b); }
inline __attribute__((used)) float fmaxf(float a, float b) noexcept { return largest_of(a, b); }
}
