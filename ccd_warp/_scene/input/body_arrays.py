"""Positions and indices, checked, and those of bodies, joined into the arrays of one mesh."""

import numbers
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arrays import as_any_array, as_positions, validated_indices
from ccd_warp._scene.input.names import body_label


def common_dimension(vertices: Mapping[int, Any], names: Sequence[str]) -> int:
    """2 if the vertices of all bodies, given by body, are in the plane, shape [n, 2], and 3 otherwise.

    Raises:
        ValueError: If those of some bodies are in the plane and those of others are not.
    """
    columns = {}
    for b, values in vertices.items():
        shape = np.shape(as_any_array(values, f"vertices of {body_label(b, names)}", "positions"))
        if len(shape) == 2:
            columns[b] = shape[1]
    planar = [b for b, count in columns.items() if count == 2]
    others = [b for b, count in columns.items() if count != 2]
    if planar and others:
        raise ValueError(
            f"vertices of {body_label(others[0], names)} has {columns[others[0]]} columns and those of "
            f"{body_label(planar[0], names)} 2; expected all bodies in the plane, or none"
        )
    return 2 if planar else 3


def check_bodies(bodies: Sequence[Any]) -> None:
    """Check that bodies are half-spaces, and tuples of as many arrays as a body has.

    Raises:
        ValueError: If one is neither; so are the rows of a list of positions that is given in place of bodies.
    """
    for b, body in enumerate(bodies):
        is_tuple = isinstance(body, (tuple, list)) and len(body) in (2, 3)
        is_row = is_tuple and all(isinstance(number, numbers.Number) for number in body)
        if is_row or not (is_tuple or isinstance(body, HalfSpace)):
            raise ValueError(
                f"body {b} is a {type(body).__name__}{' of numbers' if is_row else ''}; expected a pair (vertices, "
                f"faces) or a triple (vertices, faces, edges), all bodies in one list: from_arrays([(vertices, faces)])"
            )


class JoinedBodies(NamedTuple):
    """The arrays of all bodies.

    Attributes:
        vertices: Positions, float64, shape [V, 3], or [V, 2] in the plane.
        faces: Indices into these, int32, shape [F, 3].
        edges: The given edges, indices into the vertices, int32, shape [E, 2].
        offsets: Body b has the vertices offsets[b] … offsets[b + 1] - 1; a static half-space has none.
        consists_of_points: Bodies in the plane without edges, bool, shape [B].
        dimension: Number of coordinates.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    offsets: list[int]
    consists_of_points: NDArray[np.bool_]
    dimension: int


def joined_bodies(
    bodies: Sequence[Any], names: Sequence[str], points_of: Callable[[int, int], NDArray[np.float64]]
) -> JoinedBodies:
    """Check and join the arrays of bodies, at least one of which is no half-space; positions may be no numbers.

    The vertices of a half-space, at most one, are given by ``points_of`` for its body and a number of coordinates.

    Raises:
        ValueError: If an array is not as :meth:`ccd_warp.CollisionMesh.from_arrays` expects.
    """
    body_arrays = {b: body for b, body in enumerate(bodies) if not isinstance(body, HalfSpace)}
    dimension = common_dimension({b: body[0] for b, body in body_arrays.items()}, names)
    all_vertices, all_faces, all_edges, offsets = [], [], [np.zeros((0, 2), dtype=np.int64)], [0]
    consists_of_points = np.zeros(len(bodies), dtype=bool)
    for b in range(len(bodies)):
        begin = offsets[-1]
        if b in body_arrays:
            label, body = body_label(b, names), body_arrays[b]
            vertices = as_positions(body[0], f"vertices of {label}", dimension)  # which of them count is known later
            faces, edges = (body[1], body[2:]) if dimension == 3 else ((), body[1:])
            if len(edges) == 2:
                raise ValueError(f"{label} is in the plane and has 3 arrays; expected a pair (vertices, edges)")
            all_vertices.append(vertices)
            all_faces.append(validated_indices(faces, 3, len(vertices), f"faces of {label}") + begin)
            all_edges += [validated_indices(pairs, 2, len(vertices), f"edges of {label}") + begin for pairs in edges]
            consists_of_points[b] = dimension == 2 and len(all_edges[-1]) == 0
            begin += len(vertices)
        else:
            all_vertices.append(points_of(b, dimension))
            begin += len(all_vertices[-1])
        offsets.append(begin)
    num_faces, num_edges = sum(map(len, all_faces)), sum(map(len, all_edges))
    if max(offsets[-1], 3 * num_faces + num_edges) > np.iinfo(np.int32).max:
        raise ValueError(
            f"bodies hold {offsets[-1]} vertices, {num_faces} faces and {num_edges} codimensional edges; "
            f"expected counts whose edges int32 can index"
        )
    faces, edges = (np.concatenate(arrays).astype(np.int32) for arrays in (all_faces, all_edges))
    return JoinedBodies(np.concatenate(all_vertices), faces, edges, offsets, consists_of_points, dimension)
