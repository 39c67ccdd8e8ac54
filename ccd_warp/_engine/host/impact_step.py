"""What both goals that solve pairs for their times of impact share: the distance of pairs, and what kernels read."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.mesh.lengths import half_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.motion import Slice

if TYPE_CHECKING:
    from ccd_warp.kernels.pair.turns import Turns


class ImpactStep(HostStep):
    """A step whose pairs are solved for their times of impact.

    Attributes:
        lets_part: Whether what starts within its distance may part and slide.
        start_distances: How near each vertex was to anything at the start, on the device; None where none keeps that.
        among: Vertices of which a pair has at least one whose contacts are wanted; None where those of all are.
    """

    is_for_impacts, lets_part = True, False
    stages = "input", "boxes", "pairs", "narrow phase"
    stages_with_planes = "input", "boxes", "pairs", "planes", "narrow phase"
    among: NDArray[np.bool_] | None = None
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
            if self.options.precision != "float64":
                self.options = replace(self.options, precision="float64")
            self.workspace.start_distances.write(start_distances.ravel())
            self.start_distances = self.workspace.start_distances.array
        return self

    def played_whole(self) -> Batch | None:
        """All pairs of a step whose stages are played as one section (`HostStep.played_whole`)."""
        batch = super().played_whole()
        if batch is not None:
            self.oddities.note_pairs(self.plan, sum(self.survivors.values()), batch.num_pairs)
        return batch

    def plays_whole(self, plan: HostPlan) -> bool:
        """Whether a step of one slice is played as a whole."""
        return plan.has_fitted and not plan.sampled_pairs

    def set_extent(self) -> None:
        """Let boxes of pairs within their distance overlap, until the end of the motion."""
        plan, options, self.t_end = self.plan, self.options, self.motion.t_end
        if plan.lengths[0] is not options:
            length_scale = length_scale_of(self.mesh, options)
            separation = options.separation(length_scale)
            plan.lengths = options, length_scale, separation, half_rounded_up(separation)
        _, self.length_scale, self.separation, self.inflation = plan.lengths
        if self.separation > 0.0 or self.mesh.is_thick:
            self._note_distance()

    def _note_distance(self) -> None:
        """Note the distance of pairs, if it is many edges long."""
        x, rings = self.positions[0], self.mesh.exclusion_rings
        self.far_distance = DistanceInEdges.of(self.topology, x, self.separation, rings=rings)
        self.oddities.distance = self.oddities.distance or self.far_distance

    def is_idle(self) -> bool:
        """Whether there is nothing to search; the memory limit and the stages are then those of any other slice."""
        if not self.plan.is_idle or self.planes is not None:
            return False
        self.capacity()
        for stage in ("pairs", "narrow phase"):
            self.timings.setdefault(stage, 0.0)
        return True

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels have the options, how bodies turn in a slice, and what half-spaces are asked for."""
        turns = self.motion.turns(time_slice)
        # the arrays of how bodies turn are the same for all slices and steps
        key = self.options, self.length_scale, self.start_distances is not None, turns is not None
        if key != self.plan.of_options:
            self.plan.bind(options=self.workspace.packed_once(key, lambda: self._packed(turns)), turns=turns)
            self.plan.of_options = key
        if self.planes is not None:
            self.planes.bind(self.options, self.length_scale, time_slice.active, lets_part=self.lets_part)

    def _packed(self, turns: "Turns | None" = None) -> Any:
        """The options as a struct of the kernels, and how bodies turn."""
        return self.options.for_kernel(
            self.length_scale,
            stop=self.workspace.flag.array,
            radius=self.topology.radius,
            start_distances=self.start_distances,
            turns=turns,
        )
