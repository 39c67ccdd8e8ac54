"""The main job: two frames of a mesh in, earliest times of impact out; one-shot calls, and an object to hold."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from numpy.typing import ArrayLike

from ccd_warp._candidates import Candidates, sorted_candidates, validated_inflation
from ccd_warp._line_search import DEFAULT_MAX_ROUNDS, DEFAULT_SAFETY, LineSearchResult, search_step
from ccd_warp._mesh import CollisionMesh
from ccd_warp._options import DEFAULT_MAX_ITERATIONS, DEFAULT_TOLERANCE, Options, resolve_device
from ccd_warp._results import MeshResult
from ccd_warp._status import PairKind
from ccd_warp._step import Step
from ccd_warp._workspace import Workspace


@contextmanager
def borrowed_workspace(mesh: CollisionMesh, options: Options) -> Iterator[Workspace]:
    """A workspace of the mesh that no other thread uses; it stays with the mesh for the next call."""
    device = resolve_device(options.device)
    idle: list[Workspace] = mesh._idle_steps.setdefault(str(device), [])  # type: ignore[attr-defined]
    try:
        workspace = idle.pop()
    except IndexError:
        workspace = Workspace(mesh, device)
    try:
        yield workspace
    finally:
        idle.append(workspace)


def find_candidates(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    inflation: float = 0.0,
    *,
    pair_kinds: Sequence[PairKind | str] | None = None,
    device: Any = None,
    num_threads: int | None = None,
) -> Candidates:
    """Find the pairs of primitives whose swept axis-aligned boxes overlap.

    The box of a primitive encloses its vertices at both ends of the step, grows by ``inflation`` on every side, rounded
    outward, and is closed: boxes that only touch overlap. Left out are pairs that share a vertex, pairs of two static
    bodies, pairs within a body whose self-collision is off, and what ``body_pairs`` and ``exclusion_rings`` of the mesh
    leave out.

    Four kinds of pair are enough: vertices with faces, edges with edges, loose points with loose edges, and loose
    points with each other. What collides are faces, loose edges and loose points: convex sets, two of which, A and B,
    are as far apart in any norm as the origin is from the polytope A - B, which is at its boundary while they do not
    touch. For two faces, or a face and a loose edge, that boundary consists of differences (vertex) - (face) and
    (edge) - (edge), and where A - B is flat these cover all of it. Two loose edges are an edge-edge pair as they stand,
    a loose point and a face a vertex-face pair. So a loose point and an edge of a face need no pair: the edge is part
    of the face and no nearer. Nor do a vertex of an edge and a loose edge: the vertex is part of its own edge. Loose
    points with loose edges, and with each other, are all that is left, and are looked for only where they exist.
    Because pairs that share a vertex are left out, a cable that folds back on itself at a joint is not noticed by the
    two segments of that joint, as two faces with a common edge meet only through their other vertices.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving vertices
            only, shape [V_moving, 3].
        inflation: Growth of every box on every side, a length in the unit of the mesh, finite and not negative.
        pair_kinds: Kinds of pairs to look for (:class:`ccd_warp.PairKind` or their names); by default all.
        device: Warp device; by default Warp's current one.
        num_threads: Threads on the CPU; by default one a core. The result does not depend on it.

    Returns:
        The pairs, sorted.

    Raises:
        ValueError: If the frames do not match the mesh, a value that is read is not finite, ``inflation`` is negative
            or not finite, or ``num_threads`` is less than one.

    References:
        Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (boxes along a
        space-filling curve); Ericson 2005, "Real-time collision detection", section 6 (bounding volume hierarchies).

    Guarantee: every pair whose boxes overlap is found, exactly once, and no other pair. The boxes of two primitives
    that come within ``inflation`` of each other (L∞) during the step overlap.
    """
    inflation = validated_inflation(inflation)
    options = Options(pair_kinds=pair_kinds, device=device, num_threads=num_threads)
    with borrowed_workspace(mesh, options) as workspace:
        return sorted_candidates(Step(workspace, vertices_t0, vertices_t1, options), inflation)


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
    pair_kinds: Sequence[PairKind | str] | None = None,
    memory_limit: int | None = None,
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
        pair_kinds: Kinds of pairs to look at (:class:`ccd_warp.PairKind` or their names, as ``"vertex_face"``); by
            default all that the mesh can form.
        memory_limit: Bytes that the step may take beside its input, its contacts included. Where the pairs do not fit
            they come in batches; no result depends on it. By default what the boxes need, and 1 GiB for the pairs.
        device: Warp device; by default Warp's current one.
        num_threads: Threads on the CPU; by default one a core. The result does not depend on it.

    Returns:
        The result, NumPy arrays.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values; or if
            ``memory_limit`` is too small, with the least that works.

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
        pair_kinds=pair_kinds,
        memory_limit=memory_limit,
        device=device,
        num_threads=num_threads,
    )
    with borrowed_workspace(mesh, options) as workspace:
        return Step(workspace, vertices_t0, vertices_t1, options).contacts()


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
    pair_kinds: Sequence[PairKind | str] | None = None,
    memory_limit: int | None = None,
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
        pair_kinds: Kinds of pairs to look at.
        memory_limit: Bytes that the step may take beside its input.
        device: Warp device.
        num_threads: Threads on the CPU.

    Returns:
        A fraction of the step in [0, t_max], dimensionless: t_max if there is certainly no collision, 0 if bodies touch
        at the start.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values; or if
            ``memory_limit`` is too small, with the least that works.

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
        pair_kinds=pair_kinds,
        memory_limit=memory_limit,
        device=device,
        num_threads=num_threads,
    )
    with borrowed_workspace(mesh, options) as workspace:
        return Step(workspace, vertices_t0, vertices_t1, options).bound()


def line_search(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    per: str = "scene",
    safety: float = DEFAULT_SAFETY,
    max_rounds: int = DEFAULT_MAX_ROUNDS,
    **options: Any,
) -> LineSearchResult:
    """Shorten a step until it is certain to be free of collisions: as a whole, by bodies, or vertex by vertex.

    A round takes the toi of every pair that still touches, shortens the displacements of its scene, bodies or vertices
    to ``safety`` times it, and looks again, at the shortened step. Shortening each vertex by its own toi alone would
    not do: a vertex that is stopped leaves one that would have passed behind it to run into it.

    Pairs that touch at the start, or are within the minimum separation there, have toi 0, and what shares their
    fraction does not move; they come back as ``touching``. With ``start_gap_fraction`` those that are only close may
    move.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, as in :func:`mesh_ccd`.
        vertices_t1: End positions wished for.
        per: ``"scene"``: all vertices move by one fraction of their displacements; ``"body"``: each body by one;
            ``"vertex"``: each vertex by its own.
        safety: Share of its toi that what touches may move, in (0, 1).
        max_rounds: Most calls of :func:`mesh_ccd`, at least 3; where they do not do, all vertices move by one fraction,
            or not at all, and ``is_limited`` says so.
        **options: Options of :func:`mesh_ccd`, all but ``t_max``.

    Returns:
        The end positions that can be taken, and the fractions that led there.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values.

    References:
        Li et al. 2020, "Incremental potential contact", section 5 (one fraction for the scene).

    Guarantee: while every vertex moves on a straight line from ``vertices_t0`` to ``vertices`` of the result, no pair
    that passes the mesh's filter touches (or comes within the minimum separation), except pairs of ``touching``, whose
    vertices do not move. Proof: the last round ran :func:`mesh_ccd` on these very positions, as they are rounded, and
    every pair with a vertex that moves had toi ``inf`` there, which is certain.
    """
    check_step_is_whole(options.get("t_max", 1.0))

    def solve(start: ArrayLike, end: ArrayLike) -> MeshResult:
        return mesh_ccd(mesh, start, end, **options)

    return search_step(mesh, vertices_t0, vertices_t1, solve, per=per, safety=safety, max_rounds=max_rounds)


def check_step_is_whole(t_max: float) -> None:
    """Check that a line search looks at all of the step.

    Raises:
        ValueError: If not.
    """
    if t_max != 1.0:
        raise ValueError(f"t_max is {t_max!r}; expected 1, as a line search looks at the whole step")


class CollisionPipeline:
    """The calls on one mesh with one set of options, for a time loop.

    It holds the topology, the trees of what rests and all buffers: a step of a size that was seen before allocates
    nothing but its result. The one-shot calls do the same with a workspace that they leave with the mesh, so this is
    for those who want to own it, release it, or read what it does.

    Attributes:
        mesh: The bodies.
        counts: What the last call did, by stage.
        timings: Seconds of each stage of the last call.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        *,
        tolerance: float = DEFAULT_TOLERANCE,
        minimum_separation: float = 0.0,
        start_gap_fraction: float | None = None,
        t_max: float = 1.0,
        max_iterations: int = DEFAULT_MAX_ITERATIONS,
        length_scale: float | None = None,
        precision: str = "float64",
        method: str = "clipping",
        pair_kinds: Sequence[PairKind | str] | None = None,
        memory_limit: int | None = None,
        device: Any = None,
        num_threads: int | None = None,
    ) -> None:
        """Hold a mesh and options, which are those of :func:`ccd_warp.mesh_ccd`.

        Raises:
            ValueError: If an option is out of its range.
        """
        self.mesh = mesh
        self.counts: dict[str, int] = {}
        self.timings: dict[str, float] = {}
        self._options = Options(
            tolerance=tolerance,
            minimum_separation=minimum_separation,
            start_gap_fraction=start_gap_fraction,
            t_max=t_max,
            max_iterations=max_iterations,
            length_scale=length_scale,
            precision=precision,
            method=method,
            pair_kinds=pair_kinds,
            memory_limit=memory_limit,
            device=device,
            num_threads=num_threads,
        )
        self._workspace = Workspace(mesh, resolve_device(device))
        self._lock = threading.Lock()

    @contextmanager
    def _step(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike) -> Iterator[Step]:
        with self._lock:
            step = Step(self._workspace, vertices_t0, vertices_t1, self._options)
            yield step
            if "total" not in step.timings:
                step.finish_timings()
            self.timings = step.timings
            self.counts = {"boxes": step.boxes.num_boxes, "sets sorted anew": step.boxes.num_sorted, **step.counts}

    @property
    def num_allocations(self) -> int:
        """Device arrays that were allocated so far."""
        return self._workspace.buffers.num_allocations

    def find_candidates(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, inflation: float = 0.0) -> Candidates:
        """Like :func:`ccd_warp.find_candidates`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions, as there.
            inflation: Growth of every box on every side, a length.

        Returns:
            The pairs, sorted.

        Raises:
            ValueError: As there.

        Guarantee: every pair whose boxes overlap is found, exactly once, and no other pair.
        """
        inflation = validated_inflation(inflation)
        with self._step(vertices_t0, vertices_t1) as step:
            return sorted_candidates(step, inflation)

    def mesh_ccd(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike) -> MeshResult:
        """Like :func:`ccd_warp.mesh_ccd`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions, as there.

        Returns:
            The result, NumPy arrays.

        Raises:
            ValueError: As there.

        Guarantee: as there; no toi is late and no contact is missed.
        """
        with self._step(vertices_t0, vertices_t1) as step:
            return step.contacts()

    def collision_free_step(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike) -> float:
        """Like :func:`ccd_warp.collision_free_step`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions, as there.

        Returns:
            A fraction of the step in [0, t_max].

        Raises:
            ValueError: As there.

        Guarantee: as there; no pair touches before the returned fraction.
        """
        with self._step(vertices_t0, vertices_t1) as step:
            return step.bound()

    def line_search(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        per: str = "scene",
        safety: float = DEFAULT_SAFETY,
        max_rounds: int = DEFAULT_MAX_ROUNDS,
    ) -> LineSearchResult:
        """Like :func:`ccd_warp.line_search`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions wished for, as there.
            per: ``"scene"``, ``"body"`` or ``"vertex"``.
            safety: Share of its toi that what touches may move.
            max_rounds: Most calls of :meth:`mesh_ccd`.

        Returns:
            The end positions that can be taken, and the fractions that led there.

        Raises:
            ValueError: As there, and if the pipeline's ``t_max`` is not 1.

        Guarantee: as there; no pair with a vertex that moves touches on the way to the end positions.
        """
        check_step_is_whole(self._options.t_max)
        return search_step(
            self.mesh, vertices_t0, vertices_t1, self.mesh_ccd, per=per, safety=safety, max_rounds=max_rounds
        )
