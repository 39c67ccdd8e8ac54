"""Poses of bodies at several times, from CSV or JSON: a row for each body and time."""

import csv
import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.opened import read_file
from ccd_warp._input.messages import InputError

COLUMNS = ("t", "body", "px", "py", "pz", "qx", "qy", "qz", "qw")
_EXPECTED = f"expected {', '.join(COLUMNS)}"
_MOST_NAMES = 8


@dataclass(frozen=True)
class Poses:
    """The poses of bodies at several times.

    Attributes:
        times: Ascending, float64, shape [T].
        bodies: What the file calls each body, a name or an index, in the order in which they come first.
        poses: Position and quaternion x y z w, float64, shape [T, B, 7].
    """

    times: NDArray[np.float64]
    bodies: list[str]
    poses: NDArray[np.float64]


def read_poses(path: Path, max_bytes: int) -> Poses:
    """Read the poses in a file: ``.json``, or else CSV.

    A row of CSV holds ``t, body, px, py, pz, qx, qy, qz, qw``; a first row of these names may give another order, and
    what follows ``#`` at the begin of a line is a remark. JSON is a list of objects with these keys.

    Raises:
        InputError: If the file is missing or damaged, a number is none, a quaternion has no length, a body has two
            poses at a time or none, or there are fewer than two times. It names the line and the column.
    """
    try:
        text = read_file(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no text in UTF-8 at byte {error.start}; {_EXPECTED}") from None
    rows = _rows_of_json(path, text) if path.suffix.lower() == ".json" else _rows_of_csv(path, text)
    numbers, where, names = [], [], []
    for place, row in rows:
        values = [_number(path, place, name, row[name]) for name in COLUMNS if name != "body"]
        if not any(values[4:]):
            raise InputError(f"{path}: {place}, columns qx qy qz qw are all 0; expected a quaternion")
        numbers.append(values)
        where.append(place)
        names.append(_name(path, place, row["body"]))
    if not numbers:
        raise InputError(f"{path}: holds no poses; {_EXPECTED}")
    return _table(path, np.array(numbers), where, names)


def _table(path: Path, numbers: NDArray[np.float64], where: list[str], names: list[str]) -> Poses:
    """Rows by time and body."""
    times, bodies = np.unique(numbers[:, 0]), list(dict.fromkeys(names))
    if len(times) < 2:
        raise InputError(f"{path}: holds poses at t = {times[0]:g} alone; expected two times or more")
    row_of: dict[tuple[float, str], int] = {}
    for row, (t, name) in enumerate(zip(numbers[:, 0].tolist(), names, strict=True)):
        earlier = row_of.setdefault((t, name), row)
        if earlier != row:
            raise InputError(
                f"{path}: {where[row]} is another pose of body {name} at t = {t:g}, after {where[earlier]}; "
                "expected one"
            )
    for t in times.tolist():
        for name in bodies:
            if (t, name) not in row_of:
                raise InputError(f"{path}: holds no pose of body {name} at t = {t:g}; expected one at each time")
    order = [[row_of[t, name] for name in bodies] for t in times.tolist()]
    return Poses(times, bodies, numbers[:, 1:][np.array(order)])


def _rows_of_csv(path: Path, text: str) -> list[tuple[str, dict[str, Any]]]:
    found, columns = [], None
    rows = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True)
    try:
        for row in rows:
            cells = [cell.strip() for cell in row]
            if not any(cells) or cells[0].startswith("#"):
                continue
            place = f"line {rows.line_num}"
            if columns is None:
                columns = cells if sorted(cells) == sorted(COLUMNS) else list(COLUMNS)
                if columns is cells:
                    continue
            if len(cells) != len(columns):
                number = f"{len(cells)} column" + "s" * (len(cells) != 1)
                raise InputError(f"{path}: {place} has {number}; {_EXPECTED}")
            found.append((place, dict(zip(columns, cells, strict=True))))
    except csv.Error as error:
        raise InputError(f"{path}: line {rows.line_num}: {error}; {_EXPECTED}") from None
    return found


def _rows_of_json(path: Path, text: str) -> list[tuple[str, dict[str, Any]]]:
    try:
        rows = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        place = f"line {error.lineno}, column {error.colno}: " if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(f"{path}: {place}no JSON; expected a list of objects with {', '.join(COLUMNS)}") from None
    if not isinstance(rows, list):
        raise InputError(f"{path}: holds no list; expected a list of objects with {', '.join(COLUMNS)}")
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict) or sorted(row) != sorted(COLUMNS):
            found = ", ".join(map(str, row)) if isinstance(row, dict) else "no object"
            raise InputError(f"{path}: row {number} has {found or 'nothing'}; {_EXPECTED}")
    return [(f"row {number}", row) for number, row in enumerate(rows, start=1)]


def _number(path: Path, place: str, column: str, value: Any) -> float:
    is_text = isinstance(value, str) and "_" not in value  # which Python takes within digits
    if is_text or (isinstance(value, (int, float)) and not isinstance(value, bool)):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number):
            return number
    raise InputError(f"{path}: {place}, column {column} is {value!r}; expected a finite number")


def _name(path: Path, place: str, value: Any) -> str:
    if isinstance(value, (str, int)) and not isinstance(value, bool) and str(value):
        return str(value)
    raise InputError(f"{path}: {place}, column body is {value!r}; expected a name or an index")


def bodies_of(path: Path, given: list[str], names: list[str]) -> list[int]:
    """The index of each body that a file of poses names, by its name or, where no body has it, by its index.

    Raises:
        InputError: If there is no such body, or one is named twice.
    """
    found: list[int] = []
    for name in given:
        index = names.index(name) if name in names else int(name) if name.isdecimal() else -1
        if not 0 <= index < len(names):
            known = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
            raise InputError(f"{path}: column body holds {name}, and no body is called so; expected one of {known}")
        if index in found:
            raise InputError(f"{path}: column body holds {given[found.index(index)]} and {name}, which are one body")
        found.append(index)
    return found
