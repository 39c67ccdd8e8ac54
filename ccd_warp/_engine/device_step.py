"""A step whose input and results stay on the device: launches of fixed sizes, recorded once and replayed."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contact_place import located
from ccd_warp._engine.boxes import Tree, fill_tree, new_tree
from ccd_warp._engine.contacts import CONTACT_DTYPES, new_contact_list, new_minima
from ccd_warp._engine.scene import half_up, moves_alone, possible_kinds
from ccd_warp._engine.search import LONG_PART, LONG_SEARCH, TreePair, search_range, tree_pairs_of
from ccd_warp._engine.topology import CORNER_ARRAYS, VERTEX_AABB_FLOATS, PrimitiveSet, Topology, choose_quantization
from ccd_warp._input.interop import as_positions
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Contacts, DeviceContacts, LaunchResult
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._status import LaunchFlag, PairKind
from ccd_warp.kernels import box_tree, device_step
from ccd_warp.kernels.minima import FOUND, OPEN
from ccd_warp.kernels.narrow_phase import make_narrow_phase
from ccd_warp.kernels.pair_search import CULL, NUM_COUNTS, make_pair_search

MOST_PAIRS = 1 << 28
MOST_CONTACTS = np.iinfo(np.int32).max
_LEAST_CAPACITY = 1 << 12
_NUM_AABBS = 2
_CHUNK = int(device_step.CHUNK)
# Largest number of CUDA threads that share the pairs of a kind, and parts of a search for each CPU thread.
_MOST_SOLVERS = 1 << 17
_PARTS_PER_THREAD = 8
_SMALLEST_SEARCH = 64
# Flags that a pass of a line search keeps from earlier passes: later passes do not make up for what one missed.
_KEPT_FLAGS = int(LaunchFlag.PAIRS_OVERFLOW | LaunchFlag.INVALID_INPUT)
# Number of vertices from which on threads for the narrow phase save more than waking them costs.
_WORTH_THREADS = 1 << 11
_PER = {
    "scene": int(device_step.PER_SCENE),
    "world": int(device_step.PER_WORLD),
    "body": int(device_step.PER_BODY),
    "vertex": int(device_step.PER_VERTEX),
}
_SAFETY = Slot("safety")
# In place of a number of pairs: the number that the device finds.
_AS_FOUND = -1
# Recordings that are kept, enough for the different kinds of calls in a loop.
_MOST_RECORDINGS = 16
# Rounds of a line search that shorten by toi; in later rounds vertices in contact stay where they are.
_ROUNDS_BY_TOI = 2
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


@dataclass(frozen=True)
class LineSearch:
    """The kind of a line search, which determines its launches; ``safety`` is an argument of the launches."""

    per: str
    num_rounds: int  # 0 where it is not used

    @staticmethod
    def of(per: str, num_rounds: int) -> "LineSearch":
        """The line search of :meth:`ccd_warp.CollisionPipeline.launch_line_search`."""
        return LineSearch(per, 0 if per in ("scene", "world") else num_rounds)

    def stages(self) -> list[tuple[str, Any]]:
        """For each pass, whose toi then limits the motion of a vertex, and the fraction of that toi it may move."""
        if self.per in ("scene", "world"):
            return [(self.per, _SAFETY)] * _ROUNDS_BY_TOI + [("world", 0.0)]
        # Stopped vertices may stop others in turn; one fraction for the world settles the contacts that remain.
        by_toi = min(_ROUNDS_BY_TOI, self.num_rounds)
        shares = [_SAFETY] * by_toi + [0.0] * (self.num_rounds - by_toi)
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
    """

    form: _Form
    vertices_t0: wp.array
    vertices_t1: wp.array
    safety: float
    places_static: bool


