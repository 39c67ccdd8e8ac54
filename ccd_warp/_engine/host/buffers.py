"""Device arrays that are kept for the next step, and the memory they occupy."""

import warp as wp

_GROWTH = 1.25


class Buffers:
    """Named arrays that only grow: a step of the same size allocates nothing.

    Attributes:
        num_allocations: Number of arrays allocated so far.
        capacity: Pairs for which a search for candidates allocates capacity, as learned from earlier steps.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self.num_allocations = 0
        self.capacity = 0
        self._arrays: dict[str, wp.array] = {}

    def get(self, name: str, count: int, dtype: type) -> wp.array:
        """An array of at least ``count`` elements with arbitrary contents; every caller with this name shares it."""
        array = self._arrays.get(name)
        if array is None or len(array) < count:
            size = count if array is None else max(count, int(_GROWTH * len(array)))
            self._arrays.pop(name, None)
            array = self._arrays[name] = wp.empty(max(size, 1), dtype=dtype, device=self.device)
            self.num_allocations += 1
        return array

    def rows(self, name: str, count: int, width: int, dtype: type) -> wp.array:
        """An array of at least ``count`` rows; a row of eight 64-bit numbers fills a cache line of its own."""
        array = self.get(name, -(-count // 64) * 64 * width, dtype)
        return array[: len(array) // width * width].reshape((-1, width))

    def grown(self, name: str, used: int, count: int, dtype: type) -> wp.array:
        """The array of a name with at least ``count`` elements, of which the first ``used`` are kept."""
        array = self._arrays.get(name)
        if array is None or len(array) >= count or used == 0:
            return self.get(name, count, dtype)
        new = wp.empty(max(count, 2 * len(array)), dtype=dtype, device=self.device)
        wp.copy(new, array, count=used)
        self._arrays[name] = new
        self.num_allocations += 1
        return new

    def release(self, name: str) -> None:
        """Leave the array of a name to those who have it."""
        self._arrays.pop(name, None)

    def num_bytes_but(self, *words: str) -> int:
        """Bytes of all arrays whose names contain none of the words."""
        return sum(
            array.capacity for name, array in self._arrays.items() if not any(word in name.split() for word in words)
        )
