"""Slices of a step in which bodies turn: where they are at both ends of each, and what kernels know of their arcs."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._engine.motion import Motion, Slice
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp.kernels.pair.turns import Turns
from ccd_warp.kernels.rigid import place_bodies as kernels

_COLUMNS = dtypes_of(kernels.BodyPaths)
Times = tuple[wp.array, wp.array]


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
        self._arrays = self._columns(*_COLUMNS)
        self.paths = struct_of(kernels.BodyPaths, self._arrays)
        self._ends: list[wp.array] = []

    def _columns(self, *names: str) -> dict[str, wp.array]:
        """Arrays with a row a body, by the names of columns of a table of paths."""
        count, device = self._topology.mesh.num_bodies, self._topology.device
        return {name: wp.zeros(count, dtype=_COLUMNS[name], device=device) for name in names}

    def new_paths(self, *names: str) -> Any:
        """Another table of paths, of these columns alone."""
        return struct_of(kernels.BodyPaths, self._columns(*names))

    def begin(self, paths: BodyPaths) -> None:
        """Begin a step along these paths."""
        for name, array in self._arrays.items():
            array.assign(_column(paths, name))

    def new_times(self, part: Slice) -> Times:
        """Arrays of the begin and the end of a slice, for each body."""
        count, device = self._topology.mesh.num_bodies, self._topology.device
        times: list[wp.array] = [wp.array(np.broadcast_to(t, count), dtype=wp.float64, device=device) for t in part[:2]]
        return times[0], times[1]

    def place(self, times: Times, launcher: Execution | Recording, start: Any, end: Any) -> None:
        """Place vertices at both ends of a slice, given their positions at both ends of the step."""
        topology = self._topology
        inputs = [*times, topology.vertex_body, self.paths, start, end, *self._radii]
        outputs = [self.start, self.end, self._velocity, self._slack, self.radius, self.box_radius]
        launcher.launch(kernels.place_vertices, topology.mesh.num_vertices, inputs=inputs, outputs=outputs)

    def begin_on_host(self, paths: BodyPaths, slices: list[Slice], positions: Positions) -> Motion:
        """Begin a step on the host along these paths, given positions at both ends in the bodies' own frames."""
        self.begin(paths)
        self.slices = slices
        device = self._topology.device
        self._ends = [wp.array(x, dtype=wp.vec3d, device=device, copy=False) for x in positions]
        return self

    def placed(self, part: Slice, execution: Execution) -> Positions:
        """The positions at both ends of a slice on the host; on the CPU the next slice overwrites them."""
        for array, t in zip(self._times, part[:2], strict=True):
            array.assign(np.broadcast_to(t, len(array)))
        self.place(self._times, execution, *self._ends)
        return self.start.numpy(), self.end.numpy()

    def release(self) -> None:
        """Do not keep the caller's arrays alive."""
        self._ends.clear()

    def turns(self, part: Slice, times: Times | None = None) -> Any:
        """How the vertices turn in a slice, by default the one in which they have last been placed on the host.

        Returns:
            The struct of the kernels.
        """
        turns = Turns()
        turns.velocity, turns.omega, turns.slack = self._velocity, self._arrays["omega"], self._slack
        turns.vertex_body = self._topology.vertex_body
        turns.t_begin, turns.t_end = times or self._times
        return turns


def paths_on(device: Any, paths: BodyPaths) -> Any:
    """The paths of bodies, all of which are rigid, on a device, as the struct of the kernels."""
    columns = {name: _column(paths, name) for name in _COLUMNS if name != "is_rigid"}
    arrays: dict[str, wp.array] = {
        name: wp.array(x, dtype=_COLUMNS[name], device=device) for name, x in columns.items()
    }
    return struct_of(kernels.BodyPaths, arrays)


def _column(paths: BodyPaths, name: str) -> NDArray[Any]:
    column: NDArray[Any] = getattr(paths, "pivot_t0" if name == "start" else name)
    return column
