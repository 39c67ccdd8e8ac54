"""What a rank hands in for a mesh, checked by itself. Without MPI."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arrays import as_array, as_positions, validated_indices
from ccd_warp._scene.input.mesh_checks import validated_radius


@dataclass(frozen=True)
class HandedIn:
    """The part of a mesh that a rank hands in; the arguments are those of :class:`DistributedMesh`.

    Attributes:
        vertices: Rest positions, which may be no numbers, float64, shape [n, 3] or [n, 2].
        vertex_ids: Id of each vertex, int64, shape [n].
        order: Rows of the vertices by ascending id.
        faces: Rows of the vertices of the faces, shape [f, 3].
        edges: Those of the codimensional edges, shape [e, 2].
        bodies: Body of each vertex.
        worlds: World of each vertex.
        radius: Radius of each vertex; None if none was given.
        owned: 1 where this rank says that it owns the vertex, 0 where not, -1 where it leaves this open.
    """

    vertices: NDArray[np.float64]
    vertex_ids: NDArray[np.int64]
    order: NDArray[np.intp]
    faces: NDArray[np.int64]
    edges: NDArray[np.int64]
    bodies: NDArray[np.int64]
    worlds: NDArray[np.int64]
    radius: NDArray[np.float64] | None
    owned: NDArray[np.int64]


def handed_in(
    dimension: int,
    half_spaces: Collection[int],
    vertices: ArrayLike,
    faces: ArrayLike | None,
    vertex_ids: ArrayLike,
    edges: ArrayLike | None,
    bodies: ArrayLike | None,
    vertex_world: ArrayLike | None,
    radius: ArrayLike | None,
    owned: ArrayLike | None,
) -> HandedIn:
    """Check what belongs to a rank alone.

    Args:
        dimension: Number of coordinates on all ranks.
        half_spaces: Bodies that are half-spaces.
        vertices: Positions on this rank; this and what follows as :class:`DistributedMesh` takes them.
        faces: Faces on this rank.
        vertex_ids: Ids of the vertices.
        edges: Codimensional edges.
        bodies: Body of each vertex.
        vertex_world: World of each vertex.
        radius: Radius of each vertex.
        owned: Which vertices this rank owns.

    Raises:
        ValueError: If an argument is not as described.
    """
    positions = as_positions(vertices, "vertices", dimension)  # which of them count, all ranks have to say
    count = len(positions)
    ids = _per_vertex("vertex_ids", vertex_ids, count)
    order = np.argsort(ids, kind="stable")
    ordered = ids[order]
    if (ordered[1:] == ordered[:-1]).any():
        again = ordered[1:][ordered[1:] == ordered[:-1]][0]
        raise ValueError(f"vertex_ids holds {again} more than once; expected each id once on a rank")
    face_rows = validated_indices(() if faces is None else faces, 3, count, "faces")
    if dimension == 2 and len(face_rows):
        raise ValueError(
            f"faces has shape {face_rows.shape}; expected none of a mesh in the plane, whose edges collide"
        )
    edge_rows = np.zeros((0, 2), dtype=np.int64) if edges is None else validated_indices(edges, 2, count, "edges")
    zeros = np.zeros(count, dtype=np.int64)
    body = zeros if bodies is None else _per_vertex("bodies", bodies, count)
    is_solid = np.isin(body, list(half_spaces))
    if is_solid.any():
        at = int(np.argmax(is_solid))
        raise ValueError(
            f"bodies gives vertex id {ids[at]} body {body[at]}, which is a half-space; expected the number of another "
            f"body"
        )
    world = (
        np.zeros(count, dtype=np.int64) if vertex_world is None else _per_vertex("vertex_world", vertex_world, count)
    )
    for name, corners in (("face", face_rows), ("edge", edge_rows)):
        for what, of in (("bodies", body), ("vertex_world", world)):
            _check_whole(name, corners, what, of)
    return HandedIn(
        positions,
        ids,
        order,
        face_rows,
        edge_rows,
        body,
        world,
        validated_radius(radius, [0, count], lambda row: f" (vertex id {ids[row]})", {}),
        _flags("owned", owned, count),
    )


def _check_whole(name: str, corners: NDArray[np.int64], what: str, of: NDArray[np.int64]) -> None:
    """Check that all vertices of a face, or of an edge, have one body or world."""
    if len(of) == 0 or of.min() == of.max():
        return
    values = of[corners]
    is_torn = np.logical_or.reduce([values[:, k] != values[:, 0] for k in range(1, corners.shape[1])])
    if is_torn.any():
        at = int(np.argmax(is_torn))
        raise ValueError(f"{what} gives {name} {at} the values {values[at].tolist()}; expected one")


def _flags(name: str, values: ArrayLike | None, count: int) -> NDArray[np.int64]:
    """One flag for each vertex as 0 or 1, -1 where none were given, or a ValueError."""
    if values is None:
        return np.full(count, -1, dtype=np.int64)
    flags: Any = as_array(values, name, f"bool and shape {(count,)}")
    if (flags.dtype != bool and flags.size) or flags.shape != (count,):
        raise ValueError(f"{name} has dtype {flags.dtype} and shape {flags.shape}; expected bool and {(count,)}")
    as_numbers: NDArray[np.int64] = flags.astype(np.int64)
    return as_numbers


def _per_vertex(name: str, values: ArrayLike, count: int) -> NDArray[np.int64]:
    """One integer of at least 0 for each vertex, or a ValueError."""
    array = as_array(values, name, f"integers and shape {(count,)}")
    if array.shape == (0,) == (count,):
        return np.zeros(0, dtype=np.int64)
    if array.shape != (count,) or array.dtype.kind not in "iu":
        raise ValueError(f"{name} has dtype {array.dtype} and shape {array.shape}; expected integers and {(count,)}")
    low, high = array.min(), array.max()
    if low < 0 or high > np.iinfo(np.int64).max:
        raise ValueError(f"{name} holds {low if low < 0 else high}; expected integers of at least 0, below 2**63")
    return array.astype(np.int64)
