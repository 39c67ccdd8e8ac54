"""Gradients of times of impact of contacts and of pairs on the host, computed when they are asked for."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._contact_place import MovingVertices
from ccd_warp._contacts import Contacts
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.threads import default_num_threads
from ccd_warp._status import PairKind
from ccd_warp._toi_gradient import ToiGradient
from ccd_warp.kernels.step import toi_slope

_COLUMNS = dtypes_of(toi_slope.Slopes)
# The columns that are the points of a pair function.
_POINTS = {
    PairKind.VERTEX_FACE: [0, 1, 2, 3],
    PairKind.EDGE_EDGE: [0, 1, 2, 3],
    PairKind.POINT_SEGMENT: [0, 2, 3],
    PairKind.POINT_POINT: [0, 2],
}


def of_contacts(
    query: Any, contacts: Contacts, frames: MovingVertices, distances: NDArray[np.float64] | None
) -> ToiGradient:
    """The gradients of contacts whose vertices move straight, with the distance of each pair where they have one."""
    mesh, vertices = frames.mesh, contacts.vertices.copy()
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
    columns = contacts.toi, contacts.status, distances, normals if len(planes) else None
    slopes = _slopes(query, contacts.kind, ends, *columns)
    gradient = _expanded(slopes, list(range(4)), mesh.dimension)
    gradient[0][planes[~moves], 3] = gradient[1][planes[~moves], 3] = 0.0
    return ToiGradient(*gradient, slopes["distance"], slopes["is_regular"], vertices)


def of_pairs(
    query: Any,
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
    query: Any,
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

    def array(values: NDArray[Any] | None, dtype: Any) -> wp.array | None:
        if values is None:
            return None
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=False)

    inputs = [
        query,
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
