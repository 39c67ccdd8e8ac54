"""What a plan says of boxes: where they may be while it is kept, and to which ranks primitives go. Without MPI."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.mesh.topology import LARGEST_EXPONENT, LARGEST_ORIGIN
from ccd_warp.distributed._partition import WORLD_AXIS, Regions, regions_met

# Steps for which a vertex may go on as it moves in the step for which a plan is made.
_STEPS_AHEAD = 3.0
# A plan's boxes are this much larger on every side than the boxes of its first step, in mean extents of a primitive, or
# where all are points in mean distances of those that fill the box of the scene.
_MARGIN = 0.5
# Two coordinates that are equal in quantized coordinates (float32 with a scale, shifted by a world) differ by less than
# this, relative to their distance from the origin and to the size of the scene: eight times what rounding can do.
_RESOLUTION = 2.0**-20


@dataclass(frozen=True)
class Bounds:
    """The numbers from which the boxes of a plan follow, the same on all ranks.

    Attributes:
        margin: Enlargement of a box beside its inflation, a length.
        inflation: Enlargement that a step asks for: half of the largest separation, or that of find_candidates.
        centre: Of the scene, shape [3].
        size: Of the scene, a length, in the quantized coordinates that its worlds share.
    """

    margin: float
    inflation: float
    centre: NDArray[np.float64]
    size: float

    @staticmethod
    def of(
        mean_extent: float,
        inflation: float,
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        num_worlds: int = 1,
        num_vertices: int = 1,
    ) -> "Bounds":
        """The bounds of a plan for a scene in a box, `scene_box`, whose edges or faces have this mean extent."""
        with np.errstate(over="ignore", invalid="ignore"):
            centre = np.nan_to_num(0.5 * lower + 0.5 * upper)
            size = min(float(np.nan_to_num(upper - lower, nan=0.0).max(initial=0.0)), np.finfo(np.float64).max)
            if mean_extent == 0.0:
                mean_extent = size / max(num_vertices, 1) ** (1.0 / 3.0)
            # the quantization has a least scale and a largest origin, which may be farther away than the scene is large
            size += max(float((np.abs(centre) - LARGEST_ORIGIN).max()), 2.0**-LARGEST_EXPONENT)
            size = min(size * 2.0 ** (num_worlds - 1).bit_length(), np.finfo(np.float64).max)
            # an inflation that grows a little, as that of a separation does with rounding, needs no new plan
            return Bounds(_MARGIN * mean_extent, 1.0001 * inflation, centre, size)

    def boxes(
        self,
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        worlds: NDArray[np.integer],
        radius: NDArray[np.float64] | float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The box of each vertex while the plan is kept, shapes [4, n].

        It holds the motion of this step and of some more in its direction, and all that is equal to it in quantized
        coordinates; it is enlarged by ``radius``, the largest of the primitives around each vertex. Every rank gets the
        same bits from the same positions.
        """
        lower, upper = np.empty((4, len(start))), np.empty((4, len(start)))
        lower[WORLD_AXIS] = upper[WORLD_AXIS] = worlds
        fixed = self.margin + _enlarged(self.inflation) + _RESOLUTION * self.size
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(3):
                a, b = np.ascontiguousarray(start[:, k]), np.ascontiguousarray(end[:, k])
                ahead = b + _STEPS_AHEAD * (b - a)
                slack = np.maximum(np.abs(a - self.centre[k]), np.abs(b - self.centre[k]))
                slack *= _RESOLUTION
                slack += fixed
                slack += _enlarged(radius)
                low, high = np.minimum(a, b), np.maximum(a, b)
                lower[k] = np.nextafter(np.minimum(low, ahead) - slack, -np.inf)
                upper[k] = np.nextafter(np.maximum(high, ahead) + slack, np.inf)
        return lower, upper

    def limits(
        self, lower: NDArray[np.float64], upper: NDArray[np.float64], radius: NDArray[np.float64] | float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Limits of the positions of vertices, shapes [n, 3], given their boxes in a plan.

        A vertex that stays within them has a box, with what it is enlarged by, within that of the plan: the slack by
        distance is that of the farthest corner.
        """
        fixed = _enlarged(self.inflation) + _RESOLUTION * self.size
        low, high = np.empty((lower.shape[1], 3)), np.empty((lower.shape[1], 3))
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(3):
                slack = np.maximum(np.abs(lower[k] - self.centre[k]), np.abs(upper[k] - self.centre[k]))
                slack = slack * _RESOLUTION + fixed + _enlarged(radius)
                low[:, k] = np.nan_to_num(lower[k] + slack, nan=np.inf)
                high[:, k] = np.nan_to_num(upper[k] - slack, nan=-np.inf)
        return low, high


def _enlarged(length: Any) -> Any:
    """By how much more than a length a box may be enlarged in quantized coordinates, where it is rounded, too."""
    return (1.0 + _RESOLUTION) * length


def is_within(positions: NDArray[np.float64], limits: tuple[NDArray[np.float64], NDArray[np.float64]]) -> bool:
    """Whether no coordinate is beyond its limits, between which one that is not a number is."""
    lower, upper = limits
    return not ((positions < lower).any() or (positions > upper).any())


def scene_box(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A box around all positions of a step and of those after it that a plan expects, shapes [3]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    with np.errstate(over="ignore"):
        for x in (start, end, end + _STEPS_AHEAD * (end - start)):
            lower, upper = (
                np.minimum(lower, x.min(axis=0, initial=np.inf)),
                np.maximum(upper, x.max(axis=0, initial=-np.inf)),
            )
    return lower, upper


def united(
    lower: NDArray[np.float64], upper: NDArray[np.float64], corners: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box of each primitive: that around the boxes of its vertices; corners have shape [n, 1 to 3]."""
    low, high = lower.take(corners[:, 0], axis=1), upper.take(corners[:, 0], axis=1)
    for k in range(1, corners.shape[1]):
        np.minimum(low, lower.take(corners[:, k], axis=1), out=low)
        np.maximum(high, upper.take(corners[:, k], axis=1), out=high)
    return low, high


def destinations(
    regions: Regions, lower: NDArray[np.float64], upper: NDArray[np.float64], corners: Mapping[str, NDArray[np.int64]]
) -> dict[str, list[NDArray[np.intp]]]:
    """For each kind of primitive and each region the primitives whose boxes meet it, given the boxes of vertices.

    A pair belongs to the region of the lower corner of the intersection of the boxes of its two primitives. The corner
    lies in both boxes, so both are sent there; it lies in one region alone, so nobody else counts the pair.
    """
    return {kind: regions_met(regions, *united(lower, upper, c)) for kind, c in corners.items()}


def axes_below(lower: NDArray[np.float64], region_lower: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The axes along which each box begins below a region, as the bits of a number, given their lower corners [4, n].

    The corner of an intersection is the larger of two lower corners. So a pair of boxes that meet a region belongs to
    it unless both begin below it along the same axis.
    """
    bits = np.zeros(lower.shape[1], dtype=np.uint8)
    for k, least in enumerate(region_lower):
        bits |= (lower[k] < least).astype(np.uint8) << k
    return bits


def used_rows(num_rows: int, corners: list[NDArray[np.integer]]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """The rows that some primitives use, ascending, and the place of each row among them."""
    is_used = np.zeros(num_rows, dtype=bool)
    for c in corners:
        is_used[c] = True
    rows = np.flatnonzero(is_used)
    place = np.cumsum(is_used, dtype=np.int64) - 1
    return rows, place
