"""What every goal of a step on the host shares: its boxes, batches of pairs, memory, counts and timings."""

from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.host.oddities import DistanceInEdges, Oddities
from ccd_warp._engine.host.plan import NO_PAIRS, Batch, HostPlan
from ccd_warp._engine.host.plane_stage import PlaneStage
from ccd_warp._engine.host.stage_timer import StageTimer
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.scene import norm_of
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.motion import Motion, Slice, StepPaths
from ccd_warp._engine.plan import Goal
from ccd_warp._engine.stages import Stages
from ccd_warp._results.results import Counts
from ccd_warp._runtime.launch import Recording
from ccd_warp._runtime.quick import of_values
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.options import Options
from ccd_warp.kernels.pair.norm import Norm

# Memory for pairs where the user sets no limit.
_DEFAULT_PAIR_BYTES = 1 << 30
_LEAST_KEYS = 1 << 12


class HostStep:
    """A step on the host.

    Attributes:
        goal: What it looks for.
        result_bytes: Bytes that a pair takes for what is found of it, besides what its search takes.
        plan: What is searched, from `begin` on.
        planes: The stage in which vertices meet half-spaces; None in scenes without.
        motion: How vertices move, and in which slices the step is searched.
        vertices_t0: Positions at the start, on the device.
        separation: The distance within which pairs are searched.
        inflation: By how much boxes grow.
        t_end: The end of the boxes of a slice, as a fraction of the way between the positions at its ends.
        far_distance: The distance of pairs, if it is many edges long.
        stages: The names of the stages of a step that is played whole, in their order.
        stages_with_planes: The same with half-spaces.
        survivors: Pairs that the search has left, by kind.
        counts: What the step has done, from `finish` on.
        timings: Seconds of its stages.
        counts_survivors: Whether its counts have them.
        is_for_impacts: Whether what does not touch in the step is of no interest.
        oddities: What is odd about it, which is said at its end.
    """

    goal: Goal
    motion: Motion
    result_bytes = 0
    separation = inflation = 0.0
    t_end = 1.0
    far_distance: DistanceInEdges | None = None
    stages: tuple[str, ...] = ("input", "boxes", "pairs")
    stages_with_planes = stages
    counts_survivors = is_for_impacts = _has_boxes = False
    _active: NDArray[np.bool_] | None = None
    counts = Counts()

    def __init__(
        self,
        workspace: Workspace,
        positions: Positions,
        options: Options,
        paths: StepPaths | None = None,
    ) -> None:
        """Begin a step.

        Args:
            workspace: What stays from step to step.
            positions: Positions at both ends; of bodies on paths in their own frames.
            options: The options.
            paths: Paths of bodies that turn, where there are any.
        """
        self.workspace, self.options = workspace, options
        self.topology, self.mesh = workspace.topology, workspace.topology.mesh
        self.positions = self.ends = positions
        self.paths = paths
        if paths is None:
            t_max = options.t_max
            self.motion = workspace.packed_once(("straight", t_max), lambda: Motion(self.topology, t_max))
        else:
            self.motion = paths.begin(workspace, positions, options, for_impacts=self.is_for_impacts)
        self.timer = StageTimer(self.topology.device, workspace.unused_events)
        self.timed, self.timings = self.timer.timed, self.timer.seconds
        self.survivors = dict(NO_PAIRS)
        self.oddities = Oddities()
        self._num_active_bodies = self.mesh.num_bodies

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        if error is None or issubclass(error, Exception):  # a warning that is an error would hide an interrupt
            self.oddities.explain(self.workspace, self.positions, self.options)

    def norm(self) -> Norm:
        """The norm of separations (``kernels.pair.norm``)."""
        return norm_of(self.mesh, self.options, on_arcs=self.motion.on_arcs)

    def begin(self, time_slice: Slice | None = None) -> HostPlan:
        """Compute the boxes of a slice, or of the whole step; a body that none comes near costs only its own box."""
        with self.timed("input"):
            plan = self.plan_of_step()
            self.begin_plan(plan, time_slice)
        with self.timed("boxes"):
            if self.begin_boxes(self._bodies_near()):
                plan.fill_boxes()
        return plan

    def played_whole(self) -> Batch | None:
        """All pairs of a step of one slice without a limit of memory, of which all stages are played as one section.

        Returns:
            The pairs, of which all is found but what a second round of a bound finds; None if nothing has been done,
            and the step is to be played section by section.
        """
        if self.options.memory_limit is not None or len(self.motion.slices) > 1:
            return None
        plan, time_slice = self.plan_of_step(), self.motion.slices[0]
        if not self.plays_whole(plan):
            return None
        now = plan.now = self.timer.now
        begin = now()
        self.begin_plan(plan, time_slice)
        if self.far_distance is not None:
            return None
        moments = [begin, now()]
        self.begin_boxes(None if plan.near_bodies else self._bodies_near())
        self.bind_options(time_slice)
        plan.set_search(self.t_end, self.inflation, self.separation)
        batch = plan.play_step(self.capacity(), self.begin_found, self.fits, self.record_found)
        if batch is not None:
            self.timer.add(self.stages_with_planes if plan.has_planes else self.stages, moments + plan.marks)
            self.survivors |= batch.num_pairs
            if plan.near_bodies:
                self._num_active_bodies = plan.note_bodies_near()
            if self.planes is not None:
                self.survivors[PairKind.VERTEX_PLANE] = self.planes.count()
        return batch

    def plays_whole(self, plan: HostPlan) -> bool:
        """Whether a step of one slice is played as a whole: where all that the last step of the plan found did fit."""
        return plan.has_fitted

    def set_extent(self) -> None:
        """Choose where the boxes of a slice end and by how much they grow, when its positions are known."""

    def bind_options(self, time_slice: Slice) -> None:
        """Let the kernels have what a slice is asked for."""

    def begin_found(self) -> None:
        """Begin what is found of the pairs, before a whole step is played."""
        self.plan.counters.clear()

    def fits(self) -> bool:
        """Whether there was a place for all of it."""
        return True

    def record_found(self, stages: Stages, recording: Recording) -> None:
        """Record what follows the search in a whole step of a goal without a narrow phase."""

    def plan_of_step(self) -> HostPlan:
        """The plan: that of the last step with this goal, where nothing that it depends on has changed."""
        of_step, last_plans = (self.options, self.motion, self.options.threads), self.workspace.last_plans
        last = last_plans.get(self.goal)
        if last is None or last[0] != of_step:
            plan = HostPlan.of(self.workspace, self.options, self.goal, self.norm(), self.motion)
            last = last_plans[self.goal] = of_step, plan
        return last[1]

    def begin_plan(self, plan: HostPlan, time_slice: Slice | None) -> None:
        """Begin a step, or a slice of it, with a plan: its positions, and the extent of its boxes."""
        self.plan, self.execution = plan, plan.execution
        self.planes = PlaneStage(plan, self.workspace) if plan.has_planes else None
        if time_slice is None or time_slice is self.motion.slices[0]:
            plan.begin_counts()
        self._active = None
        if time_slice is not None:
            self.positions = self.motion.placed(time_slice, plan.execution) or self.positions
            self._active = time_slice.active
        self.vertices_t0 = plan.set_positions(self.positions)[0]
        self.set_extent()

    def begin_boxes(self, near: NDArray[np.bool_] | None) -> bool:
        """Begin the boxes of the bodies that are near others; returns whether there are any."""
        plan = self.plan
        if near is not None and not near.any():
            plan.skip_boxes(goes_on=self._has_boxes)
            return False
        active = self.workspace.active(near)
        plan.begin_boxes(self.positions, self.t_end, self.inflation, active, goes_on=self._has_boxes)
        self._has_boxes = True
        return True

    def _bodies_near(self) -> NDArray[np.bool_] | None:
        """Bodies that may collide, or None for all."""
        active = self._active
        if not self.topology.may_have_inactive_bodies:
            return active
        radius = self.motion.radius.numpy() if self.motion.on_arcs else None
        near = bodies_near(self.topology, self.positions, self.inflation, self.execution, radius)
        if active is not None:
            near &= active
        self._num_active_bodies = int((near | self.mesh.static).sum())
        return near

    def capacity(self, bytes_per_pair: int | None = None, num_parts: int = 1) -> int:
        """Largest number of pairs at a time within the memory limit, where so many parts are searched at once.

        Every part needs capacity for all partners of one query.
        """
        if bytes_per_pair is None:
            bytes_per_pair = self.plan.memory.pair_bytes + self.result_bytes
        least = num_parts * max(_LEAST_KEYS, self.plan.most_partners)
        limit = self.options.memory_limit
        if limit is None:
            return min(max(least, _DEFAULT_PAIR_BYTES // bytes_per_pair), self.plan.memory.most_pairs)
        # half of what is left is for the pairs, half for the contacts
        needed = self.fixed_bytes + 2 * least * bytes_per_pair
        if needed > limit:
            raise ValueError(
                f"memory_limit is {limit} bytes; expected at least {needed} for this step: "
                f"{self.fixed_bytes} for its boxes and {needed - self.fixed_bytes} for pairs and contacts"
            )
        return min((limit - self.fixed_bytes) // 2 // bytes_per_pair, self.plan.memory.most_pairs)

    @property
    def fixed_bytes(self) -> int:
        """Bytes of the mesh's topology and of the boxes."""
        return self.topology.num_bytes + self.workspace.buffers.num_bytes_but("keys", "contact", "pair")

    def batches(self, batches: Iterator[Batch]) -> Iterator[Batch]:
        """The batches of a search, counted, and timed as the stage of pairs."""
        for batch in self.timer.timed_items("pairs", batches):
            for kind, number in batch.num_pairs.items():
                self.survivors[kind] += number
            yield batch

    def finish(self, **counts: Any) -> None:
        """Release what the step has used, count what it has done, and end its timings.

        ``counts`` are those that the goal knows, by their names.
        """
        plan, boxes = self.plan, self.workspace.boxes
        plan.release_positions()
        if self.paths is not None:
            self.motion.release()
        of_step = {
            "num_active_bodies": self._num_active_bodies,
            "num_boxes": boxes.num_boxes,
            "num_sorted_sets": boxes.num_sorted,
            "num_searches": plan.num_searches,
            "num_candidates": plan.num_candidates,
            "num_after_cull": {kind: self.survivors[kind] for kind in plan.kinds} if self.counts_survivors else {},
            "num_contacts": {},
            "num_batches": plan.num_batches,
        }
        self.counts = of_values(Counts, self.workspace.no_counts | of_step | counts)
        self.timer.finish()
