// How a module launches its kernels, and what the device offers them.
#pragma once

#include "collectives.h"

// What a thread of the device runs; the argument is that of the launch.
using DeviceFunction = void (*)(void*);

// Whom a thread may wait for: none, which needs no stack of its own; the lanes of its warp; all of its block, which then
// has the shared memory for itself.
enum Togetherness { ALONE, WARPS, BLOCKS };

// Run a function for so many threads, in blocks of the given size; 0 if nothing failed.
extern "C" int run_grid(size_t size, unsigned block_size, Togetherness togetherness, DeviceFunction function, void* argument);

// The message of the launch that failed, or an empty one; launches work again afterwards.
extern "C" const char* take_error();
