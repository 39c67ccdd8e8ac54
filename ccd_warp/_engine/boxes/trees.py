"""Trees of boxes, and the pairs of trees whose primitives form pairs of a kind."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import BLOCK_FLOATS, BoxSet, Layout, Order, level_sizes
from ccd_warp._engine.mesh.lengths import next_above
from ccd_warp._engine.mesh.samples import uneven_samples
from ccd_warp._engine.mesh.topology import WIDTH, PrimitiveSet, Role, Topology
from ccd_warp._runtime.launch import Execution, Recording, Slot, fields_of
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.threads import StopFlag
from ccd_warp.kernels.boxes import box_tree as kernels
from ccd_warp.kernels.boxes import half_warp_tree
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.search import search_types

_DIAGONAL = float(np.nextafter(np.sqrt(3.0), 2.0))  # of a cube with a side of 1, and more
# A level of no more boxes than this is united in one launch with all levels above.
_FEW_BOXES = 2048
# Trees that a launch fills on CUDA: as many as its kernel has arguments.
_MOST_TREES = 3
# The roles of bodies whose primitives are paired: one of the two is free.
_PAIRED: tuple[tuple[Role, Role], ...] = (
    ("moving", "moving"),
    ("moving", "kinematic"),
    ("kinematic", "moving"),
    ("moving", "static"),
    ("static", "moving"),
    ("slender", "slender"),
)
# Blocks of a tree that are looked at to see whether most consist of neighbours.
CHECKED_BLOCKS = 64
# Box tests above which a part of a search may take long: some 0.3 s if all boxes overlap.
LONG_SEARCH = 1 << 22
# On CUDA a warp takes up to `WIDTH` queries. Where there are not enough for so many warps, about twice as many as an
# H100 runs at once, several warps share the leaves of each walk, or each has fewer queries.
_BUSY_WARPS = 1 << 12
# Largest number of queries of a launch on CUDA, whose threads are numbered in 32 bits.
MOST_QUERIES = 1 << 26


class Tree(BoxSet):
    """A set of primitives and the tree of their boxes."""

    walk = "search_trees"
    parts = ("boxes",)
    is_sorted_when_filled = False
    _nodes: tuple[wp.array, NDArray[np.float32]] | None = None  # an array of boxes, and the same as one of NumPy

    def __init__(self, primitives: PrimitiveSet) -> None:
        super().__init__(primitives, level_sizes(primitives.count), primitives.name)

    def lay_out(self, layout: Layout) -> None:
        """Give the tree an order, and arrays for boxes that it does not have yet."""
        nodes = layout.allocate(f"{self.name} boxes", self.num_floats(layout.num_aabbs), wp.float32)
        self.set_order(layout.num_aabbs, layout.order_of(self.primitives), nodes)

    def set_order(self, num_aabbs: int, order: Order, nodes: wp.array) -> None:
        """Give the tree an order and an array for its boxes."""
        first = np.concatenate([[0], np.cumsum(self.levels)])
        arrays = kernels.BoxTree()
        arrays.num_boxes = self.primitives.count
        arrays.num_levels = len(self.levels)
        arrays.num_aabbs = num_aabbs
        arrays.block_begin = kernels.vec8i(*(int(b) for b in [*first[:-1], *[0] * 8][:8]))
        arrays.nodes = nodes
        arrays.primitive, arrays.corners, groups = order
        if groups is not None:
            arrays.groups = groups
        self.structs = (arrays,)

    def level_boxes(self, level: int) -> NDArray[np.float32]:
        """Lower and upper corners of a level, indexed by block, AABB, corner, axis and lane; on the CPU."""
        size = self.arrays.num_aabbs * BLOCK_FLOATS
        first = sum(self.levels[:level])
        if self._nodes is None or self._nodes[0] is not self.arrays.nodes:
            self._nodes = self.arrays.nodes, self.arrays.nodes.numpy()
        floats = self._nodes[1][first * size : (first + self.levels[level]) * size]
        return floats.reshape(-1, self.arrays.num_aabbs, 2, 3, WIDTH)

    def places_of_some_blocks(self) -> NDArray[np.intp]:
        """Where boxes around blocks of a sample have their corners among the nodes, shape [2, 3 AABBs, blocks]."""
        blocks, num_aabbs = uneven_samples(self.levels[0], CHECKED_BLOCKS), self.arrays.num_aabbs
        size, of_box = num_aabbs * BLOCK_FLOATS, WIDTH * np.arange(6 * num_aabbs).reshape(num_aabbs, 2, 3)
        first: NDArray[np.intp] = (self.levels[0] + blocks // WIDTH) * size + blocks % WIDTH
        return of_box.swapaxes(0, 1).reshape(2, -1, 1) + first

    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The box around the tree, in quantized coordinates; on the CPU."""
        block = self.level_boxes(len(self.levels) - 1)[0]
        return block[:, 0].min(axis=(0, 2)), block[:, 1].max(axis=(0, 2))

    @staticmethod
    def fill(
        sets: Iterable["Tree"],
        vertex_aabbs: wp.array | Slot,
        launcher: Execution | Recording,
        structs_of: Callable[["Tree"], tuple[Any, ...]] = lambda tree: tree.structs,
        only_if: wp.array | None = None,
    ) -> None:
        """Compute the boxes of every level of trees from the vertex AABBs."""
        trees = list(dict.fromkeys(sets))
        if launcher.is_cuda:
            fill_in_half_warps(trees, vertex_aabbs, launcher, structs_of, only_if)
        else:
            _fill_in_blocks(trees, vertex_aabbs, launcher, structs_of)


