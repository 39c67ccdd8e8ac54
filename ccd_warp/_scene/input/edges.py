"""The unique edges of a mesh: those of its faces, and codimensional edges; and what they connect."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def unique_edges(
    faces: NDArray[np.integer], listed_edges: NDArray[np.integer]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Unique (min, max) pairs sorted by (max, min), and the indices of those in no face; indices within int32.

    One sort of 64-bit keys, and NumPy sorts those with SIMD.
    """
    a, b, c = (faces[:, k] for k in range(3))
    keys = _unique_edge_keys([(a, b), (b, c), (c, a)])
    codimensional = np.zeros(0, dtype=np.int64)
    if len(listed_edges):
        codimensional = _unique_edge_keys([(listed_edges[:, 0], listed_edges[:, 1])])
        codimensional = np.setdiff1d(codimensional, keys, assume_unique=True)
        keys = np.sort(np.concatenate([keys, codimensional]))
    edges = np.stack([keys & 0xFFFFFFFF, keys >> 32], axis=1).astype(np.int32)
    return edges, np.searchsorted(keys, codimensional).astype(np.int32)


def _unique_edge_keys(pairs: Sequence[tuple[NDArray[np.integer], NDArray[np.integer]]]) -> NDArray[np.int64]:
    """Ascending keys (max << 32) | min of the edges among pairs of vertices; (a, a) is none."""
    wide = [(p.astype(np.int64), q.astype(np.int64)) for p, q in pairs]
    keys = np.concatenate([(np.maximum(p, q) << 32) | np.minimum(p, q) for p, q in wide])
    keys.sort()
    first = np.ones(len(keys), dtype=bool)
    first[1:] = keys[1:] != keys[:-1]
    keys = keys[first]
    return keys[(keys >> 32) != (keys & 0xFFFFFFFF)]


def lowest_linked(count: int, links: NDArray[np.integer]) -> NDArray[np.int64]:
    """The lowest node of those with which each is connected by links, shape [count]."""
    lowest = np.arange(count)
    while True:
        ends = np.sort(lowest[links], axis=1)
        links = ends[ends[:, 0] != ends[:, 1]]
        if not len(links):
            return lowest
        np.minimum.at(lowest, links[:, 1], links[:, 0])
        while not np.array_equal(further := lowest[lowest], lowest):
            lowest = further
