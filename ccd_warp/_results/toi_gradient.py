"""What gradients of times of impact are: arrays with a row for each pair."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.placed import Placed
from ccd_warp._runtime.display import counted


@dataclass(frozen=True, eq=False, repr=False)
class ToiGradient(Placed):
    """How times of impact change with the points of their pairs at both ends of the step, to first order.

    To first order toi changes by the sum of ``start`` times the moves of the points at the start, ``end`` times those
    at the end, and ``distance`` times the change of the distance at which the pair counts as touching. Where a contact
    lies on the border of a face or an edge, that holds for moves that keep it on the primitive.

    Attributes:
        start: d toi / d start position of each point, in 1 / length, float64, shape [n, points, 3], or [n, points, 2]
            in the plane. The points are those of the columns of ``vertices``; of a pair function those of the call.
        end: d toi / d end position of each point, of the same shape.
        distance: d toi / d distance, in 1 / length, float64, shape [n]: that of the minimum distance, of the minimum
            separation as a length, and of each of the two radii of the pair. Never above 0.
        is_regular: Whether the toi has a gradient, bool, shape [n]. Where it has none, all of it is 0: with a toi of
            inf or 0, at ``t_max``, at a limit, where the two graze each other or only come within the tolerance, and
            where a toi jumps rather than moves, as that of a point on a point or on an edge in space without a
            distance.
        vertices: Vertices of the mesh whose positions the points are, int32, shape [n, 4]: the columns of
            ``contacts.vertices``; of a plane that moves the last is the vertex that is its point. Columns that repeat a
            vertex are 0, and so are vertices of rigid bodies, of whose poses a motion gives the gradients:
            :meth:`ccd_warp.RigidMotion.gradient_by_poses`. None for pair functions.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    distance: NDArray[np.float64]
    is_regular: NDArray[np.bool_]
    vertices: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.distance)

    def __repr__(self) -> str:
        return f"ToiGradient({counted(len(self), 'pair', 'pairs')}, {np.count_nonzero(self.is_regular):,} regular)"
