// How a module launches its kernels, and what the device offers them.
#pragma once

#include "collectives.h"

// What a thread of the device runs; the argument is that of the launch.
using DeviceFunction = void (*)(void*);

// Run a function for so many threads, in blocks of the given size; 0 if nothing failed. Threads may use collectives only
// in a cooperative launch, where each has a stack of its own.
extern "C" int run_grid(size_t size, unsigned block_size, int is_cooperative, DeviceFunction function, void* argument);

// The message of the launch that failed, or an empty one; launches work again afterwards.
extern "C" const char* take_error();
