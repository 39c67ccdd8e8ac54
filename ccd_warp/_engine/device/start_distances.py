"""What starts within its distance in a line search on the device: how near it is, and the stages that let it part."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import warp as wp

from ccd_warp._engine.boxes.trees import search_options
from ccd_warp._engine.mesh.lengths import next_above
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of, packed_reach
from ccd_warp._engine.mesh.start_distances import corners_by_kind, largest_start_distance
from ccd_warp._engine.stages import Stages
from ccd_warp._results.device_pairs import DeviceContacts
from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import Recording
from ccd_warp._runtime.threads import StopFlag
from ccd_warp.kernels.at_one_time import device_start_distances as kernels
from ccd_warp.kernels.narrow_phase.sinks import START_DISTANCE
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp._engine.mesh.topology import Topology
    from ccd_warp._scene.input.options import Options


class DeviceStartDistances:
    """How near vertices are to anything at the start of a line search, and the launches that find it.

    The first pass is strict. Where it finds a contact in a world that may start within its distance, the distances at
    the start are searched for there, and the pass is made again. All passes are solved in float64, each pair with a
    separation of its own: in float32 the margin of a pair would be lost anew in each search.

    Attributes:
        of_vertex: Share and length that each vertex keeps, infinite where it keeps none, float64, shape [2 V].
        is_near: Whether the first pass has found such a contact, int32, shape [1].
    """

    def __init__(
        self,
        topology: "Topology",
        options: "Options",
        stages: Stages,
        contacts: DeviceContacts,
        flag: StopFlag,
        radius: wp.array | None,
        *,
        on_arcs: bool = False,
    ) -> None:
        """Allocate what a line search needs; stages, contacts, flag and radii are those of its step."""
        mesh, device = topology.mesh, topology.device
        self._topology, self._contacts = topology, contacts
        self.of_vertex: wp.array = wp.empty(2 * mesh.num_vertices, dtype=wp.float64, device=device)
        self._near: wp.array = wp.empty(mesh.num_bodies, dtype=wp.int32, device=device)
        self._world_near: wp.array = wp.empty(mesh.num_worlds, dtype=wp.int32, device=device)
        self.is_near: wp.array = wp.empty(1, dtype=wp.int32, device=device)
        length_scale = length_scale_of(mesh, options)
        separation = options.separation(length_scale)
        distance = largest_start_distance(mesh, options, mesh._largest_radius)
        norm = norm_of(mesh, options, on_arcs=on_arcs)
        self._norm = norm.shape
        radii = topology.radius if radius is None else radius
        exact = replace(options, precision="float64")
        self._narrow_phase = narrow_phase_on(device, exact.real, norm)
        arrays: dict[str, Any] = {"stop": flag.array, "radius": radii, "start_distances": self.of_vertex}
        self._options = partial(exact.for_kernel, length_scale, **arrays)
        # boxes of static bodies stay as they are, and those of the others make up for it
        inflation = next_above(stages.inflation + (distance - separation))
        self._of_start: dict[str, Any] = {
            "inflation": inflation,
            "search_options": search_options(1.0, inflation, distance, norm, flag, (radii, stages.box_radius)),
            "reach": packed_reach(radii, distance, flag.array, separation),
            "start_distances": self.of_vertex.view(wp.int64),
        }
        self._no_end: wp.array | None = wp.empty(0, dtype=wp.vec3d, device=device) if on_arcs else None

    def stages(self, stages: Stages) -> Stages:
        """These stages, with pairs that keep their start distances."""
        return replace(stages, narrow_phase=self._narrow_phase, options=self._options(turns=stages.turns))

    def record_begin(self, recording: Recording) -> None:
        """Record that nothing keeps a start distance."""
        recording.launch(kernels.clear_start_distances, len(self.of_vertex), inputs=[], outputs=[self.of_vertex])
        near = [self._near, self._world_near, self.is_near]
        recording.launch(kernels.clear_near, max(map(len, near)), inputs=[], outputs=near)

    def record_near(self, recording: Recording, stages: Stages) -> None:
        """Record the launches that look for worlds in which the first pass has found a contact that may start close."""
        topology, moving = self._topology, self._topology.moving_vertices
        contacts = self._contacts
        listed = contacts.count, contacts.kind, contacts.primitives, contacts.parameters
        start, minima = stages.step.vertices_t0, stages.step.minima
        end = stages.step.vertices_t1 if self._no_end is None else self._no_end
        recording.launch(
            specialised("at_one_time.near_contacts", norm=self._norm).note_near_contacts,
            len(contacts.kind),
            inputs=[*listed, *corners_by_kind(topology), start, end, self._of_start["reach"], minima],
            outputs=[self._world_near],
        )
        inputs = [moving, self._world_near, minima]
        recording.launch(kernels.note_near_bodies, len(moving), inputs=inputs, outputs=[self._near, self.is_near])

    def record_distances(
        self, recording: Recording, stages: Stages, record_search: Callable[[Stages, wp.array], None]
    ) -> None:
        """Record the launches that find the distances, after a reset; ``record_search`` records those of a search."""
        start = stages.step.vertices_t0
        of_start = replace(stages.between(start, start), **self._of_start)
        record_search(of_start, self._near)
        of_start.measure_pairs(recording, START_DISTANCE, self._norm)
        inputs, outputs = [stages.step.minima], [self.of_vertex]
        recording.launch(kernels.drop_start_distances, len(self.of_vertex) // 2, inputs=inputs, outputs=outputs)
