"""Conversion to NumPy arrays on the host, without a copy where possible and never with rounding."""

import math
import numbers
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._input.arguments import check_unmasked, shown

_FEW = 1 << 13
_LARGEST_ODD = 2**53  # float64 represents all integers up to this magnitude


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
    array: NDArray[np.float64], name: str, row_name: str = "row", where: Callable[[int], str] | None = None
) -> None:
    """Raise a ValueError if a value is not finite; ``where`` describes a row of the array."""
    if array.size <= _FEW and math.isfinite(np.vdot(array, array)):
        return  # as below, in a third of the time; on one thread, since there are few
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(array.sum()):
            return  # an infinity or NaN would make the sum non-finite; a sum that overflows proves nothing
    finite = np.isfinite(array)
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
