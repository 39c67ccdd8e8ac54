"""A search of those queries of a tree pair alone that may find a pair with one of some vertices; on the CPU.

An item of a search is a block of queries, which begins with the box around it. In a copy of the tree that box is empty
for a block that neither has such a vertex nor comes near a block of targets that has one.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import WIDTH
from ccd_warp._engine.boxes.trees import Tree, TreePair
from ccd_warp._engine.mesh.topology import BLOCK_CORNERS

# Blocks of a tree from which on this is worth its time, and of these, how many may have such a vertex; and of pairs of
# boxes, how many are tested at a time.
_LEAST_BLOCKS, _MOST_BLOCKS, _MOST_TESTS = 256, 0.25, 1 << 21
_Blocks = NDArray[np.bool_]


def with_some_queries(
    tree_pair: TreePair, is_wanted: NDArray[np.bool_], allocate: Callable[[str, int], wp.array]
) -> TreePair | None:
    """The pair with the queries that wanted vertices need, in an array of a name and a length; None if it needs all.

    A pair of primitives of which one has a wanted vertex is found as in a search of all; of others some are.
    """
    query, target = tree_pair.query, tree_pair.target
    if not isinstance(query, Tree) or not isinstance(target, Tree):
        return None
    if not has_many_blocks(tree_pair):
        return None
    blocks, of_target = (_blocks_with(tree, is_wanted) for tree in (query, target))
    if blocks.sum() > _MOST_BLOCKS * len(blocks) or of_target.sum() > _MOST_BLOCKS * len(of_target):
        return None
    near = _blocks_near(query, target, np.flatnonzero(of_target))
    if near is None:
        return None
    name = f"{query.name} for {tree_pair.kind.name} {target.name}"  # a tree has the queries of several pairs
    return replace(tree_pair, query=_with_blocks(query, blocks | near, name, allocate))


def has_many_blocks(tree_pair: TreePair) -> bool:
    """Whether there are so many blocks of queries that leaving some out may pay."""
    return tree_pair.query.levels[0] >= _LEAST_BLOCKS


def _blocks_with(tree: Tree, is_wanted: NDArray[np.bool_]) -> _Blocks:
    """Which blocks of a tree have a primitive with a wanted vertex."""
    corners = tree.arrays.corners.numpy()[: tree.levels[0] * BLOCK_CORNERS].reshape(-1, BLOCK_CORNERS)
    with_wanted: _Blocks = is_wanted[corners].any(axis=1)  # what stands in an empty place may be any
    return with_wanted


def _blocks_near(tree: Tree, other: Tree, others: NDArray[np.intp]) -> _Blocks | None:
    """Which blocks of a tree have boxes that may overlap those of some blocks of another; None if they are many."""
    low, high = (corner[others] for corner in _around(other, 1))
    level = len(tree.levels) - 1
    boxes = np.arange(tree.levels[level - 1])
    which, boxes = np.repeat(np.arange(len(others)), len(boxes)), np.tile(boxes, len(others))
    while True:
        of_tree = _around(tree, level)
        overlap = (of_tree[0][boxes] <= high[which]).all(axis=1) & (low[which] <= of_tree[1][boxes]).all(axis=1)
        which, boxes, level = which[overlap], boxes[overlap], level - 1
        if level == 0:
            break
        if len(boxes) * WIDTH > _MOST_TESTS:
            return None
        which, boxes = np.repeat(which, WIDTH), (WIDTH * boxes[:, None] + np.arange(WIDTH)).ravel()
        exists = boxes < tree.levels[level - 1]
        which, boxes = which[exists], boxes[exists]
    near = np.zeros(tree.levels[0], dtype=bool)
    near[boxes] = True
    return near


def _around(tree: Tree, level: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The corners of the boxes of a level over the whole step, shape [n, 3] each."""
    boxes = tree.level_boxes(level)
    low, high = (corner.transpose(0, 2, 1).reshape(-1, 3) for corner in (boxes[:, :, 0].min(1), boxes[:, :, 1].max(1)))
    return low, high


def _with_blocks(tree: Tree, blocks: _Blocks, name: str, allocate: Callable[[str, int], wp.array]) -> Tree:
    """A copy of a tree for queries in which the box around each other block is empty."""
    arrays, some = tree.arrays, Tree(tree.primitives)
    some.name = name
    count = tree.num_floats(arrays.num_aabbs)
    nodes = allocate(f"{name} boxes", count)
    wp.copy(nodes, arrays.nodes, count=count)
    some.set_order(arrays.num_aabbs, (arrays.primitive, arrays.corners, arrays.groups), nodes)
    around = some.level_boxes(1)
    is_empty = np.ones(len(around) * WIDTH, dtype=bool)
    is_empty[: len(blocks)] = ~blocks
    of_corners = is_empty.reshape(-1, 1, 1, WIDTH)
    np.copyto(around[:, :, 0], np.float32(np.inf), where=of_corners)
    np.copyto(around[:, :, 1], np.float32(-np.inf), where=of_corners)
    return some
