"""Line search: the largest safe step of the scene, of each world, body or vertex, from times of impact."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.one_process import OneProcess
from ccd_warp._engine.motion import moved
from ccd_warp._results.contact_place import joined
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.intersections import Intersections, crossing_at_start
from ccd_warp._results.pairs import pair_bodies, pair_vertices
from ccd_warp._results.results import MeshResult
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.arguments import EVERY_PER, Per, check_choice, check_real
from ccd_warp._scene.mesh import CollisionMesh

DEFAULT_SAFETY = 0.9
DEFAULT_MAX_ROUNDS = 16
# A pair that has toi 0 but does not touch at the start is checked again over a motion of this many of its gaps, but at
# most this fraction of its previous motion. Among 2 to 64 gaps and fractions of 1/64 to 1/4, these gave the most even
# steps: on draped cloths in float32 at least a sixth of the exact one, in at most five rounds.
_GAPS = 4.0
_LARGEST_CUT = 2.0**-3
# Fraction of a displacement at which this ends: the vertices of a pair that has toi 0 even then are stopped.
_LEAST_FRACTION = 2.0**-30
# Final rounds of a search that takes too long: one with one fraction for each world, then one that stops.
_ROUNDS_BY_WORLD = 2
# Rounds that must be left for bodies or vertices of toi 0 to be checked again.
_ROUNDS_TO_SHORTEN = 6


@dataclass(frozen=True)
class LineSearchResult:
    """A step that is certain to be free of collisions.

    Attributes:
        vertices: Positions at its end, a new array, float64, shape [V, 3], or [V, 2] in the plane.
        vertex_fraction: Fraction of its displacement by which each vertex moves, in [0, 1], shape [V]; 1 for vertices
            of static and kinematic bodies.
        fraction: The least fraction of the vertices of free bodies.
        touching: Pairs that keep their vertices from moving, in the order of :class:`ccd_warp.Contacts`, each once;
            none of their vertices moves. Such a pair touches at the start, or presses on from within its distance, or
            its gap is too small for the precision over any step however short, or the rest of the step is lost in the
            rounding of positions. Each pair is reported as found in the last round in which one of its vertices was
            still to move: its toi and all other fields refer to the step of that round. Where a search that takes too
            long stops a world, these are all pairs of this world that touched in its last step, so that their toi may
            be above 0.
        struck: Pairs of a kinematic body that moves and vertices that stay where they are and that it meets on its way,
            in the order of :class:`ccd_warp.Contacts`; their toi is when. Empty: it passes through nothing. Otherwise
            the end positions are those of vertices that it has passed through, so the whole step, the script too, has
            to be cut to a little less than ``struck.toi.min()``, or the response has to move them out of its way.
        num_rounds: Number of times that a step was checked, one after another; a first check that is made again because
            something starts within its distance counts once.
        is_limited: Whether individual fractions took too many rounds, so that all vertices of a world move by one
            fraction, or not at all.
        start: What touches or crosses at the start, exactly, with ``check_start=True``; otherwise None.
        motion: The :class:`ccd_warp.RigidMotion` up to the end of the step, where one was given: its ``poses_t1`` are
            the poses of the rigid bodies there, and ``vertices`` has their vertices in the world. Otherwise None.
    """

    vertices: NDArray[np.float64]
    vertex_fraction: NDArray[np.float64]
    fraction: float
    touching: Contacts
    num_rounds: int
    is_limited: bool
    struck: Contacts
    start: Intersections | None = None
    motion: Any = None

    def __repr__(self) -> str:
        limited = ", is_limited" if self.is_limited else ""
        struck = f", {len(self.struck)} struck" if len(self.struck) else ""
        touching = f"{len(self.touching)} touching{struck}, {self.num_rounds} rounds{limited}"
        crossing = crossing_at_start(self.start)
        at_start = f";\n{crossing}" if crossing else ""
        least = f"least fraction {self.fraction!r} of {len(self.vertices):,} vertices"
        return f"LineSearchResult({least}, {touching}{at_start})"


def check_step_is_whole(t_max: float) -> None:
    """Check that a line search covers the whole step.

    Raises:
        ValueError: If not.
    """
    if t_max != 1.0:
        raise ValueError(f"t_max is {t_max!r}; expected 1, as a line search covers the whole step")


def validated_line_search(per: Per, safety: float) -> tuple[Per, float]:
    """The arguments ``per`` and ``safety``, validated."""
    return (
        check_choice("per", per, EVERY_PER),
        check_real("safety", safety, "a number between 0 and 1", lambda x: 0 < x < 1),
    )


class Ends(NamedTuple):
    """A step as a solver takes it.

    Attributes:
        start: Positions at its start; of bodies on ``paths`` in their own frames.
        end: Those at its end.
        paths: The paths of bodies that turn, up to there; None where there are none.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    paths: Any = None


