"""A step whose input and results stay on the device: launches of fixed sizes, recorded once and replayed."""

from collections.abc import Collection
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contact_place import located
from ccd_warp._contacts import Contacts
from ccd_warp._device_pairs import DeviceContacts
from ccd_warp._device_results import LaunchResult
from ccd_warp._engine.box_sets import Layout
from ccd_warp._engine.boxes import BROAD_PHASES
from ccd_warp._engine.contact_arrays import ContactArrays
from ccd_warp._engine.contacts import BYTES_PER_CONTACT, CONTACT_DTYPES, new_contact_list, new_minima
from ccd_warp._engine.grids import choose_cell
from ccd_warp._engine.lengths import half_up, length_scale_of
from ccd_warp._engine.planes import plane_query
from ccd_warp._engine.rest_order import order_at, rest_order
from ccd_warp._engine.scene import norm_of, possible_kinds
from ccd_warp._engine.search import KEY_BYTES
from ccd_warp._engine.stages import CANDIDATES_EACH, Stages, StepFields
from ccd_warp._engine.topology import MOST_COPIED, VERTEX_AABB_FLOATS, PrimitiveSet, Topology, choose_quantization
from ccd_warp._engine.trees import search_options, tree_pairs_of, trees_of
from ccd_warp._input.interop import as_positions, vector_of, without_worlds
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._runtime.lanes import narrow_phase_on
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.pair_queue import QUEUE_BYTES, new_queue
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._status import LaunchFlag, PairKind
from ccd_warp.kernels.boxes import thickness
from ccd_warp.kernels.narrow_phase.sinks import CONTACTS
from ccd_warp.kernels.pair.norm import is_ball
from ccd_warp.kernels.step import device_step
from ccd_warp.kernels.step.minima import ANY_OPEN, ANY_UNLISTED, NUM_COUNTS
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp._engine.device_hold import DeviceHold

MOST_PAIRS = 1 << 28
MOST_CONTACTS = np.iinfo(np.int32).max
_LEAST_CAPACITY = 1 << 12
_REALS = (np.float64, np.float32)
_NUM_AABBS = 2
_CHUNK = int(device_step.CHUNK)
_PLAY = "step"
# Flags that a pass of a line search keeps from earlier passes: later passes do not make up for what one missed, and
# what has been stopped and is struck stays so.
_KEPT_FLAGS = int(LaunchFlag.PAIRS_OVERFLOW | LaunchFlag.INVALID_INPUT | LaunchFlag.STATIC_MOVED | LaunchFlag.STRUCK)
_PER = {
    "scene": int(device_step.PER_SCENE),
    "world": int(device_step.PER_WORLD),
    "body": int(device_step.PER_BODY),
    "vertex": int(device_step.PER_VERTEX),
}
_SAFETY = Slot("safety")
# By how much the cells of spatial hashes are larger than those for boxes at rest, as the motions are not known yet.
_SPARE = 4.0
# Recordings that are kept, enough for the different kinds of calls in a loop.
_MOST_RECORDINGS = 16
# Rounds of a line search that shorten by toi; in later rounds vertices in contact stay where they are.
_ROUNDS_BY_TOI = 2
# The last rounds, in which all vertices of a world move by one fraction, or not at all.
_ROUNDS_BY_WORLD = 2
# Fraction of its gap by which a pair may move where the first of these rounds finds toi 0, because the gap may only be
# lost in the rounding of a long motion; vertices with toi 0 in the second round stay where they are. Of a half, a
# quarter and an eighth, only an eighth let all the draped cloths in float32 move.
_GAPS_MOVED = 0.125


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
        keys = num_kinds * KEY_BYTES * (1 + CANDIDATES_EACH if is_cuda else 1) + (QUEUE_BYTES if is_cuda else 0)
        return self.max_pairs * keys + self.max_contacts * BYTES_PER_CONTACT


