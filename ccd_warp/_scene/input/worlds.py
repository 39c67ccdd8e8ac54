"""The worlds of a mesh: which arrays have an axis of them, and which bodies move alone in theirs."""

import numpy as np
from numpy.typing import NDArray


def aligned_forms(vertex_world: NDArray[np.int32]) -> list[tuple[int, int]]:
    """Numbers of blocks, and of rows in each, that cut rows into equally many for each block and no world in two.

    Args:
        vertex_world: World of each row, shape [n].

    Returns:
        The forms, the one with the most blocks first; none if there are no rows.
    """
    count = len(vertex_world)
    if count == 0:
        return []
    # rows may be cut where all worlds before are less than all that follow
    following = np.minimum.accumulate(vertex_world[::-1])[::-1]
    may_cut = np.append(True, np.maximum.accumulate(vertex_world)[:-1] < following[1:])
    most = int(may_cut.sum())
    blocks = np.arange(1, most + 1)
    blocks = blocks[count % blocks == 0][::-1]
    return [(k, count // k) for k in blocks.tolist() if may_cut[:: count // k].all()]


def worlds_of_bodies(
    vertex_body: NDArray[np.integer], vertex_world: NDArray[np.integer], num_bodies: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first and the last world of each body's vertices, shape [B]; of a body without any the first is larger."""
    first = np.full(num_bodies, np.iinfo(np.int64).max)
    last = np.full(num_bodies, -1, dtype=np.int64)
    np.minimum.at(first, vertex_body, vertex_world)
    np.maximum.at(last, vertex_body, vertex_world)
    return first, last


def move_alone(
    moving: NDArray[np.bool_], self_collision: NDArray[np.bool_], first: NDArray[np.int64], last: NDArray[np.int64]
) -> bool:
    """Whether something moves, at most one body in each world, and none of them collides with itself.

    Args:
        moving: Bodies that move, shape [B].
        self_collision: Bodies that collide with themselves, shape [B].
        first: The first world of each body, as of :func:`worlds_of_bodies`.
        last: The last one.
    """
    if not moving.any() or self_collision[moving].any():
        return False
    if moving.sum() == 1:
        return True
    worlds = first[moving & (first <= last)]
    return bool((first[moving] >= last[moving]).all()) and len(np.unique(worlds)) == len(worlds)