class Solver:
    """The steps that a line search takes.

    Attributes:
        worlds_near: Which worlds have a contact that starts within its distance or passes by, given the start in the
            world, the step and all of its contacts; None where that does not matter, or pairs keep no distance.
        find_holds: The hold of each vertex at the start (`HoldStep`).
    """

    def __init__(
        self,
        on_step: Callable[[Ends, Callable[[Any], MeshResult]], MeshResult],
        worlds_near: Callable[[NDArray[np.float64], Ends, Contacts], NDArray[np.bool_]] | None,
        find_holds: Callable[[NDArray[np.float64]], NDArray[np.float64]],
        *,
        holds: bool,
    ) -> None:
        """Of what does some work on a step, and of whether what starts close may part."""
        self._on_step, self._holds = on_step, holds
        self.worlds_near, self.find_holds = worlds_near if holds else None, find_holds

    def strict(self, ends: Ends) -> MeshResult:
        """All contacts of a step."""
        return self._on_step(ends, lambda step: step.contacts())

    def holding(self, ends: Ends, holds: NDArray[np.float64] | None) -> MeshResult:
        """The same, where what starts within its distance may part and slide, by holds, None until these matter."""
        return self._on_step(ends, lambda step: (step.holding(holds) if self._holds else step).contacts())


