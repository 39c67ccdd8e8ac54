"""Regions of space, one a rank: recursive bisection of sampled points. Arrays alone, without MPI.

Points and boxes have the coordinates of space and then their world, so that worlds that occupy the same space are
different places. A region is closed below and open above, and all of them tile space: a cut of one into {x < c} and
{x >= c} leaves no point out and puts none into both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Quantiles between which the extent of the samples is measured, so that a few far away do not choose the axis.
_EXTENT = (0.02, 0.98)


@dataclass(frozen=True)
class Regions:
    """The regions in the order of the ranks.

    Attributes:
        lower: Lower corner of each region, which belongs to it, float64, shape [P, k].
        upper: Upper corner, which does not, float64, shape [P, k].
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    def meets(self, region: int, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which closed boxes meet a region, given their corners, shape [n, k]."""
        result = np.ones(len(lower), dtype=bool)
        for low, high, begin, end in zip(lower.T, upper.T, self.lower[region], self.upper[region], strict=True):
            result &= (low < end) & (high >= begin)
        return result

    def holds(self, region: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points, shape [n, k], lie in a region."""
        return self.meets(region, points, points)

    def assigned(self, num_samples: NDArray[np.float64]) -> "Regions":
        """The regions in an order such that each rank gets one of which it has many samples, shape [ranks, regions]."""
        count = len(num_samples)
        rank_of_region, is_free = np.full(count, -1), np.ones(count, dtype=bool)
        places = np.flatnonzero(num_samples)  # which are far fewer than the square of the ranks
        for place in places[np.argsort(-num_samples.ravel()[places], kind="stable")].tolist():
            rank, region = divmod(place, count)
            if rank_of_region[region] < 0 and is_free[rank]:
                rank_of_region[region], is_free[rank] = rank, False
        rank_of_region[rank_of_region < 0] = np.flatnonzero(is_free)
        order = np.argsort(rank_of_region)
        return Regions(self.lower[order], self.upper[order])


def bisected(points: NDArray[np.float64], weights: NDArray[np.float64], count: int) -> Regions:
    """Cut space into regions of nearly equal work.

    Args:
        points: Sampled points, finite, the world last, shape [n, k].
        weights: The work that each of them stands for, shape [n].
        count: Number of regions; it need not be a power of two.

    Returns:
        The regions. Where there are fewer samples than regions, some are without any, or empty.
    """
    lower, upper = (np.full((count, points.shape[1]), end) for end in (-np.inf, np.inf))
    pending = [(np.arange(len(points)), 0, count)]
    while pending:
        items, first, num = pending.pop()
        if num == 1:
            continue
        middle = first + num // 2
        axis, cut = _cut(points[items], weights[items], (middle - first) / num, num)
        below, above = np.s_[first:middle, axis], np.s_[middle : first + num, axis]
        upper[below], lower[above] = np.minimum(upper[below], cut), np.maximum(lower[above], cut)
        is_below = points[items, axis] < cut
        pending += [(items[is_below], first, middle - first), (items[~is_below], middle, first + num - middle)]
    return Regions(lower, upper)


def _cut(points: NDArray[np.float64], weights: NDArray[np.float64], share: float, num: int) -> tuple[int, float]:
    """The axis and the coordinate of a cut below which this share of the work lies; between worlds if these suffice."""
    if len(points) == 0:
        return 0, 0.0
    axis = points.shape[1] - 1
    if len(np.unique(points[:, axis])) < num:
        low, high = np.quantile(0.5 * points[:, :-1], _EXTENT, axis=0)  # of halves, whose difference is a number
        axis = int(np.argmax(high - low))
    order = np.argsort(points[:, axis], kind="stable")
    values, work = points[order, axis], np.cumsum(weights[order])
    steps = np.flatnonzero(values[1:] > values[:-1])  # a cut divides only where one value differs from the next
    if len(steps) == 0:
        return axis, float(values[0])
    step = steps[np.argmin(np.abs(work[steps] - share * work[-1]))]
    return axis, float(values[step + 1])
