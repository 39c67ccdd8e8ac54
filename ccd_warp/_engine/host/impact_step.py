"""What both goals that solve pairs for their times of impact share: the distance of pairs, and what kernels read."""

from dataclasses import replace
from typing import Any, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.plan import HostPlan
from ccd_warp._engine.host.step import Step
from ccd_warp._engine.mesh.lengths import half_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.motion import Slice


class ImpactStep(Step):
    """A step whose pairs are solved for their times of impact.

    Attributes:
        lets_part: Whether what starts within its distance may part and slide.
        start_distances: How near each vertex was to anything at the start, on the device; None where none keeps that.
        far_distance: The distance of pairs, if it is many edges long.
    """

    lets_part = False
    start_distances: wp.array | None = None

    def parting(self, start_distances: NDArray[np.float64] | None = None) -> Self:
        """This step, in which what starts within its distance may part and slide, if the options let it.

        Args:
            start_distances: How near each vertex was to anything at the start (`StartDistances`); None as long as it is
                not known that a pair of surfaces starts within its distance. The pairs are then solved in float64, as
                the margin of float32 would be lost anew in each step.
        """
        self.lets_part = self.options.keeps_start_distances
        if start_distances is not None:
            self.options = replace(self.options, precision="float64")
            self.start_distances = self.workspace.start_distances
            self.start_distances.assign(start_distances)
        return self

    def begin_slice(self, part: Slice) -> HostPlan:
        """Compute the boxes of a slice, or of the whole step, in which pairs within their distance overlap."""
        return self.begin(self.motion.t_end, self._inflation, part)

    def _inflation(self) -> float:
        self.length_scale = length_scale_of(self.mesh, self.options)
        self.separation = self.options.separation(self.length_scale)
        x, rings = self.positions[0], self.mesh.exclusion_rings
        self.far_distance = DistanceInEdges.of(self.topology, x, self.separation, rings=rings)
        self.oddities.distance = self.oddities.distance or self.far_distance
        return half_rounded_up(self.separation)

    def is_idle(self) -> bool:
        """Whether there is nothing to search; the memory limit and the stages are then those of any other slice."""
        if not self.plan.is_idle or self.planes is not None:
            return False
        self.capacity()
        for stage in ("pairs", "narrow phase"):
            self.timings.setdefault(stage, 0.0)
        return True

    def bind_options(self, part: Slice) -> None:
        """Let the kernels have the options, how bodies turn in a slice, and what half-spaces are asked for."""
        turns = self.motion.turns(part)
        key = self.options, self.length_scale, self.start_distances is not None
        # those of a slice in which bodies turn are packed for it alone
        packed = self.workspace.packed_once(key, self._packed) if turns is None else self._packed(turns)
        self.plan.bind(options=packed, turns=turns)
        if self.planes is not None:
            self.planes.bind(self.options, self.length_scale, self.motion.active, lets_part=self.lets_part)

    def _packed(self, turns: Any = None) -> Any:
        """The options as a struct of the kernels, and how bodies turn."""
        return self.options.for_kernel(
            self.length_scale,
            stop=self.workspace.flag.array,
            radius=self.topology.radius,
            start_distances=self.start_distances,
            turns=turns,
        )
