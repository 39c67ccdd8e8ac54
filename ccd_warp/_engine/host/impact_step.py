"""What both goals that solve pairs for their times of impact share: the distance of pairs, and what kernels read."""

from dataclasses import replace
from typing import Self

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
        holds: Whether what starts within its distance may part and slide.
        far_distance: The distance of pairs, if it is many edges long.
    """

    holds = False

    def holding(self, hold: NDArray[np.float64] | None = None) -> Self:
        """This step, in which what starts within its distance may part and slide.

        Args:
            hold: How near each vertex was to anything at the start (`HoldStep`); None as long as it is not known that a
                pair of surfaces starts within its distance. The pairs are then solved in float64, as the margin of
                float32 would be lost anew in each step.
        """
        self.holds, self.is_held = True, hold is not None
        if hold is not None:
            self.options = replace(self.options, precision="float64")
            self.workspace.hold.assign(hold)
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
        plan, workspace, turns = self.plan, self.workspace, self.motion.turns(part)
        packed = workspace.packed(self.options, self.length_scale, is_held=self.is_held, turns=turns)
        plan.bind(options=packed, turns=turns)
        if self.planes is not None:
            query = workspace.plane_query(self.options, self.length_scale, holds=self.holds)
            active = self.motion.active
            plan.bind(plane_query=query, searched=None if active is None else self.topology.array(active, wp.int32))
