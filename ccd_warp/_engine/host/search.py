"""The search for candidates in parts, whose pairs fit the available capacity."""

import threading
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.trees import LONG_SEARCH, MOST_QUERIES, SearchPart, TreePair, range_of_warps, search_range
from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.host.candidates import Found
from ccd_warp._engine.host.pair_memory import MOST_PAIRS
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Execution, block_dim_of, load
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.narrow_phase.whole_warp import WARP
from ccd_warp.kernels.search.search_types import BOXES, SearchRange
from ccd_warp.kernels.step.minima import FOUND, NUM_COUNTS
from ccd_warp.kernels.step.step import Step

_FOUND = int(FOUND)
_NUM_COUNTS = int(NUM_COUNTS)
# Parts of a search for each thread, so that no thread waits long for another, and the fewest blocks in a part.
_PARTS_PER_THREAD = 8
_SMALLEST_PART = 128


@dataclass
class _Region:
    """A thread's part of the capacity."""

    slot: int
    begin: int
    end: int
    filled: int = 0
    found: list[Found] = field(default_factory=list)


class PairSearch:
    """A search for candidates over tree pairs of a step.

    Attributes:
        candidates: Pairs of each kind that passed the box test and the mesh's filter.
        num_batches: Number of batches.
        num_launches: Launches of the search, by kind.
        largest_capacity: Largest capacity of a batch, in pairs.
        num_workers: Number of parts that are searched at once.
    """

    def __init__(self, stages: Stages, execution: Execution, buffers: Buffers, tree_pairs: list[TreePair]) -> None:
        """A search by the stages of a step, whose positions, boxes and options it takes."""
        assert execution.flag
        self.execution, self.buffers = execution, buffers
        self.candidates: Counter[PairKind] = Counter()
        self.num_launches: Counter[PairKind] = Counter()
        self.num_batches = 0
        self.largest_capacity = MOST_PAIRS
        self.num_workers = 1 if execution.is_cuda else execution.num_threads
        self._tree_pairs, self._flag, self._progress = tree_pairs, execution.flag, execution.progress
        self._counts = buffers.rows("search counts", self.num_workers, _NUM_COUNTS, wp.int64)
        self._counts_view = None if execution.is_cuda else self._counts.numpy()
        self._stages, self._step = stages, Step()
        self._step.vertices_t0, self._step.vertices_t1 = stages.step.vertices_t0, stages.step.vertices_t1
        self._step.counts = self._counts

    def ranges(self) -> Iterator[list[Found]]:
        """Search, and yield batches that fit the capacity: the keys of each part, with their place among all keys.

        A part runs on one thread, block by block of its queries, and a block finds its pairs in the order of the trees.
        So the parts of all batches, sorted by place, give the keys in an order that depends only on the trees, wherever
        the parts were split. A block stays whole: where all pairs of one do not fit a thread's part of the capacity,
        one thread has all of it. On CUDA the threads of a part write in arbitrary order.
        """
        tree_pairs = self._tree_pairs
        pending = deque(part for k, tree_pair in enumerate(tree_pairs) for part in self._parts(tree_pair, k))
        if not pending:
            return
        self._kernel = self._stages.search_kernel(tree_pairs[0], BOXES, is_cuda=self.execution.is_cuda)
        load(self._kernel, self.execution.device)
        num_queries = sum(part.num_queries for part in pending)
        is_long = max(part.num_tests for part in pending) > LONG_SEARCH
        # On CUDA, where an item is a query, a part of one fits.
        least = max(tree_pair.target.primitives.count for tree_pair in tree_pairs)
        wanted = 16 * sum(tree_pair.query.primitives.count for tree_pair in tree_pairs)
        last = self.buffers.capacity  # what the last step needed
        capacity = min(self.largest_capacity, max(self.num_workers * least, wanted, last, 1 << 16))
        total, num_workers = 0, self.num_workers
        while pending:
            self.buffers.get("keys", capacity, wp.int64)
            self._progress.begin("pairs", num_queries, num_queries - sum(part.num_queries for part in pending))
            regions = self._batch(pending, capacity, num_workers, is_long)
            self.num_batches += 1
            total += sum(region.filled for region in regions)
            if self.num_batches > 1:
                # threads find unequal shares, so with twice the capacity the next step needs one batch
                self.buffers.capacity = min(2 * total, self.largest_capacity)
            found = [each for region in regions for each in region.found]
            yield found
            if pending and not found and num_workers == 1 and capacity == self.largest_capacity:
                raise MemoryError(f"a block of boxes overlaps more than {capacity:,} others, the most of a batch")
            num_workers = self.num_workers if found else 1
            capacity = min(2 * capacity, self.largest_capacity)

    def _parts(self, tree_pair: TreePair, number: int) -> list[SearchPart]:
        whole = SearchPart.whole(tree_pair, is_cuda=self.execution.is_cuda, number=number)
        count = len(whole.items)
        parts = -(-count // MOST_QUERIES)
        if not self.execution.is_cuda:
            parts = max(1, min(_PARTS_PER_THREAD * self.num_workers, count // _SMALLEST_PART))
        return whole.split(parts) if parts > 1 else [whole]

    def _record(self, tree_pair: TreePair) -> wp.Launch:
        """Record the launch of a tree pair; :meth:`_launch` sets its items. Packing the trees only once is cheaper."""
        return wp.launch(
            self._kernel,
            dim=1,
            inputs=[0, SearchRange(), *self._stages.searched(tree_pair)],
            outputs=[self._step, self.buffers.get("keys", 0, wp.int64)],
            device=self.execution.device,
            record_cmd=True,
            record_tape=False,
            block_dim=block_dim_of(self._kernel, self.execution.device),
        )

    def _launch(self, command: wp.Launch, part: SearchPart, slot: int, begin: int, capacity: int) -> NDArray[np.int64]:
        """Search a part, and return its counts."""
        if self._counts_view is None:
            self._counts.zero_()
        else:
            self._counts_view[slot] = 0
        if self.execution.is_cuda:
            searched = range_of_warps(slot, part.items, capacity, begin)
            command.set_dim(searched.num_warps * WARP)
        else:
            searched = search_range(part.level, slot, part.items, capacity, begin)
            command.set_dim(len(part.items))
        command.set_param_at_index(1, searched)
        command.launch()
        return self._counts.numpy()[slot] if self._counts_view is None else self._counts_view[slot]

    def _keep(self, region: _Region, part: SearchPart, begin: int, counts: NDArray[np.int64]) -> None:
        self.num_launches[part.tree_pair.kind] += 1
        count = int(counts[_FOUND])
        self.candidates[part.tree_pair.kind] += count
        if count == 0:
            return
        region.filled += count
        keys = self.buffers.get("keys", 0, wp.int64)
        region.found.append(Found(part, keys, begin, count))

    def _batch(self, pending: deque[SearchPart], capacity: int, num_workers: int, is_long: bool) -> list[_Region]:
        """Threads take parts until none is left or their capacity is exhausted; on CUDA this thread alone."""
        bounds = [capacity * k // num_workers for k in range(num_workers + 1)]
        regions = [_Region(k, bounds[k], bounds[k + 1]) for k in range(num_workers)]
        lock = threading.Lock()

        def work(region: _Region) -> None:
            commands: dict[TreePair, wp.Launch] = {}
            while True:
                with lock:
                    if not pending:
                        return
                    part = pending.popleft()
                if part.tree_pair not in commands:
                    commands[part.tree_pair] = self._record(part.tree_pair)
                begin = region.begin + region.filled
                counts = self._launch(commands[part.tree_pair], part, region.slot, begin, region.end - begin)
                if self._flag.is_set:
                    return  # the kernel has stopped early, so its result is incomplete
                with lock:
                    if counts[_FOUND] <= region.end - begin:
                        self._keep(region, part, begin, counts)
                        self._progress.done += part.num_queries
                    elif region.found or len(part.items) == 1:
                        pending.appendleft(part)
                        return
                    else:
                        pending.extendleft(part.split(2))

        self.execution.run([lambda r=r: work(r) for r in regions], is_long=is_long)  # type: ignore[misc]
        return regions
