"""Slices of a step in which bodies turn: where they are at both ends of each, and what kernels know of their arcs."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._engine.mesh.topology import MOST_COPIED, Positions, Topology
from ccd_warp._engine.motion import Motion, Slice
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.written import Written
from ccd_warp.kernels.pair.turns import Turns
from ccd_warp.kernels.rigid import place_bodies as kernels

_COLUMNS, _OF_ENDS = dtypes_of(kernels.BodyPaths), dtypes_of(kernels.BodyEnds)
_PLACE, _ENDS = "place", ("start", "end")
_MOST_PLACING = 4  # recordings
Times = tuple[wp.array, wp.array]


class PathTable:
    """The paths of some bodies on a device.

    Attributes:
        table: The struct of the kernels.
        columns: Its arrays by name.
    """

    def __init__(self, count: int, device: wp.Device, names: Iterable[str] = _COLUMNS) -> None:
        """Allocate these columns, all by default, for so many bodies."""
        self.columns: dict[str, wp.array] = {
            name: wp.zeros(count, dtype=_COLUMNS[name], device=device) for name in names
        }
        self.table = struct_of(kernels.BodyPaths, self.columns)
        self._views = {name: Written(array) for name, array in self.columns.items()}

    def assign(self, paths: BodyPaths) -> None:
        """Write the paths of as many bodies, of which some may be on none (`MeshPaths`)."""
        for name, view in self._views.items():
            if name != "is_rigid" or hasattr(paths, name):
                view.write(getattr(paths, "pivot_t0" if name == "start" else name))


class Arcs(Motion):
    """The arrays of a mesh whose bodies turn; those of a slice are overwritten by the next.

    A vertex is enlarged in a slice by its radius, its sagitta and its rounding.

    Attributes:
        start: Positions at the begin of a slice.
        end: Positions at its end.
        paths: The paths of the bodies, as the struct of the kernels.
    """

    on_arcs, t_end = True, 1.0

    def __init__(self, topology: Topology, radius: wp.array | None = None, box_radius: wp.array | None = None) -> None:
        """Allocate the arrays; ``radius`` and ``box_radius`` are others than those of the mesh."""
        mesh, device = topology.mesh, topology.device
        self._topology = topology
        self._radii = (topology.radius, topology.box_radius) if radius is None else (radius, box_radius)
        self.start, self.end, self._velocity = (
            wp.zeros(mesh.num_vertices, dtype=wp.vec3d, device=device) for _ in range(3)
        )
        self.radius, self.box_radius, self._slack = (
            wp.zeros(mesh.num_vertices, dtype=wp.float64, device=device) for _ in range(3)
        )
        self._times = self.new_times(Slice(0.0, 1.0))
        self._written = [Written(array) for array in self._times]
        self._paths = PathTable(mesh.num_bodies, device)
        self.paths = self._paths.table
        ends = {name: wp.zeros(mesh.num_bodies, dtype=x, device=device) for name, x in _OF_ENDS.items()}
        self._body_ends = struct_of(kernels.BodyEnds, ends)
        self._copies: list[Written] = []  # of few positions; of more the caller's own arrays are read
        self._no_ends: list[wp.array] = 2 * [wp.empty(0, dtype=wp.vec3d, device=device)]
        self._ends = self._no_ends
        self._placing: list[Recording] = []  # of the last goals
        self._places = (self.start.numpy(), self.end.numpy()) if device.is_cpu else None
        self._turns = self.turns_at(self._times)

    def new_paths(self, *names: str) -> Any:
        """Another table of paths, of these columns alone."""
        return PathTable(self._topology.mesh.num_bodies, self._topology.device, names).table

    def begin(self, paths: BodyPaths) -> None:
        """Begin a step along these paths."""
        self._paths.assign(paths)

    def new_times(self, time_slice: Slice) -> Times:
        """Arrays of the begin and the end of a slice, for each body."""
        count, device = self._topology.mesh.num_bodies, self._topology.device
        begin, end = (np.broadcast_to(t, count) for t in time_slice[:2])
        return wp.array(begin, dtype=wp.float64, device=device), wp.array(end, dtype=wp.float64, device=device)

    def place(self, times: Times, recording: Recording, start: wp.array | Slot, end: wp.array | Slot) -> None:
        """Record what places bodies and vertices at both ends of a slice, given positions at those of the step."""
        topology = self._topology
        inputs = [*times, self.paths]
        recording.launch(kernels.place_bodies, topology.mesh.num_bodies, inputs=inputs, outputs=[self._body_ends])
        inputs = [*times, topology.vertex_body, self.paths, self._body_ends, start, end, *self._radii]
        outputs = [self.start, self.end, self._velocity, self._slack, self.radius, self.box_radius]
        recording.launch(kernels.place_vertices, topology.mesh.num_vertices, inputs=inputs, outputs=outputs)

    def begin_on_host(self, slices: list[Slice], positions: Positions) -> Motion:
        """Begin a step on the host along paths that are known, given positions at both ends in the bodies' frames."""
        self.slices = slices
        num_vertices, device = self._topology.mesh.num_vertices, self._topology.device
        if num_vertices <= MOST_COPIED:
            if not self._copies:
                self._copies = [Written(wp.empty(num_vertices, dtype=wp.vec3d, device=device)) for _ in range(2)]
                self._ends = [written.array for written in self._copies]
            for written, values in zip(self._copies, positions, strict=True):
                written.write(values)
            return self
        start, end = positions
        first: wp.array = wp.array(start, dtype=wp.vec3d, device=device, copy=False)
        self._ends = [first, first if end is start else wp.array(end, dtype=wp.vec3d, device=device, copy=False)]
        return self

    def placed(self, time_slice: Slice, execution: Execution) -> Positions:
        """The positions at both ends of a slice on the host; on the CPU the next slice overwrites them."""
        for written, t in zip(self._written, time_slice[:2], strict=True):
            written.write(np.asarray(t))
        placing = next((known for known in self._placing if known.execution is execution), None)
        if placing is None:
            placing = Recording(execution, dict(zip(_ENDS, self._ends, strict=True)))
            with placing.section(_PLACE):
                self.place(self._times, placing, *map(Slot, _ENDS))
            self._placing = [placing, *self._placing[: _MOST_PLACING - 1]]
        self._bind(placing)
        placing.play(_PLACE)
        return self._places or (self.start.numpy(), self.end.numpy())

    def _bind(self, placing: Recording) -> None:
        for name, array in zip(_ENDS, self._ends, strict=True):
            placing.bind(name, array)

    def release(self) -> None:
        """Do not keep the caller's arrays alive."""
        if self._copies:
            return
        self._ends = self._no_ends
        for placing in self._placing:
            self._bind(placing)

    def turns(self, time_slice: Slice) -> Any:
        """How the vertices turn in the slice in which they have last been placed on the host."""
        return self._turns

    def turns_at(self, times: Times) -> Any:
        """How the vertices turn in a slice, as the struct of the kernels."""
        turns = Turns()
        turns.velocity, turns.omega, turns.slack = self._velocity, self._paths.columns["omega"], self._slack
        turns.excess = self._paths.columns["excess"]
        turns.vertex_body = self._topology.vertex_body
        turns.t_begin, turns.t_end = times
        return turns
