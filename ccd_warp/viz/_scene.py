"""The content of a picture of a step in its own coordinates; this module needs only NumPy."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contact_place import BodyMotion, points_at_toi
from ccd_warp._results.results import HostLaunchResult, MeshResult
from ccd_warp._runtime.display import listed, shortened
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.input.arguments import check_instance
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.viz._moving import arcs_of, moving_vertices, outermost

STATIC_COLOUR = "#c6c6c2"
CROSSING_COLOUR = "#d6008f"
MOVING_COLOURS = ("#5b87b5", "#d09a55", "#7fa678", "#a27fae", "#c27a70", "#6aa8a6")
# A contact counts as one of the earliest if it is at most this fraction of the step after the first.
_SAME_TOI = 1e-6
# Share of white in the colour of a moving body where it touches nothing.
_PALE = 0.72
# Moving bodies that the legend names.
_MOST_NAMED = 3
# Half the side of the squares that show half-spaces, in halves of the longest side of the scene.
_SQUARE = 1.25
# Trails of more bodies than this hide the scene.
_MOST_TRAILS = 50


@dataclass(frozen=True)
class StepScene:
    """A step translated and scaled so that its box is centred at the origin and its longest side is 2.

    Attributes:
        start: Positions at t = 0, float64, shape [V, 3].
        end: Positions at t = 1, float64, shape [V, 3].
        faces: Vertex indices, shape [F, 3].
        segments: Vertex indices of codimensional edges, shape [S, 2].
        points: Indices of the vertices in no face and no edge, shape [P].
        vertex_body: Body of each vertex, shape [V].
        static: Bodies that do not move, bool, shape [B].
        kinematic: Bodies that move as they are told, bool, shape [B].
        vertex_toi: Earliest toi of each vertex, inf if none, float64, shape [V].
        toi: Earliest toi of the scene, inf if none.
        contact_points: Positions of the contacts, float64, shape [m, 3].
        contact_normals: Their unit normals, or 0, float64, shape [m, 3].
        contact_is_first: Contacts that are the earliest, bool, shape [m].
        names: Name of each body.
        squares: Corners of squares in the planes of those half-spaces that the box reaches, shape [H, 4, 3].
        place: Positions at a time, shape [V, 3], where bodies turn; None where all vertices move straight.
        arcs: Paths of some vertices of bodies that turn, shape [k, 3] each.
        between: Outermost positions between both ends of the step, where bodies turn, shape [n, 3].
        crossing_points: Places where surfaces cross at the start, as far as they are known, shape [k, 3].
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    faces: NDArray[np.int32]
    segments: NDArray[np.int32]
    points: NDArray[np.int32]
    vertex_body: NDArray[np.int32]
    static: NDArray[np.bool_]
    kinematic: NDArray[np.bool_]
    vertex_toi: NDArray[np.float64]
    toi: float
    contact_points: NDArray[np.float64]
    contact_normals: NDArray[np.float64]
    contact_is_first: NDArray[np.bool_]
    names: tuple[str, ...]
    squares: NDArray[np.float64]
    place: Callable[[float], NDArray[np.float64]] | None = None
    arcs: list[NDArray[np.float64]] = field(default_factory=list)
    between: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    crossing_points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))

    def positions(self, t: float) -> NDArray[np.float64]:
        """Positions at a time, shape [V, 3]."""
        if self.place is not None:
            return self.place(t)
        return (1.0 - t) * self.start + t * self.end

    @property
    def ends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What a view is to show of the motion: positions at both ends, and what lies farther out between them."""
        return np.concatenate([self.start, self.between]), np.concatenate([self.end, self.between])

    @lazy_property
    def vertex_colours(self) -> NDArray[np.uint8]:
        """Red, green and blue of each vertex's body, shape [V, 3]."""
        palette = np.array([_rgb(colour) for colour in MOVING_COLOURS])
        of_body = palette[(np.cumsum(~self.static) - 1) % len(palette)]
        of_body[self.static] = _rgb(STATIC_COLOUR)
        return of_body[self.vertex_body]

    @property
    def plane_colour(self) -> NDArray[np.uint8]:
        """Red, green and blue of half-spaces, which are static."""
        return _rgb(STATIC_COLOUR)

    @lazy_property
    def pale_colours(self) -> NDArray[np.uint8]:
        """Colours of vertices that touch nothing, where others show a toi: pale, but for static bodies."""
        pale = (_PALE * 255.0 + (1.0 - _PALE) * self.vertex_colours).astype(np.uint8)
        is_static = self.static[self.vertex_body]
        pale[is_static] = self.vertex_colours[is_static]
        return pale

    @lazy_property
    def legend(self) -> list[tuple[NDArray[np.uint8], str]]:
        """Colours and what they mean: the first moving bodies, all static ones unless all are, and crossings."""
        kinds = [
            "static" if s else "kinematic" if k else "moving" for s, k in zip(self.static, self.kinematic, strict=True)
        ]
        moving, static = np.flatnonzero(~self.static).tolist(), np.flatnonzero(self.static).tolist()
        palette = [_rgb(colour) for colour in MOVING_COLOURS]
        count = len(moving) if len(moving) <= _MOST_NAMED else _MOST_NAMED - 1
        entries = [
            (palette[k % len(palette)], f"{shortened(self.names[body])}, {kinds[body]}")
            for k, body in enumerate(moving[:count])
        ]
        if count < len(moving):
            others = " and ".join(sorted({kinds[body] for body in moving[count:]}, reverse=True))
            entries.append((palette[count % len(palette)], f"and {len(moving) - count} more, {others}"))
        if moving and static:
            entries.append((_rgb(STATIC_COLOUR), f"{listed([self.names[body] for body in static])}, static"))
        return entries + ([(_rgb(CROSSING_COLOUR), "surfaces cross")] if len(self.crossing_points) else [])

    @lazy_property
    def body_edge_length(self) -> NDArray[np.float64]:
        """Mean length of the sides of each body's faces, 0 without faces, shape [B]."""
        corners = self.start[self.faces]
        lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
        body, count = self.vertex_body[self.faces[:, 0]], len(self.static)
        total = np.bincount(body, weights=lengths, minlength=count)
        return total / np.maximum(np.bincount(body, minlength=count), 1)

    @lazy_property
    def trails(self) -> list[NDArray[np.float64]]:
        """Paths of the centres of bodies that move farther than their own size, and of vertices of those that turn."""
        moving = np.flatnonzero(~self.static)
        trails: list[NDArray[np.float64]] = []
        for body in moving if len(moving) <= _MOST_TRAILS else ():
            start, end = (frame[self.vertex_body == body] for frame in (self.start, self.end))
            if len(start):
                ends = np.array([start.mean(axis=0), end.mean(axis=0)])
                trails += [ends] if np.ptp(ends, axis=0).max() > np.ptp(start, axis=0).max() else []
        return trails + self.arcs


