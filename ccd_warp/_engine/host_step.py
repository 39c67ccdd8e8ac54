"""One step of a mesh on its way through the stages: boxes, pairs, narrow phase, gather."""

import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contact_place import located
from ccd_warp._engine.body_boxes import bodies_near
from ccd_warp._engine.buffers import Buffers
from ccd_warp._engine.contacts import BYTES_KEPT, BYTES_PER_CONTACT, ContactStore, Gathered
from ccd_warp._engine.scene import half_up, moves_alone, possible_kinds
from ccd_warp._engine.search import KEY_BYTES, LONG_PART, Found, PairSearch, tree_pairs_of
from ccd_warp._engine.topology import CORNER_ARRAYS
from ccd_warp._engine.workspace import Workspace
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Contacts, Counts, MeshResult
from ccd_warp._runtime.launch import Execution, load
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp.kernels import boxes as box_kernels
from ccd_warp.kernels.minima import OPEN
from ccd_warp.kernels.narrow_phase import make_narrow_phase
from ccd_warp.kernels.pair_search import NUM_COUNTS

# Memory for pairs where the user sets no limit.
DEFAULT_PAIR_BYTES = 1 << 30
# The search for a bound first samples every so many blocks, and then checks all of them over the rest of the step.
_SAMPLE_STRIDE = 32
_WORTH_SAMPLING = 1 << 14  # vertices
# Largest number of pairs in a part, so that threads end at about the same time and progress is visible.
_LARGEST_PART = 1 << 14
# Pairs left by the cull, in total and for each primitive, from which on there are suspiciously many overlaps.
_MANY_PAIRS = 1_000_000
_MANY_PAIRS_EACH = 16
_LARGEST = float(np.finfo(np.float64).max)
_LEAST_KEYS = 1 << 12
_MOST_PAIRS = np.iinfo(np.int32).max


class OpenPairs:
    """Pairs of a step that the first round of the narrow phase leaves open.

    Attributes:
        marked: The complements of their keys, by kind of pair, in a search for contacts.
        arrays: Their keys and their toi so far, by kind of pair, in a search for the least toi.
    """

    def __init__(self) -> None:
        self.marked: dict[PairKind, NDArray[np.int64]] = {}
        self.arrays: dict[PairKind, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}

    def take(self, found: Found) -> None:
        """Copy the marked keys of a batch."""
        keys = found.keys.numpy()[found.begin : found.begin + found.count]
        marked = keys[keys < 0]
        self.marked[found.kind] = np.concatenate([self.marked.get(found.kind, marked[:0]), marked])

    def add(self, kind: PairKind, keys: NDArray[np.int64], toi: NDArray[np.float64]) -> None:
        """Keep the pairs of a batch."""
        if len(keys):
            before = self.arrays.get(kind, (keys[:0], toi[:0]))
            self.arrays[kind] = (np.concatenate([before[0], keys]), np.concatenate([before[1], toi]))


