// What the lanes of a warp, and the threads of a block, do together.
//
// Every collective of a warp is an exchange: each lane that the mask names brings a number of 64 bits, waits until all of
// them have arrived at the same collective with the same mask, and then knows the numbers of all.
#pragma once

#include "intrinsics.h"

static constexpr unsigned FULL_WARP = 0xffffffffu;

// Wait for the lanes of the mask; the numbers that they have brought, by lane.
const uint64_t* exchange(const char* name, unsigned mask, uint64_t value);
// Wait for all threads of the block that have not ended.
void wait_for_block(const char* name);

static inline unsigned lane_id() { return (threadIdx.z * blockDim.y * blockDim.x + threadIdx.y * blockDim.x + threadIdx.x) % 32; }

template <class T> inline uint64_t as_number(T value)
{
    static_assert(sizeof(T) <= 8);
    uint64_t result = 0;
    memcpy(&result, &value, sizeof(T));
    return result;
}
template <class T> inline T from_number(uint64_t number)
{
    T result;
    memcpy(&result, &number, sizeof(T));
    return result;
}

// Which lanes run together is left to the device: a kernel may rely on nothing but that it includes the lane itself.
inline unsigned __activemask() { return 1u << lane_id(); }

inline void __syncthreads() { wait_for_block("__syncthreads"); }
inline void __syncwarp(unsigned mask = FULL_WARP) { exchange("__syncwarp", mask, 0); }

inline unsigned lanes_for_which(const char* name, unsigned mask, int predicate)
{
    const uint64_t* all = exchange(name, mask, predicate != 0);
    unsigned result = 0;
    for (int k = 0; k < 32; ++k)
        result |= (mask >> k & 1u && all[k]) ? 1u << k : 0u;
    return result;
}
inline unsigned __ballot_sync(unsigned mask, int predicate) { return lanes_for_which("__ballot_sync", mask, predicate); }
inline int __any_sync(unsigned mask, int predicate) { return lanes_for_which("__any_sync", mask, predicate) != 0; }
inline int __all_sync(unsigned mask, int predicate) { return lanes_for_which("__all_sync", mask, predicate) == mask; }

// The number of a lane: garbage if the mask does not name it, as a device leaves it undefined.
template <class T> inline T number_of(const uint64_t* all, unsigned mask, int lane)
{
    return from_number<T>(mask >> lane & 1u ? all[lane] : 0xdeadbeefdeadbeefu);
}
template <class T> inline T __shfl_sync(unsigned mask, T value, int source, int width = 32)
{
    const uint64_t* all = exchange("__shfl_sync", mask, as_number(value));
    const int lane = lane_id();
    return number_of<T>(all, mask, (lane & ~(width - 1)) | (source & (width - 1)));
}
template <class T> inline T __shfl_up_sync(unsigned mask, T value, unsigned distance, int width = 32)
{
    const uint64_t* all = exchange("__shfl_up_sync", mask, as_number(value));
    const int lane = lane_id(), source = lane - (int)distance;
    return source < (lane & ~(width - 1)) ? value : number_of<T>(all, mask, source);
}
template <class T> inline T __shfl_down_sync(unsigned mask, T value, unsigned distance, int width = 32)
{
    const uint64_t* all = exchange("__shfl_down_sync", mask, as_number(value));
    const int lane = lane_id(), source = lane + (int)distance;
    return source > (lane | (width - 1)) ? value : number_of<T>(all, mask, source);
}
template <class T> inline T __shfl_xor_sync(unsigned mask, T value, int bits, int width = 32)
{
    const uint64_t* all = exchange("__shfl_xor_sync", mask, as_number(value));
    const int lane = lane_id(), source = lane ^ bits;
    // a lane reads from its own segment or an earlier one
    return source > (lane | (width - 1)) ? value : number_of<T>(all, mask, source);
}

template <class T> inline unsigned __match_any_sync(unsigned mask, T value)
{
    const uint64_t* all = exchange("__match_any_sync", mask, as_number(value));
    unsigned result = 0;
    for (int k = 0; k < 32; ++k)
        result |= (mask >> k & 1u && all[k] == as_number(value)) ? 1u << k : 0u;
    return result;
}

#define DEVICE_REDUCTION(name, expression)                                                                             \
    template <class T> inline T name(unsigned mask, T value)                                                           \
    {                                                                                                                  \
        const uint64_t* all = exchange(#name, mask, as_number(value));                                                 \
        T result = value;                                                                                              \
        for (int k = 0; k < 32; ++k) {                                                                                 \
            if (!(mask >> k & 1u) || k == (int)lane_id())                                                              \
                continue;                                                                                              \
            const T other = from_number<T>(all[k]);                                                                    \
            result = expression;                                                                                       \
        }                                                                                                              \
        return result;                                                                                                 \
    }
DEVICE_REDUCTION(__reduce_add_sync, result + other)
DEVICE_REDUCTION(__reduce_min_sync, other < result ? other : result)
DEVICE_REDUCTION(__reduce_max_sync, other > result ? other : result)
DEVICE_REDUCTION(__reduce_and_sync, result & other)
DEVICE_REDUCTION(__reduce_or_sync, result | other)
DEVICE_REDUCTION(__reduce_xor_sync, result ^ other)
#undef DEVICE_REDUCTION
