"""Spatial hashes of boxes, a second broad phase in place of the trees of `trees`."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import warp as wp

from ccd_warp._engine.boxes.box_sets import BoxSet, Layout
from ccd_warp._engine.boxes.trees import fill_in_half_warps
from ccd_warp._engine.mesh.topology import BLOCK_CORNERS, WIDTH, Positions, PrimitiveSet, Topology, large_half_side
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp.kernels.boxes import box_groups, box_tree, hash_grid

if TYPE_CHECKING:
    from ccd_warp.kernels.boxes.box_tree import Quantization

# A cell of the finest level, as a multiple of the length that so many of the boxes do not exceed.
_CELL_FACTOR, _QUANTILE = 1.4, 0.95
_LEAST_CELL_EXPONENT = int(math.log2(hash_grid.LEAST_CELL))
# Buckets of the smallest table: more than a query looks up in a row.
_LEAST_BUCKET_BITS = 4
# Boxes that are worth a thread of their own in sorting.
_WORTH_SORTING = 1 << 14


class Grid(BoxSet):
    """A set of primitives and the spatial hash of their boxes, in the order of the buckets.

    Attributes:
        cell: Side of a cell of the finest level in quantized coordinates.
    """

    walk = "search_hashes"
    parts = ("boxes", "cells")
    is_sorted_when_filled = True

    def __init__(self, primitives: PrimitiveSet) -> None:
        levels = primitives.num_blocks, -(-primitives.num_blocks // WIDTH)
        super().__init__(primitives, levels, f"{primitives.name} grid")
        self.cell = 0.0

    def lay_out(self, layout: Layout) -> None:
        """Give the grid its arrays."""
        count, blocks, allocate = self.primitives.count, self.primitives.num_blocks, layout.allocate
        arrays = box_tree.BoxTree()
        arrays.num_boxes, arrays.num_levels, arrays.num_aabbs = count, 2, layout.num_aabbs
        arrays.block_begin = box_tree.vec8i(0, blocks, *[0] * 6)
        arrays.nodes = allocate(f"{self.name} boxes", self.num_floats(layout.num_aabbs), wp.float32)
        arrays.primitive = allocate(f"{self.name} order", count, wp.int32)
        arrays.corners = allocate(f"{self.name} corners", blocks * BLOCK_CORNERS, wp.int32)
        cells = hash_grid.HashGrid()
        cells.bucket_bits = max(_LEAST_BUCKET_BITS, (count - 1).bit_length())
        cells.bucket_begin = allocate(f"{self.name} buckets", (1 << cells.bucket_bits) + 1, wp.int32)
        cells.cells = allocate(f"{self.name} cells", blocks * WIDTH, wp.uint64)
        cells.levels = allocate(f"{self.name} levels", 1, wp.int32)
        self.vertex_group = layout.vertex_group
        if len(self.vertex_group):
            arrays.groups = allocate(f"{self.name} groups", (WIDTH + 1) * self.levels[1], wp.vec2i)
            arrays.groups.fill_(wp.vec2i(0, -1))
        # a radix sort needs twice the size
        self.unsorted_cells = allocate(f"{self.name} unsorted", count, wp.uint64)
        self.buckets = allocate(f"{self.name} keyed", 2 * count, wp.int32)
        self.order = allocate(f"{self.name} sorted", 2 * count, wp.int32)
        self.structs = arrays, cells
        self.set_cell(layout.cell)

    def adapt(self, layout: Layout) -> bool:
        """Adapt the size of the cells; returns whether it has changed."""
        cell = layout.cell
        if cell == self.cell:
            return False
        self.set_cell(cell)
        return True

    def set_cell(self, cell: float) -> None:
        """Set the side of a cell before the boxes are sorted again; a recording then has to bind the new cells."""
        cells = hash_grid.HashGrid()
        for name in hash_grid.HashGrid.vars:
            setattr(cells, name, getattr(self.cells, name))
        cells.cells_per_unit = 1.0 / cell
        self.structs = self.arrays, cells
        self.cell = cell

    @property
    def cells(self) -> Any:
        """The cells and the buckets, a ``hash_grid.HashGrid``."""
        return self.structs[1]

    @staticmethod
    def fill(
        sets: Iterable["Grid"],
        vertex_aabbs: wp.array | Slot,
        launcher: Execution | Recording,
        structs_of: Callable[["Grid"], tuple[Any, ...]] = lambda grid: grid.structs,
        only_if: wp.array | None = None,
    ) -> None:
        """Compute and sort the boxes of spatial hashes from the vertex AABBs."""
        grids = list(sets)
        device = launcher.device
        if only_if is None or not launcher.is_cuda:
            only_if = wp.empty(0, dtype=wp.int32, device=device)
        with launcher.at_once():
            for grid in grids:
                primitives = grid.primitives
                launcher.launch(
                    hash_grid.fill_cells,
                    primitives.count,
                    inputs=[only_if, primitives.corners, vertex_aabbs, grid.arrays.num_aabbs],
                    outputs=[structs_of(grid)[1], grid.unsorted_cells, grid.buckets, grid.order],
                )
        if launcher.is_cuda:
            _sort_and_fill_places(grids, vertex_aabbs, launcher, structs_of, only_if)
        else:
            _sort_and_fill_blocks(grids, vertex_aabbs, launcher, structs_of)
        with launcher.at_once():
            for grid in grids:
                if len(grid.vertex_group):
                    count = grid.levels[1]
                    inputs = [grid.arrays.corners, grid.vertex_group, 0, count * WIDTH]
                    launcher.launch(box_groups.unite_groups, count, inputs, [grid.arrays.groups])

    @staticmethod
    def searches(pairs: list[Any]) -> list[Any]:
        """The searches that find the pairs of these pairs of hashes: a box looks up only boxes that are no smaller.

        So two different hashes are searched in both directions, the second time for pairs of different levels alone.
        """
        searches = []
        for pair in pairs:
            searches.append(pair)
            if not pair.within:
                turned = {"query": pair.target, "target": pair.query, "swapped": not pair.swapped}
                searches.append(replace(pair, **turned, rise=1))
        return searches


def choose_cell(topology: Topology, positions: Positions, quantization: "Quantization", *, spare: float = 1.0) -> float:
    """Side of a cell of the finest level in quantized coordinates, from samples of the step.

    It is ``spare`` times as large where motions are still to come: too small a cell costs more than a large one. It is
    a power of the fourth root of two, so that it stays the same, and with it the hashes of static bodies, while boxes
    change little.
    """
    side = _CELL_FACTOR * large_half_side(topology, positions, _QUANTILE) * (2.0 * quantization.scale) * spare
    exponent = math.ceil(4.0 * math.log2(side)) / 4.0 if 0.0 < side < math.inf else 0.0
    return 2.0 ** min(max(exponent, _LEAST_CELL_EXPONENT), 0.0)


_StructsOf = Callable[[Grid], tuple[Any, ...]]


def _sort_and_fill_blocks(
    grids: list[Grid], vertex_aabbs: wp.array | Slot, launcher: Execution | Recording, structs_of: _StructsOf
) -> None:
    """Sort the boxes by bucket and fill their blocks on the CPU, an item for each block."""
    with launcher.at_once():
        for grid in grids:
            count = grid.primitives.count
            ranges = max(1, min(launcher.num_threads, count // _WORTH_SORTING))
            inputs = [grid.buckets, count, ranges]
            launcher.launch(hash_grid.sort_range, ranges, inputs, [structs_of(grid)[1], grid.order], grain=1)
    with launcher.at_once():
        for grid in grids:
            primitives = grid.primitives
            inputs = [grid.order, grid.unsorted_cells, primitives.ids, primitives.corners]
            inputs += [primitives.num_corners, vertex_aabbs, grid.vertex_group]
            launcher.launch(hash_grid.fill_grid, primitives.num_blocks, inputs, [*structs_of(grid)], grain=256)


def _sort_and_fill_places(
    grids: list[Grid],
    vertex_aabbs: wp.array | Slot,
    launcher: Execution | Recording,
    structs_of: _StructsOf,
    only_if: wp.array,
) -> None:
    """Sort the boxes by bucket and fill their blocks on CUDA, a thread for each place and half a warp for its boxes."""
    for grid in grids:
        primitives, arrays, (boxes, cells) = grid.primitives, grid.arrays, structs_of(grid)
        count, places = primitives.count, primitives.num_blocks * WIDTH
        launcher.call(lambda g=grid, n=count: _radix_sort(g, n))  # type: ignore[misc]
        num_buckets = len(grid.cells.bucket_begin)
        launcher.launch(hash_grid.find_buckets, num_buckets, [only_if, grid.buckets, count], [cells])
        inputs: list[Any] = [only_if, grid.order, grid.unsorted_cells, primitives.ids, primitives.corners]
        launcher.launch(hash_grid.fill_places, places, inputs, [boxes, cells])
        if len(grid.vertex_group):
            inputs = [arrays.corners, grid.vertex_group, -1, 0]
            launcher.launch(box_groups.unite_groups, primitives.num_blocks, inputs, [arrays.groups])
    fill_in_half_warps(grids, vertex_aabbs, launcher, structs_of, only_if)


def _radix_sort(grid: Grid, count: int) -> None:
    """Sort the buckets and the order of a grid. Sorted ones stay as they are, as the sort is stable."""
    bits = grid.cells.bucket_bits + 1  # with the bucket of empty boxes
    wp.utils.radix_sort_pairs(grid.buckets, grid.order, count, end_bit=bits)
