"""All pairs of a step whose boxes overlap."""

from dataclasses import replace

from ccd_warp._engine.host.candidates import Candidates, Collector, union
from ccd_warp._engine.host.pair_memory import KEY_BYTES
from ccd_warp._engine.host.search import PairSearch
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.mesh.topology import WIDTH
from ccd_warp._engine.motion import Slice
from ccd_warp._runtime.status import PairKind


class CandidateStep(HostStep):
    """The candidates."""

    goal = "candidates"

    def candidates(self, inflation: float) -> Candidates:
        """All pairs whose boxes, enlarged by ``inflation``, overlap, in a slice where the step has several."""
        of_slices = [self._find(time_slice, inflation) for time_slice in self.motion.slices]
        candidates = of_slices[0] if len(of_slices) == 1 else union(of_slices)
        if self.planes is not None:
            self.plan.num_searches[PairKind.VERTEX_PLANE] = 1
            self.plan.num_candidates[PairKind.VERTEX_PLANE] = len(candidates.vertex_plane)
        self.finish()
        return candidates

    def _find(self, time_slice: Slice, inflation: float) -> Candidates:
        """The candidates of a slice, or of the whole step."""
        plan = self.begin(1.0, inflation, time_slice)
        # the threads of a GPU write in arbitrary order, and that of a spatial hash means nothing
        is_sorted = self.execution.is_cuda or self.options.broad_phase == "hash"
        collector = Collector(self.execution, is_sorted=is_sorted)
        with self.timed("pairs"):
            plan.set_search(1.0, inflation, 0.0)
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
            candidates = collector.candidates()
        if self.planes is not None:
            with self.timed("planes"):
                near = self.planes.candidates(self.positions, inflation, self.motion.box_radius)
            candidates = replace(candidates, vertex_plane=near)
        return candidates