@dataclass(frozen=True)
class LineSearch:
    """The kind of a line search, which determines its launches; ``safety`` is an argument of the launches."""

    per: str
    num_rounds: int  # of all passes; 0 where it is not used

    @staticmethod
    def of(per: str, num_rounds: int) -> "LineSearch":
        """The line search of :meth:`ccd_warp.CollisionPipeline.launch_line_search`."""
        return LineSearch(per, 0 if per in ("scene", "world") else num_rounds)

    def stages(self) -> list[tuple[str, Any]]:
        """For each pass, whose toi then limits the motion of a vertex, and the fraction of that toi it may move."""
        if self.per in ("scene", "world"):
            return [(self.per, _SAFETY)] * _ROUNDS_BY_TOI + [("world", 0.0)]
        # Stopped vertices may stop others in turn; one fraction for the world settles the contacts that remain.
        num_own = self.num_rounds - _ROUNDS_BY_WORLD
        by_toi = min(_ROUNDS_BY_TOI, num_own)
        shares = [_SAFETY] * by_toi + [0.0] * (num_own - by_toi)
        return [*((self.per, share) for share in shares), ("world", _SAFETY), ("world", 0.0)]


class _Form(NamedTuple):
    """What a recording depends on besides the arrays."""

    real: Any
    t0_by_vertex: bool
    t1_by_vertex: bool
    is_displacement: bool = False
    line_search: LineSearch | None = None


class PreparedLaunch(NamedTuple):
    """The checked arguments of a launch.

    Attributes:
        form: The form of the launch, which selects the recording.
        vertices_t0: Start positions.
        vertices_t1: End positions, or displacements.
        safety: Fraction of a toi that a line search keeps.
        places_static: Whether it sets the positions of static bodies.
        given: The arrays of NumPy whose values the launch copies to ``vertices_t0`` and ``vertices_t1``; None where
            these are the caller's.
    """

    form: _Form
    vertices_t0: wp.array
    vertices_t1: wp.array
    safety: float
    places_static: bool
    given: list[NDArray[Any]] | None = None


