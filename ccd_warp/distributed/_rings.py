"""The vertices that exclusion_rings, and pairs of vertices, keep from each vertex, over the edges of all ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed._homes import Homes

_MOST_VERTICES = 1 << 27


@dataclass(frozen=True)
class Rings:
    """Rows of numbers, for the vertices of which this rank is the home.

    Attributes:
        homes: The homes.
        keys: The vertices of the rows and those in them, ascending, int64, shape [n, 2].
    """

    homes: Homes
    keys: NDArray[np.int64]

    @staticmethod
    def of(
        homes: Homes,
        edges: NDArray[np.int64],
        numbers: NDArray[np.int64],
        num_rings: int,
        excluded: NDArray[np.int64],
    ) -> Rings | None:
        """The rings of a mesh, collectively; None where pairs that share a vertex are all that is left out.

        Args:
            homes: The homes of numbers of vertices.
            edges: Numbers of the vertices of the edges that this rank owns, shape [n, 2].
            numbers: Number of each of its vertices.
            num_rings: ``exclusion_rings``.
            excluded: Further pairs of numbers, the same on all ranks.
        """
        if num_rings == 1 and len(excluded) == 0:
            return None
        ranks = homes.ranks
        rings = Rings(homes, np.zeros((0, 2), dtype=np.int64))
        vertices = np.unique(numbers)
        near = np.zeros((0, 2), dtype=np.int64)
        if num_rings > 1:
            neighbours = Rings(homes, rings._sent_home(np.concatenate([edges, edges[:, ::-1]])))
            near = rings._sent_home(np.stack([vertices, vertices], axis=1))
            fresh = near
            for _ in range(num_rings - 1):
                reached = neighbours.rows_of(fresh[:, 1])
                lengths = reached[0]
                pairs = np.stack([np.repeat(fresh[:, 0], lengths), reached[1]], axis=1)
                # what is reached from a vertex of this home belongs to this home
                keys = np.unique(np.concatenate([near, pairs]), axis=0)
                fresh = _without(keys, near)
                near = keys
                size, most = int(ranks.total(np.array(len(near)))), int(ranks.most(np.array(len(fresh))))
                if size > _MOST_VERTICES * ranks.size:
                    raise ValueError(
                        f"exclusion_rings is {num_rings}, which leaves out more than {_MOST_VERTICES} pairs of "
                        f"vertices for each rank; expected a lower number"
                    )
                if most == 0:
                    break
        listed = rings._sent_home(np.concatenate([excluded, excluded[:, ::-1]]) if ranks.rank == 0 else excluded[:0])
        return Rings(homes, np.unique(np.concatenate([near, listed]), axis=0))

    def _sent_home(self, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
        """The pairs of all ranks whose first number has its home here, ascending, each once."""
        return np.unique(self.homes.ask(pairs, pairs[:, 0]).rows, axis=0)

    def rows_of(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The length of the row of each number, and the rows one after the other; collective."""
        unique, place = np.unique(numbers, return_inverse=True)
        ranks = self.homes.ranks
        requested = self.homes.ask(unique, unique).received
        begins = [np.searchsorted(self.keys[:, 0], part, side="left") for part in requested]
        ends = [np.searchsorted(self.keys[:, 0], part, side="right") for part in requested]
        lengths = ranks.swap([end - begin for begin, end in zip(begins, ends, strict=True)])
        rows = ranks.swap([self.keys[_ranges(begin, end - begin), 1] for begin, end in zip(begins, ends, strict=True)])
        # homes hold ascending ranges, so their answers follow each other as the unique numbers do
        length, row = np.concatenate(lengths), np.concatenate(rows)
        begin = np.cumsum(length) - length
        return length[place], row[_ranges(begin[place], length[place])]

    def among(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Begin of each row, and the rows, as places among ascending numbers; what is not among them is left out."""
        lengths, row = self.rows_of(numbers)
        vertex = np.repeat(np.arange(len(numbers)), lengths)
        if len(numbers) == 0:
            return np.zeros(1, dtype=np.int32), np.zeros(0, dtype=np.int32)
        place = np.minimum(np.searchsorted(numbers, row), len(numbers) - 1)
        is_here = numbers[place] == row
        counts = np.bincount(vertex[is_here], minlength=len(numbers))
        return np.append(0, np.cumsum(counts)).astype(np.int32), place[is_here].astype(np.int32)


def _ranges(begin: NDArray[np.integer], length: NDArray[np.integer]) -> NDArray[np.int64]:
    """The numbers of several ranges, one after the other."""
    total = int(length.sum())
    shift = np.repeat(begin - (np.cumsum(length) - length), length)
    return np.arange(total) + shift


def _without(keys: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows that are not among others, both unique."""
    both, counts = np.unique(np.concatenate([keys, others]), axis=0, return_counts=True)
    return both[counts == 1]
