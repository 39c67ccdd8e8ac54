"""Poses of bodies at several times, from CSV: a row for each body and time."""

import csv
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.opened import read_file
from ccd_warp._scene.input.messages import InputError

COLUMNS = ["t", "body", "px", "py", "pz", "qx", "qy", "qz", "qw"]
_EXPECTED = f"expected {', '.join(COLUMNS)}"
_MOST_NAMES = 8


def read_poses(path: Path, names: list[str]) -> tuple[NDArray[np.float64], list[int], NDArray[np.float64]]:
    """Read the poses of bodies of these names.

    A row holds ``t, body, px, py, pz, qx, qy, qz, qw``, the body by its name or, where no body has it, by its index. A
    first row of these names is passed over, and what follows ``#`` at the begin of a line is a remark.

    Returns:
        Times, ascending, shape [T]; the indices of the bodies that have poses, ascending; and position and quaternion
        x y z w of each of these, float64, shape [T, B, 7].

    Raises:
        InputError: If the file is missing or damaged, a number is none, a quaternion has no length, a body is unknown,
            or has two poses at a time or none, or there are fewer than two times. It names the line and the column.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no text in UTF-8 at byte {error.start}; {_EXPECTED}") from None
    poses: dict[tuple[float, int], tuple[int, list[float]]] = {}
    rows = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True)
    try:
        for row in rows:
            cells = [cell.strip() for cell in row]
            if not any(cells) or cells[0].startswith("#") or cells == COLUMNS:
                continue
            if len(cells) != len(COLUMNS):
                raise InputError(f"has {len(cells)} column{'s' * (len(cells) != 1)}; {_EXPECTED}")
            t, *pose = [_number(*cell) for cell in zip(COLUMNS, cells, strict=True) if cell[0] != "body"]
            if not any(pose[3:]):
                raise InputError("columns qx qy qz qw are all 0; expected a quaternion")
            line, _ = poses.setdefault((t, _body(cells[1], names)), (rows.line_num, pose))
            if line != rows.line_num:
                raise InputError(f"is another pose of body {cells[1]} at t = {t:g}, after line {line}; expected one")
    except (InputError, csv.Error) as error:
        raise InputError(f"{path}: line {rows.line_num}, {error}") from None
    times, bodies = sorted({t for t, _ in poses}), sorted({body for _, body in poses})
    if len(times) < 2:
        raise InputError(f"{path}: holds poses at {len(times)} times; expected two or more, and {_EXPECTED}")
    for t in times:
        for body in bodies:
            if (t, body) not in poses:
                raise InputError(f"{path}: holds no pose of body {names[body]} at t = {t:g}; expected one at each time")
    return np.array(times), bodies, np.array([[poses[t, body][1] for body in bodies] for t in times])


def _number(column: str, text: str) -> float:
    try:
        number = math.nan if "_" in text else float(text)  # Python takes it within digits
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"column {column} is {text!r}; expected a finite number")
    return number


def _body(text: str, names: list[str]) -> int:
    """The index of a body, by its name or, where no body has it, by its index."""
    index = names.index(text) if text in names else int(text) if text.isdecimal() else -1
    if not 0 <= index < len(names):
        expected = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
        raise InputError(f"column body holds {text}, and no body is called so; expected one of {expected}")
    return index
