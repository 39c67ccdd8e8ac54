"""A recorded launch of the solver for a few pairs on the CPU, with its own arrays, reused from call to call.

Solving one pair takes less than a microsecond; making eight Warp arrays and packing a launch takes nearly a hundred.
Only one call at a time uses a recorded launch: the call takes it out of the list of idle ones, and puts it back only if
it succeeds.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import load
from ccd_warp._runtime.packed import PackedLaunch
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp.kernels.narrow_phase.sinks import TABLE, Table
from ccd_warp.kernels.step.minima import Minima
from ccd_warp.kernels.step.pair_list import LeastToi, PairList, Round
from ccd_warp.kernels.step.step import ContactList

CAPACITY = 512  # pairs, some 240 bytes each; beyond it solving takes longer than launching, and threads share it
_MOST_IDLE = 16  # kept for each kind and precision, however many threads call at once
OUTPUTS = dtypes_of(Table)
# Positions among the kernel's parameters.
_OPTIONS, _COUNT = 5, 7
# So many that each takes one chunk of the pairs.
MANY_SOLVERS = 1 << 30

_idle: dict[tuple[PairKind, Any, str], list["SmallBatch"]] = {}


def table_inputs(kind: PairKind, packed: Any, count: int, counts: wp.array | None = None) -> list[Any]:
    """The inputs of the narrow phase from the pairs on, where these are given by their points."""
    pairs = PairList()
    pairs.kind = int(kind)
    if counts is not None:
        pairs.counts = counts
    return [pairs, packed, Round(), count]


def table_outputs(points: Sequence[wp.array], found: Mapping[str, wp.array]) -> list[Any]:
    """Its outputs, where these arrays take what is found of pairs that have these points at both ends."""
    table = struct_of(Table, {"points_t0": points[0], "points_t1": points[1], **found})
    return [table, Minima(), ContactList(), LeastToi()]


class SmallBatch:
    """Up to `CAPACITY` pairs of one kind, solved in one precision and with separations in one norm."""

    def __init__(self, kind: PairKind, real: Any, norm: str, device: Any, num_points: int, packed: Any) -> None:
        narrow_phase = narrow_phase_on(device, real, norm)
        kernel = narrow_phase.solve_pairs
        load(kernel, device)
        inputs: list[wp.array] = [wp.zeros((CAPACITY, num_points), dtype=wp.vec3d, device=device) for _ in range(2)]
        outputs = {name: wp.zeros(CAPACITY, dtype=dtype, device=device) for name, dtype in OUTPUTS.items()}
        command: Any = wp.launch(
            kernel,
            dim=1,  # one solver takes all pairs
            inputs=[0, 1, narrow_phase.chunk_of_table, TABLE, *table_inputs(kind, packed, 1)],
            outputs=table_outputs(inputs, outputs),
            device=device,
            record_cmd=True,
            record_tape=False,
        )
        self._command = PackedLaunch(command, [(0, 1)])
        self._points_t0, self._points_t1 = (array.numpy() for array in inputs)
        self._outputs = [array.numpy() for array in outputs.values()]
        self._packed = packed
        self._count = 1

    def solve(self, points_t0: NDArray[np.float64], points_t1: NDArray[np.float64], packed: Any) -> list[NDArray[Any]]:
        """Solve the pairs and return copies of the kernel's outputs, in their order.

        Args:
            points_t0: Start positions, shape [n, points, 3], n from 1 to `CAPACITY`.
            points_t1: End positions, of the same shape.
            packed: Options as the kernel's struct.
        """
        count = len(points_t0)
        if packed is not self._packed:
            self._command.bind(_OPTIONS, packed)
            self._packed = packed
        if count != self._count:
            self._command.bind(_COUNT, count)
            self._count = count
        self._points_t0[:count] = points_t0
        self._points_t1[:count] = points_t1
        self._command.parts()[0]()
        return [array[:count].copy() for array in self._outputs]


@contextmanager
def borrowed_batch(
    kind: PairKind, real: Any, norm: str, device: Any, num_points: int, packed: Any
) -> Iterator[SmallBatch]:
    """A batch for one call, which no other call uses meanwhile; a call that raises does not return it."""
    idle = _idle.setdefault((kind, real, norm), [])
    try:
        batch = idle.pop()
    except IndexError:
        batch = SmallBatch(kind, real, norm, device, num_points, packed)
    yield batch
    if len(idle) < _MOST_IDLE:
        idle.append(batch)
