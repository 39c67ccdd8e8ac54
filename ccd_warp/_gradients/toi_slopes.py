"""Gradients of times of impact of contacts and of pairs on the host, computed when they are asked for."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.toi_gradient import ToiGradient
from ccd_warp._rigid.rotations import in_space
from ccd_warp._rigid.turn_gradient import TurningPoints
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.threads import default_num_threads
from ccd_warp.kernels.gradients import toi_slope

if TYPE_CHECKING:
    from ccd_warp.kernels.gradients.toi_slope import Query

# Tangents of arcs at toi, which lead to the root at twice the digits each.
_MOST_TANGENTS = 8
_COLUMNS = dtypes_of(toi_slope.Slopes)
# The columns that are the points of a pair function.
_POINTS = {
    PairKind.VERTEX_FACE: [0, 1, 2, 3],
    PairKind.EDGE_EDGE: [0, 1, 2, 3],
    PairKind.POINT_SEGMENT: [0, 2, 3],
    PairKind.POINT_POINT: [0, 2],
}


def of_contacts(
    query: "Query", contacts: Contacts, frames: MovingVertices, distances: NDArray[np.float64] | None
) -> ToiGradient:
    """The gradients of contacts whose vertices move so, with the distance of each pair where they have one."""
    mesh, vertices = frames.mesh, contacts.vertices.copy()
    planes = np.flatnonzero(contacts.kind == int(PairKind.VERTEX_PLANE))
    of_plane = mesh.planes.vertices[contacts.primitives[planes, 1]]
    moves = of_plane >= 0
    vertices[planes[moves], 3] = of_plane[moves]
    rests = planes[~moves]
    is_resting = np.zeros(len(contacts), dtype=bool)
    is_resting[rests] = True
    normals = np.zeros((len(contacts), 3)) if len(planes) else None
    if normals is not None:
        normals[:, : mesh.dimension] = contacts.normal
    columns = contacts.kind, contacts.toi, contacts.status, distances, normals
    world = frames.worlds_of(contacts)

    def slopes_of(rows: slice | NDArray[np.intp], t: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """The slopes of some contacts, at these times where bodies turn."""
        of_rows, rest = vertices[rows], np.flatnonzero(is_resting[rows])
        resting = mesh.planes.points[contacts.primitives[rows][rest, 1]]
        ends: list[NDArray[np.float64]] = [np.zeros((*of_rows.shape, 3)) for _ in range(2)]
        straight = _straight_ends(frames, of_rows.ravel(), t, None if world is None else world[rows])
        for end, positions in zip(ends, straight, strict=True):
            end[..., : mesh.dimension] = positions[:, : mesh.dimension].reshape(*of_rows.shape, -1)
            end[rest, 3, : mesh.dimension] = resting
        of_contacts: Any = [None if column is None else column[rows] for column in columns]
        return _slopes(query, of_contacts[0], ends, *of_contacts[1:])

    slopes = slopes_of(slice(None), contacts.toi)
    if frames.paths is not None:
        _go_to_roots(slopes, slopes_of, contacts.toi)
    gradient = _expanded(slopes, list(range(4)), mesh.dimension)
    gradient[0][rests, 3] = gradient[1][rests, 3] = 0.0
    turning = None
    if frames.paths is not None:
        turning = _turning(contacts, frames, gradient[0] + gradient[1], slopes["time"], vertices)
        is_rigid = mesh.rigid[mesh.vertex_body[vertices]]
        gradient[0][is_rigid] = gradient[1][is_rigid] = 0.0
    return ToiGradient(*gradient, slopes["distance"], slopes["is_regular"], vertices)._of(turning)


def _go_to_roots(
    slopes: dict[str, NDArray[Any]],
    slopes_of: Callable[[NDArray[np.intp], NDArray[np.float64]], dict[str, NDArray[Any]]],
    toi: NDArray[np.float64],
) -> None:
    """Replace slopes on the tangents at toi by those on the tangents at the roots to which these lead."""
    rows, t = np.arange(len(toi)), toi
    before, t = t, np.where(slopes["is_regular"], slopes["time"], toi)
    moves = t != before
    for left in reversed(range(_MOST_TANGENTS - 1)):
        rows, before, t = rows[moves], before[moves], t[moves]
        if len(rows) == 0:
            break
        of_rows = slopes_of(rows, t)
        for name, column in of_rows.items():
            slopes[name][rows] = column
        following = np.where(of_rows["is_regular"], of_rows["time"], toi[rows])
        moves = following != t
        if left % 2 == 0:  # what goes to and fro between two times would end at this one
            moves &= following != before
        before, t = t, following


def _straight_ends(
    frames: MovingVertices, vertices: NDArray[np.integer], toi: NDArray[np.float64], world: NDArray[np.int32] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of vertices at both ends of the step, on the tangents of their arcs at toi where bodies turn."""
    if frames.paths is None:
        return frames._ends_of(vertices)
    num_corners = len(vertices) // len(toi)
    t, of_vertices = np.repeat(toi, num_corners)[:, None], None if world is None else np.repeat(world, num_corners)
    velocities = frames.velocities(vertices, t, of_vertices)
    start = frames.at(vertices, t, of_vertices) - t * velocities
    return start, start + velocities


