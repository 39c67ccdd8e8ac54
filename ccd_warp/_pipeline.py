"""The main job: two frames of a mesh in, earliest times of impact out."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from ccd_warp._box_grid import Execution
from ccd_warp._broad_phase import DeviceCandidates, find_candidates_on_device, mesh_arrays
from ccd_warp._mesh import CollisionMesh
from ccd_warp._narrow_phase import PairArrays
from ccd_warp._options import DEFAULT_MAX_ITERATIONS, DEFAULT_TOLERANCE, Options, resolve_device
from ccd_warp._results import Contacts, MeshResult
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp.kernels import contacts as contact_kernels
from ccd_warp.kernels import cull as cull_kernels
from ccd_warp.kernels.narrow_phase import make_narrow_phase

# Primitives of each kind, as named in the mesh arrays.
_PRIMITIVES = {
    PairKind.VERTEX_FACE: ("vertex", "face"),
    PairKind.EDGE_EDGE: ("edge", "edge"),
    PairKind.POINT_SEGMENT: ("vertex", "edge"),
    PairKind.POINT_POINT: ("vertex", "vertex"),
}


# Pairs of the first and of the largest chunk of the search for a bound.
_FIRST_CHUNK = 4096
_LARGEST_CHUNK = 1 << 18


def mesh_ccd(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    minimum_separation: float = 0.0,
    start_gap_fraction: float | None = None,
    t_max: float = 1.0,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    length_scale: float | None = None,
    precision: str = "float64",
    method: str = "clipping",
    device: Any = None,
    num_threads: int | None = None,
) -> MeshResult:
    """Earliest times of impact of a step: of the scene, per vertex, per body, and of every contact.

    Args:
        mesh: The bodies; see :class:`ccd_warp.CollisionMesh`.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving vertices
            only, shape [V_moving, 3].
        tolerance: Largest gap (L∞) that counts as contact where a pair cannot be told apart cheaply, as a multiple of
            ``length_scale``, above 0.
        minimum_separation: Distance (L∞) at which a pair counts as touching, as a multiple of ``length_scale``.
        start_gap_fraction: In (0, 1), or None. Where a pair starts closer than the minimum separation, or close to it,
            its separation is this fraction of its start gap at most: its toi is then positive, unless it touches at
            the start (``CCDStatus.INITIAL_CONTACT``), when there is no positive step.
        t_max: End of the step that is checked, in [0, 1].
        max_iterations: Limit of the work on a pair; at the limit its toi is early, never late.
        length_scale: Length that the two multiples refer to; by default the longest side of the box around the whole
            motion.
        precision: ``"float64"`` or ``"float32"``, of the iteration. Differences are always formed in float64.
        method: ``"clipping"``, or ``"bisection"``: the literature's plain inclusion bisection, for comparison.
        device: Warp device; by default Warp's current one.
        num_threads: Threads on the CPU; by default one a core. The result does not depend on it.

    Returns:
        The result, NumPy arrays.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values.

    References:
        Wang et al. 2021, section 4 (narrow phase); see :func:`ccd_warp.find_candidates` for the broad phase.

    Guarantee: if the exact trajectories of a pair that passes the mesh's filter (vertex-face, edge-edge, and where the
    mesh has loose primitives point-segment and point-point) first touch (or come within the minimum separation) at
    τ ≤ t_max, every reported toi that covers the pair is ≤ τ. ``inf`` is certain. A finite toi without a collision is
    possible only where the L∞ gap falls below separation + δ + ε, or where a limit was reached, which the status says.
    """
    options = Options(
        tolerance=tolerance,
        minimum_separation=minimum_separation,
        start_gap_fraction=start_gap_fraction,
        t_max=t_max,
        max_iterations=max_iterations,
        length_scale=length_scale,
        precision=precision,
        method=method,
        device=device,
        num_threads=num_threads,
    )
    return _Step(mesh, vertices_t0, vertices_t1, options).run()


def collision_free_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    minimum_separation: float = 0.0,
    start_gap_fraction: float | None = None,
    t_max: float = 1.0,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    length_scale: float | None = None,
    precision: str = "float64",
    method: str = "clipping",
    device: Any = None,
    num_threads: int | None = None,
) -> float:
    """Largest step fraction that is certain to be free of collisions.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, as in :func:`mesh_ccd`, as all that follow.
        vertices_t1: End positions.
        tolerance: Largest gap that counts as contact.
        minimum_separation: Distance at which a pair counts as touching.
        start_gap_fraction: Largest separation of a pair as a fraction of its start gap; makes a line search's step
            positive where the minimum separation alone would make it 0.
        t_max: End of the step that is checked.
        max_iterations: Limit of the work on a pair.
        length_scale: Length that the two multiples refer to.
        precision: ``"float64"`` or ``"float32"``.
        method: ``"clipping"`` or ``"bisection"``.
        device: Warp device.
        num_threads: Threads on the CPU.

    Returns:
        A fraction of the step in [0, t_max], dimensionless: t_max if there is certainly no collision, 0 if bodies touch
        at the start.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values.

    References:
        Wang et al. 2021, section 4.

    Guarantee: no pair that passes the mesh's filter, of any kind that :func:`mesh_ccd` looks at, touches (or comes
    within the minimum separation) before the returned fraction.
    """
    options = Options(
        tolerance=tolerance,
        minimum_separation=minimum_separation,
        start_gap_fraction=start_gap_fraction,
        t_max=t_max,
        max_iterations=max_iterations,
        length_scale=length_scale,
        precision=precision,
        method=method,
        device=device,
        num_threads=num_threads,
    )
    return _Step(mesh, vertices_t0, vertices_t1, options).bound()


class _Step:
    """One step on its way through the stages."""

    def __init__(self, mesh: CollisionMesh, vertices_t0: ArrayLike, vertices_t1: ArrayLike, options: Options) -> None:
        self.timings: dict[str, float] = {}
        self.mesh = mesh
        self.options = options
        self.execution = Execution(resolve_device(options.device), options.threads)
        with self.timed("input"):
            start, end = mesh.frames(vertices_t0, vertices_t1)
            self.length_scale = longest_side(start, end) if options.length_scale is None else options.length_scale
            self.separation = min(options.minimum_separation * self.length_scale, np.finfo(np.float64).max)
            self.x_t0: wp.array = wp.array(start, dtype=wp.vec3d, device=self.execution.device, copy=False)
            self.x_t1: wp.array = wp.array(end, dtype=wp.vec3d, device=self.execution.device, copy=False)
            self.arrays = mesh_arrays(mesh, self.execution.device)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        if self.execution.device.is_cuda:
            wp.synchronize_device(self.execution.device)
        self.timings[stage] = self.timings.get(stage, 0.0) + time.perf_counter() - begin

    def candidates(self) -> DeviceCandidates:
        """Pairs whose boxes, each grown by half the minimum separation, overlap."""
        with self.timed("broad phase"):
            inflation = 0.5 * self.separation
            if self.separation > 0.0:
                inflation = min(math.nextafter(inflation, math.inf), np.finfo(np.float64).max)
            return find_candidates_on_device(self.mesh, self.x_t0, self.x_t1, inflation, self.execution)

    def pair_inputs(self, kind: PairKind, pairs: wp.array) -> list:
        """Inputs that every kernel over pairs begins with."""
        first, second = _PRIMITIVES[kind]
        return [int(kind), pairs, self.arrays[first][0], self.arrays[second][0], self.x_t0, self.x_t1]

    def cull(self, kind: PairKind, pairs: wp.array) -> wp.array:
        """The pairs that one inclusion test over the whole step does not settle."""
        with self.timed("cull"):
            flags = wp.empty(len(pairs), dtype=wp.int32, device=self.execution.device)
            self.execution.launch(
                cull_kernels.flag_survivors,
                len(pairs),
                inputs=[*self.pair_inputs(kind, pairs), self.separation],
                outputs=[flags],
            )
            count = counted(flags)
            survivors = wp.empty(count, dtype=wp.vec2i, device=self.execution.device)
            self.execution.launch(cull_kernels.keep_survivors, len(pairs), inputs=[pairs, flags], outputs=[survivors])
        return survivors

    def narrow_phase(self, kind: PairKind, pairs: wp.array) -> PairArrays:
        """The toi of each pair."""
        with self.timed("narrow phase"):
            out = PairArrays.empty(len(pairs), self.execution.device)
            self.execution.launch(
                make_narrow_phase(self.options.real).pairs_toi,
                len(pairs),
                inputs=[*self.pair_inputs(kind, pairs), self.options.for_kernel(self.length_scale)],
                outputs=out.as_list(),
                grain=64,
            )
        return out

    def bound(self) -> float:
        """Earliest toi of all pairs, or t_max: pairs that are free up to the best one so far stop at once.

        Pairs come in chunks, each with the bound that the chunks before it left, so that the result depends on nothing
        but the order of the pairs. The first chunk is small: a first bound makes the rest cheap.
        """
        found = self.candidates()
        best = self.options.t_max
        with self.timed("narrow phase"):
            kernel = make_narrow_phase(self.options.real).pairs_bound
            options = self.options.for_kernel(self.length_scale)
            for kind, pairs in found.by_kind():
                begin, size = 0, _FIRST_CHUNK
                while begin < len(pairs):
                    chunk = pairs[begin : min(begin + size, len(pairs))]
                    toi = wp.empty(len(chunk), dtype=wp.float64, device=self.execution.device)
                    inputs = [*self.pair_inputs(kind, chunk), self.separation, best, self.options.rounded_up(best)]
                    self.execution.launch(kernel, len(chunk), inputs=[*inputs, options], outputs=[toi])
                    best = min(best, float(toi.numpy().min()))
                    begin += size
                    size = min(4 * size, _LARGEST_CHUNK)
        return best

    def run(self) -> MeshResult:
        mesh = self.mesh
        device = self.execution.device
        found = self.candidates()
        candidates = {kind: len(pairs) for kind, pairs in found.by_kind()}
        # A kind without candidates is neither compiled nor launched.
        open_pairs = [(kind, self.cull(kind, pairs)) for kind, pairs in found.by_kind()]
        solved = [(kind, pairs, self.narrow_phase(kind, pairs)) for kind, pairs in open_pairs if len(pairs)]
        with self.timed("gather"):
            vertex_toi = wp.full(mesh.num_vertices, value=math.inf, dtype=wp.float64, device=device)
            body_toi = wp.full(mesh.num_bodies, value=math.inf, dtype=wp.float64, device=device)
            slots = [self.slots(out) for _, _, out in solved]
            sizes = [counted(slot) for slot in slots]
            total = sum(sizes)
            outputs = [
                wp.empty(total, dtype=dtype, device=device)
                for dtype in (wp.int32, wp.vec2i, wp.float64, wp.int32, wp.vec2d, wp.float64, wp.float64, wp.vec3d)
            ]
            serial = Execution(device, 1)
            first_slot = 0
            for (kind, pairs, out), slot, size in zip(solved, slots, sizes, strict=True):
                first, second = _PRIMITIVES[kind]
                if size:
                    serial.launch(
                        contact_kernels.write_contacts,
                        len(pairs),
                        inputs=[
                            int(kind),
                            first_slot,
                            pairs,
                            out.toi,
                            out.status,
                            out.parameters,
                            out.gap,
                            out.width,
                            slot,
                            self.arrays[first][0],
                            self.arrays[second][0],
                            self.arrays["vertex"][1],
                            self.x_t0,
                            self.x_t1,
                        ],
                        outputs=[*outputs, vertex_toi, body_toi],
                    )
                first_slot += size
            kind_, primitives, toi, status, parameters, gap, width, normal = (array.numpy() for array in outputs)
        contacts = Contacts(
            kind=kind_,
            primitives=primitives.reshape(-1, 2),
            toi=toi,
            parameters=parameters.reshape(-1, 2),
            normal=normal.reshape(-1, 3),
            status=status,
            gap=gap,
            width=width,
        )
        survivors = {kind: len(pairs) for kind, pairs in open_pairs}
        counts = {
            "bodies": mesh.num_bodies,
            "vertices": mesh.num_vertices,
            "edges": mesh.num_edges,
            "faces": mesh.num_faces,
            **_loose_counts(mesh),
            **{f"{_name(kind)} candidates": candidates.get(kind, 0) for kind in _kinds(mesh)},
            **{f"{_name(kind)} after the cull": survivors.get(kind, 0) for kind in _kinds(mesh)},
            **{f"{_name(kind)} contacts": int(np.count_nonzero(contacts.kind == kind)) for kind in _kinds(mesh)},
            "contacts at the start": int(np.count_nonzero(contacts.status == CCDStatus.INITIAL_CONTACT)),
            "contacts at a limit": int(np.count_nonzero(contacts.status >= CCDStatus.ITERATION_LIMIT)),
        }
        self.timings["total"] = sum(self.timings.values())
        scene = float(toi.min()) if total else math.inf
        return MeshResult(scene, vertex_toi.numpy(), body_toi.numpy(), contacts, counts, self.timings)

    def slots(self, out: PairArrays) -> wp.array:
        """1 for every pair that is a contact."""
        flags = wp.empty(len(out.toi), dtype=wp.int32, device=self.execution.device)
        self.execution.launch(contact_kernels.flag_contacts, len(flags), inputs=[out.toi], outputs=[flags])
        return flags


def _kinds(mesh: CollisionMesh) -> list[PairKind]:
    """Pair kinds that the primitives of a mesh can form."""
    kinds = [PairKind.VERTEX_FACE, PairKind.EDGE_EDGE]
    if len(mesh.loose_points):
        kinds += [PairKind.POINT_SEGMENT, PairKind.POINT_POINT]
    return kinds


def _name(kind: PairKind) -> str:
    return kind.name.lower().replace("_", "-")


def _loose_counts(mesh: CollisionMesh) -> dict[str, int]:
    """Numbers of codimensional primitives, where a mesh has any."""
    counts = {"loose edges": len(mesh.loose_edges), "loose points": len(mesh.loose_points)}
    return {name: count for name, count in counts.items() if count}


def counted(flags: wp.array) -> int:
    """Turn flags into their inclusive scan, in place; the number of flags set."""
    if len(flags) == 0:
        return 0
    wp.utils.array_scan(flags, flags, inclusive=True)
    return int(flags[-1:].numpy()[0])


def longest_side(start: np.ndarray, end: np.ndarray) -> float:
    """Longest side of the box around both frames."""
    if len(start) == 0:
        return 0.0
    low = np.minimum(start.min(axis=0), end.min(axis=0))
    high = np.maximum(start.max(axis=0), end.max(axis=0))
    with np.errstate(over="ignore"):
        return float(min((high - low).max(), np.finfo(np.float64).max))
