"""Candidate pairs: primitives whose swept boxes overlap."""

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._status import PairKind
from ccd_warp._step import Step


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

    def pairs(kind: PairKind) -> NDArray[np.int32]:
        keys = np.concatenate([np.zeros(0, dtype=np.int64), *parts[kind]])
        keys.sort()
        # the first index is the upper half of a key
        return np.ascontiguousarray(keys.view(np.uint32).reshape(-1, 2)[:, :: -1 if sys.byteorder == "little" else 1])

    with step.timed("sort"):
        found = step.execution.run([lambda k=k: pairs(k) for k in PairKind])  # type: ignore[misc]
    return Candidates(*(array.view(np.int32) for array in found))


def validated_inflation(value: float) -> float:
    """The inflation as a float, or a ValueError."""
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not real or not 0 <= value <= sys.float_info.max:
        raise ValueError(f"inflation is {value!r}; expected a finite length that is not negative")
    return float(value)
