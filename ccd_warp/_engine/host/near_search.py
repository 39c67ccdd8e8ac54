"""Edges of many worlds by their parts: only windows in which parts may touch are searched, with these parts alone.

Slices of all worlds are tested first (`near_parts`), some at a time. What may touch in a window of a slice is a world
of a mesh of parts (`part_mesh`), in which a pass says whether there may be a contact. The first such window of each
world is searched to the end (`joint_search`), with the primitives of its contacts alone: others are certain not to
touch in it. Where it turns out to be free, the windows after it follow.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.joint_search import Array, JointSearch, Links, Solve, Windows, slices_of_worlds
from ccd_warp._engine.host.near_parts import NearParts, spans
from ccd_warp._engine.host.part_mesh import MOST_BODIES, PartMesh, rows_within
from ccd_warp._engine.host.part_trees import distinct, ranges
from ccd_warp._engine.host.world_results import result_of, sizes_of
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths
from ccd_warp._results import Counts, MeshResult
from ccd_warp._runtime.launch import Execution
from ccd_warp._status import PairKind

if TYPE_CHECKING:
    from ccd_warp._joint_motion import JointMotion

# Primitives, and windows, of a mesh of parts, and worlds at a time: enough to fill a pass, and not much memory.
_MOST_ROWS, _MOST_WINDOWS, _MOST_WORLDS = 1 << 18, 1 << 10, 1 << 12
_FEW_WORLDS = 32  # of which it does not pay to leave out those that are settled
_HALVINGS = 2  # of a slice
# Slices, and windows, of each world at a time, and of all: what lies after a contact is not looked at.
_LEAST_SLICES, _SLICES = 2, 1 << 10
_LEAST_WINDOWS, _FEW_WINDOWS = 1, 1 << 8


class _NearWindows:
    """The windows of slices in which parts may touch, those of a world in the order of time.

    Attributes:
        world: The world of each, shape [n].
        begin: Its begin.
        end: Its end.
        sizes: The number of primitives of its parts.
        num_bodies: The number of bodies that have them.
    """

    def __init__(
        self,
        parts: NearParts,
        motion: JointMotion,
        world: NDArray[np.intp],
        begin: Array,
        end: Array,
        reach: float,
        execution: Execution,
    ) -> None:
        row, a, b = parts.near(motion, world, begin, end, reach, execution, _HALVINGS)
        each, count = 1 << _HALVINGS, len(parts.body)
        times = begin[:, None] + np.arange(each + 1) / each * (end - begin)[:, None]
        times[:, -1] = end
        of_key, self._part = np.divmod(distinct(np.concatenate([row * count + a, row * count + b])), count)
        near, first = np.unique(of_key, return_index=True)
        self.world, self.begin, self.end = world[near // each], times[:, :-1].ravel()[near], times[:, 1:].ravel()[near]
        self._parts, self._first = parts, np.append(first, len(of_key))
        number = np.repeat(np.arange(len(near)), np.diff(self._first))
        self.num_bodies = parts.num_bodies(number, self._part, len(near))
        of_part = np.append(0, np.cumsum(np.diff(parts.begins)[self._part]))
        self.sizes = of_part[self._first[1:]] - of_part[self._first[:-1]]

    def rows(self, windows: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The primitives of the parts of some windows: the window, as one of those, and the row."""
        counts = np.diff(self._first)[windows]
        part = self._part[ranges(self._first[windows], counts)]
        begins = self._parts.begins
        sizes = begins[part + 1] - begins[part]
        return np.repeat(np.arange(len(windows)), self.sizes[windows]), ranges(begins[part], sizes)


