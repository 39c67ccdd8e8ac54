"""The CUDA side of the library without a GPU: the CUDA source that Warp generates, run on threads of the CPU."""
