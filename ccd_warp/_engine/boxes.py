"""The trees of the swept boxes of one step, built on demand in persistent buffers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.topology import (
    BLOCK_CORNERS,
    VERTEX_AABB_FLOATS,
    WIDTH,
    PrimitiveSet,
    Topology,
    choose_quantization,
    choose_static_quantization,
    sorted_keys,
)
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp.kernels import box_tree as kernels

BLOCK_FLOATS = int(kernels.BLOCK_FLOATS)
# A block whose longest side exceeds this multiple of a typical primitive's no longer consists of neighbours.
_LARGEST_BLOCK = 12.0
_CHECKED_BLOCKS = 64
# A level of no more boxes than this is united in one launch with all levels above.
_FEW_BOXES = 2048
# Number of boxes in all trees from which on several threads build them.
_WORTH_THREADS = 100_000
_NO_END = 1.0
# Remaining share of the step below which recomputing the boxes for it pays.
_WORTH_SHORTENING = 0.5


@dataclass(frozen=True)
class Tree:
    """A set of primitives and the tree of their boxes."""

    primitives: PrimitiveSet
    arrays: Any  # kernels.BoxTree
    levels: tuple[int, ...]  # blocks of each level

    def level_boxes(self, level: int) -> NDArray[np.float32]:
        """Lower and upper corners of a level, indexed by block, AABB, corner, axis and lane; on the CPU."""
        size = self.arrays.num_aabbs * BLOCK_FLOATS
        first = sum(self.levels[:level])
        floats = self.arrays.nodes.numpy()[first * size : (first + self.levels[level]) * size]
        return floats.reshape(-1, self.arrays.num_aabbs, 2, 3, WIDTH)

    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The box around the tree, in quantized coordinates; on the CPU."""
        block = self.level_boxes(len(self.levels) - 1)[0]
        return block[:, 0].min(axis=(0, 2)), block[:, 1].max(axis=(0, 2))


@dataclass(frozen=True)
class _StaticKey:
    """The values on which the boxes of static bodies depend."""

    positions: list[NDArray[np.float64]]
    quantization: tuple[float, ...]
    inflation: float
    num_aabbs: int

    def same(self, other: "_StaticKey | None") -> bool:
        return (
            other is not None
            and self.quantization == other.quantization
            and (self.inflation, self.num_aabbs) == (other.inflation, other.num_aabbs)
            and all(map(np.array_equal, self.positions, other.positions))
        )


