"""Where contacts are: their vertices, and their positions at the time of impact."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contacts import Contacts
from ccd_warp._half_space import unit_normals
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths
from ccd_warp._pairs import pair_corners
from ccd_warp._status import PairKind

# Contacts at a time, so that intermediate arrays stay in the cache and out of the memory of a step.
_CHUNK = 1 << 12
# The positions of so many vertices, and of some more, are copied in the time in which the point of one contact is
# computed: with 50,000 vertices and 40,000 contacts in 0.6 ms in place of 3.
_VERTICES_A_POINT = 5
_FEW_VERTICES = 1 << 12

# Positions of vertices at a time of each.
_At = Callable[[NDArray[np.int32], NDArray[np.float64]], NDArray[np.float64]]


@dataclass
class ContactPlace:
    """The mesh of some contacts, and what has been computed from it or can be.

    Attributes:
        mesh: The mesh.
        frames: Positions at both ends of the step, of which nobody else holds the arrays; None if not needed or known.
        points: Points of the contacts, once they are computed.
        vertices: Vertices of the contacts, once they are computed.
        paths: Those of bodies that turn in the step; None where there are none.
    """

    mesh: CollisionMesh
    frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    points: NDArray[np.float64] | None = None
    vertices: NDArray[np.int32] | None = None
    paths: MeshPaths | None = None

    @property
    def has_points(self) -> bool:
        """Whether the points are known."""
        return self.points is not None or self.frames is not None

    def chosen(self, index: Any) -> "ContactPlace":
        """The place of some of the contacts."""
        return ContactPlace(
            self.mesh,
            self.frames,
            None if self.points is None else self.points[index],
            None if self.vertices is None else self.vertices[index],
            self.paths,
        )

    def points_of(self, contacts: Contacts) -> NDArray[np.float64] | None:
        """The points of the contacts to which this belongs; None if they are not known."""
        if self.points is None and self.frames is not None:
            self.points = points_at_toi(self.mesh, *self.frames, contacts, self.paths)
        return self.points


def located(
    contacts: Contacts,
    mesh: CollisionMesh,
    start: NDArray[np.float64] | None = None,
    end: NDArray[np.float64] | None = None,
    paths: MeshPaths | None = None,
) -> Contacts:
    """Contacts that know their mesh and their points in a step between these positions of all vertices.

    The positions may be arrays of the caller, who changes them afterwards. Where there are many contacts, the positions
    are therefore copied, and the points computed when they are asked for; otherwise the points are computed at once.
    Without positions the points stay unknown. Positions and normals have three columns, or of a mesh in the plane the
    positions two; of such a mesh two are kept. ``paths`` are those of bodies that turn, whose positions are in their
    own frames.
    """
    place = ContactPlace(mesh, paths=paths)
    if mesh.dimension == 2:
        contacts = replace(contacts, normal=contacts.normal[:, :2].copy())
        start, end = (None if x is None else x[:, :2] for x in (start, end))
    if len(contacts) == 0:
        place.points = np.zeros((0, mesh.dimension))
    elif start is not None and end is not None:
        if len(start) < _VERTICES_A_POINT * len(contacts) + _FEW_VERTICES:
            place.frames = start.copy(), end.copy()
        else:
            place.points = points_at_toi(mesh, start, end, contacts, paths)
    return Contacts(**vars(contacts))._of(place)


def joined(parts: Sequence[Contacts]) -> Contacts:
    """The contacts of one list or more of the same mesh, one list after the other."""
    contacts = Contacts(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})
    places: list[ContactPlace | None] = [part._place for part in parts]
    if places[0] is None or not all(place is not None and place.has_points for place in places):
        return contacts
    return contacts._of(ContactPlace(places[0].mesh, points=np.concatenate([part.points for part in parts])))


def points_at_toi(
    mesh: CollisionMesh,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    contacts: Contacts,
    paths: MeshPaths | None = None,
) -> NDArray[np.float64]:
    """Midpoints of the two closest points of each contact, shape [m, 3] or [m, 2].

    The positions are those of all vertices at both ends of the step, shape [V, 3] or [V, 2]; of bodies on ``paths`` in
    their own frames.

    Raises:
        ValueError: If the contacts refer to primitives that the mesh does not have.
    """

    def at(vertices: NDArray[np.int32], t: NDArray[np.float64]) -> NDArray[np.float64]:
        if paths is not None:
            return paths.at(mesh, start, end, t, vertices)
        return (1.0 - t) * start.take(vertices, axis=0) + t * end.take(vertices, axis=0)

    points = np.empty((len(contacts), start.shape[1]))
    for kind in PairKind:
        of_kind = np.flatnonzero(contacts.kind == kind)
        for k in range(0, len(of_kind), _CHUNK):
            chosen: Any = of_kind[k : k + _CHUNK]
            if chosen[-1] - chosen[0] == len(chosen) - 1:
                chosen = slice(chosen[0], chosen[-1] + 1)  # contacts are mostly sorted by kind
            corners = pair_corners(mesh, kind, contacts.primitives[chosen])
            toi, parameters = contacts.toi[chosen, None], contacts.parameters[chosen]
            if kind == PairKind.VERTEX_PLANE:
                points[chosen] = _at_planes(mesh, contacts.primitives[chosen], at, toi)
            else:
                points[chosen] = _midpoints(kind, corners, at, toi, parameters)
    return points


def _midpoints(
    kind: PairKind,
    corners: tuple[NDArray[np.int32], NDArray[np.int32]],
    at: _At,
    t: NDArray[np.float64],
    parameters: NDArray[np.float64],
) -> NDArray[np.float64]:
    u, v = parameters.T[..., None]
    weights: Any = {
        PairKind.VERTEX_FACE: lambda: ([1.0], [1.0 - u - v, u, v]),
        PairKind.EDGE_EDGE: lambda: ([1.0 - u, u], [1.0 - v, v]),
        PairKind.POINT_SEGMENT: lambda: ([1.0], [1.0 - u, u]),
        PairKind.POINT_POINT: lambda: ([1.0], [1.0]),
    }[kind]()
    sides = [
        sum(w * at(i, t) for w, i in zip(side_weights, side.T, strict=True))
        for side_weights, side in zip(weights, corners, strict=True)
    ]
    return 0.5 * sides[0] + 0.5 * sides[1]


def _at_planes(
    mesh: CollisionMesh,
    primitives: NDArray[np.int32],
    at: _At,
    t: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Midpoints of vertices and the points of their planes that are closest to them."""
    vertices, number = primitives.T
    x = at(vertices, t)
    columns = x.shape[1]
    # of a mesh in the plane the positions of a picture have three coordinates
    points, unit = (mesh._in_space(a)[:, :columns] for a in (mesh.planes.points, unit_normals(mesh.planes.normals)))
    point = points[number]
    moves = mesh.planes.vertices[number] >= 0
    if moves.any():
        of_point = mesh.planes.vertices[number[moves]]
        point[moves] = at(of_point, t[moves])
    half, normal = 0.5 * x - 0.5 * point, unit[number]
    depth = half[:, 0] * normal[:, 0] + half[:, 1] * normal[:, 1]
    if columns == 3:
        depth += half[:, 2] * normal[:, 2]
    midpoints: NDArray[np.float64] = x - depth[:, None] * normal
    return midpoints
