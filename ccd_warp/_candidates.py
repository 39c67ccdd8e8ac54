"""Candidate pairs: primitives whose swept boxes overlap."""

import itertools
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._arguments import check_real
from ccd_warp._status import PairKind
from ccd_warp._step import Step

# Pairs of a kind from which on threads sort them together.
_WORTH_RANGES = 100_000


@dataclass(frozen=True)
class Candidates:
    """Pairs that may collide in the step, each once, in lexicographic order.

    Attributes:
        vertex_face: Vertex and face indices, int32, shape [m, 2].
        edge_edge: Edge indices, first < second, int32, shape [k, 2].
        point_segment: Indices of loose points among the vertices and of loose edges among the edges, int32,
            shape [n, 2]; empty where the mesh has none.
        point_point: Indices of loose points among the vertices, first < second, int32, shape [l, 2]; likewise.
    """

    vertex_face: NDArray[np.int32]
    edge_edge: NDArray[np.int32]
    point_segment: NDArray[np.int32]
    point_point: NDArray[np.int32]


def sorted_candidates(step: Step, inflation: float) -> Candidates:
    """All pairs whose boxes overlap, in order."""
    parts = step.candidates(inflation)

    threads = step.execution.num_threads
    # the first index is the upper half of a key
    swap = slice(None, None, -1 if sys.byteorder == "little" else 1)

    def begin(kind: PairKind) -> tuple[NDArray[np.int64], NDArray[np.int32], list[int]]:
        """The keys of a kind, parted so that ranges between cuts can be sorted apart; room for the pairs; the cuts."""
        keys = np.concatenate([np.zeros(0, dtype=np.int64), *parts[kind]])
        pieces = threads if len(keys) > _WORTH_RANGES else 1
        cuts = [len(keys) * k // pieces for k in range(pieces + 1)]
        if pieces > 1:
            keys.partition(cuts[1:-1])
        return keys, np.empty((len(keys), 2), dtype=np.int32), cuts

    def finish(keys: NDArray[np.int64], pairs: NDArray[np.int32], low: int, high: int) -> None:
        """Sort a range and write its pairs."""
        keys[low:high].sort()
        pairs[low:high] = keys[low:high].view(np.int32).reshape(-1, 2)[:, swap]

    with step.timed("sort"):
        found = step.execution.run([lambda k=k: begin(k) for k in PairKind])  # type: ignore[misc]
        ranges = [(keys, pairs, *cut) for keys, pairs, cuts in found for cut in itertools.pairwise(cuts)]
        step.execution.run([lambda r=r: finish(*r) for r in ranges])  # type: ignore[misc]
    return Candidates(*(pairs for _, pairs, _ in found))


def validated_inflation(value: float) -> float:
    """The inflation as a float, or a ValueError."""
    return check_real("inflation", value, "a finite length that is not negative", lambda x: x >= 0)