_StructsOf = Callable[[Tree], tuple[Any, ...]]


def _fill_in_blocks(
    trees: list[Tree], vertex_aabbs: wp.array | Slot, launcher: Execution | Recording, structs_of: _StructsOf
) -> None:
    """Compute the boxes on the CPU: a launch fills the lowest two levels, and one each of the large ones above."""
    next_level = dict.fromkeys(trees, 2)
    with launcher.at_once():
        for tree in next_level:
            inputs = [vertex_aabbs, tree.primitives.num_corners]
            launcher.launch(kernels.fill_blocks, tree.levels[0], inputs, list(structs_of(tree)), grain=2048)
    while True:
        large = [
            tree
            for tree, level in next_level.items()
            if level < len(tree.levels) and tree.levels[level - 1] > _FEW_BOXES
        ]
        if not large:
            break
        with launcher.at_once():
            for tree in large:
                level = next_level[tree]
                count = tree.levels[level - 1]
                launcher.launch(kernels.unite_blocks, count, inputs=[level, count], outputs=list(structs_of(tree)))
                next_level[tree] += 1
    with launcher.at_once():
        for tree, level in next_level.items():
            if level < len(tree.levels):
                inputs = [level, tree.levels[level - 1]]
                launcher.launch(kernels.unite_levels, 1, inputs, list(structs_of(tree)), grain=2)


_TreeToFill = fields_of(half_warp_tree.TreeToFill)


def fill_in_half_warps(
    trees: Sequence[BoxSet],
    vertex_aabbs: wp.array | Slot,
    launcher: Execution | Recording,
    structs_of: Callable[[Any], tuple[Any, ...]],
    only_if: wp.array | None,
) -> None:
    """Compute the boxes on CUDA: a launch fills all levels of a few trees."""
    if only_if is None:
        only_if = wp.empty(0, dtype=wp.int32, device=launcher.device)
    for k in range(0, len(trees), _MOST_TREES):
        filled, end = [], 0
        for tree in trees[k : k + _MOST_TREES]:
            end += tree.levels[0] * tree.arrays.num_aabbs * WIDTH
            of_tree = _TreeToFill(end, tree.primitives.num_corners, structs_of(tree)[0], tree.arrivals)
            filled.append(launcher.struct(of_tree))
        filled += filled[-1:] * (_MOST_TREES - len(filled))  # which have no threads
        launcher.launch(half_warp_tree.fill_trees, end, inputs=[only_if, vertex_aabbs], outputs=filled)