class _OpenList:
    """Device arrays that a launch writes open pairs of a kind to; they grow where there are more.

    Attributes:
        count: Number of pairs, int32, shape [1].
        num_found: The same, on the host, after :meth:`has_held_all`.
        arrays: Count, keys and toi, as the kernel takes them.
    """

    def __init__(self, buffers: Buffers, kind: PairKind) -> None:
        self._buffers = buffers
        self._name = f"{kind.name} open"
        self.count = buffers.get(f"{self._name} pair count", 1, wp.int32)
        self._size = 1 << 10
        self.num_found = 0
        self.begin()

    def begin(self) -> None:
        """Empty the list, and let it be as long as is known to be needed.

        Not on the threads that launch: of arrays that two of them make larger at once, one would be lost.
        """
        self.count.zero_()
        keys = self._buffers.get(f"{self._name} keys", self._size, wp.int64)
        self.arrays = [self.count, keys, self._buffers.get(f"{self._name} pair toi", len(keys), wp.float64)]

    def has_held_all(self) -> bool:
        """Whether there was capacity for all; if not, there is now."""
        self.num_found = int(self.count.numpy()[0])
        self._size = max(self._size, self.num_found)
        return self.num_found <= len(self.arrays[1])

    def found(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Copies of the keys and the toi, once they are known to have been held."""
        count = self.num_found
        _, keys, toi = self.arrays
        return keys.numpy()[:count].copy(), toi.numpy()[:count].copy()


@dataclass(frozen=True)
class _PairPart:
    """``count`` of the found pairs, from ``first`` on."""

    found: Found
    first: int
    count: int


class Step:
    """One step on the host: it runs the stages and collects counts and timings."""

    def __init__(
        self,
        workspace: Workspace,
        host: tuple[NDArray[np.float64], NDArray[np.float64]],
        options: Options,
        checking_seconds: float = 0.0,
        show: Callable[[Progress], None] | None = None,
    ) -> None:
        """Begin a step; ``checking_seconds`` went into checking its positions, and ``show`` displays its progress."""
        self.timings: dict[str, float] = {"input": checking_seconds}
        self._events: list[tuple[str, wp.Event, wp.Event]] = []
        self.options = options
        self.workspace = workspace
        self.topology = workspace.topology
        self.mesh = workspace.topology.mesh
        self.buffers = workspace.buffers
        self.boxes = workspace.boxes
        self.progress = Progress(show)
        self.execution = Execution(workspace.topology.device, options.threads, workspace.flag, self.progress.tick)
        self.counts = Counts()
        self._num_active_bodies = self.mesh.num_bodies
        self._num_searches: Counter[PairKind] = Counter()
        self._num_candidates: Counter[PairKind] = Counter()
        self._num_batches = 0
        self.is_warned = False
        with self.timed("input"):
            device = self.execution.device
            self.host = start, end = host
            self.vertices_t0: wp.array = wp.array(start, dtype=wp.vec3d, device=device, copy=False)
            self.vertices_t1: wp.array = wp.array(end, dtype=wp.vec3d, device=device, copy=False)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of a stage; on CUDA by events, which are read once the result is available."""
        if self.execution.device.is_cuda:
            begin_event, end_event = (wp.Event(self.execution.device, enable_timing=True) for _ in range(2))
            stream = wp.get_stream(self.execution.device)
            stream.record_event(begin_event)
            yield
            stream.record_event(end_event)
            self._events.append((stage, begin_event, end_event))
            return
        begin = time.perf_counter()
        yield
        self.timings[stage] = self.timings.get(stage, 0.0) + time.perf_counter() - begin

    def finish_timings(self) -> None:
        """Read the events of CUDA, and sum the stages."""
        for stage, begin, end in self._events:
            seconds = 1e-3 * wp.get_event_elapsed_time(begin, end)
            self.timings[stage] = self.timings.get(stage, 0.0) + seconds
        self._events.clear()
        self.timings["total"] = sum(self.timings.values())

    @lazy_property
    def length_scale(self) -> float:
        """The unit of tolerance and separation."""
        if self.options.length_scale is not None:
            return self.options.length_scale
        return longest_side(self.vertices_t0, self.vertices_t1, self.execution, self.buffers)

    @property
    def separation(self) -> float:
        """The minimum separation, a length."""
        if self.options.minimum_separation == 0.0:
            return 0.0
        return self.options.separation(self.length_scale)

    @property
    def inflation(self) -> float:
        """Enlargement of the boxes for the separation."""
        return half_up(self.separation)

    def begin_boxes(self, inflation: float, t_end: float, num_aabbs: int) -> None:
        """Compute the swept boxes of bodies that may collide; a body that none comes near costs only its own box."""
        mesh = self.mesh
        active = None
        if mesh.num_bodies > 1 and mesh.num_worlds == 1 and not mesh.self_collision[~mesh.static].all():
            near = bodies_near(self.topology, self.host, inflation, self.execution)
            self._num_active_bodies = int((near | mesh.static).sum())
            active = self.buffers.get("active bodies", mesh.num_bodies, wp.int32)
            active.assign(near.astype(np.int32))
        self.boxes.begin(
            self.host, self.vertices_t0, self.vertices_t1, t_end, inflation, self.execution, num_aabbs, active
        )
        self.tree_pairs = tree_pairs_of(self.boxes, possible_kinds(mesh, self.options), moves_alone(mesh))

    def search(self, *, with_cull: bool, t_end: float, bytes_per_pair: int) -> PairSearch:
        """A search with the capacity that the memory limit allows."""
        search = PairSearch(
            self.boxes,
            self.execution,
            self.buffers,
            with_cull=with_cull,
            t_end=t_end,
            separation=self.separation,
            progress=self.progress,
        )
        search.largest_capacity = self.capacity(bytes_per_pair)  # counts what the search has just allocated
        return search

    def capacity(self, bytes_per_pair: int) -> int:
        """Largest number of pairs at a time within the memory limit."""
        least = max([_LEAST_KEYS, *(tree_pair.target.primitives.count for tree_pair in self.tree_pairs)])
        least *= 1 if self.execution.is_cuda else self.execution.num_threads
        limit = self.options.memory_limit
        if limit is None:
            return min(max(least, DEFAULT_PAIR_BYTES // bytes_per_pair), _MOST_PAIRS)
        # half of what is left is for the pairs, half for the contacts
        needed = self.fixed_bytes + 2 * least * bytes_per_pair
        if needed > limit:
            raise ValueError(
                f"memory_limit is {limit} bytes; expected at least {needed} for this step: "
                f"{self.fixed_bytes} for its boxes and {needed - self.fixed_bytes} for pairs and contacts"
            )
        return min((limit - self.fixed_bytes) // 2 // bytes_per_pair, _MOST_PAIRS)

    @property
    def fixed_bytes(self) -> int:
        """Bytes of the mesh's topology and of the boxes."""
        return self.topology.num_bytes + self.buffers.num_bytes_but("keys", "contact", "pair")

    def largest_contacts(self) -> int:
        """Largest number of contacts within the memory limit."""
        if self.options.memory_limit is None:
            return np.iinfo(np.int32).max
        return (self.options.memory_limit - self.fixed_bytes) // 2 // BYTES_KEPT

    def timed_batches(self, batches: Iterator[list[Found]]) -> Iterator[list[Found]]:
        """The batches of a search, timed as the stage of pairs."""
        while True:
            with self.timed("pairs"):
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    def candidates(self, inflation: float, take: Callable[[list[Found]], None]) -> None:
        """Pass the keys of all pairs whose boxes overlap to ``take`` in batches; each overwrites the previous one."""
        with self.timed("boxes"):
            self.begin_boxes(inflation, 1.0, num_aabbs=1)
        with self.timed("pairs"):
            search = self.search(with_cull=False, t_end=1.0, bytes_per_pair=KEY_BYTES)
            batches = search.ranges(self.tree_pairs)
        for ranges in self.timed_batches(batches):
            with self.timed("copy"):
                take(ranges)
        self.count_pairs(search)
        self.finish_counts()

    def pair_inputs(self, found: Found, first: int) -> list:
        """The inputs with which the kernel of the least toi begins, for the pairs from ``first`` on."""
        a, b = CORNER_ARRAYS[found.kind]
        corners = self.topology.corners
        return [
            int(found.kind),
            found.begin + first,
            found.keys,
            corners[a],
            corners[b],
            self.vertices_t0,
            self.vertices_t1,
        ]

    def parts_of(self, batch: list[Found], grain: int = 256) -> list["_PairPart"]:
        """Split a batch into parts that are worth a launch each: several for every thread, more of a large batch."""
        parts = []
        total = sum(found.count for found in batch)
        for found in batch:
            share = 4 * self.execution.num_threads * found.count // max(total, 1)
            pieces = 1
            if not self.execution.is_cuda:
                pieces = max(1, min(share, found.count // grain), -(-found.count // _LARGEST_PART))
            bounds = [found.count * k // pieces for k in range(pieces + 1)]
            parts += [_PairPart(found, bounds[k], bounds[k + 1] - bounds[k]) for k in range(pieces)]
        return parts

    def launch_parts(
        self, kernel: Any, parts: list["_PairPart"], launch: Callable[["_PairPart"], None], is_long: bool
    ) -> None:
        """Launch a kernel on each part; ``is_long`` where pairs may take more than the iterations of a first round."""
        load(kernel, self.execution.device)

        def run(part: "_PairPart") -> None:
            launch(part)
            self.progress.done += part.count

        self.progress.begin("narrow phase", sum(part.count for part in parts))
        is_long = is_long or max(part.count for part in parts) > LONG_PART
        self.execution.run([lambda p=p: run(p) for p in parts], is_long=is_long)  # type: ignore[misc]

    def bound(self) -> float:
        """Earliest toi of all pairs, or t_max.

        A sample of the queries comes first. Where it finds a contact, the full search covers only the part of the step
        before it: the boxes are shorter, and the cull ends there. The bound of each round is the least toi of the pairs
        of the previous round. It depends only on the input, and so does the result.
        """
        best = self.options.t_max
        with self.timed("boxes"):
            self.begin_boxes(self.inflation, best, num_aabbs=2)
        for stride in (_SAMPLE_STRIDE, 1):
            if stride > 1 and self.mesh.num_vertices < _WORTH_SAMPLING:
                continue
            with self.timed("boxes"):
                self.boxes.shorten(best)
            with self.timed("pairs"):
                search = self.search(with_cull=True, t_end=best, bytes_per_pair=KEY_BYTES)
                batches = search.batches(self.tree_pairs, 0, stride)
            least = best
            open_pairs = OpenPairs()
            for batch in self.timed_batches(batches):
                with self.timed("narrow phase"):
                    least = self.least_toi(batch, least, open_pairs)
                if least <= 0.0:
                    break
            self.count_pairs(search)
            if least <= 0.0:
                best = 0.0
                break
            with self.timed("narrow phase"):
                best = self.least_open_toi(least, open_pairs)
        self.finish_counts()
        return best

    def least_toi(self, batch: list[Found], bound: float, open_pairs: "OpenPairs | None") -> float:
        """Earliest toi of the pairs of a batch, or the bound.

        Args:
            batch: The pairs.
            bound: A toi found earlier, or the end of the step.
            open_pairs: Collects the pairs that the first round leaves open; None in the second round.
        """
        if not batch:
            return bound
        kernel = make_narrow_phase(self.options.real).pairs_bound
        cap = self.options.first_iterations
        if open_pairs is None:
            cap = self.options.share_of_work(sum(found.count for found in batch))
        options = self.workspace.packed(self.options, self.length_scale, cap)
        # a pair that reaches its own limit gets no second round
        is_first = int(open_pairs is not None and cap < self.options.max_iterations)
        parts = self.parts_of(batch, grain=256 if is_first else 16)
        bits = self.buffers.get("pair bits", 1, wp.int64)
        bits.fill_(int(np.array(bound).view(np.int64)))
        lists = {found.kind: _OpenList(self.buffers, found.kind) for found in batch}

        def launch(part: _PairPart) -> None:
            inputs = [0, *self.pair_inputs(part.found, part.first), options, is_first]
            outputs = [bits, *lists[part.found.kind].arrays]
            wp.launch(kernel, dim=part.count, inputs=inputs, outputs=outputs, device=self.execution.device)

        while True:
            self.launch_parts(kernel, parts, launch, is_long=open_pairs is None)
            if all([each.has_held_all() for each in lists.values()]):  # not a generator: all of them grow
                break
            for each in lists.values():
                each.begin()
        if open_pairs is not None:
            for kind, each in lists.items():
                if each.num_found:
                    open_pairs.add(kind, *each.found())
        return float(bits.numpy()[:1].view(np.float64)[0])

    def least_open_toi(self, bound: float, open_pairs: "OpenPairs") -> float:
        """The second round: earliest toi of the pairs that the first has left open, or the bound."""
        closed = bound
        for kind, (keys, toi) in open_pairs.arrays.items():
            # which pairs are earlier than all closed ones depends only on the pairs, and so does their share of the
            # work
            is_earlier = toi < closed
            keys, toi = keys[is_earlier], toi[is_earlier]
            if len(keys) == 0:
                continue
            if self.options.share_of_work(len(keys)) <= self.options.first_iterations:
                bound = min(bound, float(toi.min()))
                continue
            pairs = self.buffers.get("open keys", len(keys), wp.int64)
            pairs[: len(keys)].assign(keys)
            bound = self.least_toi([Found(kind, pairs, 0, len(keys))], bound, None)
        return bound

    def count_pairs(self, search: PairSearch) -> None:
        """Add what a search did to the counts."""
        self._num_searches += search.num_launches
        self._num_candidates = search.candidates
        self._num_batches += search.num_batches

    def finish_counts(self, survivors: Counter[PairKind] | None = None, contacts: Contacts | None = None) -> None:
        """Say what the call did, with what survived the cull and touches if it looked for contacts."""
        mesh = self.mesh
        kinds = [kind for kind in _kinds(mesh) if kind in self.options.kinds]
        counts = Counts(
            num_bodies=mesh.num_bodies,
            num_vertices=mesh.num_vertices,
            num_edges=mesh.num_edges,
            num_faces=mesh.num_faces,
            num_codimensional_edges=len(mesh.codimensional_edges),
            num_codimensional_points=len(mesh.codimensional_points),
            num_active_bodies=self._num_active_bodies,
            num_boxes=self.boxes.num_boxes,
            num_sorted_sets=self.boxes.num_sorted,
            num_searches={kind: self._num_searches[kind] for kind in kinds},
            num_candidates={kind: self._num_candidates[kind] for kind in kinds},
            num_batches=self._num_batches,
        )
        if survivors is not None and contacts is not None:
            status = contacts.status
            counts = replace(
                counts,
                num_after_cull={kind: survivors[kind] for kind in kinds},
                num_contacts={kind: int(np.count_nonzero(contacts.kind == kind)) for kind in kinds},
                num_contacts_at_start=int(np.count_nonzero(status == CCDStatus.INITIAL_CONTACT)),
                num_contacts_at_limit=int(np.count_nonzero(status >= CCDStatus.ITERATION_LIMIT)),
            )
        self.counts = counts

    def contacts(self) -> MeshResult:
        """Compute the toi of every pair that the cull leaves, and gather the result."""
        t_max = self.options.t_max
        survivors: Counter[PairKind] = Counter()
        with self.timed("boxes"):
            self.begin_boxes(self.inflation, t_max, num_aabbs=2)
        with self.timed("pairs"):
            search = self.search(with_cull=True, t_end=t_max, bytes_per_pair=KEY_BYTES + BYTES_PER_CONTACT)
            batches = search.batches(self.tree_pairs)
            store = self.workspace.contacts
            store.begin(self.execution, self.largest_contacts())
        open_pairs = OpenPairs()
        for batch in self.timed_batches(batches):
            with self.timed("narrow phase"):
                for found in batch:
                    survivors[found.kind] += found.count
                self.warn_of_overlaps(survivors.total())
                if batch:
                    self.solve(batch, store, open_pairs)
        with self.timed("narrow phase"):
            self.solve_open(store, open_pairs)
        if not store.is_complete:
            least = self.fixed_bytes + 2 * store.total * BYTES_KEPT
            raise ValueError(
                f"memory_limit is {self.options.memory_limit} bytes; expected at least {least} for the {store.total} "
                f"contacts of this step, or collision_free_step, which keeps none"
            )
        with self.timed("gather"):
            gathered = store.gather()
        return self.result(gathered, search, survivors)

    def solve(self, batch: list[Found], store: ContactStore, open_pairs: "OpenPairs | None") -> None:
        """Run the narrow phase on a batch: the first round or, without ``open_pairs``, the second on marked keys."""
        contacts = store.begin_batch(sum(found.count for found in batch))
        counts = self.buffers.rows("pair counts", len(PairKind), NUM_COUNTS, wp.int64)
        counts.zero_()
        if open_pairs is None:
            num_open = counts.numpy()
            for found in batch:
                num_open[found.kind, OPEN] = found.count
            counts.assign(num_open)
        options = self.workspace.packed(self.options, self.length_scale)
        is_second = int(open_pairs is None)
        outputs = [store.minima, contacts]
        parts = self.parts_of(batch, grain=16 if is_second else 256)

        def launch(part: _PairPart) -> None:
            found = part.found
            a, b = CORNER_ARRAYS[found.kind]
            corners = self.topology.corners
            pairs = [found.begin + part.first, part.count, counts, found.keys, corners[a], corners[b]]
            wp.launch(
                kernel,
                dim=part.count,
                inputs=[
                    0,
                    part.count,
                    int(found.kind),
                    *pairs,
                    self.vertices_t0,
                    self.vertices_t1,
                    options,
                    0,
                    is_second,
                    0.0,
                ],
                outputs=outputs,
                device=self.execution.device,
            )

        kernel = make_narrow_phase(self.options.real).solve_pairs
        self.launch_parts(kernel, parts, launch, is_long=bool(is_second))
        store.end_batch()
        if open_pairs is not None:
            num_open = counts.numpy()
            for found in batch:
                if num_open[found.kind, OPEN]:
                    open_pairs.take(found)

    def solve_open(self, store: ContactStore, open_pairs: "OpenPairs") -> None:
        """The second round: solve the pairs that the first has left open, each with its share of ``max_work``."""
        for kind, keys in open_pairs.marked.items():
            pairs = self.buffers.get("open keys", len(keys), wp.int64)
            pairs[: len(keys)].assign(keys)
            self.solve([Found(kind, pairs, 0, len(keys))], store, None)

    def warn_of_overlaps(self, num_pairs: int) -> None:
        """Warn once if so many pairs are left that parts of the scene seem to overlap."""
        mesh = self.mesh
        primitives = mesh.num_vertices + mesh.num_edges + mesh.num_faces
        if self.is_warned or num_pairs < _MANY_PAIRS or num_pairs < _MANY_PAIRS_EACH * primitives:
            return
        self.is_warned = True
        warnings.warn(
            f"{num_pairs:,} pairs of {primitives:,} primitives may touch, so parts of the scene seem to lie in each "
            f"other; pair_kinds, or exclusion_rings of the mesh, leave pairs out, and memory_limit bounds the memory",
            RuntimeWarning,
            stacklevel=_level_of_caller(),
        )

    def result(self, gathered: Gathered, search: PairSearch, survivors: Counter[PairKind]) -> MeshResult:
        with self.timed("gather"):
            contacts = located(gathered.contacts, self.mesh, *self.host)
        self.count_pairs(search)
        self.finish_counts(survivors, contacts)
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
        )


def _level_of_caller() -> int:
    """Number of stack frames from the function that warns to the first one outside the package."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "ccd_warp":
        frame, level = frame.f_back, level + 1
    return level


def _kinds(mesh: CollisionMesh) -> list[PairKind]:
    """Pair kinds that the primitives of a mesh can form."""
    kinds = [PairKind.VERTEX_FACE, PairKind.EDGE_EDGE]
    if len(mesh.codimensional_points):
        kinds += [PairKind.POINT_SEGMENT, PairKind.POINT_POINT]
    return kinds


def longest_side(vertices_t0: wp.array, vertices_t1: wp.array, execution: Execution, buffers: Buffers) -> float:
    """Longest side of the box around the start and end positions."""
    if len(vertices_t0) == 0:
        return 0.0
    chunk = 64 if execution.is_cuda else 2048
    count = -(-len(vertices_t0) // chunk)
    lower, upper = (buffers.get(f"chunk {side}", count, wp.vec3d) for side in ("lower", "upper"))
    execution.launch(
        box_kernels.chunk_bounds, count, inputs=[vertices_t0, vertices_t1, chunk], outputs=[lower, upper], grain=8
    )
    with np.errstate(over="ignore"):
        sides = upper.numpy()[:count].max(axis=0) - lower.numpy()[:count].min(axis=0)
    return float(min(sides.max(), _LARGEST))
