"""Poses of bodies at several times, from CSV: a row for each body and time."""

import csv
import io
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.opened import read_file
from ccd_warp._scene.input.messages import InputError

COLUMNS = ("t", "body", "px", "py", "pz", "qx", "qy", "qz", "qw")
_EXPECTED = f"expected {', '.join(COLUMNS)}"
_MOST_NAMES = 8


class Poses(NamedTuple):
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
    """Read the poses in a file.

    A row holds ``t, body, px, py, pz, qx, qy, qz, qw``; a first row of these names may give another order, and what
    follows ``#`` at the begin of a line is a remark.

    Raises:
        InputError: If the file is missing or damaged, a number is none, a quaternion has no length, a body has two
            poses at a time or none, or there are fewer than two times. It names the line and the column.
    """
    try:
        text = read_file(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no text in UTF-8 at byte {error.start}; {_EXPECTED}") from None
    poses: dict[tuple[float, str], tuple[int, list[float]]] = {}
    columns: list[str] | None = None
    rows = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True)
    try:
        for row in rows:
            cells = [cell.strip() for cell in row]
            if not any(cells) or cells[0].startswith("#"):
                continue
            if columns is None:
                columns = cells if sorted(cells) == sorted(COLUMNS) else list(COLUMNS)
                if columns is cells:
                    continue
            if len(cells) != len(columns):
                raise InputError(f"has {len(cells)} column{'s' * (len(cells) != 1)}; {_EXPECTED}")
            of = dict(zip(columns, cells, strict=True))
            name, (t, *pose) = of.pop("body"), [_number(column, of[column]) for column in COLUMNS if column != "body"]
            if not name:
                raise InputError("column body is empty; expected a name or an index")
            if not any(pose[3:]):
                raise InputError("columns qx qy qz qw are all 0; expected a quaternion")
            line, _ = poses.setdefault((t, name), (rows.line_num, pose))
            if line != rows.line_num:
                raise InputError(f"is another pose of body {name} at t = {t:g}, after line {line}; expected one")
    except (InputError, csv.Error) as error:
        raise InputError(f"{path}: line {rows.line_num}, {error}") from None
    times, bodies = sorted({t for t, _ in poses}), list(dict.fromkeys(name for _, name in poses))
    if len(times) < 2:
        raise InputError(f"{path}: holds poses at {len(times)} times; expected two or more, and {_EXPECTED}")
    for t in times:
        for name in bodies:
            if (t, name) not in poses:
                raise InputError(f"{path}: holds no pose of body {name} at t = {t:g}; expected one at each time")
    return Poses(np.array(times), bodies, np.array([[poses[t, name][1] for name in bodies] for t in times]))


def _number(column: str, text: str) -> float:
    try:
        number = math.nan if "_" in text else float(text)  # Python takes it within digits
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"column {column} is {text!r}; expected a finite number")
    return number


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
