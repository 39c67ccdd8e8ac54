"""Line search: the largest safe step of the scene, of each world, body or vertex, from times of impact."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.contact_step import ContactStep
from ccd_warp._engine.host.course import Course, Ends
from ccd_warp._engine.host.start_distances import LeastOfParts, StartDistances, in_any_part, of_one_part
from ccd_warp._results.contact_place import joined
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.line_search_result import LineSearchResult
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


# Does some work on a step of a course.
OnStep = Callable[[Ends, Callable[[ContactStep], MeshResult]], MeshResult]
_Floats = NDArray[np.float64]


class _Shortening(NamedTuple):
    """What a round has shortened.

    Attributes:
        contacts: The contacts of its step that are not stopped.
        corners: Their vertices, shape [m, 4].
        toi: Their tois, as they were counted, shape [m].
        bound: The least toi of all vertices that share the fraction of each, shape [V].
        before: The fraction of each vertex before it, shape [V].
    """

    contacts: Contacts
    corners: NDArray[np.int32]
    toi: _Floats
    bound: _Floats
    before: _Floats


class LineSearchRounds:
    """A line search, round by round: displacements are shortened until no vertex that moves has a contact in the step.

    Attributes:
        num_rounds: Number of steps that were checked.
        fraction: Fraction of its displacement by which each vertex moves, so far.
        vertices: Positions there.
        distances: Start distances of the vertices, as share and length, [V, 2]; None until these matter.
        is_limited: Whether individual fractions took too many rounds.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        course: Course,
        on_step: OnStep,
        start_distances: StartDistances | None,
        *,
        per: Per,
        safety: float,
        max_rounds: int,
        of_parts: LeastOfParts = of_one_part,
    ) -> None:
        """Begin with the whole step; where the mesh is a part of another, all parts have one number of rounds."""
        self._mesh, self._course, self._on_step, self._of_parts = mesh, course, on_step, of_parts
        self._start_distances, self._per, self._safety, self._max_rounds = start_distances, per, safety, max_rounds
        self._moves = mesh._is_free[mesh.vertex_body]
        self._driven = _Driven(mesh, course, self._solved)
        self.num_rounds, self.is_limited = 0, False
        self.distances: _Floats | None = None
        self.fraction = np.ones(mesh.num_vertices)
        self.vertices = course.end.copy()  # the caller's own array may be what `frames` returns
        self._common = np.empty(0)  # the fraction of each vertex's world by the first round
        # vertices whose fractions the last round has changed: pairs without any are free, or stopped; None for all
        self._changed: NDArray[np.bool_] | None = None
        self._is_common = np.full(mesh.num_vertices, per in ("scene", "world"))
        self._at_start: NDArray[np.uint64] | None = None  # keys of the pairs that touch there
        self._stopping: list[Contacts] = []
        self._shortening: list[_Shortening] = []

    def result(self, *, begins_at_rest: bool = False) -> LineSearchResult:
        """The result after all rounds.

        With ``begins_at_rest`` much starts within its distance: a strict search looks at the start alone first, where
        everything may be in contact already, and one with start distances looks for these before its first round.
        """
        return (self._result_at_rest() if begins_at_rest else None) or self._result_of_rounds()

    def _solved(self, ends: Ends, strict: Contacts | None = None) -> Contacts:
        """The contacts of a step, in which what starts within its distance may part.

        Those of pairs that start beyond their distance may be ``strict`` ones that are known.
        """

        def work(step: ContactStep) -> MeshResult:
            if strict is not None and self.distances is not None:
                step.of_vertices(np.isfinite(self.distances[:, 0]), known=strict)
            else:
                step.of_vertices(self._changed)
            return step.parting(self.distances).contacts(is_ordered=False)

        return self._on_step(ends, work).contacts

    def _touching_at_start(self) -> Contacts:
        """The contacts of no motion."""
        course = self._course
        ends = course.step_to(course.start, np.zeros(len(course.start)))
        return self._on_step(ends, lambda step: step.contacts(is_ordered=False)).contacts

    @property
    def _has_time(self) -> bool:
        """Whether rounds are left for bodies or vertices of toi 0 to be checked again."""
        return self._max_rounds - self.num_rounds >= _ROUNDS_TO_SHORTEN

    def _result_at_rest(self) -> LineSearchResult | None:
        """The result where nothing can move from a start at which much is near; otherwise what is near is known."""
        mesh, course = self._mesh, self._course
        if self._start_distances is not None:
            self.distances = self._start_distances.of(course.start)
            return None
        if mesh.kinematic.any():
            return None
        contacts = self._touching_at_start()
        corners = pair_vertices(mesh, contacts)
        least = self._shared(self._least(contacts.toi, corners), self._per)
        if self._any((least != 0)[self._moves]):
            return None
        fraction = np.where(self._moves, 0.0, 1.0)
        motion = course.motion_to(fraction)
        touching = contacts[np.argsort(_keys(contacts))]
        at_rest = partial(
            _shortened_by, self._moves, contacts, [_Shortening(contacts, corners, contacts.toi, least, self.fraction)]
        )
        end = course.start.copy()
        return LineSearchResult(
            end, fraction, 0.0, touching, 1, False, contacts[:0], motion=motion, _find_shortening=at_rest
        )

    def _result_of_rounds(self) -> LineSearchResult:
        while self.num_rounds < self._max_rounds:
            contacts = self._checked()
            corners = _vertices_of(self._mesh, contacts)
            is_stopped = _of_all((self.fraction == 0) | ~self._moves, corners)
            is_stopped |= self._driven.is_at_rest(contacts, corners)
            if not self._any(~is_stopped):
                self._stopping.append(contacts)
                break
            if is_stopped.any():
                self._stopping.append(contacts[is_stopped])
                contacts, corners = contacts[~is_stopped], corners[~is_stopped]
            self._shorten(contacts, corners, self._resolved_toi(contacts, corners))
        else:
            if self._driven.is_any:  # what the last round has stopped may be struck
                contacts = self._solved(self._course.step_to(self.vertices, self.fraction))
                self.num_rounds += 1
        return self._result_with(contacts)

    def _checked(self) -> Contacts:
        """The contacts of the step so far; the first time again where something starts within its distance."""
        ends = self._course.step_to(self.vertices, self.fraction)
        contacts = self._solved(ends)
        if self.num_rounds == 0 and self._start_distances is not None and self.distances is None:
            self.distances = self._start_distances.of_worlds_near(self._course.start, ends, contacts)
            if self.distances is not None:
                contacts = self._solved(ends, contacts)
        self.num_rounds += 1
        return contacts

    def _resolved_toi(self, contacts: Contacts, corners: NDArray[np.int32]) -> _Floats:
        """The toi of each contact, or where its gap may only be lost in rounding, that of a shorter motion.

        It is 0 of what a shorter step is of no use to, and of all where no round is left to check another step.
        """
        driven = self._driven
        if self._has_time and driven.is_to_look and self._any(driven.is_of_kinematic(contacts)):
            driven.look()
            self.num_rounds += 1
        is_driven = driven.among(contacts)
        toi = np.where(is_driven, 0.0, contacts.toi)
        if self._any(toi == 0):
            has_time = self._has_time
            if self._at_start is None and has_time:
                self._at_start = np.sort(_keys(self._touching_at_start()))
                self.num_rounds += 1
            is_all_common = not self._any(~self._is_common)
            # with too few rounds left, a further attempt could stop other vertices of the world, too
            can_be_shorter = (self.fraction[corners].max(axis=1) > _LEAST_FRACTION) & (has_time or is_all_common)
            if self._at_start is not None:
                can_be_shorter &= ~_is_among(_keys(contacts), self._at_start)
            can_be_shorter &= ~is_driven
            least = self._shared(self._least(toi, corners), self._per)
            can_be_shorter &= ~_of_all(least != 0, corners)
            is_one = corners[:, 0] == corners[:, 3]
            share = _resolved_share(contacts, self._course.start[corners], self.vertices[corners], is_one)
            toi = np.where(can_be_shorter, np.maximum(toi, share), toi)
        if self.num_rounds >= self._max_rounds - 1:
            toi = np.zeros(len(contacts))
            self._is_common[:] = True
        return toi

    def _shorten(self, contacts: Contacts, corners: NDArray[np.int32], toi: _Floats) -> None:
        """Shorten the motion of the vertices of contacts, and of those that share their fractions."""
        course, safety, before = self._course, self._safety, self.fraction
        least = self._least(toi, corners)
        of_world = self._shared(least, "scene" if self._per == "scene" else "world")
        if len(self._common) == 0:
            self._common = np.minimum(safety * of_world, 1.0)
        self.fraction = fraction = before.copy()
        bound = of_world
        if self._max_rounds - self.num_rounds > _ROUNDS_BY_WORLD:
            bound = self._shared(least, self._per)
            touched = np.isfinite(bound)
            fraction[touched] *= safety * bound[touched]
        else:
            # Worlds that touch move by one fraction each, and in the end not at all. The other worlds stay as this
            # round has found them free, so that even the last round needs no further one.
            self.is_limited = True
            touched = np.isfinite(of_world)
            shorter = fraction[touched] * safety * of_world[touched]
            fraction[touched] = np.where(self._is_common[touched], shorter, self._common[touched])
            self._is_common |= touched
        fraction[~self._moves] = 1.0
        self._shortening.append(_Shortening(contacts, corners, toi, bound, before))
        if not self._driven.is_any:
            self._changed = fraction != before
        self.vertices = course.at(fraction)
        # which contacts stop their vertices alone; where others let one go some way, this one does
        may_stop = self.is_limited | course.may_stay(fraction)
        rows = np.flatnonzero(_of_all(may_stop, corners)) if may_stop.any() else np.zeros(0, dtype=np.intp)
        corners = corners[rows]
        alone = safety * toi[rows, None] * before[corners]
        stops = (course.at(alone, corners) == course.start[corners]).all(axis=(1, 2))
        self._stopping.append(contacts[rows[stops]])

    def _least(self, toi: _Floats, corners: NDArray[np.int32]) -> _Floats:
        """For each vertex the least toi of its contacts, inf if there is none."""
        least = np.full(self._mesh.num_vertices, np.inf)
        for column in corners.T:  # which NumPy takes in a fifth of the time of all at once
            np.minimum.at(least, column, toi)
        return least

    def _any(self, flags: NDArray[np.bool_]) -> bool:
        """Whether any flag is set, in any part."""
        return in_any_part(self._of_parts, bool(flags.any()))

    def _shared(self, least: _Floats, per: Per) -> _Floats:
        """For each vertex the least toi of all vertices that share its fraction."""
        mesh = self._mesh
        if per == "scene":
            least = np.full_like(least, self._of_parts(least.min(initial=np.inf, keepdims=True), per)[0])
        elif per == "vertex":
            least = self._of_parts(least, per)
        else:
            group = mesh.vertex_body if per == "body" else mesh.vertex_world
            of_group = np.full(mesh.num_bodies if per == "body" else mesh.num_worlds, np.inf)
            np.minimum.at(of_group, group, least)
            least = self._of_parts(of_group, per)[group]
        return self._course.shared(least)

    def _result_with(self, contacts: Contacts) -> LineSearchResult:
        """The result, given the contacts of the last round."""
        mesh, fraction = self._mesh, self.fraction
        is_at_start = self._course.are_at_start(self.vertices, fraction)
        is_struck = self._driven.is_any & ~np.asarray(is_at_start[_vertices_of(mesh, contacts)].all(axis=1))
        least = self._of_parts(fraction[self._moves].min(initial=1.0, keepdims=True), "scene")
        return LineSearchResult(
            vertices=self.vertices,
            vertex_fraction=fraction,
            fraction=float(least[0]),
            touching=_stationary_contacts(mesh, self._stopping, is_at_start),
            num_rounds=self.num_rounds,
            is_limited=self.is_limited,
            struck=_each_once([contacts[is_struck]]),
            motion=self._course.motion_to(fraction),
            _find_shortening=partial(_shortened_by, self._moves, contacts, self._shortening),
        )


