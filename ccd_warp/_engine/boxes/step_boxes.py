"""The boxes of one step, in trees or spatial hashes that are kept in persistent arrays."""

import itertools
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import BoxSet, Layout
from ccd_warp._engine.boxes.grids import choose_cell
from ccd_warp._engine.boxes.rest_order import apply_order, order_at, rest_order
from ccd_warp._engine.boxes.trees import CHECKED_BLOCKS
from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.mesh.topology import (
    VERTEX_AABB_FLOATS,
    WIDTH,
    Positions,
    PrimitiveSet,
    Quantization,
    Topology,
    choose_quantization,
    sorted_keys,
    typical_static_extent,
)
from ccd_warp._runtime.launch import Execution
from ccd_warp._scene.mesh import blocks_of
from ccd_warp.kernels.boxes import box_tree as kernels

# A block whose longest side exceeds this multiple of a typical primitive's no longer consists of neighbours.
_LARGEST_BLOCK = 12.0
_FEW_OF_A_WORLD = 3 * WIDTH  # primitives
# Vertices up to which it is asked whether positions are near those of an earlier step, and the binary logarithm of the
# most steps in which that is not asked.
_FEW_VERTICES, _MOST_UNASKED = 1 << 12, 4
_NO_END = 1.0


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


class _Around(NamedTuple):
    """Positions of a step around which all others have the same quantization.

    Attributes:
        positions: A copy of them.
        changes: Memory for what others differ by.
        slack: The largest difference, at least 0: equal positions have the same quantization in any case.
    """

    positions: NDArray[np.float64]
    changes: NDArray[np.float64]
    slack: float

    @classmethod
    def of(cls, positions: Positions, quantization: Quantization) -> "_Around":
        """Those around the positions of a step."""
        both = np.stack(positions)
        slack = quantization.slack(float(np.abs(both).max(initial=0.0)))
        return cls(both, np.empty_like(both), max(slack, 0.0))

    def has_near(self, positions: Positions) -> bool:
        """Whether they are among those."""
        changes = self.changes
        for values, at_end, change in zip(positions, self.positions, changes, strict=True):
            np.subtract(values, at_end, out=change)
        return float(np.maximum.reduce(np.abs(changes, out=changes), axis=None, initial=0.0)) <= self.slack