class DeviceStep:
    """All arrays to which a step on the device writes, and its launches.

    Attributes:
        result: The arrays of the result.
    """

    def __init__(
        self,
        topology: Topology,
        options: Options,
        capacities: Capacities,
        vertices: NDArray[np.float64],
        static_positions: NDArray[np.float64],
    ) -> None:
        """Allocate everything, with trees for ``vertices`` and the static bodies of ``static_positions``."""
        self.topology = topology
        self._mesh = mesh = topology.mesh
        self._has_static = bool(mesh.static.any())
        _ = topology.corners, topology.collision_filter  # computed now, not during a capture
        self._options = options
        self._flag = StopFlag(topology.device)
        self._execution = Execution(topology.device, options.threads, self._flag)
        self._vertices = vertices
        self._length_scale = options.length_scale or _longest_side(vertices)
        self._separation = options.separation(self._length_scale)
        self._inflation = half_up(self._separation)
        self._quantization = choose_quantization(mesh, vertices, vertices, _NUM_AABBS)
        self._vertex_aabbs = self._empty(mesh.num_vertices * _NUM_AABBS * VERTEX_AABB_FLOATS, wp.float32)
        self._active, self._touched = (self._full(mesh.num_bodies, 1, wp.int32) for _ in range(2))
        self._is_moved = self._full(1, 0, wp.int32)
        self._counts: wp.array = wp.zeros((len(PairKind), NUM_COUNTS), dtype=wp.int64, device=topology.device)
        self._trees: dict[str, Tree] = {}
        self._start = self._end = self._empty(0, wp.vec3d)
        self._last: PreparedLaunch | None = None
        if self._has_static:
            self._place_static(static_positions)
        self._tree_pairs = tree_pairs_of(self, possible_kinds(mesh, options), moves_alone(mesh))
        self._keys = {
            kind: self._empty(capacities.max_pairs, wp.int64)
            for kind in {tree_pair.kind for tree_pair in self._tree_pairs}
        }
        self._recordings: dict[_Form, Recording] = {}  # in the order in which they were made
        self.result = self._new_result(capacities.max_contacts)
        result = self.result
        self._minima = new_minima(
            topology,
            vertex=result.vertex_toi,
            body=result.body_toi,
            world=result.world_toi,
            scene=result.toi,
            world_flags=result.world_flags,
            flags=result.flags,
        )
        self._contacts = new_contact_list(vars(result.contacts))

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

    def build(self, wanted: list[tuple[str, bool]]) -> None:
        """Lay out trees, given by the kind of primitives and whether they are static, and fill the static ones."""
        sets = [self.topology.primitives(*end) for end in dict.fromkeys(wanted)]
        if any(primitives.is_static for primitives in sets):
            self._execution.launch(
                box_tree.fill_vertex_aabbs,
                len(self.topology.static_vertices),
                inputs=self._vertex_aabb_inputs(
                    self.topology.static_vertices, self._active, self._start, self._end, 1.0
                ),
                outputs=[self._vertex_aabbs],
            )
        for primitives in sets:
            tree = new_tree(primitives, _NUM_AABBS, lambda n: self._empty(n, wp.float32))
            tree.arrays.primitive, tree.arrays.corners = self._order(primitives)
            if primitives.is_static:
                fill_tree(tree, self._vertex_aabbs, self._execution)
            self._trees[primitives.name] = tree

    def _order(self, primitives: PrimitiveSet) -> tuple[wp.array, wp.array]:
        if self._vertices is self._mesh.vertices:
            return self.topology.rest_order(primitives, self._execution)
        return self.topology.order_at(self._vertices, primitives, self._execution)

    def tree(self, kind: str, is_static: bool) -> Tree | None:
        """The tree of the moving or static primitives of a kind; None if there are none."""
        return self._trees.get(self.topology.primitives(kind, is_static).name)

    def may_meet(self, a: Tree, b: Tree) -> bool:
        """Always true: only the device could tell."""
        return True

    def _vertex_aabb_inputs(self, vertices: wp.array, active: wp.array, start: Any, end: Any, t_end: float) -> list:
        of_vertices = self.topology.of_vertices(active)
        return [vertices, *of_vertices, start, end, t_end, self._inflation, self._quantization, _NUM_AABBS]

    def prepare(
        self,
        vertices_t0: Any,
        vertices_t1: Any,
        *,
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
        start = as_positions(vertices_t0, "vertices_t0", device, rows)
        end = as_positions(vertices_t1, name_t1, device, rows)
        if start.dtype is not end.dtype:
            raise ValueError(
                f"{name_t1} has dtype {end.dtype.__name__}; expected {start.dtype.__name__} like vertices_t0"
            )
        real = wp.float64 if start.dtype is wp.vec3d else wp.float32
        count = mesh.num_vertices
        form = _Form(real, len(start) == count, len(end) == count, is_displacement, line_search)
        if form not in self._recordings and device.is_capturing and device.is_cuda:
            raise RuntimeError("launch() was not called before the capture with arrays of these types and shapes")
        return PreparedLaunch(form, start, end, safety, form.t0_by_vertex and self._has_static)

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
        recording.play()
        self._last = prepared

    def locate(self, contacts: Contacts, vertices_t0: Any, vertices_t1: Any) -> Contacts:
        """Contacts of a launch that know their mesh, and their points in a step between these positions.

        If these are None, they are what the arrays of the last launch hold now; this waits for the device.
        """
        if vertices_t0 is not None:
            given = (v.numpy() if isinstance(v, wp.array) else v for v in (vertices_t0, vertices_t1))
            return located(contacts, self._mesh, *self._mesh.frames(*given))
        if self._last is None:
            return located(contacts, self._mesh)
        start, end = self._last.vertices_t0, self._last.vertices_t1
        if _is_copied(self._last.form, self._has_static):
            start, end = self._start, self._end
        return located(contacts, self._mesh, start.numpy().reshape(-1, 3), end.numpy().reshape(-1, 3))

    def _record(self, form: _Form, vertices_t0: wp.array, vertices_t1: wp.array) -> Recording:
        """All launches of a step, or of all passes of a line search."""
        recording = Recording(
            self._execution, {"vertices_t0": vertices_t0, "vertices_t1": vertices_t1, _SAFETY.name: 1.0}
        )
        if form.line_search is None:
            self._record_step(recording, form)
            return recording
        topology = self.topology
        num_bodies = self._mesh.num_bodies
        by_scene = int(form.line_search.per == "scene" or not _worlds_are_apart(self._mesh))
        recording.launch(device_step.set_active, num_bodies, inputs=[1], outputs=[self._touched])
        stages = form.line_search.stages()
        for number, (per, share) in enumerate(stages):
            # only where the next pass, if this was in vain, stops the same bodies or vertices and not their world
            may_cut = number == 0 and stages[1][0] == per
            self._record_step(recording, form, _KEPT_FLAGS if number > 0 else 0, _GAPS_MOVED if may_cut else 0.0)
            if number < len(stages) - 1:
                # a world found free of contacts stays so until something in it is shortened
                recording.launch(device_step.set_active, num_bodies, inputs=[0], outputs=[self._touched])
                recording.launch(
                    device_step.keep_touched,
                    len(topology.moving_vertices),
                    inputs=[topology.moving_vertices, by_scene, self._minima],
                    outputs=[self._touched],
                )
            recording.launch(
                device_step.make_input(form.real).shorten,
                len(topology.moving_vertices),
                inputs=[
                    topology.moving_vertices,
                    Slot("vertices_t0"),
                    int(form.t0_by_vertex),
                    int(form.t1_by_vertex),
                    _PER[per],
                    share,
                    self._minima,
                ],
                outputs=[Slot("vertices_t1")],
            )
        return recording

    def _record_step(self, recording: Recording, form: _Form, kept_flags: int = 0, gaps_moved: float = 0.0) -> None:
        """Record the launches of one pass over a step."""
        mesh, topology = self._mesh, self.topology
        start: Any = Slot("vertices_t0")
        end: Any = Slot("vertices_t1")
        is_copied = _is_copied(form, self._has_static)
        if is_copied:
            if len(self._start) == 0:
                self._start, self._end = (self._empty(mesh.num_vertices, wp.vec3d) for _ in range(2))
            start, end = self._start, self._end
        self._record_input(recording, form, is_copied, kept_flags)
        recording.launch(
            box_tree.fill_vertex_aabbs,
            len(topology.moving_vertices),
            inputs=self._vertex_aabb_inputs(
                topology.moving_vertices,
                self._active if form.line_search is None else self._touched,
                start,
                end,
                self._options.t_max,
            ),
            outputs=[self._vertex_aabbs],
        )
        for tree in self._trees.values():
            if not tree.primitives.is_static:
                fill_tree(tree, self._vertex_aabbs, recording)
        for tree_pair in self._tree_pairs:
            self._record_search(recording, tree_pair, start, end)
        for kind in self._keys:
            self._record_narrow_phase(recording, kind, start, end, form.line_search is not None, gaps_moved)

    def _record_input(self, recording: Recording, form: _Form, is_copied: bool, kept_flags: int) -> None:
        """Record the launches that read positions and reset the results."""
        mesh, topology, minima = self._mesh, self.topology, self._minima
        read = device_step.make_input(form.real)
        recording.launch(
            device_step.reset,
            max(mesh.num_bodies, mesh.num_worlds),
            inputs=[kept_flags],
            outputs=[minima, self._counts, self.result.contacts.count, self._flag.array],
        )
        if form.t0_by_vertex and self._has_static:
            recording.launch(
                read.read_static,
                -(-len(topology.static_vertices) // _CHUNK),
                inputs=[topology.static_vertices, Slot("vertices_t0")],
                outputs=[self._start, self._end, self._is_moved, minima],
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
        recording.launch(device_step.reset_vertices, mesh.num_vertices, inputs=[], outputs=[minima])
        # also if static bodies are not read here: an earlier launch may have been interrupted after it read them
        self._record_refresh(recording)

    def _record_refresh(self, recording: Recording) -> None:
        """Record the launches that recompute the boxes of static bodies, which run only if these have moved."""
        topology = self.topology
        trees = [tree for tree in self._trees.values() if tree.primitives.is_static]
        if not trees:
            return
        lattice = [topology.vertex_world, topology.world_shift]
        recording.launch(
            device_step.refresh_vertex_aabbs,
            -(-len(topology.static_vertices) // _CHUNK),
            inputs=[
                self._is_moved,
                topology.static_vertices,
                *lattice,
                self._start,
                self._inflation,
                self._quantization,
                _NUM_AABBS,
            ],
            outputs=[self._vertex_aabbs],
            grain=64,
        )
        for tree in trees:
            recording.launch(
                device_step.refresh_blocks,
                -(-tree.levels[0] // _CHUNK),
                inputs=[self._is_moved, self._vertex_aabbs, tree.primitives.num_corners],
                outputs=[tree.arrays],
                grain=64,
            )
            if len(tree.levels) > 2:
                recording.launch(
                    device_step.refresh_levels, 1, inputs=[self._is_moved, tree.levels[1]], outputs=[tree.arrays]
                )
        recording.launch(device_step.settle, 1, inputs=[], outputs=[self._is_moved])

    def _record_search(self, recording: Recording, tree_pair: TreePair, start: Any, end: Any) -> None:
        """Record the search of a tree pair; an item is a block of queries, on CUDA a query."""
        level = 0 if recording.is_cuda else 1
        count = tree_pair.query.primitives.count if level == 0 else tree_pair.query.levels[0]
        num_parts = len(self._execution.ranges(count, _SMALLEST_SEARCH, _PARTS_PER_THREAD))
        is_long = tree_pair.query.primitives.count * tree_pair.target.primitives.count > LONG_SEARCH * num_parts
        keys = self._keys[tree_pair.kind]
        recording.launch(
            make_pair_search(CULL).search_pairs,
            count,
            inputs=[
                search_range(level, int(tree_pair.kind), len(keys), is_shared=True),
                *tree_pair.search_inputs(
                    self.topology, self._options.t_max, self._inflation, self._separation, self._flag
                ),
                start,
                end,
            ],
            outputs=[self._counts, keys, self._minima],
            grain=_SMALLEST_SEARCH,
            parts_per_thread=_PARTS_PER_THREAD,
            is_long=lambda: is_long,
        )

    def _record_narrow_phase(
        self, recording: Recording, kind: PairKind, start: Any, end: Any, only_moving: bool, gaps_moved: float
    ) -> None:
        """Record the two rounds of the narrow phase for the pairs of a kind."""
        keys = self._keys[kind]
        solvers = min(len(keys), _MOST_SOLVERS)
        if not recording.is_cuda:
            solvers = self._execution.num_threads if self._mesh.num_vertices > _WORTH_THREADS else 1
        corners = [self.topology.corners[name] for name in CORNER_ARRAYS[kind]]
        options = self._options.for_kernel(self._length_scale, stop=self._flag.array)
        found = self._counts.numpy()[kind]  # on the CPU a view of what the launch has found

        for is_second in (False, True):
            recording.launch(
                make_narrow_phase(self._options.real).solve_pairs,
                solvers,
                inputs=[
                    solvers,
                    int(kind),
                    0,
                    _AS_FOUND,
                    self._counts,
                    keys,
                    *corners,
                    start,
                    end,
                    options,
                    int(only_moving),
                    int(is_second),
                    gaps_moved,
                ],
                outputs=[self._minima, self._contacts],
                grain=1,
                is_needed=(lambda: bool(found[OPEN])) if is_second else None,
                is_long=lambda: bool(found[FOUND] > LONG_PART * solvers or found[OPEN]),
            )


def _is_copied(form: _Form, has_static: bool) -> bool:
    """Whether a launch reads positions into arrays of its own."""
    return form.real is not wp.float64 or form.is_displacement or has_static


def _worlds_are_apart(mesh: CollisionMesh) -> bool:
    """Whether no body has vertices in more than one world."""
    within = np.diff(mesh.vertex_body) == 0
    return not (within & (np.diff(mesh.vertex_world) != 0)).any()


def _longest_side(vertices: NDArray[np.float64]) -> float:
    """Longest side of the box around positions, the unit of tolerance and separation."""
    with np.errstate(over="ignore"):
        side = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 1.0
    if not 0.0 < side <= np.finfo(np.float64).max:
        raise ValueError(f"length_scale is None, and the vertices span {side}; expected a length_scale above 0")
    return side
