"""All pairs of a step whose boxes overlap."""

from typing import Any

from ccd_warp._engine.host.candidates import NO_KEYS, Candidates, Collector, pairs_of, union
from ccd_warp._engine.host.pair_memory import KEY_BYTES
from ccd_warp._engine.host.plan import NO_PAIRS, Batch, HostPlan
from ccd_warp._engine.host.search import PairSearch
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.topology import WIDTH
from ccd_warp._engine.motion import Slice
from ccd_warp._runtime.quick import of_values
from ccd_warp._runtime.status import PairKind


class CandidateStep(HostStep):
    """The candidates, with a workspace of its own, as their boxes have one AABB each."""

    goal = "candidates"

    def __init__(self, workspace: Workspace, *arguments: Any, **further: Any) -> None:
        """Begin a step; the other arguments are those of every step."""
        super().__init__(workspace.at_one_time(self.goal), *arguments, **further)

    def candidates(self, inflation: float) -> Candidates:
        """All pairs whose boxes, enlarged by ``inflation``, overlap, in a slice where the step has several."""
        self.inflation = inflation
        batch = self.played_whole()
        if batch is None:
            of_slices = [self._with_planes(self._found(time_slice)) for time_slice in self.motion.slices]
        else:
            of_slices = [self._with_planes(self._listed(batch))]
        candidates = of_slices[0] if len(of_slices) == 1 else union(of_slices)
        if self.planes is not None:
            self.plan.num_searches[PairKind.VERTEX_PLANE] = 1
            self.plan.num_candidates[PairKind.VERTEX_PLANE] = len(candidates.vertex_plane)
        self.finish()
        return candidates

    def plays_whole(self, plan: HostPlan) -> bool:
        """Whether a step of one slice is played as a whole: where its pairs are then in order."""
        return plan.lists_in_order

    @property
    def _is_sorted(self) -> bool:
        """Whether pairs are sorted: the threads of a GPU write in any order, and that of a hash means nothing."""
        return self.execution.is_cuda or self.options.broad_phase == "hash"

    def _listed(self, batch: Batch) -> Candidates:
        """The candidates of a whole step."""
        with self.timed("copy"):
            keys = {kind: self.plan.memory.host_keys(kind, count) for kind, count in batch.num_pairs.items()}
            candidates = Candidates(*(pairs_of(keys.get(kind, NO_KEYS)) for kind in NO_PAIRS))
            return candidates.sorted() if self._is_sorted else candidates

    def _found(self, time_slice: Slice) -> Candidates:
        """The candidates of a slice, or of the whole step, by a search in parts."""
        plan = self.begin(time_slice)
        collector = Collector(self.execution, is_sorted=self._is_sorted)
        with self.timed("pairs"):
            plan.set_search(self.t_end, self.inflation, self.separation)
            tree_pairs = list(filter(plan.may_meet, plan.tree_pairs))
            search = PairSearch(plan.stages_now(), self.execution, self.workspace.buffers, tree_pairs)
            # counts what the search has just allocated
            blocks = search.num_workers if self.execution.is_cuda else max(search.num_workers, WIDTH)
            search.largest_capacity = self.capacity(KEY_BYTES, blocks)
        for ranges in self.timer.timed_items("pairs", search.ranges()):
            with self.timed("copy"):
                collector.take(ranges)
        for counts, more in ((plan.num_searches, search.num_launches), (plan.num_candidates, search.candidates)):
            for kind, number in more.items():
                counts[kind] += number
        plan.num_batches += search.num_batches
        with self.timed("copy"):
            return collector.candidates()

    def _with_planes(self, candidates: Candidates) -> Candidates:
        """The candidates, and the pairs of vertices and planes whose boxes overlap."""
        if self.planes is None:
            return candidates
        with self.timed("planes"):
            near = self.planes.candidates(self.positions, self.inflation, self.motion.box_radius)
        with_planes: Candidates = of_values(Candidates, vars(candidates) | {"vertex_plane": near})
        return with_planes
