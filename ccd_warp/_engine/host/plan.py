"""The driver of calls on the host, whose sizes and positions change from step to step: sections that it plays."""

import itertools
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from operator import attrgetter, gt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import BoxSet
from ccd_warp._engine.boxes.near_bodies import NearBodies
from ccd_warp._engine.boxes.some_queries import has_many_blocks, with_some_queries
from ccd_warp._engine.boxes.trees import SearchPart, TreePair, search_options
from ccd_warp._engine.host.pair_memory import CANDIDATES_EACH, PairMemory
from ccd_warp._engine.mesh.topology import MOST_COPIED, Positions
from ccd_warp._engine.motion import Motion
from ccd_warp._engine.plan import AT_ONE_TIME, NUM_ALL_COUNTS, Goal, Plan, high_half
from ccd_warp._engine.stages import MOST_IN_ORDER, Stages, StepFields
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.narrow_phase.sinks import BOUND, CONTACTS
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.step.minima import ANY_OPEN, CANDIDATES, FOUND, OPEN, Minima
from ccd_warp.kernels.step.step import ContactList

if TYPE_CHECKING:
    from ccd_warp._engine.host.workspace import Workspace
    from ccd_warp._scene.input.options import Options

_CANDIDATES, _FOUND, _OPEN, _ANY_OPEN = map(int, (CANDIDATES, FOUND, OPEN, ANY_OPEN))
# Queries of a tree pair, and the pairs of them that are kept, where a few are likely to show a toi of 0.
_FEW_QUERIES, _FEW_PAIRS = 16, 1 << 14
# Blocks of queries from which it pays to look first whether a static tree is near at all.
_WORTH_A_LOOK = 64
# Plans that a workspace keeps, enough for the different kinds of calls in a loop.
_MOST_PLANS = 8
_structs_of = attrgetter("structs")
NO_PAIRS = dict.fromkeys(PairKind, 0)
_POSITIONS = ("vertices_t0", "vertices_t1")
# Fields of the stages, each of which is a slot of its name.
_FIELDS = (
    *("vertex_aabbs", "quantization", "largest_block", "t_end", "inflation", "search_options"),
    *("options", "queue", "plane_query", "reach", "proximities", "start_distances"),
)


class Batch(NamedTuple):
    """Pairs whose keys the search has just written.

    Attributes:
        num_pairs: Number of pairs by kind.
        is_only: Whether these are all pairs of the search.
    """

    num_pairs: dict[PairKind, int]
    is_only: bool


