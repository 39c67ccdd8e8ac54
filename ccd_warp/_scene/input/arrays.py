"""Conversion to NumPy arrays on the host, without a copy where possible, and of arrays never with rounding.

Lists are first what NumPy makes of them, which rounds an integer from 2^53 on in a list with floats.
"""

import math
import sys
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arguments import check_unmasked, on_one_line, shown

if TYPE_CHECKING:
    import warp as wp

_FEW = 1 << 13
_EXACT_BELOW = 2**53  # float64 represents all integers below it, and rounds none that is not below to one that is
# Device types of DLPack: the CPU, and host memory that CUDA has pinned or manages.
_HOST_MEMORY = (1, 3, 13)


class SupportsDLPack(Protocol):
    """An array of a library that shares its memory by DLPack."""

    def __dlpack__(self, *, stream: Any = ...) -> Any: ...


def as_array(values: object, name: str, expected: str) -> NDArray[Any]:
    """A NumPy array of at least one dimension.

    Raises:
        ValueError: If the values form no such array, or a mask hides one of them.
    """
    array = as_any_array(values, name, expected)
    if array.ndim == 0:
        raise ValueError(f"{name} is {shown(values)}; expected {expected}")
    return array


def as_any_array(values: object, name: str, expected: str) -> NDArray[Any]:
    """A NumPy array of any dimension, including 0, of values that are on the host.

    Raises:
        ValueError: If the values form no such array, a mask hides one of them, they are on a GPU, or a tape records
            their gradient.
    """
    check_unmasked(name, values)
    if is_on_gpu(values, name):
        raise ValueError(
            f"{name} is a {type(values).__name__} on a GPU; expected an array on the host, "
            f"or CollisionPipeline.launch, which takes arrays on its device"
        )
    if is_of_warp(values):
        from ccd_warp._runtime.tape import wants_gradient  # imports Warp, which sequences do without

        if wants_gradient(values):
            raise ValueError(
                f"{name} requires a gradient and a tape is recording, but this call works on the host, where nothing "
                f"is recorded; expected a launch, or {name}.numpy()"
            )
        values = values.numpy()
    try:
        array = np.asarray(values)
    except Exception as error:  # ragged lists, or whatever another library raises
        if is_device_array(values):
            raise ValueError(
                f"{name} is a {type(values).__name__} that cannot be shared: {reason_of(error)}"
            ) from error
        raise ValueError(f"{name} is not an array but {shown(values)}; expected {expected}") from error
    check_unmasked(name, values, array.ndim)
    return array


def as_float64(array: NDArray[Any], name: str, row_name: str = "row") -> NDArray[np.float64]:
    """A C-ordered float64 array of exactly these numbers; an array that already has this form is returned as it is.

    Args:
        array: Of two or more dimensions.
        name: Name of the argument, for the messages.
        row_name: What the first index counts.

    Raises:
        ValueError: If the numbers are not real, or float64 would round one of them: from 2^53 on all integers count.
    """
    if is_float64(array):
        return array
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {shown(array.dtype)}; expected real numbers")
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = np.ascontiguousarray(array, dtype=np.float64)
        is_integer = array.dtype.kind in "iu"
        if array.dtype.itemsize <= (4 if is_integer else 8):
            return rounded
        is_exact = np.abs(rounded) < _EXACT_BELOW if is_integer else (rounded == array) | ~np.isfinite(array)
    if not is_exact.all():
        at = tuple(np.argwhere(~is_exact)[0])
        raise ValueError(
            f"{name} holds {array[at]!s} in {row_name} {at[0]}; expected numbers that float64 holds without rounding, "
            f"integers below 2^53"
        )
    return rounded


def is_float64(array: NDArray[Any]) -> bool:
    """Whether an array is of float64 and in C order."""
    return array.dtype == np.float64 and array.flags.c_contiguous


def check_finite(
    array: NDArray[np.float64],
    name: str,
    row_name: str = "row",
    where: Callable[[int], str] | None = None,
    but: NDArray[np.integer] | None = None,
) -> None:
    """Raise a ValueError if a value is not finite, but in some rows; ``where`` describes a row of the array."""
    if are_few_and_finite(array, array):
        return  # as below, in a third of the time
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(array.sum()):
            return  # an infinity or NaN would make the sum non-finite; a sum that overflows proves nothing
    finite = np.isfinite(array)
    if but is not None:
        finite[but] = True
    if not finite.all():
        at = tuple(np.argwhere(~finite)[0])
        place = f"{row_name} {at[0]}{where(int(at[0])) if where else ''}"
        raise ValueError(f"{name} holds {array[at]} in {place}; expected finite values")


