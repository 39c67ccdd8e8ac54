"""The earliest toi of a step alone."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.contacts import BYTES_PER_CONTACT
from ccd_warp._engine.host.impact_step import ImpactStep
from ccd_warp._engine.host.plan import Batch, HostPlan
from ccd_warp._engine.host.start_witnesses import StartWitnesses
from ccd_warp._engine.mesh.start_distances import keeps_start_distances
from ccd_warp._engine.motion import Slice
from ccd_warp._results.contacts import Contacts
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.step.step import ContactList

# Remaining share of the step below which recomputing the boxes for it pays.
_WORTH_SHORTENING = 0.5
# Where pairs that keep their start distances press (`kernels.pair.start_distance`), a step below the first
# fraction is none if its motion is below the second fraction of the size of the scene.
_LOST_TOI, _LOST = 2.0**-20, 2.0**-30
# Pairs that a search may list as the earliest so far: each that lowers the least toi is one, and all that have it.
_MOST_LISTED = 1 << 14
# Marked keys of open pairs and their toi so far, of each kind in batches.
_OpenPairs = dict[PairKind, list[tuple[NDArray[np.int64], NDArray[np.float64]]]]


def _add_open(plan: HostPlan, batch: Batch, open_pairs: _OpenPairs) -> None:
    """Add the pairs of a batch that the first round has left open."""
    for kind in plan.num_open():
        of_kind = plan.memory.keys, plan.memory.open_toi
        keys, toi = (of_batch(kind, batch.num_pairs[kind]).numpy() for of_batch in of_kind)
        open_pairs.setdefault(kind, []).append((keys[keys < 0], toi[keys < 0]))


class Earliest(NamedTuple):
    """The earliest toi of a step, and the pairs that have it, without those with half-spaces.

    Attributes:
        toi: The toi, inf if nothing touches.
        pairs: A pair that has it, and others that have the same, as contacts of which kind, primitives, toi and
            parameters are known; None if none is, as at a toi of 0.
    """

    toi: float
    pairs: Contacts | None


class LeastToiStep(ImpactStep):
    """The earliest toi of all pairs."""

    goal = "bound"
    result_bytes = 8  # of a toi
    stages_with_planes = "input", "planes", "boxes", "pairs", "narrow phase"
    _any_suffices = _lists_pairs = _is_cut_short = False

    def earliest(self) -> Earliest:
        """The earliest toi of all pairs, where what starts within its distance may part, and what pairs have it.

        It is not searched for where a pair of an earlier step shows that it is 0, and then nothing is counted: a step
        with start distances follows.
        """
        witnesses, mesh = self.workspace.kept(StartWitnesses, StartWitnesses), self.mesh
        is_followed = self.paths is None and keeps_start_distances(mesh, self.options)
        if is_followed and witnesses.are_within(self.options, self.positions[0]):
            return Earliest(0.0, None)
        self._lists_pairs = True
        toi = self.least_toi()
        if toi == np.inf or self._is_cut_short or (toi <= 0.0 and not is_followed):
            return Earliest(toi, None)
        pairs = self.workspace.contacts.with_toi(toi)
        if toi > 0.0:
            return Earliest(toi, pairs)
        if pairs is not None:
            witnesses.note(mesh, self.options, self.positions[0], pairs)
        return Earliest(toi, None)

    def least_toi(self, start_distances: NDArray[np.float64] | None = None, *, any_suffices: bool = False) -> float:
        """Earliest toi of all pairs, inf if none touches; what starts within its distance may part (`parting`).

        In a large mesh the pairs of a sample of the queries come first. Where one touches, the full search covers only
        the part of the step before that: the boxes are shorter, and the cull ends there. The bound of each round is the
        least toi of the pairs of the previous round. It depends only on the input, and so does the result.

        Args:
            start_distances: How near each vertex was to anything at the start, where pairs keep that. The toi is then 0
                where nothing moves until it by more than rounding.
            any_suffices: Whether to end with the first contact found, whose toi need not be the earliest; what starts
                within its distance then is one.
        """
        self._any_suffices = any_suffices
        if not any_suffices:
            self.parting(start_distances)
        batch, best = self.played_whole(), np.inf
        if batch is not None:
            best = self._least_of_whole(batch)
        for time_slice in self.motion.slices if batch is None else ():
            if best <= np.min(time_slice.t_begin):
                break
            best = self._least_of(time_slice, best)
        self.oddities.is_stuck = self.oddities.touches_at_start = best <= 0.0
        self.finish()
        return 0.0 if start_distances is not None and self._is_lost(best) else best

    def _is_lost(self, toi: float) -> bool:
        """Whether nothing moves until a time by more than rounding."""
        start, end = self.positions
        with np.errstate(over="ignore"):
            motion = float(np.abs(end - start).max(initial=0.0))
            return toi <= _LOST_TOI and toi * motion <= _LOST * self.mesh.length_scale

    def _suffices(self, toi: float) -> bool:
        """Whether no earlier toi is looked for."""
        return toi <= 0.0 or (self._any_suffices and toi < np.inf)

    def _least_of(self, time_slice: Slice, best: float) -> float:
        """The least of a toi and those in a slice, or in the whole step."""
        plan = self.begin(time_slice)
        if time_slice is self.motion.slices[0]:
            self._begin_list(plan)
        if self.is_idle():
            return best
        self.bind_options(time_slice)
        num_with_planes = 0
        if self.planes is not None:
            with self.timed("planes"):
                plan.counters.set_least(best)
                num_with_planes = self.planes.meet()
                best = plan.counters.least()
            if self._suffices(best):
                return best
        t_end, is_straight = self.motion.t_end, not self.motion.on_arcs
        # the next step is played whole, not up to the toi of a half-space, and phantoms tell where a search has ended
        is_sampled = is_straight and bool(plan.sampled_pairs)
        for of_sample in (True, False) if is_sampled else (False,):
            if is_sampled and best <= _WORTH_SHORTENING * t_end:
                t_end = best
                with self.timed("boxes"):
                    plan.shorten_boxes(t_end)
            plan.set_search(min(best, t_end) if is_sampled else t_end, self.inflation, self.separation)
            plan.counters.set_least(best)
            plan.begin_candidates(num_with_planes)
            open_pairs: _OpenPairs = {}
            for batch in self.batches(self._searched(plan, best, of_sample=of_sample)):
                self._solve(plan, batch, open_pairs)
                if self._suffices(plan.counters.least()):
                    break
            best = plan.counters.least()
            if self._suffices(best):
                break
            with self.timed("narrow phase"):
                best = self._least_open_toi(plan, best, open_pairs)
        return best

    def _solve(self, plan: HostPlan, batch: Batch, open_pairs: _OpenPairs) -> None:
        """The first round of the narrow phase on a batch, whose open pairs are added to the others."""
        with self.timed("narrow phase"):
            plan.solve(is_second=False)
            _add_open(plan, batch, open_pairs)

    def _least_of_whole(self, batch: Batch) -> float:
        """The least toi of a step that was played whole."""
        plan, open_pairs = self.plan, dict[PairKind, Any]()
        _add_open(plan, batch, open_pairs)
        best = plan.counters.least()
        return best if self._suffices(best) or not open_pairs else self._least_open_toi(plan, best, open_pairs)

    def plays_whole(self, plan: HostPlan) -> bool:
        """Whether a step is played as a whole: not where a toi of half-spaces suffices, which are looked at first."""
        return super().plays_whole(plan) and not (self._any_suffices and plan.has_planes)

    def begin_found(self) -> None:
        """Begin without a toi."""
        plan = self.plan
        plan.counters.begin(np.inf)
        self._begin_list(plan)

    def _begin_list(self, plan: HostPlan) -> None:
        """Begin a list of the earliest pairs, or none."""
        if self._lists_pairs:
            store, limit = self.workspace.contacts, self.options.memory_limit
            most = _MOST_LISTED if limit is None else (limit - self.fixed_bytes) // 2 // BYTES_PER_CONTACT
            store.begin(self.execution, max(1, min(most, _MOST_LISTED)))
            plan.bind(contacts=store.begin_batch(_MOST_LISTED))
        elif plan.lists_pairs:
            plan.bind(contacts=ContactList())
        plan.lists_pairs = self._lists_pairs

    def _searched(self, plan: HostPlan, best: float, *, of_sample: bool) -> Iterator[Batch]:
        """The batches of a search; none where few of its queries show that what touches does so at once."""
        capacity = self.capacity()
        if self.far_distance is not None:
            # most queries have a partner within the distance, so a few of them show a toi of 0
            for _ in self.batches(plan.few_batches(capacity)):
                with self.timed("narrow phase"):
                    plan.solve(is_second=False)
            best = plan.counters.least()
        return iter(()) if self._suffices(best) else plan.batches(capacity, of_sample=of_sample)

    def _least_open_toi(self, plan: HostPlan, bound: float, open_pairs: _OpenPairs) -> float:
        """The second round: earliest toi of the pairs that the first has left open, or the bound."""
        earlier = {}
        for kind, batches in open_pairs.items():
            keys, toi = map(np.concatenate, zip(*batches, strict=True))
            # which pairs are earlier than all closed ones depends only on the pairs, and so does their share of the
            # work
            is_earlier = toi < bound
            earlier[kind] = keys[is_earlier], toi[is_earlier]
        for kind, (keys, toi) in earlier.items():
            if len(keys) == 0:
                continue
            if self.options.share_of_work(len(keys)) <= self.options.first_iterations:
                bound, self._is_cut_short = min(bound, float(toi.min())), True
                continue
            plan.set_open_pairs(kind, keys)
            plan.counters.set_least(bound)
            plan.solve(is_second=True)
            bound = plan.counters.least()
        return bound
