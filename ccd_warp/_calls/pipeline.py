"""The object for a time loop: a mesh, its options, and everything that stays the same from step to step."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, Unpack

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.motions import course_of, paths_of, start_of, straight_sentence, worlds_of
from ccd_warp._engine.device.input import LineSearch
from ccd_warp._engine.host.candidates import Candidates, validated_inflation
from ccd_warp._engine.host.contact_step import ContactStep
from ccd_warp._engine.host.course import Course, Ends
from ccd_warp._engine.host.least_toi_step import LeastToiStep
from ccd_warp._engine.host.line_search import (
    DEFAULT_MAX_ROUNDS,
    DEFAULT_SAFETY,
    LineSearchRounds,
    check_step_is_whole,
    validated_line_search,
)
from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.host.start_distances import LeastOfParts, StartDistances, in_all_parts, of_one_part
from ccd_warp._engine.host.step import HostStep
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._engine.mesh.start_distances import keeps_start_distances, largest_start_distance
from ccd_warp._results.device_results import DeviceDisplacements, DeviceProximities, LaunchResult
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.line_search_result import LineSearchResult
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import Counts, MeshResult
from ccd_warp._rigid.mesh_paths import MeshPaths, check_own_frames
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.streams import in_current_order
from ccd_warp._scene.input.arguments import Per, check_count, check_flag, check_instance, check_real, shown
from ccd_warp._scene.input.interop import DeviceArray, check_writable
from ccd_warp._scene.input.option_types import MeshOptions
from ccd_warp._scene.input.options import Options, naming, options_of, resolve_device
from ccd_warp._scene.mesh import CollisionMesh

if TYPE_CHECKING:
    from ccd_warp._calls.launches import Launches

DEFAULT_NUM_ROUNDS = 8
_MOST_ROUNDS = 100


_T = TypeVar("_T")
_StepT = TypeVar("_StepT", bound=HostStep)


class CollisionPipeline:
    """All functions on one mesh with one set of options, for a time loop.

    A pipeline keeps the topology, the trees of static bodies and all buffers, so a step no larger than an earlier one
    allocates nothing but its result. :meth:`launch` and :meth:`launch_line_search` work on device arrays only and can
    be captured in a graph; the other methods take and return NumPy arrays. The one-shot functions call these methods on
    a temporary pipeline whose buffers are cached with the mesh.

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
        """Make a pipeline for a mesh with options.

        Args:
            mesh: The bodies.
            max_pairs: Capacity for pairs, as in :meth:`reserve`.
            max_contacts: Capacity for contacts, as in :meth:`reserve`.
            **options: Options of :class:`ccd_warp.MeshOptions`.

        Raises:
            ValueError: If an option is out of its range.
            TypeError: If there is no such option.
        """
        checked_options = options_of("CollisionPipeline", MeshOptions, options, others=["max_pairs", "max_contacts"])
        check_instance("mesh", mesh, CollisionMesh)
        self._set_up(checked_options, Workspace(mesh, resolve_device(checked_options.device)))
        if max_pairs is not None or max_contacts is not None:
            with naming("CollisionPipeline"):
                self._launches.set_capacities(max_pairs, max_contacts)

    def _set_up(self, options: Options, workspace: Workspace) -> None:
        self.mesh = workspace.topology.mesh
        self.counts = Counts()
        self.timings: dict[str, float] = {}
        self._options = options
        self._topology = workspace.topology
        # A call takes it out while it uses it and puts it back only if it succeeds, so that no inconsistent state is
        # used again.
        self._workspace: Workspace | None = workspace
        self._show_progress: Callable[[Progress], None] | None = None  # the command line has a line of its own
        self._lock = threading.Lock()
        norm_of(self.mesh, options)

    @property
    def radius(self) -> wp.array | None:
        """The radii of the vertices that launches read, float64, shape [V]; None if the mesh was made without.

        It begins as a copy of ``mesh.radius`` and stays the same array, to which the caller, or a captured graph, may
        write others between launches. Every launch reads it anew. A radius that is negative or not finite counts as a
        coordinate that is not finite does: its world has toi 0 and a flag. Calls with NumPy arrays use ``mesh.radius``.
        """
        return self._launches.radius

    @lazy_property
    def _launches(self) -> Launches:
        """The steps on the device, with capacities and radii of their own."""
        from ccd_warp._calls.launches import Launches  # programs on the host have no use for it

        return Launches(self._topology, self._options)

    def _warn_once(self, what: str, message: Callable[[], str]) -> None:
        """Say something of launches once."""
        self._workspace = self._workspace or Workspace(self.mesh, self._topology.device)
        self._workspace.warn_once(what, message)

    @classmethod
    @contextmanager
    def _borrowed(cls, mesh: CollisionMesh, options: Options) -> Iterator[CollisionPipeline]:
        """A pipeline for one call, on a workspace cached with the mesh that no other thread uses meanwhile."""
        check_instance("mesh", mesh, CollisionMesh)
        device = resolve_device(options.device)
        idle = MeshCache.of(mesh).idle_workspaces.setdefault(str(device), [])
        try:
            workspace = idle.pop()
        except IndexError:
            workspace = Workspace(mesh, device)
        pipeline = cls.__new__(cls)
        pipeline._set_up(options, workspace)
        try:
            yield pipeline
        except KeyboardInterrupt as interrupt:
            raise KeyboardInterrupt(*interrupt.args) from None  # without the frames below
        finally:
            if pipeline._workspace is not None:
                idle.append(pipeline._workspace)

    def __repr__(self) -> str:
        changed = [
            f", {option.name}={shown(value)}"
            for option in fields(self._options)
            if (value := getattr(self._options, option.name)) != option.default
        ]
        return f"CollisionPipeline({self.mesh!r}{''.join(changed)}, on {self._topology.device})"

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: its contents live on a device and belong to this process."""
        raise TypeError(
            "a CollisionPipeline cannot be copied or pickled; copy or pickle its mesh and its options, "
            "and build another: CollisionPipeline(mesh, **options)"
        )

    def _on_step(
        self,
        kind: type[_StepT],
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        work: Callable[[_StepT], _T],
        motion: RigidMotion | MeshPaths | None = None,
    ) -> _T:
        """Run ``work`` on a step of a kind and return its result."""
        paths = None if motion is None else paths_of(self.mesh, self._options, motion)

        def frames() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            start, end = self.mesh.frames(vertices_t0, vertices_t1)
            if paths is not None:
                check_own_frames(self.mesh, start, end)
            return start, end

        return self._run(kind, frames, work, paths=paths)

    def _warn_of_straight_motion(self, motion: RigidMotion | None) -> None:
        """Say once, in a call without a motion, that rigid bodies then move as others do."""
        if motion is None and len(self.mesh._moving_rigid) and self._workspace is not None:
            self._workspace.warn_once("no motion", lambda: straight_sentence(self.mesh))

    def _run(
        self,
        kind: type[_StepT],
        frames: Callable[[], tuple[NDArray[np.float64], NDArray[np.float64]]],
        work: Callable[[_StepT], _T],
        **further: Any,
    ) -> _T:
        """Run ``work`` on a step of a kind between validated positions."""
        self._check_no_capture()
        # what a step frees is freed in the order of the null stream
        with self._lock, in_current_order(self._topology.device):
            begin = time.perf_counter()
            start, end = self.mesh._both_in_space(*frames())
            workspace, self._workspace = self._workspace, None
            if workspace is None:
                workspace = Workspace(self.mesh, self._topology.device)
            seconds = time.perf_counter() - begin
            try:
                with kind(workspace, (start, end), self._options, **further) as step:
                    step.workspace.progress.show = self._show_progress
                    step.timings["input"] = seconds
                    result = work(step)
            except KeyboardInterrupt as interrupt:
                raise interrupt.with_traceback(None) from None  # the frames below say nothing to who has ended it
            self.timings = step.timings
            self.counts = step.counts
            self._workspace = workspace
        return result

    def _check_no_capture(self) -> None:
        """Check that the device is not captured in a graph, which a call that waits for it cannot be part of."""
        if self._topology.device.is_capturing:
            raise RuntimeError("a graph is being captured, and this call waits for the device; launch() does not")

    def reserve(
        self, *, max_pairs: int | None = None, max_contacts: int | None = None, vertices: ArrayLike | None = None
    ) -> LaunchResult[RigidMotion]:
        """Allocate everything that :meth:`launch` needs: before the loop, and again after an overflow flag.

        What :meth:`launch_proximity` and :meth:`launch_displacement_bounds` need is allocated by their first calls.

        Later launches no longer write to the previous result. A graph captured before still writes to it, as long as
        that result is kept alive: capture a new graph. A distance of pairs that is three median edges long, or more, is
        warned of here, and where a first launch begins, once.

        Args:
            max_pairs: Capacity for the pairs of each kind that the cull leaves, 8 bytes each. On CUDA 40, with
                the list of candidates, four for each pair, and 96 more for a queue that all kinds share. Default:
                unchanged; initially one for each primitive, and at least 4,096.
            max_contacts: Capacity for contacts, 80 bytes each, and for what :meth:`launch_proximity` lists, 64 bytes
                each. Default: unchanged; initially one for each vertex, and at least 4,096.
            vertices: Positions that are typical of the loop, shape [V, 3]. The trees are laid out for them, and static
                bodies stay there until a launch gives them other positions. Default: unchanged; initially those of the
                mesh. An unsuitable layout costs time but never misses a collision.

        Returns:
            The arrays to which later launches write.

        Raises:
            ValueError: If a capacity is out of its range, or the positions do not match the mesh.
            RuntimeError: If a graph is being captured.
            MemoryError: If the device has not as much memory; the pipeline stays as it was.
        """
        with self._lock:
            return self._launches.reserve(max_pairs, max_contacts, vertices, self._warn_once)

    def launch(
        self,
        vertices_t0: DeviceArray,
        vertices_t1: DeviceArray | None = None,
        *,
        displacements: DeviceArray | None = None,
        motion: RigidMotion | None = None,
    ) -> LaunchResult[RigidMotion]:
        """Check a step for collisions on the device, without waiting for the result.

        This is for time loops on the device. Kernels of fixed sizes, recorded at the first call, read the positions and
        write the arrays of the result. A call allocates nothing, copies nothing to or from the host and does not wait,
        so it can be captured in a graph (``wp.ScopedCapture``, on CUDA and on the CPU) and replayed with the current
        contents of the same arrays; on CUDA a first call outside the capture is required. Float64 positions of a mesh
        without static bodies are read in place; others are converted by the kernel that checks them. Outside a capture,
        positions of NumPy arrays of up to 32,768 rows are copied, which is faster.

        ``memory_limit`` is ignored here; the capacities are the limits.

        Inside a ``wp.Tape``, where an array or ``radius`` requires a gradient, one function is recorded, and the tois
        of the result, arrays of this launch alone, require one; without a motion.

        Args:
            vertices_t0: Start positions on the pipeline's device: a contiguous array of Warp, NumPy, or any library
                that supports DLPack, of vec3f or vec3d and shape [V], or of float32 or float64 and shape [V, 3]; or
                rows of the moving vertices only, if the static bodies stay where they were. Of a mesh whose W worlds
                have equally many vertices, n each, also of shape [W, n] or [W, n, 3]. Of a mesh in the plane vec2f or
                vec2d, and 2 in place of 3.
            vertices_t1: End positions of the same type; or rows of the moving vertices only. A static body whose rows
                differ from those of its start has moved: its world has toi 0 and ``LaunchFlag.STATIC_MOVED``.
            displacements: Displacements in place of end positions; they are added to the start positions in float64. A
                solver that adds them in float32 must pass the resulting positions instead, because its rounding is part
                of the motion.
            motion: How the rigid bodies turn, as in :func:`ccd_warp.mesh_ccd`; their rows are read from
                ``vertices_t0``. Its numbers are read on the host, so such a launch is no part of a graph. It writes to
                arrays of its own, whose list has a pair again for each slice of the step in which it touches, one slice
                for each 0.2 radians; ``to_host()`` keeps the first. One of W worlds for a mesh of one launches what
                :meth:`ccd_warp.CollisionMesh.replicate` of W would, whose capacities are for all worlds.

        Returns:
            The arrays to which the launch writes, the same ones until the next :meth:`reserve`.

        Raises:
            ValueError: If an array or the motion is not as described, or if both or neither of ``vertices_t1`` and
                ``displacements`` are given.
            RuntimeError: If a CUDA graph is being captured, and there was no earlier call with arrays of these types.
                If there are rows of moving vertices alone, after static bodies were placed by a launch with a motion
                where there is none now, or the other way round.

        References:
            As for :func:`ccd_warp.mesh_ccd`.

        Guarantee: as for :func:`ccd_warp.mesh_ccd`, for the scene and for each world, body and vertex, whatever the
        flags. A pair that exceeds the capacity counts with toi 0, and a world with a coordinate that is not finite, or
        a static body that moves, has toi 0.
        """
        if (vertices_t1 is None) == (displacements is None):
            which = "both" if vertices_t1 is not None else "neither"
            raise ValueError(f"{which} of vertices_t1 and displacements is given; expected one of them")
        if vertices_t1 is not None:
            return self._launch(vertices_t0, vertices_t1, motion)
        assert displacements is not None
        return self._launch(vertices_t0, displacements, motion, name_t1="displacements", is_displacement=True)

    def launch_line_search(
        self,
        vertices_t0: DeviceArray,
        vertices_t1: DeviceArray,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        num_rounds: int = DEFAULT_NUM_ROUNDS,
        motion: RigidMotion | None = None,
    ) -> LaunchResult[RigidMotion]:
        """Shorten a step on the device until it is certain to be free of collisions, without waiting for the result.

        Each pass checks the step as :meth:`launch` does, and then limits the motion of every vertex of a contact, and
        of all vertices that share its fraction, to ``safety`` times the toi. Bodies or vertices with their own
        fractions that touch in a third pass stay where they are, which may stop others in turn. The last pass but one
        has one fraction for each world that still touches, and in the final pass a world that touches even then stays
        where it is. With one fraction for the scene or for each world there are three passes. The number of launches is
        always the same, so that a graph can contain them; a world that a pass finds free of contacts has no boxes in
        the following passes.

        A small gap is lost in the rounding of a long motion, and the toi is then 0. Where the first pass finds a toi
        below 1e-6, the pair is therefore allowed to move by at least an eighth of its gap. If its toi is 0 in the
        second pass, its vertices, and all that share their fraction, stay where they are. With one fraction for each
        body or vertex this requires ``num_rounds`` of at least 4.

        What starts within its distance may part and slide, and comes no closer, by default (``start_gap_fraction``).
        Where the first pass finds a contact that starts so close, what is near at the start is searched for, and the
        pass is made again; all passes of such a pipeline, if it keeps a distance, are solved in float64.

        Inside a ``wp.Tape``, ``vertices_t1`` has to require a gradient where anything does: the backward pass turns
        that of the shortened positions, which stand there, into that of the desired ones. ``is_regular()`` of the
        result says which of them have a derivative.

        Stationary pairs are ignored: primitives whose vertices all stay where they are may touch. Kinematic bodies move
        as they are told. Where one meets vertices that stay, it passes through them: its world and the scene have
        ``LaunchFlag.STRUCK``, and no toi is lowered by such a pair. With kinematic bodies one more pass, which shortens
        nothing and keeps every toi, follows the others, and ``contacts`` are these pairs.

        Args:
            vertices_t0: Start positions, as in :meth:`launch`.
            vertices_t1: Desired end positions, of the same type; they are overwritten with those of the shortened step.
                Those of static and kinematic bodies are not written.
            per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``, as in :func:`ccd_warp.line_search`.
            safety: Fraction of its toi by which a vertex in contact may move, in (0, 1).
            num_rounds: Number of passes if bodies or vertices have their own fractions, at least 3. In a pile that
                falls one body stops another, each in a pass: fewer passes than it is high stop the whole world.
            motion: How the rigid bodies turn, as in :meth:`launch`. Each goes on its path, shortened as a whole, and
                stays rigid; their rows of ``vertices_t1`` are not written. Such a launch is no part of a graph.

        Returns:
            The result of the final pass. The toi of a world in which something moves is inf, and that of a world that
            this pass had to stop is finite. The flags cover all passes, but for that of contacts, which is of the last;
            on a tape it is of all, as each passes gradients. ``num_pairs`` are the most of any pass. With a motion,
            ``body_fraction`` and ``motion`` say where the rigid bodies are at the end.

        Raises:
            ValueError: As in :meth:`launch`, or if an option is out of its range.
            RuntimeError: As in :meth:`launch`.

        References:
            Li et al. 2020, "Incremental potential contact", section 5 (one fraction for the scene).

        Guarantee: while every vertex moves on a straight line from ``vertices_t0`` to ``vertices_t1``, no pair with a
        vertex that moves touches, or comes within its distance, or closer than one of its vertices was to something at
        the start (as in :func:`ccd_warp.line_search`), whatever the flags; but for pairs of which what is kinematic
        alone moves, and then ``LaunchFlag.STRUCK`` is set, or a flag for what was not checked. Proof: the final pass
        checked exactly these rounded positions, and where its toi was not inf free vertices do not move. A rigid body
        moves on the path of ``motion`` up to its fraction; a pair stays if, in float64, all its vertices do.
        """
        check_writable(vertices_t1, "vertices_t1")
        with naming("launch_line_search"):
            per, safety = validated_line_search(per, safety)
            num_rounds = check_count("num_rounds", num_rounds, _MOST_ROUNDS, least=3)
            check_step_is_whole(self._options.t_max)
        search = LineSearch.of(per, num_rounds)
        return self._launch(vertices_t0, vertices_t1, motion, line_search=search, safety=safety)

    def _launch(
        self,
        vertices_t0: DeviceArray,
        vertices_t1: DeviceArray,
        motion: RigidMotion | None = None,
        **arguments: Any,
    ) -> LaunchResult[RigidMotion]:
        with self._lock:
            self._warn_of_straight_motion(motion)
            return self._launches.launch(vertices_t0, vertices_t1, motion, self._warn_once, **arguments)

    def launch_proximity(self, positions: DeviceArray, distance: float) -> DeviceProximities:
        """Find what is near at one time on the device, without waiting for the result.

        As :meth:`launch`, for loops on the device: a call allocates nothing after the first, does not wait, and can be
        captured in a graph, with the distance of that call. Two launches of this kind write to one result.

        Args:
            positions: Positions of all vertices, those of static bodies as well, as ``vertices_t0`` of :meth:`launch`.
            distance: Largest Euclidean distance of a pair, as in :func:`ccd_warp.find_proximity`.

        Returns:
            The arrays to which the launch writes, the same ones until the next :meth:`reserve`. They have capacity for
            ``max_contacts`` pairs, of ``max_pairs`` that the cull leaves of each kind.

        Raises:
            ValueError: If the positions are not as described, or the distance is out of its range; or if the positions
                or ``radius`` require a gradient inside a ``wp.Tape``, as only times of impact have one.
            RuntimeError: If a graph is being captured, and there was no earlier call with an array of this type.

        Guarantee: as for :func:`ccd_warp.find_proximity`, where no flag is set; a flag says that pairs may be missing.
        """
        from ccd_warp._at_one_time.device_step import DeviceProximityStep  # few programs need it

        with naming("launch_proximity"):
            distance = validated_distance(distance)
        with self._lock:
            return self._launches.launch_at_one_time(DeviceProximityStep, positions, distance, self._warn_once)

    def launch_displacement_bounds(self, positions: DeviceArray, search_radius: float) -> DeviceDisplacements:
        """For each vertex a length by which it may move, on the device, without waiting for the result.

        Args:
            positions: Positions of all vertices, those of static bodies as well, as ``vertices_t0`` of :meth:`launch`.
            search_radius: Distance beyond which nothing counts as near, as in :func:`ccd_warp.displacement_bounds`.

        Returns:
            The arrays to which the launch writes, the same ones until the next :meth:`reserve`.

        Raises:
            ValueError: As in :meth:`displacement_bounds`, or if the positions are not as described; or if they or
                ``radius`` require a gradient inside a ``wp.Tape``, as only times of impact have one.
            RuntimeError: If a graph is being captured, and there was no earlier call with an array of this type.

        Guarantee: as for :func:`ccd_warp.displacement_bounds`, whatever the flags. The vertices of a pair that exceeds
        the capacity, and those of a world with a coordinate that is not finite, have bound 0.
        """
        from ccd_warp._at_one_time.device_step import DeviceDisplacementStep

        with naming("launch_displacement_bounds"):
            search_radius = validated_search_radius(search_radius, self._options)
        with self._lock:
            launch = self._launches.launch_at_one_time
            return launch(DeviceDisplacementStep, positions, search_radius, self._warn_once)

    def find_candidates(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        inflation: float = 0.0,
        *,
        motion: RigidMotion | None = None,
    ) -> Candidates:
        """Find the pairs of primitives whose swept boxes overlap: :func:`ccd_warp.find_candidates` says which."""
        from ccd_warp._engine.host.candidate_step import CandidateStep  # few programs need it

        with naming("find_candidates"):
            inflation = validated_inflation(inflation)
        self._warn_of_straight_motion(motion)
        work = lambda step: step.candidates(inflation)  # noqa: E731
        return self._on_step(CandidateStep, vertices_t0, vertices_t1, work, motion)

    def find_intersections(self, positions: ArrayLike) -> Intersections:
        """Find the pairs that touch or cross at one time, exactly (:func:`ccd_warp.find_intersections`)."""
        from ccd_warp._at_one_time.intersection_step import IntersectionStep  # few programs need it

        return self._run(IntersectionStep, lambda: self._one_frame(positions), IntersectionStep.intersections)

    def find_proximity(self, positions: ArrayLike, distance: float, *, unique: bool = False) -> Proximities:
        """Find the pairs within a Euclidean distance at one time (:func:`ccd_warp.find_proximity`).

        Separations of the pipeline play no part.
        """
        from ccd_warp._at_one_time.proximity_step import ProximityStep  # few programs need it

        with naming("find_proximity"):
            distance, unique = validated_distance(distance), check_flag("unique", unique)
        work = lambda step: step.proximities(distance, unique=unique)  # noqa: E731
        return self._run(ProximityStep, lambda: self._one_frame(positions), work)

    def displacement_bounds(self, positions: ArrayLike, search_radius: float) -> NDArray[np.float64]:
        """Lengths by which vertices may move (:func:`ccd_warp.displacement_bounds`).

        They keep the ``minimum_distance`` of the pipeline, which must have no ``minimum_separation``.
        """
        from ccd_warp._at_one_time.proximity_step import DisplacementStep

        with naming("displacement_bounds"):
            search_radius = validated_search_radius(search_radius, self._options)
        return self._run(DisplacementStep, lambda: self._one_frame(positions), lambda step: step.bounds(search_radius))

    def _one_frame(self, positions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions at one time, as both ends of a step."""
        frame = self.mesh.frame(positions, "positions")
        return frame, frame

    def mesh_ccd(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        motion: RigidMotion | None = None,
        check_start: bool = False,
    ) -> MeshResult:
        """Earliest times of impact in a step (:func:`ccd_warp.mesh_ccd`)."""
        with naming("mesh_ccd"):
            check_start = check_flag("check_start", check_start)
        self._warn_of_straight_motion(motion)
        worlds = worlds_of(self, vertices_t0, vertices_t1, motion, check_start=check_start)
        if worlds is not None:
            result = worlds.result()
            self.counts, self.timings = result.counts, result.timings
        else:
            result = self._contacts(vertices_t0, vertices_t1, motion)
        return replace(result, start=self._checked_start(vertices_t0, motion)) if check_start else result

    def _contacts(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        motion: RigidMotion | MeshPaths | None,
        *,
        is_ordered: bool = True,
    ) -> MeshResult:
        """The contacts of a step."""
        contacts = partial(ContactStep.contacts, is_ordered=is_ordered, is_placed=is_ordered)
        return self._on_step(ContactStep, vertices_t0, vertices_t1, contacts, motion)

    def _checked_start(self, vertices_t0: ArrayLike, motion: RigidMotion | None = None) -> Intersections:
        """What intersects at the start of the step of the last call, with a warning where surfaces cross."""
        if motion is not None:
            vertices_t0 = start_of(self.mesh, self._options, vertices_t0, motion)
        counts, timings = self.counts, self.timings
        start = self.find_intersections(vertices_t0)
        timings["intersections at start"] = self.timings["total"]
        timings["total"] += self.timings["total"]
        self.counts, self.timings = counts, timings
        if start.num_crossing:
            crossing = start[start.is_crossing]
            of_bodies = "crossing", frozenset(crossing.by_bodies())
            if self._workspace is not None:
                said = f"at the start {crossing.describe()}; what crosses already is not seen in the step"
                self._workspace.warn_once(of_bodies, lambda: said)
        return start

    def collision_free_step(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        motion: RigidMotion | None = None,
        check_start: bool = False,
    ) -> float:
        """Largest fraction of a step that is surely free of collisions (:func:`ccd_warp.collision_free_step`)."""
        with naming("collision_free_step"):
            check_start = check_flag("check_start", check_start)
        self._warn_of_straight_motion(motion)
        least = self._least_of_worlds(vertices_t0, vertices_t1, motion, check_start=check_start)
        toi = min(least, self._options.t_max)
        if check_start:
            self._checked_start(vertices_t0, motion)
        return toi

    def _least_of_worlds(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        motion: RigidMotion | None,
        *,
        check_start: bool,
        any_suffices: bool = False,
    ) -> float:
        """The earliest toi of a step, also where a motion has many worlds; inf if it is free."""
        worlds = worlds_of(self, vertices_t0, vertices_t1, motion, check_start=check_start)
        if worlds is None:
            return self._least_toi(vertices_t0, vertices_t1, motion, any_suffices=any_suffices)
        least = worlds.least_toi(any_suffices=any_suffices)
        self.counts, self.timings = worlds.counts(), worlds.timings
        return least

    def _least_toi(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        motion: RigidMotion | MeshPaths | None = None,
        *,
        any_suffices: bool = False,
        of_parts: LeastOfParts = of_one_part,
    ) -> float:
        """The earliest toi of a step in which, unless the options say otherwise, what starts close may part.

        Where any toi suffices, what starts close is a contact. Where the mesh is a part of another, it is that of all.
        """
        on_step = partial(self._on_step, LeastToiStep, vertices_t0, vertices_t1, motion=motion)
        near = None if any_suffices else self._start_distances(of_parts)
        if near is None:
            return in_all_parts(of_parts, on_step(work=lambda step: step.least_toi(any_suffices=any_suffices)))
        of_part, pairs = on_step(work=LeastToiStep.earliest)
        toi = in_all_parts(of_parts, of_part)
        if toi == np.inf:
            return toi
        # what starts within its distance has toi 0, whichever way it moves; what is a rounding beyond it and slides has
        # any toi
        start = start_of(self.mesh, self._options, vertices_t0, motion)
        end = start if motion is not None or pairs is None else self.mesh.frame(vertices_t1, "vertices_t1")
        if near.are_near(start, Ends(start, end, motion), pairs, are_first=toi == of_part):
            distances = near.of(start)
            if distances is not None:
                toi = max(toi, in_all_parts(of_parts, on_step(work=lambda step: step.least_toi(distances))))
        return toi

    def _start_distances(self, of_parts: LeastOfParts = of_one_part) -> StartDistances | None:
        """What finds how near vertices are at the start; None where pairs keep no distance within which they may."""
        mesh = self.mesh
        if not keeps_start_distances(mesh, self._options):
            return None

        def on_step(work: Callable[[Any], _T], start: NDArray[np.float64], end: NDArray[np.float64]) -> _T:
            from ccd_warp._at_one_time.start_distance_step import StartDistanceStep  # few programs need it

            of_call = self.counts, self.timings
            result = self._run(StartDistanceStep, lambda: (start, end), work)
            self.counts, self.timings = of_call
            return result

        distance = largest_start_distance(mesh, self._options, mesh._largest_radius)
        return StartDistances(distance, mesh.vertex_world, on_step, of_parts)

    def is_step_collision_free(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        motion: RigidMotion | None = None,
        check_start: bool = False,
    ) -> bool:
        """Whether a step is certain to be free of collisions (:func:`ccd_warp.is_step_collision_free`)."""
        with naming("is_step_collision_free"):
            check_start = check_flag("check_start", check_start)
        self._warn_of_straight_motion(motion)
        least = self._least_of_worlds(vertices_t0, vertices_t1, motion, check_start=check_start, any_suffices=True)
        if not check_start:
            return least == np.inf
        return self._checked_start(vertices_t0, motion).num_crossing == 0 and least == np.inf

    def line_search(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        max_rounds: int = DEFAULT_MAX_ROUNDS,
        motion: RigidMotion | None = None,
        check_start: bool = False,
    ) -> LineSearchResult[RigidMotion]:
        """Shorten a step until it is free of collisions (:func:`ccd_warp.line_search`), with a ``t_max`` of 1."""
        with naming("line_search"):
            check_step_is_whole(self._options.t_max)
            per, safety = validated_line_search(per, safety)
            max_rounds = check_count("max_rounds", max_rounds, 2**31 - 1, least=3)
            check_start = check_flag("check_start", check_start)
        self._warn_of_straight_motion(motion)
        frames = self.mesh.frames(vertices_t0, vertices_t1)
        paths = None if motion is None else paths_of(self.mesh, self._options, motion)
        course = course_of(self.mesh, *frames, paths, motion)
        rounds = self._rounds_of(course, per=per, safety=safety, max_rounds=max_rounds)
        result = rounds.result(begins_at_rest=self._reaches_neighbours(course.start))
        return replace(result, start=self._checked_start(vertices_t0, motion)) if check_start else result

    def _rounds_of(self, course: Course, of_parts: LeastOfParts = of_one_part, **how: Any) -> LineSearchRounds:
        """A line search; where the mesh is a part of another, all parts search together."""

        def on_step(ends: Ends, work: Callable[[ContactStep], MeshResult]) -> MeshResult:
            return self._on_step(ContactStep, ends.start, ends.end, work, ends.paths)

        return LineSearchRounds(self.mesh, course, on_step, self._start_distances(of_parts), of_parts=of_parts, **how)

    def _reaches_neighbours(self, vertices_t0: ArrayLike) -> bool:
        """Whether pairs count as touching at many times the length of an edge, so that everything may do so already."""
        separation = self._options.separation(length_scale_of(self.mesh, self._options))
        if self._options.start_gap_share > 0.0 or not (separation > 0.0 or self.mesh.is_thick):
            return False  # what is within its distance may come closer, or there is none
        start = self.mesh._in_space(self.mesh.frame(vertices_t0))
        return DistanceInEdges.of(self._topology, start, separation) is not None


def validated_distance(distance: float) -> float:
    """The argument ``distance``, validated."""
    return check_real("distance", distance, "a finite length of at least 0", lambda x: x >= 0)


def validated_search_radius(search_radius: float, options: Options) -> float:
    """The argument ``search_radius``, validated, for which the options must have no other separation."""
    if options.minimum_separation > 0:
        raise ValueError(
            f"minimum_separation is {options.minimum_separation}; expected 0, and minimum_distance in its place: "
            f"bounds of displacements are Euclidean"
        )
    return check_real("search_radius", search_radius, "a finite length above 0", lambda x: x > 0)