class NearSearch:
    """The earliest contacts of each world of a motion, whose worlds are copies of one.

    Attributes:
        world_toi: Toi of each world, inf where it is free, shape [W].
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        parts: NearParts,
        motion: JointMotion,
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
        self._passes: list[tuple[Counts, dict[str, float]]] = []
        self._seconds = 0.0

    def run(self, solver: Callable[[PartMesh], Solve], reach: float) -> None:
        """Search all worlds; ``solver`` is of what finds contacts in a mesh, ``reach`` a distance that pairs keep."""
        count = len(self.world_toi)
        self._begin, self._end = np.zeros(count), np.zeros(count)  # of the last window of each world
        self._at = Windows.of(self._begin, self._end)
        for first in range(0, count, _MOST_WORLDS):
            is_open = np.zeros(count, dtype=bool)
            is_open[first : first + _MOST_WORLDS] = True
            while is_open.any():
                touching = self._first_windows(is_open, solver, reach)
                worlds = np.array(sorted(touching), dtype=np.intp)
                self.world_toi[worlds] = self._to_the_end(worlds, touching, solver)
                is_open[:] = False
                is_open[worlds] = (self.world_toi[worlds] == np.inf) & (self._end[worlds] < self._t_max)

    def _first_windows(
        self, is_open: NDArray[np.bool_], solver: Callable[[PartMesh], Solve], reach: float
    ) -> dict[int, NDArray[np.intp]]:
        """The first window of each open world, after its last one, in which a pass touches; primitives by world."""
        each = slices_of_worlds(self._motion, 0.0, self._t_max).astype(np.intp)
        world, begin, end = spans(each, self._t_max)
        number = np.arange(len(world)) - np.repeat(np.cumsum(each) - each, each)
        begin = np.maximum(begin, self._end[world])
        is_left = is_open[world] & (end > self._end[world])
        first, is_open = int(number[is_left].min(initial=each.max(initial=0))), is_open.copy()
        found: dict[int, NDArray[np.intp]] = {}
        while first < each.max(initial=0) and is_open.any():
            last = first + max(_LEAST_SLICES, _SLICES // int(is_open.sum()))
            some = np.flatnonzero(is_left & is_open[world] & (number >= first) & (number < last))
            since = time.perf_counter()
            near = _NearWindows(self._parts, self._motion, world[some], begin[some], end[some], reach, self._execution)
            self._seconds += time.perf_counter() - since
            left = np.arange(len(near.world))
            while len(left):
                chosen = self._batch(near, left)
                found |= self._pass(near, chosen, solver)
                is_open[list(found)] = False
                left = np.setdiff1d(left, chosen, assume_unique=True)
                left = left[is_open[near.world[left]]]
            first = last
        return found

    def _batch(self, near: _NearWindows, left: NDArray[np.intp]) -> NDArray[np.intp]:
        """Some of the windows, the first of all worlds first, that fit in one mesh."""
        rank = np.arange(len(left)) - np.searchsorted(near.world[left], near.world[left])
        ordered = left[np.argsort(rank, kind="stable")]
        wanted = int((rank < max(_LEAST_WINDOWS, _FEW_WINDOWS // int((rank == 0).sum()))).sum())
        fits = min(
            int(np.searchsorted(np.cumsum(near.sizes[ordered]), self._most_rows)),
            int(np.searchsorted(np.cumsum(near.num_bodies[ordered]), MOST_BODIES)),
        )
        return np.sort(ordered[: min(max(1, fits), wanted, _MOST_WINDOWS)])

    def _pass(
        self, near: _NearWindows, windows: NDArray[np.intp], solver: Callable[[PartMesh], Solve]
    ) -> dict[int, NDArray[np.intp]]:
        """A pass over windows: the worlds in which something may touch, with the primitives that may in the first."""
        of_window, rows = near.rows(windows)
        parts = PartMesh.of(self._parts, len(windows), of_window, rows)
        of_world, span = near.world[windows], (near.begin[windows], near.end[windows])
        search, solve = self._search(parts, of_world, span, solver)
        result = search.make_pass(solve)
        touching = np.flatnonzero(np.isfinite(result.world_toi))
        touching = touching[np.unique(of_world[touching], return_index=True)[1]]  # windows are in the order of time
        worlds = of_world[touching]
        self._begin[worlds], self._end[worlds] = (times[touching] for times in span)
        for own, values in zip(self._at, search.at, strict=True):
            own[worlds] = values[touching]
        touches = np.zeros(len(windows), dtype=bool)
        touches[touching] = True
        of_window, row = parts.rows_of(result.contacts, touches)
        bounds = np.searchsorted(of_window, [touching, touching + 1]).tolist()
        return {world: row[i:j] for world, i, j in zip(worlds.tolist(), *bounds, strict=True)}

    def _to_the_end(
        self, worlds: NDArray[np.intp], rows: dict[int, NDArray[np.intp]], solver: Callable[[PartMesh], Solve]
    ) -> Array:
        """The toi in the last window of each of some worlds, with these primitives alone, inf where it is free.

        When half of them are settled the others have a mesh of their own.
        """
        toi = np.full(len(worlds), np.inf)
        for k in range(0, len(worlds), _MOST_WINDOWS):
            left = np.arange(k, min(k + _MOST_WINDOWS, len(worlds)))
            while len(left):
                chosen = worlds[left]
                own = [rows[world] for world in chosen.tolist()]
                of_window = np.repeat(np.arange(len(left)), [len(each) for each in own])
                parts = PartMesh.of(self._parts, len(left), of_window, np.concatenate(own))
                search, solve = self._search(parts, chosen, (self._begin[chosen], self._end[chosen]), solver)
                search.at = self._at.of_worlds(chosen)
                search.run(solve, leave=len(left) // 2 if len(left) > _FEW_WORLDS else 0)
                toi[left] = search.world_toi
                for values, found in zip(self._at, search.at, strict=True):
                    values[chosen] = found
                for each in search.found:
                    placed = {"points": each.points, "relative_velocity": each.relative_velocity}
                    self._found.append(parts.in_worlds(each, self._mesh, self._world, chosen, **placed))
                left = left[search.is_open]
        return toi

    def _search(
        self, parts: PartMesh, worlds: NDArray[np.intp], span: tuple[Array, Array], solver: Callable[[PartMesh], Solve]
    ) -> tuple[JointSearch, Solve]:
        """A search of windows of worlds in a mesh of parts."""
        mesh = parts.mesh
        links = Links(self._motion._of_worlds(worlds), *self._spheres, parts.is_used)
        solve = solver(parts)

        def counted(begin: Array, end: Array, paths: MeshPaths) -> MeshResult:
            result = solve(begin, end, paths)
            self._passes.append((result.counts, result.timings))
            return result

        scale, one = self._mesh.length_scale, np.ones(len(worlds))
        search = JointSearch(mesh, mesh.vertices, mesh.vertices, links, span, self._t_max, num_slices=one, scale=scale)
        return search, counted

    def result(self) -> MeshResult:
        """The result of all passes, whose counts and times are sums."""
        mesh, passes = self._mesh, [counts for counts, _ in self._passes]
        sums: dict[str, Any] = {
            name: sum(getattr(each, name) for each in passes)
            for name in ("num_active_bodies", "num_boxes", "num_sorted_sets", "num_batches")
        }
        for name in ("num_searches", "num_candidates", "num_after_cull", "num_contacts"):
            sums[name] = {kind: sum(getattr(each, name).get(kind, 0) for each in passes) for kind in self._kinds}
        counts = Counts(**sizes_of(mesh, len(self.world_toi)), **sums)
        timings: Counter[str] = Counter()
        for _, seconds in self._passes:
            timings.update(seconds)
        times = {"near parts": self._seconds, **timings, "total": timings["total"] + self._seconds}
        return result_of(mesh, self.world_toi, self._found, counts, times)
