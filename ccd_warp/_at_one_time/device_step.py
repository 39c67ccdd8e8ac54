"""The device driver at one time: what is near, and how far vertices may move, in launches of fixed sizes.

A step on the device whose two ends are the same positions, with the boxes, trees and search of every other step and
kernels for distances in place of the narrow phase. How near is near may change from launch to launch; the boxes of
static bodies are made again where they had another size.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._at_one_time.proximities import PROXIMITY_DTYPES, largest_bound, new_proximity_list
from ccd_warp._engine.boxes.trees import search_options
from ccd_warp._engine.device.contact_arrays import ContactArrays
from ccd_warp._engine.device.input import Form, PreparedLaunch
from ccd_warp._engine.device.step import Capacities, DeviceStep
from ccd_warp._engine.mesh.lengths import add_rounded_up, half_rounded_up
from ccd_warp._engine.mesh.scene import packed_reach
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.plan import Goal
from ccd_warp._engine.stages import Stages
from ccd_warp._results.device_results import DeviceDisplacements, DeviceProximities
from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp._scene.input.interop import DeviceArray, without_worlds
from ccd_warp._scene.input.options import Options
from ccd_warp.kernels.at_one_time import proximity as kernels
from ccd_warp.kernels.narrow_phase.sinks import DISPLACEMENT, NEAR
from ccd_warp.kernels.pair.norm import Norm

_SLOTS = ("inflation", "search options", "reach", "largest")


class _Values(NamedTuple):
    """What a launch is asked for, as the values of the slots."""

    inflation: float
    search_options: Any
    reach: Any
    largest: float


class DeviceAtOneTime(DeviceStep, ABC):
    """A step on the device at one time.

    Attributes:
        arrays: The arrays to which launches write.
    """

    def __init__(
        self,
        topology: Topology,
        options: Options,
        capacities: Capacities,
        vertices: NDArray[np.float64],
        radius: wp.array | None,
    ) -> None:
        """Allocate everything, with trees for ``vertices``; every launch gives the positions of all bodies.

        The others are those of every step on the device.
        """
        super().__init__(topology, options, replace(capacities, max_contacts=1), vertices, vertices, radius)
        self._radii = topology.radius if radius is None else radius
        self._of_static = self._full(1, float(self._stages.inflation), wp.float64)
        self._values: dict[tuple[float, float], _Values] = {}  # the last ones
        self._next: _Values  # those of the launch that is recorded
        self._stages = replace(
            self._stages, inflation=Slot("inflation"), search_options=Slot("search options"), reach=Slot("reach")
        )
        self.arrays = self._new_arrays(capacities.max_contacts)

    @abstractmethod
    def _new_arrays(self, capacity: int) -> Any:
        """Allocate the arrays to which launches write, with capacity for so many pairs."""

    @abstractmethod
    def values(self, length: float) -> _Values:
        """The values of a launch with a distance, or with a search radius."""

    def prepare_positions(self, positions: DeviceArray) -> PreparedLaunch:
        """Check the positions of a launch, one row for every vertex."""
        mesh = self._mesh
        positions = without_worlds(positions, "positions", mesh.rows_by_world, mesh.dimension)
        prepared = self.prepare(positions, positions, name_t0="positions", name_t1="positions")
        if not prepared.form.t0_by_vertex:
            raise ValueError(
                f"positions has {len(prepared.vertices_t0)} rows; expected {mesh.num_vertices}, one a vertex"
            )
        return prepared

    def _values_of(self, distance: float, kept: float, largest: float) -> _Values:
        """The values for a distance, packed once, since packing takes as long as a launch."""
        key = (distance, largest)
        if key not in self._values:
            self._values.clear()
            inflation, radii = half_rounded_up(distance), (self._radii, self._input.box_radius)
            searched = search_options(1.0, inflation, distance, Norm.EUCLIDEAN, self._flag, radii)
            reach = packed_reach(self._radii, distance, self._flag.array, kept)
            self._values[key] = _Values(inflation, searched, reach, largest)
        return self._values[key]

    def launch_within(self, prepared: PreparedLaunch, values: _Values) -> None:
        """Launch. If this raises, the step is in an inconsistent state and must not be used again."""
        recording = self._recordings.get(prepared.form)
        if recording is not None:
            for name, value in zip(_SLOTS, values, strict=True):
                recording.bind(name, value)
        self._next = values
        self.launch(prepared)

    def _new_recording(self, **values: Any) -> Recording:
        return super()._new_recording(**values, **dict(zip(_SLOTS, self._next, strict=True)))

    def _record_form(self, recording: Recording, form: Form) -> None:
        """Record all launches."""
        self._record_reset(recording)
        if self.static_trees:
            outputs = [self._of_static, self._input.is_moved]
            recording.launch(kernels.note_inflation, 1, inputs=[Slot("inflation")], outputs=outputs)
        self._record_distances(recording, self._record_pairs(recording, form, self._active))

    @abstractmethod
    def _record_distances(self, recording: Recording, stages: Stages) -> None:
        """Record what takes the place of the narrow phase."""


class DeviceProximityStep(DeviceAtOneTime):
    """The pairs within a distance."""

    goal: Goal = "proximities"

    def _new_arrays(self, capacity: int) -> DeviceProximities:
        arrays = {name: self._empty(capacity, dtype) for name, dtype in PROXIMITY_DTYPES.items()}
        self._count = self._full(1, 0, wp.int32)
        self._stages = replace(self._stages, proximities=new_proximity_list({"count": self._count, **arrays}))
        listed = {name: arrays[name] for name in ("kind", "primitives", "parameters")}
        self.contact_arrays = ContactArrays(
            self.topology, self.execution, {"count": self._count, **listed}, name="proximities"
        )
        result = self.result
        return DeviceProximities(
            count=self._count,
            **arrays,
            flags=result.flags,
            world_flags=result.world_flags,
            num_pairs=result.num_pairs,
        )._of(self)

    def values(self, length: float) -> _Values:
        return self._values_of(length, 0.0, 0.0)

    def positions(self) -> NDArray[np.float64]:
        """What the positions of the last launch are now; this waits for the device."""
        last = self.last_positions()
        assert last is not None
        positions: NDArray[np.float64] = last[0].numpy().reshape(-1, 3)[:, : self._mesh.dimension].copy()
        return positions

    def radius(self) -> NDArray[np.float64] | None:
        """What the array of radii holds now; None where there are none."""
        radii = self._radii_of_last()
        return None if radii is None else radii[0]

    def _record_reset(self, recording: Recording, kept_flags: int = 0, *, keeps_toi: bool = False) -> None:
        self._stages.reset(recording, self._count, self._flag.array, kept_flags, keeps_toi=keeps_toi)

    def _record_distances(self, recording: Recording, stages: Stages) -> None:
        if stages.plane_query is not None:
            stages.list_near_planes(recording)
        stages.measure_pairs(recording, NEAR, Norm.EUCLIDEAN)


class DeviceDisplacementStep(DeviceAtOneTime):
    """How far vertices may move."""

    goal: Goal = "displacements"

    def _new_arrays(self, capacity: int) -> DeviceDisplacements:
        self._is_alone = self._mesh._moves_alone
        _ = self.topology.body_static  # computed now, not during a capture
        self._unused = self.topology.array(self._mesh.unused_vertices)
        result = self.result
        return DeviceDisplacements(
            bounds=result.vertex_toi,
            flags=result.flags,
            world_flags=result.world_flags,
            num_pairs=result.num_pairs,
            _step=self,
        )

    def values(self, length: float) -> _Values:
        kept = self._options.minimum_distance
        return self._values_of(add_rounded_up(length, kept), kept, largest_bound(length, self._is_alone))

    def _record_input(self, recording: Recording, form: Form, stages: Stages, is_first: bool) -> None:
        super()._record_input(recording, form, stages, is_first)
        inputs = [Slot("largest"), self.topology.body_static]
        recording.launch(kernels.reset_bounds, self._mesh.num_vertices, inputs=inputs, outputs=[stages.step.minima])
        if len(self._unused):
            recording.launch(kernels.unbind, len(self._unused), inputs=[self._unused], outputs=[stages.step.minima])

    def _record_distances(self, recording: Recording, stages: Stages) -> None:
        if stages.plane_query is not None:
            stages.bound_by_half_spaces(recording)
        stages.measure_pairs(recording, DISPLACEMENT, Norm.EUCLIDEAN)
