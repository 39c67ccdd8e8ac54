"""Regions of space, one a rank: recursive bisection, and which regions a box meets. Arrays alone, without MPI.

Points and boxes have four coordinates: three of space, and their world, so that worlds that occupy the same space are
different places. A cut divides a region into what lies below it and what lies at it or above it. So each region is
closed below and open above, every point lies in exactly one region, and the regions tile space: the whole is one
region, and a cut of a region into {x < c} and {x >= c} leaves no point out and puts none into both.

Coordinates come first in all arrays, shape [4, n], so that a cut reads one contiguous row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

DIMENSIONS = 4
WORLD_AXIS = 3
# How much more work than along the best axis the larger side may have: with a cut between worlds, which divides no box,
# and with one across the longest extent.
_WORLD_SLACK = 1.05
_SLACK = 1.01
# Quantiles between which the extent of the samples is measured, so that a few far away do not choose the axis.
_EXTENT = (0.02, 0.98)


@dataclass(frozen=True)
class Regions:
    """A binary tree of cuts, whose leaves are the regions in their order.

    Attributes:
        axis: Axis of each cut, int64, shape [P - 1].
        cut: Its coordinate, float64, shape [P - 1].
        below: What lies below a cut: the number of another cut, or ~r of region r, int64, shape [P - 1].
        above: What lies at a cut or above it: another cut, or ~r of region r, int64, shape [P - 1].
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


def bisected(
    lower: NDArray[np.float64],
    weights: NDArray[np.float64],
    count: int,
    upper: NDArray[np.float64] | None = None,
    ghost_weights: NDArray[np.float64] | None = None,
) -> Regions:
    """Cut space into regions of nearly equal work.

    A box that a cut divides goes to both sides. It is counted in full below the cut, where its lower corner is, and
    above it as what a primitive costs that is there as a ghost. So regions into which many boxes reach are smaller, and
    of the axes that is cut along which the larger side has the least to do.

    Args:
        lower: Lower corners of sampled boxes, shape [4, n].
        weights: The work that each of them stands for, shape [n].
        count: Number of regions; it need not be a power of two.
        upper: Upper corners; those of points by default.
        ghost_weights: The part of the work that is done wherever the box is, shape [n]; by default all.

    Returns:
        The regions. Where there are fewer samples than regions, some are empty.
    """
    upper = lower if upper is None else upper
    ghost_weights = weights if ghost_weights is None else ghost_weights
    low, high = np.full((count, DIMENSIONS), -np.inf), np.full((count, DIMENSIONS), np.inf)
    axis, cut = np.zeros(count - 1, dtype=np.int64), np.zeros(count - 1)
    below, above = np.zeros(count - 1, dtype=np.int64), np.zeros(count - 1, dtype=np.int64)
    # samples of a part, what each weighs there, its first region, their number, and where the cut that made it refers
    # to it
    everything = np.arange(lower.shape[1])
    pending: list[tuple[Any, Any, int, int, Any]] = [(everything, weights, 0, count, None)]
    num_cuts = 0
    while pending:
        boxes, work, first, num, parent = pending.pop()
        if parent is not None:
            parent[0][parent[1]] = ~first if num == 1 else num_cuts
        if num == 1:
            continue
        left = num // 2
        # what reaches in from below counts where it enters
        begins = np.maximum(lower[:, boxes], low[first][:, None])
        ends = upper[:, boxes]
        of_ghosts = np.minimum(ghost_weights[boxes], work)
        at, coordinate = _best_cut(begins, ends, work, of_ghosts, left / num)
        axis[num_cuts], cut[num_cuts] = at, coordinate
        high[first : first + left, at] = coordinate
        low[first + left : first + num, at] = coordinate
        is_below = begins[at] < coordinate
        is_above = ends[at] >= coordinate
        work_above = np.where(is_below, of_ghosts, work)[is_above]
        pending.append((boxes[is_above], work_above, first + left, num - left, (above, num_cuts)))
        pending.append((boxes[is_below], work[is_below], first, left, (below, num_cuts)))
        num_cuts += 1
    return Regions(axis, cut, below, above, low, high)


def _best_cut(
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    weights: NDArray[np.float64],
    ghost_weights: NDArray[np.float64],
    share: float,
) -> tuple[int, float]:
    """The axis and the coordinate of a cut below which this share of the work lies."""
    if lower.shape[1] == 0:
        return 0, 0.0
    cuts = [_cut_along(lower[k], upper[k], weights, ghost_weights, share) for k in range(DIMENSIONS)]
    load, coordinate = cuts[WORLD_AXIS]
    best = min(load for load, _ in cuts)
    if load <= _WORLD_SLACK * best:
        return WORLD_AXIS, coordinate
    low, high = np.quantile(0.5 * lower[:WORLD_AXIS], _EXTENT, axis=1)  # of halves, whose difference is a number
    good = [k for k in range(WORLD_AXIS) if cuts[k][0] <= _SLACK * best] or [0]
    axis = max(good, key=lambda k: float(high[k] - low[k]))
    return axis, cuts[axis][1]


