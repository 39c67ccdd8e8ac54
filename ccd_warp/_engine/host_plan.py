"""The recorded stages of calls on the host, whose sizes and positions change from step to step."""

import itertools
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes import BROAD_PHASES
from ccd_warp._engine.scene import norm_of, possible_kinds
from ccd_warp._engine.search import KEY_BYTES, MOST_PAIRS
from ccd_warp._engine.stages import CANDIDATES_EACH, Stages, StepFields
from ccd_warp._engine.topology import MOST_COPIED, WIDTH, Positions
from ccd_warp._engine.trees import TreePair, sampled_pairs_of, search_options, tree_pairs_of, trees_of
from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.pair_queue import QUEUE_BYTES, queue_of
from ccd_warp._status import PairKind
from ccd_warp.kernels.narrow_phase.sinks import BOUND, CONTACTS, DISPLACEMENT, HOLD, NEAR
from ccd_warp.kernels.pair.norm import EUCLIDEAN_NORM
from ccd_warp.kernels.step.minima import CANDIDATES, FOUND, NUM_COUNTS, OPEN, Minima
from ccd_warp.kernels.step.step import ContactList

if TYPE_CHECKING:
    from ccd_warp._engine.workspace import Workspace
    from ccd_warp._input.options import Options

# What a call looks for: all contacts, the least toi alone, candidate pairs; or at one time what intersects, what
# is near, how far vertices may move, or how near they are to anything.
Goal = Literal["contacts", "bound", "candidates", "intersections", "proximities", "displacements", "holds"]
_AT_ONE_TIME = ("proximities", "displacements", "holds")
# The least capacity for pairs of a kind, and how much more than what was found the next one is.
_LEAST_CAPACITY = 1 << 12
_GROWTH = 1.25
# Queries of a tree pair, and the pairs of them that are kept, where a few are likely to show a toi of 0.
_FEW_QUERIES, _FEW_PAIRS = 16, 1 << 14
# Plans that a workspace keeps, enough for the different kinds of calls in a loop.
_MOST_PLANS = 8
_NONE = dict.fromkeys(PairKind, 0)
_COUNTS_SHAPE = len(PairKind), int(NUM_COUNTS)
_NUM_ALL_COUNTS = len(PairKind) * int(NUM_COUNTS)
_OnHost = tuple[NDArray[np.int64], NDArray[np.float64]]
_POSITIONS = ("vertices_t0", "vertices_t1")
_OF_STEP = (*_POSITIONS, "contacts")  # fields of the struct of a step that are slots


@dataclass(frozen=True)
class Batch:
    """Pairs whose keys the search has just written.

    Attributes:
        found: Number of pairs by kind.
        is_only: Whether these are all pairs of the search.
    """

    found: dict[PairKind, int]
    is_only: bool