class HostPlan(Plan):
    """What a workspace keeps for calls with one goal, of the same pair kinds, precision, method and number of threads.

    Attributes:
        most_partners: Number of primitives in the largest set in which partners are searched.
        memory: Memory for the pairs that a search finds.
        counters: What the kernels count, and the least toi so far; of all plans of a workspace.
        num_searches: Searches of a tree pair, or of a part of one, in this step, by kind.
        num_candidates: Pairs of each kind whose boxes overlap, in the last search.
        num_batches: Number of batches of this step.
        is_idle: Whether no body is near another in this step, or slice, so that nothing is searched.
        has_fitted: Whether all pairs of the last step did fit the memory, as those of the next one are likely to.
        near_bodies: What finds in a whole step which bodies others come near; None where the host does before it.
        of_options: What the options that the recording has were made of.
        lengths: The options of the last step, and what they say of lengths.
        marks: When the stages of the last step that was played as a whole ended, as ``now`` tells.
        lists_in_order: Whether the search is one for all pairs whose boxes overlap, in the order of its few boxes.
        lists_pairs: Whether the earliest pairs of the last step with the goal of a bound were listed.
    """

    @staticmethod
    def of(workspace: "Workspace", options: "Options", goal: Goal, norm: Norm, motion: Motion) -> "HostPlan":
        """The plan of a workspace for calls with such options, a goal, a norm of separations and a motion."""
        of_options = options.pair_kinds, options.precision, options.method, options.threads, options.broad_phase
        key = (goal, norm, of_options, motion.on_arcs)
        if key not in workspace.plans:
            if len(workspace.plans) >= _MOST_PLANS:
                workspace.plans.clear()
                workspace.last_plans.clear()
            workspace.plans[key] = HostPlan(workspace, options, goal, norm, motion)
        return workspace.plans[key]

    def __init__(self, workspace: "Workspace", options: "Options", goal: Goal, norm: Norm, motion: Motion) -> None:
        self._workspace, self._boxes, topology = workspace, workspace.boxes, workspace.topology
        device, threads = topology.device, options.threads
        execution = Execution(device, threads, workspace.flag, workspace.progress, may_be_captured=False)
        self._radii = motion.radius, motion.box_radius
        self.counters = workspace.counters
        super().__init__(topology, options, execution, goal, norm, workspace.boxes.sets, self.counters.array)
        self.most_partners = max((tree_pair.target.primitives.count for tree_pair in self.tree_pairs), default=0)
        has_queue = execution.is_cuda and self._has_narrow_phase
        are_few = all(tree.levels[0] <= MOST_IN_ORDER for tree in self.trees)
        self.lists_in_order = goal == "candidates" and not execution.is_cuda and are_few
        self.memory = PairMemory(
            workspace.buffers,
            self._searched_kinds,
            is_cuda=execution.is_cuda,
            keeps_toi=goal == "bound",
            has_queue=has_queue,
            has_ranges=self.lists_in_order,
        )
        self._excess: dict[str, Mapping[PairKind, int]] = {}  # pairs of the last step that was searched in parts
        self._needed: Mapping[PairKind, int] = {}  # pairs of the last search
        self._search_values: tuple[float, ...] | None = None
        self.is_idle = self.lists_pairs = self.has_fitted = False
        self.marks: list[Any] = []
        self.now: Callable[[], Any] = time.perf_counter
        is_straight = self._has_narrow_phase and not motion.on_arcs
        self.near_bodies = NearBodies.of(topology, fewest=2) if is_straight else None
        # what boxes depend on besides positions and trees: objects by their identities, as the recording keeps them
        self._of_boxes: tuple[Any, ...] = ()
        self.of_options: tuple[Any, ...] = ()
        self.lengths: tuple[Options | None, float, float, float] = None, 0.0, 0.0, 0.0
        self._positions: tuple[wp.array, ...] = ()
        self._active = workspace.active(None)
        self._bound: list[tuple[Any, ...]] = []  # structs of trees that the recording has
        self._are_copied = topology.device.is_cuda or topology.mesh.num_vertices <= MOST_COPIED
        self._has_counted_blocks = False  # since they were noted
        self.begin_counts()

        boxes = {tree.name: tuple(map(Slot, tree.slots)) for tree in self.trees}
        of_pairs = self.memory.slots()
        names = [*_POSITIONS, *_FIELDS, "turns", "searched", "largest_bound"]
        names += [slot.name for slots in boxes.values() for slot in slots]
        names += [slot.name for slots in of_pairs.values() for slot in slots.values()]
        self._recording = Recording(execution, dict.fromkeys(names) | {"contacts": ContactList()})
        self.memory.bind_to(self._recording)
        slots: dict[str, Any] = {name: Slot(name) for name in _FIELDS}
        start, end = map(Slot, _POSITIONS)
        self._stages = Stages(
            topology,
            self.tree_pairs,
            self._num_aabbs,
            self._narrow_phase,
            self.is_clipping,
            step=StepFields(start, end, self._counts, self._minima(), Slot("contacts"), self.counters.least_bits),
            box_radius=self._radii[1],
            is_thick=topology.is_thick or motion.on_arcs,
            boxes=boxes,
            turns=Slot("turns") if motion.on_arcs else None,
            plane_radius=topology.box_radius,
            **of_pairs,
            **slots,
        )
        self._stages.load(execution, self.sink)

    def _minima(self) -> Any:
        """The minima that the calls lower; of others only which vertex is in which world is read."""
        if self._goal in ("contacts", *AT_ONE_TIME):
            return self._workspace.contacts.minima
        minima = Minima()
        minima.vertex_world = self.topology.vertex_world
        return minima

    def begin_counts(self) -> None:
        """Forget the counts of the last step."""
        self.num_searches = dict.fromkeys(self.kinds, 0)
        self.num_batches = 0
        self.begin_candidates()

    def begin_candidates(self, num_with_planes: int = 0) -> None:
        """Count the candidates of the next search, besides so many pairs of vertices and planes."""
        self.num_candidates = dict.fromkeys(self.kinds, 0)
        if num_with_planes:
            self.num_candidates[PairKind.VERTEX_PLANE] = num_with_planes

    def play(self, section: str, record: Callable[[Stages, Recording], None]) -> None:
        """Run a section of the recording; ``record`` records it at its first use."""
        if section not in self._recording:
            with self._recording.section(section):
                record(self._stages, self._recording)
        self.counters.change()
        self._recording.play(section)

    def set_positions(self, positions: Positions) -> tuple[wp.array, wp.array]:
        """Use the positions of a step, and return them on the device."""
        if self._are_copied:
            arrays = self._workspace.copied(positions)
        else:
            device = self.topology.device
            of_ends: list[wp.array] = [wp.array(x, dtype=wp.vec3d, device=device, copy=False) for x in positions]
            arrays = of_ends[0], of_ends[1]
        if arrays != self._positions:  # which are the same or not
            self.bind(**dict(zip(_POSITIONS, arrays, strict=True)))
            self._positions = arrays
        return arrays

    def release_positions(self) -> None:
        """Do not keep the caller's arrays alive."""
        self._boxes.release()
        if not self._are_copied:
            none = self.topology.array(np.empty((0, 3)), wp.vec3d)
            self.bind(vertices_t0=none, vertices_t1=none)
            self._positions = ()

    def bind(self, **values: Any) -> None:
        """Use these values of the stages, by the names of their fields."""
        for name, value in values.items():
            self._recording.bind(name, value)

    def begin_boxes(
        self, positions: Positions, t_end: float, inflation: float, active: wp.array, *, goes_on: bool = False
    ) -> None:
        """Choose how the boxes of a step over [0, t_end], or of a slice with which it ``goes_on``, are computed.

        Those of bodies that are not active are empty.
        """
        boxes, self.is_idle = self._boxes, False
        # candidates are listed in the order of the rest configuration, whatever was searched before
        keeps_order = goes_on or self._goal != "candidates"
        of_step = positions, inflation, self._num_aabbs, self.trees, self.execution
        boxes.begin(*of_step, goes_on=goes_on, keeps_order=keeps_order)
        self._active = active
        packed, vertex_aabbs = boxes.quantization.packed, boxes.vertex_aabbs
        of_boxes = id(packed), id(vertex_aabbs), inflation, t_end
        if of_boxes != self._of_boxes:
            self.bind(quantization=packed, vertex_aabbs=vertex_aabbs, inflation=inflation, t_end=t_end)
            if self.execution.is_cuda:
                self.bind(largest_block=boxes.largest_block)
            self._of_boxes = of_boxes
        self._bind_trees()

    def fill_boxes(self) -> None:
        """Compute the boxes of a step that has begun; on CUDA twice where a new order of trees is a bad one."""
        is_new = self.execution.is_cuda and self._boxes.trust_order(self._kept_in_order)
        self._play_boxes()
        if is_new and not self._note_order():
            self._play_boxes()

    def _play_boxes(self) -> None:
        self.play("boxes", self._record_boxes)
        self._has_counted_blocks = self.execution.is_cuda

    def _record_boxes(self, stages: Stages, recording: Recording, active: wp.array | None = None) -> None:
        """Record the boxes of active bodies, by default of those that the host has found near others.

        Trees are sorted where their blocks no longer consist of neighbours, on CUDA those of their last boxes, as the
        host reads how many are large with the counts of pairs.
        """
        active = self._active if active is None else active
        self.record_boxes(recording, stages, active, sort=self._keep_in_order if self._kept_in_order else None)
        if recording.is_cuda:
            for cell, tree in enumerate(self._kept_in_order):
                stages.count_large_blocks(recording, tree, self.counters.array, NUM_ALL_COUNTS + 1 + cell)

    def _keep_in_order(self) -> None:
        if any([self._boxes.keep_in_order(tree, self.execution) for tree in self._kept_in_order]):
            self._bind_trees()
            self._recording.update_structs()

    def _note_order(self) -> bool:
        """On CUDA, note which trees are in order by the large blocks since the last time; returns whether all are."""
        self._has_counted_blocks = False
        trees = zip(self._kept_in_order, self.counters.large_blocks(), strict=False)
        return all([self._boxes.note_large_blocks(tree, count) for tree, count in trees])

    @lazy_property
    def _kept_in_order(self) -> list[BoxSet]:
        """The trees of which a step may change the order."""
        is_sorted = bool(self.trees) and self.trees[0].is_sorted_when_filled
        return [] if is_sorted else [tree for tree in self.moving_trees if self._boxes.may_be_sorted(tree)]

    def skip_boxes(self, *, goes_on: bool = False) -> None:
        """Search nothing in a step, or in a slice with which it ``goes_on``, as no body is near another."""
        self.is_idle = True
        if not goes_on:
            self._boxes.num_boxes = self._boxes.num_sorted = 0

    def shorten_boxes(self, t_end: float) -> None:
        """Compute the boxes over [0, t_end] alone; the order of the trees stays."""
        if not self.is_idle:
            self.bind(t_end=t_end)
            self._of_boxes = ()
            self.play("shorter boxes", lambda stages, recording: self.record_boxes(recording, stages, self._active))

    def _bind_trees(self) -> None:
        structs = list(map(_structs_of, self.trees))
        if structs != self._bound:  # tuples of one object each, which are the same or not
            for tree in self.trees:
                for slot, struct in zip(tree.slots, tree.structs, strict=True):
                    self._recording.bind(slot, struct)
            self._bound = structs

    def may_meet(self, tree_pair: TreePair) -> bool:
        """Whether the boxes around two trees overlap; only a static tree may be far from the others for long."""
        if self.is_idle:
            return False
        query, target = tree_pair.query, tree_pair.target
        return not target.primitives.is_static or self._boxes.may_meet(query, target)

    def set_search(self, t_end: float, inflation: float, separation: float) -> None:
        """Search for pairs that touch before ``t_end``."""
        values = (t_end, inflation, separation)
        if values != self._search_values:
            packed = search_options(*values, self.norm, self._workspace.flag, self._radii)
            self.bind(search_options=packed)
            self._search_values = values

    def stages_now(self) -> Stages:
        """The stages with the values of their slots, to launch now."""
        return self._stages.with_values(self._recording.values)

    def batches(
        self, largest: int, *, of_sample: bool = False, among: NDArray[np.bool_] | None = None
    ) -> Iterator[Batch]:
        """Search all pairs, or those of a sample of the queries, and yield what the cull leaves in batches.

        They are one where :meth:`search` finds all, and otherwise those of a search in parts. Where there are few
        vertices ``among`` which one of each pair is wanted, of all others only some may be found.
        """
        batch = self.search(largest, of_sample=of_sample, among=among)
        if batch is None:
            section, tree_pairs = self._searched(of_sample=of_sample)
            yield from self._batches_of_parts(section, tree_pairs, largest, self._needed)
        elif batch.num_pairs:
            yield batch

    def _searched(self, *, of_sample: bool) -> tuple[str, list[TreePair]]:
        return ("pairs of a sample", self.sampled_pairs) if of_sample else ("pairs", self.tree_pairs)

    def search(self, largest: int, *, of_sample: bool = False, among: NDArray[np.bool_] | None = None) -> Batch | None:
        """Search all pairs, or those of a sample of queries or of some vertices, into the capacity of the last step.

        The search tells how many pairs there are. If they are more than the capacity, this grows up to ``largest``
        pairs, and the search is repeated.

        Returns:
            What the cull leaves, of no kind where nothing is searched; None if it is more than ``largest`` pairs, or
            was in the last step, and so is to be searched in parts.
        """
        section, tree_pairs = self._searched(of_sample=of_sample)
        if not tree_pairs or self.is_idle:
            return Batch({}, is_only=True)
        if section in self._excess:
            self._needed = self._excess[section]
            return None
        self._reserve(tree_pairs, largest)
        self._look_at_static(tree_pairs)
        some = None if among is None or self.execution.is_cuda else self._with_some_queries(tree_pairs, among)

        def search() -> None:
            self.counters.clear()
            if some is None:
                self.play(section, partial(self._record_search, tree_pairs))
            else:
                self._search_some(some)

        return self._fitting(tree_pairs, largest, search)

    def _reserve(self, tree_pairs: list[TreePair], largest: int) -> None:
        """Have memory for the pairs of the last step, or for some."""
        self.memory.reserve(lambda kind: sum(p.query.primitives.count for p in tree_pairs if p.kind == kind), largest)

    def _look_at_static(self, tree_pairs: list[TreePair]) -> None:
        """Note which tree pairs may meet; only a static tree may be far from the others for long.

        Where a tree has few queries a search takes less than a look.
        """
        self._meets = [True] * len(tree_pairs)
        for number, tree_pair in enumerate(tree_pairs if self._may_be_far else ()):
            if tree_pair.query.levels[0] >= _WORTH_A_LOOK:
                self._meets[number] = self.may_meet(tree_pair)

    def _record_search(self, tree_pairs: list[TreePair], stages: Stages, recording: Recording) -> None:
        is_needed = (lambda number: self._meets[number]) if self._may_be_far else None
        stages.find_pairs(recording, tree_pairs, is_needed=is_needed)

    @lazy_property
    def _may_be_far(self) -> bool:
        """Whether trees are looked at before they are searched."""
        static = (tree_pair for tree_pair in self.tree_pairs if tree_pair.target.primitives.is_static)
        return any(tree_pair.query.levels[0] >= _WORTH_A_LOOK for tree_pair in static)

    def _fitting(
        self,
        tree_pairs: list[TreePair],
        largest: int,
        search: Callable[[], None],
        fits: Callable[[], bool] = lambda: True,
    ) -> Batch | None:
        """The batch of a search of tree pairs, which is repeated until all pairs fit, and what else there is.

        None if the pairs are more than ``largest``.
        """
        while True:
            search()
            for tree_pair, meets in zip(tree_pairs, self._meets, strict=True):
                self.num_searches[tree_pair.kind] += meets
            self._needed = needed = self._num_needed()
            if any(map(gt, needed.values(), self.memory.capacities.values())):
                self.has_fitted = self.memory.grow(needed, largest)
                if not self.has_fitted:
                    return None
            elif fits():
                self.has_fitted = True
                if self._has_counted_blocks:
                    self._note_order()
                return self._batch(self._num_found() if self.execution.is_cuda else needed, is_only=True)

    def play_step(
        self,
        largest: int,
        begin: Callable[[], None],
        fits: Callable[[], bool],
        record_found: Callable[[Stages, Recording], None],
    ) -> Batch | None:
        """Play all stages of a step whose boxes have begun as one section, and again until all that is found fits.

        Args:
            largest: The largest capacity.
            begin: Called before each time: begins what is found of the pairs.
            fits: Whether that was large enough.
            record_found: Records what follows the search where there is no narrow phase.

        Returns:
            The pairs, which are solved but for the second round of a bound; None if they are more than the capacity.
        """
        tree_pairs = [] if self.is_idle else self.tree_pairs
        self._reserve(self.tree_pairs, largest)

        def search() -> None:
            begin()
            self.marks, self._meets = [], [False] * len(tree_pairs)
            section = "step without pairs" if self.is_idle else "step"
            self.play(section, partial(self._record_step, tree_pairs, record_found))
            if self.execution.is_cuda:
                self._has_counted_blocks = bool(tree_pairs)
                if self._goal == "contacts":
                    self.counters.read_all()

        return self._fitting(tree_pairs, largest, search, fits)

    def _record_step(
        self,
        tree_pairs: list[TreePair],
        record_found: Callable[[Stages, Recording], None],
        stages: Stages,
        recording: Recording,
    ) -> None:
        """Record all stages; of a bound, half-spaces come first, and nothing else where a toi is 0 there."""
        if not self._has_narrow_phase:
            self._record_pairs(tree_pairs, stages, recording, self._active)
            record_found(stages, recording)
            return
        near, active = self.near_bodies, self._active
        planes_first = self.sink == BOUND and self.has_planes
        if self.sink == CONTACTS:
            self._record_reset(stages, recording)
        if near is not None:
            active = near.record(recording, stages, active)
        if planes_first:
            self._record_planes(stages, recording)
        with recording.only_if(high_half(self.counters.least_bits)) if planes_first else nullcontext():
            with nullcontext() if near is None else recording.only_if(near.is_any):
                self._record_pairs(tree_pairs, stages, recording, active)
            if self.sink == CONTACTS and self.has_planes:
                self._record_planes(stages, recording)
            self.record_rounds(recording, stages)
            self.mark(recording)

    def _record_pairs(self, tree_pairs: list[TreePair], stages: Stages, recording: Recording, active: wp.array) -> None:
        """Record the boxes of active bodies, and the search, where there is anything to search."""
        if tree_pairs:
            self._record_boxes(stages, recording, active)
        recording.call(partial(self._look_at_static, tree_pairs))
        self.mark(recording)
        self._record_search(tree_pairs, stages, recording)
        self.mark(recording)

    def note_bodies_near(self) -> int:
        """Note whether the last whole step had boxes; returns how many bodies are static, or near others."""
        assert self.near_bodies
        near = self.near_bodies.near.numpy()
        if not near[~self.topology.mesh.static].any():
            self._boxes.num_boxes = self._boxes.num_sorted = 0
        return int(near.sum())

    def _record_planes(self, stages: Stages, recording: Recording) -> None:
        stages.meet_planes(recording, self.sink, Slot("searched"))
        self.mark(recording)

    def mark(self, recording: Recording) -> None:
        """Record that a stage of a whole step ends here."""
        recording.call(lambda: self.marks.append(self.now()))

    @lazy_property
    def may_leave_out_queries(self) -> bool:
        """Whether a search of some vertices is another than that of all."""
        return any(map(has_many_blocks, self.tree_pairs))

    def _with_some_queries(self, tree_pairs: list[TreePair], among: NDArray[np.bool_]) -> list[TreePair] | None:
        """Those of the tree pairs that may meet, with the queries that some vertices need; None if each needs all."""
        allocate = lambda name, count: self._workspace.buffers.get(name, count, wp.float32)  # noqa: E731
        pairs = list(itertools.compress(tree_pairs, self._meets))
        some = [with_some_queries(tree_pair, among, allocate) for tree_pair in pairs]
        return [a or b for a, b in zip(some, pairs, strict=True)] if any(some) else None

    def _search_some(self, tree_pairs: list[TreePair]) -> None:
        """Search tree pairs with some of their queries, now."""
        stages = self.stages_now()
        boxes = stages.boxes | {tree_pair.query.name: tree_pair.query.structs for tree_pair in tree_pairs}
        for tree_pair in tree_pairs:
            replace(stages, boxes=boxes).search(self.execution, tree_pair)

    def few_batches(self, largest: int) -> Iterator[Batch]:
        """Batches of a few queries of each tree pair, of at most ``largest`` pairs; further pairs of them are left."""
        largest = min(largest, _FEW_PAIRS)
        self.memory.share(largest)
        stages = self.stages_now()
        for tree_pair in filter(self.may_meet, self.tree_pairs):
            count = tree_pair.query.primitives.count
            self._search_part(stages, SearchPart(tree_pair, 0, range(0, count, -(-count // _FEW_QUERIES))))
            found = {kind: min(count, largest) for kind, count in self._num_found().items()}
            if found[tree_pair.kind] > 0:
                yield self._batch(found, is_only=False)

    def _batches_of_parts(
        self, section: str, tree_pairs: list[TreePair], largest: int, expected: Mapping[PairKind, int]
    ) -> Iterator[Batch]:
        """Batches of at most ``largest`` pairs, given how many there may be of each kind."""
        pending: deque[SearchPart] = deque()
        for tree_pair in filter(self.may_meet, tree_pairs):
            whole = SearchPart.whole(tree_pair, is_cuda=self.execution.is_cuda)
            pending += whole.split(_pieces(expected[tree_pair.kind], largest))
        total = sum(part.num_queries for part in pending)
        total_needed: Counter[PairKind] = Counter()
        self.memory.share(largest)
        stages = self.stages_now()
        done = 0
        while pending:
            part = pending.popleft()
            kind = part.tree_pair.kind
            self.execution.progress.begin("pairs", total, done)
            self._search_part(stages, part)
            needed = self._num_needed()[kind]
            if needed > largest:
                pending.extendleft(reversed(part.split(_pieces(needed, largest))))
                continue
            found = self._num_found()
            done += part.num_queries
            total_needed[kind] += needed
            batch = self._batch(found, is_only=False)
            if found[kind] > 0:
                yield batch
        if total_needed.total() > largest:
            self._excess[section] = total_needed
        else:
            self._excess.pop(section, None)

    def _search_part(self, stages: Stages, part: SearchPart) -> None:
        """Search some items of a tree pair alone, now."""
        self.counters.clear()
        stages.find_some_pairs(self.execution, part.tree_pair, part.items, part.level)
        self.num_searches[part.tree_pair.kind] += 1

    def _batch(self, num_pairs: dict[PairKind, int], is_only: bool) -> Batch:
        """A batch, after it is counted."""
        self.num_batches += 1
        rows = self.counters.rows()
        for kind in self._searched_kinds:
            self.num_candidates[kind] += rows[kind][_CANDIDATES]
        return Batch(num_pairs, is_only)

    def _num_found(self) -> dict[PairKind, int]:
        rows = self.counters.rows()
        return {kind: rows[kind][_FOUND] for kind in self._searched_kinds}

    def _num_needed(self) -> dict[PairKind, int]:
        """The capacity for pairs that the search needs; on CUDA for its candidates, too."""
        needed = self._num_found()
        if self.execution.is_cuda:
            rows = self.counters.rows()
            return {kind: max(n, -(-rows[kind][_CANDIDATES] // CANDIDATES_EACH)) for kind, n in needed.items()}
        return needed

    def num_open(self) -> dict[PairKind, int]:
        """Number of pairs that the first round of the narrow phase has left open, by kind."""
        rows = self.counters.rows()
        if not rows[0][_ANY_OPEN]:
            return {}
        return {kind: rows[kind][_OPEN] for kind in self._searched_kinds if rows[kind][_OPEN]}

    def solve(self, *, is_second: bool) -> None:
        """A round of the narrow phase on the pairs of a batch."""
        section = "narrow phase, second round" if is_second else "narrow phase"
        self.play(section, lambda stages, recording: stages.solve(recording, self.sink, is_second=is_second))

    def measure_pairs(self, sink: int) -> None:
        """In place of the narrow phase: measure the distances of the pairs of a batch, for a sink."""
        self.play("distances", lambda stages, recording: stages.measure_pairs(recording, sink, self.norm))

    def set_open_pairs(self, kind: PairKind, keys: NDArray[np.int64]) -> None:
        """Make these marked keys the pairs of the second round, which share the work of so many."""
        pairs = self._workspace.buffers.get("open keys", len(keys), wp.int64)
        pairs[: len(keys)].assign(keys)
        self.memory.take_over(kind, pairs, len(keys))
        self.counters.clear()
        self.counters.set_column(FOUND, {kind: len(keys)})
        self.counters.set_column(OPEN, {kind: len(keys)})

    def reset_minima(self) -> None:
        """Set every toi to infinity."""
        self.play("reset", self._record_reset)

    def _record_reset(self, stages: Stages, recording: Recording) -> None:
        stages.reset(recording, self.counters.num_contacts, self._workspace.flag.array)
        stages.reset_vertices(recording)


def _pieces(count: int, largest: int) -> int:
    """Number of parts in which so many pairs are likely to fit one by one, at least two."""
    return max(2, -(-3 * count // (2 * largest)))
