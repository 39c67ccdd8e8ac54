"""Regions of space, one a rank: recursive bisection, and which regions a box meets. Arrays alone, without MPI.

Points and boxes have four coordinates: three of space, and their world, so that worlds that occupy the same space are
different places. A cut divides a region into what lies below it and what lies at it or above it. So each region is
closed below and open above, every point lies in exactly one region, and the regions tile space: the whole is one
region, and a cut of a region into {x < c} and {x >= c} leaves no point out and puts none into both.

Coordinates come first in all arrays, shape [4, n], so that a cut reads one contiguous row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DIMENSIONS = 4
WORLD_AXIS = 3
# Share of a region's weight by which a cut between worlds may miss its target; otherwise space is cut.
_WORLD_SLACK = 0.05
# Quantiles between which the extent of the samples is measured, so that a few far away do not choose the axis.
_EXTENT = (0.02, 0.98)


@dataclass(frozen=True)
class Regions:
    """A binary tree of cuts, whose leaves are the regions in their order.

    Attributes:
        axis: Axis of each cut, int64, shape [P - 1].
        cut: Its coordinate, float64, shape [P - 1].
        below: What lies below a cut: the number of another cut, or ~r of region r, int64, shape [P - 1].
        above: What lies at a cut or above it, likewise.
        lower: Lower corner of each region, which belongs to it, float64, shape [P, 4].
        upper: Upper corner, which does not, float64, shape [P, 4].
    """

    axis: NDArray[np.int64]
    cut: NDArray[np.float64]
    below: NDArray[np.int64]
    above: NDArray[np.int64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of regions."""
        return len(self.lower)


def bisected(points: NDArray[np.float64], weights: NDArray[np.float64], count: int) -> Regions:
    """Cut space into regions of nearly equal weight.

    Args:
        points: Samples, shape [4, n].
        weights: The work that each of them stands for, shape [n].
        count: Number of regions; it need not be a power of two.

    Returns:
        The regions. Where there are fewer samples than regions, some are empty.
    """
    lower = np.full((count, DIMENSIONS), -np.inf)
    upper = np.full((count, DIMENSIONS), np.inf)
    axis, cut = np.zeros(count - 1, dtype=np.int64), np.zeros(count - 1)
    below, above = np.zeros(count - 1, dtype=np.int64), np.zeros(count - 1, dtype=np.int64)
    # samples of a part, its first region, their number, and where the cut that made it refers to it
    pending: list[tuple[NDArray[np.intp], int, int, tuple[NDArray[np.int64], int] | None]] = [
        (np.arange(points.shape[1]), 0, count, None)
    ]
    num_cuts = 0
    while pending:
        chosen, first, num, parent = pending.pop()
        if parent is not None:
            parent[0][parent[1]] = ~first if num == 1 else num_cuts
        if num == 1:
            continue
        left = num // 2
        at, coordinate = _cut_of(points[:, chosen], weights[chosen], left / num)
        axis[num_cuts], cut[num_cuts] = at, coordinate
        upper[first : first + left, at] = coordinate
        lower[first + left : first + num, at] = coordinate
        is_below = points[at, chosen] < coordinate
        pending.append((chosen[~is_below], first + left, num - left, (above, num_cuts)))
        pending.append((chosen[is_below], first, left, (below, num_cuts)))
        num_cuts += 1
    return Regions(axis, cut, below, above, lower, upper)


def _cut_of(points: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> tuple[int, float]:
    """The axis and the coordinate of a cut below which this share of the weight lies."""
    total = float(weights.sum())
    if points.shape[1] == 0 or total <= 0.0:
        return 0, 0.0
    worlds = points[WORLD_AXIS]
    if worlds[0] != worlds.min() or worlds[0] != worlds.max():
        coordinate, is_below = _quantile(worlds, weights, share)
        if abs(float(weights[is_below].sum()) - share * total) <= _WORLD_SLACK * total:
            return WORLD_AXIS, coordinate
    low, high = np.quantile(points[:WORLD_AXIS], _EXTENT, axis=1)
    axis = int(np.argmax(high - low))
    return axis, _quantile(points[axis], weights, share)[0]


def _quantile(
    values: NDArray[np.float64], weights: NDArray[np.float64], share: float
) -> tuple[float, NDArray[np.bool_]]:
    """A coordinate between two of the values that has this share of the weight below it, and what is below it."""
    order = np.argsort(values, kind="stable")
    ordered, sums = values[order], np.cumsum(weights[order])
    # a cut is possible only where one value differs from the next
    steps = np.flatnonzero(ordered[1:] > ordered[:-1])
    if len(steps) == 0:
        return float(ordered[0]), np.zeros(len(values), dtype=bool)
    k = int(steps[np.argmin(np.abs(sums[steps] - share * sums[-1]))])
    middle = float(0.5 * ordered[k] + 0.5 * ordered[k + 1])
    coordinate = middle if ordered[k] < middle <= ordered[k + 1] else float(ordered[k + 1])
    return coordinate, values < coordinate


def regions_met(regions: Regions, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """The closed boxes that meet each region.

    Args:
        regions: The regions.
        lower: Lower corners, shape [4, n].
        upper: Upper corners, shape [4, n].

    Returns:
        For each region the indices of its boxes, ascending. A box stands in the list of a region once.
    """
    found: list[NDArray[np.intp]] = [np.zeros(0, dtype=np.intp)] * regions.count
    _descend(
        regions,
        np.arange(lower.shape[1]),
        lambda axis, cut, items: (lower[axis].take(items) < cut, upper[axis].take(items) >= cut),
        found,
    )
    return found


def region_of(regions: Regions, points: NDArray[np.float64]) -> NDArray[np.int32]:
    """The region of each point, int32, shape [n]; points have shape [4, n]."""
    found: list[NDArray[np.intp]] = [np.zeros(0, dtype=np.intp)] * regions.count

    def sides(axis: int, cut: float, items: NDArray[np.intp]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        is_below = points[axis].take(items) < cut
        return is_below, ~is_below

    _descend(regions, np.arange(points.shape[1]), sides, found)
    result = np.empty(points.shape[1], dtype=np.int32)
    for region, items in enumerate(found):
        result[items] = region
    return result


def _descend(regions, items, sides, found) -> None:  # type: ignore[no-untyped-def]
    """Divide items at every cut, by what ``sides`` says of them, down to the regions."""
    pending = [(0 if regions.count > 1 else ~0, items)]
    while pending:
        node, items = pending.pop()
        if node < 0:
            found[~node] = items
            continue
        is_below, is_above = sides(int(regions.axis[node]), float(regions.cut[node]), items)
        pending.append((int(regions.below[node]), items[is_below]))
        pending.append((int(regions.above[node]), items[is_above]))


def even_samples(count: int, most: int) -> NDArray[np.intp]:
    """Indices of at most ``most`` of ``count`` items, evenly spaced."""
    num = min(count, most)
    return (np.arange(num) * count) // max(num, 1)


def imbalance(work: Sequence[float] | NDArray[np.float64]) -> float:
    """The largest of some amounts of work in multiples of their mean; 1 where there is no work."""
    values = np.asarray(work, dtype=np.float64)
    mean = float(values.mean())
    return float(values.max()) / mean if mean > 0.0 else 1.0
