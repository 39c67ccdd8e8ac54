"""Spatial hashes of boxes, which stand beside the trees of `trees` as a second broad phase."""

import math
from collections.abc import Callable, Iterable
from typing import Any

import warp as wp

from ccd_warp._engine.topology import BLOCK_CORNERS, WIDTH, Positions, PrimitiveSet, Topology, large_half_side
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp.kernels import box_tree, hash_grid

BLOCK_FLOATS = int(box_tree.BLOCK_FLOATS)
# A cell of the finest level, as a multiple of the length that so many of the boxes do not exceed.
_CELL_FACTOR, _QUANTILE = 1.4, 0.95
_LEAST_CELL_EXPONENT = int(math.log2(hash_grid.LEAST_CELL))
# Buckets of the smallest table: more than a query looks up in a row.
_LEAST_BUCKET_BITS = 4
# Boxes that are worth a thread of their own in sorting.
_WORTH_SORTING = 1 << 14

Allocate = Callable[[str, int, Any], wp.array]


class Grid:
    """A set of primitives and the spatial hash of their boxes.

    Attributes:
        primitives: The set.
        levels: Number of its blocks, and of the blocks of the boxes around these.
        arrays: The boxes in the order of the buckets, a ``box_tree.BoxTree`` of two levels; None before the first step.
        cells: The cells and the buckets, a ``hash_grid.HashGrid``; likewise.
        cell: Side of a cell of the finest level in quantized coordinates.
    """

    def __init__(self, primitives: PrimitiveSet) -> None:
        self.primitives = primitives
        self.levels = (primitives.num_blocks, -(-primitives.num_blocks // WIDTH))
        self.arrays: Any = None
        self.cells: Any = None
        self.cell = 0.0

    @property
    def name(self) -> str:
        """Name of its buffers."""
        return f"{self.primitives.name} grid"

    def lay_out(self, num_aabbs: int, cell: float, allocate: Allocate) -> None:
        """Give the grid its arrays.

        Args:
            num_aabbs: AABBs of a box.
            cell: Side of a cell of the finest level in quantized coordinates.
            allocate: Returns an array of a name, a length and a type.
        """
        count, blocks = self.primitives.count, self.primitives.num_blocks
        size = sum(self.levels) * BLOCK_FLOATS * num_aabbs
        if size >= 2**31:
            raise ValueError(f"the mesh has {count} boxes of one kind; expected at most 150 million")
        arrays = box_tree.BoxTree()
        arrays.num_boxes, arrays.num_levels, arrays.num_aabbs = count, 2, num_aabbs
        arrays.block_begin = box_tree.vec8i(0, blocks, *[0] * 6)
        arrays.nodes = allocate(f"{self.name} boxes", size, wp.float32)
        arrays.primitive = allocate(f"{self.name} order", count, wp.int32)
        arrays.corners = allocate(f"{self.name} corners", blocks * BLOCK_CORNERS, wp.int32)
        cells = hash_grid.HashGrid()
        cells.bucket_bits = max(_LEAST_BUCKET_BITS, (count - 1).bit_length())
        cells.bucket_begin = allocate(f"{self.name} buckets", (1 << cells.bucket_bits) + 1, wp.int32)
        cells.cells = allocate(f"{self.name} cells", blocks * WIDTH, wp.uint64)
        cells.levels = allocate(f"{self.name} levels", 1, wp.int32)
        # a radix sort needs twice the size
        self.unsorted_cells = allocate(f"{self.name} unsorted", count, wp.uint64)
        self.buckets = allocate(f"{self.name} keyed", 2 * count, wp.int32)
        self.order = allocate(f"{self.name} sorted", 2 * count, wp.int32)
        self.arrays, self.cells = arrays, cells
        self.set_cell(cell)

    def set_cell(self, cell: float) -> None:
        """Set the side of a cell before the boxes are sorted again; a recording then has to bind the new cells."""
        before, self.cells = self.cells, hash_grid.HashGrid()
        for name in hash_grid.HashGrid.vars:
            setattr(self.cells, name, getattr(before, name))
        self.cells.cells_per_unit = 1.0 / cell
        self.cell = cell


def choose_cell(topology: Topology, positions: Positions, quantization: Any, *, spare: float = 1.0) -> float:
    """Side of a cell of the finest level in quantized coordinates, from samples of the step.

    It is ``spare`` times as large where motions are still to come: too small a cell costs more than a large one. It is
    a power of the fourth root of two, so that it stays the same, and with it the hashes of static bodies, while boxes
    change little.
    """
    side = _CELL_FACTOR * large_half_side(topology, positions, _QUANTILE) * (2.0 * quantization.scale) * spare
    exponent = math.ceil(4.0 * math.log2(side)) / 4.0 if 0.0 < side < math.inf else 0.0
    return 2.0 ** min(max(exponent, _LEAST_CELL_EXPONENT), 0.0)


def fill_grids(
    grids: Iterable[Grid],
    vertex_aabbs: Any,
    launcher: Execution | Recording,
    boxes_of: Callable[[Grid], Any] = lambda grid: grid.arrays,
    cells_of: Callable[[Grid], Any] = lambda grid: grid.cells,
    is_changed: Any = None,
) -> None:
    """Compute and sort the boxes of grids from the vertex AABBs; a recording may take slots for the arrays.

    Args:
        grids: The grids.
        vertex_aabbs: AABBs of the vertices.
        launcher: Where to launch, or to record.
        boxes_of: The boxes of a grid.
        cells_of: Its cells.
        is_changed: The flag on the device without which the grids stay as they are, int32, shape [1]; None for always.
    """
    grids = list(grids)
    device = launcher.device
    if is_changed is None:
        is_changed = wp.empty(0, dtype=wp.int32, device=device)
    with launcher.at_once():
        for grid in grids:
            primitives = grid.primitives
            launcher.launch(
                hash_grid.fill_cells,
                primitives.count,
                inputs=[is_changed, primitives.corners, vertex_aabbs, grid.arrays.num_aabbs],
                outputs=[cells_of(grid), grid.unsorted_cells, grid.buckets, grid.order],
            )
    with launcher.at_once():
        for grid in grids:
            count = grid.primitives.count
            if launcher.is_cuda:
                launcher.call(lambda g=grid, n=count: _radix_sort(g, n))  # type: ignore[misc]
            else:
                ranges = max(1, min(launcher.num_threads, count // _WORTH_SORTING))
                inputs = [is_changed, grid.buckets, count, ranges]
                launcher.launch(hash_grid.sort_range, ranges, inputs, [cells_of(grid), grid.order], grain=1)
    if launcher.is_cuda:
        with launcher.at_once():
            for grid in grids:
                num_buckets = len(grid.cells.bucket_begin)
                inputs = [is_changed, grid.buckets, grid.primitives.count]
                launcher.launch(hash_grid.find_buckets, num_buckets, inputs, [cells_of(grid)])
    with launcher.at_once():
        for grid in grids:
            primitives = grid.primitives
            launcher.launch(
                hash_grid.fill_grid,
                primitives.num_blocks,
                inputs=[
                    is_changed,
                    grid.order,
                    grid.unsorted_cells,
                    primitives.ids,
                    primitives.corners,
                    primitives.num_corners,
                    vertex_aabbs,
                ],
                outputs=[boxes_of(grid), cells_of(grid)],
                grain=256,
            )


def _radix_sort(grid: Grid, count: int) -> None:
    """Sort the buckets and the order of a grid. Sorted ones stay as they are, as the sort is stable."""
    bits = grid.cells.bucket_bits + 1  # with the bucket of empty boxes
    wp.utils.radix_sort_pairs(grid.buckets, grid.order, count, end_bit=bits)
