// Vectors of numbers, and loads that the device makes at once.
//
// Included after Warp's headers, which have a `float4` of their own.
#pragma once

#include "intrinsics.h"

#define DEVICE_VECTOR_4(type, base, size)                                                                              \
    struct alignas(size) type##4 {                                                                                     \
        base x, y, z, w;                                                                                               \
    };
#define DEVICE_VECTORS(type, base, size)                                                                       \
    struct alignas(size) type##2 {                                                                                    \
        base x, y;                                                                                                     \
    };                                                                                                                 \
    struct type##3 {                                                                                                   \
        base x, y, z;                                                                                                  \
    };                                                                                                                 \
    inline type##2 make_##type##2(base x, base y) { return { x, y }; }                                                 \
    inline type##3 make_##type##3(base x, base y, base z) { return { x, y, z }; }                                      \
    inline type##4 make_##type##4(base x, base y, base z, base w) { return { x, y, z, w }; }
DEVICE_VECTOR_4(char, signed char, 4)
DEVICE_VECTOR_4(uchar, unsigned char, 4)
DEVICE_VECTOR_4(short, short, 8)
DEVICE_VECTOR_4(ushort, unsigned short, 8)
DEVICE_VECTOR_4(int, int, 16)
DEVICE_VECTOR_4(uint, unsigned, 16)
DEVICE_VECTOR_4(longlong, long long, 16)
DEVICE_VECTOR_4(ulonglong, unsigned long long, 16)
DEVICE_VECTOR_4(double, double, 16)
DEVICE_VECTORS(char, signed char, 2)
DEVICE_VECTORS(uchar, unsigned char, 2)
DEVICE_VECTORS(short, short, 4)
DEVICE_VECTORS(ushort, unsigned short, 4)
DEVICE_VECTORS(int, int, 8)
DEVICE_VECTORS(uint, unsigned, 8)
DEVICE_VECTORS(longlong, long long, 16)
DEVICE_VECTORS(ulonglong, unsigned long long, 16)
DEVICE_VECTORS(float, float, 8)
DEVICE_VECTORS(double, double, 16)
#undef DEVICE_VECTORS
#undef DEVICE_VECTOR_4

// A device faults where an address is no multiple of the size of the load.
template <class T> inline T load_aligned(const T* place, const char* name)
{
    if (reinterpret_cast<uintptr_t>(place) % alignof(T))
        fail_launch("%s of %zu bytes from %p, which is not aligned", name, sizeof(T), (const void*)place);
    return *place;
}
template <class T> inline T __ldg(const T* place) { return load_aligned(place, "__ldg"); }
template <class T> inline T __ldca(const T* place) { return load_aligned(place, "__ldca"); }
template <class T> inline T __ldcg(const T* place) { return load_aligned(place, "__ldcg"); }
template <class T> inline T __ldcs(const T* place) { return load_aligned(place, "__ldcs"); }
template <class T> inline void __stcg(T* place, Same<T> value) { *place = value; }
template <class T> inline void __stcs(T* place, Same<T> value) { *place = value; }