def _cut_along(
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    weights: NDArray[np.float64],
    ghost_weights: NDArray[np.float64],
    share: float,
) -> tuple[float, float]:
    """The best cut of an axis: the work of the side that has more of it for its share, and the coordinate."""
    order = np.argsort(lower, kind="stable")
    begins = lower[order]
    # a cut is possible only where one value differs from the next
    steps = np.flatnonzero(begins[1:] > begins[:-1])
    if len(steps) == 0:
        return np.inf, float(begins[0])
    middle = 0.5 * begins[steps] + 0.5 * begins[steps + 1]
    cuts = np.where((begins[steps] < middle) & (middle <= begins[steps + 1]), middle, begins[steps + 1])
    work_below = np.cumsum(weights[order])
    ghosts_begun = np.cumsum(ghost_weights[order])
    by_end = np.argsort(upper, kind="stable")
    ghosts_ended = np.concatenate([[0.0], np.cumsum(ghost_weights[by_end])])
    divided = ghosts_begun[steps] - ghosts_ended[np.searchsorted(upper[by_end], cuts, side="left")]
    load = np.maximum(work_below[steps] / share, (work_below[-1] - work_below[steps] + divided) / (1.0 - share))
    k = int(np.argmin(load))
    return float(load[k]), float(cuts[k])


def regions_met(regions: Regions, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """The closed boxes that meet each region.

    Args:
        regions: The regions.
        lower: Lower corners, shape [4, n].
        upper: Upper corners, shape [4, n].

    Returns:
        For each region the indices of its boxes, ascending. A box stands in the list of a region once.
    """
    boxes_by_region: list[NDArray[np.intp]] = [np.zeros(0, dtype=np.intp)] * regions.count
    _descend(
        regions,
        np.arange(lower.shape[1]),
        lambda axis, cut, items: (lower[axis].take(items) < cut, upper[axis].take(items) >= cut),
        boxes_by_region,
    )
    return boxes_by_region


def region_of(regions: Regions, points: NDArray[np.float64]) -> NDArray[np.int32]:
    """The region of each point, int32, shape [n]; points have shape [4, n]."""
    points_by_region: list[NDArray[np.intp]] = [np.zeros(0, dtype=np.intp)] * regions.count

    def sides(axis: int, cut: float, items: NDArray[np.intp]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        is_below = points[axis].take(items) < cut
        return is_below, ~is_below

    _descend(regions, np.arange(points.shape[1]), sides, points_by_region)
    result = np.empty(points.shape[1], dtype=np.int32)
    for region, items in enumerate(points_by_region):
        result[items] = region
    return result


def _descend(
    regions: Regions,
    items: NDArray[np.intp],
    sides: Callable[[int, float, NDArray[np.intp]], tuple[NDArray[np.bool_], NDArray[np.bool_]]],
    items_by_region: list[NDArray[np.intp]],
) -> None:
    """Divide items at every cut, by what ``sides`` says of them, down to the regions."""
    pending = [(0 if regions.count > 1 else ~0, items)]
    while pending:
        node, items = pending.pop()
        if node < 0:
            items_by_region[~node] = items
            continue
        is_below, is_above = sides(int(regions.axis[node]), float(regions.cut[node]), items)
        pending.append((int(regions.below[node]), items[is_below]))
        pending.append((int(regions.above[node]), items[is_above]))


def assigned(regions: Regions, work: NDArray[np.float64]) -> Regions:
    """The regions in an order such that each rank gets one of which it holds much already.

    Args:
        regions: The regions.
        work: What each rank holds of each region, shape [ranks, regions].
    """
    count = regions.count
    rank_of_region = np.full(count, -1, dtype=np.int64)
    has_region = np.zeros(count, dtype=bool)
    # the pairs of a rank and a region are as many as the square of the ranks, and few hold anything
    places = np.flatnonzero(work)
    for place in places[np.argsort(-work.ravel()[places], kind="stable")].tolist():
        rank, region = divmod(place, count)
        if rank_of_region[region] < 0 and not has_region[rank]:
            rank_of_region[region], has_region[rank] = rank, True
    rank_of_region[rank_of_region < 0] = np.flatnonzero(~has_region)
    sides = [
        np.where(side < 0, ~rank_of_region[np.where(side < 0, ~side, 0)], side)
        for side in (regions.below, regions.above)
    ]
    lower, upper = np.empty_like(regions.lower), np.empty_like(regions.upper)
    lower[rank_of_region], upper[rank_of_region] = regions.lower, regions.upper
    return Regions(regions.axis, regions.cut, sides[0], sides[1], lower, upper)


def even_samples(count: int, most: int) -> NDArray[np.intp]:
    """Indices of at most ``most`` of ``count`` items, evenly spaced."""
    num = min(count, most)
    return (np.arange(num) * count) // max(num, 1)


def imbalance(work: Sequence[float] | NDArray[np.float64]) -> float:
    """The largest of some amounts of work in multiples of their mean; 1 where there is no work."""
    values = np.asarray(work, dtype=np.float64)
    mean = float(values.mean())
    return float(values.max()) / mean if mean > 0.0 else 1.0
