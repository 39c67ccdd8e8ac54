"""Conversion to NumPy arrays on the host, without a copy where possible and never with rounding."""

import math
import numbers
import sys
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.input.arguments import check_unmasked, on_one_line, shown

_FEW = 1 << 13
_LARGEST_ODD = 2**53  # float64 represents all integers up to this magnitude
# Device types of DLPack: the CPU, and host memory that CUDA has pinned or manages.
_HOST_MEMORY = (1, 3, 13)


def as_array(values: Any, name: str, expected: str) -> NDArray[Any]:
    """A NumPy array of at least one dimension.

    Raises:
        ValueError: If the values form no such array, or a mask hides one of them.
    """
    array = as_any_array(values, name, expected)
    if array.ndim == 0:
        raise ValueError(f"{name} is {shown(values)}; expected {expected}")
    return array


def as_any_array(values: Any, name: str, expected: str) -> NDArray[Any]:
    """A NumPy array of any dimension, including 0.

    Raises:
        ValueError: If the values form no such array, or a mask hides one of them.
    """
    check_unmasked(name, values)
    try:
        array = np.asarray(values)
    except Exception as error:  # ragged lists, or whatever an __array__ of another library raises
        raise ValueError(f"{name} is not an array but {shown(values)}; expected {expected}") from error
    check_unmasked(name, values, array.ndim)
    return array


def as_float64(array: NDArray[Any], name: str, given: Any, row_name: str = "row") -> NDArray[np.float64]:
    """A C-ordered float64 array of exactly these numbers; an array that already has this form is returned as it is.

    Args:
        array: Of two or more dimensions.
        name: Name of the argument, for the messages.
        given: The argument from which the array was made.
        row_name: What the first index counts.

    Raises:
        ValueError: If the numbers are not real, or float64 cannot represent one of them.
    """
    if array is given and is_float64(array):
        return array
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {shown(array.dtype)}; expected real numbers")
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = np.ascontiguousarray(array, dtype=np.float64)
        if array.dtype.kind in "iu":
            is_exact = _are_exact_integers(array) if array.dtype.itemsize > 4 else None
        elif array.dtype.itemsize > 8:
            is_exact = (rounded == array) | ~np.isfinite(array)
        else:
            array, is_exact = _as_given(given, rounded)
    if is_exact is not None and not is_exact.all():
        at = tuple(np.argwhere(~is_exact)[0])
        raise ValueError(
            f"{name} holds {shown_number(array[at])} in {row_name} {at[0]}; "
            f"expected numbers that float64 holds without rounding"
        )
    return rounded


def is_float64(array: NDArray[Any]) -> bool:
    """Whether an array is of float64 and in C order."""
    return array.dtype == np.float64 and array.flags.c_contiguous


def shown_number(value: Any) -> str:
    """A number without its type."""
    return shown(int(value)) if isinstance(value, numbers.Integral) else str(value)


def check_finite(
    array: NDArray[np.float64],
    name: str,
    row_name: str = "row",
    where: Callable[[int], str] | None = None,
    but: NDArray[np.integer] | None = None,
) -> None:
    """Raise a ValueError if a value is not finite, but in some rows; ``where`` describes a row of the array."""
    if array.size <= _FEW and math.isfinite(np.vdot(array, array)):
        return  # as below, in a third of the time; on one thread, since there are few
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


def _are_exact_integers(array: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Which integers float64 represents (lowest and highest bit at most 52 places apart); None if all."""
    if not array.size or (array.max() <= _LARGEST_ODD and array.min() >= -_LARGEST_ODD):
        return None
    magnitude = np.abs(array).astype(np.uint64)  # also correct for the least int64, whose abs NumPy leaves negative
    lowest_bit = magnitude & (~magnitude + np.uint64(1))
    return magnitude // np.maximum(lowest_bit, np.uint64(1)) < np.uint64(_LARGEST_ODD)


def _as_given(given: Any, rounded: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """The numbers before NumPy converted integers and floats to one dtype, and which of them it did not round."""
    has_one_dtype = hasattr(given, "__array_interface__") or hasattr(given, "__dlpack__")
    if has_one_dtype or not rounded.size or not np.abs(rounded).max() >= _LARGEST_ODD:
        return rounded, None
    try:
        numbers_given = np.asarray(given, dtype=object)
    except Exception:  # a library that supports only its own dtype
        return rounded, None
    if numbers_given.shape != rounded.shape:
        return rounded, None
    is_exact = [
        not isinstance(exact, numbers.Integral) or int(exact) == value
        for exact, value in zip(numbers_given.ravel(), rounded.ravel().tolist(), strict=True)
    ]
    return numbers_given, np.reshape(is_exact, rounded.shape)


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
    array = as_array(on_host(values, name), name, f"shape {expected}")
    if array.ndim == 3 and array.shape[:2] in by_world and array.shape[2] == dimension:
        if not hasattr(values, "__array_interface__") and isinstance(values, (list, tuple)):
            values = [row for world in values for row in world]  # so that its numbers are compared one by one
        array = array.reshape(-1, dimension)
    if count is not None and array.shape != (count, dimension):
        raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
    if array.ndim != 2 or array.shape[1] != dimension:
        if array.size == 0 and array.ndim <= 2:
            return np.zeros((0, dimension))
        raise ValueError(f"{name} has shape {array.shape}; expected (n, {dimension})")
    return as_float64(array, name, values)


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
    array = as_array(on_host(values, name), name, f"shape (n, {columns})")
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


def is_device_array(value: Any) -> bool:
    """Whether a value is an array of Warp, or of a library other than NumPy that supports DLPack."""
    return _is_of_warp(value) or (speaks_dlpack(value) and not isinstance(value, np.ndarray))


def _is_of_warp(value: Any) -> bool:
    """Whether a value is an array of Warp, which readers of data sets do not import."""
    array = getattr(sys.modules.get("warp"), "array", None)
    return array is not None and isinstance(value, array)


def speaks_dlpack(value: Any) -> bool:
    """Whether a value is an array that can be shared, and not a class of such arrays."""
    return hasattr(value, "__dlpack__") and not isinstance(value, type)


def is_of_jax(value: Any) -> bool:
    """Whether a value is an array of JAX."""
    return type(value).__module__.partition(".")[0] in ("jax", "jaxlib")


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


def on_host(value: Any, name: str) -> Any:
    """The value as NumPy can read it in place; arrays of other libraries must not be on a GPU.

    Raises:
        ValueError: If it is an array on a GPU, or one that NumPy cannot read, as an array that requires a gradient.
    """
    if is_device_array(value) and place_of(value, name)[0] not in _HOST_MEMORY:
        raise ValueError(
            f"{name} is a {type(value).__name__} on a GPU; expected an array on the host, "
            f"or CollisionPipeline.launch, which takes arrays on its device"
        )
    if _is_of_warp(value):
        from ccd_warp._runtime.tape import wants_gradient  # imports Warp, which sequences do without

        if wants_gradient(value):
            raise ValueError(
                f"{name} requires a gradient and a tape is recording, but this call works on the host, where nothing "
                f"is recorded; expected a launch, or {name}.numpy()"
            )
        return value.numpy()
    if not is_device_array(value):
        return value
    try:
        return np.asarray(value)
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {reason_of(error)}") from error
