"""A step on the device in which bodies turn: all its slices one after another, in one recording."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ccd_warp._contact_place import located
from ccd_warp._contacts import Contacts
from ccd_warp._engine.boxes.trees import search_options
from ccd_warp._engine.device.input import Form, PreparedLaunch
from ccd_warp._engine.device.step import Capacities, DeviceStep
from ccd_warp._engine.host.arcs import Arcs, Slice, slices_of
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Recording

if TYPE_CHECKING:
    from ccd_warp._mesh_paths import MeshPaths

_ALL_FLAGS = -1


class DeviceArcStep(DeviceStep):
    """A step on the device whose bodies go on paths; those of static bodies may be others in each launch."""

    on_arcs = True

    def _arrays(self, capacities: Capacities, quantization: Any) -> dict[str, Any]:
        """The arrays and values of the stages."""
        topology, options = self.topology, self._options
        self._arcs = arcs = Arcs(topology, self._radius, self._input.box_radius)
        self._length_scale = length_scale_of(self._mesh, options)
        arrays = super()._arrays(capacities, quantization)
        separation = options.separation(self._length_scale)
        radii = arcs.radius, arcs.box_radius
        searched = search_options(1.0, arrays["inflation"], separation, self.norm, self._flag, radii)
        # the contacts of all slices stay in the list, of which each slice resets the count of something else
        self._no_count: wp.array = self._full(1, 0, wp.int32)
        own = {"box_radius": radii[1], "plane_radius": self._input.box_radius, "is_thick": True}
        return arrays | own | {"t_end": 1.0, "search_options": searched}

    def prepare_on_paths(
        self, vertices_t0: Any, vertices_t1: Any, paths: "MeshPaths", **options: Any
    ) -> PreparedLaunch:
        """Check the arguments of a launch along paths."""
        if self.topology.device.is_capturing:
            raise RuntimeError("a graph is being captured; a launch with a motion reads it on the host, and cannot be")
        num_slices = len(slices_of(paths, self._options.t_max))
        return self.prepare(vertices_t0, vertices_t1, num_slices=num_slices, **options)

    def launch_on_paths(self, prepared: PreparedLaunch, paths: "MeshPaths") -> None:
        """Launch a step along paths."""
        self._arcs.begin(paths)
        self._paths = paths
        self.launch(prepared)

    def _record_form(self, recording: Recording, form: Form) -> None:
        """Record all launches of a step, slice by slice."""
        for part in Slice.all(form.num_slices, self._options.t_max):
            is_first = part.t_begin == 0.0
            if is_first:
                self._record_reset(recording)
            else:
                counts = self._no_count, self._flag.array
                self._stages.reset(recording, *counts, _ALL_FLAGS, keeps_toi=True)
            stages = self._stages_of(part)
            given = self._input.slots(form)
            if is_first:
                self._input.record(recording, form, stages.between(*given), True)
                stages.reset_vertices(recording)
            self._arcs.place(part, recording, *given)
            if is_first and self.static_trees:
                stages.fill_vertex_aabbs(recording, self.topology.static_vertices, self._active)
                stages.fill_boxes(recording, self.static_trees)
            self._record_search(recording, stages, self._active)
            self._record_narrow_phase(recording, stages, self._active)

    def _stages_of(self, part: Slice) -> Stages:
        """The stages of a slice."""
        turns = self._arcs.turns(part)
        radius = self.topology.radius if self._radius is None else self._radius
        packed = self._options.for_kernel(self._length_scale, stop=self._flag.array, radius=radius, turns=turns)
        return replace(self._stages.between(self._arcs.start, self._arcs.end), options=packed, turns=turns)

    def locate(self, contacts: Contacts, vertices_t0: Any, vertices_t1: Any) -> Contacts:
        """Contacts of the last launch that know their mesh, each pair once, and their points on the paths."""
        last = self._last_positions()
        if last is None:
            return located(contacts, self._mesh)
        start, end = (v.numpy().reshape(-1, 3) for v in last)
        if vertices_t0 is not None:
            start, end = self._mesh.frames(vertices_t0, vertices_t1)
        return located(_earliest(contacts), self._mesh, start, end, self._paths)

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
