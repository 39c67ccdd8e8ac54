"""What intersects at one time, as a rank has found it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.intersections import Crossings, Intersections
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp.distributed._results import PairsOnRanks


@text_completed_by(Intersections)
@dataclass(frozen=True, repr=False, eq=False)
class DistributedIntersections(Crossings, PairsOnRanks):
    """Pairs that touch or pass through each other at one time and that this rank has found; each is on one rank.

    They are ordered as those of :class:`ccd_warp.Intersections`.

    Attributes:
        primitives: Indices of both primitives in the whole mesh, int64, shape [m, 2].
        vertices: Ids of the vertices, as in ``ccd_warp.Intersections.vertices``, int64, shape [m, 5].
        num_intersections: Number of pairs of the whole mesh, the same on all ranks.
    """

    parameters: NDArray[np.float64]
    edge_parameter: NDArray[np.float64]
    points: NDArray[np.float64]
    vertices: NDArray[np.int64]
    bodies: NDArray[np.int32]
    world: NDArray[np.int32]
    num_intersections: int

    def __repr__(self) -> str:
        here = f"{counted(self.num_crossing, 'crossing', 'crossings')} and {self.num_touching:,} that touch"
        return f"DistributedIntersections({here} on this rank, {self.num_intersections:,} on all)"
