"""Edges of many worlds by their parts: only slices in which parts may touch are searched, with these parts alone.

All slices of all worlds are tested by spheres first (`near_parts`). What may touch in a slice is a world of a mesh of
parts (`part_mesh`), in which a pass says in which slices there may be a contact. Of each world the first of those is
searched to the end (`joint_search`), with the primitives of its contacts alone: others are certain not to touch in it.
Where it turns out to be free, the next one follows.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.joint_search import Array, JointSearch, Links, Solve, slices_of_worlds
from ccd_warp._engine.host.near_parts import NearParts, ranges, spans
from ccd_warp._engine.host.part_mesh import MOST_BODIES, PartMesh, rows_within
from ccd_warp._engine.host.world_results import result_of, sizes_of
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths
from ccd_warp._results import Counts, MeshResult
from ccd_warp._runtime.launch import Execution
from ccd_warp._status import PairKind

if TYPE_CHECKING:
    from ccd_warp._joint_motion import JointMotion

# Primitives, and slices, of a mesh of parts: enough to fill a pass, and not much memory.
_MOST_ROWS, _MOST_SLICES = 1 << 18, 1 << 10
_HALVINGS = 2  # of a slice
_FEW_SLICES = 32  # of which it does not pay to leave out those that are settled


class NearSearch:
    """The earliest contacts of each world of a motion, whose worlds are copies of one.

    Attributes:
        world_toi: Toi of each world, inf where it is free, shape [W].
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        parts: NearParts,
        motion: "JointMotion",
        t_max: float,
        kinds: Sequence[PairKind],
        execution: Execution,
        memory_limit: int | None = None,
    ) -> None:
        """Begin a search for pairs of some kinds in a mesh, all of whose worlds are copies of one, up to a time."""
        self._most_rows = rows_within(memory_limit, _MOST_ROWS)
        self._mesh, self._parts, self._motion, self._t_max, self._kinds = mesh, parts, motion, t_max, kinds
        self._execution = execution
        world = self._world = parts.mesh
        one = Links.of(world, world.vertices, motion._of_worlds(np.zeros(1, dtype=np.intp)))
        self._spheres = one.centre, one.reach
        self.world_toi = np.full(motion.num_worlds, np.inf)
        self._found: list[Contacts] = []
        self._results: list[MeshResult] = []

    def run(self, solver: Callable[[PartMesh], Solve], reach: float) -> None:
        """Search all worlds; ``solver`` is of what finds contacts in a mesh, ``reach`` a distance that pairs keep."""
        begin = time.perf_counter()
        self._choose_slices(reach)
        self._seconds = time.perf_counter() - begin
        is_open = np.ones(len(self.world_toi), dtype=bool)
        touching: dict[int, NDArray[np.intp]] = {}  # slices with a pass that touches, and the primitives that may
        is_done = np.zeros(len(self._of), dtype=bool)  # slices with a pass, or free
        while True:
            known = np.array(sorted(touching), dtype=np.intp)
            known = known[is_open[self._of[known]]]
            known = known[np.unique(self._of[known], return_index=True)[1]]  # the first of each world
            until = np.full(len(self.world_toi), len(self._of))
            until[self._of[known]] = known
            left = np.flatnonzero(~is_done & is_open[self._of] & (np.arange(len(self._of)) < until[self._of]))
            if len(left):
                chosen = self._batch(left)
                touching |= self._pass(chosen, solver)
                is_done[chosen] = True
            elif len(known):
                toi = self._to_the_end(known, touching, solver)
                hits = known[toi < np.inf]
                self.world_toi[self._of[hits]] = toi[toi < np.inf]
                is_open[self._of[hits]] = False
                for each in known.tolist():
                    del touching[each]
            else:
                break

    def _choose_slices(self, reach: float) -> None:
        """The slices in which parts may touch, and these parts: those of a world in the order of time."""
        motion, parts = self._motion, self._parts
        each = slices_of_worlds(motion, 0.0, self._t_max).astype(np.intp)
        row, a, b = parts.near(motion, *spans(each, self._t_max), reach, self._execution, _HALVINGS)
        world, begin, end = spans(each << _HALVINGS, self._t_max)
        count = len(parts.body)
        keys = np.unique(np.concatenate([row * count + a, row * count + b]))
        of_key, self._part = np.divmod(keys, count)
        near, self._first = np.unique(of_key, return_index=True)
        self._first = np.append(self._first, len(keys))
        self._of, self._begin, self._end_of = world[near], begin[near], end[near]
        number = np.repeat(np.arange(len(near)), np.diff(self._first))
        self._num_bodies = parts.num_bodies(number, self._part, len(near))

    def _batch(self, left: NDArray[np.intp]) -> NDArray[np.intp]:
        """Some of the slices, the first of all worlds first, that fit in one mesh."""
        rank = np.arange(len(left)) - np.searchsorted(self._of[left], self._of[left])
        ordered = left[np.argsort(rank, kind="stable")]
        sizes = self._sizes(ordered)
        fits = min(
            int(np.searchsorted(np.cumsum(sizes), self._most_rows)),
            int(np.searchsorted(np.cumsum(self._num_bodies[ordered]), MOST_BODIES)),
        )
        return np.sort(ordered[: min(max(1, fits), _MOST_SLICES)])

    def _sizes(self, slices: NDArray[np.intp]) -> NDArray[np.intp]:
        """Primitives of slices."""
        of_part = np.append(0, np.cumsum(np.diff(self._parts.begins)[self._part]))
        return of_part[self._first[slices + 1]] - of_part[self._first[slices]]

    def _pass(self, slices: NDArray[np.intp], solver: Callable[[PartMesh], Solve]) -> dict[int, NDArray[np.intp]]:
        """A pass over slices: those in which something may touch, with the primitives that may."""
        counts = np.diff(self._first)[slices]
        which = np.repeat(np.arange(len(slices)), counts)
        part = self._part[ranges(self._first[slices], counts)]
        first = self._parts.begins
        sizes = first[part + 1] - first[part]
        parts = PartMesh.of(self._parts, len(slices), np.repeat(which, sizes), ranges(first[part], sizes))
        search, solve = self._search(parts, slices, solver)
        result = search.make_pass(solve)
        touches = np.isfinite(result.world_toi)
        of_slice, row = parts.rows_of(result.contacts, touches)
        bounds = np.searchsorted(of_slice, np.arange(len(slices) + 1)).tolist()
        return {int(each): row[bounds[k] : bounds[k + 1]] for k, each in enumerate(slices.tolist()) if touches[k]}

    def _to_the_end(
        self,
        slices: NDArray[np.intp],
        rows: dict[int, NDArray[np.intp]],
        solver: Callable[[PartMesh], Solve],
    ) -> Array:
        """The toi in each of some slices, with these primitives alone, inf where it is free.

        When half of them are settled the others have a mesh of their own.
        """
        toi = np.full(len(slices), np.inf)
        for k in range(0, len(slices), _MOST_SLICES):
            chosen = slices[k : k + _MOST_SLICES]
            own = [rows[each] for each in chosen.tolist()]
            left, before = np.arange(len(chosen)), None
            while len(left):
                of_slice = np.repeat(np.arange(len(left)), [len(own[j]) for j in left.tolist()])
                parts = PartMesh.of(self._parts, len(left), of_slice, np.concatenate([own[j] for j in left.tolist()]))
                search, solve = self._search(parts, chosen[left], solver)
                if before is not None:
                    search.go_on(before, np.flatnonzero(before.is_open))
                search.run(solve, leave=len(left) // 2 if len(left) > _FEW_SLICES else 0)
                toi[k + left] = search.world_toi
                of_world = self._of[chosen[left]]
                self._found += [parts.in_worlds(each, self._mesh, self._world, of_world) for each in search.found]
                left, before = left[search.is_open], search
        return toi

    def _search(
        self, parts: PartMesh, slices: NDArray[np.intp], solver: Callable[[PartMesh], Solve]
    ) -> tuple[JointSearch, Solve]:
        """A search of slices in a mesh of parts, each a window of its own."""
        mesh = parts.mesh
        links = Links(self._motion._of_worlds(self._of[slices]), *self._spheres, parts.is_used)
        span = self._begin[slices], self._end_of[slices]
        solve = solver(parts)

        def counted(begin: Array, end: Array, paths: MeshPaths) -> MeshResult:
            result = solve(begin, end, paths)
            self._results.append(result)
            return result

        scale, one = self._mesh.length_scale, np.ones(len(slices))
        search = JointSearch(mesh, mesh.vertices, mesh.vertices, links, span, self._t_max, num_slices=one, scale=scale)
        return search, counted

    def result(self) -> MeshResult:
        """The result of all passes, whose counts and times are sums."""
        mesh, passes = self._mesh, [each.counts for each in self._results]
        sums: dict[str, Any] = {
            name: sum(getattr(each, name) for each in passes)
            for name in ("num_active_bodies", "num_boxes", "num_sorted_sets", "num_batches")
        }
        for name in ("num_searches", "num_candidates", "num_after_cull", "num_contacts"):
            sums[name] = {kind: sum(getattr(each, name).get(kind, 0) for each in passes) for kind in self._kinds}
        counts = Counts(**sizes_of(mesh, len(self.world_toi)), **sums)
        timings: Counter[str] = Counter()
        for each in self._results:
            timings.update(each.timings)
        times = {"near parts": self._seconds, **timings, "total": timings["total"] + self._seconds}
        return result_of(mesh, self.world_toi, self._found, counts, times)
