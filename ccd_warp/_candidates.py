"""Candidate pairs: primitives whose swept boxes overlap."""

import itertools
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._status import PairKind
from ccd_warp._step import Step

_ALL = 2**63 - 1
# Pairs of a kind from which on they are sorted in ranges, and ranges at the most: each looks through all pairs.
_WORTH_RANGES = 200_000
_MOST_RANGES = 4


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

    def pairs(kind: PairKind, low: int, high: int) -> NDArray[np.int32]:
        """The pairs with keys in [low, high), sorted."""
        found = parts[kind]
        if low > 0:
            found = [part[part >= low] for part in found]
        if high < _ALL:
            found = [part[part < high] for part in found]
        keys = np.concatenate([np.zeros(0, dtype=np.int64), *found])
        keys.sort()
        # the first index is the upper half of a key
        return np.ascontiguousarray(keys.view(np.int32).reshape(-1, 2)[:, :: -1 if sys.byteorder == "little" else 1])

    # A kind with many pairs is sorted in ranges, one a thread.
    ranges = []
    for kind in PairKind:
        total = sum(map(len, parts[kind]))
        pieces = min(step.execution.num_threads, _MOST_RANGES) if total > _WORTH_RANGES else 1
        sample = np.sort(np.concatenate([part[::997] for part in parts[kind]])) if pieces > 1 else None
        cuts = [] if sample is None else [int(sample[len(sample) * k // pieces]) for k in range(1, pieces)]
        ranges += [(kind, low, high) for low, high in itertools.pairwise([0, *cuts, _ALL])]
    with step.timed("sort"):
        found = step.execution.run([lambda r=r: pairs(*r) for r in ranges])  # type: ignore[misc]
        by_kind = {kind: [p for p, r in zip(found, ranges, strict=True) if r[0] == kind] for kind in PairKind}
        return Candidates(*(pieces[0] if len(pieces) == 1 else np.concatenate(pieces) for pieces in by_kind.values()))


def validated_inflation(value: float) -> float:
    """The inflation as a float, or a ValueError."""
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not real or not 0 <= value <= sys.float_info.max:
        raise ValueError(f"inflation is {value!r}; expected a finite length that is not negative")
    return float(value)