def are_few_and_finite(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether two arrays of one shape are so small that NumPy has one thread, and their product shows they are finite.

    What is not finite makes its product so, and the sum, whatever the other number is.
    """
    return a.size <= _FEW and math.isfinite(np.vdot(a, b))


def check_both_finite(a: NDArray[np.float64], b: NDArray[np.float64], names: tuple[str, str], row_name: str) -> None:
    """Raise a ValueError if a value of two arrays of one shape is not finite."""
    if are_few_and_finite(a, b):
        return
    for array, name in zip((a, b), names, strict=True):
        check_finite(array, name, row_name)


def as_positions(
    values: ArrayLike,
    name: str,
    dimension: int,
    count: int | None = None,
    reason: str = "",
    by_world: Collection[tuple[int, int]] = (),
) -> NDArray[np.float64]:
    """Float64 array of shape [n, dimension], with n = ``count`` if given, or a ValueError.

    Args:
        values: The positions; those of several worlds may have an axis of worlds before the others.
        name: Name of the argument, for the messages.
        dimension: Number of columns, 3 in space and 2 in the plane.
        count: Number of rows.
        reason: Why it must be this number, for the messages.
        by_world: The accepted numbers of worlds and of rows in each.
    """
    if type(values) is np.ndarray and values.shape == (count, dimension) and is_float64(values):
        return values
    expected = f"(n, {dimension})" if count is None else f"{(count, dimension)} {reason}"
    array = as_array(values, name, f"shape {expected}")
    if array.ndim == 3 and array.shape[:2] in by_world and array.shape[2] == dimension:
        array = array.reshape(-1, dimension)
    if count is not None and array.shape != (count, dimension):
        raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
    if array.ndim != 2 or array.shape[1] != dimension:
        if array.size == 0 and array.ndim <= 2:
            return np.zeros((0, dimension))
        raise ValueError(f"{name} has shape {array.shape}; expected (n, {dimension})")
    return as_float64(array, name)


def validated_positions(
    values: ArrayLike,
    name: str,
    dimension: int,
    count: int | None = None,
    reason: str = "",
    by_world: Collection[tuple[int, int]] = (),
    where: Callable[[int], str] | None = None,
    but: NDArray[np.integer] | None = None,
) -> NDArray[np.float64]:
    """Finite positions as of :func:`as_positions`, or a ValueError; ``where`` describes a row, some need not be."""
    array = as_positions(values, name, dimension, count, reason, by_world)
    check_finite(array, name, where=where, but=but)
    return array


def validated_indices(values: ArrayLike, columns: int, num_vertices: int, name: str) -> NDArray[np.int64]:
    """Valid vertex indices of shape [n, columns], or a ValueError."""
    array = as_array(values, name, f"shape (n, {columns})")
    if array.size == 0 and array.ndim <= 2 and array.shape[-1:] in ((0,), (columns,)):
        return np.zeros((0, columns), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{name} has shape {array.shape}; expected (n, {columns})")
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name} has dtype {shown(array.dtype)}; expected integers")
    for index in (array.min(), array.max()):
        if not 0 <= index < num_vertices:
            raise ValueError(f"{name} holds index {index}; expected indices in [0, {num_vertices})")
    return array.astype(np.int64)


def is_device_array(value: object) -> bool:
    """Whether a value is an array of Warp, or of a library other than NumPy that supports DLPack."""
    if type(value) is np.ndarray:
        return False  # as found below, but at once
    return is_of_warp(value) or (has_dlpack(value) and not isinstance(value, np.ndarray))


def is_of_warp(value: object) -> "TypeGuard[wp.array]":
    """Whether a value is an array of Warp, which readers of data sets do not import."""
    array = getattr(sys.modules.get("warp"), "array", None)
    return array is not None and isinstance(value, array)


def has_dlpack(value: object) -> TypeGuard[SupportsDLPack]:
    """Whether a value is an array that can be shared, and not a class of such arrays."""
    return hasattr(value, "__dlpack__") and not isinstance(value, type)


def is_of_jax(value: object) -> bool:
    """Whether a value is an array of JAX."""
    return type(value).__module__.partition(".")[0] in ("jax", "jaxlib")


def is_on_gpu(value: object, name: str) -> bool:
    """Whether a value is an array in the memory of a GPU, which the host cannot read."""
    return is_device_array(value) and place_of(value, name)[0] not in _HOST_MEMORY


def reason_of(error: Exception) -> str:
    """The error message of another library on one line, and what was expected."""
    return f"{on_one_line(str(error))}; expected one that can"


def place_of(value: Any, name: str) -> tuple[int, int]:
    """Type and index of the device of an array, in the numbering of DLPack."""
    try:
        kind, index = value.__dlpack_device__()
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {reason_of(error)}") from error
    return int(kind), int(index)