def _turning(
    contacts: Contacts,
    frames: MovingVertices,
    gradient: NDArray[np.float64],
    time: NDArray[np.float64],
    vertices: NDArray[np.int32],
) -> TurningPoints:
    """The points of contacts on rigid bodies."""
    mesh = frames.mesh
    row_of_body = np.where(mesh.rigid, np.cumsum(mesh.rigid) - 1, -1)
    num_first = np.where(contacts.kind == int(PairKind.VERTEX_FACE), 1, 2)
    num_first[contacts.kind == int(PairKind.VERTEX_PLANE)] = 3
    side = (np.arange(4) >= num_first[:, None]).astype(np.intp)
    body = mesh.vertex_body[vertices]
    rows = row_of_body[body[:, [0, 3]]]
    rows[contacts.kind == int(PairKind.VERTEX_PLANE), 1] = -1
    num_rows, world = int(mesh.rigid.sum()), frames.worlds_of(contacts)
    if world is not None:
        rows = np.where(rows < 0, rows, world[:, None].astype(np.intp) * num_rows + rows)
        num_rows = len(frames.paths or ())
    points = frames._ends_of(vertices.ravel())[0].reshape(*vertices.shape, -1)
    return TurningPoints(num_rows, rows, in_space(points), side, in_space(gradient), time)


def of_pairs(
    query: "Query",
    kind: PairKind,
    ends: tuple[NDArray[np.float64], NDArray[np.float64]],
    toi: NDArray[np.float64],
    status: NDArray[np.int32],
) -> ToiGradient:
    """The gradients of pairs of a pair function, from their points in two or three dimensions."""
    dimension, columns = ends[0].shape[2], _POINTS[kind]
    in_space: list[NDArray[np.float64]] = [np.zeros((*end.shape[:2], 3)) for end in ends]
    for points, end in zip(in_space, ends, strict=True):
        points[..., :dimension] = end
    slopes = _slopes(query, kind, in_space, toi, status)
    return ToiGradient(*_expanded(slopes, columns, dimension), slopes["distance"], slopes["is_regular"])


def _expanded(
    slopes: dict[str, Any], columns: list[int], dimension: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The gradients by the start and the end of points: those of the four columns that are points."""
    along = slopes["weights"][:, columns, None] * -slopes["slope"][:, None, :dimension]
    t = slopes["time"][:, None, None]
    return (1.0 - t) * along, t * along


def _slopes(
    query: "Query",
    kind: PairKind | NDArray[np.int32],
    ends: list[NDArray[np.float64]],
    toi: NDArray[np.float64],
    status: NDArray[np.int32],
    distances: NDArray[np.float64] | None = None,
    planes: NDArray[np.float64] | None = None,
) -> dict[str, NDArray[Any]]:
    """The columns of ``Slopes`` for a table of pairs."""
    count, device = len(toi), wp.get_device("cpu")
    arrays: dict[str, wp.array] = {
        name: wp.empty(count, dtype=dtype, device=device) for name, dtype in _COLUMNS.items()
    }

    def array(values: NDArray[Any] | None, dtype: type) -> wp.array | None:
        if values is None:
            return None
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=False)

    columns = {
        "kinds": array(None if isinstance(kind, PairKind) else kind, wp.int32),
        "toi": array(toi, wp.float64),
        "status": array(status, wp.int32),
        "distances": array(distances, wp.float64),
        "planes": array(planes, wp.vec3d),
    }
    columns |= {name: array(end, wp.vec3d) for name, end in zip(("points_t0", "points_t1"), ends, strict=True)}
    pairs = struct_of(toi_slope.Table, {name: x for name, x in columns.items() if x is not None})
    inputs = [query, int(kind) if isinstance(kind, PairKind) else -1, pairs]
    execution = Execution(device, default_num_threads())
    execution.launch(toi_slope.fill_slopes, count, inputs, [struct_of(toi_slope.Slopes, arrays)], grain=256)
    return {name: column.numpy() for name, column in arrays.items()}
