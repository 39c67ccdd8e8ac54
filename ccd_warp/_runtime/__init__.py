"""Launches of kernels, threads that share them, and how far they are."""
