"""Links that joints move: passes over windows of the step, of which each world has its own, until a world is settled.

In a pass each link goes on the screw of a window (`JointMotion`), from which its true path is off by at most an excess
that falls with the square of the window. So a world is free where the pass finds it free; otherwise it is free up to
the toi found, where its next window begins, and is shorter, as the windows of a pair are (``kernels.pair.windows``). It
touches where a window ends in contacts whose excess is of the size of rounding.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._body_paths import BodyPaths
from ccd_warp._contact_place import ContactPlace
from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.arcs import TURN_OF_A_SLICE
from ccd_warp._engine.slices import Slice
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths, moved
from ccd_warp._pairs import pair_vertices
from ccd_warp._results import MeshResult
from ccd_warp._status import CCDStatus

if TYPE_CHECKING:
    from ccd_warp._joint_motion import JointMotion

# An excess below this share of the size of the scene is rounding, and a window below this share of the step ends.
_SHARP = 2.0**-46
_SHORTEST = 2.0**-44
_SHORT = 2.0**-38  # so short a window may end where its excess is the rounding of the paths
_DOWN = 1.0 - 2.0**-50
_GROWTH, _LEAST = 4.0, 2.0**-10
# Passes beyond those that the slices of a step need, after which open worlds have the toi that is proved.
_MOST_PASSES = 1000

Array = NDArray[np.float64]
# Contacts along paths, of bodies whose vertices are at these positions at both ends of a pass.
Solve = Callable[[NDArray[np.float64], NDArray[np.float64], MeshPaths], MeshResult]


class Windows(NamedTuple):
    """Where a search is in the span of each world; shape [W] each.

    Attributes:
        begin: Up to where nothing touches.
        longest: The length of a window at most.
        length: That of the next one.
        last: That of the last window that ended in a contact; 0 before.
        excess: The largest excess in that; inf before.
    """

    begin: Array
    longest: Array
    length: Array
    last: Array
    excess: Array

    @classmethod
    def of(cls, begin: Array, longest: Array) -> Self:
        """At the begin of spans."""
        return cls(begin.copy(), longest.copy(), longest.copy(), np.zeros(len(begin)), np.full(len(begin), np.inf))

    def of_worlds(self, worlds: Any) -> Self:
        """Those of some worlds."""
        return type(self)(*(x[worlds] for x in self))


class Links:
    """Links of worlds, and the spheres of their points.

    Attributes:
        motion: The motion, of as many worlds as there are.
        centre: Centres in the frames of the links, shape [L, 3].
        reach: How far points of each are from there at most, shape [L].
        is_used: Which are bodies of the mesh, bool, shape [W, L].
    """

    def __init__(self, motion: "JointMotion", centre: Array, reach: Array, is_used: NDArray[np.bool_]) -> None:
        self.motion, self.centre, self.reach, self.is_used = motion, centre, reach, is_used

    @classmethod
    def of(cls, mesh: CollisionMesh, vertices: Array, motion: "JointMotion") -> Self:
        """Of a mesh, all of whose rigid bodies are links, with spheres that hold those of all worlds."""
        num_worlds, count = motion.num_worlds, motion.num_links
        links = np.flatnonzero(mesh.rigid).reshape(num_worlds, count)
        centre, reach = np.zeros((count, 3)), np.zeros(count)
        for k in range(count):
            bodies = [vertices[slice(*mesh.body_vertex_range[link : link + 2])] for link in links[:, k].tolist()]
            own = np.concatenate(bodies)
            if len(own):
                centre[k] = 0.5 * own.min(axis=0) + 0.5 * own.max(axis=0)
                reach[k] = np.linalg.norm(own - centre[k], axis=1).max() * (1.0 + 2.0**-50)
        return cls(motion, centre, reach, np.ones((num_worlds, count), dtype=bool))

    def of_worlds(self, worlds: NDArray[np.intp], is_used: NDArray[np.bool_]) -> "Links":
        """Those of some worlds, of which some are used."""
        return Links(self.motion._of_worlds(worlds), self.centre, self.reach, is_used)

    def paths(self, begin: Array, end: Array) -> tuple[BodyPaths, Array]:
        """The paths of links that are used in a window of each world, and how far their points may be from there."""
        given, excess = self.motion._slices(begin, end, self.reach, self.centre)
        used = self.is_used.ravel()
        if used.all():
            return given, excess
        return given.rows(np.flatnonzero(used)), excess[used]


class JointSearch:
    """The earliest contacts of each world of a mesh whose rigid bodies are links that joints move.

    Attributes:
        world_toi: Toi of each world, inf where it is free, shape [W].
        at: Where the search is.
        is_open: Worlds whose toi is not known yet, shape [W].
        found: Contacts at the tois, with their points.
        num_passes: Number of passes.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        start: Array,
        end: Array,
        links: Links,
        span: tuple[Array, Array],
        t_max: float,
        is_searched: NDArray[np.bool_] | None = None,
        num_slices: Array | None = None,
        scale: float | None = None,
    ) -> None:
        """Begin a search; ``start`` and ``end`` are the positions of all vertices, of links in their own frames.

        Args:
            mesh: The mesh.
            start: Positions at t = 0.
            end: Positions at t = 1.
            links: The links.
            span: Begin and end of what is searched, times of each world.
            t_max: The latest time.
            is_searched: Worlds that are searched, by default all; of the others nothing is known.
            num_slices: Windows of each span at first; by default slices that are short enough.
            scale: The size of the scene; by default that of the mesh.

        Raises:
            ValueError: If the rigid bodies of the mesh are not in the order of worlds.
        """
        self._mesh, self._given, self._links, self._t_max = mesh, (start, end), links, t_max
        self._sharp = _SHARP * (mesh.length_scale if scale is None else scale)
        self._world_of_body = np.zeros(mesh.num_bodies, dtype=np.intp)
        filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
        self._world_of_body[filled] = mesh.vertex_world[mesh._stand_ins[mesh.body_vertex_range[filled]]]
        num_worlds = mesh.num_worlds
        self._world_of_link = np.repeat(np.arange(num_worlds), links.is_used.sum(axis=1))
        of_filled = np.isin(np.flatnonzero(mesh.rigid), filled)
        if (self._world_of_body[mesh.rigid] != self._world_of_link)[of_filled].any():
            raise ValueError(
                "motion has a row for each link of a world after those of the world before it; expected a "
                "mesh whose rigid bodies are in the order of their worlds"
            )
        self.world_toi = np.full(num_worlds, np.inf)
        self.num_passes = 0
        begin, self._end = span
        self._slices = slices_of_worlds(links.motion, *span) if num_slices is None else num_slices
        self.at = Windows.of(begin, (self._end - begin) / self._slices)
        self.is_open = np.ones(num_worlds, dtype=bool) if is_searched is None else is_searched.copy()
        self.found: list[Contacts] = []

    def windows(self) -> Iterator[tuple[Array, Array, MeshPaths]]:
        """Windows of the step, the same for all worlds: positions at both ends, and paths; they are those of a pass."""
        for part in Slice.all(int(self._slices.max()), self._t_max):
            begin, end = (np.full(self._mesh.num_worlds, t) for t in (part.t_begin, part.t_end))
            given, excess = self._links.paths(begin, end)
            yield self._positions(begin), self._positions(end), MeshPaths.of(self._mesh, given, excess)

    def run(self, solve: Solve, *, leave: int = 0) -> None:
        """Make passes until all worlds are settled, or no more than some are left."""
        most = int(self._slices.max(initial=0.0)) + _MOST_PASSES
        while self.is_open.sum() > leave:
            self.make_pass(solve, is_last=self.num_passes + 1 >= most)

    def make_pass(self, solve: Solve, *, is_last: bool = False) -> MeshResult:
        """Search a window of each open world; the result is that of the pass, with times of the windows."""
        mesh, is_open = self._mesh, self.is_open
        begin, longest, wanted, last, least = self.at
        end = begin + wanted
        end = np.where(begin + (1.0 + 2.0**-20) * wanted >= self._end, self._end, end)  # no rest of rounding
        end = np.where(is_open, end, begin)
        given, excess = self._links.paths(begin, end)
        paths = replace(MeshPaths.of(mesh, given, excess), active=is_open[self._world_of_body])
        result = solve(self._positions(begin), self._positions(end), paths)
        self.num_passes += 1
        local = result.world_toi
        is_free = np.isinf(local)
        length = end - begin
        reached = np.where(is_free, end, np.clip((begin + np.where(is_free, 0.0, local) * length) * _DOWN, begin, end))
        most = np.zeros(mesh.num_worlds)
        np.maximum.at(most, self._world_of_link, excess)
        # as the excess falls with the square of the window, one that has hardly fallen is rounding
        is_rounding = (length <= np.minimum(last / 4.0, _SHORT)) & (most >= least / 4.0)
        is_sharp = (most <= self._sharp) | (length <= _SHORTEST) | is_rounding | is_last
        touches = is_open & ~is_free & is_sharp
        self.world_toi[touches] = reached[touches]
        self._keep(result.contacts, touches, begin, length)
        self.is_open = is_open & ~touches & ~(is_free & (end >= self._end))
        gain, larger = reached - begin, np.maximum(last, length)
        ratio = np.divide(length, larger, out=np.ones_like(length), where=larger > 0.0)
        ahead = np.maximum(_GROWTH * gain * ratio**2, _LEAST * length)
        shorter = np.where(last > 0.0, np.minimum(length / 8.0, ahead), length / 8.0)
        self.at = Windows(
            reached,
            longest,
            np.where(is_free, np.minimum(_GROWTH * length, longest), shorter),
            np.where(is_free, last, length),
            np.where(is_free, least, most),
        )
        return result

    def _positions(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """The positions at a time of each world; links stay in their own frames."""
        start, end = self._given
        return start if start is end else moved(start, end, t[self._mesh.vertex_world])

    def _keep(
        self, contacts: Contacts, touches: NDArray[np.bool_], begin: NDArray[np.float64], length: NDArray[np.float64]
    ) -> None:
        """Keep the contacts of worlds that touch, at times of the step."""
        if not touches.any():
            return
        world = self._mesh.vertex_world[pair_vertices(self._mesh, contacts)[:, 0]]
        chosen = np.flatnonzero(touches[world])
        kept, of = contacts[chosen], world[chosen]
        # at the paths of this pass, whose times are those of a window
        place = ContactPlace(
            self._mesh, points=kept.points, relative_velocity=kept.relative_velocity / length[of][:, None]
        )
        toi = np.clip((begin[of] + kept.toi * length[of]) * _DOWN, begin[of], self._t_max)
        status = np.where((kept.status == int(CCDStatus.INITIAL_CONTACT)) & (toi > 0.0), 1, kept.status)
        arrays = {**vars(kept), "toi": toi, "status": status.astype(np.int32)}
        self.found.append(Contacts(**arrays)._of(place))


def slices_of_worlds(motion: "JointMotion", begin: Any, end: Any) -> Array:
    """How many slices a span of each world has, in none of which a link turns by more than `TURN_OF_A_SLICE`."""
    turns = motion._turns(begin, end).reshape(motion.num_worlds, -1).max(axis=1, initial=0.0)
    return np.maximum(1.0, np.ceil(turns / TURN_OF_A_SLICE))
