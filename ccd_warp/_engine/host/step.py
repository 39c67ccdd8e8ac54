"""One step of a mesh on its way through the stages: boxes, pairs, narrow phase, gather."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contact_place import located
from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.host.arcs import Arcs, Slice, slices_of
from ccd_warp._engine.host.candidates import Candidates, Collector, union
from ccd_warp._engine.host.contacts import BYTES_KEPT, BYTES_PER_CONTACT, ContactStore
from ccd_warp._engine.host.oddities import (
    DistanceInEdges,
    Farthest,
    are_many,
    hidden_sentence,
    overlaps_described,
)
from ccd_warp._engine.host.pair_memory import KEY_BYTES, MOST_PAIRS
from ccd_warp._engine.host.plan import HostPlan
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.lengths import half_up
from ccd_warp._engine.mesh.planes import plane_candidates
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.mesh.topology import Positions
from ccd_warp._engine.plan import Goal
from ccd_warp._input.options import Options
from ccd_warp._results import Contacts, Counts, MeshResult
from ccd_warp._runtime.progress import Progress
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp._touch import Touch
from ccd_warp.kernels.pair.norm import is_ball

if TYPE_CHECKING:
    from ccd_warp._engine.host.search import PairSearch
    from ccd_warp._mesh_paths import MeshPaths

# Memory for pairs where the user sets no limit.
DEFAULT_PAIR_BYTES = 1 << 30
TOI_BYTES = 8
# Remaining share of the step below which recomputing the boxes for it pays.
_WORTH_SHORTENING = 0.5
_LEAST_KEYS = 1 << 12
# Where pairs are held, and press (`kernels.pair.hold`), a step below the first fraction is none if its motion is below
# the second fraction of the size of the scene.
_LOST_TOI, _LOST = 2.0**-20, 2.0**-30

_T = TypeVar("_T")


class _Timer:
    """Adds the time of its block to that of a stage."""

    def __init__(self, timings: dict[str, float], stage: str) -> None:
        self._timings, self._stage = timings, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._timings[self._stage] = self._timings.get(self._stage, 0.0) + time.perf_counter() - self._begin


class Step:
    """One step on the host: it runs the stages and collects counts and timings."""

    def __init__(
        self,
        workspace: Workspace,
        positions: Positions,
        options: Options,
        checking_seconds: float = 0.0,
        show: Callable[[Progress], None] | None = None,
        paths: "MeshPaths | None" = None,
    ) -> None:
        """Begin a step.

        Args:
            workspace: What stays from step to step.
            positions: Positions at both ends; of bodies on paths in their own frames.
            options: The options.
            checking_seconds: What went into checking the positions.
            show: Displays the progress.
            paths: Paths of bodies that turn, where there are any.
        """
        self.timings: dict[str, float] = {"input": checking_seconds}
        self._events: list[tuple[str, wp.Event, wp.Event]] = []
        self.options = options
        self.workspace = workspace
        self.topology = workspace.topology
        self.mesh = workspace.topology.mesh
        self.buffers = workspace.buffers
        self.boxes = workspace.boxes
        self.positions = positions
        self.counts: Counts  # from `finish_counts` on
        self._num_active_bodies = self.mesh.num_bodies
        self.is_explained = self._has_boxes = False
        self.holds = self.is_held = False
        workspace.progress.show = show
        self.arcs: Arcs | None = None
        self.slices: list[Slice | None] = [None]
        self.paths, self.given = paths, positions
        if paths is not None:
            self.slices = [*slices_of(paths, options.t_max)]
            self.arcs = workspace.arcs
            self.arcs.begin(paths)
            self._given_on_device: list[wp.array] = [
                wp.array(x, dtype=wp.vec3d, device=self.topology.device, copy=False) for x in positions
            ]

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

    def begin(self, goal: Goal, t_end: float, inflation: float | None = None, part: "Slice | None" = None) -> HostPlan:
        """Compute the boxes over [0, t_end], or of a slice; a body that none comes near costs only its own box."""
        with self.timed("input"):
            self.plan = plan = HostPlan.of(self.workspace, self.options, goal, is_held=self.is_held, arcs=self.arcs)
            self.execution = plan.execution
            if part is None or part.t_begin == 0.0:
                plan.begin_counts()
                self._has_boxes = False
            if part is not None and self.arcs is not None:
                self.arcs.place(part, self.execution, *self._given_on_device)
                t_end, self.positions = 1.0, self.arcs.positions()
        self.share_positions()
        with self.timed("input"):
            self.vertices_t0, self.vertices_t1 = plan.set_positions(self.positions)
            if inflation is None:
                self.length_scale = length_scale_of(self.mesh, self.options)
                self.separation = self.options.separation(self.length_scale)
                self.is_far_reaching = self._reaches_far()
        with self.timed("boxes"):
            self.inflation = half_up(self.separation) if inflation is None else inflation
            near = self._bodies_near()
            if self.is_idle(near):
                plan.skip_boxes(goes_on=part is not None and part.t_begin > 0.0)
            else:
                active = self.workspace.active(near)
                plan.fill_boxes(self.positions, t_end, self.inflation, active, goes_on=self._has_boxes)
                self._has_boxes = True
        return plan

    def share_positions(self) -> None:
        """Let other processes that share the step have what they need of the positions; here there are none."""

    def bind_options(self, plan: HostPlan, part: "Slice | None") -> None:
        """Let the kernels have the options, and how bodies turn in a slice."""
        packed = partial(self.workspace.packed, self.options, self.length_scale, is_held=self.is_held)
        if part is None or self.arcs is None:
            plan.bind(options=packed())
        else:
            turns = self.arcs.turns(part)
            plan.bind(options=packed(turns=turns), turns=turns)

    def _reaches_far(self) -> bool:
        """Whether the distance of pairs is many edges long, which is said where neighbours are not excluded."""
        found = DistanceInEdges.of(self.topology, self.positions[0], self.separation)
        if found is None or not found.is_many:
            return False
        if found.reaches_beyond(self.mesh.exclusion_rings):
            self.is_explained = True  # nothing has to be said of the many pairs that follow from it
            self.workspace.warn_once("distance", found.described)
        return True

    def _warn_of_size(self) -> None:
        """Name the vertex at whose size rounding hides gaps at the start, if there is one, where a toi is 0."""
        found = Farthest.of(self.positions)
        if found.hides_gaps(self.options.tolerance, self.length_scale):
            said = "rounding at the size of the positions is more than the tolerance and hides gaps at the start"
            self.workspace.warn_once("size", lambda: f"{said}, so toi is 0: {found.described(self.mesh)}")

    def _warn_of_overlaps(self, num_pairs: int, found: Mapping[PairKind, int]) -> None:
        """Say that so many pairs are left that parts of the scene seem to overlap.

        ``found`` are the pairs of the last batch, whose keys the plan still has.
        """

        def described() -> str:
            keys = {kind: self.plan.found_keys(kind, count) for kind, count in found.items() if count}
            return overlaps_described(self.mesh, num_pairs, keys)

        if not self.is_explained and are_many(self.mesh, num_pairs):
            self.workspace.warn_once("overlaps", described)

    def _hidden_gaps(self, contacts: Contacts) -> str:
        """A sentence on the pairs whose gaps rounding hides, empty if there are none."""
        count = int((contacts.status == int(CCDStatus.ROUNDING_LIMIT)).sum())
        if count:
            self._warn_of_size()
        within = 0.0 if self.paths is None else float(self.paths.excess.max(initial=0.0))
        return hidden_sentence(count, self.mesh, self.positions, within)

    def _bodies_near(self) -> NDArray[np.bool_] | None:
        """Bodies that may collide, or None for all."""
        mesh = self.mesh
        active = None if self.paths is None or self.paths.active.all() else self.paths.active
        if not self.topology.may_have_inactive_bodies:
            return active
        radius = None if self.arcs is None else self.arcs.radius.numpy()
        near = bodies_near(self.topology, self.positions, self.inflation, self.execution, radius)
        if active is not None:
            near &= active
        self._num_active_bodies = int((near | mesh.static).sum())
        return near

    def is_idle(self, near: NDArray[np.bool_] | None) -> bool:
        """Whether nothing has to be searched, given the bodies that may collide."""
        return near is not None and not near.any()

    def _check_idle(self, bytes_per_pair: int) -> None:
        """Check the memory limit of a step, or slice, that searches nothing, and count its stages as others'."""
        self.capacity(bytes_per_pair)
        for stage in ("pairs", "narrow phase"):
            self.timings.setdefault(stage, 0.0)

    def timed(self, stage: str) -> "AbstractContextManager[None]":
        """Add the time of a stage; on CUDA by events, which are read once the result is available."""
        return self._timed_by_events(stage) if self.topology.device.is_cuda else _Timer(self.timings, stage)

    @contextmanager
    def _timed_by_events(self, stage: str) -> Iterator[None]:
        device = self.topology.device
        begin_event, end_event = (wp.Event(device, enable_timing=True) for _ in range(2))
        stream = wp.get_stream(device)
        stream.record_event(begin_event)
        yield
        stream.record_event(end_event)
        self._events.append((stage, begin_event, end_event))

    def finish_timings(self) -> None:
        """Read the events of CUDA, and sum the stages."""
        for stage, begin, end in self._events:
            seconds = 1e-3 * wp.get_event_elapsed_time(begin, end)
            self.timings[stage] = self.timings.get(stage, 0.0) + seconds
        self._events.clear()
        self.timings["total"] = sum(self.timings.values())

    def capacity(self, bytes_per_pair: int, num_parts: int = 1) -> int:
        """Largest number of pairs at a time within the memory limit, where so many parts are searched at once.

        Every part needs capacity for all partners of one query.
        """
        least = num_parts * max(_LEAST_KEYS, self.plan.most_partners)
        limit = self.options.memory_limit
        if limit is None:
            return min(max(least, DEFAULT_PAIR_BYTES // bytes_per_pair), self.plan.memory.most_pairs)
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
        return self.topology.num_bytes + self.buffers.num_bytes_but("keys", "contact", "pair")

    def largest_contacts(self) -> int:
        """Largest number of contacts within the memory limit."""
        if self.options.memory_limit is None:
            return MOST_PAIRS
        return (self.options.memory_limit - self.fixed_bytes) // 2 // BYTES_KEPT

    def timed_batches(self, batches: Iterator[_T]) -> Iterator[_T]:
        """The batches of a search, timed as the stage of pairs."""
        while True:
            with self.timed("pairs"):
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    def candidates(self, inflation: float) -> Candidates:
        """All pairs whose boxes, enlarged by ``inflation``, overlap, in a slice where the step has several."""
        found = [self._candidates_of(part, inflation) for part in self.slices]
        num_launches, num_candidates = Counter[PairKind](), Counter[PairKind]()
        for _, search in found:
            num_launches.update(search.num_launches)
            num_candidates.update(search.candidates)
        candidates = found[0][0] if len(found) == 1 else union([each for each, _ in found])
        for kind, pairs in ((PairKind.VERTEX_PLANE, candidates.vertex_plane),) if self.plan.has_planes else ():
            num_launches[kind], num_candidates[kind] = 1, len(pairs)
        self.finish_counts(num_launches, num_candidates, sum(search.num_batches for _, search in found))
        return candidates

    def _candidates_of(self, part: "Slice | None", inflation: float) -> "tuple[Candidates, PairSearch]":
        """The candidates of a slice, or of the whole step, and the search that has found them."""
        from ccd_warp._engine.host.search import PairSearch  # few programs need it

        plan = self.begin("candidates", 1.0, inflation, part)
        # the threads of a GPU write in arbitrary order, and that of a spatial hash means nothing
        is_sorted = self.execution.is_cuda or self.options.broad_phase == "hash"
        collector = Collector(self.execution, is_sorted=is_sorted)
        with self.timed("pairs"):
            plan.set_search(1.0, inflation, 0.0)
            tree_pairs = list(filter(plan.may_meet, plan.tree_pairs))
            search = PairSearch(plan.stages_now(), self.execution, self.buffers, tree_pairs)
            # counts what the search has just allocated
            search.largest_capacity = self.capacity(KEY_BYTES, search.num_workers)
        for ranges in self.timed_batches(search.ranges()):
            with self.timed("copy"):
                collector.take(ranges)
        plan.release_positions()
        with self.timed("copy"):
            candidates = collector.candidates()
        if plan.has_planes:
            with self.timed("planes"):
                box_radius = self.topology.box_radius if self.arcs is None else self.arcs.box_radius
                vertices = self.topology.plane_vertices.numpy()
                near = plane_candidates(self.mesh, vertices, self.positions, inflation, box_radius.numpy())
            candidates = replace(candidates, vertex_plane=near)
        return candidates, search

    def least_toi(self, *, any_suffices: bool = False) -> float:
        """Earliest toi of all pairs, inf if none touches.

        In a large mesh the pairs of a sample of the queries come first. Where one touches, the full search covers only
        the part of the step before that: the boxes are shorter, and the cull ends there. The bound of each round is the
        least toi of the pairs of the previous round. It depends only on the input, and so does the result.

        Args:
            any_suffices: Whether to end with the first contact found, whose toi need not be the earliest.
        """
        best = np.inf
        for part in self.slices:
            best = self._least_toi_of(part, best, any_suffices=any_suffices)
            if part is not None and best <= part.t_end:
                break
        plan = self.plan
        plan.release_positions()
        if best <= 0.0:
            self._warn_of_size()
        self.finish_counts(plan.num_searches, plan.num_candidates, plan.num_batches)
        return best

    def _least_toi_of(self, part: "Slice | None", best: float, *, any_suffices: bool) -> float:
        """The least of a toi and those in a slice, or in the whole step."""
        t_end = self.options.t_max
        plan = self.begin("bound", t_end, part=part)
        if plan.is_idle and not plan.has_planes:
            self._check_idle(plan.memory.pair_bytes + TOI_BYTES)
            return best
        self.bind_options(plan, part)
        searches: tuple[bool, ...] = (True, False) if self.topology.samples_queries and part is None else (False,)
        if plan.has_planes:
            with self.timed("planes"):
                self._bind_planes(plan)
                plan.set_least(best)
                plan.meet_planes()
                best = self.least_of_all(plan.least())  # whether anything is searched is the same everywhere
            if best <= 0.0 or (any_suffices and best < np.inf):
                searches = ()
        for of_sample in searches:
            if part is None and best <= _WORTH_SHORTENING * t_end:
                t_end = best
                with self.timed("boxes"):
                    plan.shorten_boxes(t_end)
            plan.set_search(min(best, t_end) if part is None else 1.0, self.inflation, self.separation)
            plan.set_least(best)
            plan.begin_candidates()
            open_pairs: dict[PairKind, list[tuple[NDArray[np.int64], NDArray[np.float64]]]] = {}
            capacity = self.capacity(plan.memory.pair_bytes + TOI_BYTES)
            least = best
            if self.is_far_reaching:
                # most queries have a partner within the distance, so a few of them show a toi of 0
                for _ in self.timed_batches(plan.few_batches(capacity)):
                    with self.timed("narrow phase"):
                        plan.solve(is_second=False)
                least = plan.least()
            is_known = least <= 0.0 or (any_suffices and least < np.inf)
            batches = iter(()) if is_known else plan.batches(capacity, of_sample=of_sample)
            for batch in self.timed_batches(batches):
                with self.timed("narrow phase"):
                    plan.solve(is_second=False)
                    for kind in plan.num_open():
                        open_pairs.setdefault(kind, []).append(plan.open_pairs(kind, batch.found[kind]))
                if plan.least() <= 0.0 or (any_suffices and plan.least() < np.inf):
                    break
            best = self.least_of_all(plan.least())
            if best <= 0.0 or (any_suffices and best < np.inf):
                break
            with self.timed("narrow phase"):
                best = self.least_of_all(self.least_open_toi(plan, best, open_pairs))
        return best

    def least_open_toi(
        self,
        plan: HostPlan,
        bound: float,
        open_pairs: dict[PairKind, list[tuple[NDArray[np.int64], NDArray[np.float64]]]],
    ) -> float:
        """The second round: earliest toi of the pairs that the first has left open, or the bound."""
        earlier = {}
        for kind, batches in open_pairs.items():
            keys, toi = map(np.concatenate, zip(*batches, strict=True))
            # which pairs are earlier than all closed ones depends only on the pairs, and so does their share of the
            # work
            is_earlier = toi < bound
            earlier[kind] = keys[is_earlier], toi[is_earlier]
        num_open = self.open_in_all({kind: len(keys) for kind, (keys, _) in earlier.items()})
        is_on_device = False  # whether the bound is that of the device, which is read when it is needed
        for kind, (keys, toi) in earlier.items():
            if len(keys) == 0:
                continue
            if self.options.share_of_work(num_open[kind]) <= self.options.first_iterations:
                bound = min(plan.least() if is_on_device else bound, float(toi.min()))
                is_on_device = False
                continue
            plan.set_open_pairs(kind, keys, num_open[kind])
            if not is_on_device:
                plan.set_least(bound)
            plan.solve(is_second=True)
            is_on_device = True
        return plan.least() if is_on_device else bound

    def held_toi(self) -> float:
        """Earliest toi where some pairs are held; 0 where nothing moves until then by more than rounding."""
        toi = self.least_toi()
        start, end = self.positions
        with np.errstate(over="ignore"):
            motion = self.most_of_all(float(np.abs(end - start).max(initial=0.0)))
            is_lost = toi <= _LOST_TOI and toi * motion <= _LOST * self.mesh.length_scale
        return 0.0 if is_lost else toi

    def most_of_all(self, value: float) -> float:
        """The largest value of all processes that share the step; here of this one."""
        return value

    def least_of_all(self, toi: float) -> float:
        """The least toi of all processes that share the step; here of this one."""
        return toi

    def open_in_all(self, num_open: dict[PairKind, int]) -> dict[PairKind, int]:
        """How many pairs of each kind are open in all processes that share the step; asked once for each round."""
        return num_open

    def share_work(self, plan: HostPlan) -> None:
        """Let the open pairs of a batch share the work with those of other processes; here there are none."""

    def _touch(self) -> Touch | None:
        """What counts as touching; not one thing where pairs are held."""
        if self.holds:
            return None
        radius = self.mesh.radius if self.mesh.is_thick else None
        return Touch.of(self.options, self.length_scale, is_euclidean=is_ball(self.plan.norm), radius=radius)

    def _radii(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Radii of vertices, and of the largest primitive around each where there are planes; None without."""
        radius = self.mesh.radius if self.mesh.is_thick else None
        if radius is None:
            return None
        return radius, self.topology.box_radius.numpy() if len(self.mesh.planes) else radius

    def contacts(self, *, is_ordered: bool = True) -> MeshResult:
        """Compute the toi of every pair that the cull leaves, and gather the result.

        Where contacts need no order, the result has no first ones, and they do not know where they are.
        """
        store = self.workspace.contacts
        survivors: Counter[PairKind] = Counter()
        for part in self.slices:
            self._find_contacts(part, store, survivors)
        plan = self.plan
        if not store.is_complete:
            least = self.fixed_bytes + 2 * store.total * BYTES_KEPT
            raise ValueError(
                f"memory_limit is {self.options.memory_limit} bytes; expected at least {least} for the {store.total} "
                f"contacts of this step, or collision_free_step, which keeps none"
            )
        with self.timed("gather"):
            if len(self.slices) > 1:
                store.keep_earliest()
            gathered = store.gather(is_ordered=is_ordered)
            place: Any = (*self.given, self.paths, self._touch(), self._radii()) if is_ordered else ()
            contacts = located(gathered.contacts, self.mesh, *place)
        plan.release_positions()
        self.finish_counts(plan.num_searches, plan.num_candidates, plan.num_batches, survivors, contacts)
        self.finish_timings()
        return MeshResult(
            gathered.toi,
            gathered.vertex_toi,
            gathered.body_toi,
            contacts,
            self.counts,
            self.timings,
            gathered.vertex_contact,
            gathered.body_contact,
            gathered.world_toi,
            gathered.world_contact,
            hidden_gaps=self._hidden_gaps(contacts) if gathered.toi <= 0.0 else "",
        )

    def _find_contacts(self, part: "Slice | None", store: ContactStore, survivors: Counter[PairKind]) -> None:
        """Add the contacts of a slice, or of the whole step."""
        plan = self.begin("contacts", self.options.t_max, part=part)
        with self.timed("pairs"):
            if part is None or part.t_begin == 0.0:
                store.begin(self.execution, self.largest_contacts())
                plan.reset_minima(store.count)
            if plan.is_idle and not plan.has_planes:
                self._check_idle(plan.memory.pair_bytes + BYTES_PER_CONTACT)
                return
            self.bind_options(plan, part)
            plan.set_search(self.options.t_max if part is None else 1.0, self.inflation, self.separation)
            batches = plan.batches(self.capacity(plan.memory.pair_bytes + BYTES_PER_CONTACT))
        if plan.has_planes:
            with self.timed("planes"):
                survivors[PairKind.VERTEX_PLANE] += self._meet_planes(plan)
        open_keys: dict[PairKind, list[NDArray[np.int64]]] = {}
        has_shared = False
        for batch in self.timed_batches(batches):
            with self.timed("narrow phase"):
                survivors.update(batch.found)
                self._warn_of_overlaps(survivors.total(), batch.found)
                plan.bind(contacts=store.begin_batch(sum(batch.found.values())))
                plan.solve(is_second=False)
                if batch.is_only:
                    self.share_work(plan)
                    has_shared = True
                    plan.solve(is_second=True)
                else:
                    for kind in plan.num_open():
                        open_keys.setdefault(kind, []).append(plan.open_keys(kind, batch.found[kind]))
                store.end_batch()
        with self.timed("narrow phase"):
            keys_left = {kind: np.concatenate(keys) for kind, keys in open_keys.items()}
            num_open = {} if has_shared else self.open_in_all({kind: len(keys) for kind, keys in keys_left.items()})
            for kind, keys in keys_left.items():
                plan.set_open_pairs(kind, keys, num_open[kind])
                plan.bind(contacts=store.begin_batch(len(keys)))
                plan.solve(is_second=True)
                store.end_batch()

    def _bind_planes(self, plan: HostPlan) -> None:
        """Let the kernel have what vertices and half-spaces are asked for, and the bodies that are searched."""
        query = self.workspace.plane_query(self.options, self.length_scale, holds=self.holds)
        searched = None
        if self.paths is not None and not self.paths.active.all():
            searched = self.topology.array(self.paths.active, wp.int32)
        plan.bind(plane_query=query, searched=searched)

    def _meet_planes(self, plan: HostPlan) -> int:
        """Contacts of vertices and planes, whose number is returned; repeated where they exceed what was expected."""
        store = self.workspace.contacts
        self._bind_planes(plan)
        plan.bind(contacts=store.begin_batch(store.num_with_planes))
        found = plan.meet_planes()
        if found > store.num_with_planes:
            store.num_with_planes = found
            plan.bind(contacts=store.begin_batch(found))
            plan.meet_planes(is_repeated=True)
        store.end_batch(found)
        return found

    def finish_counts(
        self,
        num_searches: Mapping[PairKind, int],
        num_candidates: Mapping[PairKind, int],
        num_batches: int,
        survivors: Counter[PairKind] | None = None,
        contacts: Contacts | None = None,
    ) -> None:
        """Set the counts; those of the cull and of contacts only if they are given."""
        mesh = self.mesh
        kinds = self.plan.kinds
        found: dict[str, Any] = {}
        if survivors is not None and contacts is not None:
            # NumPy would ask an enumeration for attributes, and lose an interrupt that arrives meanwhile
            of_kind = np.bincount(contacts.kind, minlength=len(PairKind)).tolist()
            of_status = np.bincount(contacts.status, minlength=len(CCDStatus)).tolist()
            found = {
                "num_after_cull": {kind: survivors[kind] for kind in kinds},
                "num_contacts": {kind: of_kind[int(kind)] for kind in kinds},
                "num_contacts_at_start": of_status[int(CCDStatus.INITIAL_CONTACT)],
                "num_contacts_at_limit": sum(of_status[int(CCDStatus.ITERATION_LIMIT) :]),
            }
        self.counts = Counts(
            num_bodies=mesh.num_bodies,
            num_vertices=mesh.num_vertices,
            num_edges=mesh.num_edges,
            num_faces=mesh.num_faces,
            num_codimensional_edges=len(mesh.codimensional_edges),
            num_codimensional_points=len(mesh.codimensional_points),
            num_active_bodies=self._num_active_bodies,
            num_boxes=self.boxes.num_boxes,
            num_sorted_sets=self.boxes.num_sorted,
            num_searches={kind: num_searches[kind] for kind in kinds},
            num_candidates={kind: num_candidates[kind] for kind in kinds},
            num_batches=num_batches,
            **found,
        )