class StepBoxes:
    """Boxes of a mesh, kept between steps and recomputed by each.

    Attributes:
        sets: The trees, and the spatial hashes, that calls have asked for so far, by broad phase and name of the set of
            primitives; see ``trees.tree_pairs_of``.
        vertex_aabbs: AABBs of the vertices of this step.
        quantization: The map to quantized coordinates of this step.
        num_boxes: Boxes computed in this step; those of static bodies count only in the step that computes them.
        num_sorted: Sets of primitives that had to be sorted again in this step.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        self.topology = topology
        self.buffers = buffers
        self.sets: defaultdict[Any, dict[str, BoxSet]] = defaultdict(dict)
        self.num_boxes = self.num_sorted = 0
        self._num_aabbs = 0
        # the boxes of each set, those of trees in the order of the rest configuration
        self._rest: dict[str, tuple[Any, ...]] = {}
        # the numbers of the boxes of trees, and the places of those of some blocks among them
        self._checked: dict[str, tuple[NDArray[np.float32], NDArray[np.intp]]] = {}
        # on CUDA, whether most blocks of a tree consisted of neighbours when it was last filled; not of new orders
        self._are_neighbours: dict[str, bool] = {}
        # sets of static bodies whose boxes are those of `_static_key`
        self._filled: set[str] = set()
        self._static_key: _StaticKey | None = None
        # lists of trees that have their arrays, by their identities, with the number of boxes of those that move
        self._laid_out: dict[int, tuple[Sequence[BoxSet], int]] = {}
        self._around: _Around | None = None
        self._num_far = self._num_unasked = 0
        self._start: NDArray[np.float64] | None = None  # positions by which orders that stay are made, during a step
        self._static_extent = np.float32(0.0)
        self._static_rows = blocks_of(topology.mesh.static_vertex_ranges)

    def begin(
        self,
        positions: Positions,
        inflation: float,
        num_aabbs: int,
        sets: Sequence[BoxSet],
        execution: Execution,
        *,
        goes_on: bool = False,
        keeps_order: bool = False,
    ) -> None:
        """Start a step: choose its quantization, and build what static bodies need where it is not up to date.

        Args:
            positions: Start and end positions.
            inflation: Enlargement of every box, a length.
            num_aabbs: AABBs of a box: 1, the swept AABB; 2, the endpoint AABBs.
            sets: The trees or spatial hashes that the step needs.
            execution: Where to build them.
            goes_on: Whether this is a further slice of a step.
            keeps_order: Whether trees of moving bodies begin in the order of the last step, and not in that of the rest
                configuration.
        """
        start = positions[0]
        mesh = self.topology.mesh
        if not goes_on:
            self.num_boxes = self.num_sorted = 0
        self._start = start if keeps_order else None
        self._quantize(positions, num_aabbs)
        if num_aabbs != self._num_aabbs:
            self._num_aabbs = num_aabbs
            self._rest.clear()
            self._laid_out.clear()
            size = mesh.num_vertices * num_aabbs * VERTEX_AABB_FLOATS
            self.vertex_aabbs = self.buffers.get("vertex_aabbs", size, wp.float32)
        if id(sets) in self._laid_out:
            self.num_boxes += self._laid_out[id(sets)][1]
        else:
            self._lay_out_all(sets, num_aabbs, positions, execution)
        if not keeps_order:
            self._begin_in_rest_order(sets)
        if mesh.static_vertex_ranges:
            self._begin_static(start, inflation, execution)
            for box_set in sets:
                if box_set.primitives.is_static and box_set.name not in self._filled:
                    box_set.structs = self._rest[box_set.name]
                    box_set.fill([box_set], self.vertex_aabbs, execution)
                    self.keep_in_order(box_set, execution)
                    self._filled.add(box_set.name)

    def _lay_out_all(self, sets: Sequence[BoxSet], num_aabbs: int, positions: Positions, execution: Execution) -> None:
        """Give all sets their arrays; of trees these stay, so that it is not asked again."""
        layout = Layout(
            num_aabbs,
            self.buffers.get,
            lambda primitives: rest_order(self.topology, primitives, execution),
            lambda: choose_cell(self.topology, positions, self.quantization),
            self.topology.vertex_group,
        )
        for box_set in sets:
            self._lay_out(box_set, layout)
        if not any(box_set.is_sorted_when_filled for box_set in sets):
            moving = [box_set.primitives for box_set in sets if not box_set.primitives.is_static]
            self._laid_out[id(sets)] = sets, sum(primitives.count for primitives in moving)

    def _quantize(self, positions: Positions, num_aabbs: int) -> None:
        """Choose the quantization: that of an earlier step, where all positions are near those of that one.

        This is asked in meshes of so few vertices that asking takes less than choosing, and after a step that was not
        near less and less often.
        """
        around, num_vertices = self._around, self.topology.mesh.num_vertices
        if around is not None and self._num_aabbs == num_aabbs and around.has_near(positions):
            self._num_far = 0
            return
        self.quantization, self._around = choose_quantization(self.topology, positions, num_aabbs), None
        if around is not None:  # the next steps will hardly be near
            self._num_far += 1
            self._num_unasked = 1 << min(self._num_far, _MOST_UNASKED)
        if self._num_unasked > 0:
            self._num_unasked -= 1
        elif num_vertices <= _FEW_VERTICES and self.topology.mesh.num_worlds == 1:
            self._around = _Around.of(positions, self.quantization)

    def _lay_out(self, box_set: BoxSet, layout: Layout) -> None:
        """Give a set its arrays, and a new tree of moving bodies the order of the rest configuration."""
        is_new = box_set.name not in self._rest
        if is_new:
            box_set.lay_out(layout)
            self._checked.pop(box_set.name, None)
        is_changed = is_new or box_set.adapt(layout)
        if is_changed:
            self._rest[box_set.name] = box_set.structs
            self._filled.discard(box_set.name)
            self._are_neighbours.pop(box_set.name, None)
        if not box_set.primitives.is_static:
            self.num_boxes += box_set.primitives.count

    def _begin_in_rest_order(self, sets: Sequence[BoxSet]) -> None:
        """Give trees of moving bodies the order of the rest configuration."""
        for box_set in sets:
            if not box_set.primitives.is_static:
                box_set.structs = self._rest[box_set.name]
                self._are_neighbours.pop(box_set.name, None)

    def _begin_static(self, start: NDArray[np.float64], inflation: float, execution: Execution) -> None:
        """Compute the vertex AABBs of static bodies, unless they are those of an earlier step."""
        topology = self.topology
        static_positions = [start[rows] for rows in self._static_rows]
        quantization = self.quantization
        key = _StaticKey(static_positions, (*quantization.origin, quantization.scale), inflation, self._num_aabbs)
        if key.same(self._static_key):
            return
        self._static_key = None
        self._filled.clear()
        self._static_extent = typical_static_extent(topology, start, self.quantization.scale)
        positions: wp.array = wp.array(start, dtype=wp.vec3d, device=topology.device, copy=False)
        every = wp.ones(topology.mesh.num_bodies, dtype=wp.int32, device=topology.device)
        execution.launch(
            kernels.fill_vertex_aabbs,
            len(topology.static_vertices),
            inputs=[
                topology.static_vertices,
                *topology.of_vertices(every),
                positions,
                positions,
                _NO_END,
                inflation,
                topology.box_radius,
                quantization.packed,
                self._num_aabbs,
            ],
            outputs=[self.vertex_aabbs],
        )
        self._static_key = replace(key, positions=[positions.copy() for positions in static_positions])

    def release(self) -> None:
        """Do not keep the positions of a step alive."""
        self._start = None

    def may_meet(self, a: BoxSet, b: BoxSet) -> bool:
        """Whether the boxes around two sets overlap; on CUDA, and of spatial hashes, the search has to find out."""
        if a is b or self.topology.device.is_cuda:
            return True
        of_a, of_b = a.bounds(), b.bounds()
        if of_a is None or of_b is None:
            return True
        return bool((of_a[0] <= of_b[1]).all() and (of_b[0] <= of_a[1]).all())

    def keep_in_order(self, box_set: BoxSet, execution: Execution) -> bool:
        """Sort the primitives of a tree by their current positions unless most blocks consist of neighbours.

        On CUDA by what was noted of its last boxes, before it is filled; elsewhere it is filled anew.
        Returns whether it was sorted.
        """
        if box_set.primitives.is_static:
            self.num_boxes += box_set.primitives.count
        elif execution.is_cuda:
            if self._are_neighbours.get(box_set.name, False):
                return False
            self._sort(box_set, execution)
            return True
        if box_set.is_sorted_when_filled or (not execution.is_cuda and self._is_in_order(box_set)):
            return False
        self._sort(box_set, execution)
        box_set.fill([box_set], self.vertex_aabbs, execution)
        return True

    def trust_order(self, trees: Sequence[Any]) -> bool:
        """On CUDA, let trees be filled in their orders before anything is known of these; returns whether some are."""
        is_new = [tree.name not in self._are_neighbours for tree in trees]
        self._are_neighbours |= dict.fromkeys((tree.name for tree in itertools.compress(trees, is_new)), True)
        return any(is_new)

    def note_large_blocks(self, tree: BoxSet, count: int) -> bool:
        """Note how many of the blocks that are looked at are large; returns whether most consist of neighbours."""
        self._are_neighbours[tree.name] = count < CHECKED_BLOCKS // 2
        return self._are_neighbours[tree.name]

    @property
    def largest_block(self) -> np.float32:
        """The longest side of a block of neighbours in a tree of bodies that move, in quantized coordinates."""
        return np.float32(_LARGEST_BLOCK) * self.quantization.typical_extent

    def _sort(self, tree: Any, execution: Execution) -> None:
        """Order the primitives by their current positions, by halving where the order stays for further steps."""
        self.num_sorted += 1
        if self._start is not None and not tree.primitives.is_static:
            order = order_at(self.topology, self._start, tree.primitives, execution)
            tree.set_order(self._num_aabbs, order, tree.arrays.nodes)
            return
        primitives, num_aabbs = tree.primitives, self._num_aabbs
        extent = self._typical_extent_of(primitives)
        keys = sorted_keys(self.topology, primitives, self.vertex_aabbs, num_aabbs, extent, self.buffers, execution)
        mask = (1 << primitives.index_bits) - 1
        order = apply_order(self.topology, keys, mask, primitives, self.buffers.get, execution)
        tree.set_order(num_aabbs, order, tree.arrays.nodes)

    def _typical_extent_of(self, primitives: PrimitiveSet) -> np.float32:
        """The typical extent by which the order of a set is checked and made.

        The trees of static bodies are kept for steps with other positions, so their order must not depend on what moves
        in the step that happens to build them.
        """
        return self._static_extent if primitives.is_static else self.quantization.typical_extent

    def may_be_sorted(self, box_set: BoxSet) -> bool:
        """Whether a tree is sorted on the CPU where most of its blocks do not consist of neighbours."""
        # of few blocks every query tests no more than the boxes of one block before these; a sample has no neighbours;
        # and where a world has hardly more than a block, most hold two, and are large in every order
        are_few = box_set.primitives.count <= _FEW_OF_A_WORLD * len(self.topology.world_places.unit)
        return not (box_set.levels[0] <= WIDTH or are_few or box_set.primitives.is_sample)

    def _is_in_order(self, tree: Any) -> bool:
        """Whether most of the blocks are small enough to consist of neighbours."""
        if not self.may_be_sorted(tree):
            return True
        if tree.name not in self._checked:
            self._checked[tree.name] = tree.arrays.nodes.numpy(), tree.places_of_some_blocks()
        nodes, places = self._checked[tree.name]
        with np.errstate(invalid="ignore", over="ignore"):
            lower, upper = nodes.take(places)
            longest = np.maximum.reduce(np.subtract(upper, lower, out=upper), axis=0)
        longest.sort()
        return bool(longest[len(longest) // 2] <= _LARGEST_BLOCK * self._typical_extent_of(tree.primitives))