def check_result(result: object) -> None:
    """Raise a ValueError if it is no result with the contacts of a step on the host."""
    if not isinstance(result, HostLaunchResult):
        check_instance("result", result, MeshResult)


def make_scene(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    result: MeshResult | HostLaunchResult,
    motion: BodyMotion | None = None,
) -> StepScene:
    """Transform a step into the coordinates of the picture.

    Raises:
        ValueError: If the mesh is empty, or the positions, the motion or the result do not match it.
    """
    moving = moving_vertices(mesh, *mesh._both_placed(*mesh.frames(vertices_t0, vertices_t1)), motion)
    start, end = moving.start, moving.end
    if len(start) == 0:
        raise ValueError("mesh has no vertices; expected something to draw")
    if np.shape(result.vertex_toi) != (len(start),):
        raise ValueError(f"result.vertex_toi has shape {np.shape(result.vertex_toi)}; expected {(len(start),)}")
    contacts = result.contacts
    points = points_at_toi(moving, contacts)
    between = np.zeros((0, 3))
    if moving.paths is not None:
        start, end = moving.all_at(0.0), moving.all_at(1.0)
        between = np.concatenate([outermost(moving.all_at(t)) for t in moving.times])
    centre, unit = middle_of(np.concatenate([start, between]), np.concatenate([end, between]))
    is_first = np.asarray(contacts.toi) <= result.toi + _SAME_TOI
    squares = (plane_squares(mesh, centre, unit) - centre) / unit
    is_point = np.ones(mesh.num_vertices, dtype=bool)
    for covered in (mesh.faces, mesh.edges, mesh.unused_vertices):
        is_point[covered] = False
    return StepScene(
        start=(start - centre) / unit,
        end=(end - centre) / unit,
        faces=mesh.faces,
        segments=mesh.edges[mesh.codimensional_edges],
        points=np.flatnonzero(is_point).astype(np.int32),
        vertex_body=mesh.vertex_body,
        static=mesh.static,
        kinematic=mesh.kinematic,
        names=mesh.names,
        # those whose middle is not far from the box of the picture; a plane far below would not be seen
        squares=squares[np.linalg.norm(squares.mean(axis=1), axis=1) < 2.0 * _SQUARE],
        vertex_toi=np.asarray(result.vertex_toi),
        toi=float(result.toi),
        contact_points=(points - centre) / unit,
        contact_normals=mesh._in_space(np.asarray(contacts.normal)),
        contact_is_first=is_first,
        place=None if moving.paths is None else lambda t: (moving.all_at(t) - centre) / unit,
        arcs=[(arc - centre) / unit for arc in arcs_of(moving, _MOST_TRAILS)],
        between=(between - centre) / unit,
        crossing_points=(_crossing_points(mesh, result) - centre) / unit,
    )


def plane_squares(mesh: CollisionMesh, centre: NDArray[np.float64], unit: float) -> NDArray[np.float64]:
    """Corners of a square in the plane of each half-space, shape [H, 4, 3].

    They are below the middle of a box, half of whose longest side is ``unit``, and larger than it.
    """
    squares = []
    points, normals = mesh._in_space(mesh.planes.points), mesh._in_space(unit_normals(mesh.planes.normals))
    for point, normal in zip(points, normals, strict=True):
        below = centre - (centre - point) @ normal * normal
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        across /= np.linalg.norm(across)
        along = np.cross(normal, across)
        corners = np.array([across + along, along - across, -across - along, across - along])
        squares.append(below + _SQUARE * unit * corners)
    return np.array(squares).reshape(-1, 4, 3)


def middle_of(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Middle of the box around a step, and half its longest side, 1 if it has none."""
    lower = np.minimum(start.min(axis=0), end.min(axis=0))
    upper = np.maximum(start.max(axis=0), end.max(axis=0))
    half_sides = 0.5 * upper - 0.5 * lower  # also for the largest coordinates, whose difference overflows
    return lower + half_sides, float(half_sides.max()) or 1.0


def _crossing_points(mesh: CollisionMesh, result: MeshResult | HostLaunchResult) -> NDArray[np.float64]:
    """Where surfaces cross at the start, where the result has it."""
    start = getattr(result, "start", None)
    return np.zeros((0, 3)) if start is None else mesh._in_space(start.points[start.is_crossing])


def _rgb(colour: str) -> NDArray[np.uint8]:
    return np.frombuffer(bytes.fromhex(colour[1:]), dtype=np.uint8)