def level_sizes(count: int) -> tuple[int, ...]:
    """Number of blocks in each level of a tree over ``count`` boxes; there are at least two levels."""
    sizes = [-(-count // WIDTH)]
    while len(sizes) < 2 or sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // WIDTH))
    return tuple(sizes)


def new_tree(primitives: PrimitiveSet, num_aabbs: int, allocate: Callable[[int], wp.array]) -> Tree:
    """A tree that has no order and no boxes yet; ``allocate`` returns an array of the given length."""
    levels = level_sizes(primitives.count)
    first = np.concatenate([[0], np.cumsum(levels)])
    size = int(first[-1]) * BLOCK_FLOATS * num_aabbs
    if size >= 2**31:
        raise ValueError(f"the mesh has {primitives.count} boxes of one kind; expected at most 150 million")
    arrays = kernels.BoxTree()
    arrays.num_boxes = primitives.count
    arrays.num_levels = len(levels)
    arrays.num_aabbs = num_aabbs
    arrays.block_begin = kernels.vec8i(*(int(b) for b in [*first[:-1], *[0] * 8][:8]))
    arrays.nodes = allocate(size)
    return Tree(primitives, arrays, levels)


def fill_tree(tree: Tree, vertex_aabbs: wp.array, execution: Execution | Recording) -> None:
    """Compute the boxes of every level from the vertex AABBs."""
    inputs = [vertex_aabbs, tree.primitives.num_corners]
    execution.launch(kernels.fill_blocks, tree.levels[0], inputs=inputs, outputs=[tree.arrays], grain=2048)
    level, last = 2, len(tree.levels)
    while level < last and (execution.is_cuda or tree.levels[level - 1] > _FEW_BOXES):
        count = tree.levels[level - 1]
        execution.launch(kernels.unite_blocks, count, inputs=[level, count], outputs=[tree.arrays])
        level += 1
    if level < last:
        execution.launch(kernels.unite_levels, 1, inputs=[level, tree.levels[level - 1]], outputs=[tree.arrays])


class StepBoxes:
    """Swept boxes of a mesh, kept between steps and recomputed by each.

    Attributes:
        num_boxes: Boxes computed in this step; those of static bodies count only in the step that computes them.
        num_sorted: Sets of primitives that had to be sorted again in this step.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        self.topology = topology
        self.buffers = buffers
        self.num_boxes = 0
        self.num_sorted = 0
        self._all_active = wp.ones(topology.mesh.num_bodies, dtype=wp.int32, device=topology.device)
        self._trees: dict[str, Tree] = {}
        self._static_trees: dict[str, Tree] = {}
        self._static_key: _StaticKey | None = None
        self._static_quantization: Any = None

    def begin(
        self,
        host: tuple[NDArray[np.float64], NDArray[np.float64]],
        vertices_t0: wp.array,
        vertices_t1: wp.array,
        t_end: float,
        inflation: float,
        execution: Execution,
        num_aabbs: int,
        active: wp.array | None = None,
    ) -> None:
        """Start a step, given its positions, its end time, the number of AABBs of a box and the active bodies."""
        start, end = host
        self.execution = execution
        self.vertices_t0, self.vertices_t1, self.inflation = vertices_t0, vertices_t1, inflation
        self.num_boxes = self.num_sorted = 0
        self.active = self._all_active if active is None else active
        self.num_aabbs = num_aabbs
        self.quantization = choose_quantization(self.topology.mesh, start, end, num_aabbs)
        self._trees.clear()
        if self.topology.mesh.static_vertex_ranges:
            quantization = (*self.quantization.origin, self.quantization.scale)
            static_positions = [start[begin:end] for begin, end in self.topology.mesh.static_vertex_ranges]
            key = _StaticKey(static_positions, quantization, inflation, num_aabbs)
            if not key.same(self._static_key):
                self._static_key = None
                self._static_trees.clear()
                self._static_quantization = choose_static_quantization(self.topology.mesh, start, self.quantization)
                self._fill_vertex_aabbs(self.topology.static_vertices, self._all_active, _NO_END)
                self._static_key = replace(key, positions=[positions.copy() for positions in static_positions])
        self.t_end = t_end
        self._fill_vertex_aabbs(self.topology.moving_vertices, self.active, t_end)

    def shorten(self, t_end: float) -> None:
        """Recompute the boxes over [0, t_end] only, where this pays; the order of the trees stays."""
        if t_end > _WORTH_SHORTENING * self.t_end:
            return
        self.t_end = t_end
        self._fill_vertex_aabbs(self.topology.moving_vertices, self.active, t_end)
        trees = list(self._trees.values())
        fills = [lambda t=t: fill_tree(t, self.vertex_aabbs, self.execution) for t in trees]  # type: ignore[misc]
        self._at_once(fills, [t.primitives for t in trees])

    def _at_once(self, tasks: Sequence[Callable[[], Any]], sets: list[PrimitiveSet]) -> list[Any]:
        """Run one task for each set on threads, unless there is too little work to wake them."""
        if sum(primitives.count for primitives in sets) < _WORTH_THREADS:
            return [task() for task in tasks]
        return self.execution.run(tasks)

    def build(self, wanted: list[tuple[str, bool]]) -> None:
        """Build trees concurrently, each given by the kind of its primitives and whether they are static."""
        sets = [(self.topology.primitives(kind, is_static), is_static) for kind, is_static in dict.fromkeys(wanted)]
        new = [(p, s) for p, s in sets if p.count and p.name not in (self._static_trees if s else self._trees)]
        built = self._at_once([lambda p=p: self._build(p) for p, _ in new], [p for p, _ in new])  # type: ignore[misc]
        for tree, (primitives, is_static) in zip(built, new, strict=True):
            (self._static_trees if is_static else self._trees)[primitives.name] = tree
            self.num_boxes += primitives.count

    def tree(self, kind: str, is_static: bool) -> Tree | None:
        """The tree of the moving or static primitives of a kind; None if there are none."""
        self.build([(kind, is_static)])
        trees = self._static_trees if is_static else self._trees
        return trees.get(self.topology.primitives(kind, is_static).name)

    def may_meet(self, a: Tree, b: Tree) -> bool:
        """Whether the boxes around two trees overlap; on CUDA the search has to find this out."""
        if a is b or self.execution.is_cuda:
            return True
        low_a, high_a = a.bounds()
        low_b, high_b = b.bounds()
        return bool((low_a <= high_b).all() and (low_b <= high_a).all())

    def _fill_vertex_aabbs(self, vertices: wp.array, active: wp.array, t_end: float) -> None:
        vertex_aabbs = self.buffers.get(
            "vertex_aabbs", self.topology.mesh.num_vertices * self.num_aabbs * VERTEX_AABB_FLOATS, wp.float32
        )
        self.execution.launch(
            kernels.fill_vertex_aabbs,
            len(vertices),
            inputs=[
                vertices,
                *self.topology.of_vertices(active),
                self.vertices_t0,
                self.vertices_t1,
                t_end,
                self.inflation,
                self.quantization,
                self.num_aabbs,
            ],
            outputs=[vertex_aabbs],
        )
        self.vertex_aabbs = vertex_aabbs

    def _build(self, primitives: PrimitiveSet) -> Tree:
        tree = new_tree(
            primitives, self.num_aabbs, lambda n: self.buffers.get(f"{primitives.name} boxes", n, wp.float32)
        )
        arrays = tree.arrays
        # On CUDA sorting is cheap, and whether it is needed would have to be read back.
        in_order = not self.execution.is_cuda
        if in_order:
            arrays.primitive, arrays.corners = self.topology.rest_order(primitives, self.execution)
            fill_tree(tree, self.vertex_aabbs, self.execution)
            in_order = self._is_in_order(tree, self._quantization_of(primitives))
        if not in_order:
            self._sort(primitives, arrays)
            fill_tree(tree, self.vertex_aabbs, self.execution)
        return tree

    def _sort(self, primitives: PrimitiveSet, arrays: Any) -> None:
        """Order the primitives by their current positions."""
        self.num_sorted += 1
        quantization = self._quantization_of(primitives)
        keys = sorted_keys(primitives, self.vertex_aabbs, self.num_aabbs, quantization, self.buffers, self.execution)
        name = primitives.name
        arrays.primitive = self.buffers.get(f"{name} order", primitives.count, wp.int32)
        arrays.corners = self.buffers.get(f"{name} corners", primitives.num_blocks * BLOCK_CORNERS, wp.int32)
        self.execution.launch(
            kernels.apply_order,
            primitives.num_blocks,
            inputs=[keys, (1 << primitives.index_bits) - 1, primitives.ids, primitives.corners],
            outputs=[arrays.primitive, arrays.corners],
            grain=64,
        )

    def _quantization_of(self, primitives: PrimitiveSet) -> Any:
        """The quantization by which the order of a set is checked and made.

        The trees of static bodies are kept for steps with other positions, so their order must not depend on what moves
        in the step that happens to build them.
        """
        return self._static_quantization if primitives.is_static else self.quantization

    def _is_in_order(self, tree: Tree, quantization: Any) -> bool:
        """Whether most of the blocks are small enough to consist of neighbours."""
        count = tree.levels[0]
        if count <= 4:
            return True
        chosen = (np.arange(_CHECKED_BLOCKS) * count) // _CHECKED_BLOCKS
        boxes = tree.level_boxes(1)[chosen // WIDTH, :, :, :, chosen % WIDTH]
        with np.errstate(invalid="ignore", over="ignore"):
            longest = (boxes[:, :, 1] - boxes[:, :, 0]).max(axis=(1, 2))
        longest.sort()
        return bool(longest[_CHECKED_BLOCKS // 2] <= _LARGEST_BLOCK * quantization.typical_extent)