@dataclass(frozen=True)
class TreePair:
    """Two trees, or two spatial hashes, whose boxes may overlap; the same one twice for pairs within a set."""

    kind: PairKind
    query: BoxSet
    target: BoxSet
    swapped: bool = False
    prunes: bool = False  # whether some of the bodies may not meet, so that boxes may hold no partner of a query
    rise: int = 0  # of spatial hashes: the least number of levels by which the targets are above the query

    @property
    def within(self) -> bool:
        """Whether the pairs are those of one set."""
        return self.query.primitives is self.target.primitives

    @property
    def is_symmetric(self) -> bool:
        """Whether both primitives are of one kind, and the lower index comes first."""
        return self.kind in (PairKind.EDGE_EDGE, PairKind.POINT_POINT)

    @lazy_property
    def packed(self) -> Any:
        """The pair as the struct of the kernels."""
        packed = search_types.TreePair()
        packed.kind = int(self.kind)
        packed.within = int(self.within)
        packed.symmetric = int(self.is_symmetric)
        packed.swapped = int(self.swapped)
        packed.num_query_corners = self.query.primitives.num_corners
        packed.num_target_corners = self.target.primitives.num_corners
        packed.prunes = int(self.prunes)
        packed.rise = self.rise
        return packed


@dataclass(frozen=True)
class SearchPart:
    """Items of a tree pair: blocks of queries (level 1) or single queries (level 0)."""

    tree_pair: TreePair
    level: int
    items: range
    number: int = 0  # of the tree pair

    @staticmethod
    def whole(tree_pair: TreePair, *, is_cuda: bool, number: int = 0) -> "SearchPart":
        """All items of a tree pair."""
        query = tree_pair.query
        count = query.primitives.count if is_cuda else query.levels[0]
        return SearchPart(tree_pair, 0 if is_cuda else 1, range(count), number)

    @property
    def num_queries(self) -> int:
        """Number of query boxes."""
        return len(self.items) * WIDTH**self.level

    @property
    def place(self) -> tuple[int, int]:
        """Where the part begins: the numbers of the tree pair, and of its first item."""
        return self.number, self.items[0]

    @property
    def num_tests(self) -> int:
        """Number of pairs of boxes, most of which the tree rejects early."""
        return self.num_queries * self.tree_pair.target.primitives.count

    def split(self, count: int) -> list["SearchPart"]:
        """These items in at least ``count`` parts, as far as that is possible."""
        if len(self.items) == 1 and self.level == 1:
            first = WIDTH * self.items[0]
            queries = range(first, min(first + WIDTH, self.tree_pair.query.primitives.count))
            return replace(self, level=0, items=queries).split(count)
        count, length = min(count, len(self.items)), len(self.items)
        # queries of one block stay together where there are enough, as a warp takes them
        unit = WIDTH if self.level == 0 and length >= WIDTH * count else 1
        bounds = [length // unit * k // count * unit for k in range(count)] + [length]
        return [replace(self, items=self.items[i:j]) for i, j in itertools.pairwise(bounds)]


def search_options(
    t_end: float, inflation: float, separation: float, norm: Norm, flag: StopFlag, radii: tuple[wp.array, wp.array]
) -> Any:
    """What a step asks of the search, as the struct of the kernels; ``radii`` of vertices and of their boxes.

    Sagittas of arcs are Euclidean, as radii are, so the search is for balls there; one that holds a box is as large as
    its diagonal.
    """
    if norm.has_arcs and not norm.is_ball:
        norm, separation = Norm.EUCLIDEAN, next_above(_DIAGONAL * separation)
    packed = search_types.SearchOptions()
    packed.t_end, packed.inflation, packed.separation = t_end, inflation, separation
    packed.is_euclidean = int(norm.is_ball)
    packed.radius, packed.box_radius = radii
    packed.stop = flag.array
    return packed


def search_range(
    level: int,
    row: int,
    items: range,
    capacity: int = 0,
    first_key: int = 0,
    marks_overflow: bool = False,
) -> Any:
    """The items that a launch searches and the keys that it may write, as the struct of the kernel."""
    packed = search_types.SearchRange()
    packed.first, packed.stride, packed.level, packed.end = items.start, items.step, level, items.stop
    packed.row, packed.first_key, packed.capacity = row, first_key, capacity
    packed.marks_overflow = int(marks_overflow)
    return packed


def range_of_warps(
    row: int,
    queries: range,
    capacity: int = 0,
    first_key: int = 0,
    marks_overflow: bool = False,
    *,
    most_warps: int = 0,
    shares_leaves: bool = False,
) -> Any:
    """Consecutive queries that a launch on CUDA searches, with ``num_warps`` warps, ``most_warps`` of them if given."""
    packed = search_range(0, row, queries, capacity, first_key, marks_overflow)
    # a power of two: they are below one inner box, where others might be on both sides of a large gap
    packed.stride, packed.shares = _power_of_two(len(queries) // _BUSY_WARPS), 1
    if shares_leaves:
        packed.stride, packed.shares = WIDTH, _power_of_two(WIDTH * _BUSY_WARPS // max(len(queries), 1))
    num_items = -(-len(queries) // packed.stride) * packed.shares
    packed.num_warps = min(num_items, most_warps or num_items)
    return packed


def _power_of_two(most: int) -> int:
    """The largest power of two that is no more than a number, at least 1 and at most `WIDTH`."""
    return min(WIDTH, 1 << (max(most, 1).bit_length() - 1))


def tree_pairs_of(
    topology: Topology,
    kinds: tuple[PairKind, ...],
    skip_free: bool,
    trees: dict[str, BoxSet],
    make: Callable[[PrimitiveSet], BoxSet],
    *,
    with_slender: bool = False,
) -> list[TreePair]:
    """The tree pairs to search: always with a tree of free bodies, and two of these unless ``skip_free`` is set.

    Pairs within slender bodies have trees of their own if ``with_slender`` is set. Trees that are not in ``trees`` yet,
    by name of their sets, are made and added to it.
    """

    def tree(kind: str, role: Role) -> BoxSet:
        primitives = topology.primitives(kind, role)
        if primitives.name not in trees:
            trees[primitives.name] = make(primitives)
        return trees[primitives.name]

    tree_pairs = []
    paired = [pair for pair in _PAIRED if with_slender or "slender" not in pair]
    paired = [pair for pair in paired if all(topology.bodies_of(role).any() for role in pair)]
    meets = {pair: topology.meets(*pair) for pair in paired}
    for kind in kinds:
        if kind == PairKind.VERTEX_PLANE:
            continue  # every plane meets every vertex
        first, second = topology.primitives_of(kind)
        for of_first, of_second in paired:
            is_turned = of_first != "moving" == of_second
            meets_any, meets_all = meets[of_first, of_second]
            if (is_turned and first == second) or not meets_any:
                continue
            if skip_free and of_first == of_second == "moving":
                continue
            if topology.primitives(first, of_first).count and topology.primitives(second, of_second).count:
                a, b = tree(first, of_first), tree(second, of_second)
                # the free primitives are the queries, so that the tree of the static ones is only traversed
                swapped = is_turned or (
                    topology.fewer_query and of_second == "moving" and b.primitives.count < a.primitives.count
                )
                query, target = (b, a) if swapped else (a, b)
                tree_pairs.append(TreePair(kind, query, target, swapped, prunes=not meets_all))
    return tree_pairs


def sampled_pairs_of(
    tree_pairs: list[TreePair],
    topology: Topology,
    trees: dict[str, BoxSet],
    make: Callable[[PrimitiveSet], BoxSet],
) -> list[TreePair]:
    """The tree pairs in which a sample of the queries takes the place of all of them.

    Trees of samples that are not in ``trees`` yet are made and added to it. A pair of two primitives of one sample is
    found twice.
    """
    sampled_pairs = []
    for pair in tree_pairs:
        kind = topology.primitives_of(pair.kind)[int(pair.swapped)]
        primitives = topology.sampled_queries(pair.query.primitives, kind)
        if primitives.count:
            if primitives.name not in trees:
                trees[primitives.name] = make(primitives)
            sampled_pairs.append(replace(pair, query=trees[primitives.name]))
    return sampled_pairs


def trees_of(tree_pairs: list[TreePair]) -> list[BoxSet]:
    """The trees of the pairs, each once."""
    return list(dict.fromkeys(tree for pair in tree_pairs for tree in (pair.query, pair.target)))
