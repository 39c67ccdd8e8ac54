"""A mesh of one world with a motion of one or many: only what may touch is searched, in the slices in which it may.

What is near is found before a vertex is placed, of all worlds at once. Then copies of the mesh are searched, which stay
with their topology and their trees: for contacts each is a **cell**, a slice of a world, and for the least toi a world.
One world is searched slice by slice, but for contacts in many slices of a small one; or, where little of a large one is
near, as a mesh of these parts (`parts.mesh`).
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
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of, possible_kinds
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
from ccd_warp._rigid.parts.mesh import PartMesh
from ccd_warp._rigid.parts.near_search import Near, body_parts, find_near, touching_distance
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.rotations import in_space
from ccd_warp._rigid.world_results import in_one_world, result_of, sizes_of
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp._scene.replicate import copied_bodies

Array = NDArray[np.float64]
_T = TypeVar("_T")
_StepT = TypeVar("_StepT", bound=HostStep)
# Primitives at a time: of fewer the overhead of a step shows, and more leave the caches. What looks for first contacts
# ends earlier with fewer, down to as many as take the time of that overhead.
_PRIMITIVES, _FEW_PRIMITIVES = 1 << 19, 1 << 12
_BYTES_OF_A_PRIMITIVE = 1024  # with its boxes and pairs, about
# Slices up to which, and faces of all of them from which, contacts of one world are searched slice by slice.
_FEW_SLICES, _MANY_FACES = 1, 1 << 13
# Faces of one world from which a mesh of parts may be searched, and the share of primitives up to which it is smaller.
_LARGE_ALONE, _FEW = 1 << 15, 0.25


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
    def _borrowed(cls, mesh: CollisionMesh, options: Options) -> AbstractContextManager[Self]:
        """A pipeline for one call."""

    def _start_distances(self) -> StartDistances | None: ...

    def _check_no_capture(self) -> None: ...

    def _contacts(self, start: Array, end: Array, motion: MeshPaths, *, is_ordered: bool = True) -> MeshResult: ...

    def _least_toi(self, start: Array, end: Array, motion: MeshPaths, *, any_suffices: bool) -> float: ...


_Call = Callable[[Pipeline, Array, Array, MeshPaths], _T]  # of a pipeline of copies, with positions and paths


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
        paths, limit = motion._body_paths, pipeline._options.memory_limit
        check_motion(mesh, paths, self.num_worlds)
        check_worlds(mesh)
        check_own_frames(mesh, start, end)
        num_primitives = max(mesh.num_faces + mesh.num_edges + mesh.num_vertices, 1)
        most = _PRIMITIVES if limit is None else min(_PRIMITIVES, limit // _BYTES_OF_A_PRIMITIVE)
        self._most_copies, self._few_copies = (max(1, count // num_primitives) for count in (most, _FEW_PRIMITIVES))
        self._counts: list[Counts] = []
        self.timings: dict[str, float] = {}
        self._ends = start, end
        self._slices = slices_of(paths, pipeline._options.t_max)

    def _in_batches(self, call: _Call[_T], world_toi: Array | None = None) -> Iterator[tuple[NDArray[np.intp], _T]]:
        """What a call of the pipeline finds in each batch of cells, the first of whose copies are cells of some worlds.

        With the tois of worlds, which the caller lowers after each batch, the first cells of all worlds are searched
        first, and those that begin later than a toi not at all.
        """
        cells, bodies = self._cells()
        if len(cells) == 0:
            return
        left, num_together = np.arange(len(cells)), len(cells)
        if world_toi is not None:
            left, num_searched = _by_turns(cells % self.num_worlds)
            num_together = min(max(num_searched, self._few_copies), len(cells))
        copies = self._copies(num_together)
        while len(left):
            rows, left = np.split(left, [copies.num_worlds])
            number, world = np.divmod(cells[rows], self.num_worlds)
            active = self._active_in(copies, len(rows), None if bodies is None else bodies[rows])
            yield world, self._on_copies(call, copies, world, [self._slice_of_each(copies, number, active)])
            if world_toi is not None:
                number, world = np.divmod(cells[left], self.num_worlds)
                left = left[self._slices.times(number)[0] <= world_toi[world]]

    def _active_in(self, copies: CollisionMesh, count: int, bodies: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Which copied bodies the first ``count`` copies search, of those of the mesh that each has; all by default."""
        copied, _ = copied_bodies(self._mesh)
        active = np.zeros((copies.num_worlds, len(copied)), dtype=bool)
        active[:count] = True if bodies is None else bodies[:, copied]
        return active

    def _with_shared(self, of_copies: NDArray[Any], of_shared: float) -> NDArray[Any]:
        """Values of the bodies of all copies, and one value for those that they share, which come last."""
        _, shared = copied_bodies(self._mesh)
        return np.append(of_copies, np.full(len(shared), of_shared, dtype=of_copies.dtype))

    def _slice_of_each(self, copies: CollisionMesh, number: NDArray[np.intp], active: NDArray[np.bool_]) -> Slice:
        """The slice in which each copy has another of the step, the first slice where there are fewer."""
        of_copies = np.append(number, np.zeros(copies.num_worlds - len(number), dtype=number.dtype))
        times = (np.repeat(t, active.shape[1]) for t in self._slices.times(of_copies))
        begin, t_end = (self._with_shared(t, 0.0) for t in times)
        return Slice(begin, t_end, self._with_shared(active, True))

    def _cells(self) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
        """The cells in which anything may touch, those of a slice one after another, and their bodies; None for all."""
        near = self._near
        if near is None:
            return np.arange(self._slices.num_slices * self.num_worlds), None
        slice_of_cell, world = np.nonzero(near.bodies.any(axis=2))
        return near.number[slice_of_cell] * self.num_worlds + world, near.bodies[slice_of_cell, world]

    def _in_worlds(self, call: _Call[_T]) -> Iterator[_T]:
        """What a call of the pipeline finds in whole worlds, some at a time, slice after slice."""
        near = self._near
        worlds = np.arange(self.num_worlds) if near is None else np.flatnonzero(near.bodies.any(axis=(0, 2)))
        if len(worlds) == 0:
            return
        copies = self._copies(len(worlds))
        for first in range(0, len(worlds), copies.num_worlds):
            of_batch, slices = worlds[first : first + copies.num_worlds], []
            for k, time_slice in enumerate(self._slices.all() if near is None else near.slices(self._slices)):
                active = self._active_in(copies, len(of_batch), None if near is None else near.bodies[k][of_batch])
                if active.any():
                    slices.append(time_slice._replace(active=self._with_shared(active, True)))
            yield self._on_copies(call, copies, of_batch, slices)

    def _copies(self, count: int) -> CollisionMesh:
        """Copies of the mesh, so many, or as many as are searched at a time."""
        least = min(self._most_copies, count)
        return self._mesh._copies(least, least if self._near is None else self._most_copies)

    def _on_copies(self, call: _Call[_T], copies: CollisionMesh, world: NDArray[np.intp], searched: list[Slice]) -> _T:
        """What a call of the pipeline finds in copies, each in the place of a world, in these slices.

        Copies that are left over stand in the place of the first world, and no slice searches them.
        """
        places = np.append(world, np.zeros(copies.num_worlds - len(world), dtype=world.dtype))
        paths = MeshPaths.of_checked(copies, self._motion._of_worlds(places), searched=searched)
        start = np.tile(self._ends[0], (copies.num_worlds, 1))
        end = start if self._ends[1] is self._ends[0] else np.tile(self._ends[1], (copies.num_worlds, 1))
        with type(self._pipeline)._borrowed(copies, self._pipeline._options) as pipeline:
            pipeline._show_progress = self._pipeline._show_progress
            assert pipeline._workspace is not None
            pipeline._workspace.warn_with(self._pipeline._workspace)
            result = call(pipeline, start, end, paths)
            self._add(pipeline.counts, pipeline.timings)
        return result

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
        least = np.inf
        if self._are_parts:
            _, least = self._on_parts(LeastToiStep, partial(LeastToiStep.least_toi, any_suffices=any_suffices))
            if any_suffices or least == np.inf or not self._may_part(least):
                return least
        if self.num_worlds == 1:
            least = self._pipeline._least_toi(*self._ends, self._paths, any_suffices=any_suffices)
            self._add(self._pipeline.counts, self._pipeline.timings)
            return least
        for toi in self._in_worlds(lambda copies, *step: copies._least_toi(*step, any_suffices=any_suffices)):
            least = min(least, toi)
            if least <= 0.0 or (any_suffices and least < np.inf):
                break
        return least

    def _may_part(self, least: float) -> bool:
        """Whether anything starts within its distance in the one world that there is, so that it may part and slide."""
        near = self._pipeline._start_distances()
        if near is None:
            return False
        return least <= 0.0 or near.of(self._paths.at(self._mesh, self._ends[0], self._ends[0], 0.0)) is not None

    def result(self, *, is_of_first: bool = False) -> MeshResult:
        """The contacts in all worlds; or those among which the first of each world are, if these alone are wanted."""
        mesh, options = self._mesh, self._pipeline._options
        if self._is_whole:
            return self._pipeline._contacts(*self._ends, self._paths)
        world_toi, contacts, hidden = np.full(self.num_worlds, np.inf), [], ""
        for worlds, result, of_one in self._results(world_toi if is_of_first else None):
            np.minimum.at(world_toi, worlds, result.world_toi[: len(worlds)])
            contacts.append(of_one)
            hidden = hidden or result.hidden_gaps
        frames = MovingVertices(mesh, *self._ends, WorldPaths.of_worlds(mesh, self._motion._body_paths))
        scale, radius = length_scale_of(mesh, options), mesh.radius
        touch = Touch.of(options, scale, is_euclidean=norm_of(mesh, options).is_ball, radius=radius)
        return result_of(mesh, world_toi, contacts, self.counts(), self.timings, hidden, frames, touch)

    def _results(self, world_toi: Array | None) -> Iterator[tuple[NDArray[np.intp], MeshResult, Contacts]]:
        """Worlds, their results in a mesh of their own, and their contacts in that of one world.

        With the tois of worlds as of :meth:`_in_batches`.
        """
        if self._are_parts:
            worlds = np.zeros(1, dtype=np.intp)
            parts, result = self._on_parts(
                ContactStep, partial(ContactStep.contacts, is_ordered=False, is_placed=False)
            )
            numbers = {"vertex": parts.vertex, "face": parts.face}
            yield worlds, result, in_one_world(result.contacts, parts.mesh, self._mesh, worlds, numbers)
            return

        def of_copies(copies: Pipeline, *step: Any) -> tuple[CollisionMesh, MeshResult]:
            return copies.mesh, copies._contacts(*step, is_ordered=False)

        for worlds, (copies, result) in self._in_batches(of_copies, world_toi):
            yield worlds, result, in_one_world(result.contacts, copies, self._mesh, worlds)

    @property
    def _may_be_cut(self) -> bool:
        """Whether the one world that there is may be searched in a mesh of parts."""
        parts = self._body_parts
        return self.num_worlds == 1 and parts is not None and parts.may_be_cut and self._mesh.num_faces >= _LARGE_ALONE

    @lazy_property
    def _are_parts(self) -> bool:
        """Whether a mesh of parts is searched: where little is near."""
        if not self._may_be_cut:
            return False
        assert self._body_parts is not None and self._near is not None
        num_near = np.diff(self._body_parts.begins)[self._near.parts[0]].sum()
        return 0 < num_near < _FEW * (self._mesh.num_faces + len(self._mesh.codimensional_edges))

    @property
    def _is_whole(self) -> bool:
        """Whether the one world that there is goes slice by slice: of a large mesh, or where it is near in few."""
        if self.num_worlds > 1 or self._are_parts:
            return False
        num_near = self._slices.num_slices if self._near is None else len(self._near.number)
        return 0 < num_near <= _FEW_SLICES or num_near * self._mesh.num_faces > _MANY_FACES

    @lazy_property
    def _paths(self) -> MeshPaths:
        """The paths of the one world that there is, with the slices in which anything is near, and what."""
        searched = None if self._near is None else self._near.slices(self._slices)
        return MeshPaths.of_checked(self._mesh, self._motion._body_paths, searched=searched)

    @lazy_property
    def _near(self) -> Near | None:
        """What may touch in each slice of each world; None where this is not looked for."""
        start = in_space(self._ends[0])
        ends = start, start if self._ends[0] is self._ends[1] else in_space(self._ends[1])
        options = self._pipeline._options
        of_step = ends, self._motion._body_paths, self._slices, touching_distance(self._mesh, options), options.threads
        return find_near(self._pipeline._topology, self._body_parts, *of_step, wants_parts=self._may_be_cut)

    @lazy_property
    def _body_parts(self) -> BodyParts | None:
        """The parts of the bodies of a world; None where they are not looked for."""
        return body_parts(self._pipeline._topology, self._ends, self.num_worlds)

    def _on_parts(self, kind: type[_StepT], work: Callable[[_StepT], _T]) -> tuple[PartMesh, _T]:
        """Some work on a step of a kind of a mesh of the parts that are near, and this mesh."""
        pipeline, near = self._pipeline, self._near
        assert self._body_parts is not None and near is not None
        options = replace(pipeline._options, length_scale=length_scale_of(self._mesh, pipeline._options))
        pipeline._check_no_capture()
        parts = PartMesh.of(self._body_parts, np.flatnonzero(near.parts[0]))
        paths = self._motion._body_paths.rows(np.flatnonzero(parts.is_used))
        bodies = np.zeros((len(near.number), parts.mesh.num_bodies), dtype=bool)
        bodies[:, : len(parts.body)] = near.bodies[:, 0, parts.body]
        searched = [
            each._replace(active=active) for each, active in zip(near.slices(self._slices), bodies, strict=True)
        ]
        workspace = Workspace(parts.mesh, pipeline._topology.device, warns_with=pipeline._workspace)
        workspace.topology.vertex_rank = parts.rank
        workspace.progress.show = pipeline._show_progress
        ends, paths_of_parts = (parts.mesh.vertices,) * 2, MeshPaths.of_checked(parts.mesh, paths, searched=searched)
        with kind(workspace, ends, options, paths_of_parts) as step:
            result = work(step)
        self._add(step.counts, step.timings)
        return parts, result


def _by_turns(world: NDArray[np.int64]) -> tuple[NDArray[np.intp], int]:
    """The order of rows in which each world has its first before any has its second, and the number of worlds."""
    order = np.argsort(world, kind="stable")
    of_order = world[order]
    first = np.flatnonzero(np.append(True, of_order[1:] != of_order[:-1]))
    sizes = np.diff(np.append(first, len(order)))
    turn = np.arange(len(order)) - np.repeat(first, sizes)
    return order[np.argsort(turn, kind="stable")], len(first)
