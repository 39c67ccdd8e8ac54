"""Where contacts are and how they move: their vertices, their positions and velocities at the time of impact."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.contacts import Contacts
from ccd_warp._results.distinct import distinct, first_of
from ccd_warp._results.pairs import as_slice, pair_corners, pair_vertices, radii_of_pairs
from ccd_warp._results.toi_gradient import ToiGradient
from ccd_warp._results.touch import Touch
from ccd_warp._runtime.quick import of_values
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.mesh import CollisionMesh

# Contacts at a time, so that intermediate arrays stay in the cache and out of the memory of a step.
_CHUNK = 1 << 12
# The positions of so many vertices, and of some more, are copied in the time in which those of one contact are chosen.
_VERTICES_A_CONTACT = 5
_FEW_VERTICES = 1 << 12
# Turn between two of the times that stand for an arc, in radians, and the most of these times.
TURN, _MOST_TIMES = 0.1, 500
# Radii of vertices, and of the largest primitive around each.
Radii = tuple[NDArray[np.float64], NDArray[np.float64]]
# What contacts have by their place.
_PLACED = ("points", "relative_velocity", "world")

# A time of all vertices, or of each, shape [n, 1].
Times = float | NDArray[np.float64]


class Paths(Protocol):
    """The paths of all bodies of a mesh, of which some turn; their rows are numbers of bodies, or of those of worlds.

    Attributes:
        is_of_worlds: Whether they are those of a mesh of one world in many: body b in world w has the number w B + b.
    """

    is_of_worlds: ClassVar[bool]

    def __len__(self) -> int: ...

    @property
    def omega(self) -> NDArray[np.float64]:
        """The turn of each body, a rotation vector, shape [N, 3]."""

    @property
    def excess(self) -> NDArray[np.float64]:
        """How far points of each body may be from its path, a length, shape [N]."""

    def places(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Times
    ) -> NDArray[np.float64]:
        """Where vertices of these bodies, with these positions at both ends, are at a time, shape [n, 3]."""

    def velocities(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Times
    ) -> NDArray[np.float64]:
        """How they move at a time, as displacements in the whole step, shape [n, 3]."""


@dataclass(frozen=True)
class MovingVertices:
    """How vertices move in a step.

    Attributes:
        mesh: The mesh.
        start: Positions at the start of the step, of bodies on ``paths`` in their own frames, shape [n, 3] or [n, 2].
        end: Those at its end.
        paths: Paths of bodies that turn, or of those of a mesh of one world in many; None where there are none.
        rows: The vertices whose positions these are, ascending, int, shape [n]; None for all of them.
    """

    mesh: CollisionMesh
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    paths: Paths | None = None
    rows: NDArray[np.integer] | None = None

    @property
    def times(self) -> NDArray[np.float64]:
        """Times between which every vertex moves nearly straight, from 0 to 1."""
        turn = 0.0 if self.paths is None else float(np.linalg.norm(self.paths.omega, axis=1).max(initial=0.0))
        return np.linspace(0.0, 1.0, 2 + min(int(turn / TURN), _MOST_TIMES))

    def copied(self, contacts: Contacts) -> "MovingVertices":
        """The same, of arrays that nobody else holds, with what the contacts need."""
        if len(self.start) < _VERTICES_A_CONTACT * len(contacts) + _FEW_VERTICES:
            return MovingVertices(self.mesh, self.start.copy(), self.end.copy(), self.paths)
        is_needed = np.zeros(len(self.start), dtype=bool)
        is_needed[contacts.vertices] = True
        is_needed[self.mesh.planes.vertices[self.mesh.planes.vertices >= 0]] = True
        rows = np.flatnonzero(is_needed)
        return replace(self, start=self.start[rows], end=self.end[rows], rows=rows)

    def worlds_of(self, contacts: Contacts) -> NDArray[np.int32] | None:
        """The world of each contact, where the paths are those of many worlds of the mesh."""
        return contacts.world if self.paths is not None and self.paths.is_of_worlds else None

    def at(
        self, vertices: NDArray[np.integer], t: Times, world: NDArray[np.int32] | None = None
    ) -> NDArray[np.float64]:
        """Positions of vertices at a time of all, or of each, shape [n, 1], in a world of each where there are many."""
        start, end = self._ends_of(vertices)
        if self.paths is not None:
            return self.paths.places(self._bodies_of(vertices, world), start, end, t)
        return (1.0 - t) * start + t * end

    def all_at(self, t: float) -> NDArray[np.float64]:
        """Positions of all vertices at a time, shape [V, 3] or [V, 2]."""
        return self.at(np.arange(len(self.start)), t)

    def velocities(
        self, vertices: NDArray[np.integer], t: NDArray[np.float64], world: NDArray[np.int32] | None = None
    ) -> NDArray[np.float64]:
        """How vertices move at a time of each, as displacements in the whole step."""
        start, end = self._ends_of(vertices)
        if self.paths is not None:
            return self.paths.velocities(self._bodies_of(vertices, world), start, end, t)
        return np.subtract(end, start, dtype=np.float64)

    def _bodies_of(self, vertices: NDArray[np.integer], world: NDArray[np.int32] | None) -> NDArray[np.integer]:
        """The bodies of vertices, by their numbers in the paths."""
        bodies: NDArray[np.integer] = self.mesh.vertex_body[vertices]
        return bodies if world is None else world.astype(np.int64) * self.mesh.num_bodies + bodies

    def _ends_of(self, vertices: NDArray[np.integer]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rows = vertices if self.rows is None else np.searchsorted(self.rows, vertices)
        return self.start.take(rows, axis=0), self.end.take(rows, axis=0)


@runtime_checkable
class BodyMotion(Protocol):
    """A motion that turns bodies (:class:`ccd_warp.RigidMotion`), as pictures know it."""

    def _moving(self, mesh: CollisionMesh, start: NDArray[np.float64], end: NDArray[np.float64]) -> MovingVertices:
        """How all vertices move between positions in space, of the rigid bodies in their own frames."""


@dataclass
class ContactPlace:
    """The mesh of some contacts, and what has been computed from it or can be.

    Attributes:
        mesh: The mesh.
        frames: How the vertices of the contacts move, in arrays that nobody else holds; None if it is not known.
        points: Points of the contacts, once they are computed.
        relative_velocity: Their relative velocities, once they are computed.
        vertices: Vertices of the contacts, once they are computed.
        world: Their worlds, once they are computed.
        touch: What counts as touching in their step; None if it is not known.
        radii: Radii of the vertices of the step; None where there are none.
    """

    # of a query, contacts, how their vertices move and their distances; set where the calls are put together
    gradients_of: ClassVar[Callable[..., ToiGradient]]

    mesh: CollisionMesh
    frames: MovingVertices | None = None
    points: NDArray[np.float64] | None = None
    relative_velocity: NDArray[np.float64] | None = None
    vertices: NDArray[np.int32] | None = None
    world: NDArray[np.int32] | None = None
    touch: Touch | None = None
    radii: Radii | None = None

    @property
    def tolerance(self) -> float:
        """The length up to which places of contacts are the same; 0 where it is not known."""
        return 0.0 if self.touch is None else self.touch.tolerance

    @property
    def has_points(self) -> bool:
        """Whether the points are known."""
        return self.points is not None or self.frames is not None

    def subset(self, index: slice | NDArray[Any]) -> "ContactPlace":
        """The place of some of the contacts."""
        columns = {name: getattr(self, name) for name in ("points", "relative_velocity", "vertices", "world")}
        columns_of_rows: Any = {name: None if column is None else column[index] for name, column in columns.items()}
        return replace(self, **columns_of_rows)

    def points_of(self, contacts: Contacts) -> NDArray[np.float64] | None:
        """The points of the contacts to which this belongs; None if they are not known."""
        if self.points is None and self.frames is not None:
            self.points = _points(self.frames, contacts, self.radii)
        return self.points

    def relative_velocity_of(self, contacts: Contacts) -> NDArray[np.float64] | None:
        """Their relative velocities; None if they are not known."""
        if self.relative_velocity is None and self.frames is not None:
            self.relative_velocity = _relative_velocities(self.frames, contacts)
        return self.relative_velocity

    def unique_of(self, contacts: Contacts) -> Contacts:
        """One contact for each two features that touch."""
        rows, toi = distinct(contacts, None if self.frames is None else self.frames.at)
        kept, place = contacts._subset(rows), self.subset(rows)
        if place.frames is not None:  # points are then those of the toi that it has now
            place = replace(place, points=None)
        return replace(kept, toi=toi)._of(place)

    def first_of(self, contacts: Contacts) -> int:
        """The index of the first contact, as `Outcome.first` has it; without velocities of the earliest in the list."""
        if self.relative_velocity is None and self.frames is None:
            return int(np.argmin(contacts.toi))
        return first_of(contacts, None if self.frames is None else self.frames.at)

    def toi_gradient_of(self, contacts: Contacts) -> ToiGradient:
        """How their tois change.

        Raises:
            ValueError: If it is not known.
        """
        if len(contacts) == 0:
            none = np.zeros((0, 4, self.mesh.dimension))
            return ToiGradient(none, none, np.zeros(0), np.zeros(0, dtype=bool), contacts.vertices)
        if self.frames is not None and self.frames.paths is not None and self.frames.paths.excess.any():
            raise ValueError("contacts are those of a motion with within; expected one whose paths are known")
        if self.frames is None or self.touch is None:
            raise ValueError(
                "contacts do not know the positions and the distance of their step; expected those of mesh_ccd, "
                "or of a launch by to_host()"
            )
        query = self.touch.query(is_planar=self.mesh.dimension == 2)
        distances = self.touch.distances(self.mesh, contacts.kind, contacts.vertices)
        return ContactPlace.gradients_of(query, contacts, self.frames, distances)


def located(
    contacts: Contacts,
    mesh: CollisionMesh,
    start: NDArray[np.float64] | None = None,
    end: NDArray[np.float64] | None = None,
    paths: Paths | None = None,
    touch: Touch | None = None,
    radii: Radii | None = None,
) -> Contacts:
    """These contacts, which know now their mesh and where they are in a step between these positions of all vertices.

    The positions may be arrays of the caller, who changes them afterwards. They are therefore copied: all of them, or
    where there are few contacts theirs alone. Points and velocities are computed when they are asked for, and without
    positions stay unknown. Positions and normals have three columns, or of a mesh in the plane the positions two; of
    such a mesh two are kept. ``paths`` are those of bodies that turn, whose positions are in their own frames;
    ``touch`` is what counts as touching, without which there are no gradients; ``radii`` are those of vertices.
    """
    place: ContactPlace = of_values(ContactPlace, {"mesh": mesh, "touch": touch, "radii": radii})
    if mesh.dimension == 2:
        contacts = replace(contacts, normal=contacts.normal[:, :2].copy())
        start, end = (None if x is None else x[:, :2] for x in (start, end))
    if len(contacts) == 0:
        place.points = place.relative_velocity = np.zeros((0, mesh.dimension))
    contacts = contacts._of(place)
    if len(contacts) and start is not None and end is not None:
        place.frames = MovingVertices(mesh, start, end, paths).copied(contacts)
    return contacts


def joined(parts: Sequence[Contacts]) -> Contacts:
    """The contacts of one list or more of the same mesh, one list after the other."""
    if len(parts) == 1:
        return parts[0]
    contacts = Contacts(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})
    places: list[ContactPlace | None] = [part._place for part in parts]
    if places[0] is None:
        return contacts
    names = _PLACED if all(place is not None and place.has_points for place in places) else _PLACED[-1:]
    placed: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return contacts._of(ContactPlace(places[0].mesh, **placed))


def points_at_toi(frames: MovingVertices, contacts: Contacts) -> NDArray[np.float64]:
    """Where the surfaces of each contact touch, given how all vertices move, with the radii of the mesh.

    Raises:
        ValueError: If the contacts refer to primitives that the mesh does not have.
    """
    return _points(frames, contacts, radii_of(frames.mesh))


def radii_of(mesh: CollisionMesh) -> Radii | None:
    """Radii of the vertices of a mesh, and the largest of the primitives around each; None where it has none."""
    return None if mesh.radius is None else (mesh.radius, mesh._largest_around(mesh.radius))


def _points(frames: MovingVertices, contacts: Contacts, radii: Radii | None) -> NDArray[np.float64]:
    """Midpoints of the closest points of the two surfaces, each a radius from the closest point of its primitive."""
    points, world = np.empty((len(contacts), frames.start.shape[1])), frames.worlds_of(contacts)
    for kind in PairKind:
        of_kind = np.flatnonzero(contacts.kind == kind)
        for k in range(0, len(of_kind), _CHUNK):
            rows = as_slice(of_kind[k : k + _CHUNK])
            corners = pair_corners(frames.mesh, kind, contacts.primitives[rows])
            toi, parameters = contacts.toi[rows, None], contacts.parameters[rows]
            world_of_rows = None if world is None else world[rows]
            if kind == PairKind.VERTEX_PLANE:
                points[rows] = _at_planes(frames, contacts.primitives[rows], toi, world_of_rows)
            else:
                points[rows] = _midpoints(kind, corners, frames, toi, parameters, world_of_rows)
    if radii is not None and len(contacts):
        first, second = radii_of_pairs(contacts.kind, pair_vertices(frames.mesh, contacts), *radii).T
        points[:, : contacts.normal.shape[1]] += (0.5 * (second - first))[:, None] * contacts.normal
    return points


def _midpoints(
    kind: PairKind,
    corners: tuple[NDArray[np.int32], NDArray[np.int32]],
    frames: MovingVertices,
    t: NDArray[np.float64],
    parameters: NDArray[np.float64],
    world: NDArray[np.int32] | None,
) -> NDArray[np.float64]:
    u, v = parameters.T[..., None]
    weights: Any = {
        PairKind.VERTEX_FACE: lambda: ([1.0], [1.0 - u - v, u, v]),
        PairKind.EDGE_EDGE: lambda: ([1.0 - u, u], [1.0 - v, v]),
        PairKind.POINT_SEGMENT: lambda: ([1.0], [1.0 - u, u]),
        PairKind.POINT_POINT: lambda: ([1.0], [1.0]),
    }[kind]()
    sides = [
        sum(w * frames.at(i, t, world) for w, i in zip(side_weights, side.T, strict=True))
        for side_weights, side in zip(weights, corners, strict=True)
    ]
    return 0.5 * sides[0] + 0.5 * sides[1]


def _at_planes(
    frames: MovingVertices, primitives: NDArray[np.int32], t: NDArray[np.float64], world: NDArray[np.int32] | None
) -> NDArray[np.float64]:
    """Midpoints of vertices and the points of their planes that are closest to them."""
    mesh = frames.mesh
    vertices, number = primitives.T
    x = frames.at(vertices, t, world)
    columns = x.shape[1]
    # of a mesh in the plane the positions of a picture have three coordinates
    points, unit = (mesh._in_space(a)[:, :columns] for a in (mesh.planes.points, unit_normals(mesh.planes.normals)))
    point = points[number]
    moves = mesh.planes.vertices[number] >= 0
    if moves.any():
        of_point = mesh.planes.vertices[number[moves]]
        point[moves] = frames.at(of_point, t[moves])
    half, normal = 0.5 * x - 0.5 * point, unit[number]
    depth = half[:, 0] * normal[:, 0] + half[:, 1] * normal[:, 1]
    if columns == 3:
        depth += half[:, 2] * normal[:, 2]
    midpoints: NDArray[np.float64] = x - depth[:, None] * normal
    return midpoints


def _relative_velocities(frames: MovingVertices, contacts: Contacts) -> NDArray[np.float64]:
    """Velocities of the first closest points less those of the second, shape [m, 3] or [m, 2]."""
    mesh, columns, world = frames.mesh, frames.start.shape[1], frames.worlds_of(contacts)
    velocities = np.empty((len(contacts), columns))
    for k in range(0, len(contacts), _CHUNK):
        chunk = slice(k, k + _CHUNK)
        vertices, toi = contacts.vertices[chunk], contacts.toi[chunk]
        of_corners = None if world is None else np.repeat(world[chunk], vertices.shape[1])
        of_vertices = frames.velocities(vertices.ravel(), np.repeat(toi, vertices.shape[1])[:, None], of_corners)
        weights = contacts.weights[chunk, :, None]
        velocities[chunk] = (weights * of_vertices.reshape(*vertices.shape, columns)).sum(axis=1)
    of_planes = np.flatnonzero(contacts.kind == int(PairKind.VERTEX_PLANE))
    points = mesh.planes.vertices[contacts.primitives[of_planes, 1]]
    moves = points >= 0  # those that move have a vertex of their own, and the others none
    of_planes, points = of_planes[moves], points[moves]
    velocities[of_planes] -= frames.velocities(points, contacts.toi[of_planes, None])
    return velocities
