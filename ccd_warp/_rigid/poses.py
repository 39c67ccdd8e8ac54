"""Poses of bodies as positions and quaternions x y z w, from whatever form they are given in, or a ValueError."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.rotations import quaternions_of_matrices, scaled
from ccd_warp._runtime.display import counted
from ccd_warp._scene.input.arguments import check_real, shown
from ccd_warp._scene.input.arrays import as_any_array, as_array, as_float64, is_of_warp, is_on_gpu

# How far columns of a matrix may be from orthonormal, and the end of a twist from the end pose, relative.
TOLERANCE = 1e-6
_ORDERS = {False: "quaternion x y z w, scalar last", True: "quaternion w x y z, scalar first"}


def shown_body(row: int, leading: tuple[int, ...]) -> str:
    """A body in a message: "body 3", or "body 3 of world 2"."""
    *worlds, count = leading
    return f"body {row % count} of world {row // count}" if worlds else f"body {row}"


def shown_bodies(leading: tuple[int, ...]) -> str:
    """How many bodies there are: "3 bodies in each of 2 worlds"."""
    *worlds, count = leading
    bodies = counted(count, "body", "bodies")
    return f"{bodies} in each of {counted(worlds[0], 'world', 'worlds')}" if worlds else bodies


def read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """The array, which cannot be written to any more."""
    array.flags.writeable = False
    return array


def checked_rows(
    values: object, name: str, tails: tuple[tuple[int, ...], ...], expected: str
) -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Finite numbers of each body, a copy of shape [N, *tail], and the leading shape: (B,), or (W, B) of worlds.

    Raises:
        ValueError: If the array has none of the shapes, or a number is not finite.
    """
    array = as_array(read_values(values, name), name, expected)
    for tail in tails:
        leading = array.shape[: array.ndim - len(tail)]
        if len(leading) in (1, 2) and array.shape[len(leading) :] == tail:
            rows = as_float64(array, name).reshape(-1, *tail).copy()
            check_rows_finite(rows, name, leading)
            return rows, leading
    raise ValueError(f"{name} has shape {array.shape}; expected {expected}")


def check_rows_finite(
    rows: NDArray[np.float64], name: str, leading: tuple[int, ...], expected: str = "finite numbers"
) -> None:
    """Raise a ValueError that names the body if a number is not finite."""
    finite = np.isfinite(rows)
    if not finite.all():
        at = tuple(np.argwhere(~finite)[0])
        raise ValueError(f"{name} holds {rows[at]} for {shown_body(int(at[0]), leading)}; expected {expected}")


