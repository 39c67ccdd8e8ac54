"""What kernels count in a step, and the least toi so far, as the host reads and sets them."""

from collections.abc import Mapping

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.plan import COUNTS_SHAPE, NUM_ALL_COUNTS
from ccd_warp._runtime.status import PairKind

_OnHost = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]


class Counters:
    """The counts of the pairs of each kind, the least toi, and large blocks of trees, in one array.

    On CUDA reading waits for the device, once after what has changed them.

    Attributes:
        least_bits: The least toi as bits, on the device, shape [1].
    """

    def __init__(self, counters: wp.array, *, is_cuda: bool) -> None:
        self._counters, self.least_bits = counters, counters[NUM_ALL_COUNTS : NUM_ALL_COUNTS + 1]
        self._view = None if is_cuda else _split(counters.numpy())
        self._read: _OnHost | None = None  # on CUDA, as long as nothing is launched that changes them
        self._rows: list[list[int]] | None = None  # the same of the counts alone, on the CPU as well

    def change(self) -> None:
        """Note that a launch may change them."""
        self._read = self._rows = None

    def _on_host(self) -> _OnHost:
        if self._view is not None:
            return self._view
        if self._read is None:
            self._read = _split(self._counters.numpy())
        return self._read

    def counts(self) -> NDArray[np.int64]:
        """The counts of each kind, a row each, after the last launch."""
        return self._on_host()[0]

    def rows(self) -> list[list[int]]:
        """The same as lists, of which it takes less to read some."""
        if self._rows is None:
            self._rows = self.counts().tolist()
        return self._rows

    def clear(self) -> None:
        """Count the pairs of the next launches from 0."""
        self._rows = None
        if self._view is not None:
            self._view[0].fill(0)
        else:
            self._counters[:NUM_ALL_COUNTS].zero_()
            self._read = None

    def set_column(self, column: int, numbers: Mapping[PairKind, int]) -> None:
        """Let pairs of kinds count as so many."""
        counts, self._rows = self.counts(), None
        for kind, number in numbers.items():
            counts[kind, column] = number
        if self._view is None:
            self._counters[:NUM_ALL_COUNTS].assign(counts.ravel())

    def least(self) -> float:
        """The least toi so far."""
        return float(self._on_host()[1][0])

    def large_blocks(self) -> list[int]:
        """Blocks of each tree that were counted as large so far; they are never set back."""
        return self._on_host()[2].tolist()

    def set_least(self, toi: float) -> None:
        """Set the least toi so far."""
        if self._view is not None:
            self._view[1][0] = toi
        else:
            self.least_bits.assign(np.array([toi]).view(np.int64))
            self._read = None


def _split(counters: NDArray[np.int64]) -> _OnHost:
    """The counts, the least toi and the blocks of an array of all."""
    least = counters[NUM_ALL_COUNTS : NUM_ALL_COUNTS + 1].view(np.float64)
    return counters[:NUM_ALL_COUNTS].reshape(COUNTS_SHAPE), least, counters[NUM_ALL_COUNTS + 1 :]
