"""The object to hold in a time loop: a mesh, options, and all that does not change from step to step."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NoReturn, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.candidates import Candidates, candidates_of, validated_inflation
from ccd_warp._engine.device_step import (
    MOST_CONTACTS,
    MOST_PAIRS,
    Capacities,
    DeviceStep,
    LineSearch,
)
from ccd_warp._engine.host_step import Step
from ccd_warp._engine.line_search import (
    DEFAULT_MAX_ROUNDS,
    DEFAULT_SAFETY,
    EVERY_PER,
    LineSearchResult,
    Per,
    check_step_is_whole,
    search_step,
)
from ccd_warp._engine.mesh_cache import MeshCache
from ccd_warp._engine.workspace import Workspace
from ccd_warp._input.arguments import check_choice, check_count, check_instance, check_real
from ccd_warp._input.interop import check_writable
from ccd_warp._input.option_types import MeshOptions
from ccd_warp._input.options import Options, naming, options_of, resolve_device
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Counts, LaunchResult, MeshResult
from ccd_warp._runtime.progress import Progress

DEFAULT_NUM_ROUNDS = 5
_MOST_ROUNDS = 100


_T = TypeVar("_T")


class CollisionPipeline:
    """The calls on one mesh with one set of options, for a time loop.

    It holds the topology, the trees of what rests and all buffers: a step of a size that was seen before allocates
    nothing but its result. :meth:`launch` works on arrays on the device alone, and can be captured in a graph; the
    other methods take and return NumPy arrays. The one-shot functions are these methods on a pipeline for one call,
    whose buffers stay with the mesh.

    Attributes:
        mesh: The bodies.
        counts: What the last call that returned NumPy arrays or a number did, all 0 before the first; of a line search
            its last step, and of contacts only where :meth:`mesh_ccd` looked for them. :meth:`launch` and
            :meth:`launch_line_search` leave it as it is: their counts are ``num_pairs`` and ``contacts.count`` of the
            result, on the device.
        timings: Seconds of each stage of that call, and their ``total``; empty before the first.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        *,
        max_pairs: int | None = None,
        max_contacts: int | None = None,
        **options: Unpack[MeshOptions],
    ) -> None:
        """Hold a mesh and options.

        Args:
            mesh: The bodies.
            max_pairs: Capacity for pairs, as of :meth:`reserve`.
            max_contacts: Capacity for contacts, likewise.
            **options: Options of :class:`ccd_warp.MeshOptions`.

        Raises:
            ValueError: If an option is out of its range.
            TypeError: If there is no such option.
        """
        chosen = options_of("CollisionPipeline", MeshOptions, options, others=["max_pairs", "max_contacts"])
        check_instance("mesh", mesh, CollisionMesh)
        self._hold(chosen, Workspace(mesh, resolve_device(chosen.device)))
        with naming("CollisionPipeline"):
            self._capacities = self._with_capacities(max_pairs, max_contacts)

    def _hold(self, options: Options, workspace: Workspace) -> None:
        self.mesh = workspace.topology.mesh
        self.counts = Counts()
        self.timings: dict[str, float] = {}
        self._options = options
        self._topology = workspace.topology
        # both are away while a call uses them, and come back from one that ended well: nothing half-made is used again
        self._workspace: Workspace | None = workspace
        self._device_step: DeviceStep | None = None
        self._show_progress: Callable[[Progress], None] | None = None  # set by the command line
        self._lock = threading.Lock()
        self._capacities = Capacities.default(self.mesh)
        self._layout = self.mesh.vertices
        self._interrupted: DeviceStep | None = None  # the step of a launch that did not end
        self._is_placing = False  # whether that may have placed some of the static bodies

    @classmethod
    @contextmanager
    def borrowed(cls, mesh: CollisionMesh, options: Options) -> Iterator["CollisionPipeline"]:
        """A pipeline for one call, on a workspace that stays with the mesh and that no other thread uses meanwhile."""
        check_instance("mesh", mesh, CollisionMesh)
        device = resolve_device(options.device)
        idle = MeshCache.of(mesh).idle_workspaces.setdefault(str(device), [])
        try:
            workspace = idle.pop()
        except IndexError:
            workspace = Workspace(mesh, device)
        pipeline = cls.__new__(cls)
        pipeline._hold(options, workspace)
        try:
            yield pipeline
        finally:
            if pipeline._workspace is not None:
                idle.append(pipeline._workspace)

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: what it holds is on a device, and of this process."""
        raise TypeError(
            "a CollisionPipeline cannot be copied or pickled; copy or pickle its mesh and its options, "
            "and build another: CollisionPipeline(mesh, **options)"
        )

    def _on_step(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, work: Callable[[Step], _T]) -> _T:
        """What ``work`` makes of a step."""
        if self._topology.device.is_capturing:
            raise RuntimeError("a graph is being captured, and this call waits for the device; launch() does not")
        with self._lock:
            begin = time.perf_counter()
            frames = self.mesh.frames(vertices_t0, vertices_t1)
            workspace, self._workspace = self._workspace, None
            if workspace is None:
                workspace = Workspace(self.mesh, self._topology.device)
            step = Step(workspace, frames, self._options, time.perf_counter() - begin, self._show_progress)
            result = work(step)
            if "total" not in step.timings:
                step.finish_timings()
            self.timings = step.timings
            self.counts = step.counts
            self._workspace = workspace
        return result

    def _with_capacities(self, max_pairs: int | None, max_contacts: int | None) -> Capacities:
        capacities = self._capacities
        if max_pairs is not None:
            capacities = replace(capacities, max_pairs=check_count("max_pairs", max_pairs, MOST_PAIRS))
        if max_contacts is not None:
            capacities = replace(capacities, max_contacts=check_count("max_contacts", max_contacts, MOST_CONTACTS))
        return capacities

    def reserve(
        self, *, max_pairs: int | None = None, max_contacts: int | None = None, vertices: ArrayLike | None = None
    ) -> LaunchResult:
        """Allocate all that :meth:`launch` needs: before the loop, and again where a flag told of too little capacity.

        The result of before is no longer written to. A graph that was captured before still writes there, as long as
        that result is kept: capture anew.

        Args:
            max_pairs: Pairs of each kind that there is capacity for after the cull, 8 bytes each; by default as before, at
                first one a primitive and at least 4,096.
            max_contacts: Contacts that there is capacity for, 80 bytes each; by default as before, at first one a vertex
                and at least 4,096.
            vertices: Positions that are typical of the loop, shape [V, 3]: boxes are laid out for them, and static
                bodies rest there until a launch says otherwise. By default as before, at first those of the mesh.
                Another layout costs time, never a collision.

        Returns:
            Where the launches to come write.

        Raises:
            ValueError: If a capacity is out of its range, the positions do not match, or are all one and no
                ``length_scale`` is given.
            RuntimeError: While a graph is captured.
        """
        with self._lock:
            if self._topology.device.is_capturing:
                raise RuntimeError("a graph is being captured; call reserve() before the capture")
            with naming("reserve"):
                capacities = self._with_capacities(max_pairs, max_contacts)
            layout = None if vertices is None else self.mesh.frame(vertices, "vertices").copy()
            self._reserve(capacities, layout)
            assert self._device_step
            return self._device_step.result

    def _reserve(self, capacities: Capacities, layout: NDArray[np.float64] | None) -> None:
        """Make the step on the device, at other positions if they are given."""
        before = self._device_step or self._interrupted
        placed = self._layout if before is None else before.at_rest()
        if layout is not None:
            placed = layout
        layout = self._layout if layout is None else layout
        step = DeviceStep(self._topology, self._options, capacities, layout, placed)
        if placed is layout:
            self._is_placing = False
        self._capacities, self._layout, self._device_step = capacities, layout, step

    def launch(self, vertices_t0: Any, vertices_t1: Any = None, *, displacements: Any = None) -> LaunchResult:
        """Look at a step on the device, without waiting for it.

        For a time loop on the device: kernels of known sizes, recorded at the first call, read the positions and write
        the result's arrays. Nothing is allocated, copied to or from the host, or waited for, so a call can be captured
        in a graph (``wp.ScopedCapture``, on CUDA and on the CPU) and replayed with whatever the same arrays hold by
        then; on CUDA after a first call outside. Float64 positions of a mesh without static bodies are read where they
        are; others are converted, by the kernel that checks them.

        ``length_scale`` is, unless it was given, the longest side of the box around the positions of :meth:`reserve`,
        so that it is the same in every step. ``memory_limit`` does not count here; the capacities are the limits.

        Args:
            vertices_t0: Start positions on the pipeline's device: a contiguous array of Warp, NumPy, or any library that
                speaks DLPack, of vec3f or vec3d and shape [V], or of float32 or float64 and shape [V, 3]; or rows of
                the moving vertices alone, when static bodies stay where they were.
            vertices_t1: End positions of the same type. Rows of static bodies are not read.
            displacements: In their place, what is added to the start positions, in float64. A solver that adds them in
                float32 must pass the positions that it gets, as its rounding is part of the motion.

        Returns:
            The arrays that the launch writes to, the same ones until the next :meth:`reserve`.

        Raises:
            ValueError: If an array is not as described, or not exactly one of ``vertices_t1`` and ``displacements`` is given.
            RuntimeError: If a graph of CUDA is being captured, and no call with arrays of these types came before.

        References:
            As of :func:`ccd_warp.mesh_ccd`.

        Guarantee: as of :func:`ccd_warp.mesh_ccd`, for the scene, each world, body and vertex, whatever the flags.
        Where there is no capacity for a pair its toi counts as 0, and where a coordinate is not finite that of its world.
        """
        if (vertices_t1 is None) == (displacements is None):
            given = "both" if vertices_t1 is not None else "neither"
            raise ValueError(f"{given} of vertices_t1 and displacements is given; expected one of them")
        if displacements is None:
            return self._launch(vertices_t0, vertices_t1)
        return self._launch(vertices_t0, displacements, name_t1="displacements", is_displacement=True)

    def launch_line_search(
        self,
        vertices_t0: Any,
        vertices_t1: Any,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        num_rounds: int = DEFAULT_NUM_ROUNDS,
    ) -> LaunchResult:
        """Shorten a step on the device until it is certain to be free of collisions, as :meth:`launch` looks at it.

        A round looks at the step and moves every vertex that is part of a contact, or all that move with it, no
        farther than ``safety`` times its toi; bodies and vertices of their own fractions that touch a third time stay
        where they are, which may stop others in turn. After ``num_rounds`` a round with one fraction for each world
        that still touches follows, and a last look: a world that touches even then stays where it is. One fraction for
        the scene or each world is shortened twice at most before the last look. The number of launches is always the
        same, so that a graph can hold them; a world that a look finds free has no boxes in those that follow.

        Beside a long motion a small gap is lost in rounding, and the toi is 0. Where the first look finds a toi below
        1e-6, the pair is therefore taken to move by an eighth of its gap at least; with toi 0 in the second look its
        vertices, or all that move with them, stay where they are. With one fraction for each body or vertex that takes
        two rounds.

        Pairs that rest are no matter here: two vertices that both stay may touch.

        Args:
            vertices_t0: Start positions, as in :meth:`launch`.
            vertices_t1: End positions wished for, of the same type, which become those that can be taken. Rows of static
                bodies are neither read nor written.
            per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``, as in :func:`ccd_warp.line_search`.
            safety: Share of its toi that what touches may move, in (0, 1).
            num_rounds: Rounds in which bodies or vertices have fractions of their own, at least one; two more looks
                follow.

        Returns:
            The result of the last look: of a world in which something moves, toi is inf; of one that it had to stop it
            is finite. Flags of too little capacity for pairs and of invalid input are those of all looks.

        Raises:
            ValueError: As :meth:`launch`, or if an option is out of its range.
            RuntimeError: As :meth:`launch`.

        References:
            Li et al. 2020, "Incremental potential contact", section 5 (one fraction for the scene).

        Guarantee: while every vertex moves on a straight line from ``vertices_t0`` to ``vertices_t1``, no pair with a vertex that
        moves touches (or comes within the minimum separation), whatever the flags. Proof: the last look was at these
        very positions, as they are rounded, and where its toi was not inf the vertices do not move.
        """
        check_writable(vertices_t1, "vertices_t1")
        with naming("launch_line_search"):
            per, safety = _validated_line_search(per, safety)
            num_rounds = check_count("num_rounds", num_rounds, _MOST_ROUNDS)
            check_step_is_whole(self._options.t_max)
        return self._launch(vertices_t0, vertices_t1, line_search=LineSearch.of(per, num_rounds), safety=safety)

    def _launch(self, vertices_t0: Any, vertices_t1: Any, **arguments: Any) -> LaunchResult:
        """Launch on what :meth:`reserve` made, or makes now."""
        with self._lock:
            if self._device_step is None:
                if self._topology.device.is_capturing:
                    raise RuntimeError("nothing is reserved; call reserve() before the capture")
                self._reserve(self._capacities, None)
            step = self._device_step
            assert step
            prepared = step.prepare(vertices_t0, vertices_t1, **arguments)
            if self._is_placing and not prepared.places_static:
                raise RuntimeError(
                    "a launch was interrupted while it placed static bodies; "
                    "pass vertices_t0 with a row for every vertex, or call reserve(vertices=...)"
                )
            self._interrupted, self._is_placing = step, prepared.places_static
            self._device_step = None
            step.launch(prepared)
            self._device_step = step
            self._interrupted, self._is_placing = None, False
            return step.result

    @property
    def num_allocations(self) -> int:
        """Device arrays that were allocated so far."""
        return self._workspace.buffers.num_allocations if self._workspace else 0

    def find_candidates(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, inflation: float = 0.0) -> Candidates:
        """Like :func:`ccd_warp.find_candidates`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions, as there.
            inflation: Growth of every box on every side, a length.

        Returns:
            The pairs, in an order that does not depend on threads, memory limit or earlier calls.

        Raises:
            ValueError: As there.

        Guarantee: every pair whose boxes overlap is found, exactly once, and no other pair.
        """
        with naming("find_candidates"):
            inflation = validated_inflation(inflation)
        return self._on_step(vertices_t0, vertices_t1, lambda step: candidates_of(step, inflation))

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
        return self._on_step(vertices_t0, vertices_t1, Step.contacts)

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
        return self._on_step(vertices_t0, vertices_t1, Step.bound)

    def line_search(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        max_rounds: int = DEFAULT_MAX_ROUNDS,
    ) -> LineSearchResult:
        """Like :func:`ccd_warp.line_search`.

        Args:
            vertices_t0: Start positions, shape [V, 3].
            vertices_t1: End positions wished for, as there.
            per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``.
            safety: Share of its toi that what touches may move.
            max_rounds: Most calls of :meth:`mesh_ccd`.

        Returns:
            The end positions that can be taken, and the fractions that led there.

        Raises:
            ValueError: As there, and if the pipeline's ``t_max`` is not 1.

        Guarantee: as there; no pair with a vertex that moves touches on the way to the end positions.
        """
        with naming("line_search"):
            check_step_is_whole(self._options.t_max)
            per, safety = _validated_line_search(per, safety)
            max_rounds = check_count("max_rounds", max_rounds, 2**31 - 1, least=3)
        return search_step(
            self.mesh, vertices_t0, vertices_t1, self.mesh_ccd, per=per, safety=safety, max_rounds=max_rounds
        )


def _validated_line_search(per: Per, safety: float) -> tuple[Per, float]:
    """What moves together and how far, or a ValueError."""
    return (
        check_choice("per", per, EVERY_PER),
        check_real("safety", safety, "a number between 0 and 1", lambda x: 0 < x < 1),
    )
