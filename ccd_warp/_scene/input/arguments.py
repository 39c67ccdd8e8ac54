"""Validation of single arguments: numbers, counts, choices and paths; and how messages show their values."""

import math
import numbers
import os
import reprlib
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np

_MOST_BITS = 2000  # of an integer that is printed; Python refuses to print very large ones
_MOST_CHARACTERS = 80  # of a value in a message

# The sets of vertices that have one toi, or move by one fraction of their displacements.
Per = Literal["scene", "world", "body", "vertex"]
EVERY_PER: tuple[Per, ...] = get_args(Per)

_Choice = TypeVar("_Choice", bound=str)

_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = _repr.maxlong = _MOST_CHARACTERS
_repr.maxlist = _repr.maxtuple = _repr.maxset = _repr.maxfrozenset = _repr.maxdict = 6


def shown(value: object) -> str:
    """A value as shown in a message: on one line, and short however large it is."""
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        return f"an integer of {value.bit_length()} bits"
    try:
        text = str(value) if isinstance(value, np.dtype) else _repr.repr(value)
    except Exception:  # whatever a __repr__ of the caller raises
        text = f"a {type(value).__name__}"
    return on_one_line(text)


def on_one_line(text: str) -> str:
    """A text as shown in a message: on one line and short."""
    text = " ".join(text.split())
    return text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..."


def check_real(name: str, value: object, expected: str, is_valid: Callable[[float], bool]) -> float:
    """A finite number as float64, with -0.0 as 0.0.

    Raises:
        ValueError: If it is not a number, is out of its range, or would have to be rounded: no bound may change
            silently.
    """
    number = None
    if isinstance(value, numbers.Real) and not isinstance(value, (bool, np.bool_)):
        # NumPy would compare its integers with a float after rounding them
        exact = int(value) if isinstance(value, numbers.Integral) else value
        try:
            number = float(exact)
        except Exception:  # an overflow, or whatever a number of another library raises
            raise ValueError(f"{name} is {shown(value)}; expected {expected}, that float64 can hold") from None
        if math.isfinite(number) and number != exact:
            raise ValueError(f"{name} is {shown(value)}; expected {expected}, that float64 holds without rounding")
    if number is None or not math.isfinite(number) or not is_valid(number):
        raise ValueError(f"{name} is {shown(value)}; expected {expected}")
    return number + 0.0


def check_count(name: str, value: object, largest: int, least: int = 1) -> int:
    """An integer that counts something.

    Raises:
        ValueError: If it is not an integer, too small or too large.
    """
    is_bool = isinstance(value, (bool, np.bool_))
    count = int(value) if isinstance(value, numbers.Integral) and not is_bool else None
    if count is None or not least <= count <= largest:
        limit = f" up to {largest}" if count is not None and count > largest else ""
        kind = "a positive integer" if least == 1 else f"an integer of at least {least}"
        raise ValueError(f"{name} is {shown(value)}; expected {kind}{limit}")
    return count


def check_choice(name: str, value: object, choices: Collection[_Choice]) -> _Choice:
    """A string out of a few choices.

    Raises:
        ValueError: If it is none of them.
    """
    if not isinstance(value, str) or value not in choices:
        *others, last = map(repr, choices)
        words = f"{others[0]} or {last}" if len(others) == 1 else f"one of {', '.join([*others, last])}"
        raise ValueError(f"{name} is {shown(value)}; expected {words}")
    return next(choice for choice in choices if choice == value)


def check_flag(name: str, value: object) -> bool:
    """True or False.

    Raises:
        ValueError: If it is not a bool, even if Python would convert it to one.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} is {shown(value)}; expected True or False")
    return bool(value)


def check_instance(name: str, value: object, kind: type) -> None:
    """An object of a class of this library.

    Raises:
        ValueError: If it is of another.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{name} is {shown(value)}; expected a {kind.__name__}")


def check_items(name: str, value: object, expected: str) -> list[Any]:
    """The items of an iterable, read once; strings and bytes are not accepted.

    Raises:
        ValueError: If it is not such an iterable.
    """
    if not isinstance(value, Iterable) or isinstance(value, (str, bytes, bytearray, memoryview)):
        raise ValueError(f"{name} is {shown(value)}; expected {expected}")
    check_unmasked(name, value)
    try:
        return list(value)
    except Exception as error:  # an array without dimensions, or whatever an iterator of the caller raises
        raise ValueError(f"{name} is {shown(value)}; expected {expected}") from error


def check_path(name: str, value: object) -> Path:
    """A path of the file system.

    Raises:
        ValueError: If it is not a path.
    """
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(text, str) or not text or "\0" in text:
        raise ValueError(f"{name} is {shown(value)}; expected a path, as text or a pathlib.Path")
    return Path(text)


def check_unmasked(name: str, values: object, depth: int = 0) -> None:
    """Check that no mask hides a value, in lists nested up to ``depth``: NumPy would read the hidden values.

    Raises:
        ValueError: If one does.
    """
    if isinstance(values, np.ma.MaskedArray):
        count = int(np.ma.getmaskarray(values).sum())
        if count:
            raise ValueError(f"{name} is a masked array that hides {count} of its values; expected one without a mask")
    elif depth > 0 and isinstance(values, (list, tuple)):
        for value in values:
            if not isinstance(value, (float, int)):
                check_unmasked(name, value, depth - 1)
