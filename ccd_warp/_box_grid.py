"""Builds the layered grid of boxes on the device; its rules and its proof stand in ``kernels/broad_phase.py``."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._launch import launch
from ccd_warp.kernels import boxes as box_kernels
from ccd_warp.kernels import broad_phase as kernels

_CELL_SHIFT = int(kernels.CELL_SHIFT)
_NUM_RAW_LAYERS = int(kernels.NUM_RAW_LAYERS)
_NUM_LEVELS = _NUM_RAW_LAYERS // 2
# Exponents of cell sizes whose quantum, and its inverse, are normal float64 numbers.
_SMALLEST_EXPONENT, _LARGEST_EXPONENT = -900, 1023
_SAMPLES = 4096
_CELL_QUANTILE = 0.9


@dataclass(frozen=True)
class Execution:
    """Where and on how many threads to run."""

    device: Any
    num_threads: int

    def launch(self, kernel: Any, count: int, inputs: list, outputs: list, grain: int = 1024) -> None:
        """See :func:`ccd_warp._launch.launch`."""
        launch(kernel, count, inputs, outputs, device=self.device, num_threads=self.num_threads, grain=grain)

    @property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return wp.get_device(self.device).is_cuda

    @property
    def chunk(self) -> int:
        """Boxes that one reduction item goes through: long where threads are few."""
        return 64 if self.is_cuda else 4096


@dataclass(frozen=True)
class Boxes:
    """Swept boxes of the primitives of one kind."""

    lower: wp.array
    upper: wp.array
    corners: wp.array
    body: wp.array
    is_static: wp.array

    @property
    def count(self) -> int:
        """Number of boxes."""
        return self.lower.shape[0]


@dataclass(frozen=True)
class Ladder:
    """Origin and cell sizes that the grids of two kinds share: 2^(base + step k) for k = 0 … 31."""

    origin: Any
    base_exponent: int
    level_step: int
    inverse_quantum: wp.array


def sort_keys(keys: wp.array, count: int, execution: Execution) -> None:
    """Sort the first ``count`` non-negative int64 keys in place; on CUDA the array has room for twice as many.

    On the CPU NumPy's SIMD sort took a quarter of the time of the radix sort.
    """
    if count < 2:
        return
    if execution.is_cuda:
        wp.utils.radix_sort_pairs(keys, wp.empty(2 * count, dtype=wp.int32, device=execution.device), count)
    else:
        keys.numpy()[:count].sort()


def key_array(count: int, execution: Execution) -> wp.array:
    """Uninitialised int64 keys that :func:`sort_keys` can sort."""
    return wp.empty(2 * count if execution.is_cuda else count, dtype=wp.int64, device=execution.device)


def swept_boxes(
    corners: wp.array,
    body: wp.array,
    is_static: wp.array,
    vertices_t0: wp.array,
    vertices_t1: wp.array,
    inflation: float,
    execution: Execution,
) -> Boxes:
    """Boxes of primitives that are given by three vertex indices each."""
    count = corners.shape[0]
    lower = wp.empty(count, dtype=wp.vec3d, device=execution.device)
    upper = wp.empty(count, dtype=wp.vec3d, device=execution.device)
    execution.launch(
        box_kernels.swept_boxes,
        count,
        inputs=[corners, vertices_t0, vertices_t1, inflation],
        outputs=[lower, upper],
    )
    return Boxes(lower, upper, corners, body, is_static)


def _longest_extent(boxes: Boxes, execution: Execution) -> float:
    chunks = -(-boxes.count // execution.chunk)
    longest = wp.empty(chunks, dtype=wp.float64, device=execution.device)
    execution.launch(
        kernels.chunk_longest_extent,
        chunks,
        inputs=[boxes.lower, boxes.upper, execution.chunk],
        outputs=[longest],
        grain=1,
    )
    return float(longest.numpy().max())


def choose_ladder(all_boxes: list[Boxes], execution: Execution, cell_factor: float = 1.0) -> Ladder:
    """Pick the origin and the cell sizes from a sample of the boxes.

    The origin is their median, so that one box far away costs the others no resolution. The finest cell is
    ``cell_factor`` of a size that nine in ten boxes of the first kind stay under, rounded up to a power of two: finer
    cells would only make more layers to visit.
    """
    lowers, extents = [], []
    for boxes in all_boxes:
        stride = -(-boxes.count // _SAMPLES)
        count = -(-boxes.count // stride)
        lower = wp.empty(count, dtype=wp.vec3d, device=execution.device)
        extent = wp.empty(count, dtype=wp.float64, device=execution.device)
        execution.launch(
            kernels.sample_boxes, count, inputs=[boxes.lower, boxes.upper, stride], outputs=[lower, extent]
        )
        lowers.append(lower.numpy())
        extents.append(extent.numpy())
    longest = max(_longest_extent(boxes, execution) for boxes in all_boxes)
    origin = np.sort(np.concatenate(lowers), axis=0)[sum(map(len, lowers)) // 2]
    typical = float(np.sort(extents[0])[int(_CELL_QUANTILE * (len(extents[0]) - 1))])
    base = _exponent_above(min(typical * cell_factor, longest))
    step = max(2, -(-(_exponent_above(longest) - base) // (_NUM_LEVELS - 1)))
    exponents = np.minimum(base + step * np.arange(_NUM_LEVELS), _LARGEST_EXPONENT)
    inverse_quantum = np.ldexp(1.0, _CELL_SHIFT - np.repeat(exponents, 2))
    return Ladder(wp.vec3d(*origin), base, step, wp.array(inverse_quantum, dtype=wp.float64, device=execution.device))


def _exponent_above(extent: float) -> int:
    """Smallest exponent e in the range of cell sizes with extent <= 2^e."""
    if not np.isfinite(extent):
        return _LARGEST_EXPONENT
    mantissa, exponent = np.frexp(extent)
    if extent <= 0:
        return _SMALLEST_EXPONENT
    return int(np.clip(exponent - (mantissa == 0.5), _SMALLEST_EXPONENT, _LARGEST_EXPONENT))


def build_grid(boxes: Boxes, ladder: Ladder, execution: Execution) -> Any:
    """Sort the boxes into buckets.

    Memory: one entry a box, at most eight bucket offsets a box and a few arrays of 64, whatever the boxes are.
    """
    device = execution.device
    count = boxes.count
    chunks = -(-count // execution.chunk)
    layer = wp.empty(count, dtype=wp.int32, device=device)
    chunk_count = wp.zeros((chunks, _NUM_RAW_LAYERS), dtype=wp.int32, device=device)
    chunk_span = wp.zeros((chunks, _NUM_RAW_LAYERS), dtype=kernels.vec3l, device=device)
    execution.launch(
        kernels.assign_layers,
        chunks,
        inputs=[
            boxes.lower,
            boxes.upper,
            boxes.is_static,
            ladder.origin,
            ladder.inverse_quantum,
            ladder.base_exponent,
            ladder.level_step,
            execution.chunk,
        ],
        outputs=[layer, chunk_count, chunk_span],
        grain=1,
    )
    layer_count = chunk_count.numpy().sum(axis=0, dtype=np.int64)
    span = chunk_span.numpy().max(axis=0)
    # Two to four buckets a box keep strangers apart; a handful of boxes is faster looked through than looked up.
    size = np.where(layer_count > 8, 1 << np.ceil(np.log2(np.maximum(2 * layer_count, 1))).astype(np.int64), 1)
    size[layer_count == 0] = 0
    bucket_begin = np.concatenate([[0], np.cumsum(size)])
    num_buckets = int(bucket_begin[-1])
    if num_buckets >= 2**31 - 1:
        raise ValueError(f"{count} boxes need {num_buckets} grid buckets; expected fewer than 2^31")

    grid = kernels.Grid()
    occurring = np.flatnonzero(layer_count).astype(np.int32)
    grid.num_layers = len(occurring)
    grid.layers = wp.array(occurring, dtype=wp.int32, device=device)
    grid.inverse_quantum = ladder.inverse_quantum
    grid.bucket_begin = wp.array(bucket_begin[:-1].astype(np.int32), dtype=wp.int32, device=device)
    grid.bucket_mask = wp.array((size - 1).astype(np.int32), dtype=wp.int32, device=device)
    grid.span = wp.array(span, dtype=kernels.vec3l, device=device)
    grid.entry_begin = wp.empty(num_buckets + 1, dtype=wp.int32, device=device)
    grid.layer = wp.empty(count, dtype=wp.int32, device=device)
    grid.primitive = wp.empty(count, dtype=wp.int32, device=device)
    grid.words = wp.empty(count, dtype=kernels.vec2ul, device=device)
    grid.box_lower = wp.empty(count, dtype=wp.vec3d, device=device)
    grid.box_upper = wp.empty(count, dtype=wp.vec3d, device=device)

    keys = key_array(count, execution)
    execution.launch(
        kernels.bucket_keys,
        count,
        inputs=[boxes.lower, layer, ladder.origin, ladder.inverse_quantum, grid.bucket_begin, grid.bucket_mask],
        outputs=[keys],
    )
    sort_keys(keys, count, execution)
    execution.launch(
        kernels.fill_grid,
        count,
        inputs=[keys, count, num_buckets, boxes.lower, boxes.upper, layer, ladder.origin],
        outputs=[grid],
    )
    return grid
