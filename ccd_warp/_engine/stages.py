"""The stages of a step, each written once: a driver gives them an `Execution`, or a `Recording` to record them in."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import warp as wp

from ccd_warp._engine.boxes.box_sets import BoxSet
from ccd_warp._engine.boxes.trees import LONG_SEARCH, MOST_QUERIES, TreePair, range_of_warps, search_range
from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._engine.mesh.topology import CORNER_ARRAYS, WIDTH, Topology
from ccd_warp._runtime.lanes import lanes_of, queued_kernels, search_on
from ccd_warp._runtime.launch import Execution, Recording, Slot, StructFields, fields_of, load_all
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.pair_queue import launch_queued
from ccd_warp._runtime.status import PairKind
from ccd_warp.kernels.boxes import body_frames, box_tree, half_warp_tree, rest_order
from ccd_warp.kernels.narrow_phase.sinks import BOUND, CONTACTS, DISPLACEMENT, NEAR, START_DISTANCE, Table
from ccd_warp.kernels.narrow_phase.whole_warp import WARP
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.pair.turns import Turns
from ccd_warp.kernels.search.search_types import BOXES, CULL, LIST, Candidates, Searched
from ccd_warp.kernels.step import contacts, device_step
from ccd_warp.kernels.step.minima import FOUND, OPEN
from ccd_warp.kernels.step.pair_list import LeastToi, PairList, Round
from ccd_warp.kernels.step.step import Step
from ccd_warp.kernels.template import specialised

Launcher = Execution | Recording
# Parts of a search for each CPU thread, and the fewest blocks of queries that are worth a part.
_PARTS_PER_THREAD = 8
_SMALLEST_SEARCH = 64
# The most blocks of queries that are one part of a search, whose pairs are in the order of the boxes.
MOST_IN_ORDER = 2 * _SMALLEST_SEARCH - 1
# Largest number of CUDA threads that share the candidates of a kind; and of warps that search for the candidates
# of a tree pair again if they exceeded the list, so few that a launch takes no time where they did not.
_MOST_CULLS = 1 << 17
_MOST_REST = 1 << 11
# What a launch on CUDA searches, culls and solves: two trees, pairs of two kinds.
KINDS_AT_ONCE = 2
# Pairs for which a recording on CUDA has threads, where their number is not known then: as many as there ever are.
_MANY_PAIRS = 1 << 20
# On the CPU: solvers for each thread; and pairs that a solver takes one after another, so that it finds their vertices
# in the cache.
_SOLVERS_PER_THREAD = 8
_CHUNK = 128
# Pairs above which a solver may take long: some 0.4 s if all reach the limit of the first round.
_LONG_PART = 1 << 11


# Structs of kernels by their fields, some of which may be slots.
StepFields, PairFields, LeastFields = fields_of(Step), fields_of(PairList), fields_of(LeastToi)
SearchedFields, CandidateFields = fields_of(Searched), fields_of(Candidates)


def measure_pairs_in(norm: Norm, device: wp.Device) -> Any:
    """The kernel that takes the place of the narrow phase at one time, for distances in a norm."""
    parameters = {"width": lanes_of(device)} if norm.is_ball else {}
    return specialised("at_one_time.measure_pairs", norm=norm.shape, **parameters).measure_pairs


def _groups(items: Sequence[Any], size: int = KINDS_AT_ONCE) -> Iterator[Any]:
    """The items, so many at a time."""
    return (items[k : k + size] for k in range(0, len(items), size))


@dataclass(frozen=True)
class Stages:
    """The launches of a step. Everything from ``step`` on may be a slot of a recording, or have such fields.

    Attributes:
        topology: The mesh on its device.
        tree_pairs: The tree pairs to search.
        num_aabbs: AABBs of a box: 1, the swept AABB; 2, the endpoint AABBs.
        narrow_phase: The kernels of ``narrow_phase`` for a precision.
        is_clipping: Whether they solve pairs by clips of time.
        step: The positions, and what is found of the step.
        vertex_aabbs: AABBs of the vertices.
        boxes: The structs of each tree or spatial hash, by its name.
        keys: Keys of the pairs that the search finds, by kind.
        candidates: On CUDA, keys of the candidates that the search lists for the cull, by kind.
        quantization: The map to quantized coordinates.
        t_end: End of the vertex AABBs, a fraction of the step.
        inflation: Enlargement of the boxes, a length.
        box_radius: By how much the boxes of each vertex grow besides; empty where there are no radii.
        is_thick: Whether each pair has a distance of its own.
        search_options: What the search is asked for.
        options: What the narrow phase is asked for.
        ranges: Of a search for all pairs whose boxes overlap, on the CPU, how many keys of a kind it may write.
        open_toi: Beside each key of a pair that the first round leaves open its toi so far, where no contacts are kept.
        queue: On CUDA, the queue of open pairs of a kind, one for all kinds.
        plane_query: What vertices and planes are asked for; None where there are no half-spaces.
        turns: How vertices turn in a slice of the step; None where no body turns.
        plane_radius: Where bodies turn, `box_radius` without what is added for their arcs.
        reach: At one time, how near is near.
        proximities: The list of pairs within that.
        start_distances: Bits of the share and the length that each vertex keeps, int64, shape [2 V].
    """

    topology: Topology
    tree_pairs: list[TreePair]
    num_aabbs: int
    narrow_phase: Any
    is_clipping: bool
    step: Any
    vertex_aabbs: Any
    boxes: dict[str, tuple[Any, ...]]
    keys: dict[PairKind, Any]
    candidates: dict[PairKind, Any]
    quantization: Any
    t_end: Any
    inflation: Any
    box_radius: Any
    is_thick: bool
    search_options: Any
    options: Any
    ranges: dict[PairKind, Any] = field(default_factory=dict)
    open_toi: dict[PairKind, Any] = field(default_factory=dict)
    queue: Any = None
    plane_query: Any = None
    turns: Any = None
    plane_radius: Any = None
    reach: Any = None
    proximities: Any = None
    start_distances: Any = None
    largest_block: Any = None

    @property
    def kinds(self) -> list[PairKind]:
        """The kinds of pairs that are searched."""
        return list(self.keys)

    def between(self, vertices_t0: Any, vertices_t1: Any) -> "Stages":
        """These stages, of a step between other positions."""
        return replace(self, step=replace(self.step, vertices_t0=vertices_t0, vertices_t1=vertices_t1))

    def with_values(self, values: dict[str, Any]) -> "Stages":
        """Stages with values in place of slots, for an `Execution`."""

        def value(of: Any) -> Any:
            if isinstance(of, dict):
                return {name: value(attribute) for name, attribute in of.items()}
            if isinstance(of, tuple):
                return tuple(map(value, of))
            if isinstance(of, StructFields):
                return of.packed(values)
            return values[of.name] if isinstance(of, Slot) else of

        return replace(self, **{attribute.name: value(getattr(self, attribute.name)) for attribute in fields(self)})

    def load(self, launcher: Launcher, sink: int) -> None:
        """Load what a step with a narrow phase launches, side by side where it has to be compiled."""
        if self.narrow_phase is None or not self.tree_pairs:
            return
        narrow_phase, query = self.narrow_phase, self.tree_pairs[0].query
        if launcher.is_cuda:
            solvers = [*self._queued_kernels(sink).values()]
            others = [specialised("search.candidate_cull", is_thick=self.is_thick).cull_candidates]
        else:
            solvers = [narrow_phase.solve_pairs]
            others = [contacts.first_contacts] if sink == CONTACTS else []
            others += [device_step.reset, box_tree.fill_vertex_aabbs]
            others += [] if query.is_sorted_when_filled else [rest_order.fill_centres]
        others += [body_frames.fill_frame_aabbs] if self._has_slender else []
        search = self.search_kernel(self.tree_pairs[0], LIST if launcher.is_cuda else CULL, is_cuda=launcher.is_cuda)
        # the first to be compiled makes Warp's header for all: one that begins soon, with the solver
        load_all([*solvers[::-1], others[0], search, *others[1:]], launcher.device, launcher.progress)

    def fill_vertex_aabbs(self, launcher: Launcher, vertices: wp.array, active: wp.array) -> None:
        """Compute the AABBs of the given vertices, empty ones for those of bodies that are not active."""
        launcher.launch(
            box_tree.fill_vertex_aabbs,
            len(vertices),
            inputs=[
                vertices,
                *self.topology.of_vertices(active),
                self.step.vertices_t0,
                self.step.vertices_t1,
                self.t_end,
                self.inflation,
                self.box_radius,
                self.quantization,
                self.num_aabbs,
            ],
            outputs=[self.vertex_aabbs],
        )

    def fill_boxes(self, launcher: Launcher, sets: list[BoxSet], only_if: wp.array | None = None) -> None:
        """Compute the boxes of sets from the AABBs of the vertices; with a flag on the device only where it is set."""
        if sets:
            sets[0].fill(sets, self.vertex_aabbs, launcher, lambda box_set: self.boxes[box_set.name], only_if)

    def count_large_blocks(self, launcher: Launcher, tree: Any, counters: wp.array, cell: int) -> None:
        """On CUDA, count in a cell how many blocks of a sample of a tree are too large to consist of neighbours."""
        places: wp.array = wp.array(tree.places_of_some_blocks(), dtype=wp.int32, device=launcher.device)
        inputs = [places, self.largest_block, cell, counters]
        launcher.launch(half_warp_tree.count_large_blocks, places.shape[2], inputs, list(self.boxes[tree.name]))

    def fill_slender(self, launcher: Launcher, sets: list[BoxSet], active: wp.array) -> None:
        """Compute the boxes for pairs within slender bodies, after all others, whose AABBs of vertices they replace."""
        if sets:
            topology = self.topology
            of_vertices = [topology.slender_vertices, topology.vertex_body, active, topology.body_frames]
            positions = [self.step.vertices_t0, self.step.vertices_t1]
            launcher.launch(
                body_frames.fill_frame_aabbs,
                len(topology.slender_vertices),
                inputs=[*of_vertices, *positions, self.t_end, self.inflation, self.box_radius],
                outputs=[self.vertex_aabbs],
            )
            self.fill_boxes(launcher, sets)

    @property
    def _has_slender(self) -> bool:
        """Whether pairs within slender bodies have a search of their own."""
        return any(tree_pair.query.primitives.role == "slender" for tree_pair in self.tree_pairs)

    def reset(
        self,
        launcher: Launcher,
        num_contacts: wp.array,
        stop: wp.array,
        kept_flags: int = 0,
        *,
        keeps_toi: bool = False,
    ) -> None:
        """Set every toi but those of the vertices to infinity, and all counts to 0; see also ``reset_vertices``."""
        mesh = self.topology.mesh
        launcher.launch(
            device_step.reset,
            max(mesh.num_bodies, mesh.num_worlds, len(PairKind)),
            inputs=[kept_flags, int(keeps_toi)],
            outputs=[self.step.minima, self.step.counts, num_contacts, stop],
        )

    def reset_vertices(self, launcher: Launcher) -> None:
        """Set the toi of every vertex to infinity, or to 0 in a world with a coordinate that is not finite."""
        mesh = self.topology.mesh
        launcher.launch(device_step.reset_vertices, mesh.num_vertices, inputs=[], outputs=[self.step.minima])

    def find_pairs(
        self,
        recording: Recording,
        tree_pairs: list[TreePair],
        *,
        is_needed: Callable[[int], bool] | None = None,
        is_any_unlisted: wp.array | None = None,
    ) -> None:
        """Search tree pairs, and count all pairs that the cull leaves, whether or not there was capacity for them.

        Args:
            recording: Where to record.
            tree_pairs: The tree pairs.
            is_needed: Called on the CPU outside a capture for pairs with static trees, which alone may be far from all
                others for long: whether boxes of the trees of this number may overlap. By default they always may.
            is_any_unlisted: None where the host sees the counts, and repeats the search. Otherwise the flag on the
                device that says whether there were more candidates than the lists of CUDA could take, which are then
                searched for again; and a pair for which there is no capacity gets toi 0.
        """
        marks_overflow = is_any_unlisted is not None
        if not tree_pairs:
            return
        if not recording.is_cuda:
            with nullcontext() if self.ranges else recording.at_once():
                for number, tree_pair in enumerate(tree_pairs):
                    needed = None
                    if is_needed is not None and tree_pair.target.primitives.is_static:
                        needed = partial(is_needed, number)
                    self.search(recording, tree_pair, marks_overflow=marks_overflow, is_needed=needed)
            return
        self._list_candidates(recording, [(pair, range(pair.query.primitives.count)) for pair in tree_pairs])
        self._cull(recording, self.kinds, marks_overflow=marks_overflow)
        if is_any_unlisted is not None:
            with recording.only_if(is_any_unlisted):
                self._cull_the_rest(recording, tree_pairs)

    def find_some_pairs(self, execution: Execution, tree_pair: TreePair, items: range, level: int) -> None:
        """Search for the pairs of some items of a tree pair alone, now; see :meth:`search`."""
        if execution.is_cuda:
            self._list_candidates(execution, [(tree_pair, items)])
            self._cull(execution, [tree_pair.kind])
        else:
            self.search(execution, tree_pair, items, level=level)

    def search(
        self,
        launcher: Launcher,
        tree_pair: TreePair,
        items: range | None = None,
        *,
        level: int = 1,
        marks_overflow: bool = False,
        is_needed: Callable[[], bool] | None = None,
    ) -> None:
        """On the CPU: search a tree pair, and count all that is left, whether or not there was capacity.

        These are the pairs that the cull leaves, or with `ranges` all whose boxes overlap.

        Args:
            launcher: Where to launch, or to record.
            tree_pair: The trees, or the spatial hashes.
            items: The items to search; all by default.
            level: Level of the items in the tree of the queries: 1, blocks; 0, single boxes.
            marks_overflow: Whether a pair for which there is no capacity gets toi 0.
            is_needed: Called outside a capture: whether boxes of the two trees may overlap.
        """
        if items is None:
            items = range(tree_pair.query.levels[0])
        count = len(items)
        num_tests = count * WIDTH**level * tree_pair.target.primitives.count
        num_parts = max(1, min(count // _SMALLEST_SEARCH, _PARTS_PER_THREAD * launcher.num_threads))
        is_long = num_tests > LONG_SEARCH * num_parts
        part = self.ranges.get(tree_pair.kind)
        kernel = self.search_kernel(tree_pair, CULL if part is None else BOXES, is_cuda=False)
        if part is None:
            part = search_range(level, int(tree_pair.kind), items, marks_overflow=marks_overflow)
        launcher.launch(
            kernel,
            count,
            inputs=[part, *self.searched(tree_pair)],
            outputs=[self.step, self.keys[tree_pair.kind]],
            grain=_SMALLEST_SEARCH,
            parts_per_thread=_PARTS_PER_THREAD,
            num_needed=None if is_needed is None else lambda: count if is_needed() else 0,  # no more parts than items
            is_long=(lambda: True) if is_long else None,
        )

    def search_kernel(self, tree_pair: TreePair, end: str, *, is_cuda: bool) -> Any:
        """The kernel of a search that ends at a stage."""
        topology, walk = self.topology, tree_pair.query.walk
        return search_on(topology.device, walk, end, topology.has_lists, is_cuda=is_cuda, is_thick=self.is_thick)

    def filter_of(self, tree_pair: TreePair) -> Any:
        """The collision filter of a search."""
        topology = self.topology
        roles = {tree.primitives.role for tree in (tree_pair.query, tree_pair.target)}
        if self._has_slender and len(roles) == 1:
            return topology.filters[roles.pop()]
        return topology.collision_filter

    def searched(self, tree_pair: TreePair) -> list[Any]:
        """The inputs of a search of its own besides its items."""
        boxes = [*self.boxes[tree_pair.query.name], *self.boxes[tree_pair.target.name]]
        return [*boxes, tree_pair.packed, self.search_options, self.filter_of(tree_pair)]

    def _list_candidates(self, launcher: Launcher, searched: list[tuple[TreePair, range]]) -> None:
        """On CUDA: list the candidates of some queries of tree pairs, and count all of them; :meth:`_cull` follows."""
        searches = []
        for tree_pair, queries in searched:
            row, shares_leaves = int(tree_pair.kind), tree_pair.query.walk == "search_trees"
            for k in range(0, len(queries), MOST_QUERIES):
                part = range_of_warps(row, queries[k : k + MOST_QUERIES], shares_leaves=shares_leaves)
                searches.append((tree_pair, part))
        self._search_in_warps(launcher, searches, LIST, self.candidates)

    def _cull_the_rest(self, launcher: Launcher, tree_pairs: list[TreePair]) -> None:
        """If there were more candidates than the list could take, search again, and cull each where it is found."""
        searches = []
        for tree_pair in tree_pairs:
            kind, queries = tree_pair.kind, range(tree_pair.query.primitives.count)
            capacity = len(self.candidates[kind])
            part = range_of_warps(int(kind), queries, capacity, marks_overflow=True, most_warps=_MOST_REST)
            searches.append((tree_pair, part))
        self._search_in_warps(launcher, searches, CULL, self.keys)

    def _search_in_warps(
        self, launcher: Launcher, searches: list[tuple[TreePair, Any]], end: str, keys: dict[PairKind, Any]
    ) -> None:
        """Search tree pairs on CUDA, a warp for some queries each: two trees in a launch, or a spatial hash."""
        kernel = self.search_kernel(searches[0][0], end, is_cuda=True)
        if searches[0][0].query.walk == "search_hashes":
            for tree_pair, part in searches:
                inputs, outputs = [part, *self.searched(tree_pair)], [self.step, keys[tree_pair.kind]]
                launcher.launch(kernel, part.num_warps * WARP, inputs=inputs, outputs=outputs)
            return
        filters = [self.filter_of(tree_pair) for tree_pair, _ in searches]
        for collision_filter in {id(one): one for one in filters}.values():  # more than one with slender bodies
            alike = [search for search, one in zip(searches, filters, strict=True) if one is collision_filter]
            for two in _groups(alike):
                of_two = []
                for tree_pair, part in two:
                    (query,), (target,) = (self.boxes[tree.name] for tree in (tree_pair.query, tree_pair.target))
                    fields = SearchedFields(part, query, target, tree_pair.packed, keys[tree_pair.kind])
                    of_two.append(launcher.struct(fields))
                inputs = [self.search_options, collision_filter, *(2 * of_two)[:2]]  # no threads are left for another
                num_warps = sum(part.num_warps for _, part in two)
                launcher.launch(kernel, num_warps * WARP, inputs=inputs, outputs=[self.step])

    def _cull(self, launcher: Launcher, kinds: list[PairKind], *, marks_overflow: bool = False) -> None:
        """Cull the listed candidates of some kinds on CUDA, and write the keys of those that stay open.

        Args:
            launcher: Where to launch, or to record.
            kinds: Kinds of the candidates; ``counts`` hold their number, which may exceed the length of the list.
            marks_overflow: Whether a pair for which there is no capacity gets toi 0; and nothing is culled if there
                were more candidates than the list could take, as :meth:`_cull_the_rest` then does.
        """
        culled = specialised("search.candidate_cull", is_thick=self.is_thick)
        for two in _groups(kinds):
            of_kinds, num_threads = [], 0
            for kind in two:
                candidates, most = self.candidates[kind], _MOST_CULLS
                if not isinstance(candidates, Slot):
                    most = min(most, -(-len(candidates) // WARP) * WARP)
                num_threads += most
                part = search_range(0, int(kind), range(0), marks_overflow=marks_overflow)
                first, second = (self.topology.corners[name] for name in self.topology.corner_arrays(kind))
                of_kind = CandidateFields(part, most, candidates, first, second, self.keys[kind])
                of_kinds.append(launcher.struct(of_kind))
            inputs = [int(marks_overflow), self.search_options, *(2 * of_kinds)[:2]]  # no threads are left for another
            launcher.launch(culled.cull_candidates, num_threads, inputs=inputs, outputs=[self.step])

    def meet_planes(
        self,
        launcher: Launcher,
        sink: int,
        active: wp.array | Slot | None = None,
        *,
        only_moving: bool = False,
        gaps_moved: float = 0.0,
    ) -> None:
        """Let vertices meet planes: as in :meth:`solve`, but that nothing is left open.

        Args:
            launcher: Where to launch, or to record.
            sink: Where what is found goes: `CONTACTS` or `BOUND`.
            active: The bodies whose vertices do; all by default.
            only_moving: As for :meth:`solve`.
            gaps_moved: As for :meth:`solve`, too.
        """
        from ccd_warp.kernels.narrow_phase.meet_planes import meet_planes  # not before a scene needs it

        topology = self.topology
        vertices = topology.plane_vertices
        box_radius, turns = self.box_radius, Turns()
        if self.turns is not None:
            box_radius, turns = self.plane_radius, self.turns
        inputs = [
            sink,
            vertices,
            planes_of(topology),
            self.plane_query,
            topology.vertex_body,
            box_radius,
            turns,
            active,
        ]
        inputs += [int(only_moving), float(gaps_moved)]
        launcher.launch(meet_planes, len(vertices), inputs=inputs, outputs=[self.step])

    def solve(
        self,
        launcher: Launcher,
        sink: int,
        *,
        is_second: bool,
        only_moving: bool = False,
        gaps_moved: float = 0.0,
    ) -> None:
        """A round of the narrow phase, for the pairs of each kind that the search has found.

        Args:
            launcher: Where to launch, or to record.
            sink: Where what is found goes: with `CONTACTS` the minima are lowered, and the contacts listed; with
                `BOUND` the least toi alone is lowered.
            is_second: Whether it is the second round, of the pairs that the first has left open.
            only_moving: Whether stationary pairs are ignored.
            gaps_moved: Number of gaps by which a pair may move if its toi is near 0.
        """
        chunk = 1 if is_second else _CHUNK  # the open pairs may be neighbours, so solvers take turns
        step, table, least, of_round = self.step, Table(), LeastToi(), Round()
        of_round.is_second, of_round.only_moving = int(is_second), int(only_moving)
        of_round.gaps_moved = float(gaps_moved)
        if launcher.is_cuda:
            self._solve_queued(launcher, sink, of_round)
            return
        with launcher.at_once():
            for kind in self.kinds:
                inputs = [sink, self.pairs[kind], self.options, of_round, 0]
                # not the struct of the step, with which the solver takes 3 to 8 % longer: clang copies the minima in it
                outputs = [table, step.minima, step.contacts, self._least[kind] if sink == BOUND else least]
                kernel = self.narrow_phase.solve_pairs
                self._launch_solvers(launcher, kernel, kind, chunk, inputs, outputs, only_open=is_second)

    def _queued_kernels(self, sink: int) -> dict[str, Any]:
        """The kernels of the narrow phase on CUDA."""
        narrow_phase = self.narrow_phase
        return queued_kernels(narrow_phase.real, narrow_phase.norm, sink, is_clipping=self.is_clipping)

    def _solve_queued(self, launcher: Launcher, sink: int, of_round: Any) -> None:
        """A round on CUDA: of two kinds at once where contacts are kept."""
        kernels = self._queued_kernels(sink)
        step = self.step
        for kinds in _groups(self.kinds, KINDS_AT_ONCE if sink == CONTACTS else 1):
            pairs: list[Any] = [self.pairs[kind] for kind in kinds]
            others = pairs[1] if len(kinds) > 1 else replace(pairs[0], keys=None)
            inputs = [pairs[0], self.options, of_round, 0, others, self.queue]
            outputs = [Table(), step.minima, step.contacts, self._least[kinds[0]] if sink == BOUND else LeastToi()]
            most = sum(_MANY_PAIRS if isinstance(self.keys[kind], Slot) else len(self.keys[kind]) for kind in kinds)
            launch_queued(launcher, kernels, most, inputs, outputs)

    def measure_pairs(self, launcher: Launcher, sink: int, norm: Norm) -> None:
        """In place of the narrow phase: measure the pairs at the start, in a norm.

        Args:
            launcher: Where to launch, or to record.
            sink: Where what is found goes: with `NEAR` near pairs are listed; with `DISPLACEMENT` the bounds of the
                vertices are lowered, which are their minima, with `START_DISTANCE` their start distances.
            norm: That of the distance; `START_DISTANCE` alone knows others than the Euclidean.
        """
        from ccd_warp.kernels.at_one_time.proximity import ProximityList  # few programs need it

        kernel = measure_pairs_in(norm, launcher.device)
        chunk = 1 if launcher.is_cuda else _CHUNK
        body_static = self.topology.body_static if sink == DISPLACEMENT else None
        outputs = [self.step.minima, self.proximities if sink == NEAR else ProximityList()]
        outputs.append(self.start_distances if sink == START_DISTANCE else None)
        with launcher.at_once():
            for kind, keys in self.keys.items():
                solvers = None
                if launcher.is_cuda:
                    solvers = _MOST_CULLS if isinstance(keys, Slot) else max(1, min(_MOST_CULLS, len(keys)))
                inputs = [sink, self.pairs[kind], self.reach, body_static]
                self._launch_solvers(launcher, kernel, kind, chunk, inputs, outputs, num_solvers=solvers)

    def list_near_planes(self, launcher: Launcher) -> None:
        """List the planes of half-spaces that are near vertices at the start."""
        self._measure_planes(launcher, NEAR, self.proximities)

    def bound_by_half_spaces(self, launcher: Launcher) -> None:
        """Lower the bounds of vertices near planes."""
        from ccd_warp.kernels.at_one_time.proximity import ProximityList

        self._measure_planes(launcher, DISPLACEMENT, ProximityList())

    def _measure_planes(self, launcher: Launcher, sink: int, proximities: Any) -> None:
        from ccd_warp.kernels.at_one_time.near_planes import measure_planes

        topology = self.topology
        inputs = [sink, topology.plane_vertices, topology.vertex_body, planes_of(topology), self.box_radius]
        inputs += [self.step.vertices_t0, self.reach]
        outputs = [self.step.counts, self.step.minima, proximities]
        launcher.launch(measure_planes, len(topology.plane_vertices), inputs=inputs, outputs=outputs)

    @lazy_property
    def pairs(self) -> dict[PairKind, StructFields]:
        """The pairs of each kind as kernels take them: one struct for all launches."""
        step, pairs = self.step, {}
        for kind, keys in self.keys.items():
            first, second = (self.topology.corners[array] for array in CORNER_ARRAYS[kind])
            ends = step.vertices_t0, step.vertices_t1
            pairs[kind] = PairFields(int(kind), step.counts, keys, first, second, *ends)
        return pairs

    @lazy_property
    def _least(self) -> dict[PairKind, StructFields]:
        """The least toi, and that of open pairs of each kind."""
        return {kind: LeastFields(self.step.least_bits, toi) for kind, toi in self.open_toi.items()}

    def _launch_solvers(
        self,
        launcher: Launcher,
        kernel: wp.Kernel,
        kind: PairKind,
        chunk: int,
        inputs: list[Any],
        outputs: list[Any],
        *,
        num_solvers: int | None = None,
        only_open: bool = False,
    ) -> None:
        """Launch solvers that share the pairs of a kind, chunk by chunk; only the device knows how many these are."""
        solvers = num_solvers or _SOLVERS_PER_THREAD * launcher.num_threads
        # a view of what the search has found
        counts: Any = None if launcher.is_cuda else self.step.counts.numpy()[kind]
        launcher.launch(
            kernel,
            solvers,
            inputs=[solvers, chunk, *inputs],
            outputs=outputs,
            grain=1,
            parts_per_thread=_SOLVERS_PER_THREAD,
            num_needed=lambda: 0 if only_open and not counts[OPEN] else -(-int(counts[FOUND]) // chunk),
            is_long=lambda: bool(counts[OPEN] or counts[FOUND] > _LONG_PART * solvers),
        )
