"""The published query files: exact rationals as float64 and back, a block of lines at a time.

A block of the form found in the published files, numerators below 2**53 over powers of two, is converted by C loops
only; every other coordinate is compared with its rational in Python integers.
"""

import re
import sys
from collections.abc import Callable, Iterator
from itertools import repeat
from pathlib import Path

import numpy as np

from ccd_warp.datasets._paths import replacing

ROWS = 8  # rows of a query: four points at the start, four at the end
_BLOCK = 1 << 20  # bytes; larger blocks lose time on fresh memory
_QUERIES = 1 << 12  # queries written at a time
_DIGITS = 512  # below any limit that Python can set on the digits of an int
# A float64 in lowest terms has a numerator of at most 309 digits and a denominator of at most 324, that of 2**-1074.
# The remaining digits allow for common factors; without a limit, two numbers of ten million digits take a minute.
_MOST_DIGITS = 10_000
# Denominators of float64: the last is that of the subnormals.
_EXPONENTS = {str(1 << k).encode(): k for k in range(1075)}


def read_csv(path: Path, advance: Callable[[int], object]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Start and end points of the queries of one file, [n, 4, 3] each, and their truth, [n], if the file has it.

    ``advance`` is called with the number of bytes of each block.
    """
    columns = 0
    values = [np.empty(0)]
    truths = [np.empty(0, dtype=bool)]
    for line, block in _blocks(path, advance):
        columns = columns or _columns(path, block)
        fields = _fields(path, line, block, columns)
        if columns == 7:
            truths.append(_truth(path, line, fields[6::7]))
            del fields[6::7]
        values.append(_floats(path, line, fields[0::2], fields[1::2]))
    rows = sum(map(len, values)) // 3
    if rows % ROWS:
        raise ValueError(f"{path}, line {rows}: the file ends after {rows} rows; expected a multiple of 8, 8 a query")
    points = np.concatenate(values).reshape(-1, 2, 4, 3)
    truth = np.concatenate(truths).reshape(-1, ROWS)
    mixed = np.flatnonzero(truth != truth[:, :1])
    if mixed.size:
        row = int(mixed[0])
        raise ValueError(
            f"{path}, line {row + 1}: truth is {truth.flat[row]:d} and {not truth.flat[row]:d} on line "
            f"{row - row % ROWS + 1}; expected one truth on the 8 rows of a query"
        )
    return points[:, 0].copy(), points[:, 1].copy(), truth[:, 0].copy() if columns == 7 else None


def write_csv(path: Path, points_t0: np.ndarray, points_t1: np.ndarray, truth: np.ndarray | None) -> None:
    """Write queries, all of them or none; the arrays are float64 and finite, [n, 4, 3] and [n]."""
    denominators = {1 << k: text.decode() for text, k in _EXPONENTS.items()}
    with replacing(path) as unfinished, unfinished.open("w", encoding="ascii", newline="\n") as file:
        for first in range(0, len(points_t0), _QUERIES):
            part = slice(first, first + _QUERIES)
            points = np.concatenate([points_t0[part], points_t1[part]], axis=1)
            ratios = map(float.as_integer_ratio, points.ravel().tolist())
            texts = [f"{n},{denominators[d]}" for n, d in ratios]
            columns = [texts[0::3], texts[1::3], texts[2::3]]
            if truth is not None:
                columns.append(np.where(np.repeat(truth[part], ROWS), "1", "0").tolist())
            file.write("\n".join(map(",".join, zip(*columns, strict=True))) + "\n")


def _blocks(path: Path, advance: Callable[[int], object]) -> Iterator[tuple[int, bytes]]:
    """Whole lines of a file, LF between them and none at the end, and the number of the first of them."""
    line, num_empty = 1, 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK) + file.readline():
            advance(len(block))
            if line == 1:
                block = block.removeprefix(b"\xef\xbb\xbf")
            if b"\r" in block:
                block = block.replace(b"\r\n", b"\n")
            if b" " in block:  # some published files have spaces after their commas
                block = re.sub(rb", +(?=[-0-9])", b",", block)
            rows = block.rstrip(b"\n")
            num_ends = len(block) - len(rows)
            if not rows:  # empty lines are refused where a row comes after them; at the end of the file they are not
                num_empty += num_ends
                continue
            rows = b"\n" * min(num_empty, 1) + rows  # the first of them is the one that is named
            yield line, rows
            line += rows.count(b"\n") + 1
            num_empty = max(num_ends - 1, 0)


def _columns(path: Path, block: bytes) -> int:
    """Number of columns of the file, by its first line."""
    first = block.split(b"\n", 1)[0]
    columns = first.count(b",") + 1
    if columns not in (6, 7):
        found = f"has {columns} columns" if first else "is empty"
        raise ValueError(f"{path}, line 1 {found}; expected 6 integers, or 7 with the truth")
    return columns


def _fields(path: Path, line: int, block: bytes, columns: int) -> list[bytes]:
    """The fields of all lines, row by row; each consists of digits and minus signs only."""
    rows = block.count(b"\n") + 1
    if block.translate(None, b"-0123456789") == ((b"," * (columns - 1) + b"\n") * rows)[:-1]:
        return block.replace(b"\n", b",").split(b",")
    for number, text in enumerate(block.split(b"\n"), line):
        fields = text.split(b",")
        if not text:
            raise ValueError(f"{path}, line {number} is empty; expected {columns} integers")
        if len(fields) != columns:
            raise ValueError(f"{path}, line {number} has {len(fields)} columns; expected {columns} as on line 1")
        for field in fields:
            if not re.fullmatch(rb"[-0-9]+", field):
                raise ValueError(f"{path}, line {number}: {_quoted(field)} is not an integer; expected decimal digits")
    raise AssertionError("no line explains the block's separators")


def _truth(path: Path, line: int, fields: list[bytes]) -> np.ndarray:
    """The truth column, one boolean for each row."""
    if not {b"0", b"1"}.issuperset(fields):
        row = next(i for i, field in enumerate(fields) if field not in (b"0", b"1"))
        raise ValueError(f"{path}, line {line + row}: truth is {_quoted(fields[row])}; expected 0 or 1")
    return np.frombuffer(b"".join(fields), dtype=np.uint8) == ord("1")


def _floats(path: Path, line: int, numerators: list[bytes], denominators: list[bytes]) -> np.ndarray:
    """Rationals as float64, three in each row, all exact."""
    exponents = np.fromiter(map(_EXPONENTS.get, denominators, repeat(-1)), np.int32, len(denominators))
    try:
        if not 0 < sys.get_int_max_str_digits() <= _MOST_DIGITS and max(map(len, numerators), default=0) > _MOST_DIGITS:
            raise ValueError("too many digits for int() to read them at once, and it may")
        values = np.fromiter(map(int, numerators), np.float64, len(numerators))
    except (ValueError, OverflowError):  # not an integer, too many digits for int(), or beyond float64
        values = np.full(len(numerators), np.inf)
    # An integer that rounds to less than 2**53 did not round, and over 2**k it is a multiple of 2**-1074: a float64.
    simple = (np.abs(values) < 2.0**53) & (exponents >= 0)
    np.ldexp(values, -exponents, out=values, where=simple)
    for i in np.flatnonzero(~simple).tolist():
        try:
            values[i] = exact_float(numerators[i], denominators[i])
        except ValueError as error:
            raise ValueError(f"{path}, line {line + i // 3}: {error}") from None
    return values


def exact_float(numerator: bytes, denominator: bytes) -> float:
    """A rational of two decimal integers as float64; a ValueError if float64 cannot represent it exactly."""
    n, d = _integer(numerator), _integer(denominator)
    if d <= 0:
        raise ValueError(f"denominator is {_shown(denominator)}; expected a positive integer")
    fraction = f"{_shown(numerator)}/{_shown(denominator)}"
    try:
        value = n / d  # rounded once, to nearest
    except OverflowError:
        raise ValueError(f"{fraction} is not a float64; expected a coordinate of at most 1.8e308") from None
    p, q = value.as_integer_ratio()
    if p * d != n * q:
        raise ValueError(f"{fraction} is not a float64; expected a rational that is exactly one")
    return value


def _integer(text: bytes) -> int:
    """A decimal integer of at most `_MOST_DIGITS` digits."""
    if len(text) > _MOST_DIGITS + text.startswith(b"-"):
        raise ValueError(f"{_shown(text)} is too long; expected an integer of at most {_MOST_DIGITS:,} digits")
    if not re.fullmatch(rb"-?[0-9]+", text):
        raise ValueError(f"{_quoted(text)} is not an integer; expected decimal digits")
    if text.startswith(b"-"):
        return -_integer(text[1:])
    if len(text) <= _DIGITS:
        return int(text)
    low = len(text) // 2
    return _integer(text[:-low]) * 10**low + _integer(text[-low:])


def _shown(text: bytes) -> str:
    """A field as shown in a message."""
    plain = text.decode("utf-8", "replace")
    return plain if len(plain) <= 40 else f"{plain[:16]}...{plain[-8:]} ({len(plain)} characters)"


def _quoted(text: bytes) -> str:
    return repr(_shown(text))
