"""Several arrays in one block of memory, so that they are allocated, and some also copied, at once."""

import ctypes
from collections.abc import Mapping
from typing import Any

import warp as wp

_ALIGNMENT = 64


def parts_of(block: wp.array, sizes: Mapping[str, int]) -> dict[str, wp.array]:
    """Arrays of these sizes, one after another in a contiguous array with one index, and so in its gradient."""
    parts, begin = {}, 0
    for name, size in sizes.items():
        of_part = {}
        if block.grad is not None:
            of_part["grad"] = _view(block.grad, begin * block.strides[0], block.dtype, size)
        parts[name] = _view(block, begin * block.strides[0], block.dtype, size, **of_part)
        begin += size
    return parts


def _view(block: wp.array, offset: int, dtype: Any, count: int, **options: Any) -> wp.array:
    """An array at so many bytes behind the begin of a block, which it keeps alive."""
    view: Any = wp.array(ptr=block.ptr + offset, dtype=dtype, shape=(count,), device=block.device, **options)
    view._ref = block
    return view


class Copies:
    """Copies of the first rows of arrays, all in one block."""

    def __init__(self, arrays: Mapping[str, tuple[wp.array, int]], device: Any) -> None:
        """Copy so many rows of each, which are contiguous."""
        self._places: dict[str, tuple[int, Any, int]] = {}
        num_bytes = 0
        for name, (array, count) in arrays.items():
            self._places[name] = num_bytes, array.dtype, count
            num_bytes += -(-array.strides[0] * count // _ALIGNMENT) * _ALIGNMENT
        self._block = wp.empty(max(num_bytes, 1), dtype=wp.uint8, device=device)
        is_read = device.is_cpu and not device.is_capturing
        for name, (array, count) in arrays.items():
            if is_read:
                ctypes.memmove(self._block.ptr + self._places[name][0], array.ptr, array.strides[0] * count)
            elif count:
                wp.copy(self[name], array, count=count)

    def __getitem__(self, name: str) -> wp.array:
        """A copy as an array; a new one each time, in the same memory."""
        offset, dtype, count = self._places[name]
        return _view(self._block, offset, dtype, count)
