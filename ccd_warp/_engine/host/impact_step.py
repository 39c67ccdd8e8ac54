"""What both goals that solve pairs for their times of impact share: the distance of pairs, and what kernels read."""

import time
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.step import Step
from ccd_warp._engine.mesh.lengths import half_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.motion import Slice


@dataclass(frozen=True)
class _AtOnce:
    """What the steps with the same options share that :meth:`ImpactStep.found_at_once` makes."""

    plan: HostPlan
    t_end: float
    length_scale: float
    separation: float
    inflation: float
    most_pairs: int
    packed: Any  # the options


class ImpactStep(Step):
    """A step whose pairs are solved for their times of impact.

    Attributes:
        lets_part: Whether what starts within its distance may part and slide.
        start_distances: How near each vertex was to anything at the start, on the device; None where none keeps that.
        far_distance: The distance of pairs, if it is many edges long.
        among: Vertices of which a pair has at least one whose contacts are wanted; None where those of all are.
    """

    is_for_impacts, lets_part = True, False
    among: NDArray[np.bool_] | None = None
    start_distances: wp.array | None = None
    far_distance: DistanceInEdges | None = None

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
            self.start_distances.assign(start_distances.ravel())
        return self

    def found_at_once(self) -> Batch | None:
        """All pairs of a step of one slice, in one process, without half-spaces and a limit of memory, on the CPU.

        This plays what :meth:`begin_slice`, :meth:`bind_options` and :meth:`HostPlan.batches` do, with what stays the
        same from step to step: in a small scene that would take longer than the kernels.

        Returns:
            The pairs; None if the step is another one, or if they do not fit the memory, and nothing has been done.
        """
        if self.start_distances is not None or not self.ranks.is_alone:
            return None
        turns = self.paths is not None
        if turns and len(self.motion.slices) > 1:
            return None
        shared = self.workspace.packed_once((self.goal, self.options, self.options.threads, turns), self._at_once)
        if shared is None or shared.plan.is_divided:
            return None
        begin = time.perf_counter()
        self.plan = plan = shared.plan
        self.execution, self.planes = plan.execution, None
        if turns:
            self._active = self.motion.slices[0].active
            self.positions = self.motion.placed(self.motion.slices[0], self.execution)
        self.length_scale, self.separation, self.inflation = shared.length_scale, shared.separation, shared.inflation
        plan.begin_counts()
        if self.separation > 0.0 or self.mesh.is_thick:
            self._note_distance()
            if self.far_distance is not None:
                return None
        near = self._bodies_near()
        if self._step_before is shared and plan.is_repeatable:
            plan.fill_boxes_again(self.positions, self.workspace.active(near))
        else:
            plan.set_positions(self.positions)
            if near is not None and not near.any():
                plan.skip_boxes()
            else:
                plan.fill_boxes(self.positions, shared.t_end, self.inflation, self.workspace.active(near))
            plan.bind(options=shared.packed)
            plan.set_search(shared.t_end, self.inflation, self.separation)
        boxes_end = time.perf_counter()
        self.reset(plan)
        batch = plan.search(shared.most_pairs, among=self.among)
        if batch is not None:
            self.survivors |= batch.num_pairs
            self.workspace.last_step = None if plan.is_idle else shared
            self.timings |= {"boxes": boxes_end - begin, "pairs": time.perf_counter() - boxes_end, "narrow phase": 0.0}
        return batch

    def _at_once(self) -> _AtOnce | None:
        """What is the same in all steps with these options; None if the pairs of none are found at once."""
        plan = HostPlan.of(self.workspace, self.options, self.goal, self.norm(), self.motion)
        is_sampled = self.goal == "bound" and self.topology.samples_queries
        if plan.execution.is_cuda or plan.has_planes or is_sampled or self.options.memory_limit is not None:
            return None
        length_scale = length_scale_of(self.mesh, self.options)
        separation = self.options.separation(length_scale)
        self.plan, self.length_scale = plan, length_scale
        turns = self.motion.turns(self.motion.slices[0])
        plan.bind(turns=turns)
        inflation, packed = half_rounded_up(separation), self._packed(turns)
        return _AtOnce(plan, self.motion.t_end, length_scale, separation, inflation, self.capacity(), packed)

    def reset(self, plan: HostPlan) -> None:
        """Forget what earlier steps have found, before a search."""

    def begin_slice(self, part: Slice) -> HostPlan:
        """Compute the boxes of a slice, or of the whole step, in which pairs within their distance overlap."""
        return self.begin(self.motion.t_end, self._inflation, part)

    def _inflation(self) -> float:
        self.length_scale = length_scale_of(self.mesh, self.options)
        self.separation = self.options.separation(self.length_scale)
        self._note_distance()
        return half_rounded_up(self.separation)

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

    def bind_options(self, part: Slice) -> None:
        """Let the kernels have the options, how bodies turn in a slice, and what half-spaces are asked for."""
        turns = self.motion.turns(part)
        key = self.options, self.length_scale, self.start_distances is not None, turns is not None
        # the arrays of how bodies turn are the same for all slices and steps
        packed = self.workspace.packed_once(key, lambda: self._packed(turns))
        self.plan.bind(options=packed, turns=turns)
        if self.planes is not None:
            self.planes.bind(self.options, self.length_scale, part.active, lets_part=self.lets_part)

    def _packed(self, turns: Any = None) -> Any:
        """The options as a struct of the kernels, and how bodies turn."""
        return self.options.for_kernel(
            self.length_scale,
            stop=self.workspace.flag.array,
            radius=self.topology.radius,
            start_distances=self.start_distances,
            turns=turns,
        )
