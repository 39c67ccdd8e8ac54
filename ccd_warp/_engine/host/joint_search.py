"""Links that joints move: passes over windows of the step, of which each world has its own, until a world is settled.

In a pass each link goes on the screw of a window (`JointMotion`), from which its true path is off by at most an excess
that falls with the square of the window. So a world is free where the pass finds it free; otherwise it is free up to
the toi found, where its next window begins, and is shorter, as the windows of a pair are (``kernels.pair.windows``). It
touches where a window ends in contacts whose excess is of the size of rounding.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contact_place import joined
from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.arcs import TURN_OF_A_SLICE, Slice
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths, moved
from ccd_warp._pairs import pair_bodies, pair_vertices
from ccd_warp._results import MeshResult
from ccd_warp._status import CCDStatus

if TYPE_CHECKING:
    from ccd_warp._joint_motion import JointMotion

# An excess below this share of the size of the scene is rounding, and a window below this share of the step ends.
_SHARP = 2.0**-46
_SHORTEST = 2.0**-44
_DOWN = 1.0 - 2.0**-50
_GROWTH, _LEAST = 4.0, 2.0**-10
# Passes beyond those that the slices of a step need, after which open worlds have the toi that is proved.
_MOST_PASSES = 1000

# Contacts along paths, of bodies whose vertices are at these positions at both ends of a pass.
Solve = Callable[[NDArray[np.float64], NDArray[np.float64], MeshPaths], MeshResult]


class JointSearch:
    """The earliest contacts of each world of a mesh whose rigid bodies are links that joints move.

    Attributes:
        world_toi: Toi of each world, inf where it is free, shape [W].
        num_passes: Number of passes.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        motion: "JointMotion",
        t_max: float,
        is_searched: NDArray[np.bool_] | None = None,
    ) -> None:
        """Begin a search; ``start`` and ``end`` are the positions of all vertices, of links in their own frames.

        Of worlds that are not searched, as ``is_searched`` says, nothing is known.
        """
        self._mesh, self._given, self._motion, self._t_max = mesh, (start, end), motion, t_max
        links = np.flatnonzero(mesh.rigid)
        self._world_of_body = np.zeros(mesh.num_bodies, dtype=np.intp)
        filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
        self._world_of_body[filled] = mesh.vertex_world[mesh.body_vertex_range[filled]]
        self._centre, self._reach = _spheres(mesh, start, links[: motion.num_links])
        num_worlds = mesh.num_worlds
        self.world_toi = np.full(num_worlds, np.inf)
        self.num_passes = 0
        turns = motion._turns(0.0, t_max).reshape(num_worlds, -1).max(axis=1, initial=0.0)
        self._slices = np.maximum(1.0, np.ceil(turns / TURN_OF_A_SLICE))
        self._begin = np.zeros(num_worlds)
        self._length = t_max / self._slices
        self._last = np.zeros(num_worlds)  # of the last window that ended in a contact
        self._is_open = np.ones(num_worlds, dtype=bool) if is_searched is None else is_searched.copy()
        self._found: list[Contacts] = []

    def windows(self) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64], MeshPaths]]:
        """Windows of the step, the same for all worlds: positions at both ends, and paths; they are those of a pass."""
        for part in Slice.all(int(self._slices.max()), self._t_max):
            begin, end = (np.full(self._mesh.num_worlds, t) for t in (part.t_begin, part.t_end))
            given, excess = self._motion._slices(begin, end, self._reach, self._centre)
            yield self._positions(begin), self._positions(end), MeshPaths.of(self._mesh, given, excess)

    def run(self, solve: Solve) -> None:
        """Make passes until all worlds are settled."""
        most = int(self._slices.max()) + _MOST_PASSES
        while self._is_open.any():
            self._pass(solve, is_last=self.num_passes + 1 >= most)

    def _pass(self, solve: Solve, *, is_last: bool) -> None:
        mesh, is_open, begin = self._mesh, self._is_open, self._begin
        end = np.minimum(begin + self._length, self._t_max)
        end = np.where(is_open, end, begin)
        given, excess = self._motion._slices(begin, end, self._reach, self._centre)
        paths = replace(MeshPaths.of(mesh, given, excess), active=is_open[self._world_of_body])
        result = solve(self._positions(begin), self._positions(end), paths)
        self.num_passes += 1
        local = result.world_toi
        is_free = np.isinf(local)
        length = end - begin
        reached = np.where(is_free, end, np.clip((begin + np.where(is_free, 0.0, local) * length) * _DOWN, begin, end))
        most = excess.reshape(mesh.num_worlds, -1).max(axis=1, initial=0.0)
        is_sharp = (most <= _SHARP * mesh.length_scale) | (length <= _SHORTEST) | is_last
        touches = is_open & ~is_free & is_sharp
        self.world_toi[touches] = reached[touches]
        self._keep(result.contacts, touches, begin, length)
        self._is_open = is_open & ~touches & ~(is_free & (end >= self._t_max))
        gain, last = reached - begin, np.maximum(self._last, length)
        ratio = np.divide(length, last, out=np.ones_like(length), where=last > 0.0)
        ahead = np.maximum(_GROWTH * gain * ratio**2, _LEAST * length)
        shorter = np.where(self._last > 0.0, np.minimum(length / 8.0, ahead), length / 8.0)
        longest = self._t_max / self._slices
        self._length = np.where(is_free, np.minimum(_GROWTH * length, longest), shorter)
        self._last = np.where(is_free, self._last, length)
        self._begin = reached

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
        _ = kept.points if kept._place is not None else None  # at the paths of this pass
        toi = np.clip((begin[of] + kept.toi * length[of]) * _DOWN, begin[of], self._t_max)
        status = np.where((kept.status == int(CCDStatus.INITIAL_CONTACT)) & (toi > 0.0), 1, kept.status)
        arrays = {**vars(kept), "toi": toi, "status": status.astype(np.int32)}
        self._found.append(Contacts(**arrays)._of(kept._place))

    def result(self, last: MeshResult) -> MeshResult:
        """The result of all passes; sizes and times are those of the last."""
        mesh = self._mesh
        contacts = joined(self._found) if self._found else last.contacts[:0]
        order = np.lexsort((*contacts.primitives.T[::-1], contacts.kind))
        contacts = contacts[order]
        of_vertices, of_bodies = pair_vertices(mesh, contacts), pair_bodies(mesh, contacts)
        of_worlds = mesh.vertex_world[of_vertices[:, :1]]
        vertex = firsts(contacts.toi, of_vertices, mesh.num_vertices)
        body = firsts(contacts.toi, of_bodies, mesh.num_bodies)
        world = firsts(contacts.toi, of_worlds, mesh.num_worlds)
        return replace(
            last,
            toi=float(self.world_toi.min()),
            vertex_toi=vertex[0],
            body_toi=body[0],
            contacts=contacts,
            vertex_contact=vertex[1],
            body_contact=body[1],
            world_toi=self.world_toi,
            world_contact=world[1],
            hidden_gaps="",
        )


def firsts(toi: NDArray[np.float64], owners: NDArray[Any], count: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The least toi of each owner, and the first contact that has it, -1 for none."""
    least, first = np.full(count, np.inf), np.full(count, len(toi), dtype=np.int32)
    for column in owners.T:
        np.minimum.at(least, column, toi)
    for column in owners.T:
        has_it = np.flatnonzero(toi == least[column])
        np.minimum.at(first, column[has_it], has_it.astype(np.int32))
    return least, np.where(first == len(toi), np.int32(-1), first)


def _spheres(
    mesh: CollisionMesh, vertices: NDArray[np.float64], links: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre and radius of a sphere around each link, in its own frame; worlds have the same links."""
    centre, reach = np.zeros((len(links), 3)), np.zeros(len(links))
    for k, link in enumerate(links.tolist()):
        own = vertices[slice(*mesh.body_vertex_range[link : link + 2])]
        if len(own):
            centre[k] = 0.5 * own.min(axis=0) + 0.5 * own.max(axis=0)
            reach[k] = np.linalg.norm(own - centre[k], axis=1).max() * (1.0 + 2.0**-50)
    return centre, reach