class Course:
    """Where vertices are at fractions of their displacements, on straight lines, and the steps there.

    Attributes:
        start: Positions at the start, in the world.
        end: Positions at the end.
    """

    def __init__(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        self.start, self.end = start, end

    def at(self, fraction: NDArray[np.float64], vertices: Any = slice(None)) -> NDArray[np.float64]:
        """The positions of vertices, an array of any shape, at a fraction of each; of all by default."""
        return moved(self.start[vertices], self.end[vertices], fraction)

    def step_to(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> Ends:
        """The step to positions that are those at a fraction of each."""
        return Ends(self.start, vertices)

    def motion_to(self, fraction: NDArray[np.float64]) -> Any:
        """The motion of the call up to a fraction of each vertex; None where there is none."""
        return None

    def are_at_start(self, vertices: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which vertices have not moved on the way to positions that are those at a fraction of each, shape [V]."""
        found: NDArray[np.bool_] = (vertices == self.start).all(axis=1)
        return found

    def shared(self, least: NDArray[np.float64]) -> NDArray[np.float64]:
        """A value of each vertex, which vertices share that have one fraction whatever is asked for."""
        return least


def search_step(
    mesh: CollisionMesh,
    course: Course,
    solver: Solver,
    *,
    per: str,
    safety: float,
    max_rounds: int,
    everywhere: OneProcess | None = None,
    begins_at_rest: bool = False,
) -> LineSearchResult:
    """Shorten displacements until the solver finds no contact of a vertex that moves, here and ``everywhere``.

    With ``begins_at_rest`` much starts within its distance: a strict search looks at the start alone first, where
    everything may be in contact already, and one that holds looks for the holds before its first round.
    """
    everywhere = everywhere or OneProcess()
    start, end = course.start, course.end
    moves = mesh._is_free[mesh.vertex_body]
    holds: NDArray[np.float64] | None = None
    if begins_at_rest and solver.worlds_near is not None:
        found = solver.find_holds(start)
        holds = found if np.isfinite(found).any() else None
    elif begins_at_rest and not mesh.kinematic.any():
        contacts = solver.strict(course.step_to(start, np.zeros(len(start)))).contacts
        stopped = course.shared(_least(contacts.toi, pair_vertices(mesh, contacts), mesh, per, everywhere)) == 0
        if everywhere.all(bool(stopped[moves].all())):
            fraction = np.where(moves, 0.0, 1.0)
            motion = course.motion_to(fraction)
            return LineSearchResult(start.copy(), fraction, 0.0, contacts, 1, False, contacts[:0], motion=motion)
    driven = _Driven(mesh, course, lambda ends: solver.holding(ends, holds), everywhere)
    fraction = np.ones(mesh.num_vertices)
    vertices = end.copy()  # the caller's own array may be what `frames` returns
    common = np.empty(0)  # the fraction of each vertex's world by the first round
    is_common = np.full(mesh.num_vertices, per in ("scene", "world"))
    at_start: NDArray[np.uint64] | None = None
    stopping: list[Contacts] = []
    is_limited = False
    num_rounds = 0
    while num_rounds < max_rounds:
        result = solver.holding(course.step_to(vertices, fraction), holds)
        worlds_near = solver.worlds_near if num_rounds == 0 and holds is None else None
        if worlds_near is not None and not everywhere.all(not len(result.contacts)):
            # what starts within its distance has a contact, whichever way it moves
            found_near = worlds_near(start, course.step_to(vertices, fraction), result.contacts)
            is_near = everywhere.least(np.where(found_near, 0.0, 1.0)) == 0.0
            if is_near.any():
                holds = everywhere.least_of_vertices(solver.find_holds(start))
                holds[~is_near[mesh.vertex_world]] = np.inf  # worlds do not depend on each other
                result = solver.holding(course.step_to(vertices, fraction), holds)
        contacts = result.contacts
        num_rounds += 1
        corners = _vertices_of(mesh, contacts)
        is_stopped = ((fraction[corners] == 0) | ~moves[corners]).all(axis=1) | driven.is_at_rest(contacts, corners)
        if everywhere.all(bool(is_stopped.all())):
            stopping.append(contacts)
            break
        contacts, corners = _chosen(contacts, ~is_stopped), corners[~is_stopped]
        num_rounds += driven.look(contacts, has_time=max_rounds - num_rounds >= _ROUNDS_TO_SHORTEN)
        is_driven = driven.among(contacts)
        toi = np.where(is_driven, 0.0, contacts.toi)
        if not everywhere.all(bool(toi.all())):
            has_time = max_rounds - num_rounds >= _ROUNDS_TO_SHORTEN
            if at_start is None and has_time:
                at_start = np.sort(_keys(solver.strict(course.step_to(start, 0.0 * fraction)).contacts))
                num_rounds += 1
            is_all_common = everywhere.all(bool(is_common.all()))
            # with too few rounds left, a further attempt could stop other vertices of the world, too
            can_be_shorter = (fraction[corners].max(axis=1) > _LEAST_FRACTION) & (has_time or is_all_common)
            if at_start is not None:
                can_be_shorter &= ~_is_among(_keys(contacts), at_start)
            can_be_shorter &= ~is_driven
            least = course.shared(_least(toi, corners, mesh, per, everywhere))
            can_be_shorter &= (least[corners] == 0).any(axis=1)
            is_one = corners[:, 0] == corners[:, 3]
            share = _resolved_share(contacts, start[corners], vertices[corners], is_one)
            toi = np.where(can_be_shorter, np.maximum(toi, share), toi)
        if num_rounds >= max_rounds - 1:
            toi = np.zeros(len(contacts))
            is_common[:] = True
        of_world = _least(toi, corners, mesh, "scene" if per == "scene" else "world", everywhere)
        if len(common) == 0:
            common = np.minimum(safety * of_world, 1.0)
        own = safety * toi[:, None] * fraction[corners]
        if max_rounds - num_rounds > _ROUNDS_BY_WORLD:
            bound = course.shared(_least(toi, corners, mesh, per, everywhere))
            touched = np.isfinite(bound)
            fraction[touched] *= safety * bound[touched]
        else:
            # Worlds that touch move by one fraction each, and in the end not at all. The other worlds stay as this
            # round has found them free, so that even the last round needs no further one.
            is_limited = True
            touched = np.isfinite(of_world)
            shorter = fraction[touched] * safety * of_world[touched]
            fraction[touched] = np.where(is_common[touched], shorter, common[touched])
            is_common |= touched
        fraction[~moves] = 1.0
        vertices = course.at(fraction)
        stops = (course.at(own, corners) == start[corners]).all(axis=(1, 2))
        stopping.append(_chosen(contacts, stops))
    else:
        if driven.is_any:  # what the last round has stopped may be struck
            contacts = solver.holding(course.step_to(vertices, fraction), holds).contacts
            num_rounds += 1
    is_at_start = course.are_at_start(vertices, fraction)
    return LineSearchResult(
        vertices=vertices,
        vertex_fraction=fraction,
        fraction=float(everywhere.least(fraction[moves].min(initial=1.0, keepdims=True))[0]),
        touching=_stationary_contacts(mesh, stopping, is_at_start),
        num_rounds=num_rounds,
        is_limited=is_limited,
        struck=_chosen(contacts, driven.is_any & ~np.asarray(is_at_start[_vertices_of(mesh, contacts)].all(axis=1))),
        motion=course.motion_to(fraction),
    )


class _Driven:
    """The pairs of which a kinematic body meets one side even if that stays: a shorter step is of no use to these."""

    def __init__(
        self,
        mesh: CollisionMesh,
        course: Course,
        solve: Callable[[Ends], MeshResult],
        everywhere: OneProcess,
    ) -> None:
        self.is_any = bool(mesh.kinematic.any())
        self._mesh, self._course, self._solve, self._everywhere = mesh, course, solve, everywhere
        self._keys: NDArray[np.uint64] | None = None

    def look(self, contacts: Contacts, *, has_time: bool) -> int:
        """Find them once a kinematic body is in contact, if there is time for a round; returns the rounds taken."""
        if not self.is_any or not has_time or self._keys is not None:
            return 0
        mesh = self._mesh
        if self._everywhere.all(not mesh.kinematic[pair_bodies(mesh, contacts)].any()):
            return 0
        stays, course = mesh._is_free[mesh.vertex_body], self._course
        end = np.where(stays[:, None], course.start, course.end)
        found = self._solve(course.step_to(end, np.where(stays, 0.0, 1.0)))
        self._keys = np.sort(_keys(found.contacts))
        return 1

    def is_at_rest(self, contacts: Contacts, corners: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which of the contacts are of a kinematic body and vertices that have no motion to shorten."""
        if not self.is_any:
            return np.zeros(len(contacts), dtype=bool)
        course = self._course
        stays = course.are_at_start(course.end, np.ones(len(course.end)))
        is_still = stays[corners] | self._mesh.kinematic[self._mesh.vertex_body[corners]]
        found: NDArray[np.bool_] = np.asarray(is_still.all(axis=1))
        return found & self._mesh.kinematic[pair_bodies(self._mesh, contacts)].any(axis=1)

    def among(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Which of the contacts are of such a pair."""
        if self._keys is None:
            return np.zeros(len(contacts), dtype=bool)
        is_of_kinematic = self._mesh.kinematic[pair_bodies(self._mesh, contacts)].any(axis=1)
        found: NDArray[np.bool_] = is_of_kinematic & _is_among(_keys(contacts), self._keys)
        return found


def _vertices_of(mesh: CollisionMesh, contacts: Contacts) -> NDArray[np.int32]:
    """The vertices of each contact, shape [m, 4]; that of a kinematic half-space, which moves as others do, too."""
    corners = pair_vertices(mesh, contacts)
    if mesh._moves_planes:
        of_plane = np.flatnonzero(contacts.kind == int(PairKind.VERTEX_PLANE))
        point = mesh.planes.vertices[contacts.primitives[of_plane, 1]]
        corners[of_plane[point >= 0], 3] = point[point >= 0]
    return corners


def _resolved_share(
    contacts: Contacts, start: NDArray[np.float64], end: NDArray[np.float64], is_one: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Fraction of a contact's motion over which its gap is not lost in rounding, shape [m]; from its four vertices.

    The reported gap of a contact with toi 0 is no less than the gap at the start, so a pair that closes it head-on
    touches within a quarter of this motion, unless rounding makes up most of the gap; then the next round shortens the
    motion again. The vertices of a contact with a plane that does not move are one, and the plane moves by 0.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        motion = end - start
        motion[(contacts.kind == int(PairKind.VERTEX_PLANE)) & is_one, 1:] = 0.0
        share = _GAPS * contacts.gap / np.ptp(motion, axis=1).max(axis=1, initial=0.0)
    return np.where(share < _LARGEST_CUT, share, _LARGEST_CUT)  # also where the share is NaN


def _keys(contacts: Contacts) -> NDArray[np.uint64]:
    """Each pair as one number; ascending keys give the order of :class:`ccd_warp.Contacts`."""
    first, second = contacts.primitives.astype(np.uint64).T
    is_plane = contacts.kind == int(PairKind.VERTEX_PLANE)  # which has no bits of its own, as in `contact_key`
    kind = np.where(is_plane, int(PairKind.POINT_POINT), contacts.kind).astype(np.uint64)
    first |= is_plane.astype(np.uint64) << np.uint64(30)
    return kind << np.uint64(62) | first << np.uint64(31) | second


def _is_among(keys: NDArray[np.uint64], ascending: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Which keys are among others, which may be millions: `np.isin` would take seconds."""
    if len(ascending) == 0:
        return np.zeros(len(keys), dtype=bool)
    found: NDArray[np.bool_] = ascending[np.searchsorted(ascending[:-1], keys)] == keys
    return found


def _stationary_contacts(mesh: CollisionMesh, stopping: list[Contacts], is_at_start: NDArray[np.bool_]) -> Contacts:
    """Contacts of all rounds whose vertices are all at their start positions, each pair once, as found last."""
    stationary = []
    for part in stopping[::-1]:
        is_stationary: NDArray[np.bool_] = is_at_start[_vertices_of(mesh, part)]
        stationary.append(_chosen(part, np.flatnonzero(is_stationary.all(axis=1))))
    contacts = joined(stationary)
    return _chosen(contacts, np.unique(_keys(contacts), return_index=True)[1])


def _least(
    toi: NDArray[np.float64], corners: NDArray[np.int32], mesh: CollisionMesh, per: str, everywhere: OneProcess
) -> NDArray[np.float64]:
    """For each vertex the least toi of all contacts of vertices that share its fraction, inf if there is none."""
    least = np.full(mesh.num_vertices, np.inf)
    np.minimum.at(least, corners, toi[:, None])
    if per == "scene":
        return np.full_like(least, everywhere.least(least.min(initial=np.inf, keepdims=True))[0])
    if per == "vertex":
        return everywhere.least_of_vertices(least)
    group, count = (mesh.vertex_body, mesh.num_bodies) if per == "body" else (mesh.vertex_world, mesh.num_worlds)
    of_group = np.full(count, np.inf)
    np.minimum.at(of_group, group, least)
    of_group = everywhere.least(of_group)
    return of_group[group]


def _chosen(contacts: Contacts, chosen: NDArray[Any]) -> Contacts:
    return contacts[chosen]