def checked_poses(
    values: object, name: str, *, scalar_first: bool = False
) -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Positions and scaled quaternions x y z w, shape [N, 7], and the leading shape: (B,), or (W, B) of worlds.

    Raises:
        ValueError: If they are no poses; it names the first body that has none.
    """
    form = f"shape (B, 7), position and {_ORDERS[scalar_first]}"
    if not scalar_first:
        form += ", or (B, 4, 4)"
    form += ", with an axis of worlds before the others if there are several"
    rows, leading = checked_rows(values, name, ((7,),) if scalar_first else ((7,), (4, 4)), form)
    if rows.ndim == 3:
        return _of_matrices(rows, name, leading), leading
    if scalar_first:
        rows = rows[:, [0, 1, 2, 4, 5, 6, 3]]
    zero = ~rows[:, 3:].any(axis=1)
    if zero.any():
        raise ValueError(
            f"{name} has a quaternion of length 0 for {shown_body(int(zero.argmax()), leading)}; "
            f"expected any other length ({_ORDERS[scalar_first]})"
        )
    rows[:, 3:] = scaled(rows[:, 3:])
    return rows, leading


def checked_pivot(values: object, leading: tuple[int, ...]) -> NDArray[np.float64]:
    """Pivots in the bodies' frames, shape [N, 3]: one for all bodies, one a body, or one a body of each world.

    Raises:
        ValueError: If they are not of a shape that fits, or not finite.
    """
    count = leading[-1]
    shapes = [(3,), (count, 3), (*leading, 3)][: 1 + len(leading)]
    expected = f"shape {' or '.join(map(str, shapes))}, in the bodies' frames"
    array = as_array(read_values(values, "pivot"), "pivot", expected)
    if array.shape not in shapes:
        raise ValueError(f"pivot has shape {array.shape}; expected {expected}")
    array = as_float64(array[None] if array.ndim == 1 else array, "pivot")
    rows = np.broadcast_to(array, (*leading, 3)).reshape(-1, 3).copy()
    check_rows_finite(rows, "pivot", leading)
    return rows


def checked_fractions(values: object, leading: tuple[int, ...]) -> NDArray[np.float64]:
    """Fractions of the step, shape [N]: one for all bodies, one a body, or one a body of each world.

    Raises:
        ValueError: If one is not in [0, 1], or there are not as many as bodies.
    """
    return _checked_numbers(values, "t", leading, "a fraction in [0, 1], or such fractions", 1.0)


def checked_lengths(values: object, name: str, leading: tuple[int, ...]) -> NDArray[np.float64]:
    """Lengths, shape [N]: one for all bodies, one a body, or one a body of each world.

    Raises:
        ValueError: If one is below 0 or not finite, or there are not as many as bodies.
    """
    most = float(np.finfo(np.float64).max)
    return _checked_numbers(values, name, leading, "a finite length of at least 0, or such lengths", most)


def _checked_numbers(
    values: object, name: str, leading: tuple[int, ...], expected: str, most: float
) -> NDArray[np.float64]:
    """Numbers of at least 0, and of at most another one, shape [N]: one for all bodies, or one of each.

    Raises:
        ValueError: If one is another number, or there are not as many as bodies.
    """
    shapes = [leading[-1:], leading][: len(leading)]
    expected += f" of shape {' or '.join(map(str, shapes))}"
    array = as_any_array(read_values(values, name), name, expected)
    if array.ndim == 0:
        return np.full(math.prod(leading), check_real(name, values, expected, lambda x: 0.0 <= x <= most))
    if array.shape not in shapes:
        raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
    rows = np.broadcast_to(as_float64(array[None], name)[0], leading).reshape(-1) + 0.0
    wrong = ~((rows >= 0.0) & (rows <= most))
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(f"{name} is {rows[row]} for {shown_body(row, leading)}; expected {expected}")
    return rows


def check_leading(name: str, shape: tuple[int, ...], leading: tuple[int, ...]) -> None:
    """Raise a ValueError if an argument is not of as many bodies and worlds as ``poses_t0``."""
    if shape != leading:
        raise ValueError(f"{name} is of {shown_bodies(shape)}; expected {shown_bodies(leading)} like poses_t0")


def check_ends(
    ends: NDArray[np.float64], poses: NDArray[np.float64], scale: NDArray[np.float64], leading: tuple[int, ...]
) -> None:
    """Raise a ValueError if the path of a twist does not end at the poses that are given, to 1e-6.

    Args:
        ends: Where the paths end, shape [N, 7], unit quaternions.
        poses: Those that were given for it.
        scale: What a difference of positions, and of rotations in radians, is relative to, shape [N, 2].
        leading: The shape of the bodies.
    """
    apart = np.abs(ends[:, :3] - poses[:, :3]).max(axis=1, initial=0.0)
    signs = np.where((ends[:, 3:] * poses[:, 3:]).sum(axis=1) < 0.0, -1.0, 1.0)
    chords = np.sqrt(((ends[:, 3:] - signs[:, None] * poses[:, 3:]) ** 2).sum(axis=1))
    turned = 4.0 * np.arcsin(0.5 * chords)  # of half the angle, and no digits lost where it is small
    wrong = (apart > TOLERANCE * scale[:, 0]) | (turned > TOLERANCE * scale[:, 1])
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"twist ends {apart[row]:.3g} and {turned[row]:.3g} rad away from poses_t1 for "
            f"{shown_body(row, leading)}; expected the same pose to {TOLERANCE:g}, relative, or only one of them"
        )


def read_values(values: object, name: str) -> Any:
    """What NumPy can read, from any library and device."""
    if is_of_warp(values) or is_on_gpu(values, name):
        from ccd_warp._scene.input.interop import as_warp

        return as_warp(values, name).numpy()
    return values


def _of_matrices(rows: NDArray[np.float64], name: str, leading: tuple[int, ...]) -> NDArray[np.float64]:
    """Positions and quaternions of matrices, shape [N, 4, 4]."""
    wrong = (rows[:, 3] != [0.0, 0.0, 0.0, 1.0]).any(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        bottom = shown((rows[row, 3] + 0.0).tolist())
        raise ValueError(f"{name} has the bottom row {bottom} for {shown_body(row, leading)}; expected [0, 0, 0, 1]")
    turns = rows[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        departure = np.abs(turns.transpose(0, 2, 1) @ turns - np.eye(3)).max(axis=(1, 2), initial=0.0)
        reflected = np.linalg.det(turns) < 0.0
    wrong = ~(departure <= TOLERANCE)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"{name} holds no rotation for {shown_body(row, leading)}: the products of its columns are "
            f"{departure[row]:.3g} from those of a rotation; expected at most {TOLERANCE:g}"
        )
    if reflected.any():
        row = int(reflected.argmax())
        raise ValueError(
            f"{name} holds a reflection for {shown_body(row, leading)}, with determinant -1; expected a rotation"
        )
    return np.hstack([rows[:, :3, 3], quaternions_of_matrices(turns)])
