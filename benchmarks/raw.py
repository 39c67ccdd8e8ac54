"""The raw figures: a CSV file for each part, and runs.csv, which says where and when each was measured."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from machine import machine, why_refused, why_stale

RUNS = "runs"


def write(folder: Path, part: str, rows: list[dict], **about: object) -> None:
    """Write the rows of a part, and about them a row of runs.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    _save(pd.DataFrame([flat(row) for row in rows], dtype=object), folder / f"{part}.csv")
    note(folder, part, **about)


def note(folder: Path, part: str, **about: object) -> None:
    """Say in runs.csv that a part was measured just now, at this commit and on this machine."""
    row = pd.DataFrame([{"part": part, **machine(), **about}])
    kept = read(folder, RUNS)
    others = [kept[kept.part != part]] if len(kept) else []
    _save(pd.concat([*others, row]).sort_values("part"), folder / f"{RUNS}.csv")


def _save(table: pd.DataFrame, path: Path) -> None:
    new = path.with_suffix(".new")
    # six digits are more than a measurement has; of integers all
    table.map(lambda x: float(f"{x:.6g}") if isinstance(x, float) else x).to_csv(new, index=False)
    os.replace(new, path)


def read(folder: Path, part: str) -> pd.DataFrame:
    """The rows of a part, none where it was not measured."""
    path = folder / f"{part}.csv"
    if (lines := path.with_suffix(".json")).is_file():  # of gpu_times.py: the machine, and a line a measurement
        return pd.read_json(lines, lines=True)
    return pd.read_csv(path, keep_default_na=False, na_values=[""]) if path.is_file() else pd.DataFrame()


def stale(folder: Path, why: Callable[[str], str] = why_stale) -> dict[str, str]:
    """Parts whose figures are not those of this checkout, and why."""
    runs = read(folder, RUNS)
    found = {part: why(code) for part, code in zip(runs.part, runs.code.fillna(""), strict=True)} if len(runs) else {}
    return {part: text for part, text in found.items() if text}


def refused(folder: Path) -> list[str]:
    """Parts of a folder that pages must not show, with the command that measures each."""
    why = stale(folder, why_refused)
    return [f"{part} is {text}: python benchmarks/run.py {part} --output {folder}" for part, text in why.items()]


def described(folder: Path, part: str) -> str:
    """Where and when a part was measured, in one line; empty if it was not."""
    runs = read(folder, RUNS)
    rows = runs[runs.part == part] if len(runs) else runs
    if not len(rows):
        return ""
    about = rows.iloc[0].dropna()
    gpus = f", {about.gpus}" if "gpus" in about and about.gpus else ""
    where = f"{about.cpu}, {about.cores} cores{gpus}, {about.memory_gib} GiB, {about.system}, Python {about.python}"
    return f"{where}, {about.versions}, {about.date}"


def flat(record: dict, prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries and lists by joined names."""
    result: dict[str, Any] = {}
    for key, value in record.items():
        if isinstance(value, list | tuple):
            value = dict(enumerate(value))
        result |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return result
