"""The narrow phase: the kernels that solve many pairs, on the CPU and on CUDA, and half-spaces."""
