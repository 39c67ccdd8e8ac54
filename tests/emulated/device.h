// Stands before the CUDA source of a module: what a device has, then Warp's headers, and from there on CUDA's branches.
#pragma once

#include "device_launch.h"

// a copy in which the macro below stands for __CUDA_ARCH__, so that Warp's atomics are those of a device
#define EMULATED_CUDA_ARCH 900
// tiles are not emulated; Warp would reset their memory, of so many threads, for each thread
#define WP_TILE_BLOCK_DIM 1
#include "builtin.h"
#include "deterministic.h"
#include "vectors.h"

#undef WP_TILE_BLOCK_DIM
#define __CUDA_ARCH__ 900
