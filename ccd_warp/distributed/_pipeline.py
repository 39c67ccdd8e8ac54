"""The mesh functions on a mesh whose parts lie on several ranks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, Unpack

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.motions import check_options_on_arcs
from ccd_warp._calls.pipeline import validated_distance, validated_search_radius
from ccd_warp._engine.host.candidates import validated_inflation
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
from ccd_warp._engine.host.start_distances import StartDistances
from ccd_warp._engine.host.step import Step
from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.lengths import add_rounded_up, half_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._engine.mesh.start_distances import keeps_start_distances, largest_start_distance
from ccd_warp._engine.motion import moved
from ccd_warp._results.results import MeshResult
from ccd_warp._rigid.mesh_paths import MeshPaths
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.rotations import in_space
from ccd_warp._runtime.quiet import start_warp
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import Per, check_count, check_instance
from ccd_warp._scene.input.option_types import MeshOptions
from ccd_warp._scene.input.options import naming, options_of, resolve_device
from ccd_warp.distributed._across_ranks import work_by_vertex
from ccd_warp.distributed._intersections import DistributedIntersections
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._partition import imbalance
from ccd_warp.distributed._plan import is_within
from ccd_warp.distributed._planning import (
    WORK_OF_CANDIDATE,
    WORK_OF_PAIR,
    WORK_OF_PRIMITIVE,
    Plan,
    make_plan,
    work_of_owners,
)
from ccd_warp.distributed._results import (
    DistributedCandidates,
    DistributedContacts,
    DistributedLineSearch,
    DistributedProximities,
    DistributedResult,
    RankWork,
    candidates_of,
    of_part,
)

# The imbalance of the measured work above which a plan is made anew: if it was made for less knowledge, so that it has
# become better by this factor, or if it has become worse by that one since the plan was made.
_MOST_IMBALANCE = 1.3
_IMPROVED = 0.9
_WORSE = 1.1

if TYPE_CHECKING:
    from ccd_warp.distributed._motion import LocalPaths

_T = TypeVar("_T")
_StepT = TypeVar("_StepT", bound=Step)


class DistributedPipeline:
    """The mesh functions on the parts of several ranks, for a time loop; every call is collective.

    All ranks call the same functions in the same order, each with the positions of its own vertices. A call brings the
    positions to the ranks in whose regions the primitives lie, searches and solves there, and brings what was found
    back to the owners. The plan of who has which primitives is kept from step to step. Results are those of one process
    with the whole mesh, in every bit, for every number of ranks and every distribution of the mesh over them.

    Attributes:
        mesh: The mesh.
        work: What this rank did in the last call; None before the first.
    """

    def __init__(self, mesh: DistributedMesh, **options: Unpack[MeshOptions]) -> None:
        """Make a pipeline, collectively.

        Args:
            mesh: The mesh.
            **options: Options of :class:`ccd_warp.MeshOptions`, the same on all ranks but for ``device``,
                ``num_threads`` and ``memory_limit``, which are those of a rank. By default the ranks of a machine take
                its CUDA devices in turns, or share its cores where it has none.

        Raises:
            ValueError: On all ranks, if an option of one is out of its range, or differs between ranks.
            TypeError: On all ranks, if there is no such option.
        """
        check_instance("mesh", mesh, DistributedMesh)
        self.mesh = mesh
        self.work: RankWork | None = None
        self._ranks = ranks = mesh.ranks
        with ranks.together("DistributedPipeline"):
            rank_options: dict[str, Any] = dict(options)
            if rank_options.get("device") is None:
                rank_options["device"] = _device_of(ranks.local_rank)
            rank_options.setdefault("num_threads", ranks.default_num_threads)
            self._options = options_of("DistributedPipeline", MeshOptions, rank_options)  # type: ignore[arg-type]
            self._device = resolve_device(self._options.device)
            self._check_same_options()
            norm_of(_Thickness(mesh.body_radius), self._options)  # type: ignore[arg-type]
            self._number = ranks.next_pipeline()
        self._plan: Plan | None = None
        self._workspace: Workspace | None = None
        self._work: NDArray[np.float64] | None = None  # by the vertices that this rank owns, when it last mattered
        self._wants_plan = False
        self._last_imbalance = np.inf  # of the first step of the plan before
        self._local: LocalPaths | None = None  # the motion of the call
        self._paths: MeshPaths | None = None

    def __repr__(self) -> str:
        return f"DistributedPipeline({self.mesh!r}, on {self._device})"

    def _check_same_options(self) -> None:
        o = self._options
        numbers = [o.tolerance, o.minimum_separation, o.minimum_distance, o.start_gap_share, o.keeps_start_distances]
        numbers += [o.t_max, o.max_iterations, o.max_work, o.length_scale or 0.0, o.precision == "float32"]
        numbers += [o.method == "bisection", o.broad_phase == "hash", *(kind in o.kinds for kind in PairKind)]
        values = np.array(numbers, dtype=np.float64)
        if not np.array_equal(self._ranks.least(values), self._ranks.most(values)):
            raise ValueError(
                "options differ between ranks; expected the same on all, but for device, num_threads and memory_limit"
            )

    def mesh_ccd(
        self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: RigidMotion | None = None
    ) -> DistributedResult:
        """Earliest times of impact of a step of the whole mesh; all ranks call it together.

        Args:
            vertices_t0: Start positions of the vertices on this rank, shape [n, 3], or [n, 2] of a mesh in the plane.
                Rows of ghosts are ignored: the positions of the owners count.
            vertices_t1: End positions, of the same shape. Static bodies are where they start.
            motion: How the rigid bodies of the whole mesh turn, a row each, the same on all ranks; the rows of their
                vertices are in the bodies' own frames at both ends, as for :func:`ccd_warp.mesh_ccd`.

        Returns:
            What concerns this rank, and the toi of the whole mesh.

        Raises:
            ValueError: On all ranks, if an array of one is not as described; the message begins with its rank.
            RuntimeError: On all ranks, if another error occurs on one.

        Guarantee: as for :func:`ccd_warp.mesh_ccd`, for the whole mesh; every result has the bits that one process
        would give it.
        """

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> DistributedResult:
            plan = self._planned
            result: MeshResult = self._run(ContactStep, *self._ends, ContactStep.contacts, self._paths)
            with self._timed("results"):
                vertex_toi = self._to_local(result.vertex_toi)
                least = self._ranks.least(np.concatenate([[result.toi], result.body_toi, result.world_toi]))
                contacts = of_part(DistributedContacts, plan.part, result.contacts, self._ranks)
                num_contacts = int(self._ranks.total(np.array(len(contacts))))
            body = 1 + self.mesh.num_bodies
            return DistributedResult(
                float(least[0]), vertex_toi, least[1:body], least[body:], contacts, num_contacts, self._finished()
            )

        with self._together_on("mesh_ccd", motion):
            return self._collectively(vertices_t0, vertices_t1, self._inflation, work, motion=motion)

    @text_completed_by(mesh_ccd)
    def collision_free_step(
        self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: RigidMotion | None = None
    ) -> float:
        """Largest fraction of a step of the whole mesh certain to be free of collisions; all ranks call it together.

        Returns:
            A fraction of the step in [0, t_max], the same on all ranks.

        Guarantee: as for :func:`ccd_warp.collision_free_step`, for the whole mesh.
        """
        return min(self._least_toi(vertices_t0, vertices_t1, motion), self._options.t_max)

    @text_completed_by(mesh_ccd)
    def is_step_collision_free(
        self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: RigidMotion | None = None
    ) -> bool:
        """Whether a step of the whole mesh is certain to be free of collisions; all ranks call it together.

        Returns:
            True on all ranks if no pair touches in [0, t_max].

        Guarantee: True is certain.
        """
        return self._least_toi(vertices_t0, vertices_t1, motion, any_suffices=True) == np.inf

    def _least_toi(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        motion: RigidMotion | None,
        *,
        any_suffices: bool = False,
    ) -> float:
        def on_step(work: Callable[[LeastToiStep], _T]) -> _T:
            return self._run(LeastToiStep, *self._ends, work, self._paths)

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> float:
            near = None if any_suffices else self._start_distances
            if near is None:
                toi = on_step(lambda step: step.least_toi(any_suffices=any_suffices))
            else:
                toi, pairs = on_step(LeastToiStep.earliest)
                at_start = self._planned.start
                if toi < np.inf and near.are_near(at_start, Ends(at_start, self._ends[1], self._paths), pairs):
                    distances = near.of(at_start)
                    if distances is not None:
                        toi = max(toi, on_step(lambda step: step.least_toi(distances)))
            self._finished()
            return toi

        with self._together_on("is_step_collision_free" if any_suffices else "collision_free_step", motion):
            inflation = self._inflation if any_suffices else self._parting_inflation
            return self._collectively(vertices_t0, vertices_t1, inflation, work, motion=motion)

    @text_completed_by(mesh_ccd)
    def find_candidates(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        inflation: float = 0.0,
        *,
        motion: RigidMotion | None = None,
    ) -> DistributedCandidates:
        """Find the pairs of the whole mesh whose swept boxes overlap; all ranks call it together.

        Args:
            inflation: Enlargement of every box on every side, a length, the same on all ranks.

        Returns:
            The pairs that this rank has found, in lexicographic order.

        Guarantee: every pair that passes the filter and whose boxes overlap is found once, on one rank.
        """

        from ccd_warp._engine.host.candidate_step import CandidateStep  # few programs need it

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> DistributedCandidates:
            plan = self._planned
            candidates = self._run(CandidateStep, *self._ends, lambda step: step.candidates(inflation), self._paths)
            pairs_of_mesh = candidates_of(plan.part, plan.topology, candidates, self._ranks)
            self._finished()
            return pairs_of_mesh

        with self._together_on("find_candidates", motion):
            with naming("find_candidates"):
                inflation = validated_inflation(inflation)
            self._check_same_length("inflation", inflation)
            return self._collectively(vertices_t0, vertices_t1, inflation, work, motion=motion)

    @text_completed_by(mesh_ccd)
    def find_proximity(self, positions: ArrayLike, distance: float) -> DistributedProximities:
        """Find the pairs of the whole mesh within a distance at one time; all ranks call it together.

        Args:
            positions: Positions of the vertices on this rank at one time, as in :meth:`mesh_ccd`.
            distance: Largest Euclidean distance of a pair, a length, the same on all ranks.

        Returns:
            The pairs that this rank has found.

        Guarantee: every pair that passes the filter and is within the distance is found once, on one rank.
        """
        from ccd_warp._at_one_time.proximity_step import ProximityStep  # few programs need it

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> DistributedProximities:
            plan = self._planned
            proximities = self._run(ProximityStep, plan.start, plan.start, lambda step: step.proximities(distance))
            pairs_of_mesh = of_part(DistributedProximities, plan.part, proximities, self._ranks)
            self._finished()
            return pairs_of_mesh

        with self._together("find_proximity"):
            with naming("find_proximity"):
                distance = validated_distance(distance)
            self._check_same_length("distance", distance)
            return self._collectively(positions, positions, half_rounded_up(distance), work, name_t0="positions")

    @text_completed_by(mesh_ccd)
    def displacement_bounds(self, positions: ArrayLike, search_radius: float) -> NDArray[np.float64]:
        """For each vertex on this rank a length by which it may move; all ranks call it together.

        Args:
            positions: Positions of the vertices on this rank at one time, as in :meth:`mesh_ccd`.
            search_radius: Distance beyond which nothing counts as near, a length, the same on all ranks.

        Returns:
            For each vertex on this rank, ghosts too, the length by which it may move, float64, shape [n].

        Raises:
            ValueError: As in :meth:`mesh_ccd`, or if the pipeline has a ``minimum_separation``, which is none in the
                Euclidean norm.

        Guarantee: as for :func:`ccd_warp.displacement_bounds`, for the whole mesh.
        """
        from ccd_warp._at_one_time.proximity_step import DisplacementStep  # few programs need it

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
            plan = self._planned
            bounds_of_part = self._run(
                DisplacementStep, plan.start, plan.start, lambda step: step.bounds(search_radius)
            )
            with self._timed("results"):
                bounds = self._to_local(bounds_of_part)
            self._finished()
            return bounds

        with self._together("displacement_bounds"):
            with naming("displacement_bounds"):
                search_radius = validated_search_radius(search_radius, self._options)
            self._check_same_length("search_radius", search_radius)
            inflation = half_rounded_up(add_rounded_up(search_radius, self._options.minimum_distance))
            return self._collectively(positions, positions, inflation, work, name_t0="positions")

    @text_completed_by(mesh_ccd)
    def find_intersections(self, positions: ArrayLike) -> DistributedIntersections:
        """Find the pairs of the whole mesh that touch or cross at one time; all ranks call it together.

        Args:
            positions: Positions of the vertices on this rank at one time, as in :meth:`mesh_ccd`.

        Returns:
            The pairs that this rank has found, and the number of those of all ranks.

        Guarantee: every pair that passes the filter and touches or passes through each other is found once, on one
        rank, and no other pair is.
        """
        from ccd_warp.distributed._part_intersections import PartIntersectionStep  # few programs need it

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> DistributedIntersections:
            plan = self._planned
            intersections = self._run(PartIntersectionStep, plan.start, plan.start, PartIntersectionStep.intersections)
            total = int(self._ranks.total(np.array(len(intersections))))
            pairs_of_mesh = of_part(
                DistributedIntersections, plan.part, intersections, self._ranks, num_intersections=total
            )
            self._finished()
            return pairs_of_mesh

        with self._together("find_intersections"):
            # boxes need no enlargement here; with that of a step, a plan serves both
            return self._collectively(positions, positions, self._inflation, work, name_t0="positions")

    def _check_same_length(self, name: str, length: float) -> None:
        least, negative = self._ranks.agree(length, -length)
        if least != -negative:
            raise ValueError(f"{name} is {least} on one rank and {-negative} on another; expected the same on all")

    @text_completed_by(mesh_ccd)
    def line_search(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        max_rounds: int = DEFAULT_MAX_ROUNDS,
        motion: RigidMotion | None = None,
    ) -> DistributedLineSearch:
        """Shorten a step of the whole mesh until it is free of collisions; all ranks call it together.

        Args:
            vertices_t0: Start positions of the vertices on this rank, as in :meth:`mesh_ccd`.
            vertices_t1: Desired end positions, of the same shape.
            per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``; this and what follows the same on all ranks.
            safety: Fraction of its toi by which a vertex in contact may move.
            max_rounds: Largest number of steps that are checked.
            motion: How the rigid bodies turn, as in :meth:`mesh_ccd`; each goes as far as it may, on all ranks.

        Returns:
            End positions and fractions of the vertices on this rank, ghosts too.

        Raises:
            ValueError: As in :meth:`mesh_ccd`, and if ``t_max`` is not 1.

        Guarantee: as for :func:`ccd_warp.line_search`, for the whole mesh.
        """

        def work(start: NDArray[np.float64], end: NDArray[np.float64]) -> DistributedLineSearch:
            plan = self._planned
            everywhere, course = plan.everywhere, Course(*plan.part.mesh.frames(*self._ends))
            if self._local is not None:
                from ccd_warp._rigid.arc_course import ArcCourse  # few programs need it

                course = ArcCourse(plan.part.mesh, *self._ends, self._local.paths, self._local.motion, everywhere)

            def on_step(ends: Ends, work: Callable[[ContactStep], MeshResult]) -> MeshResult:
                return self._run(ContactStep, ends.start, ends.end, work, ends.paths)

            how: dict[str, Any] = {"per": per, "safety": safety, "max_rounds": max_rounds, "everywhere": everywhere}
            result = LineSearchRounds(plan.part.mesh, course, on_step, self._start_distances, **how).result()
            fraction = np.full(len(start), np.inf)
            plan.part.everything.back(result.vertex_fraction, fraction, np.minimum)
            self._follow(fraction, per, is_limited=result.is_limited, turns=motion is not None)
            vertices, owned = np.empty_like(start), self.mesh.owned_rows
            # a step that is free as it was asked for ends with these bits, with the sign of every 0
            vertices[owned] = end[owned] if result.num_rounds == 1 else moved(start[owned], end[owned], fraction[owned])
            if self._local is not None and result.num_rounds > 1:
                self._local.turn(vertices, fraction)
            self.mesh.copies.forward([(vertices, vertices), (fraction, fraction)])
            part, ranks = plan.part, self._ranks
            touching, struck = (of_part(DistributedContacts, part, c, ranks) for c in (result.touching, result.struck))
            self._finished()
            of_rounds = result.num_rounds, result.is_limited
            return DistributedLineSearch(
                vertices,
                fraction,
                result.fraction,
                touching,
                *of_rounds,
                struck,
                result.motion,
                _find_shortening=lambda: of_part(DistributedContacts, part, result.shortened_by, ranks),
            )

        with self._together_on("line_search", motion):
            with naming("line_search"):
                check_step_is_whole(self._options.t_max)
                per, safety = validated_line_search(per, safety)
                max_rounds = check_count("max_rounds", max_rounds, 2**31 - 1, least=3)
            self._name_call(f"line_search(per={per!r}, safety={safety!r}, max_rounds={max_rounds!r})")
            return self._collectively(vertices_t0, vertices_t1, self._parting_inflation, work, motion=motion)

    def _follow(self, fraction: NDArray[np.float64], per: str, *, is_limited: bool, turns: bool) -> None:
        """Let vertices that take no part, which no rank is sent, go as others of their body or world do; collective."""
        mesh = self.mesh
        if not mesh._num_unused:
            return
        is_free = ~(mesh.static | mesh.kinematic)[mesh.bodies]
        shared = mesh.is_owned & ~mesh.is_unused & is_free

        def of_group(group: NDArray[np.int64], count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            """The least and the largest fraction in the group of each vertex."""
            least, most = np.ones(count), np.zeros(count)
            np.minimum.at(least, group[shared], fraction[shared])
            np.maximum.at(most, group[shared], fraction[shared])
            return self._ranks.least(least)[group], self._ranks.most(most)[group]

        least, most = of_group(mesh.worlds, mesh.num_worlds)
        of_body = of_group(mesh.bodies, mesh.num_bodies)[0]
        own_fraction = least if per in ("scene", "world") else of_body
        if per == "vertex":  # in the last rounds a world has one fraction, and a rigid body always
            own_fraction = np.where(is_limited & (least == most), least, 1.0)
            own_fraction = np.where(turns & mesh.rigid[mesh.bodies], of_body, own_fraction)
        fraction[mesh.is_unused] = np.where(is_free, own_fraction, 1.0)[mesh.is_unused]

    @property
    def _start_distances(self) -> StartDistances | None:
        """What finds how near vertices of this part are at the start; None where that does not matter."""
        if not keeps_start_distances(self.mesh, self._options):
            return None

        def on_step(work: Callable[[Any], _T], start: NDArray[np.float64], end: NDArray[np.float64]) -> _T:
            from ccd_warp._at_one_time.start_distance_step import StartDistanceStep  # few programs need it

            return self._run(StartDistanceStep, start, end, work)

        plan = self._planned
        return StartDistances(self._largest_start_distance, plan.part.mesh.vertex_world, on_step, plan.everywhere)

    @property
    def _largest_start_distance(self) -> float:
        radius = self.mesh.body_radius
        largest = 0.0 if radius is None else float(radius.max(initial=0.0))
        return largest_start_distance(self.mesh, self._options, largest)

    @property
    def _parting_inflation(self) -> float:
        """That of the boxes of calls that let what starts within its distance part and slide."""
        if not keeps_start_distances(self.mesh, self._options):
            return self._inflation
        return half_rounded_up(self._largest_start_distance)

    def _together(self, call: str) -> AbstractContextManager[None]:
        return self._ranks.together(self._named(call))

    def _together_on(self, call: str, motion: RigidMotion | None) -> AbstractContextManager[None]:
        """The same for a call on which all ranks have a motion, or none has."""
        return self._together(call if motion is None else f"{call} with a motion")

    def _name_call(self, call: str) -> None:
        self._ranks.name_call(self._named(call))

    def _named(self, call: str) -> str:
        """A call, and of which pipeline, if there are several."""
        return call if self._number == 1 else f"{call} of pipeline {self._number}"

    @property
    def _inflation(self) -> float:
        return half_rounded_up(self._options.separation(length_scale_of(self.mesh, self._options)))  # type: ignore[arg-type]

    @property
    def _planned(self) -> Plan:
        assert self._plan
        return self._plan

    def _collectively(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        inflation: float,
        work: Callable[[NDArray[np.float64], NDArray[np.float64]], _T],
        *,
        name_t0: str = "vertices_t0",
        motion: RigidMotion | None = None,
    ) -> _T:
        """Bring positions to the parts, and run ``work``, given the positions on this rank, in the world."""
        self._seconds: dict[str, float] = {}
        self._begin, self._sent_before = time.perf_counter(), self._ranks.bytes_sent
        plan = self._plan
        is_kept = is_same = False
        start, end = self.mesh.frames(vertices_t0, vertices_t1, name_t0)
        self._local, self._paths = None, None
        if motion is not None:
            from ccd_warp.distributed._motion import LocalPaths  # few programs need it

            check_options_on_arcs(self._options)
            self._local = LocalPaths(self.mesh, motion, start, end)
            self._paths = self._local.paths
            inflation = add_rounded_up(inflation, self._local.reach())
            start, end = self._local.at(0.0), self._local.at(1.0)
        if plan is not None and not self._wants_plan:
            is_kept = inflation <= plan.bounds.inflation and all(is_within(x, plan.limits) for x in (start, end))
            # by their bits, as the sign of a 0 shows in where contacts are
            is_same = np.array_equal(start[plan.static_rows].view(np.int64), plan.static_start.view(np.int64))
        self._seconds["input"] = time.perf_counter() - self._begin
        # what an interrupt on one rank may have kept it from noting is agreed, too
        has_work = float(self._work is not None)
        kept, same, has_work, self._last_imbalance = self._ranks.agree(
            float(is_kept), float(is_same), has_work, self._last_imbalance
        )
        if has_work == 0.0:
            self._work = None
        try:
            self._bring(start, end, inflation, is_kept=kept > 0.0, is_same=same > 0.0)
            self._ends = self._own_frames()
            return work(start, end)
        except BaseException:
            # whatever was half done is not used again, on no rank
            self._plan = self._workspace = None
            raise

    def _bring(
        self, start: NDArray[np.float64], end: NDArray[np.float64], inflation: float, *, is_kept: bool, is_same: bool
    ) -> None:
        """Bring the positions of a step to the parts, by a new plan where the old one does not hold."""
        self._is_planned = not is_kept
        if not is_kept:
            with self._timed("plan"):
                self._workspace = None
                start, end = start.copy(), end.copy()  # whose ghosts get the positions of their owners
                self._plan = make_plan(self.mesh, start, end, inflation, self._work, self._device)
                self._wants_plan = False
                self._workspace = Workspace(self._plan.part.mesh, self._device, self._plan.topology)
            return
        plan = self._planned
        with self._timed("positions"):
            if not self.mesh.static.any():
                plan.part.everything.forward([(start, plan.start), (end, plan.end)])
            elif is_same:
                plan.part.moving.forward([(start, plan.start), (end, plan.end)])
            else:
                plan.part.everything.forward([(start, plan.start), (end, plan.end)])
                plan.static_start = start[plan.static_rows]

    def _own_frames(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The positions of the part that a step takes: of rigid bodies, where a call has a motion, in their frames."""
        plan = self._planned
        if self._local is None:
            return plan.start, plan.end
        with self._timed("positions"):
            ends = np.empty_like(plan.start), np.empty_like(plan.end)
            plan.part.everything.forward(list(zip(self._local.positions, ends, strict=True)))
        return ends

    def _run(
        self,
        kind: type[_StepT],
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        work: Callable[[_StepT], _T],
        paths: MeshPaths | None = None,
    ) -> _T:
        """Run ``work`` on a step of a kind of the part."""
        assert self._workspace
        ends = in_space(start), in_space(end)
        with kind(self._workspace, ends, self._options, paths, self._planned.everywhere) as step:
            result = work(step)
        self._step: Step = step
        for stage, seconds in step.timings.items():
            if stage != "total":
                self._seconds[stage] = self._seconds.get(stage, 0.0) + seconds
        return result

    def _to_local(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The least value of each vertex on this rank, given those of the vertices of the parts."""
        result = np.full(len(self.mesh.vertex_ids), np.inf)
        self._planned.part.everything.back(values, result, np.minimum)
        if self.mesh.has_ghosts:
            self.mesh.copies.forward([(result, result)])
        return result

    def _finished(self) -> RankWork:
        """Measure the work of the ranks, decide whether the next step needs a new plan, and sum up."""
        plan, counts = self._planned, self._step.counts
        num_primitives, num_home = plan.num_primitives
        work = WORK_OF_PRIMITIVE * num_primitives + WORK_OF_CANDIDATE * sum(counts.num_candidates.values())
        work += WORK_OF_PAIR * sum(counts.num_after_cull.values())
        measured = imbalance(self._ranks.every(np.array([work])))
        if plan.imbalance is None:
            # a plan that is much better than the one before may be followed by a better one still
            is_improved = measured < _IMPROVED * self._last_imbalance
            plan.imbalance = self._last_imbalance = measured
        else:
            is_improved = False
        self._wants_plan = measured > _MOST_IMBALANCE and (is_improved or measured > _WORSE * plan.imbalance)
        if self._wants_plan:
            num_vertices = plan.part.mesh.num_vertices
            by_vertex = work_by_vertex(self._step, num_vertices, WORK_OF_CANDIDATE, WORK_OF_PAIR)
            self._work = work_of_owners(plan, self.mesh, by_vertex)
        self._seconds["total"] = time.perf_counter() - self._begin
        self.work = RankWork(
            counts,
            self._seconds,
            self._ranks.bytes_sent - self._sent_before,
            plan.part.everything.num_neighbours,
            num_primitives,
            num_primitives - num_home,
            measured,
            self._is_planned,
        )
        return self.work

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self._seconds[stage] = self._seconds.get(stage, 0.0) + time.perf_counter() - begin


class _Thickness(NamedTuple):
    """What `norm_of` reads of a mesh."""

    radius: NDArray[np.float64] | None


def _device_of(local_rank: int) -> str | None:
    """The device of a rank by default: the CUDA devices of its machine in turns, or None for Warp's own choice."""
    start_warp()
    count = wp.get_cuda_device_count()
    return f"cuda:{local_rank % count}" if count else None
