"""Checks of half-spaces."""

import numbers
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.half_space import HalfSpace, Planes
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_array, as_float64


def planes_of(
    half_spaces: Iterable[tuple[int, str, HalfSpace]], dimension: int, offsets: Sequence[int] | None = None
) -> Planes:
    """The planes of half-spaces, each given with its body and what messages call that.

    A body with a vertex, between two of the ``offsets``, is kinematic: the vertex is the point of its plane.

    Raises:
        ValueError: If a point or a normal does not have as many finite numbers as the mesh has coordinates, or a normal
            is 0.
    """
    points, normals, bodies, vertices = [], [], [], []
    for body, label, half_space in half_spaces:
        points.append(_vector(half_space.point, f"point of {label}", dimension))
        normal = _vector(half_space.normal, f"normal of {label}", dimension)
        if not normal.any():
            raise ValueError(f"normal of {label} is {normal.tolist()}; expected a direction, which 0 is not")
        normals.append(normal)
        bodies.append(body)
        has_vertex = offsets is not None and offsets[body] < offsets[body + 1]
        vertices.append(offsets[body] if offsets is not None and has_vertex else -1)
    shape = (-1, dimension)
    return Planes(
        np.array(points, dtype=np.float64).reshape(shape),
        np.array(normals, dtype=np.float64).reshape(shape),
        np.array(bodies, dtype=np.int32),
        np.array(vertices, dtype=np.int32),
    )


def points_of(half_space: HalfSpace, label: str, dimension: int, *, is_kinematic: bool) -> NDArray[np.float64]:
    """The vertices of a half-space: its point if it is kinematic, shape [1, d], and none otherwise, shape [0, d]."""
    return _vector(half_space.point, f"point of {label}", dimension)[None][: int(is_kinematic)]


def half_spaces_by_body(values: object) -> dict[int, HalfSpace]:
    """Half-spaces by the number of the body that each of them is, ascending.

    Raises:
        ValueError: If they are no mapping, a key is no such number, or a value is something else.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"half_spaces is {shown(values)}; expected a mapping from numbers of bodies to HalfSpace")
    by_body = {}
    for body, half_space in values.items():
        is_number = isinstance(body, numbers.Integral) and not isinstance(body, (bool, np.bool_))
        if not is_number or not 0 <= body <= np.iinfo(np.int32).max:
            raise ValueError(f"half_spaces has the key {shown(body)}; expected the number of a body")
        if not isinstance(half_space, HalfSpace):
            raise ValueError(f"half_spaces holds {shown(half_space)} for body {body}; expected a HalfSpace")
        by_body[int(body)] = half_space
    return dict(sorted(by_body.items()))


def _vector(values: object, name: str, dimension: int) -> NDArray[np.float64]:
    """As many finite float64 numbers as there are coordinates, or a ValueError."""
    array = as_array(values, name, f"{dimension} numbers")
    if array.shape != (dimension,):
        raise ValueError(f"{name} has shape {array.shape}; expected {(dimension,)}")
    vector = as_float64(array[None], name)[0]
    if not np.isfinite(vector).all():
        raise ValueError(f"{name} is {vector.tolist()}; expected finite numbers")
    return vector
