"""A line search on a tape: its passes are kept, and one function is recorded that goes through them backwards."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from ccd_warp._engine.device.input import SAFETY, PreparedLaunch
from ccd_warp._engine.device.line_search import DeviceLineSearch, passes_of
from ccd_warp._gradients.attaining import Attaining, all_attaining, as_flags, ratings_of
from ccd_warp._gradients.caller_arrays import CallerArrays
from ccd_warp._gradients.kept_check import KeptCheck
from ccd_warp._gradients.tape_memory import TapeMemory
from ccd_warp._results.device_results import TOIS, LaunchResult
from ccd_warp._runtime.tape import active_tape
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.gradients import ordered_sums, regularity
from ccd_warp.kernels.template import specialised

_CHUNK = 256  # vertices whose contributions one item adds


class TapedLineSearch:
    """A line search whose shortened positions get gradients by the positions at both ends and by radii.

    The shortened positions stand where the wished ones stood, and so do their gradients: the backward pass turns the
    one into the other, in the same array.

    Attributes:
        on_backward: Called at the begin of the backward pass, where there is something to say; else None.
    """

    on_backward: Callable[[], None] | None = None

    def __init__(
        self, step: DeviceLineSearch, prepared: PreparedLaunch, positions: tuple[Any, Any], radius: wp.array | None
    ) -> None:
        """Of the arguments of a launch, with the positions as the caller has given them.

        Raises:
            ValueError: If the end positions, to which the shortened ones are written, do not require a gradient, or the
                distance of a pair follows from its start.
            RuntimeError: If a graph is being captured, and there was no such line search before.
        """
        rows = len(prepared.vertices_t0), len(prepared.vertices_t1)
        self._step, self._form, self._radius = step, prepared.form, radius
        self._caller_arrays = CallerArrays.of(positions, radius, prepared.form, rows)
        if self._caller_arrays.vertices_t1 is None:
            raise ValueError(
                "vertices_t1 does not require a gradient; expected an array of Warp that does, as the shortened "
                "positions are written to it, or no tape"
            )
        assert prepared.form.line_search is not None
        self._passes: list[tuple[str, float]] = [
            (per, prepared.safety if share is SAFETY else share) for per, share in passes_of(prepared.form.line_search)
        ]
        self._memory = memory = TapeMemory.of(step)
        step.contact_arrays.moving_row("gradients")  # made now, not in a capture
        self._checks: list[KeptCheck] = []
        self._start_distances: wp.array | None = None
        for per in dict(self._passes):
            if per not in memory.groups:
                if step.topology.device.is_capturing:  # memory of a capture is gone with its graph
                    raise RuntimeError(
                        f"a graph is being captured; call launch_line_search(per={per!r}) on a tape once before"
                    )
                memory.groups[per] = _Groups.of(step, per)

    def launch(self, prepared: PreparedLaunch) -> LaunchResult:
        """Launch, keep all passes, and record the backward pass on the active tape."""
        step = self._step

        def keep() -> None:
            self._checks.append(KeptCheck(step, step.positions_of(prepared), self._radius))

        step.on_pass = keep
        try:
            step.launch(prepared)
        finally:
            step.on_pass = None
        if step.start_distances is not None and any(check.may_touch for check in self._checks):
            self._start_distances = wp.clone(step.start_distances)
        active_tape().record_func(self._backward, self._caller_arrays.arrays)
        return replace(step.result, _taped=self)

    def is_regular(self, per: str) -> wp.array:
        """Whether the position of each vertex has a derivative, bool, shape [V].

        Raises:
            ValueError: If anything but vertices is asked for.
        """
        if per != "vertex":
            raise ValueError(f"per is {per!r}; expected 'vertex', as a line search has positions")
        ratings, of_passes = self._rated()
        for attaining in of_passes:
            if attaining is not None:
                attaining.release()
        return as_flags(self._step, ratings)

    def _backward(self) -> None:
        """Turn the gradient of the shortened positions into that of the wished ones, and add the others."""
        if self.on_backward is not None:
            self.on_backward()
        topology = self._step.topology
        gradients = self._caller_arrays.gradients(topology)
        vertex_rating, of_passes = self._rated()
        kernels = specialised("gradients.shorten_adjoint", real=self._form.real, dimension=topology.mesh.dimension)
        moving = topology.moving_vertices
        inputs = [moving, vertex_rating, int(self._form.t1_by_vertex)]
        self._memory.launch(kernels.clear_unknown, len(moving), inputs, [gradients[1]])
        for check, attaining, (per, share) in zip(self._checks[::-1], of_passes[::-1], self._passes[::-1], strict=True):
            if not check.may_touch:
                continue
            of_toi = self._shorten_back(check, per, share, gradients)
            if attaining is None:
                continue
            if share > 0.0:
                attaining.change_gradients({per: of_toi})
                attaining.add_rows(self._caller_arrays, gradients)
            attaining.release()

    def _rated(self) -> tuple[wp.array, list[Attaining | None]]:
        """The rating of each vertex (`regularity`), and of each pass the contacts that attain its tois."""
        topology, launch = self._step.topology, self._memory.launch
        rating = wp.full(
            topology.mesh.num_vertices, value=int(regularity.REGULAR), dtype=wp.int32, device=topology.device
        )
        of_passes: list[Attaining | None] = []
        for check, (per, share) in zip(self._checks, self._passes, strict=True):
            attaining = all_attaining(check, per) if check.may_touch else None
            of_passes.append(attaining)
            if check.may_touch:
                inputs = [
                    topology.moving_vertices,
                    self._memory.groups[per].group,
                    check.copies.arrays[TOIS[per]],
                    share,
                ]
                inputs.append(ratings_of(check, per, attaining, self._start_distances, rating))
                launch(regularity.rate_vertices, len(topology.moving_vertices), inputs, [rating])
        return rating, of_passes

    def _shorten_back(
        self, check: KeptCheck, per: str, share: float, gradients: tuple[wp.array | None, wp.array | None]
    ) -> wp.array:
        """Turn the gradient of the end of a pass into that of its begin; returns that by the toi of each group."""
        topology, form, groups = self._step.topology, self._form, self._memory.groups[per]
        launch, moving = self._memory.launch, topology.moving_vertices
        kernels = specialised("gradients.shorten_adjoint", real=form.real, dimension=topology.mesh.dimension)
        of_fraction, of_chunk, of_toi = (
            wp.empty(n, dtype=wp.float64, device=topology.device)
            for n in (len(moving), groups.num_chunks, groups.num_groups)
        )
        copies = check.copies.arrays
        inputs = [moving, groups.group, copies[TOIS[per]], share, copies["start"], copies["end"]]
        inputs += [int(form.t0_by_vertex), int(form.t1_by_vertex)]
        launch(kernels.shorten_back, len(moving), inputs, [*gradients, of_fraction])
        inputs = [of_fraction, groups.order, groups.chunk_begin]
        launch(ordered_sums.sum_chunks, groups.num_chunks, inputs, [of_chunk])
        launch(ordered_sums.sum_groups, groups.num_groups, [of_chunk, groups.group_begin, share], [of_toi])
        return of_toi


class _Groups(NamedTuple):
    """Moving vertices by the part of the mesh with which each moves by one fraction, in chunks.

    Attributes:
        group: The group of each, -1 for those whose motion is not shortened.
        order: Places of the others among the moving ones, ordered by group.
        chunk_begin: Where in that order each chunk begins, which lies in one group, and where the last ends.
        group_begin: The first chunk of each group, and the end of the last.
    """

    group: wp.array
    order: wp.array
    chunk_begin: wp.array
    group_begin: wp.array

    @property
    def num_chunks(self) -> int:
        return len(self.chunk_begin) - 1

    @property
    def num_groups(self) -> int:
        return len(self.group_begin) - 1

    @classmethod
    def of(cls, step: DeviceLineSearch, per: str) -> "_Groups":
        """Those of a kind of line search."""
        mesh = step.topology.mesh
        group, num_groups = _groups_of(mesh, per)
        of_moving = np.where(mesh.kinematic[mesh.vertex_body], -1, group)[mesh.moving_vertices]
        order = np.argsort(of_moving, kind="stable")[np.count_nonzero(of_moving < 0) :]
        sizes = np.bincount(of_moving[order], minlength=num_groups)
        group_begin = np.concatenate([[0], np.cumsum(-(-sizes // _CHUNK))])
        first = np.cumsum(sizes) - sizes
        within = np.arange(group_begin[-1]) - np.repeat(group_begin[:-1], np.diff(group_begin))
        chunk_begin = np.append(np.repeat(first, np.diff(group_begin)) + _CHUNK * within, len(order))
        arrays = (x.astype(np.int32) for x in (of_moving, order, chunk_begin, group_begin))
        return cls(*(wp.array(x, dtype=wp.int32, device=step.topology.device) for x in arrays))


def _groups_of(mesh: CollisionMesh, per: str) -> tuple[Any, int]:
    """The group of each vertex, and how many there are."""
    if per == "world":
        return mesh.vertex_world, mesh.num_worlds
    if per == "body":
        return mesh.vertex_body, mesh.num_bodies
    if per == "vertex":
        return np.arange(mesh.num_vertices), mesh.num_vertices
    return np.zeros(mesh.num_vertices, dtype=np.int32), 1
