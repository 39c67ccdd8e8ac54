"""Several arrays and their gradients in one block of memory."""

from collections.abc import Mapping
from typing import Any

import warp as wp


def joint_arrays(sizes: Mapping[str, int], device: wp.Device) -> dict[str, wp.array]:
    """Arrays of float64 of these sizes, with gradients, all of them 0: one allocation for all, which is not empty."""
    total = sum(sizes.values())
    block: wp.array = wp.zeros(2 * total, dtype=wp.float64, device=device)
    arrays: dict[str, wp.array] = {}
    place = block.ptr
    for name, size in sizes.items():
        options: Any = {"dtype": wp.float64, "shape": (size,), "device": device}
        grad: Any = wp.array(ptr=place + 8 * total, **options)
        array: Any = wp.array(ptr=place, grad=grad, **options)
        grad._ref = array._ref = block  # as views of Warp keep alive what they show
        arrays[name] = array
        place += 8 * size
    return arrays