@dataclass(frozen=True)
class _Part:
    """Items of a tree pair: blocks of queries (level 1) or single queries (level 0)."""

    tree_pair: TreePair
    level: int
    items: range

    @property
    def num_queries(self) -> int:
        """Number of query boxes."""
        return len(self.items) * WIDTH**self.level

    def split(self, count: int) -> "list[_Part]":
        """These items in at least ``count`` parts, as far as that is possible."""
        if len(self.items) == 1 and self.level == 1:
            first = WIDTH * self.items[0]
            queries = range(first, min(first + WIDTH, self.tree_pair.query.primitives.count))
            return _Part(self.tree_pair, 0, queries).split(count)
        count = min(count, len(self.items))
        bounds = (len(self.items) * k // count for k in range(count + 1))
        return [_Part(self.tree_pair, self.level, self.items[i:j]) for i, j in itertools.pairwise(bounds)]


class HostPlan:
    """What a workspace keeps for calls with one goal, of the same pair kinds, precision and number of threads.

    Attributes:
        execution: Where its stages run.
        kinds: Kinds of pairs that the mesh can form and the options select.
        tree_pairs: The tree pairs, or the pairs of spatial hashes, that are searched.
        most_partners: Number of primitives in the largest set in which partners are searched.
        num_searches: Searches of a tree pair, or of a part of one, in this step, by kind.
        num_candidates: Pairs of each kind whose boxes overlap, in the last search.
        num_batches: Number of batches of this step.
    """

    @staticmethod
    def of(workspace: "Workspace", options: "Options", goal: Goal, *, is_held: bool = False) -> "HostPlan":
        """The plan of a workspace for such calls; ``is_held`` is whether some pairs start within their distance."""
        key = (goal, options.pair_kinds, options.precision, options.norm, options.threads, options.broad_phase, is_held)
        if key not in workspace.plans:
            if len(workspace.plans) >= _MOST_PLANS:
                workspace.plans.clear()
            workspace.plans[key] = HostPlan(workspace, options, goal, is_held)
        return workspace.plans[key]

    def __init__(self, workspace: "Workspace", options: "Options", goal: Goal, is_held: bool = False) -> None:
        self._workspace = workspace
        self._buffers = workspace.buffers
        self._boxes = workspace.boxes
        topology = self._topology = workspace.topology
        mesh = topology.mesh
        self.execution = Execution(topology.device, options.threads, workspace.flag, workspace.progress)
        self.kinds = possible_kinds(mesh, options) if topology.kinds is None else topology.kinds
        sought = topology, self.kinds, mesh._is_free_alone
        broad_phase = BROAD_PHASES["tree" if goal == "intersections" else options.broad_phase]
        kept = self._boxes.sets[broad_phase], broad_phase
        tree_pairs = tree_pairs_of(*sought, *kept)
        has_sample = goal == "bound" and topology.samples_queries
        sampled = sampled_pairs_of(tree_pairs, topology, *kept) if has_sample else []
        self.tree_pairs, self._sampled_pairs = broad_phase.searches(tree_pairs), broad_phase.searches(sampled)
        self.most_partners = max((tree_pair.target.primitives.count for tree_pair in self.tree_pairs), default=0)
        self.trees = trees_of(self.tree_pairs + self._sampled_pairs)
        self._moving = [tree for tree in self.trees if not tree.primitives.is_static]
        has_narrow_phase = goal in ("contacts", "bound")
        # the search of CUDA lists candidates in trees of endpoint AABBs alone
        is_culled = has_narrow_phase or goal in _AT_ONE_TIME or (self.execution.is_cuda and goal == "intersections")
        self._num_aabbs = 2 if is_culled else 1
        self._searched_kinds = list(dict.fromkeys(tree_pair.kind for tree_pair in self.tree_pairs))
        self._capacities = dict.fromkeys(self._searched_kinds, 0)
        self._keys_base: wp.array | None = None  # the array that is divided among the kinds
        self._excess: dict[str, Mapping[PairKind, int]] = {}  # pairs of the last step that was searched in parts
        self._norm = norm_of(mesh, options, is_held=is_held)
        if goal in ("proximities", "displacements"):
            self._norm = EUCLIDEAN_NORM
        self._search_values: tuple[float, ...] | None = None
        self._are_copied = topology.device.is_cuda or mesh.num_vertices <= MOST_COPIED
        self._sink = int(BOUND if goal == "bound" else CONTACTS)  # of the narrow phase
        self._keeps_toi = goal == "bound"
        self._has_queue = self.execution.is_cuda and has_narrow_phase
        self.has_planes = PairKind.VERTEX_PLANE in self.kinds
        self._queue_arrays: list[wp.array] = []
        # the counts of each kind, and then the bits of the least toi: one array, which CUDA reads at once
        self._counters: wp.array = wp.zeros(_NUM_ALL_COUNTS + 1, dtype=wp.int64, device=topology.device)
        self._counts = self._counters[:_NUM_ALL_COUNTS].reshape(_COUNTS_SHAPE)
        self._least_bits = self._counters[_NUM_ALL_COUNTS:]
        self._view = None if self.execution.is_cuda else _split(self._counters.numpy())
        self._read: _OnHost | None = None  # on CUDA, as long as nothing is launched that changes them
        self.begin_counts()

        names = ["vertex_aabbs", "quantization", "t_end", "inflation"]
        names += ["search options", "options", "queue", "plane query", "reach", "proximities"]
        boxes = {tree.name: tuple(map(Slot, tree.slots)) for tree in self.trees}
        keys = {kind: Slot(f"{kind.name} keys") for kind in self._searched_kinds}
        candidates = {kind: Slot(f"{kind.name} candidates") for kind in self._searched_kinds}
        open_toi = {kind: Slot(f"{kind.name} open toi") for kind in self._searched_kinds}
        slots = [*itertools.chain(*boxes.values()), *keys.values(), *candidates.values(), *open_toi.values()]
        slot_names = [*_OF_STEP, *names, *(slot.name for slot in slots)]
        self._recording = Recording(self.execution, dict.fromkeys(slot_names) | {"contacts": ContactList()})
        self._stages = Stages(
            topology,
            self.tree_pairs,
            self._num_aabbs,
            narrow_phase_on(topology.device, options.real, self._norm) if has_narrow_phase else None,
            StepFields(
                self._counts,
                Slot("vertices_t0"),
                Slot("vertices_t1"),
                self._minima(goal),
                Slot("contacts"),
                self._least_bits,
            ),
            **{name.replace(" ", "_"): Slot(name) for name in names},
            box_radius=topology.box_radius,
            is_thick=topology.is_thick,
            boxes=boxes,
            keys=keys,
            candidates=candidates,
            open_toi=open_toi,
        )
        if has_narrow_phase and self.tree_pairs:
            self._stages.load(self.execution, self._sink)

    def _minima(self, goal: Goal) -> Any:
        """The minima that calls with a goal lower; of the others only which vertex is in which world is read."""
        if goal in ("contacts", *_AT_ONE_TIME):
            return self._workspace.contacts.minima
        minima = Minima()
        minima.vertex_world = self._topology.vertex_world
        return minima

    @property
    def key_bytes(self) -> int:
        """Bytes of the key of a pair; on CUDA also of its place in the queue, and of candidates listed for it."""
        return KEY_BYTES * (1 + CANDIDATES_EACH) + QUEUE_BYTES if self.execution.is_cuda else KEY_BYTES

    @property
    def most_pairs(self) -> int:
        """Largest number of pairs in a batch."""
        return MOST_PAIRS // CANDIDATES_EACH if self.execution.is_cuda else MOST_PAIRS

    def begin_counts(self) -> None:
        """Forget the counts of the last step."""
        self.num_searches = dict(_NONE)
        self.num_batches = self._num_met_by_planes = 0
        self.begin_candidates()

    def begin_candidates(self) -> None:
        """Count the candidates of the next search."""
        self.num_candidates = _NONE | {PairKind.VERTEX_PLANE: self._num_met_by_planes}

    def play(self, section: str, record: Callable[[Stages, Recording], None]) -> None:
        """Run a section of the recording; ``record`` records it at its first use."""
        if section not in self._recording:
            with self._recording.section(section):
                record(self._stages, self._recording)
        self._read = None
        self._recording.play(section)

    def set_positions(self, positions: Positions) -> tuple[wp.array, wp.array]:
        """Use the positions of a step, and return them on the device."""
        arrays = []
        for name, values in zip(_POSITIONS, positions, strict=True):
            if self._are_copied:
                arrays.append(self._workspace.positions(name, values))
            else:
                arrays.append(wp.array(values, dtype=wp.vec3d, device=self._topology.device, copy=False))
            self._recording.bind(name, arrays[-1])
        return arrays[0], arrays[1]

    def release_positions(self) -> None:
        """Do not keep the caller's arrays alive."""
        for name in () if self._are_copied else _POSITIONS:
            self._recording.release(name)

    def set_plane_query(self, query: Any) -> None:
        """Ask this of vertices and planes."""
        self._recording.bind("plane query", query)

    def meet_planes(self) -> int:
        """Let vertices meet planes; returns the number of pairs that touch."""
        return self._play_planes("planes", lambda stages, recording: stages.meet_planes(recording, self._sink))

    def _play_planes(self, section: str, record: Callable[[Stages, Recording], None]) -> int:
        self._clear_counts()
        self.play(section, record)
        kind = PairKind.VERTEX_PLANE
        self._num_met_by_planes = int(self.counts()[kind, FOUND])
        self.num_searches[kind], self.num_candidates[kind] = 1, self._num_met_by_planes
        return self._num_met_by_planes

    def set_contacts(self, contacts: Any) -> None:
        """Append contacts to this list."""
        self._recording.bind("contacts", contacts)

    def set_reach(self, reach: Any) -> None:
        """Look for what is so near."""
        self._recording.bind("reach", reach)

    def set_proximities(self, proximities: Any) -> None:
        """Append what is near to this list."""
        self._recording.bind("proximities", proximities)

    def set_options(self, options: Any) -> None:
        """Use these options in the narrow phase."""
        self._recording.bind("options", options)

    def fill_boxes(self, positions: Positions, t_end: float, inflation: float, active: wp.array) -> None:
        """Compute the boxes of a step over [0, t_end]; those of bodies that are not active are empty."""
        boxes, recording = self._boxes, self._recording
        boxes.begin(positions, inflation, self._num_aabbs, self.trees, self.execution)
        recording.bind("quantization", boxes.quantization.packed)
        recording.bind("vertex_aabbs", boxes.vertex_aabbs)
        recording.bind("inflation", inflation)
        self._active = active
        self._bind_trees()
        if not self.trees:
            return  # no pairs but those with half-spaces, which have no boxes
        self._fill_vertex_aabbs(t_end)
        is_sorted = self.trees[0].is_sorted_when_filled
        if is_sorted or not self.execution.is_cuda:
            self._fill_trees()
        if not is_sorted and any([boxes.keep_in_order(tree, self.execution) for tree in self._moving]):
            self._bind_trees()

    def shorten_boxes(self, t_end: float) -> None:
        """Compute the boxes over [0, t_end] alone; the order of the trees stays."""
        if not self.trees:
            return
        self._fill_vertex_aabbs(t_end)
        self._fill_trees()

    def _fill_vertex_aabbs(self, t_end: float) -> None:
        self._recording.bind("t_end", t_end)
        moving = self._topology.moving_vertices
        self.play("vertex AABBs", lambda stages, recording: stages.fill_vertex_aabbs(recording, moving, self._active))

    def _fill_trees(self) -> None:
        self.play("boxes", lambda stages, recording: stages.fill_boxes(recording, self._moving))

    def _bind_trees(self) -> None:
        for tree in self.trees:
            for slot, struct in zip(tree.slots, tree.structs, strict=True):
                self._recording.bind(slot, struct)

    def may_meet(self, tree_pair: TreePair) -> bool:
        """Whether the boxes around two trees overlap; only a static tree may be far from the others for long."""
        query, target = tree_pair.query, tree_pair.target
        return not target.primitives.is_static or self._boxes.may_meet(query, target)

    def set_search(self, t_end: float, inflation: float, separation: float) -> Any:
        """Search for pairs that touch before ``t_end``; returns the options of the search."""
        values = (t_end, inflation, separation)
        if values != self._search_values:
            radii = self._topology.radius, self._topology.box_radius
            self._recording.bind("search options", search_options(*values, self._norm, self._workspace.flag, radii))
            self._search_values = values
        return self._recording.values["search options"]

    def batches(self, largest: int, *, of_sample: bool = False) -> Iterator[Batch]:
        """Search all pairs, or those of a sample of the queries, and yield what the cull leaves in batches.

        The first search tells how many pairs there are. If they are more than the capacity, which grows up to
        ``largest`` pairs, it is repeated; if they are more than these, in parts. Where the last step had so many, the
        search is in parts from the beginning.
        """
        section, tree_pairs = ("pairs of a sample", self._sampled_pairs) if of_sample else ("pairs", self.tree_pairs)
        if not tree_pairs:
            return
        if section in self._excess:
            yield from self._batches_of_parts(section, tree_pairs, largest, self._excess[section])
            return
        self._reserve(tree_pairs, largest)
        self._meets = [self.may_meet(tree_pair) for tree_pair in tree_pairs]
        while True:
            for tree_pair, meets in zip(tree_pairs, self._meets, strict=True):
                self.num_searches[tree_pair.kind] += meets
            self._clear_counts()
            self.play(section, lambda stages, recording: self._record_search(stages, recording, tree_pairs))
            needed = self._num_needed()
            if all(needed[kind] <= self._capacities[kind] for kind in self._searched_kinds):
                yield self._batch(self._num_found() if self.execution.is_cuda else needed, is_only=True)
                return
            least = {kind: max(n, 1) for kind, n in needed.items()}  # of an array Warp takes no part of no elements
            if sum(least.values()) > largest:
                break
            grown = {kind: max(int(_GROWTH * n), _LEAST_CAPACITY) for kind, n in needed.items()}
            self._set_capacities(grown if sum(grown.values()) <= largest else least)
        yield from self._batches_of_parts(section, tree_pairs, largest, needed)

    def few_batches(self, largest: int) -> Iterator[Batch]:
        """Batches of a few queries of each tree pair, of at most ``largest`` pairs; further pairs of them are left."""
        largest = min(largest, _FEW_PAIRS)
        self._share_capacity(largest)
        stages = self._stages.with_values(self._recording.values)
        for tree_pair in filter(self.may_meet, self.tree_pairs):
            count = tree_pair.query.primitives.count
            self._clear_counts()
            stages.search(self.execution, tree_pair, range(0, count, -(-count // _FEW_QUERIES)), level=0)
            if self.execution.is_cuda:
                stages.cull(self.execution, tree_pair.kind)
            self.num_searches[tree_pair.kind] += 1
            found = {kind: min(count, largest) for kind, count in self._num_found().items()}
            if found[tree_pair.kind] > 0:
                yield self._batch(found, is_only=False)

    def _record_search(self, stages: Stages, recording: Recording, tree_pairs: list[TreePair]) -> None:
        with recording.at_once():
            for number, tree_pair in enumerate(tree_pairs):
                items = range(self._num_items(tree_pair))
                stages.search(recording, tree_pair, items, is_needed=lambda k=number: self._meets[k])  # type: ignore[misc]
        if recording.is_cuda:
            for kind in stages.kinds:
                stages.cull(recording, kind)

    def _num_items(self, tree_pair: TreePair) -> int:
        return tree_pair.query.primitives.count if self.execution.is_cuda else tree_pair.query.levels[0]

    def _batches_of_parts(
        self, section: str, tree_pairs: list[TreePair], largest: int, expected: Mapping[PairKind, int]
    ) -> Iterator[Batch]:
        """Batches of at most ``largest`` pairs, given how many there may be of each kind."""
        level = 0 if self.execution.is_cuda else 1
        pending: deque[_Part] = deque()
        for tree_pair in filter(self.may_meet, tree_pairs):
            items = range(self._num_items(tree_pair))
            pending += _Part(tree_pair, level, items).split(_pieces(expected[tree_pair.kind], largest))
        total = sum(part.num_queries for part in pending)
        total_needed: Counter[PairKind] = Counter()
        self._share_capacity(largest)
        stages = self._stages.with_values(self._recording.values)
        done = 0
        while pending:
            part = pending.popleft()
            self.execution.progress.begin("pairs", total, done)
            self._clear_counts()
            stages.search(self.execution, part.tree_pair, part.items, level=part.level)
            if self.execution.is_cuda:
                stages.cull(self.execution, part.tree_pair.kind)
            self.num_searches[part.tree_pair.kind] += 1
            needed = self._num_needed()[part.tree_pair.kind]
            if needed > largest:
                pending.extendleft(reversed(part.split(_pieces(needed, largest))))
                continue
            found = self._num_found()
            done += part.num_queries
            total_needed[part.tree_pair.kind] += needed
            batch = self._batch(found, is_only=False)
            if found[part.tree_pair.kind] > 0:
                yield batch
        if total_needed.total() > largest:
            self._excess[section] = total_needed
        else:
            self._excess.pop(section, None)

    def _batch(self, found: dict[PairKind, int], is_only: bool) -> Batch:
        """A batch, after it is counted."""
        self.num_batches += 1
        counts = self.counts()[:, CANDIDATES].tolist()
        for kind in self._searched_kinds:
            self.num_candidates[kind] += counts[kind]
        return Batch(found, is_only)

    def _on_host(self) -> _OnHost:
        """The counts and the least toi; on CUDA this waits for the device, once after what has changed them."""
        if self._view is not None:
            return self._view
        if self._read is None:
            self._read = _split(self._counters.numpy())
        return self._read

    def counts(self) -> NDArray[np.int64]:
        """The counts of the pairs of each kind; on CUDA those after the last launch."""
        return self._on_host()[0]

    def _num_found(self) -> dict[PairKind, int]:
        counts = self.counts()[:, FOUND].tolist()
        return {kind: counts[kind] for kind in self._searched_kinds}

    def _num_needed(self) -> dict[PairKind, int]:
        """The capacity for pairs that the search needs; on CUDA for its candidates, too."""
        needed = self._num_found()
        if self.execution.is_cuda:
            counts = self.counts()
            return {kind: max(n, -(-int(counts[kind, CANDIDATES]) // CANDIDATES_EACH)) for kind, n in needed.items()}
        return needed

    def num_open(self) -> dict[PairKind, int]:
        """Number of pairs that the first round of the narrow phase has left open, by kind."""
        counts = self.counts()[:, OPEN].tolist()
        return {kind: counts[kind] for kind in self._searched_kinds if counts[kind]}

    def _clear_counts(self) -> None:
        self._read = None
        if self._view is None:
            self._counts.zero_()
        else:
            self._view[0].fill(0)

    def _reserve(self, tree_pairs: list[TreePair], largest: int) -> None:
        """Have capacity for the pairs of the last step, at first for one pair of each query."""
        wanted = self._capacities
        if not all(wanted.values()):
            wanted = dict.fromkeys(self._searched_kinds, 0)
            for tree_pair in tree_pairs:
                wanted[tree_pair.kind] += tree_pair.query.primitives.count
            wanted = {kind: max(count, _LEAST_CAPACITY) for kind, count in wanted.items()}
        total = sum(wanted.values())
        if total > largest:
            wanted = {kind: max(count * largest // total, 1) for kind, count in wanted.items()}
        if wanted != self._capacities or self._buffers.get("keys", 0, wp.int64) is not self._keys_base:
            self._set_capacities(wanted)

    def _set_capacities(self, capacities: dict[PairKind, int]) -> None:
        """Divide the memory for pairs among the kinds."""
        total = sum(capacities.values())
        keys = self._buffers.get("keys", total, wp.int64)
        toi = self._buffers.get("keys toi", total, wp.float64) if self._keeps_toi else None
        candidates = self._candidates(total)
        begin = 0
        for kind, capacity in capacities.items():
            if candidates is not None:
                listed = candidates[CANDIDATES_EACH * begin : CANDIDATES_EACH * (begin + capacity)]
                self._recording.bind(f"{kind.name} candidates", listed)
            self._set_keys(kind, keys[begin : begin + capacity], None if toi is None else toi[begin : begin + capacity])
            begin += capacity
        self._capacities, self._keys_base = capacities, keys
        self._set_queue(max(capacities.values(), default=0))

    def _share_capacity(self, largest: int) -> None:
        """Let every kind use all the memory, one at a time."""
        keys = self._buffers.get("keys", largest, wp.int64)
        toi = self._buffers.get("keys toi", largest, wp.float64) if self._keeps_toi else None
        candidates = self._candidates(largest)
        for kind in self._searched_kinds:
            if candidates is not None:
                self._recording.bind(f"{kind.name} candidates", candidates)
            self._set_keys(kind, keys, toi)
        self._keys_base = None
        self._set_queue(largest)

    def _set_queue(self, count: int) -> None:
        """Have capacity for so many pairs of a kind in the queue."""
        if self._has_queue:
            dtypes = {"keys rows": wp.int32, "keys time": wp.float64, "keys used": wp.int8}
            arrays = [self._buffers.get(name, count, dtype) for name, dtype in dtypes.items()]
            if self._queue_arrays != arrays:
                self._queue_arrays = arrays
                self._recording.bind("queue", queue_of(*arrays))

    def _candidates(self, capacity: int) -> wp.array | None:
        """Memory for the candidates of so many pairs, on CUDA."""
        if not self.execution.is_cuda:
            return None
        return self._buffers.get("keys candidates", CANDIDATES_EACH * capacity, wp.int64)

    def _set_keys(self, kind: PairKind, keys: wp.array, toi: wp.array | None) -> None:
        self._recording.bind(f"{kind.name} keys", keys)
        if toi is not None:
            self._recording.bind(f"{kind.name} open toi", toi)

    def solve(self, *, is_second: bool) -> None:
        """A round of the narrow phase on the pairs of a batch."""
        section = "narrow phase, second round" if is_second else "narrow phase"
        self.play(section, lambda stages, recording: stages.solve(recording, self._sink, is_second=is_second))

    def list_near_planes(self) -> int:
        """List the planes that are near vertices; returns the number of pairs."""
        return self._play_planes("planes", lambda stages, recording: stages.list_near_planes(recording))

    def bound_by_half_spaces(self) -> int:
        """Lower the bounds of vertices beside planes; returns the number of pairs."""
        return self._play_planes("planes", lambda stages, recording: stages.bound_by_half_spaces(recording))

    def list_proximities(self) -> None:
        """List the pairs of a batch that are near."""
        self.play("distances", lambda stages, recording: stages.measure_pairs(recording, NEAR, self._norm))

    def lower_holds(self) -> None:
        """Lower the holds of the vertices of the pairs of a batch."""
        self.play("distances", lambda stages, recording: stages.measure_pairs(recording, HOLD, self._norm))

    def bound_displacements(self) -> None:
        """Lower the bounds of the vertices of the pairs of a batch."""
        self.play("distances", lambda stages, recording: stages.measure_pairs(recording, DISPLACEMENT, self._norm))

    def some_keys(self, kind: PairKind, count: int, most: int) -> NDArray[np.int64]:
        """Keys of at most ``most`` of the ``count`` pairs of a batch that the narrow phase has not marked yet."""
        keys = self._recording.values[f"{kind.name} keys"][:count]
        return keys[:: max(1, -(-count // most))].numpy()

    def found_keys(self, kind: PairKind, count: int) -> wp.array:
        """The keys of a batch, which has so many of a kind."""
        keys: wp.array = self._recording.values[f"{kind.name} keys"][:count]
        return keys

    def replace_keys(self, kind: PairKind, keys: NDArray[np.int64]) -> None:
        """Let a batch consist of these pairs of a kind, some of those that it has."""
        if len(keys):
            self.found_keys(kind, len(keys)).assign(keys)
        counts = self.counts()
        counts[kind, FOUND] = len(keys)
        if self._view is None:
            self._counts.assign(counts)

    def open_keys(self, kind: PairKind, count: int) -> NDArray[np.int64]:
        """The marked keys of the open pairs among the first ``count`` of a batch."""
        keys = self._recording.values[f"{kind.name} keys"][:count].numpy()
        return keys[keys < 0]

    def open_pairs(self, kind: PairKind, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The marked keys of the same pairs, and their toi so far."""
        keys, toi = (self._recording.values[f"{kind.name} {name}"][:count].numpy() for name in ("keys", "open toi"))
        return keys[keys < 0], toi[keys < 0]

    def set_number_open(self, num_open: Mapping[PairKind, int]) -> None:
        """Let the open pairs of a kind share their work with others: so many of them in all."""
        counts = self.counts()
        for kind, count in num_open.items():
            counts[kind, OPEN] = count
        if self._view is None:
            self._counts.assign(counts)

    def set_open_pairs(self, kind: PairKind, keys: NDArray[np.int64], num_open: int) -> None:
        """Make these marked keys the pairs of the second round, which share the work of so many."""
        pairs = self._buffers.get("open keys", len(keys), wp.int64)
        pairs[: len(keys)].assign(keys)
        self._set_keys(kind, pairs, None)
        self._keys_base = None
        self._set_queue(len(keys))
        counts = np.zeros(self._counts.shape, dtype=np.int64)
        counts[kind, FOUND], counts[kind, OPEN] = len(keys), num_open
        self._counts.assign(counts)
        self._read = None

    def reset_minima(self, num_contacts: wp.array) -> None:
        """Set every toi to infinity."""

        def record(stages: Stages, recording: Recording) -> None:
            stages.reset(recording, num_contacts, self._workspace.flag.array)
            stages.reset_vertices(recording)

        self.play("reset", record)

    def set_least(self, toi: float) -> None:
        """Set the least toi so far."""
        if self._view is None:
            self._least_bits.assign(np.array([toi]).view(np.int64))
            self._read = None
        else:
            self._view[1][0] = toi

    def least(self) -> float:
        """The least toi so far."""
        return float(self._on_host()[1][0])


def _split(counters: NDArray[np.int64]) -> _OnHost:
    """The counts and the least toi of an array of both."""
    return counters[:_NUM_ALL_COUNTS].reshape(_COUNTS_SHAPE), counters[_NUM_ALL_COUNTS:].view(np.float64)


def _pieces(count: int, largest: int) -> int:
    """Number of parts in which so many pairs are likely to fit one by one, at least two."""
    return max(2, -(-3 * count // (2 * largest)))
