"""The line search on the device: its passes, whose number is fixed, and the launches of each."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ccd_warp._engine.device.input import SAFETY, Form, LineSearch
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp._runtime.status import LaunchFlag
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.step import device_step
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp._engine.device.start_distances import DeviceStartDistances

# Flags that a pass of a line search keeps from earlier passes: later passes do not make up for what one missed, and
# what has been stopped and is struck stays so.
_KEPT_FLAGS = int(LaunchFlag.PAIRS_OVERFLOW | LaunchFlag.INVALID_INPUT | LaunchFlag.STATIC_MOVED | LaunchFlag.STRUCK)
_PER = {
    "scene": int(device_step.PER_SCENE),
    "world": int(device_step.PER_WORLD),
    "body": int(device_step.PER_BODY),
    "vertex": int(device_step.PER_VERTEX),
}
# Rounds of a line search that shorten by toi; in later rounds vertices in contact stay where they are.
_ROUNDS_BY_TOI = 2
# The last rounds, in which all vertices of a world move by one fraction, or not at all.
_ROUNDS_BY_WORLD = 2
# Fraction of its gap by which a pair may move where the first of these rounds finds toi 0, because the gap may only be
# lost in the rounding of a long motion; vertices with toi 0 in the second round stay where they are. Of a half, a
# quarter and an eighth, only an eighth let all the draped cloths in float32 move.
_GAPS_MOVED = 0.125


def passes_of(line_search: LineSearch) -> list[tuple[str, Any]]:
    """For each pass, whose toi then limits the motion of a vertex, and the fraction of that toi it may move."""
    if line_search.per in ("scene", "world"):
        return [(line_search.per, SAFETY)] * _ROUNDS_BY_TOI + [("world", 0.0)]
    # Stopped vertices may stop others in turn; one fraction for the world settles the contacts that remain.
    num_own = line_search.num_rounds - _ROUNDS_BY_WORLD
    by_toi = min(_ROUNDS_BY_TOI, num_own)
    shares = [SAFETY] * by_toi + [0.0] * (num_own - by_toi)
    return [*((line_search.per, share) for share in shares), ("world", SAFETY), ("world", 0.0)]


class DeviceLineSearch(DeviceStep):
    """A step on the device, and line searches, whose passes are such steps.

    Attributes:
        on_pass: Called in a taped line search after each check, before anything is shortened.
    """

    def __init__(self, *arguments: Any) -> None:
        """Allocate everything but what line searches alone need; the arguments are those of a step."""
        super().__init__(*arguments)
        self.on_pass: Callable[[], None] | None = None
        self._touched: wp.array | None = None
        self._start_distances: DeviceStartDistances | None = None

    @property
    def start_distances(self) -> wp.array | None:
        """The start distance of each vertex in the last line search; None where pairs keep no distance."""
        return None if self._start_distances is None else self._start_distances.of_vertex

    def _begin(self) -> None:
        """Allocate what line searches need."""
        mesh, options, device = self._mesh, self._options, self.topology.device
        self._is_any_touched: wp.array = wp.empty(1, dtype=wp.int32, device=device)
        has_distance = options.separation(length_scale_of(mesh, options)) > 0.0 or self._radius is not None
        if options.keeps_start_distances and has_distance:
            from ccd_warp._engine.device.start_distances import DeviceStartDistances  # few programs need it

            arguments = self.topology, options, self._stages, self.result.contacts, self._flag, self._radius
            self._start_distances = DeviceStartDistances(*arguments, on_arcs=self.on_arcs)
        # which bodies a pass searches; the last, as without it all of this is made again
        self._touched = wp.empty(mesh.num_bodies, dtype=wp.int32, device=device)

    def _parting(self, stages: Stages) -> Stages:
        """These stages, in which what starts within its distance may part and slide, if the options let it."""
        if self._options.keeps_start_distances and stages.plane_query is not None:
            stages = replace(stages, plane_query=self.plane_query(lets_part=True))
        return stages if self._start_distances is None else self._start_distances.stages(stages)

    def _record_form(self, recording: Recording, form: Form) -> None:
        """Record the launches of a step, or of all passes of a line search."""
        if form.line_search is None:
            super()._record_form(recording, form)
            return
        if self._touched is None:
            self._begin()
        mesh = self._mesh
        self._by_scene = int(form.line_search.per == "scene" or not _worlds_are_apart(mesh))
        recording.launch(
            device_step.set_active, mesh.num_bodies, inputs=[1], outputs=[self._touched, self._is_any_touched]
        )
        passes = passes_of(form.line_search)
        has_kinematic = bool(mesh.kinematic.any())
        # the contacts of every pass of a line search on a tape have gradients
        kept_flags = _KEPT_FLAGS | (int(LaunchFlag.CONTACTS_OVERFLOW) if form.is_taped else 0)
        for number, (per, share) in enumerate(passes):
            # only if the next pass has the same `per`: a failure then stops the same bodies or vertices alone
            may_cut = number == 0 and passes[1][0] == per
            gaps_moved = _GAPS_MOVED if may_cut else 0.0
            is_searched_again = number < len(passes) - 1 or has_kinematic
            if number == 0:
                self._record_reset(recording)
                self._record_first_pass(recording, form, gaps_moved)
            # where nothing was touched in the pass before, a reset and another one would find what it has found
            with recording.only_if(self._is_any_touched) if number > 0 else nullcontext():
                if number > 0:
                    self._record_next_reset(recording, kept_flags)
                    self._record_checked(recording, form, is_first=False)
                if not form.is_taped:
                    self._record_shortened(recording, form, per, share, is_searched_again=is_searched_again)
            if form.is_taped:
                recording.call(self._pass_done)
                with recording.only_if(self._is_any_touched):
                    self._record_shortened(recording, form, per, share, is_searched_again=is_searched_again)
        if has_kinematic:  # which may strike what the last pass has stopped
            with recording.only_if(self._is_any_touched):
                self._record_reset(recording, kept_flags, keeps_toi=True)
                self._record_checked(recording, form, is_first=False)
        self._record_most_found(recording)

    def _pass_done(self) -> None:
        """Tell who keeps the passes that one has been checked, and nothing shortened yet."""
        assert self.on_pass is not None
        self.on_pass()

    def _record_shortened(
        self, recording: Recording, form: Form, per: str, share: wp.array, *, is_searched_again: bool
    ) -> None:
        """Record which bodies a next pass searches, where there is one, and what shortens the motion."""
        if is_searched_again:
            self._record_touched(recording)
        self._record_shorten(recording, form, _PER[per], share)

    def _record_shorten(self, recording: Recording, form: Form, per: int, share: wp.array) -> None:
        """Record the launch that shortens the motion of what touches."""
        moving = self.topology.moving_vertices
        by_vertex = int(form.t0_by_vertex), int(form.t1_by_vertex)
        recording.launch(
            specialised("step.input_rows", real=form.real, dimension=self._mesh.dimension).shorten,
            len(moving),
            inputs=[moving, Slot("vertices_t0"), *by_vertex, per, share, self._body_kept, self._stages.step.minima],
            outputs=[Slot("vertices_t1")],
        )

    @property
    def _body_kept(self) -> wp.array:
        """Bodies whose rows a line search does not write, int32, shape [B]; empty where there are none."""
        return self.topology.body_kinematic

    def _record_first_pass(self, recording: Recording, form: Form, gaps_moved: float) -> None:
        """Record the first pass, and another one for what starts within its distance."""
        near = self._start_distances
        if near is None:
            self._record_checked(recording, form, gaps_moved=gaps_moved)
            return
        near.record_begin(recording)
        stages = self._record_checked(recording, form)
        self._record_start(recording, form)
        near.record_near(recording, stages)
        with recording.only_if(near.is_near):
            self._record_touched(recording)
            self._record_next_reset(recording)
            near.record_distances(recording, stages, partial(self._record_search, recording))
            self._record_next_reset(recording)
            # CUDA outside a graph makes this pass where nothing is near, too, so it asks as the first one did
            self._record_checked(recording, form, is_first=False)

    def _record_checked(self, recording: Recording, form: Form, **options: Any) -> Stages:
        """Record a pass over the bodies that the one before has touched; returns its stages."""
        assert self._touched is not None
        return self._record_pass(recording, form, self._touched, adapt=self._parting, only_moving=True, **options)

    def _record_start(self, recording: Recording, form: Form) -> None:
        """Record what places all vertices at the start again, where a pass has moved them."""

    def _record_next_reset(self, recording: Recording, kept_flags: int = _KEPT_FLAGS) -> None:
        """Record the reset before a pass that is not the first."""
        self._record_reset(recording, kept_flags)
        self._stages.reset_vertices(recording)

    def _record_touched(self, recording: Recording) -> None:
        """Record which bodies are searched again: a world found free stays so until something in it is shortened."""
        moving, touched = self.topology.moving_vertices, [self._touched, self._is_any_touched]
        recording.launch(device_step.set_active, self._mesh.num_bodies, inputs=[0], outputs=touched)
        inputs = [moving, self._by_scene, self._stages.step.minima]
        recording.launch(device_step.keep_touched, len(moving), inputs=inputs, outputs=touched)


def _worlds_are_apart(mesh: CollisionMesh) -> bool:
    """Whether no body has vertices in more than one world."""
    within = np.diff(mesh.vertex_body) == 0
    return not (within & (np.diff(mesh.vertex_world) != 0)).any()
