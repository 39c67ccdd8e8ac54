"""A mesh of one world with a motion of one or many: only what may touch is searched, in the slices in which it may.

The bodies stand in memory once, in parts (`parts.overlap`), and what is near is found before a vertex is placed. Where
that is little of a large mesh, a mesh of these parts is searched (`parts.worlds`). The slices of small worlds, of all
of them, are searched at once: a **cell**, a slice of a world, is a copy of the mesh, which stays with its topology and
its trees. All others are searched slice by slice.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import MISSING, fields, replace
from functools import partial
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.contact_step import ContactStep
from ccd_warp._engine.host.least_toi_step import LeastToiStep
from ccd_warp._engine.host.start_distances import StartDistances
from ccd_warp._engine.host.step import Step
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of, possible_kinds
from ccd_warp._engine.mesh.start_distances import keeps_start_distances
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.motion import Slice
from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.results import Counts, MeshResult
from ccd_warp._results.touch import Touch
from ccd_warp._rigid.mesh_paths import (
    MeshPaths,
    WorldPaths,
    check_motion,
    check_own_frames,
    check_worlds,
    slices_of,
)
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.parts.mesh import PartMesh, rows_within
from ccd_warp._rigid.parts.near_search import Near, body_parts, find_near, reach_of
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.parts.worlds import WorldsOfParts
from ccd_warp._rigid.rotations import in_space
from ccd_warp._rigid.world_results import in_one_world, result_of, sizes_of
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp._scene.replicate import copied_bodies
from ccd_warp.kernels.pair.norm import is_ball

Array = NDArray[np.float64]
_T = TypeVar("_T")
_StepT = TypeVar("_StepT", bound=Step)
# Primitives at a time: of fewer the overhead of a step shows, and more leave the caches. What looks for first contacts
# ends earlier with fewer, down to as many as take the time of that overhead.
_PRIMITIVES, _FEW_PRIMITIVES = 1 << 19, 1 << 12
# Faces from which a mesh of parts may be searched in place of copies, and in place of the one that there is.
_LARGE, _LARGE_ALONE = 2000, 1 << 15
# Slices up to which, and faces of all of them from which, one world is searched slice by slice. What looks for the
# earliest contact ends with the slice in which it is.
_FEW_SLICES, _FEW_SLICES_OF_A_STEP, _MANY_FACES = 1, 3, 1 << 13
# The share of primitives up to which a mesh of parts is smaller than that of one world.
_FEW = 0.25


class Pipeline(Protocol):
    """What the worlds of a motion take of the pipeline of their mesh, and of others for copies of it."""

    mesh: CollisionMesh
    counts: Counts
    timings: dict[str, float]
    _options: Options
    _topology: Topology
    _workspace: Workspace | None
    _show_progress: Callable[[Progress], None] | None

    @classmethod
    def borrowed(cls, mesh: CollisionMesh, options: Options) -> AbstractContextManager[Self]:
        """A pipeline for one call."""

    def _start_distances(self) -> StartDistances | None: ...

    def _check_no_capture(self) -> None: ...

    def _contacts(self, start: Array, end: Array, motion: MeshPaths, *, is_ordered: bool = True) -> MeshResult: ...

    def _least_toi(self, start: Array, end: Array, motion: MeshPaths, *, any_suffices: bool) -> float: ...


class MotionWorlds:
    """The worlds of a motion for a mesh of one world.

    Attributes:
        num_worlds: Number of worlds.
        timings: Seconds of each stage of all that has been searched.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        start: Array,
        end: Array,
        motion: RigidMotion,
    ) -> None:
        """Begin a search; ``start`` and ``end`` are the positions of all vertices, the same in every world.

        Raises:
            ValueError: If the motion has not a row for each rigid body of the mesh in every world, moves a static one,
                or a row of a rigid body differs between both ends.
        """
        self._pipeline, self._motion, self.num_worlds = pipeline, motion, motion.num_worlds
        mesh = self._mesh = pipeline.mesh
        paths = motion._body_paths
        check_motion(mesh, paths, self.num_worlds)
        check_worlds(mesh)
        check_own_frames(mesh, start, end)
        num_primitives = max(mesh.num_faces + mesh.num_edges + mesh.num_vertices, 1)
        most = rows_within(pipeline._options.memory_limit, _PRIMITIVES)
        self._most_copies, self._few_copies = (max(1, count // num_primitives) for count in (most, _FEW_PRIMITIVES))
        self._counts: list[Counts] = []
        self.timings: dict[str, float] = {}
        self._ends = start, end
        self._slices = slices_of(paths, pipeline._options.t_max)

    def _in_batches(
        self, call: Callable[[Pipeline, Array, Array, MeshPaths], _T], world_toi: Array | None = None
    ) -> Iterator[tuple[NDArray[np.intp], _T]]:
        """What a call of the pipeline finds in each batch, the first of whose copies are cells of some worlds.

        It gets a pipeline of the copies, positions and paths. With the tois of worlds, which the caller lowers after
        each batch, the first cells of all worlds are searched first, and those that begin later than a toi not at all.
        """
        cells, bodies = self._cells()
        if len(cells) == 0:
            return
        left, num_together = np.arange(len(cells)), len(cells)
        if world_toi is not None:
            left, num_searched = _by_turns(cells % self.num_worlds)
            num_together = min(max(num_searched, self._few_copies), len(cells))
        copied, shared = copied_bodies(self._mesh)
        least = min(self._most_copies, num_together)
        copies = self._mesh._copies(least, least if bodies is None else self._most_copies)
        count = copies.num_worlds
        start = np.tile(self._ends[0], (count, 1))
        end = start if self._ends[1] is self._ends[0] else np.tile(self._ends[1], (count, 1))
        while len(left):
            rows, left = left[:count], left[count:]
            of_batch = cells[rows]
            padded = np.append(of_batch, np.zeros(count - len(of_batch), dtype=of_batch.dtype))
            number, world = np.divmod(padded, self.num_worlds)
            active = np.zeros((count, len(copied)), dtype=bool)
            active[: len(of_batch)] = True if bodies is None else bodies[np.ix_(rows, copied)]
            times = self._slices.times(number)
            begin, t_end = (np.append(np.repeat(t, len(copied)), np.zeros(len(shared))) for t in times)
            part = Slice(begin, t_end, np.append(active, np.ones(len(shared), dtype=bool)))
            paths = MeshPaths.of_checked(copies, self._motion._of_worlds(world), searched=[part])
            with type(self._pipeline).borrowed(copies, self._pipeline._options) as pipeline:
                pipeline._show_progress = self._pipeline._show_progress
                assert pipeline._workspace is not None
                pipeline._workspace.warn_beside(self._pipeline._workspace)
                result = call(pipeline, start, end, paths)
                self._add(pipeline.counts, pipeline.timings)
            yield world[: len(of_batch)], result
            if world_toi is not None:
                number, world = np.divmod(cells[left], self.num_worlds)
                left = left[self._slices.times(number)[0] <= world_toi[world]]

    def _cells(self) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
        """The cells in which anything may touch, those of a slice one after another, and their bodies; None for all."""
        near = self._near
        if near is None:
            return np.arange(self._slices.num_slices * self.num_worlds), None
        slice_of_cell, world = np.nonzero(near.bodies.any(axis=2))
        return near.number[slice_of_cell] * self.num_worlds + world, near.bodies[slice_of_cell, world]

    def _add(self, counts: Counts, timings: dict[str, float]) -> None:
        """Count what a step did."""
        self._counts.append(counts)
        for name, seconds in timings.items():
            self.timings[name] = self.timings.get(name, 0.0) + seconds

    def counts(self) -> Counts:
        """What all that has been searched did; sizes are those of all worlds."""
        kinds = possible_kinds(self._mesh, self._pipeline._options)
        total: dict[str, Any] = {}
        for field in fields(Counts):
            values = [getattr(counts, field.name) for counts in self._counts]
            if field.default is MISSING:
                total[field.name] = {kind: sum(value.get(kind, 0) for value in values) for kind in kinds}
            else:
                total[field.name] = sum(values)
        return Counts(**(total | sizes_of(self._mesh, self.num_worlds)))

    def least_toi(self, *, any_suffices: bool = False) -> float:
        """The least toi of all worlds, or that of any contact, inf if there is none."""

        def least_of(tois: Iterator[float]) -> float:
            least = np.inf
            for toi in tois:
                least = min(least, toi)
                if least <= 0.0 or (any_suffices and least < np.inf):
                    break
            return least

        if self._is_whole(_FEW_SLICES_OF_A_STEP):
            least = self._pipeline._least_toi(*self._ends, self._whole_paths(), any_suffices=any_suffices)
            self._add(self._pipeline.counts, self._pipeline.timings)
            return least
        if self._are_parts:
            if any_suffices or not keeps_start_distances(self._mesh, self._pipeline._options):
                of_parts = partial(LeastToiStep.least_toi, any_suffices=any_suffices)
                return least_of(toi for *_, toi in self._parts.search(self._on_parts(LeastToiStep, of_parts)))
            least, may_part = self._earliest_of_parts()
            if not may_part:
                return least
        batches = self._in_batches(lambda copies, *step: copies._least_toi(*step, any_suffices=any_suffices))
        return least_of(toi for _, toi in batches)

    def _earliest_of_parts(self) -> tuple[float, bool]:
        """The least toi by parts, and whether anything starts within its distance in a world that has this toi."""
        mesh, least = self._mesh, np.inf
        found: list[tuple[NDArray[np.intp], PartMesh, Contacts | None]] = []
        for worlds, of_parts, (toi, pairs) in self._parts.search(self._on_parts(LeastToiStep, LeastToiStep.earliest)):
            if toi < least:
                least, found = toi, []
            if toi == least < np.inf:
                found.append((worlds, of_parts, pairs))
            if least <= 0.0:
                return least, True
        near = self._pipeline._start_distances()
        for worlds, of_parts, pairs in found:
            if pairs is None or near is None:
                return least, True
            numbers = {"vertex": of_parts.vertex, "face": of_parts.face}
            for world in np.unique(in_one_world(pairs, of_parts.mesh, mesh, worlds, numbers).world):
                paths = MeshPaths.of_checked(mesh, self._motion._of_worlds(np.array([world])))
                if near.of(paths.at(mesh, self._ends[0], self._ends[0], 0.0)) is not None:
                    return least, True
        return least, False

    def result(self, *, is_of_first: bool = False) -> MeshResult:
        """The contacts in all worlds; or those among which the first of each world are, if these alone are wanted."""
        if self._is_whole(_FEW_SLICES):
            return self._pipeline._contacts(*self._ends, self._whole_paths())
        world_toi, contacts, hidden = np.full(self.num_worlds, np.inf), [], ""
        for worlds, result, of_one in self._results(world_toi if is_of_first else None):
            np.minimum.at(world_toi, worlds, result.world_toi[: len(worlds)])
            contacts.append(of_one)
            hidden = hidden or result.hidden_gaps
        mesh, options = self._mesh, self._pipeline._options
        frames = MovingVertices(mesh, *self._ends, WorldPaths.of_worlds(mesh, self._motion._body_paths))
        scale, radius = length_scale_of(mesh, options), mesh.radius
        touch = Touch.of(options, scale, is_euclidean=is_ball(norm_of(mesh, options)), radius=radius)
        return result_of(mesh, world_toi, contacts, self.counts(), self.timings, hidden, frames, touch)

    def _results(self, world_toi: Array | None) -> Iterator[tuple[NDArray[np.intp], MeshResult, Contacts]]:
        """Worlds, their results in a mesh of their own, and their contacts in that of one world.

        With the tois of worlds as of :meth:`_in_batches`.
        """
        mesh = self._mesh
        if not self._are_parts:

            def of_copies(copies: Pipeline, *step: Any) -> tuple[CollisionMesh, MeshResult]:
                return copies.mesh, copies._contacts(*step, is_ordered=False)

            for worlds, (copies, result) in self._in_batches(of_copies, world_toi):
                yield worlds, result, in_one_world(result.contacts, copies, mesh, worlds)
            return
        of_step = partial(ContactStep.contacts, is_ordered=False, is_placed=False)
        for worlds, of_parts, result in self._parts.search(self._on_parts(ContactStep, of_step)):
            numbers = {"vertex": of_parts.vertex, "face": of_parts.face}
            yield worlds, result, in_one_world(result.contacts, of_parts.mesh, mesh, worlds, numbers)

    @property
    def _may_be_cut(self) -> bool:
        """Whether bodies are large enough for meshes of parts."""
        parts, least = self._body_parts, _LARGE if self.num_worlds > 1 else _LARGE_ALONE
        return parts is not None and parts.may_be_cut and self._mesh.num_faces >= least

    @lazy_property
    def _are_parts(self) -> bool:
        """Whether meshes of parts are searched: where little is near in one world."""
        mesh = self._mesh
        if not self._may_be_cut or self.num_worlds > 1:
            return self._may_be_cut
        return self._parts.num_primitives < _FEW * (mesh.num_faces + len(mesh.codimensional_edges))

    def _is_whole(self, few: int) -> bool:
        """Whether the one world that there is goes slice by slice: of a large mesh, or where it is near in few."""
        if self.num_worlds > 1 or self._are_parts:
            return False
        num_near = self._slices.num_slices if self._near is None else len(self._near.number)
        return 0 < num_near <= few or num_near * self._mesh.num_faces > _MANY_FACES

    def _whole_paths(self) -> MeshPaths:
        """The paths of the one world that there is, with the slices in which anything is near, and what."""
        searched = None if self._near is None else self._near.slices(self._slices)
        return MeshPaths.of_checked(self._mesh, self._motion._body_paths, searched=searched)

    @lazy_property
    def _parts(self) -> WorldsOfParts:
        """The parts that may touch."""
        parts, near = self._body_parts, self._near
        assert parts is not None
        assert near is not None
        return WorldsOfParts(parts, near, self._motion, self._slices, self._pipeline._options.memory_limit)

    @lazy_property
    def _near(self) -> Near | None:
        """What may touch in each slice of each world; None where this is not looked for."""
        start = in_space(self._ends[0])
        ends = start, start if self._ends[0] is self._ends[1] else in_space(self._ends[1])
        options = self._pipeline._options
        of_step = ends, self._motion._body_paths, self._slices, reach_of(self._mesh, options), options.threads
        return find_near(self._pipeline._topology, self._body_parts, *of_step, wants_parts=self._may_be_cut)

    @lazy_property
    def _body_parts(self) -> BodyParts | None:
        """The parts of the bodies of a world; None where they are not looked for."""
        return body_parts(self._pipeline._topology, self._ends, self.num_worlds)

    def _on_parts(self, kind: type[_StepT], work: Callable[[_StepT], _T]) -> Callable[[PartMesh, MeshPaths], _T]:
        """Some work on a step of a kind of a mesh of parts."""

        def on_parts(parts: PartMesh, paths: MeshPaths) -> _T:
            pipeline, mesh = self._pipeline, self._mesh
            options = replace(pipeline._options, length_scale=length_scale_of(mesh, pipeline._options))
            pipeline._check_no_capture()
            workspace = Workspace(parts.mesh, pipeline._topology.device, beside=pipeline._workspace)
            workspace.topology.vertex_rank = parts.rank
            workspace.progress.show = pipeline._show_progress
            with kind(workspace, (parts.mesh.vertices, parts.mesh.vertices), options, paths) as step:
                result = work(step)
            self._add(step.counts, step.timings)
            return result

        return on_parts


def _by_turns(world: NDArray[np.int64]) -> tuple[NDArray[np.intp], int]:
    """The order of rows in which each world has its first before any has its second, and the number of worlds."""
    order = np.argsort(world, kind="stable")
    of_order = world[order]
    first = np.flatnonzero(np.append(True, of_order[1:] != of_order[:-1]))
    sizes = np.diff(np.append(first, len(order)))
    turn = np.arange(len(order)) - np.repeat(first, sizes)
    return order[np.argsort(turn, kind="stable")], len(first)
