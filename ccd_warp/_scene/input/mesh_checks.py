"""Validation of what a mesh says of its bodies: which move and collide, their worlds, rings and radii."""

import numbers
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arguments import check_count, check_items, check_real, shown
from ccd_warp._scene.input.arrays import as_any_array, as_array, as_float64
from ccd_warp._scene.input.excluded_pairs import validated_rows, with_indices
from ccd_warp._scene.input.names import body_label, is_default_name


def vertices_without_primitive(
    num_vertices: int, faces: NDArray[np.int32], edges: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Vertices in no face and in no edge that is none of a face, ascending."""
    is_without = np.ones(num_vertices, dtype=bool)
    is_without[faces] = is_without[edges] = False
    return np.flatnonzero(is_without).astype(np.int32)


def validated_static(
    static: Iterable[int | str] | None, kinematic: Iterable[int | str] | None, names: Sequence[str]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which bodies are static, and which are kinematic, bool, shape [B] each, or a ValueError; none may be both."""
    is_static, is_kinematic = _listed_bodies("static", static, names), _listed_bodies("kinematic", kinematic, names)
    for body in np.flatnonzero(is_static & is_kinematic)[:1].tolist():
        raise ValueError(f"static and kinematic both hold {body_label(body, names)}; expected it in one of them")
    return is_static, is_kinematic


def validated_rigid(
    rigid: Iterable[int | str] | None, names: Sequence[str], is_half_space: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which bodies are rigid, bool, shape [B], or a ValueError; half-spaces have no shape to keep."""
    is_rigid = _listed_bodies("rigid", rigid, names)
    for body in np.flatnonzero(is_rigid & is_half_space)[:1].tolist():
        raise ValueError(f"rigid holds {body_label(body, names)}, a half-space; expected bodies with vertices")
    return is_rigid


def _listed_bodies(name: str, values: Iterable[int | str] | None, names: Sequence[str]) -> NDArray[np.bool_]:
    """Bodies given by their indices or names, bool, shape [B]; None is none of them."""
    num_bodies = len(names)
    is_listed = np.zeros(num_bodies, dtype=bool)
    for body in listed_bodies(name, values):
        if isinstance(body, str) and body in names:
            body = names.index(body)
        is_flag = isinstance(body, (bool, np.bool_))
        if not isinstance(body, numbers.Integral) or is_flag or not 0 <= body < num_bodies:
            of_flags = f"; of one flag a body np.flatnonzero({name})" if is_flag else ""
            raise ValueError(
                f"{name} holds {shown(body)}; expected body indices in [0, {num_bodies}) or names of bodies{of_flags}"
            )
        is_listed[int(body)] = True
    return is_listed


def listed_bodies(name: str, values: Iterable[int | str] | None) -> list[int | str]:
    """The items of a list of bodies, none of None, or a ValueError where it is no list."""
    expected = "a list of body indices or names, and all bodies in one list before it"
    return [] if values is None else check_items(name, values, expected)


def validated_flags(values: bool | Sequence[bool], num_bodies: int, name: str) -> NDArray[np.bool_]:
    """One bool for each body, or a ValueError."""
    array = as_any_array(values, name, "a bool or one bool a body")
    if array.dtype != bool:
        raise ValueError(f"{name} is {shown(values)}; expected a bool or one bool a body")
    if array.shape not in ((), (num_bodies,)):
        raise ValueError(f"{name} has shape {array.shape}; expected a bool or {(num_bodies,)}, one a body")
    return np.array(np.broadcast_to(array, (num_bodies,)))


def validated_body_pairs(values: object, names: Sequence[str]) -> NDArray[np.bool_] | None:
    """Which bodies may collide, symmetric, bool, shape [B, B], of flags or of the pairs that may; or a ValueError."""
    if values is None:
        return None
    num_bodies = len(names)
    shape = (num_bodies, num_bodies)
    expected = f"pairs of bodies that may collide, as [(0, 1)] or by name, or bool and shape {shape}"
    values = check_items("body_pairs", values, expected) if isinstance(values, (Set, Iterator)) else values
    array = as_array(values, "body_pairs", expected)
    if array.dtype.kind == "U":
        array = as_array(with_indices(values, "body_pairs", names, expected), "body_pairs", expected)
    elif array.shape == shape and (array.dtype == bool or (array.dtype.kind in "iu" and np.isin(array, (0, 1)).all())):
        if array.tolist() == [[1, 0], [0, 1]] and array.dtype != bool:
            raise ValueError(
                "body_pairs is [[1, 0], [0, 1]], by flags no two bodies and by pairs both; expected bool, or [(0, 1)]"
            )
        return _symmetric(array, names)
    if array.size and (array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind not in "iu"):
        raise ValueError(f"body_pairs has dtype {shown(array.dtype)} and shape {array.shape}; expected {expected}")
    column = ("body", num_bodies, None)
    a, b = validated_rows(array, "body_pairs", column, column).T
    for body in a[a == b][:1].tolist():
        raise ValueError(
            f"body_pairs holds {body_label(body, names)} with itself; expected pairs of two bodies, and self_collision "
            f"for one"
        )
    may_collide = np.zeros((num_bodies, num_bodies), dtype=bool)
    may_collide[a, b] = may_collide[b, a] = True
    return may_collide


def _symmetric(array: NDArray[Any], names: Sequence[str]) -> NDArray[np.bool_]:
    """Flags as bool, or a ValueError if they are not symmetric."""
    if not np.array_equal(array, array.T):
        a, b = np.argwhere(array != array.T)[0]
        pair = ""
        if not (is_default_name(names[a], int(a)) and is_default_name(names[b], int(b))):
            pair = f", {body_label(int(a), names)} and {body_label(int(b), names)}"
        raise ValueError(f"body_pairs differs at ({a}, {b}) and ({b}, {a}){pair}; expected a symmetric array")
    return np.array(array, dtype=bool)


def validated_rings(value: int) -> int:
    """A positive integer, or a ValueError."""
    return check_count("exclusion_rings", value, np.iinfo(np.int64).max)


def validated_radius(
    values: ArrayLike | None,
    first_vertices: Sequence[int],
    where: Callable[[int], str],
    half_spaces: Mapping[int, str] | None = None,
) -> NDArray[np.float64] | None:
    """A radius for each vertex, or a ValueError.

    Args:
        values: One number, or one for each body or vertex; None stays.
        first_vertices: First vertex of each body, and the number of all vertices.
        where: What a message adds to the number of a vertex.
        half_spaces: What messages call the bodies that are half-spaces, which have no radius.
    """
    if values is None:
        return None
    num_bodies, num_vertices = len(first_vertices) - 1, first_vertices[-1]
    if isinstance(values, numbers.Real):
        number = check_real("radius", values, "a finite length of at least 0, or an array of these", lambda x: x >= 0)
        return np.full(num_vertices, number)
    expected = f"a number, shape {(num_bodies,)}, one a body, or {(num_vertices,)}, one a vertex"
    array = as_any_array(values, "radius", expected)
    if array.shape not in ((), (num_bodies,), (num_vertices,)):
        raise ValueError(f"radius has shape {array.shape}; expected {expected}")
    radii = as_float64(np.atleast_1d(array), "radius", "entry")
    is_invalid = ~(np.isfinite(radii) & (radii >= 0))
    if is_invalid.any():
        at = int(np.argmax(is_invalid))
        owner = where(at) if num_bodies != len(radii) == num_vertices else ""
        raise ValueError(f"radius holds {radii[at]} in entry {at}{owner}; expected finite lengths of at least 0")
    radii = radii + 0.0  # a copy, with -0.0 as 0.0
    if array.ndim == 0:
        return np.full(num_vertices, radii[0])
    for body, label in half_spaces.items() if half_spaces and len(radii) == num_bodies else ():
        if radii[body] != 0.0:
            raise ValueError(f"radius holds {radii[body]} for {label}; expected 0, as a half-space has no radius")
    of_bodies = np.repeat(radii, np.diff(first_vertices)) if len(radii) == num_bodies else radii
    if len(radii) == num_vertices and not np.array_equal(radii, of_bodies):
        raise ValueError(
            f"radius has shape {array.shape}, as many entries as there are bodies and vertices, and bodies with "
            f"several vertices or none; expected a number, or bodies of one vertex each"
        )
    return of_bodies


def validated_worlds(
    values: ArrayLike | None,
    num_vertices: int,
    primitives: dict[str, NDArray[np.int32]],
    where: Callable[[int], str],
) -> NDArray[np.int32]:
    """A world for each vertex, the same for all vertices of a primitive, or a ValueError; ``where`` names its body."""
    if values is None:
        return np.zeros(num_vertices, dtype=np.int32)
    array = as_array(values, "vertex_world", f"integers and shape {(num_vertices,)}")
    if array.shape == (0,) == (num_vertices,):
        return np.zeros(0, dtype=np.int32)
    if array.shape != (num_vertices,) or array.dtype.kind not in "iu":
        raise ValueError(
            f"vertex_world has dtype {shown(array.dtype)} and shape {array.shape}; "
            f"expected integers and {(num_vertices,)}"
        )
    for world in (array.min(initial=0), array.max(initial=0)):
        if not 0 <= world < max(num_vertices, 1):
            raise ValueError(
                f"vertex_world holds {world}; expected worlds from 0 on, below the number of vertices, {num_vertices}"
            )
    for name, corners in primitives.items():
        worlds = array[corners]
        is_torn = (worlds != worlds[:, :1]).any(axis=1)
        if is_torn.any():
            at = int(np.argmax(is_torn))
            place = f"{name} {at}{where(int(corners[at, 0]))}"
            raise ValueError(f"vertex_world gives {place} worlds {worlds[at].tolist()}; expected one")
    return array.astype(np.int32)