class DeviceStep:
    """All arrays to which a step on the device writes, and its launches.

    Attributes:
        result: The arrays of the result.
        contact_arrays: What its contacts are asked for beside their own arrays.
    """

    _has_narrow_phase = True

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
        self.topology = topology
        self._mesh = mesh = topology.mesh
        self._has_static = len(mesh.moving_vertices) < mesh.num_vertices
        _ = topology.corners, topology.collision_filter, topology.body_kinematic  # computed now, not during a capture
        self._options = options
        self._flag = StopFlag(topology.device)
        self._execution = execution = Execution(topology.device, options.threads, self._flag)
        self._chunk = 1 if execution.is_cuda else _CHUNK
        self._vertices = vertices
        length_scale = length_scale_of(mesh, options)
        separation = options.separation(length_scale)
        inflation = half_up(separation)
        norm = norm_of(mesh, options, may_change=True)
        self._radius = radius
        radii = topology.radius, topology.box_radius
        if radius is not None:
            _ = topology.neighbours
            radii = radius, wp.clone(topology.box_radius)
            self._is_thicker = self._full(1, 0, wp.int32)  # written where radii of moving vertices change, never read
        self._box_radius = radii[1]
        self._active, self._touched = (self._full(mesh.num_bodies, 1, wp.int32) for _ in range(2))
        self._is_moved, self._is_any_touched = (self._full(1, 0, wp.int32) for _ in range(2))
        self._counts: wp.array = wp.zeros((len(PairKind), NUM_COUNTS), dtype=wp.int64, device=topology.device)
        self._is_open = _low_half(self._counts, int(ANY_OPEN))
        self._is_any_unlisted = _low_half(self._counts, int(ANY_UNLISTED))
        self._start = self._end = self._empty(0, wp.vec3d)
        self._last: PreparedLaunch | None = None
        self._own_arrays: dict[tuple[str, str, int], tuple[wp.array, NDArray[Any]]] = {}
        if self._has_static:
            self._place_static(static_positions)
        quantization = choose_quantization(topology, (vertices, vertices), _NUM_AABBS)
        broad_phase = BROAD_PHASES[options.broad_phase]
        sought = topology, possible_kinds(mesh, options), mesh._is_free_alone
        tree_pairs = broad_phase.searches(tree_pairs_of(*sought, {}, broad_phase))
        trees = trees_of(tree_pairs)
        self._static_trees = [tree for tree in trees if tree.primitives.is_static]
        self._moving_trees = [tree for tree in trees if not tree.primitives.is_static]
        layout = Layout(
            _NUM_AABBS,
            lambda _, n, dtype: self._empty(n, dtype),
            self._order,
            lambda: choose_cell(topology, (vertices, vertices), quantization, spare=_SPARE),
        )
        for tree in trees:
            tree.lay_out(layout)
        self._recordings: dict[_Form, Recording] = {}  # in the order in which they were made
        keeps_distance = separation > 0.0 or radius is not None
        self._may_hold = options.holds and keeps_distance and self._has_narrow_phase
        self._hold: DeviceHold | None = None  # made for the first line search
        self.result = self._new_result(capacities.max_contacts)
        result = self.result
        self.contact_arrays = ContactArrays(topology, execution, vars(result.contacts))
        minima = new_minima(
            topology,
            vertex=result.vertex_toi,
            body=result.body_toi,
            world=result.world_toi,
            scene=result.toi,
            world_flags=result.world_flags,
            flags=result.flags,
        )
        kinds = dict.fromkeys(tree_pair.kind for tree_pair in tree_pairs)
        has_planes = PairKind.VERTEX_PLANE in possible_kinds(mesh, options)
        _ = topology.planes if has_planes else None  # made now, not in a capture
        max_candidates = CANDIDATES_EACH * capacities.max_pairs if execution.is_cuda else 0
        self._stages = Stages(
            topology,
            tree_pairs,
            _NUM_AABBS,
            narrow_phase_on(topology.device, options.real, norm) if self._has_narrow_phase else None,
            StepFields(self._counts, self._start, self._end, minima, new_contact_list(vars(result.contacts))),
            vertex_aabbs=self._empty(mesh.num_vertices * _NUM_AABBS * VERTEX_AABB_FLOATS, wp.float32),
            boxes={tree.name: tree.structs for tree in trees},
            keys={kind: self._empty(capacities.max_pairs, wp.int64) for kind in kinds},
            candidates={kind: self._empty(max_candidates, wp.int64) for kind in kinds},
            quantization=quantization.packed,
            t_end=options.t_max,
            inflation=inflation,
            box_radius=self._box_radius,
            is_thick=radius is not None,
            search_options=search_options(options.t_max, inflation, separation, norm, self._flag, radii),
            options=options.for_kernel(length_scale, stop=self._flag.array, radius=radii[0]),
            queue=new_queue(capacities.max_pairs, topology.device)
            if execution.is_cuda and self._has_narrow_phase
            else None,
            plane_query=self._plane_query() if has_planes else None,
        )
        if tree_pairs and self._has_narrow_phase:
            self._stages.load(execution, CONTACTS)
        if self._static_trees:
            self._stages.fill_vertex_aabbs(execution, topology.static_vertices, self._active)
            self._stages.fill_boxes(execution, self._static_trees)

    def _empty(self, count: int, dtype: Any) -> wp.array:
        return wp.empty(count, dtype=dtype, device=self.topology.device)

    def _full(self, count: int, value: Any, dtype: Any) -> wp.array:
        return wp.full(count, value=value, dtype=dtype, device=self.topology.device)

    def _place_static(self, static_positions: NDArray[np.float64]) -> None:
        """Allocate float64 positions, with the static bodies at the given ones."""
        start: wp.array = wp.array(static_positions, dtype=wp.vec3d, device=self.topology.device)
        self._start, self._end = start, wp.clone(start)

    def static_positions(self) -> NDArray[np.float64]:
        """Positions whose static rows are the current positions of these bodies; this waits for the device."""
        return self._start.numpy().copy() if self._has_static else self._vertices

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

    def _order(self, primitives: PrimitiveSet) -> tuple[wp.array, wp.array]:
        if self._vertices is self._mesh._vertices_in_space:
            return rest_order(self.topology, primitives, self._execution)
        return order_at(self.topology, self._vertices, primitives, self._execution)

    def prepare(
        self,
        vertices_t0: Any,
        vertices_t1: Any,
        *,
        name_t0: str = "vertices_t0",
        name_t1: str = "vertices_t1",
        is_displacement: bool = False,
        line_search: LineSearch | None = None,
        safety: float = 1.0,
    ) -> "PreparedLaunch":
        """Check the arguments of a launch, which are those of :meth:`ccd_warp.CollisionPipeline.launch`."""
        mesh, device = self._mesh, self.topology.device
        rows = {mesh.num_vertices: "one a vertex"}
        if self._has_static:
            rows[len(mesh.moving_vertices)] = "one a moving vertex"
        given = [vertices_t0, vertices_t1]
        is_copied = self._may_be_copied(given, rows)
        if is_copied:
            start, end = (self._own_array(name, values)[0] for name, values in zip(("t0", "t1"), given, strict=True))
        else:
            start = as_positions(vertices_t0, name_t0, device, rows, mesh.dimension)
            end = as_positions(vertices_t1, name_t1, device, rows, mesh.dimension)
            _check_same_dtype(start, end, name_t1)
        real = wp.float64 if start.dtype in (wp.vec2d, wp.vec3d) else wp.float32
        count = mesh.num_vertices
        form = _Form(real, len(start) == count, len(end) == count, is_displacement, line_search)
        if form not in self._recordings and device.is_capturing and device.is_cuda:
            raise RuntimeError("launch() was not called before the capture with arrays of these types and shapes")
        places_static = form.t0_by_vertex and self._has_static
        return PreparedLaunch(form, start, end, safety, places_static, given if is_copied else None)

    def _may_be_copied(self, given: list[Any], rows: Collection[int]) -> bool:
        """Whether the values of two arrays are copied: of NumPy and few, which costs less than to bind the arrays.

        A graph reads the caller's arrays, whatever they hold when it is replayed.
        """
        device, dimension = self.topology.device, self._mesh.dimension
        if device.is_cuda or not all(type(values) is np.ndarray for values in given) or device.is_capturing:
            return False
        return given[0].dtype == given[1].dtype and all(
            values.dtype in _REALS
            and values.ndim == 2
            and values.shape[1] == dimension
            and values.shape[0] in rows
            and values.shape[0] <= MOST_COPIED
            and values.flags.c_contiguous
            for values in given
        )

    def _own_array(self, name: str, like: NDArray[Any]) -> tuple[wp.array, NDArray[Any]]:
        """An array of the step's own with the type and the shape of another, on the device and on the host."""
        key = (name, like.dtype.char, len(like))
        if key not in self._own_arrays:
            host = np.empty_like(like)
            self._own_arrays[key] = wp.array(host, dtype=vector_of(like), device="cpu", copy=False), host
        return self._own_arrays[key]

    def launch(self, prepared: "PreparedLaunch") -> None:
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
        recording.bind(_SAFETY.name, prepared.safety)
        own: list[NDArray[Any]] = []
        if prepared.given is not None:
            own = [self._own_array(name, values)[1] for name, values in zip(("t0", "t1"), prepared.given, strict=True)]
            for host, values in zip(own, prepared.given, strict=True):
                host[...] = values
        recording.play(_PLAY)
        if prepared.given is not None and form.line_search is not None:
            prepared.given[1][...] = own[1]
        self._last = prepared._replace(given=None)

    def locate(self, contacts: Contacts, vertices_t0: Any, vertices_t1: Any) -> Contacts:
        """Contacts of a launch that know their mesh, and their points in a step between these positions.

        If these are None, they are what the arrays of the last launch hold now; this waits for the device.
        """
        if vertices_t0 is not None:
            given = (v.numpy() if isinstance(v, wp.array) else v for v in (vertices_t0, vertices_t1))
            return located(contacts, self._mesh, *self._mesh.frames(*given))
        last = self._last_positions()
        if last is None:
            return located(contacts, self._mesh)
        return located(contacts, self._mesh, *(v.numpy().reshape(-1, 3) for v in last))

    def contact_points(self) -> wp.array:
        """Points of the contacts on the device, vec3d, at the positions that the arrays of the last launch hold.

        Raises:
            ValueError: If there was no launch.
        """
        last = self._last_positions()
        if last is None:
            raise ValueError("contacts.points are not known, as no launch has read positions; expected a launch before")
        return self.contact_arrays.points("points", last)

    def contact_points_at(self, vertices_t0: Any, vertices_t1: Any) -> wp.array:
        """Points of the contacts at given positions, those at the start of every vertex, as for a launch otherwise."""
        mesh, device = self._mesh, self.topology.device
        every = {mesh.num_vertices: "one a vertex"}
        moving = {len(mesh.moving_vertices): "one a moving vertex"}
        vertices_t0 = without_worlds(vertices_t0, "vertices_t0", mesh.rows_by_world, mesh.dimension)
        vertices_t1 = without_worlds(vertices_t1, "vertices_t1", mesh.rows_by_world, mesh.dimension)
        start = as_positions(vertices_t0, "vertices_t0", device, every, mesh.dimension)
        rows = every | moving if self._has_static else every
        end = as_positions(vertices_t1, "vertices_t1", device, rows, mesh.dimension)
        _check_same_dtype(start, end, "vertices_t1")
        return self.contact_arrays.points(f"points_at with {start.dtype.__name__}", (start, end))

    def _last_positions(self) -> tuple[wp.array, wp.array] | None:
        """Positions of all vertices in the last launch, in float64; None before the first."""
        if self._last is None:
            return None
        if self._is_copied(self._last.form):
            return self._start, self._end
        return self._last.vertices_t0, self._last.vertices_t1

    def _record(self, form: _Form, vertices_t0: wp.array, vertices_t1: wp.array) -> Recording:
        """All launches of a step, or of all passes of a line search."""
        recording = Recording(
            self._execution, {"vertices_t0": vertices_t0, "vertices_t1": vertices_t1, _SAFETY.name: 1.0}
        )
        with recording.section(_PLAY):
            if form.line_search is None:
                self._record_reset(recording)
                self._record_step(recording, form)
            else:
                self._record_line_search(recording, form, form.line_search)
        return recording

    def _record_line_search(self, recording: Recording, form: _Form, line_search: LineSearch) -> None:
        """Record the launches of all passes of a line search."""
        topology = self.topology
        num_bodies = self._mesh.num_bodies
        by_scene = int(line_search.per == "scene" or not _worlds_are_apart(self._mesh))
        touched = [self._touched, self._is_any_touched]
        recording.launch(device_step.set_active, num_bodies, inputs=[1], outputs=touched)
        if self._may_hold and self._hold is None:
            from ccd_warp._engine.device_hold import DeviceHold  # few programs need it

            self._hold = DeviceHold(
                topology, self._options, self._stages, self.result.contacts, self._flag, self._radius
            )
        stages = line_search.stages()
        has_kinematic = bool(self._mesh.kinematic.any())
        for number, (per, share) in enumerate(stages):
            # only if the next pass has the same `per`: a failure then stops the same bodies or vertices alone
            may_cut = number == 0 and stages[1][0] == per
            gaps_moved = _GAPS_MOVED if may_cut else 0.0
            if number == 0:
                self._record_reset(recording)
                self._record_first_pass(recording, form, by_scene, gaps_moved)
            else:
                self._record_reset_of_pass(recording)
            # where nothing was touched in the pass before, there is nothing else to do
            with recording.only_if(self._is_any_touched) if number > 0 else nullcontext():
                if number > 0:
                    self._record_step(recording, form, is_first=False)
                if number < len(stages) - 1 or has_kinematic:
                    self._record_touched(recording, by_scene)
                recording.launch(
                    specialised("step.input_rows", real=form.real, dimension=self._mesh.dimension).shorten,
                    len(topology.moving_vertices),
                    inputs=[
                        topology.moving_vertices,
                        Slot("vertices_t0"),
                        int(form.t0_by_vertex),
                        int(form.t1_by_vertex),
                        _PER[per],
                        share,
                        self._stages.step.minima,
                    ],
                    outputs=[Slot("vertices_t1")],
                )
        if has_kinematic:  # which may strike what the last pass has stopped
            self._record_reset(recording, _KEPT_FLAGS, keeps_toi=True)
            with recording.only_if(self._is_any_touched):
                self._record_step(recording, form, is_first=False)

    def _record_first_pass(self, recording: Recording, form: _Form, by_scene: int, gaps_moved: float) -> None:
        """Record the first pass of a line search, and another one for what starts within its distance."""
        hold = self._hold
        if hold is None:
            self._record_step(recording, form, gaps_moved=gaps_moved)
            return
        hold.record_begin(recording)
        stages = self._record_step(recording, form)
        hold.record_near(recording, stages)
        with recording.only_if(hold.is_near):
            self._record_touched(recording, by_scene)
            self._record_reset_of_pass(recording)
            hold.record_holds(recording, stages, lambda of_start, near: self._record_search(recording, of_start, near))
            self._record_reset_of_pass(recording)
            self._record_step(recording, form, is_first=False, gaps_moved=gaps_moved)

    def _record_touched(self, recording: Recording, by_scene: int) -> None:
        """Record which bodies are searched again: a world found free stays so until something in it is shortened."""
        moving, touched = self.topology.moving_vertices, [self._touched, self._is_any_touched]
        recording.launch(device_step.set_active, self._mesh.num_bodies, inputs=[0], outputs=touched)
        inputs = [moving, by_scene, self._stages.step.minima]
        recording.launch(device_step.keep_touched, len(moving), inputs=inputs, outputs=touched)

    def _record_reset_of_pass(self, recording: Recording) -> None:
        """Record the reset before a pass that is not the first."""
        self._record_reset(recording, _KEPT_FLAGS)
        self._stages.reset_vertices(recording)

    def _record_reset(self, recording: Recording, kept_flags: int = 0, *, keeps_toi: bool = False) -> None:
        """Record the launch that resets the results of the last step, or of the last pass."""
        num_contacts, stop = self.result.contacts.count, self._flag.array
        self._stages.reset(recording, num_contacts, stop, kept_flags, keeps_toi=keeps_toi)

    def _record_step(
        self, recording: Recording, form: _Form, *, is_first: bool = True, gaps_moved: float = 0.0
    ) -> Stages:
        """Record the launches of one pass over a step after the reset; returns their stages.

        Only the first pass reads the positions of static bodies, and may meet coordinates that are not finite; no later
        one changes either.
        """
        is_line_search = form.line_search is not None
        stages = self._record_pairs(recording, form, is_first)
        if is_line_search and self._options.holds:
            stages = self._with_hold(stages)
        if stages.plane_query is not None:
            active = self._touched if is_line_search else self._active
            stages.meet_planes(recording, CONTACTS, active, only_moving=is_line_search, gaps_moved=gaps_moved)
        stages.solve(recording, CONTACTS, is_second=False, only_moving=is_line_search, gaps_moved=gaps_moved)
        with recording.only_if(self._is_open):
            stages.solve(recording, CONTACTS, is_second=True, only_moving=is_line_search, gaps_moved=gaps_moved)
        return stages

    def _with_hold(self, stages: Stages) -> Stages:
        """The stages of a line search in which what starts within its distance may part and slide."""
        if stages.plane_query is not None:
            stages = replace(stages, plane_query=self._plane_query(holds=True))
        return stages if self._hold is None else self._hold.stages(stages)

    def _plane_query(self, *, holds: bool = False) -> Any:
        """What vertices and planes are asked for."""
        norm = norm_of(self._mesh, self._options, may_change=True)
        length_scale = length_scale_of(self._mesh, self._options)
        return plane_query(self._options, length_scale, is_euclidean=is_ball(norm), holds=holds)

    def _record_pairs(self, recording: Recording, form: _Form, is_first: bool = True) -> Stages:
        """Record the launches from the input to the pairs that the cull leaves; returns their stages."""
        mesh = self._mesh
        start: Any = Slot("vertices_t0")
        end: Any = Slot("vertices_t1")
        is_copied = self._is_copied(form)
        if is_copied:
            if len(self._start) == 0:
                self._start, self._end = (self._empty(mesh.num_vertices, wp.vec3d) for _ in range(2))
            start, end = self._start, self._end
        stages = self._stages.between(start, end)
        self._record_input(recording, form, stages, is_copied, is_first)
        self._record_search(recording, stages, self._active if form.line_search is None else self._touched)
        return stages

    def _record_search(self, recording: Recording, stages: Stages, active: wp.array) -> None:
        """Record the boxes of the bodies that are active, and the search."""
        if self._moving_trees:
            stages.fill_vertex_aabbs(recording, self.topology.moving_vertices, active)
        stages.fill_boxes(recording, self._moving_trees)
        with recording.at_once():
            for tree_pair in stages.tree_pairs:
                stages.search(recording, tree_pair, marks_overflow=True)
        if recording.is_cuda:
            for kind in stages.kinds:
                stages.cull(recording, kind, marks_overflow=True, only_if_complete=True)
            with recording.only_if(self._is_any_unlisted):
                for tree_pair in stages.tree_pairs:
                    stages.cull_the_rest(recording, tree_pair, marks_overflow=True)

    def _record_input(self, recording: Recording, form: _Form, stages: Stages, is_copied: bool, is_first: bool) -> None:
        """Record the launches that read positions and, in the first pass, reset the vertices."""
        topology, minima = self.topology, stages.step.minima
        read = specialised("step.input_rows", real=form.real, dimension=self._mesh.dimension)
        if is_first and form.t0_by_vertex and self._has_static:
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
                outputs=[self._start, self._end, self._is_moved, minima],
                grain=64,
            )
        elif is_first and form.t1_by_vertex and self._has_static:
            recording.launch(
                read.check_static,
                -(-len(topology.static_vertices) // self._chunk),
                inputs=[
                    topology.static_vertices,
                    Slot("vertices_t1"),
                    int(form.is_displacement),
                    self._chunk,
                    self._start,
                ],
                outputs=[minima],
                grain=64,
            )
        by_vertex = [int(form.t0_by_vertex), int(form.t1_by_vertex)]
        recording.launch(
            read.read_moving,
            len(topology.moving_vertices),
            inputs=[
                topology.moving_vertices,
                Slot("vertices_t0"),
                Slot("vertices_t1"),
                *by_vertex,
                int(form.is_displacement),
                int(is_copied),
            ],
            outputs=[self._start, self._end, minima],
        )
        if is_first and self._radius is not None:
            self._record_radius(recording, minima)
        if is_first:
            stages.reset_vertices(recording)
        if is_first and self._static_trees:
            # also if static bodies are not read here: an earlier launch may have been interrupted after it read them
            with recording.only_if(self._is_moved):
                self._record_refresh(recording)

    def _record_radius(self, recording: Recording, minima: Any) -> None:
        """Record the launches that read the radii, which may have changed, and mark static boxes that then do."""
        topology = self.topology
        for vertices, is_changed in (
            (topology.moving_vertices, self._is_thicker),
            (topology.static_vertices, self._is_moved),
        ):
            if len(vertices):
                recording.launch(
                    thickness.fill_box_radius,
                    len(vertices),
                    inputs=[vertices, self._radius, *topology.neighbours],
                    outputs=[self._box_radius, is_changed, minima],
                )

    def _record_refresh(self, recording: Recording) -> None:
        """Record the launches that recompute the boxes of static bodies, which run only if these have moved."""
        topology, stages = self.topology, self._stages
        recording.launch(
            device_step.refresh_vertex_aabbs,
            -(-len(topology.static_vertices) // self._chunk),
            inputs=[
                self._is_moved,
                topology.static_vertices,
                topology.worlds,
                self._start,
                stages.inflation,
                stages.box_radius,
                stages.quantization,
                _NUM_AABBS,
                self._chunk,
            ],
            outputs=[stages.vertex_aabbs],
            grain=64,
        )
        stages.fill_boxes(recording, self._static_trees, self._is_moved)
        recording.launch(device_step.settle, 1, inputs=[], outputs=[self._is_moved])

    def _is_copied(self, form: _Form) -> bool:
        """Whether a launch reads positions into arrays of its own."""
        is_in_plane = self._mesh.dimension == 2
        return form.real is not wp.float64 or form.is_displacement or self._has_static or is_in_plane


def _low_half(counts: wp.array, column: int) -> wp.array:
    """The low half of a count in the first row, int32, shape [1]: a flag, as there are fewer than 2³² pairs."""
    place = counts.ptr + column * counts.strides[1]  # the bytes of a number are in ascending order on all devices
    return wp.array(ptr=place, dtype=wp.int32, shape=1, device=counts.device)


def _check_same_dtype(start: wp.array, end: wp.array, name_t1: str) -> None:
    if start.dtype is not end.dtype:
        raise ValueError(f"{name_t1} has dtype {end.dtype.__name__}; expected {start.dtype.__name__} like vertices_t0")


def _worlds_are_apart(mesh: CollisionMesh) -> bool:
    """Whether no body has vertices in more than one world."""
    within = np.diff(mesh.vertex_body) == 0
    return not (within & (np.diff(mesh.vertex_world) != 0)).any()
