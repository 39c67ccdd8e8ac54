"""Gradients of times of impact: those of contacts and of pairs, computed when they are asked for."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._display import counted
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.threads import default_num_threads
from ccd_warp._status import PairKind
from ccd_warp._touch import Touch
from ccd_warp.kernels.step import toi_slope

if TYPE_CHECKING:
    from ccd_warp._contacts import Contacts

_COLUMNS = dtypes_of(toi_slope.Slopes)
# The columns that are the points of a pair function.
_POINTS = {
    PairKind.VERTEX_FACE: [0, 1, 2, 3],
    PairKind.EDGE_EDGE: [0, 1, 2, 3],
    PairKind.POINT_SEGMENT: [0, 2, 3],
    PairKind.POINT_POINT: [0, 2],
}


@dataclass(frozen=True, eq=False, repr=False)
class ToiGradient:
    """How times of impact change with the points of their pairs at both ends of the step, to first order.

    To first order toi changes by the sum of ``start`` times the moves of the points at the start, ``end`` times those
    at the end, and ``distance`` times the change of the distance at which the pair counts as touching. Where a contact
    lies on the border of a face or an edge, that holds for moves that keep it on the primitive.

    Attributes:
        start: d toi / d start position of each point, in 1 / length, float64, shape [n, points, 3], or [n, points, 2]
            in the plane. The points are those of the columns of ``vertices``; of a pair function those of the call.
        end: d toi / d end position of each point, of the same shape.
        distance: d toi / d distance, in 1 / length, float64, shape [n]: that of the minimum distance, of the minimum
            separation as a length, and of each of the two radii of the pair. Never above 0.
        is_regular: Whether the toi has a gradient, bool, shape [n]. Where it has none, all of it is 0: with a toi of
            inf or 0, at ``t_max``, at a limit, where the two graze each other or only come within the tolerance, and
            where a toi jumps rather than moves, as that of a point on a point or on an edge in space without a
            distance.
        vertices: Vertices of the mesh whose positions the points are, int32, shape [n, 4]: the columns of
            ``contacts.vertices``; of a plane that moves the last is the vertex that is its point. Columns that repeat a
            vertex are 0. None for pair functions.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    distance: NDArray[np.float64]
    is_regular: NDArray[np.bool_]
    vertices: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.distance)

    def __repr__(self) -> str:
        return f"ToiGradient({counted(len(self), 'pair', 'pairs')}, {np.count_nonzero(self.is_regular):,} regular)"


def of_contacts(contacts: "Contacts") -> ToiGradient:
    """The gradients of contacts that know how their vertices move straight, and what counts as touching.

    Raises:
        ValueError: If they do not.
    """
    place = contacts._known()
    if len(contacts) == 0:
        none = np.zeros((0, 4, place.mesh.dimension))
        return ToiGradient(none, none, np.zeros(0), np.zeros(0, dtype=bool), contacts.vertices)
    frames, touch = place.frames, place.touch
    if frames is not None and frames.paths is not None:
        raise ValueError("contacts are those of a call with a motion on arcs; expected vertices that move straight")
    if frames is None or touch is None:
        raise ValueError(
            "contacts do not know the positions and the distance of their step; expected those of mesh_ccd, "
            "or of a launch by to_host()"
        )
    mesh, vertices = place.mesh, contacts.vertices.copy()
    ends: Any = [np.zeros((len(contacts), 4, 3)) for _ in range(2)]
    planes = np.flatnonzero(contacts.kind == int(PairKind.VERTEX_PLANE))
    of_plane = mesh.planes.vertices[contacts.primitives[planes, 1]]
    moves = of_plane >= 0
    vertices[planes[moves], 3] = of_plane[moves]
    for end, positions in zip(ends, frames._ends_of(vertices.ravel()), strict=True):
        end[..., : mesh.dimension] = positions[:, : mesh.dimension].reshape(*vertices.shape, -1)
        rests = planes[~moves]
        end[rests, 3, : mesh.dimension] = mesh.planes.points[contacts.primitives[rests, 1]]
    normals = np.zeros((len(contacts), 3))
    normals[:, : mesh.dimension] = contacts.normal
    slopes = _slopes(
        touch,
        contacts.kind,
        ends,
        contacts.toi,
        contacts.status,
        distances=touch.distances(mesh, contacts.kind, contacts.vertices),
        planes=normals if len(planes) else None,
        is_planar=mesh.dimension == 2,
    )
    gradient = _expanded(slopes, list(range(4)), mesh.dimension)
    gradient[0][planes[~moves], 3] = gradient[1][planes[~moves], 3] = 0.0
    return ToiGradient(*gradient, slopes["distance"], slopes["is_regular"], vertices)


def of_pairs(
    touch: Touch,
    kind: PairKind,
    ends: tuple[NDArray[np.float64], NDArray[np.float64]],
    toi: NDArray[np.float64],
    status: NDArray[np.int32],
) -> ToiGradient:
    """The gradients of pairs of a pair function, from their points in two or three dimensions."""
    dimension, columns = ends[0].shape[2], _POINTS[kind]
    in_space: Any = [np.zeros((*end.shape[:2], 3)) for end in ends]
    for points, end in zip(in_space, ends, strict=True):
        points[..., :dimension] = end
    slopes = _slopes(touch, kind, in_space, toi, status, is_planar=dimension == 2)
    return ToiGradient(*_expanded(slopes, columns, dimension), slopes["distance"], slopes["is_regular"])


def _expanded(
    slopes: dict[str, Any], columns: list[int], dimension: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The gradients by the start and the end of points: those of the four columns that are points."""
    along = slopes["weights"][:, columns, None] * -slopes["slope"][:, None, :dimension]
    t = slopes["time"][:, None, None]
    return (1.0 - t) * along, t * along


def _slopes(
    touch: Touch,
    kind: PairKind | NDArray[np.int32],
    ends: list[NDArray[np.float64]],
    toi: NDArray[np.float64],
    status: NDArray[np.int32],
    *,
    distances: NDArray[np.float64] | None = None,
    planes: NDArray[np.float64] | None = None,
    is_planar: bool,
) -> dict[str, NDArray[Any]]:
    """The columns of ``Slopes`` for a table of pairs."""
    touch.check()
    count, device = len(toi), wp.get_device("cpu")
    arrays: dict[str, wp.array] = {
        name: wp.empty(count, dtype=dtype, device=device) for name, dtype in _COLUMNS.items()
    }

    def array(values: NDArray[Any] | None, dtype: Any) -> wp.array | None:
        if values is None:
            return None
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=False)

    inputs = [
        touch.query(is_planar=is_planar),
        int(kind) if isinstance(kind, PairKind) else -1,
        None if isinstance(kind, PairKind) else array(kind, wp.int32),
        *(array(end, wp.vec3d) for end in ends),
        array(toi, wp.float64),
        array(status, wp.int32),
        array(distances, wp.float64),
        array(planes, wp.vec3d),
        None,
    ]
    execution = Execution(device, default_num_threads())
    execution.launch(toi_slope.fill_slopes, count, inputs, [struct_of(toi_slope.Slopes, arrays)], grain=256)
    return {name: each.numpy() for name, each in arrays.items()}
