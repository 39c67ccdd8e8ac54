"""The kernels of gradients: slopes of tois, and the backward passes of steps and line searches."""
