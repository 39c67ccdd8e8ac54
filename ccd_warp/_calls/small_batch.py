"""A recorded launch of the solver for a few pairs on the CPU, with its own arrays, reused from call to call.

Solving one pair takes less than a microsecond; making eight Warp arrays and packing a launch takes nearly a hundred.
Only one call at a time uses a recorded launch: the call takes it out of the list of idle ones, and puts it back only if
it succeeds.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import load
from ccd_warp._runtime.packed import PackedLaunch
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.threads import StopFlag, run
from ccd_warp.kernels.narrow_phase.sinks import TABLE, Table
from ccd_warp.kernels.step.minima import Minima
from ccd_warp.kernels.step.pair_list import LeastToi, PairList, Round
from ccd_warp.kernels.step.step import ContactList

if TYPE_CHECKING:
    from ccd_warp.kernels.pair.query import Options as PackedOptions

CAPACITY = 1 << 13  # pairs, some 240 bytes each; beyond it, solving takes many times as long as packing a launch
_LEAST_CAPACITY = 1 << 9
_MOST_PARTS = 8  # for as many threads, if each has a thousand pairs
_MOST_IDLE = 16  # kept for each kind and precision, however many threads call at once
OUTPUTS = dtypes_of(Table)
# Positions among the kernel's parameters.
_NUM_SOLVERS, _OPTIONS, _COUNT = 1, 5, 7
# So many that each takes one chunk of the pairs.
MANY_SOLVERS = 1 << 30

_Key = tuple[PairKind, Any, str]  # kind, precision and norm
_idle: dict[_Key, list["SmallBatch"]] = {}


def table_inputs(kind: PairKind, packed: "PackedOptions", count: int, counts: wp.array | None = None) -> list[Any]:
    """The inputs of the narrow phase from the pairs on, where these are given by their points."""
    pairs = PairList()
    pairs.kind = int(kind)
    if counts is not None:
        pairs.counts = counts
    return [pairs, packed, Round(), count]


def table_outputs(points: Sequence[wp.array], columns: Mapping[str, wp.array]) -> list[Any]:
    """Its outputs, where these arrays take the results of pairs that have these points at both ends."""
    table = struct_of(Table, {"points_t0": points[0], "points_t1": points[1], **columns})
    return [table, Minima(), ContactList(), LeastToi()]


class SmallBatch:
    """Up to so many pairs of one kind, solved in one precision and with separations in one norm.

    Attributes:
        capacity: The number of pairs for which there are arrays.
    """

    def __init__(self, key: _Key, device: wp.Device, num_points: int, packed: "PackedOptions", capacity: int) -> None:
        kind, real, norm = self.key = key
        self.capacity = capacity
        narrow_phase = narrow_phase_on(device, real, norm)
        kernel = narrow_phase.solve_pairs
        load(kernel, device)
        inputs: list[wp.array] = [wp.zeros((capacity, num_points), dtype=wp.vec3d, device=device) for _ in range(2)]
        outputs = {name: wp.zeros(capacity, dtype=dtype, device=device) for name, dtype in OUTPUTS.items()}
        command: Any = wp.launch(
            kernel,
            dim=1,
            inputs=[0, 1, narrow_phase.chunk_of_table, TABLE, *table_inputs(kind, packed, 1)],
            outputs=table_outputs(inputs, outputs),
            device=device,
            record_cmd=True,
            record_tape=False,
        )
        # each solver is a part, and takes its share of the pairs
        self._command = PackedLaunch(command, [(k, k + 1) for k in range(_MOST_PARTS)])
        self._arrays = [array.numpy() for array in (*inputs, *outputs.values())]
        self._first = [array[:1] for array in self._arrays]  # as many rows as there are pairs
        self._bound: dict[int, Any] = {_NUM_SOLVERS: 1, _OPTIONS: packed, _COUNT: 1}

    def solve(
        self,
        points_t0: NDArray[np.float64],
        points_t1: NDArray[np.float64],
        packed: "PackedOptions",
        parts: int = 1,
        stop: StopFlag | None = None,
    ) -> list[NDArray[Any]]:
        """Solve the pairs and return copies of the kernel's outputs, in their order.

        Args:
            points_t0: Start positions, shape [n, points, 3], n from 1 to the capacity.
            points_t1: End positions, of the same shape.
            packed: Options as the kernel's struct.
            parts: Threads that share the pairs, at most 8.
            stop: The flag among the options, if the pairs may take long.
        """
        count = len(points_t0)
        if count != self._bound[_COUNT]:
            self._bind(_COUNT, count)
            self._first = [array[:count] for array in self._arrays]
        if packed is not self._bound[_OPTIONS]:
            self._bind(_OPTIONS, packed)
        tasks = self._command.parts()
        parts = min(parts, len(tasks))  # one, where Warp has to be asked for the whole launch
        if parts != self._bound[_NUM_SOLVERS]:
            self._bind(_NUM_SOLVERS, parts)
        of_t0, of_t1, *outputs = self._first
        of_t0[:] = points_t0
        of_t1[:] = points_t1
        if parts == 1 and stop is None:
            tasks[0]()
        else:
            run(tasks[:parts], parts, stop, is_long=stop is not None)
        return [array.copy() for array in outputs]

    def _bind(self, index: int, value: Any) -> None:
        self._command.bind(index, value)
        self._bound[index] = value


def borrowed_batch(key: _Key, device: wp.Device, num_points: int, packed: "PackedOptions", count: int) -> SmallBatch:
    """A batch for one call, which no other call uses meanwhile; one that is not given back is not used again."""
    idle = _idle.setdefault(key, [])
    try:
        batch = idle.pop()
    except IndexError:
        batch = None
    if batch is None or batch.capacity < count:
        capacity = max(_LEAST_CAPACITY, 1 << (count - 1).bit_length())
        batch = SmallBatch(key, device, num_points, packed, capacity)
    return batch


def give_back(batch: SmallBatch) -> None:
    """Let the next call have a batch, with which this call has ended well."""
    idle = _idle[batch.key]
    if len(idle) < _MOST_IDLE:
        idle.append(batch)
