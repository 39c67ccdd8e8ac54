"""Warp functions, kernels and structs of ccd_warp: no launch, no allocation, no NumPy."""
