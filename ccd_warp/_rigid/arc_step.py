"""A step on the device in which bodies turn, or a line search: all slices one after another, in one recording."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from ccd_warp._engine.boxes.trees import search_options
from ccd_warp._engine.device.input import Form, PreparedLaunch
from ccd_warp._engine.device.line_search import DeviceLineSearch
from ccd_warp._engine.device.step import Capacities
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.motion import Slices
from ccd_warp._engine.stages import Stages
from ccd_warp._results.contact_place import located
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.device_results import LaunchResult
from ccd_warp._rigid.arcs import Arcs, Times
from ccd_warp._rigid.mesh_paths import MeshPaths, slices_of
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.parts.near_search import touching_distance
from ccd_warp._rigid.parts.whole_bodies import WholeBodies
from ccd_warp._runtime.launch import Recording
from ccd_warp._scene.input.interop import DeviceArray
from ccd_warp.kernels.rigid import shorten_paths as kernels

if TYPE_CHECKING:
    from ccd_warp.kernels.boxes.box_tree import Quantization

_ALL_FLAGS = -1


class DeviceArcStep(DeviceLineSearch):
    """A step on the device whose bodies go on paths; those of static bodies may be others in each launch.

    Attributes:
        fraction: How far each rigid body has gone on its path after a line search, float64, shape [B]; 1 of the others.
    """

    on_arcs = True
    _motion: RigidMotion | None = None  # of the last launch

    def _arrays(self, capacities: Capacities, quantization: "Quantization") -> dict[str, Any]:
        """The arrays and values of the stages."""
        topology, options = self.topology, self._options
        self._arcs = arcs = Arcs(topology, self._radius, self._input.box_radius)
        self._length_scale = length_scale_of(self._mesh, options)
        arrays = super()._arrays(capacities, quantization)
        separation = options.separation(self._length_scale)
        radii = arcs.radius, arcs.box_radius
        searched = search_options(1.0, arrays["inflation"], separation, self.norm, self._flag, radii)
        mesh, device = self._mesh, topology.device
        self._of_slices: dict[int, tuple[list[Times], Any]] = {}  # for each recording, by the number of its slices
        self._bodies: WholeBodies | None = None
        self._least: wp.array = self._empty(mesh.num_bodies, wp.int64)
        self._whole = self._arcs.new_paths("omega", "velocity", "turning")
        self._rows_kept: wp.array = wp.array((mesh.kinematic | mesh.rigid).astype(np.int32), device=device)
        # the contacts of all slices stay in the list, of which each slice resets the count of something else
        self._no_count: wp.array = self._full(1, 0, wp.int32)
        arc_values = {"box_radius": radii[1], "plane_radius": self._input.box_radius, "is_thick": True}
        return arrays | arc_values | {"t_end": 1.0, "search_options": searched}

    def _new_result(self, max_contacts: int) -> LaunchResult:
        """The arrays of the result."""
        self.fraction = self._full(self._mesh.num_bodies, 1.0, wp.float64)
        return replace(super()._new_result(max_contacts), body_fraction=self.fraction)

    def prepare_on_paths(
        self, vertices_t0: DeviceArray, vertices_t1: DeviceArray, paths: MeshPaths, **options: Any
    ) -> PreparedLaunch:
        """Check the arguments of a launch along paths."""
        if self.topology.device.is_capturing:
            raise RuntimeError("a graph is being captured; a launch with a motion reads it on the host, and cannot be")
        num_slices = slices_of(paths, self._options.t_max).num_slices
        return self.prepare(vertices_t0, vertices_t1, num_slices=num_slices, **options)

    def launch_on_paths(self, prepared: PreparedLaunch, motion: RigidMotion, paths: MeshPaths) -> None:
        """Launch a step along the paths of a motion."""
        self._arcs.begin(paths)
        self.fraction.fill_(1.0)
        self._motion, self._paths = motion, paths
        self.launch(prepared)

    def ended_motion(self) -> RigidMotion | None:
        """The motion of the last launch, up to the fractions that a line search has left; this waits for the device."""
        if self._motion is None:
            return None
        of_rigid = self.fraction.numpy()[self._mesh.rigid]
        return self._motion.shortened(of_rigid.reshape(self._motion.turns.shape))

    def _record_form(self, recording: Recording, form: Form) -> None:
        """Record the launches of a step, or of all passes of a line search, for which whole paths are kept."""
        if form.line_search is not None:
            outputs = [self._whole, self._least]
            recording.launch(kernels.begin_paths, len(self._least), inputs=[self._arcs.paths], outputs=outputs)
        super()._record_form(recording, form)
        if form.line_search is None:
            self._record_most_found(recording)

    def _record_pass(
        self,
        recording: Recording,
        form: Form,
        active: wp.array,
        *,
        is_first: bool = True,
        adapt: Callable[[Stages], Stages] = lambda stages: stages,
        gaps_moved: float = 0.0,
        **solved: Any,
    ) -> Stages:
        """Record all launches of a step, or of a pass, slice by slice; returns the stages of the first slice."""
        slots = self._input.slots(form)
        slices, (times, near) = Slices(form.num_slices, self._options.t_max).all(), self._slices_of(form)
        of_slices = [self._stages_of(of_slice) for of_slice in times]
        first = of_slices[0]
        self._input.record(recording, form, first.between(*slots), is_first)
        if is_first:
            first.reset_vertices(recording)
        self._arcs.place(times[0], recording, *slots)
        if is_first and self.static_trees:
            first.fill_vertex_aabbs(recording, self.topology.static_vertices, self._active)
            first.fill_boxes(recording, self.static_trees)
        if near is not None:
            self._record_near(recording, near, slots if is_first else None, active)
        for number, (time_slice, of_slice, stages) in enumerate(zip(slices, times, of_slices, strict=True)):
            of_bodies = active if near is None else near.bodies[number]
            with nullcontext() if near is None else recording.only_if(near.is_any[number : number + 1]):
                if number > 0:
                    counts = self._no_count, self._flag.array
                    self._stages.reset(recording, *counts, _ALL_FLAGS, keeps_toi=True)
                    self._arcs.place(of_slice, recording, *slots)
                self._record_search(recording, stages, of_bodies)
                # the motion of a pair is that in the slice
                gaps = gaps_moved * float(time_slice.t_end - time_slice.t_begin)
                self.record_narrow_phase(recording, adapt(stages), of_bodies, gaps_moved=gaps, **solved)
        return first

    def _record_near(self, recording: Recording, near: Any, rows: Any, active: wp.array) -> None:
        """Record the launches that mark what is near in each slice; ``rows`` of both ends where they are others."""
        assert self._bodies is not None
        if rows is not None:
            self._bodies.record_bounds(recording, *rows)
        reach = touching_distance(self._mesh, self._options)
        self._bodies.record_near(
            recording, self._arcs.paths, self._options.t_max, reach, active, self._flag.array, near
        )

    def _record_start(self, recording: Recording, form: Form) -> None:
        """Record what places all vertices at the start again, where a pass has moved them."""
        self._arcs.place(self._slices_of(form)[0][0], recording, *self._input.slots(form))

    def _record_shorten(self, recording: Recording, form: Form, per: int, share: wp.array) -> None:
        """Record the launches that shorten the motion of what touches."""
        super()._record_shorten(recording, form, per, share)
        moving, minima = self.topology.moving_vertices, self._stages.step.minima
        recording.launch(kernels.lower_bodies, len(moving), inputs=[moving, per, minima], outputs=[self._least])
        outputs = [self._least, self.fraction, self._arcs.paths]
        recording.launch(kernels.shorten_paths, len(self._least), inputs=[share, self._whole], outputs=outputs)

    @property
    def _body_kept(self) -> wp.array:
        """Bodies whose rows a line search does not write, int32, shape [B]: they stand in the bodies' own frames."""
        return self._rows_kept

    def _slices_of(self, form: Form) -> tuple[list[Times], Any]:
        """The begins and ends of slices for each body, and what is near in each, None where that is not looked for.

        Recorded launches read them; those of recordings that stay are kept.
        """
        count = form.num_slices
        if count not in self._of_slices:
            kept = {other.num_slices for other in self._recordings}
            self._of_slices = {number: arrays for number, arrays in self._of_slices.items() if number in kept}
            times = [self._arcs.new_times(part) for part in Slices(count, self._options.t_max).all()]
            near = None
            if WholeBodies.are_few(self._mesh):
                self._bodies = self._bodies or WholeBodies(self.topology, self._both_radii[0])
                near = WholeBodies.new_marks(self._mesh.num_bodies, count, self.topology.device)
            self._of_slices[count] = times, near
        return self._of_slices[count]

    def _stages_of(self, times: Times) -> Stages:
        """The stages of a slice."""
        turns = self._arcs.turns_at(times)
        radius = self.topology.radius if self._radius is None else self._radius
        packed = self._options.for_kernel(self._length_scale, stop=self._flag.array, radius=radius, turns=turns)
        return replace(self._stages.between(self._arcs.start, self._arcs.end), options=packed, turns=turns)

    def locate(self, contacts: Contacts, vertices_t0: ArrayLike | None, vertices_t1: ArrayLike | None) -> Contacts:
        """Contacts of the last launch that know their mesh, each pair once, and their points on the paths."""
        last = self.last_positions()
        if last is None:
            return located(contacts, self._mesh)
        start, end = (v.numpy().reshape(-1, 3) for v in last)
        if vertices_t0 is not None:
            start, end = self._mesh.frames(vertices_t0, vertices_t1)  # type: ignore[arg-type]  # both or neither
        paths = self._paths.shortened(self.fraction.numpy())
        touch, radii = self._touch_of_last(), self._radii_of_last()
        return located(_earliest(contacts), self._mesh, start, end, paths, touch, radii)

    def contact_points(self) -> wp.array:
        """Points of the contacts on the device.

        Raises:
            ValueError: Always; they are known on the host.
        """
        raise ValueError("contacts.points of a launch with a motion are not known on the device; expected to_host()")


def _earliest(contacts: Contacts) -> Contacts:
    """Of each pair its earliest contact, in the same order; a pair may be listed in several slices."""
    keys = np.column_stack([contacts.kind, contacts.primitives])
    order = np.lexsort((contacts.toi, *keys.T[::-1]))
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    return contacts[np.sort(order[is_new])]
