"""The mesh functions on a mesh whose parts lie on several ranks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Unpack

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.pipeline import validated_distance, validated_search_radius
from ccd_warp._engine.host.candidates import validated_inflation
from ccd_warp._engine.host.course import Course
from ccd_warp._engine.host.line_search import (
    DEFAULT_MAX_ROUNDS,
    DEFAULT_SAFETY,
    check_step_is_whole,
    validated_line_search,
)
from ccd_warp._engine.mesh.lengths import add_rounded_up, half_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.mesh.start_distances import keeps_start_distances, largest_start_distance
from ccd_warp._engine.motion import moved
from ccd_warp._runtime.quiet import start_warp
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import Per, check_count, check_instance, shown
from ccd_warp._scene.input.option_types import MeshOptions
from ccd_warp._scene.input.options import naming, options_of, resolve_device
from ccd_warp.distributed._mesh import DistributedMesh
from ccd_warp.distributed._plan import RankPlan, make_plan
from ccd_warp.distributed._ranks import Sent
from ccd_warp.distributed._results import (
    DistributedLineSearch,
    DistributedPairs,
    DistributedResult,
    RankWork,
    columns_of,
)

_OF_RANK = ("device", "num_threads", "memory_limit")  # options of a rank alone

_Floats = NDArray[np.float64]


class DistributedPipeline:
    """The mesh functions on the parts of several ranks, for a time loop; every call is collective.

    All ranks call the same functions in the same order, each with the positions of its own vertices. A call brings the
    positions to the ranks in whose regions the primitives lie, makes the call of one process on the part that each rank
    has there, and brings what was found back to the owners. The plan of who has which primitives is kept from step to
    step. Results are those of one process with the whole mesh.

    Attributes:
        mesh: The mesh.
        work: What this rank did in the last call; None before the first.
    """

    def __init__(self, mesh: DistributedMesh, **options: Unpack[MeshOptions]) -> None:
        """Make a pipeline, collectively.

        Args:
            mesh: The mesh.
            **options: Options of :class:`ccd_warp.MeshOptions`, the same on all ranks but for ``device``,
                ``num_threads`` and ``memory_limit``, which are those of a rank; without ``max_work``. By default the
                ranks of a machine take its CUDA devices in turns, or share its cores where it has none.

        Raises:
            ValueError: On all ranks, if an option of one is out of its range, or differs between ranks.
            TypeError: On all ranks, if there is no such option.
        """
        check_instance("mesh", mesh, DistributedMesh)
        self.mesh = mesh
        self.work: RankWork | None = None
        self._plan: RankPlan | None = None
        self._ranks, self._number = mesh.ranks, mesh.ranks.next_pipeline()
        of_all = {name: value for name, value in options.items() if name not in _OF_RANK}
        with self._ranks.together(f"DistributedPipeline({', '.join(f'{k}={v!r}' for k, v in sorted(of_all.items()))})"):
            own: dict[str, Any] = dict(options)
            if "max_work" in own:
                raise ValueError("max_work is given; expected none, as the work of all ranks has no limit in common")
            if own.get("device") is None:
                own["device"] = _device_of(self._ranks.local_rank)
            # the ranks of a machine share its cores
            own.setdefault("num_threads", max(1, len(os.sched_getaffinity(0)) // self._ranks.local_size))
            self._given, self._options = own, (o := options_of("DistributedPipeline", MeshOptions, own))  # type: ignore[arg-type]
            scale = length_scale_of(mesh, o)  # type: ignore[arg-type]
            # how near pairs come that a step is to find, radii besides, and where what starts within may part and slide
            self._distance = add_rounded_up(o.separation(scale), min(o.tolerance * scale, 1e308))
            keeps = keeps_start_distances(mesh, o)  # type: ignore[arg-type]
            within = largest_start_distance(mesh, o, mesh.largest_radius) if keeps else 0.0  # type: ignore[arg-type]
            self._parting_distance = max(self._distance, within)
            self._device = resolve_device(o.device)
            if mesh.is_thick and o.minimum_separation > 0.0:
                raise ValueError(f"minimum_separation is {o.minimum_separation} and the mesh has radii; expected none")

    def __repr__(self) -> str:
        return f"DistributedPipeline({self.mesh!r}, on {self._device})"

    def mesh_ccd(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: None = None) -> DistributedResult:
        """Earliest times of impact of a step of the whole mesh; all ranks call it together.

        Args:
            vertices_t0: Start positions of the vertices on this rank, shape [n, 3], or [n, 2] of a mesh in the plane.
                Rows of ghosts are ignored: the positions of the owners count.
            vertices_t1: End positions, of the same shape. Static bodies are where they start.
            motion: None, as bodies that turn are for one process.

        Returns:
            What concerns this rank, and the toi of the whole mesh.

        Raises:
            ValueError: On all ranks, if an array of one is not as described; the message begins with its rank.
            RuntimeError: On all ranks, if another error occurs on one.

        Guarantee: as for :func:`ccd_warp.mesh_ccd`, for the whole mesh.
        """
        with self._called("mesh_ccd", vertices_t0, vertices_t1, motion=motion) as (plan, start, end):
            result = plan.pipeline.mesh_ccd(start, end)
            vertex_toi = self._to_owners(plan, result.vertex_toi)
            least = self._ranks.least(np.concatenate([[result.toi], result.body_toi, result.world_toi]))
            contacts = self._pairs(plan, result.contacts)
        body = 1 + self.mesh.num_bodies
        return DistributedResult(float(least[0]), vertex_toi, least[1:body], least[body:], contacts)

    @text_completed_by(mesh_ccd)
    def collision_free_step(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: None = None) -> float:
        """Largest fraction of a step of the whole mesh certain to be free of collisions; all ranks call it together.

        Returns:
            A fraction of the step in [0, t_max], the same on all ranks.

        Guarantee: as for :func:`ccd_warp.collision_free_step`, for the whole mesh.
        """
        call, check = "collision_free_step", lambda: self._parting_distance
        with self._called(call, vertices_t0, vertices_t1, check, motion) as (plan, start, end):
            least = plan.pipeline._least_toi(start, end, of_parts=partial(self._least, plan))
            return min(least, self._options.t_max)

    @text_completed_by(mesh_ccd)
    def is_step_collision_free(self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, *, motion: None = None) -> bool:
        """Whether a step of the whole mesh is certain to be free of collisions; all ranks call it together.

        Returns:
            True on all ranks if no pair touches in [0, t_max].

        Guarantee: True is certain.
        """
        with self._called("is_step_collision_free", vertices_t0, vertices_t1, motion=motion) as (plan, start, end):
            return self._ranks.agree(float(plan.pipeline.is_step_collision_free(start, end)))[0] == 1.0

    @text_completed_by(mesh_ccd)
    def find_candidates(
        self, vertices_t0: ArrayLike, vertices_t1: ArrayLike, inflation: float = 0.0, *, motion: None = None
    ) -> DistributedPairs:
        """Find the pairs of the whole mesh whose swept boxes overlap; all ranks call it together.

        Args:
            inflation: Enlargement of every box on every side, a length, the same on all ranks.

        Returns:
            The pairs that this rank has found.

        Guarantee: every pair that passes the filter and whose boxes overlap is found once, on one rank.
        """
        call, check = f"find_candidates(inflation={inflation})", lambda: 2.0 * validated_inflation(inflation)
        with self._called(call, vertices_t0, vertices_t1, check, motion) as (plan, start, end):
            return self._pairs(plan, plan.pipeline.find_candidates(start, end, inflation))

    @text_completed_by(find_candidates)
    def find_proximity(self, positions: ArrayLike, distance: float) -> DistributedPairs:
        """Find the pairs of the whole mesh within a distance at one time; all ranks call it together.

        Args:
            positions: Positions of the vertices on this rank at one time, as in :meth:`mesh_ccd`.
            distance: Largest Euclidean distance of a pair, a length, the same on all ranks.

        Guarantee: every pair that passes the filter and is within the distance is found once, on one rank.
        """
        call, check = f"find_proximity(distance={distance})", lambda: validated_distance(distance)
        with self._called(call, positions, None, check) as (plan, x, _):
            return self._pairs(plan, plan.pipeline.find_proximity(x, distance))

    @text_completed_by(find_proximity)
    def displacement_bounds(self, positions: ArrayLike, search_radius: float) -> NDArray[np.float64]:
        """For each vertex on this rank a length by which it may move; all ranks call it together.

        Args:
            search_radius: Distance beyond which nothing counts as near, a length, the same on all ranks.

        Returns:
            For each vertex on this rank, ghosts too, the length by which it may move, float64, shape [n].

        Raises:
            ValueError: As in :meth:`mesh_ccd`, or if the pipeline has a ``minimum_separation``, which is none in the
                Euclidean norm.

        Guarantee: as for :func:`ccd_warp.displacement_bounds`, for the whole mesh.
        """

        def reach() -> float:
            return add_rounded_up(validated_search_radius(search_radius, self._options), self._options.minimum_distance)

        call = f"displacement_bounds(search_radius={search_radius})"
        with self._called(call, positions, None, reach) as (plan, x, _):
            return self._to_owners(plan, plan.pipeline.displacement_bounds(x, search_radius))

    @text_completed_by(find_proximity)
    def find_intersections(self, positions: ArrayLike) -> DistributedPairs:
        """Find the pairs of the whole mesh that touch or cross at one time; all ranks call it together.

        Guarantee: every pair that passes the filter and touches or passes through each other is found once, on one
        rank, and no other pair is.
        """
        # boxes need no enlargement here; with that of a step, a plan serves both
        with self._called("find_intersections", positions) as (plan, x, _):
            return self._pairs(plan, plan.pipeline.find_intersections(x))

    @text_completed_by(mesh_ccd)
    def line_search(
        self,
        vertices_t0: ArrayLike,
        vertices_t1: ArrayLike,
        *,
        per: Per = "scene",
        safety: float = DEFAULT_SAFETY,
        max_rounds: int = DEFAULT_MAX_ROUNDS,
        motion: None = None,
    ) -> DistributedLineSearch:
        """Shorten a step of the whole mesh until it is free of collisions; all ranks call it together.

        Args:
            per: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``; this and what follows the same on all ranks.
            safety: Fraction of its toi by which a vertex in contact may move.
            max_rounds: Largest number of steps that are checked.

        Returns:
            End positions and fractions of the vertices on this rank, ghosts too.

        Raises:
            ValueError: As in :meth:`mesh_ccd`, and if ``t_max`` is not 1.

        Guarantee: as for :func:`ccd_warp.line_search`, for the whole mesh.
        """

        def check() -> float:
            check_step_is_whole(self._options.t_max)
            validated_line_search(per, safety)
            check_count("max_rounds", max_rounds, 2**31 - 1, least=3)
            return self._parting_distance

        call = f"line_search(per={per!r}, safety={safety!r}, max_rounds={max_rounds!r})"
        with self._called(call, vertices_t0, vertices_t1, check, motion) as (plan, start, end):
            how: dict[str, Any] = {"per": per, "safety": safety, "max_rounds": max_rounds}
            result = plan.pipeline._rounds_of(Course(start, end), partial(self._least, plan), **how).result()
            fraction = self._to_owners(plan, result.vertex_fraction)
            self._follow(fraction, per)
            first, last = self._ends
            # a step that is free as it was asked for ends with these bits, with the sign of every 0
            vertices = last.copy() if result.num_rounds == 1 else moved(first, last, fraction)
            self.mesh.copies.forward([vertices], [vertices])
            of_rounds: dict[str, Any] = {
                name: getattr(result, name) for name in ("fraction", "num_rounds", "is_limited")
            }
            tables = "touching", "struck", "shortened_by"
            of_rounds |= {name: self._pairs(plan, getattr(result, name)) for name in tables}
            return DistributedLineSearch(vertices, fraction, **of_rounds)

    def _pairs(self, plan: RankPlan, pairs: Any) -> DistributedPairs:
        """Those pairs of a part that count on this rank."""
        columns = columns_of(plan, pairs)
        return DistributedPairs(columns, int(self._ranks.total(np.array(len(columns["kind"])))), self._ranks)

    def _follow(self, fraction: _Floats, per: Per) -> None:
        """Let vertices that take no part, which no rank is sent, go as others of their group do; collective."""
        mesh = self.mesh
        if not mesh.num_unused:
            return
        group = {"body": mesh.bodies, "world": mesh.worlds}.get(per, np.zeros_like(mesh.bodies))
        least = np.ones(max(mesh.num_bodies, mesh.num_worlds))
        is_free = ~(mesh.static | mesh.kinematic)[mesh.bodies]
        rows = np.flatnonzero(is_free & ~mesh.is_unused)
        if per != "vertex":
            np.minimum.at(least, group[rows], fraction[rows])
        least = self._ranks.least(least)
        fraction[mesh.is_unused] = np.where(is_free, least[group], 1.0)[mesh.is_unused]

    def _least(self, plan: RankPlan, values: _Floats, per: Per) -> _Floats:
        """The least over all ranks of a value of the scene, or of each vertex of a part, or of what all have."""
        if per == "scene":
            return np.array(self._ranks.agree(*values))
        if per != "vertex":
            return self._ranks.least(values)
        owned = np.full((len(self.mesh.vertex_ids), *values.shape[1:]), np.inf)
        plan.exchange.back([values], [owned])
        result = np.empty_like(values)
        plan.exchange.forward([owned], [result])
        return result

    def _to_owners(self, plan: RankPlan, values: _Floats) -> _Floats:
        """The least value of each vertex on this rank, ghosts too, given those of the vertices of the parts."""
        result = np.full(len(self.mesh.vertex_ids), np.inf)
        plan.exchange.back([values], [result])
        self.mesh.copies.forward([result], [result])
        return result

    @contextmanager
    def _called(
        self,
        call: str,
        start: ArrayLike,
        end: ArrayLike | None = None,
        distance: Callable[[], float] | None = None,
        motion: object = None,
    ) -> Iterator[tuple[RankPlan, _Floats, _Floats]]:
        """A call of all ranks: a plan that serves it, and the positions of this rank's part at both ends.

        ``call`` says what must be the same on all ranks. There is no end at one time. ``distance`` checks arguments,
        and says how near pairs come that are to be found, where that is not what a step asks for.
        """
        ranks, name = self._ranks, call.partition("(")[0]
        begin, seconds, ranks.sent = time.perf_counter(), dict[str, float](), Sent()
        with ranks.together(call if self._number == 1 else f"{call} of pipeline {self._number}"):
            with naming(name):
                if motion is not None:
                    raise ValueError(
                        f"motion is {shown(motion)}; expected None, as bodies that turn are for one process"
                    )
                inflation = half_rounded_up(self._distance if distance is None else distance())
            self._ends = ends = self.mesh._frames(start, end)
            plan, self._plan = self._plan, None  # what was half done is not used again, on no rank
            is_kept = ranks.agree(float(plan is not None and plan.serves(*ends, inflation)))[0] > 0.0
            if not is_kept or plan is None:
                plan = make_plan(self.mesh, *ends, inflation, self._given)
                seconds["plan"] = time.perf_counter() - begin
            before = time.perf_counter()
            positions = plan.brought(*ends)
            seconds["positions"] = time.perf_counter() - before
            yield plan, *positions
            self._plan = plan
            counts, timings = plan.pipeline.counts, plan.pipeline.timings
            seconds["total"] = time.perf_counter() - begin
            self.work = RankWork(counts, timings | seconds, ranks.sent, plan.num_ghosts, not is_kept)


def _device_of(local_rank: int) -> str | None:
    """The device of a rank by default: the CUDA devices of its machine in turns, or None for Warp's own choice."""
    start_warp()
    count = wp.get_cuda_device_count()
    return f"cuda:{local_rank % count}" if count else None
