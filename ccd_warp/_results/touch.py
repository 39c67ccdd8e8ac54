"""What counts as touching in a step: the distance of a pair and its norm."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.pairs import radii_of_pairs
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True, eq=False)
class Touch:
    """What counts as touching.

    Attributes:
        is_euclidean: Whether the distance is Euclidean, not one in the maximum norm.
        separation: The minimum distance or separation, a length; or a multiple of the size of each pair.
        t_max: End of the step.
        start_gap_share: The fraction of its start gap that a pair keeps at most; 0 where it keeps its separation.
        is_by_size: Whether the separation is a multiple of the size of each pair.
        radius: Radius of each vertex, shape [V]; None where there are none.
        tolerance: The tolerance as a length; without a length scale 0.
    """

    is_euclidean: bool
    separation: float
    t_max: float
    start_gap_share: float
    is_by_size: bool = False
    radius: NDArray[np.float64] | None = None
    tolerance: float = 0.0

    @classmethod
    def of(
        cls,
        options: Options,
        length_scale: float | None,
        *,
        is_euclidean: bool,
        radius: NDArray[np.float64] | None = None,
    ) -> "Touch":
        """Of a call with these options; without a length scale each pair has its own."""
        is_by_size = length_scale is None and not is_euclidean
        separation = options.minimum_separation if is_by_size else options.separation(length_scale or 0.0)
        tolerance = options.tolerance * (length_scale or 0.0)
        return cls(is_euclidean, separation, options.t_max, options.start_gap_share, is_by_size, radius, tolerance)

    def query(self, *, is_planar: bool) -> Any:
        """It as the struct of the kernels.

        Raises:
            ValueError: If the distance of a pair follows from its start.
        """
        from ccd_warp.kernels.gradients import toi_slope  # loaded by those who ask for gradients
        from ccd_warp.kernels.step import pair_gap

        if self.start_gap_share > 0.0:
            raise ValueError(
                f"start_gap_fraction is {self.start_gap_share}; expected 'hold' or None for gradients, as otherwise "
                "the distance of a pair changes with its start"
            )
        query = toi_slope.Query()
        query.norm = int(pair_gap.BALL if self.is_euclidean else pair_gap.BOX)
        query.separation, query.by_size = self.separation, int(self.is_by_size)
        query.is_planar, query.t_max = int(is_planar), self.t_max
        return query

    def distances(
        self, mesh: CollisionMesh, kind: NDArray[np.int32], vertices: NDArray[np.int32]
    ) -> NDArray[np.float64] | None:
        """The distance of each pair with these vertices; None where all have one."""
        if self.radius is None:
            return None
        radii = radii_of_pairs(kind, vertices, self.radius, mesh._largest_around(self.radius))
        return self.separation + (radii[:, 0] + radii[:, 1])
