"""Slices of a step in which bodies turn: where they are at both ends of each, and what kernels know of their arcs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp.kernels.pair.rounding import INTERPOLATION, PLACE, PLACE_POSITION, UNIT_ROUNDOFF
from ccd_warp.kernels.pair.turns import Turns
from ccd_warp.kernels.step import place_bodies as kernels

if TYPE_CHECKING:
    from ccd_warp._mesh_paths import MeshPaths

# Turn of a slice, in radians: boxes of finer slices are hardly smaller, and those of coarser ones grow.
TURN_OF_A_SLICE = 0.2


@dataclass(frozen=True)
class Slice:
    """A part of a step.

    Attributes:
        t_begin: Its begin, a time of the step.
        t_end: Its end.
        is_last: Whether no other follows.
    """

    t_begin: float
    t_end: float
    is_last: bool


def slices_of(paths: "MeshPaths", t_max: float) -> list[Slice]:
    """Slices of [0, t_max] in each of which no body turns by more than `TURN_OF_A_SLICE`."""
    turn = float(np.linalg.norm(paths.omega, axis=1).max(initial=0.0)) * t_max
    count = max(1, int(np.ceil(turn / TURN_OF_A_SLICE)))
    ends = [t_max * k / count for k in range(count + 1)]
    ends[-1] = t_max
    return [Slice(ends[k], ends[k + 1], k + 1 == count) for k in range(count)]


class Arcs:
    """The arrays of a mesh whose bodies turn; those of a slice are overwritten by the next.

    Attributes:
        radius: By how much each vertex is enlarged in a slice: its radius, its sagitta and its rounding.
        box_radius: The same for its boxes.
    """

    def __init__(self, topology: Topology, buffers: Buffers) -> None:
        self._topology = topology
        num_vertices, num_bodies, device = topology.mesh.num_vertices, topology.mesh.num_bodies, topology.device
        self._ends = [wp.zeros(num_vertices, dtype=wp.vec3d, device=device) for _ in range(2)]
        self._velocity = wp.zeros(num_vertices, dtype=wp.vec3d, device=device)
        self.radius: wp.array = wp.zeros(num_vertices, dtype=wp.float64, device=device)
        self.box_radius: wp.array = wp.zeros(num_vertices, dtype=wp.float64, device=device)
        self._paths = kernels.BodyPaths()
        self._spin = wp.zeros(num_bodies, dtype=wp.vec3d, device=device)

    def begin(self, paths: "MeshPaths", positions: Positions) -> None:
        """Begin a step along these paths, of bodies whose vertices have positions in their own frames."""
        self._step_paths = paths
        topology, mesh = self._topology, self._topology.mesh
        is_rigid = paths.is_rigid
        self._start = [self._on_device(x) for x in positions]
        fields = {name: topology.array(getattr(paths, name), wp.vec3d) for name in ("omega", "pivot", "velocity")}
        fields |= {
            "start": topology.array(paths.pivot_t0, wp.vec3d),
            "turning": topology.array(paths.turning, wp.vec3d),
        }
        fields |= {"is_rigid": topology.array(is_rigid.astype(np.int32))}
        fields |= {"rotation": topology.array(paths.rotation, wp.vec4d)}
        self._slack = topology.array(slack_of(mesh, paths, positions), wp.float64)
        fields["slack"] = self._slack
        for name, array in fields.items():
            setattr(self._paths, name, array)

    def _on_device(self, values: NDArray[np.float64]) -> wp.array:
        return wp.array(values, dtype=wp.vec3d, device=self._topology.device, copy=False)

    def place(self, part: Slice, execution: Execution) -> Positions:
        """The positions at both ends of a slice, whose arrays the next slice overwrites."""
        topology = self._topology
        execution.launch(
            kernels.place_vertices,
            topology.mesh.num_vertices,
            inputs=[
                part.t_begin,
                part.t_end,
                topology.vertex_body,
                self._paths,
                *self._start,
                topology.radius,
                topology.box_radius,
            ],
            outputs=[*self._ends, self._velocity, self.radius, self.box_radius],
        )
        self._spin.assign((part.t_end - part.t_begin) * self._step_paths.omega)
        start, end = (array.numpy() for array in self._ends)
        return start, end

    def turns(self, part: Slice) -> Any:
        """How the vertices turn in a slice, as the struct of the kernels."""
        turns = Turns()
        turns.velocity, turns.spin, turns.slack = self._velocity, self._spin, self._slack
        turns.vertex_body = self._topology.vertex_body
        turns.t_begin, turns.t_length = part.t_begin, part.t_end - part.t_begin
        return turns


def slack_of(mesh: Any, paths: "MeshPaths", positions: Positions) -> NDArray[np.float64]:
    """By how much rounding may move a vertex of each body (``kernels.pair.rounding``, steps 12 and 18)."""
    unit = UNIT_ROUNDOFF[wp.float64]
    lengths = np.sqrt(np.maximum(*(np.einsum("ij,ij->i", x, x) for x in positions)))
    largest = np.zeros(mesh.num_bodies)
    filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
    if len(filled):
        largest[filled] = np.maximum.reduceat(lengths, mesh.body_vertex_range[filled])
    largest *= 1.0 + 8.0 * unit
    arm = largest + np.linalg.norm(paths.pivot, axis=1)
    far = np.maximum(np.abs(paths.pivot_t0), np.abs(paths.pivot_t0 + paths.velocity)).max(axis=1)
    turned = (1.0 + 0.5 * np.linalg.norm(paths.omega, axis=1)) * (arm + np.linalg.norm(paths.turning, axis=1))
    of_turns = unit * (PLACE_POSITION * far + PLACE * turned)
    return np.where(paths.is_rigid, of_turns, INTERPOLATION * unit * largest)
