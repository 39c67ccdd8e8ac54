"""The driver of calls whose input and results stay on the device: all stages, recorded once and replayed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.boxes.box_sets import Layout, Order
from ccd_warp._engine.boxes.grids import choose_cell
from ccd_warp._engine.boxes.near_bodies import NearBodies
from ccd_warp._engine.boxes.rest_order import order_at, rest_order
from ccd_warp._engine.boxes.trees import search_options
from ccd_warp._engine.device.contact_arrays import ContactArrays
from ccd_warp._engine.device.input import SAFETY, DeviceInput, Form, PreparedLaunch, check_same_dtype
from ccd_warp._engine.host.contacts import BYTES_PER_CONTACT, CONTACT_DTYPES, new_contact_list, new_minima
from ccd_warp._engine.host.pair_memory import CANDIDATES_EACH, KEY_BYTES
from ccd_warp._engine.mesh.lengths import half_rounded_up
from ccd_warp._engine.mesh.planes import plane_query, planes_of
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._engine.mesh.topology import VERTEX_AABB_FLOATS, PrimitiveSet, Topology, choose_quantization
from ccd_warp._engine.plan import Goal, Plan, low_half
from ccd_warp._engine.stages import KINDS_AT_ONCE, Stages, StepFields
from ccd_warp._results.contact_place import located
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.device_pairs import DeviceContacts
from ccd_warp._results.device_results import LaunchResult
from ccd_warp._results.touch import Touch
from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp._runtime.pair_queue import new_queue, queue_bytes
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._scene.input.interop import DeviceArray, as_positions, without_worlds
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.step import device_step as kernels
from ccd_warp.kernels.step.minima import ANY_UNLISTED, MOST_LISTED

if TYPE_CHECKING:
    from ccd_warp.kernels.boxes.box_tree import Quantization

MOST_PAIRS = 1 << 28
MOST_CONTACTS = np.iinfo(np.int32).max
_LEAST_CAPACITY = 1 << 12
_PLAY = "step"
# By how much the cells of spatial hashes are larger than those for stationary boxes, as the motions are not known yet.
_SPARE = 4.0
# Recordings that are kept, enough for the different kinds of calls in a loop.
_MOST_RECORDINGS = 16


@dataclass(frozen=True)
class Capacities:
    """Capacities of a device step; see :meth:`ccd_warp.CollisionPipeline.reserve`."""

    max_pairs: int
    max_contacts: int

    @staticmethod
    def default(mesh: CollisionMesh) -> "Capacities":
        """One pair of each kind for each primitive and one contact for each vertex, less memory than the boxes take."""
        primitives = mesh.num_vertices + mesh.num_edges + mesh.num_faces
        return Capacities(min(max(_LEAST_CAPACITY, primitives), MOST_PAIRS), max(_LEAST_CAPACITY, mesh.num_vertices))

    def num_bytes(self, num_kinds: int, *, is_cuda: bool) -> int:
        """Bytes of the arrays that have these capacities, for pairs of so many kinds."""
        keys = num_kinds * KEY_BYTES * (1 + CANDIDATES_EACH if is_cuda else 1)
        queue = KINDS_AT_ONCE * queue_bytes(keeps_contacts=True) if is_cuda else 0
        return self.max_pairs * (keys + queue) + self.max_contacts * BYTES_PER_CONTACT


class DeviceStep(Plan):
    """All arrays to which a step on the device writes, and its launches.

    Attributes:
        result: The arrays of the result.
        contact_arrays: What its contacts are asked for besides their own arrays.
        kept_by_rings: What rings keep with this step, by their classes.
    """

    goal: Goal = "contacts"
    on_arcs = False

    def __init__(
        self,
        topology: Topology,
        options: Options,
        capacities: Capacities,
        vertices: NDArray[np.float64],
        static_positions: NDArray[np.float64],
        radius: wp.array | None = None,
    ) -> None:
        """Allocate everything, with trees for ``vertices`` and the static bodies of ``static_positions``.

        ``radius`` are the radii of the vertices, which may change between launches; None where the mesh has none.
        """
        self._mesh = mesh = topology.mesh
        self._flag = StopFlag(topology.device)
        execution = Execution(topology.device, options.threads, self._flag)
        norm = norm_of(mesh, options, on_arcs=self.on_arcs)
        super().__init__(topology, options, execution, self.goal, norm)
        _ = topology.corners, topology.collision_filter, topology.body_kinematic  # computed now, not during a capture
        self._options, self._vertices, self._radius = options, vertices, radius
        self._input = DeviceInput(topology, execution, static_positions, radius)
        self._active = self._full(mesh.num_bodies, 1, wp.int32)
        self._near_bodies = NearBodies.of(topology)
        self._is_any_unlisted = low_half(self._counts, int(ANY_UNLISTED))
        self._last: PreparedLaunch | None = None
        self.kept_by_rings: dict[type, Any] = {}
        self._recordings: dict[Form, Recording] = {}  # in the order in which they were made
        quantization = choose_quantization(topology, (vertices, vertices), self._num_aabbs)
        layout = Layout(
            self._num_aabbs,
            lambda _, n, dtype: self._empty(n, dtype),
            self._order,
            lambda: choose_cell(topology, (vertices, vertices), quantization, spare=_SPARE),
            topology.vertex_group,
        )
        for tree in self.trees:
            tree.lay_out(layout)
        self.result = self._new_result(capacities.max_contacts)
        self.contact_arrays = ContactArrays(topology, execution, vars(self.result.contacts), self._both_radii)
        arrays = self._arrays(capacities, quantization.packed)
        narrow_phase = self._narrow_phase, self.is_clipping
        self._stages = Stages(topology, self.tree_pairs, self._num_aabbs, *narrow_phase, **arrays)
        self._stages.load(execution, self.sink)
        if self.static_trees:
            self._stages.fill_vertex_aabbs(execution, topology.static_vertices, self._active)
            self._stages.fill_boxes(execution, self.static_trees)

    @property
    def _both_radii(self) -> tuple[wp.array, wp.array]:
        """Radii of the vertices, and of the primitives around them; empty where the mesh has none."""
        return self.topology.radius if self._radius is None else self._radius, self._input.box_radius

    def _arrays(self, capacities: Capacities, quantization: "Quantization") -> dict[str, Any]:
        """The arrays and values of the stages."""
        topology, options, result, mesh = self.topology, self._options, self.result, self._mesh
        is_cuda, max_pairs = self.execution.is_cuda, capacities.max_pairs
        has_queue = is_cuda and self._has_narrow_phase
        length_scale = length_scale_of(mesh, options)
        separation = options.separation(length_scale)
        inflation = half_rounded_up(separation)
        radii = self._both_radii
        minima = new_minima(
            topology,
            vertex=result.vertex_toi,
            body=result.body_toi,
            world=result.world_toi,
            scene=result.toi,
            world_flags=result.world_flags,
            flags=result.flags,
        )
        contacts = new_contact_list(vars(result.contacts))
        if self.has_planes:
            _ = planes_of(topology)  # made now, not in a capture
        return {
            "step": StepFields(self._input.start, self._input.end, self._counts, minima, contacts, None),
            "vertex_aabbs": self._empty(mesh.num_vertices * self._num_aabbs * VERTEX_AABB_FLOATS, wp.float32),
            "boxes": {tree.name: tree.structs for tree in self.trees},
            "keys": {kind: self._empty(max_pairs, wp.int64) for kind in self._searched_kinds},
            "candidates": {
                kind: self._empty(CANDIDATES_EACH * max_pairs if is_cuda else 0, wp.int64)
                for kind in self._searched_kinds
            },
            "quantization": quantization,
            "t_end": options.t_max,
            "inflation": inflation,
            "box_radius": self._input.box_radius,
            "is_thick": self._radius is not None,
            "search_options": search_options(options.t_max, inflation, separation, self.norm, self._flag, radii),
            "options": options.for_kernel(length_scale, stop=self._flag.array, radius=radii[0]),
            "queue": new_queue(KINDS_AT_ONCE * max_pairs, topology.device, keeps_contacts=True) if has_queue else None,
            "plane_query": self.plane_query() if self.has_planes else None,
        }

    def plane_query(self, *, lets_part: bool = False) -> Any:
        """What vertices and planes are asked for."""
        length_scale = length_scale_of(self._mesh, self._options)
        return plane_query(self._options, length_scale, is_euclidean=self.norm.is_ball, lets_part=lets_part)

    def _empty(self, count: int, dtype: type) -> wp.array:
        return wp.empty(count, dtype=dtype, device=self.topology.device)

    def _full(self, count: int, value: Any, dtype: type) -> wp.array:
        return wp.full(count, value=value, dtype=dtype, device=self.topology.device)

    def static_positions(self) -> NDArray[np.float64]:
        """Positions whose static rows are the current positions of these bodies; this waits for the device."""
        return self._input.start.numpy().copy() if self._input.has_static else self._vertices

    def _new_result(self, max_contacts: int) -> LaunchResult:
        """The arrays of the result; until the first launch every toi is 0, so that nothing may move."""
        mesh = self._mesh
        sizes = {"toi": 1, "body_toi": mesh.num_bodies, "vertex_toi": mesh.num_vertices}
        arrays = {name: self._full(count, 0.0, wp.float64) for name, count in sizes.items()}
        arrays["flags"] = self._full(1, 0, wp.int32)
        arrays["world_toi"], arrays["world_flags"] = arrays["toi"], arrays["flags"]
        if mesh.num_worlds > 1:
            arrays["world_toi"] = self._full(mesh.num_worlds, 0.0, wp.float64)
            arrays["world_flags"] = self._full(mesh.num_worlds, 0, wp.int32)
        contact_arrays = {name: self._empty(max_contacts, dtype) for name, dtype in CONTACT_DTYPES.items()}
        count = self._full(1, 0, wp.int32)
        contacts = DeviceContacts(count=count, **contact_arrays)
        return LaunchResult(**arrays, contacts=contacts, num_pairs=self._counts[:, 0], _step=self)

    def _order(self, primitives: PrimitiveSet) -> Order:
        if self._vertices is self._mesh._vertices_in_space:
            return rest_order(self.topology, primitives, self.execution)
        return order_at(self.topology, self._vertices, primitives, self.execution)

    def prepare(self, vertices_t0: DeviceArray, vertices_t1: DeviceArray, **options: Any) -> PreparedLaunch:
        """Check the arguments of a launch; see :meth:`DeviceInput.prepare`."""
        prepared, device = self._input.prepare(vertices_t0, vertices_t1, **options), self.topology.device
        if prepared.form not in self._recordings and device.is_capturing and device.is_cuda:
            raise RuntimeError("launch() was not called before the capture with arrays of these types and shapes")
        return prepared

    def start_of(self, prepared: PreparedLaunch) -> NDArray[np.float64]:
        """Start positions of all vertices on the host, static ones as they are laid out; this waits for the device."""
        values = prepared.vertices_t0.numpy() if prepared.copied_arrays is None else prepared.copied_arrays[0]
        rows = slice(None) if prepared.form.t0_by_vertex else self._mesh.moving_vertices
        start = self._vertices.copy()
        start[rows, : self._mesh.dimension] = values.reshape(-1, self._mesh.dimension)
        return start

    def launch(self, prepared: PreparedLaunch) -> None:
        """Launch a step. If this raises, the device step is in an inconsistent state and must not be used again."""
        form, start, end = prepared.form, prepared.vertices_t0, prepared.vertices_t1
        recording = self._recordings.get(form)
        if recording is None:
            recording = self._record(form, start, end)
            if len(self._recordings) == _MOST_RECORDINGS:
                self._recordings.pop(next(iter(self._recordings)))
            self._recordings[form] = recording
        recording.bind("vertices_t0", start)
        recording.bind("vertices_t1", end)
        recording.bind(SAFETY.name, prepared.safety)
        self._input.copy_in(prepared)
        recording.play(_PLAY)
        self._input.copy_out(prepared)
        self._last = prepared._replace(copied_arrays=None)

    def locate(self, contacts: Contacts, vertices_t0: ArrayLike | None, vertices_t1: ArrayLike | None) -> Contacts:
        """Contacts of a launch that know their mesh, and their points in a step between these positions.

        If these are None, they are what the arrays of the last launch hold now; this waits for the device.
        """
        if vertices_t0 is not None:
            frames: list[Any] = [v.numpy() if isinstance(v, wp.array) else v for v in (vertices_t0, vertices_t1)]
            start, end = self._mesh.frames(*frames)
        else:
            last = self.last_positions()
            if last is None:
                return located(contacts, self._mesh)
            start, end = (v.numpy().reshape(-1, 3) for v in last)
        return located(contacts, self._mesh, start, end, touch=self._touch_of_last(), radii=self._radii_of_last())

    def _radii_of_last(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """What the arrays of radii hold now."""
        if self._radius is None:
            return None
        radius, around = (array.numpy().copy() for array in self._both_radii)
        return radius, around

    def _touch_of_last(self) -> Touch | None:
        """What counts as touching, with the radii that the array has now; unknown of a line search, which lets part."""
        if self._last is None or self._last.form.line_search is not None:
            return None
        return self.touch(None if self._radius is None else self._radius.numpy().copy())

    def touch(self, radius: NDArray[np.float64] | None = None) -> Touch:
        """What counts as touching in strict calls, with the radii of vertices where they are asked for."""
        length_scale = length_scale_of(self._mesh, self._options)
        return Touch.of(self._options, length_scale, is_euclidean=self.norm.is_ball, radius=radius)

    def contact_points(self) -> wp.array:
        """Points of the contacts on the device, vec3d, at the positions that the arrays of the last launch hold.

        Raises:
            ValueError: If there was no launch.
        """
        last = self.last_positions()
        if last is None:
            raise ValueError("contacts.points are not known, as no launch has read positions; expected a launch before")
        return self.contact_arrays.points("points", last)

    def contact_points_at(self, vertices_t0: DeviceArray, vertices_t1: DeviceArray) -> wp.array:
        """Points of the contacts at given positions, those at the start of every vertex, as for a launch otherwise."""
        mesh, device = self._mesh, self.topology.device
        every = {mesh.num_vertices: "one a vertex"}
        moving = {len(mesh.moving_vertices): "one a moving vertex"}
        vertices_t0 = without_worlds(vertices_t0, "vertices_t0", mesh.rows_by_world, mesh.dimension)
        vertices_t1 = without_worlds(vertices_t1, "vertices_t1", mesh.rows_by_world, mesh.dimension)
        start = as_positions(vertices_t0, "vertices_t0", device, every, mesh.dimension)
        rows = every | moving if self._input.has_static else every
        end = as_positions(vertices_t1, "vertices_t1", device, rows, mesh.dimension)
        check_same_dtype(start, end, "vertices_t1")
        return self.contact_arrays.points(f"points_at with {start.dtype.__name__}", (start, end))

    def last_positions(self) -> tuple[wp.array, wp.array] | None:
        """Positions of all vertices in the last launch, in float64; None before the first."""
        return None if self._last is None else self.positions_of(self._last)

    def positions_of(self, prepared: PreparedLaunch) -> tuple[wp.array, wp.array]:
        """Positions of all vertices in a launch, in float64."""
        if self._input.is_copied(prepared.form):
            return self._input.start, self._input.end
        return prepared.vertices_t0, prepared.vertices_t1

    def _record(self, form: Form, vertices_t0: wp.array, vertices_t1: wp.array) -> Recording:
        """A recording of all launches."""
        recording = self._new_recording(vertices_t0=vertices_t0, vertices_t1=vertices_t1)
        with recording.section(_PLAY):
            self._record_form(recording, form)
        return recording

    def _new_recording(self, **values: Any) -> Recording:
        """A recording with these values of its slots."""
        return Recording(self.execution, {SAFETY.name: 1.0, **values})

    def _record_form(self, recording: Recording, form: Form) -> None:
        """Record all launches of a step."""
        self._record_reset(recording)
        self._record_pass(recording, form, self._active)

    def _record_pass(
        self,
        recording: Recording,
        form: Form,
        active: wp.array,
        *,
        is_first: bool = True,
        adapt: Callable[[Stages], Stages] = lambda stages: stages,
        **solved: Any,
    ) -> Stages:
        """Record the launches of a step, or of a pass of a line search, after the reset; returns their stages.

        The narrow phase is launched with what ``adapt`` makes of the stages.
        """
        stages = self._record_pairs(recording, form, active, is_first, self._near_bodies)
        self.record_narrow_phase(recording, adapt(stages), active, **solved)
        return stages

    def _record_reset(self, recording: Recording, kept_flags: int = 0, *, keeps_toi: bool = False) -> None:
        """Record the launch that resets the results of the last step, or of the last pass."""
        num_contacts, stop = self.result.contacts.count, self._flag.array
        self._stages.reset(recording, num_contacts, stop, kept_flags, keeps_toi=keeps_toi)

    def _record_most_found(self, recording: Recording) -> None:
        """Record, after the last pass, the launch that lets ``num_pairs`` be the most pairs of any pass."""
        recording.launch(kernels.tell_most_found, len(self._counts), inputs=[], outputs=[self._counts])

    @property
    def most_contacts(self) -> int:
        """The most contacts of a pass or slice of the last launch but its last; this waits for the device."""
        return int(self._counts.numpy()[1, MOST_LISTED])

    def _record_pairs(
        self,
        recording: Recording,
        form: Form,
        active: wp.array,
        is_first: bool = True,
        near: NearBodies | None = None,
    ) -> Stages:
        """Record the launches from the input to the pairs that the cull leaves; returns their stages.

        Of active bodies only those are searched that others come near, where these are to be found.

        Only the first pass of a line search reads the positions of static bodies, and may meet coordinates that are not
        finite; no later one changes either.
        """
        stages = self._stages.between(*self._input.slots(form))
        self._record_input(recording, form, stages, is_first)
        if near is None:
            self._record_search(recording, stages, active)
        else:
            active = near.record(recording, stages, active)
            with recording.only_if(near.is_any):
                self._record_search(recording, stages, active)
        return stages

    def _record_input(self, recording: Recording, form: Form, stages: Stages, is_first: bool) -> None:
        """Record the launches that read the input and, in the first pass, reset the vertices."""
        self._input.record(recording, form, stages, is_first)
        if is_first:
            stages.reset_vertices(recording)
            if self.static_trees:
                self._input.record_refresh(recording, self._stages, self.static_trees)

    def _record_search(self, recording: Recording, stages: Stages, active: wp.array) -> None:
        """Record the boxes of the bodies that are active, and the search."""
        self.record_boxes(recording, stages, active)
        stages.find_pairs(recording, self.tree_pairs, is_any_unlisted=self._is_any_unlisted)