class _Driven:
    """The pairs of which a kinematic body meets one side even if that stays: a shorter step is of no use to these."""

    def __init__(
        self,
        mesh: CollisionMesh,
        course: Course,
        solve: Callable[[Ends], Contacts],
    ) -> None:
        self.is_any = bool(mesh.kinematic.any())
        self._mesh, self._course, self._solve = mesh, course, solve
        self._keys: NDArray[np.uint64] | None = None

    @property
    def is_to_look(self) -> bool:
        """Whether they are still to be found, once a kinematic body is in contact."""
        return self.is_any and self._keys is None

    def look(self) -> None:
        """Find them, in a round."""
        mesh, course = self._mesh, self._course
        stays = mesh._is_free[mesh.vertex_body]
        end = np.where(stays[:, None], course.start, course.end)
        contacts = self._solve(course.step_to(end, np.where(stays, 0.0, 1.0)))
        self._keys = np.sort(_keys(contacts))

    def is_of_kinematic(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Which of the contacts are of a kinematic body."""
        return np.asarray(self._mesh.kinematic[pair_bodies(self._mesh, contacts)].any(axis=1))

    def is_at_rest(self, contacts: Contacts, corners: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which of the contacts are of a kinematic body and vertices that have no motion to shorten."""
        if not self.is_any:
            return np.zeros(len(contacts), dtype=bool)
        course = self._course
        stays = course.are_at_start(course.end, np.ones(len(course.end)))
        is_still = stays[corners] | self._mesh.kinematic[self._mesh.vertex_body[corners]]
        is_pair_still: NDArray[np.bool_] = np.asarray(is_still.all(axis=1))
        return is_pair_still & self.is_of_kinematic(contacts)

    def among(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Which of the contacts are of such a pair."""
        if self._keys is None:
            return np.zeros(len(contacts), dtype=bool)
        is_of_pair: NDArray[np.bool_] = self.is_of_kinematic(contacts) & _is_among(_keys(contacts), self._keys)
        return is_of_pair


def _of_all(flags: NDArray[np.bool_], corners: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether all vertices of each contact have a flag."""
    first, *others = corners.T
    of_all: NDArray[np.bool_] = flags[first]
    for column in others:
        of_all &= flags[column]
    return of_all


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
    is_among: NDArray[np.bool_] = ascending[np.searchsorted(ascending[:-1], keys)] == keys
    return is_among


def _stationary_contacts(mesh: CollisionMesh, stopping: list[Contacts], is_at_start: NDArray[np.bool_]) -> Contacts:
    """Contacts of all rounds whose vertices are all at their start positions, as found last."""
    parts = [part for part in stopping[::-1] if len(part)]
    if not parts:
        return stopping[0]
    return _each_once([part[np.flatnonzero(_of_all(is_at_start, _vertices_of(mesh, part)))] for part in parts])


def _shortened_by(moves: NDArray[np.bool_], contacts: Contacts, rounds: list[_Shortening]) -> Contacts:
    """The contacts of all rounds that shortened a vertex that was still to move, as found first."""
    parts = []
    for listed, corners, toi, bound, before in rounds:
        is_shortened = moves & (before > 0)
        parts.append(listed[(is_shortened[corners] & (bound[corners] == toi[:, None])).any(axis=1)])
    return _each_once([*parts, contacts[:0]])


def _each_once(parts: list[Contacts]) -> Contacts:
    """The contacts of lists in their order, each pair once, as the first list has it."""
    contacts = joined(parts)
    return contacts if len(contacts) == 0 else contacts[np.unique(_keys(contacts), return_index=True)[1]]
