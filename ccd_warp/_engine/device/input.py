"""What a launch on the device reads: its arguments, checked, and the launches that read positions and radii."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.box_sets import BoxSet
from ccd_warp._engine.mesh.topology import MOST_COPIED, Topology
from ccd_warp._engine.stages import Stages
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._scene.input.interop import DeviceArray, as_positions, vector_of
from ccd_warp.kernels.boxes import thickness
from ccd_warp.kernels.step import device_step as kernels
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp.kernels.step.minima import Minima

_REALS = (np.float64, np.float32)
SAFETY = Slot("safety")
_CHUNK = int(kernels.CHUNK)


@dataclass(frozen=True)
class LineSearch:
    """The kind of a line search, which determines its launches; ``safety`` is an argument of the launches."""

    per: str
    num_rounds: int  # of all passes; 0 where it is not used

    @staticmethod
    def of(per: str, num_rounds: int) -> "LineSearch":
        """The line search of :meth:`ccd_warp.CollisionPipeline.launch_line_search`."""
        return LineSearch(per, 0 if per in ("scene", "world") else num_rounds)


class Form(NamedTuple):
    """What a recording depends on besides the arrays."""

    real: type
    t0_by_vertex: bool
    t1_by_vertex: bool
    is_displacement: bool = False
    line_search: LineSearch | None = None
    num_slices: int = 0  # where bodies turn
    is_taped: bool = False  # whether the passes of a line search are kept


class PreparedLaunch(NamedTuple):
    """The checked arguments of a launch.

    Attributes:
        form: The form of the launch, which selects the recording.
        vertices_t0: Start positions.
        vertices_t1: End positions, or displacements.
        safety: Fraction of a toi that a line search keeps.
        places_static: Whether it sets the positions of static bodies.
        copied_arrays: The arrays of NumPy whose values the launch copies to ``vertices_t0`` and ``vertices_t1``; None
            where these are the caller's.
    """

    form: Form
    vertices_t0: wp.array
    vertices_t1: wp.array
    safety: float
    places_static: bool
    copied_arrays: list[NDArray[Any]] | None = None


class DeviceInput:
    """The input of a step on the device, and float64 positions of its own where those of the caller do not serve.

    Attributes:
        has_static: Whether there are static bodies, whose positions stay from launch to launch.
        start: The step's own start positions, wp.vec3d; empty as long as no launch needs them.
        end: The step's own end positions.
        is_moved: Whether static bodies, or their radii, are not those of their boxes, int32, shape [1].
        box_radius: By how much the boxes of each vertex grow besides; empty where there are no radii.
    """

    def __init__(
        self,
        topology: Topology,
        execution: Execution,
        static_positions: NDArray[np.float64],
        radius: wp.array | None,
    ) -> None:
        """Allocate what has a size now.

        Args:
            topology: The mesh on its device.
            execution: Where the step runs.
            static_positions: Positions whose static rows are those of static bodies.
            radius: Radii of the vertices, which may change between launches; None where the mesh has none.
        """
        self._topology, self._mesh, device = topology, topology.mesh, topology.device
        self._chunk = 1 if execution.is_cuda else _CHUNK
        self._own_arrays: dict[tuple[str, str, int], tuple[wp.array, NDArray[Any]]] = {}
        self._radius = radius
        self.box_radius = topology.box_radius
        if radius is not None:
            _ = topology.neighbours  # computed now, not during a capture
            self.box_radius = wp.clone(topology.box_radius)
            # written where radii of moving vertices change, never read
            self._is_thicker: wp.array = wp.zeros(1, dtype=wp.int32, device=device)
        self.is_moved: wp.array = wp.zeros(1, dtype=wp.int32, device=device)
        self.has_static = len(self._mesh.moving_vertices) < self._mesh.num_vertices
        self.start: wp.array = wp.empty(0, dtype=wp.vec3d, device=device)
        self.end = self.start
        if self.has_static:
            self.start = wp.array(static_positions, dtype=wp.vec3d, device=device)
            self.end = wp.clone(self.start)

    def is_copied(self, form: Form) -> bool:
        """Whether a launch reads positions into arrays of the step's own."""
        is_in_plane = self._mesh.dimension == 2
        return form.real is not wp.float64 or form.is_displacement or self.has_static or is_in_plane

    def slots(self, form: Form) -> tuple[Any, Any]:
        """The positions at both ends for the stages of a launch: the caller's, or the step's own."""
        if not self.is_copied(form):
            return Slot("vertices_t0"), Slot("vertices_t1")
        if len(self.start) == 0:
            count, device = self._mesh.num_vertices, self._topology.device
            self.start, self.end = (wp.empty(count, dtype=wp.vec3d, device=device) for _ in range(2))
        return self.start, self.end

    def prepare(
        self,
        vertices_t0: DeviceArray,
        vertices_t1: DeviceArray,
        *,
        name_t0: str = "vertices_t0",
        name_t1: str = "vertices_t1",
        is_displacement: bool = False,
        line_search: LineSearch | None = None,
        safety: float = 1.0,
        num_slices: int = 0,
        is_taped: bool = False,
    ) -> PreparedLaunch:
        """Check the arguments of a launch, which are those of :meth:`ccd_warp.CollisionPipeline.launch`."""
        mesh, device = self._mesh, self._topology.device
        rows = {mesh.num_vertices: "one a vertex"}
        if self.has_static:
            rows[len(mesh.moving_vertices)] = "one a moving vertex"
        arrays: list[Any] = [vertices_t0, vertices_t1]
        is_copied = self._may_be_copied(arrays, rows)
        if is_copied:
            start, end = (self._own_array(name, values)[0] for name, values in zip(("t0", "t1"), arrays, strict=True))
        else:
            start = as_positions(vertices_t0, name_t0, device, rows, mesh.dimension)
            end = as_positions(vertices_t1, name_t1, device, rows, mesh.dimension)
            check_same_dtype(start, end, name_t1)
        real = wp.float64 if start.dtype in (wp.vec2d, wp.vec3d) else wp.float32
        count = mesh.num_vertices
        by_vertex = len(start) == count, len(end) == count
        form = Form(real, *by_vertex, is_displacement, line_search, num_slices, is_taped)
        places_static = form.t0_by_vertex and self.has_static
        return PreparedLaunch(form, start, end, safety, places_static, arrays if is_copied else None)

    def _may_be_copied(self, arrays: list[Any], rows: Collection[int]) -> bool:
        """Whether the values of two arrays are copied: of NumPy and few, which costs less than to bind the arrays.

        A graph reads the caller's arrays, whatever they hold when it is replayed.
        """
        device, dimension = self._topology.device, self._mesh.dimension
        if device.is_cuda or not all(type(values) is np.ndarray for values in arrays) or device.is_capturing:
            return False
        return arrays[0].dtype == arrays[1].dtype and all(
            values.dtype in _REALS
            and values.ndim == 2
            and values.shape[1] == dimension
            and values.shape[0] in rows
            and values.shape[0] <= MOST_COPIED
            and values.flags.c_contiguous
            for values in arrays
        )

    def _own_array(self, name: str, like: NDArray[Any]) -> tuple[wp.array, NDArray[Any]]:
        """An array of the step's own with the type and the shape of another, on the device and on the host."""
        key = (name, like.dtype.char, len(like))
        if key not in self._own_arrays:
            host = np.empty_like(like)
            self._own_arrays[key] = wp.array(host, dtype=vector_of(like), device="cpu", copy=False), host
        return self._own_arrays[key]

    def copy_in(self, prepared: PreparedLaunch) -> None:
        """Copy the values of NumPy's arrays to the arrays of a launch, where it has some."""
        for name, values in zip(("t0", "t1"), prepared.copied_arrays or [], strict=False):
            self._own_array(name, values)[1][...] = values

    def copy_out(self, prepared: PreparedLaunch) -> None:
        """Copy what a line search has written to the caller's array of NumPy, where it has one."""
        if prepared.copied_arrays is not None and prepared.form.line_search is not None:
            values = prepared.copied_arrays[1]
            values[...] = self._own_array("t1", values)[1]

    def record(self, recording: Recording, form: Form, stages: Stages, is_first: bool) -> None:
        """Record the launches that read positions and, in the first pass, radii."""
        topology, minima = self._topology, stages.step.minima
        read = specialised("step.input_rows", real=form.real, dimension=self._mesh.dimension)
        if is_first and form.t0_by_vertex and self.has_static:
            recording.launch(
                read.read_static,
                -(-len(topology.static_vertices) // self._chunk),
                inputs=[
                    topology.static_vertices,
                    Slot("vertices_t0"),
                    Slot("vertices_t1"),
                    int(form.t1_by_vertex),
                    int(form.is_displacement),
                    self._chunk,
                ],
                outputs=[self.start, self.end, self.is_moved, minima],
                grain=64,
            )
        elif is_first and form.t1_by_vertex and self.has_static:
            recording.launch(
                read.check_static,
                -(-len(topology.static_vertices) // self._chunk),
                inputs=[
                    topology.static_vertices,
                    Slot("vertices_t1"),
                    int(form.is_displacement),
                    self._chunk,
                    self.start,
                ],
                outputs=[minima],
                grain=64,
            )
        by_vertex = [int(form.t0_by_vertex), int(form.t1_by_vertex)]
        recording.launch(
            read.read_moving,
            len(topology.moving_vertices),
            inputs=[
                topology.checked_vertices,
                Slot("vertices_t0"),
                Slot("vertices_t1"),
                *by_vertex,
                int(form.is_displacement),
                int(self.is_copied(form)),
            ],
            outputs=[self.start, self.end, minima],
        )
        if is_first and self._radius is not None:
            self._record_radius(recording, minima)

    def _record_radius(self, recording: Recording, minima: "Minima") -> None:
        """Record the launches that read the radii, which may have changed, and mark static boxes that then do."""
        topology = self._topology
        for vertices, is_changed in (
            (topology.boxed_vertices, self._is_thicker),
            (topology.static_vertices, self.is_moved),
        ):
            if len(vertices):
                recording.launch(
                    thickness.fill_box_radius,
                    len(vertices),
                    inputs=[vertices, self._radius, *topology.neighbours],
                    outputs=[self.box_radius, is_changed, minima],
                )

    def record_refresh(self, recording: Recording, stages: Stages, static_trees: list[BoxSet]) -> None:
        """Record the launches that compute the boxes of static bodies again where these have moved."""
        topology = self._topology
        # also if static bodies are not read now: an earlier launch may have been interrupted after it read them
        with recording.only_if(self.is_moved):
            recording.launch(
                kernels.refresh_vertex_aabbs,
                len(topology.static_vertices),
                inputs=[
                    self.is_moved,
                    topology.static_vertices,
                    topology.worlds,
                    self.start,
                    stages.inflation,
                    stages.box_radius,
                    stages.quantization,
                    stages.num_aabbs,
                ],
                outputs=[stages.vertex_aabbs],
            )
            stages.fill_boxes(recording, static_trees, self.is_moved)
            recording.launch(kernels.settle, 1, inputs=[], outputs=[self.is_moved])


def check_same_dtype(start: wp.array, end: wp.array, name_t1: str) -> None:
    """Check that positions at both ends have one type."""
    if start.dtype is not end.dtype:
        raise ValueError(f"{name_t1} has dtype {end.dtype.__name__}; expected {start.dtype.__name__} like vertices_t0")
