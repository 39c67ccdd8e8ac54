"""What kernels count in a step, and every toi, as the host reads and sets them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.plan import COUNTS_SHAPE, NUM_ALL_COUNTS
from ccd_warp._runtime.status import PairKind

# Trees of bodies that move in a plan: at most five sets of primitives, each of bodies of two roles.
_MOST_TREES = 10


class _OnHost(NamedTuple):
    """All but the tois: the number of contacts, the counts, the least toi, and large blocks."""

    contacts: NDArray[np.int32]
    counts: NDArray[np.int64]
    least: NDArray[np.float64]
    blocks: NDArray[np.int64]

    @classmethod
    def of(cls, values: NDArray[np.int64]) -> "_OnHost":
        counts, others = values[1 : 1 + NUM_ALL_COUNTS], values[1 + NUM_ALL_COUNTS :]
        return cls(values[:1].view(np.int32), counts.reshape(COUNTS_SHAPE), others[:1].view(np.float64), others[1:])


class Counters:
    """The tois of a mesh, the number of contacts, the counts of the pairs of each kind, the least toi, large blocks.

    They are one array, which CUDA reads at once, or all but the tois. Reading waits for the device, once after what has
    changed them.

    Attributes:
        toi: The tois, on the device, float64.
        num_contacts: The number of contacts, on the device, int32, shape [1].
        array: What follows these, on the device, int64: the counts, the bits of the least toi, large blocks of trees.
        least_bits: The least toi as bits, on the device, shape [1].
    """

    def __init__(self, device: wp.Device, num_toi: int) -> None:
        self._is_cuda, self._num_toi = device.is_cuda, num_toi
        self._all: wp.array = wp.zeros(num_toi + 1 + NUM_ALL_COUNTS + 1 + _MOST_TREES, dtype=wp.int64, device=device)
        self._but_toi = self._all[num_toi:]
        self.toi: wp.array = self._all[:num_toi].view(wp.float64)
        self.num_contacts: wp.array = wp.array(ptr=self._but_toi.ptr, dtype=wp.int32, shape=1, device=device)
        self.array = self._but_toi[1:]
        self.least_bits = self.array[NUM_ALL_COUNTS : NUM_ALL_COUNTS + 1]
        self._counts, self._with_least = self.array[:NUM_ALL_COUNTS], self.array[: NUM_ALL_COUNTS + 1]
        self._large_blocks = [0] * _MOST_TREES  # when they were last asked for
        # on CUDA what was read, as long as nothing is launched that changes it; on the CPU the memory itself
        self._on_host: _OnHost | None = None
        self._toi_on_host: NDArray[np.float64] | None = None
        self._rows: list[list[int]] | None = None  # the counts, of which it takes less to read some as lists
        if not self._is_cuda:
            self.read_all()

    def change(self) -> None:
        """Note that a launch may change them."""
        self._rows = None
        if self._is_cuda:
            self._on_host = self._toi_on_host = None

    def read_all(self) -> NDArray[np.float64]:
        """All of them, after the last launch; returns the tois, on the CPU the memory itself."""
        if self._toi_on_host is None:
            values = self._all.numpy()
            self._toi_on_host, self._on_host = (
                values[: self._num_toi].view(np.float64),
                _OnHost.of(values[self._num_toi :]),
            )
        return self._toi_on_host

    def _read(self) -> _OnHost:
        if self._on_host is None:
            self._on_host = _OnHost.of(self._but_toi.numpy())
        return self._on_host

    def count_contacts(self) -> int:
        """The number of contacts."""
        return int(self._read().contacts[0])

    def set_contacts(self, count: int) -> None:
        """Set the number of contacts."""
        if self._is_cuda:
            self.num_contacts.fill_(count)
            self.change()
        else:
            self._read().contacts[0] = count

    def rows(self) -> list[list[int]]:
        """The counts of each kind, a row each."""
        if self._rows is None:
            self._rows = self._read().counts.tolist()
        return self._rows

    def clear(self) -> None:
        """Count the pairs of the next launches from 0."""
        if self._is_cuda:
            self._counts.zero_()
            self.change()
        elif self._on_host is not None:
            self._on_host.counts.fill(0)
            self._rows = None

    def begin(self, least: float) -> None:
        """Count from 0, with a least toi."""
        if self._is_cuda:
            values = np.zeros(NUM_ALL_COUNTS + 1)
            values[-1] = least
            self._with_least.assign(values.view(np.int64))
            self.change()
        elif self._on_host is not None:
            self._on_host.counts.fill(0)
            self._on_host.least[0] = least
            self._rows = None

    def set_column(self, column: int, numbers: Mapping[PairKind, int]) -> None:
        """Let pairs of kinds count as so many."""
        counts, self._rows = self._read().counts, None
        for kind, number in numbers.items():
            counts[kind, column] = number
        if self._is_cuda:
            self._counts.assign(counts.ravel())

    def least(self) -> float:
        """The least toi so far."""
        return float(self._read().least[0])

    def set_least(self, toi: float) -> None:
        """Set the least toi so far."""
        if self._is_cuda:
            self.least_bits.assign(np.array([toi]).view(np.int64))
            self.change()
        else:
            self._read().least[0] = toi

    def large_blocks(self) -> list[int]:
        """Blocks of each tree that were counted as large since they were last asked for."""
        before, self._large_blocks = self._large_blocks, self._read().blocks.tolist()
        return [now - then for now, then in zip(self._large_blocks, before, strict=True)]
