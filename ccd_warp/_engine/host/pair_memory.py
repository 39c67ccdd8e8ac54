"""Memory for the pairs that a search on the host finds, divided among their kinds and bound to slots of a recording."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.trees import search_range
from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp._runtime.pair_queue import queue_bytes, queue_dtypes
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.structs import struct_of
from ccd_warp.kernels.narrow_phase.pair_queue import Queue

# Bytes of the key of a pair, and the largest number of pairs, which are counted in 32 bits.
KEY_BYTES = 8
MOST_PAIRS = int(np.iinfo(np.int32).max)
# Candidates for which a list on CUDA has capacity, for each pair for which there is capacity.
CANDIDATES_EACH = 4
# The least capacity for pairs of a kind, and how much more than what was found the next one is.
_LEAST_CAPACITY = 1 << 12
_GROWTH = 1.25


class PairMemory:
    """Keys of pairs by kind, and what goes with them: on CUDA lists of candidates and a queue.

    Attributes:
        kinds: The kinds.
        capacities: Largest number of pairs of each; the sum is what there is memory for.
        pair_bytes: Bytes that a pair takes.
        most_pairs: Largest number of pairs.
    """

    def __init__(
        self,
        buffers: Buffers,
        kinds: list[PairKind],
        *,
        is_cuda: bool,
        keeps_toi: bool,
        has_queue: bool,
        has_ranges: bool = False,
    ) -> None:
        """Have no memory yet.

        Args:
            buffers: Where the memory comes from, which plans share.
            kinds: The kinds.
            is_cuda: Whether it is for a search on CUDA.
            keeps_toi: Whether there is a toi for each key.
            has_queue: Whether there is a queue.
            has_ranges: Whether a search is told how many keys it may write.
        """
        self.kinds = kinds
        self.capacities = dict.fromkeys(kinds, 0)
        keeps_contacts = not keeps_toi
        of_queue = queue_bytes(keeps_contacts=keeps_contacts)
        self.pair_bytes = KEY_BYTES * (1 + CANDIDATES_EACH) + of_queue if is_cuda else KEY_BYTES
        self.most_pairs = MOST_PAIRS // CANDIDATES_EACH if is_cuda else MOST_PAIRS
        self._buffers, self._is_cuda, self._keeps_toi, self._has_queue = buffers, is_cuda, keeps_toi, has_queue
        self._has_ranges = has_ranges
        self._views: dict[PairKind, NDArray[np.int64]] = {}
        self._keys: wp.array | None = None  # the array that is divided among the kinds
        self._total = 0  # of the capacities
        self._queue: dict[str, wp.array] = {}
        self._queue_dtypes = queue_dtypes(keeps_contacts=keeps_contacts)
        self._recording: Recording

    def slots(self) -> dict[str, dict[PairKind, Slot]]:
        """The slots for each kind, by what they are for the stages."""
        names = "keys", "candidates", "open_toi", *(("ranges",) if self._has_ranges else ())
        return {name: {kind: Slot(f"{kind.name} {name}") for kind in self.kinds} for name in names}

    def bind_to(self, recording: Recording) -> None:
        """Bind the slots of this recording, and its slot ``queue``, from now on."""
        self._recording = recording

    def keys(self, kind: PairKind, count: int) -> wp.array:
        """The first keys of a kind: those of pairs that the narrow phase leaves open are marked."""
        keys: wp.array = self._recording.values[f"{kind.name} keys"][:count]
        return keys

    def host_keys(self, kind: PairKind, count: int) -> NDArray[np.int64]:
        """The same of a search with ranges, which is one on the CPU: a view."""
        return self._views[kind][:count]

    def open_toi(self, kind: PairKind, count: int) -> wp.array:
        """What there is for these keys."""
        toi: wp.array = self._recording.values[f"{kind.name} open_toi"][:count]
        return toi

    def reserve(self, num_queries: Callable[[PairKind], int], largest: int) -> None:
        """Have memory for the pairs of the last step, at first for one pair of each query, at most for so many."""
        wanted, keys = self.capacities, self._buffers.get("keys", 0, wp.int64)
        if keys is self._keys and self._total <= largest:
            return
        if not all(wanted.values()):
            wanted = {kind: max(num_queries(kind), _LEAST_CAPACITY) for kind in self.kinds}
        total = sum(wanted.values())
        if total > largest:
            wanted = {kind: max(count * largest // total, 1) for kind, count in wanted.items()}
        self._divide(wanted)

    def grow(self, needed: dict[PairKind, int], largest: int) -> bool:
        """Have memory for so many pairs, and more where ``largest`` pairs allow it; returns whether they do."""
        least = {kind: max(n, 1) for kind, n in needed.items()}  # of an array Warp takes no part of no elements
        if sum(least.values()) > largest:
            return False
        grown = {kind: max(int(_GROWTH * n), _LEAST_CAPACITY) for kind, n in needed.items()}
        self._divide(grown if sum(grown.values()) <= largest else least)
        return True

    def _divide(self, capacities: dict[PairKind, int]) -> None:
        """Divide memory among the kinds."""
        total = sum(capacities.values())
        keys, toi, candidates = self._arrays(total)
        begin = 0
        for kind, capacity in capacities.items():
            end = begin + capacity
            parts: list[Any] = [None if array is None else array[begin:end] for array in (keys, toi)]
            if candidates is not None:
                parts.append(candidates[CANDIDATES_EACH * begin : CANDIDATES_EACH * end])
            self._give(kind, *parts)
            begin = end
        self.capacities, self._keys, self._total = capacities, keys, total
        self._reserve_queue(total)

    def share(self, count: int) -> None:
        """Let every kind use the same memory, for so many pairs, one at a time."""
        for kind in self.kinds:
            self._give(kind, *self._arrays(count))
        self._keys = None
        self._reserve_queue(count)

    def take_over(self, kind: PairKind, keys: wp.array, count: int) -> None:
        """Let the pairs of a kind be these."""
        self._give(kind, keys)
        self._keys = None
        self._reserve_queue(count)

    def _arrays(self, count: int) -> tuple[wp.array, wp.array | None, wp.array | None]:
        """Keys of so many pairs, their toi, and candidates."""
        get = self._buffers.get
        toi = get("keys toi", count, wp.float64) if self._keeps_toi else None
        candidates = get("keys candidates", CANDIDATES_EACH * count, wp.int64) if self._is_cuda else None
        return get("keys", count, wp.int64), toi, candidates

    def _give(
        self, kind: PairKind, keys: wp.array, toi: wp.array | None = None, candidates: wp.array | None = None
    ) -> None:
        for name, array in {"keys": keys, "open_toi": toi, "candidates": candidates}.items():
            if array is not None:
                self._recording.bind(f"{kind.name} {name}", array)
        if self._has_ranges:
            self._views[kind] = keys.numpy()
            self._recording.bind(f"{kind.name} ranges", search_range(1, int(kind), range(1), len(keys)))

    def _reserve_queue(self, count: int) -> None:
        """Have capacity for so many pairs in the queue."""
        if self._has_queue:
            arrays = {name: self._buffers.get(f"keys {name}", count, of) for name, of in self._queue_dtypes.items()}
            if self._queue != arrays:
                self._queue = arrays
                self._recording.bind("queue", struct_of(Queue, arrays))
