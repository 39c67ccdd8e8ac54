"""Numbers and tables as text."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd


def time_text(seconds: float) -> str:
    """The time of a query or a call with three digits, in a suitable unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}" if seconds < 1000 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def error_text(value: float | None) -> str:
    return "–" if value is None or value != value else ("0" if value == 0 else f"{value:.0e}")


def memory_text(value: float | None) -> str:
    return "–" if value is None or value != value else f"{value / 2**20:.1f}"


def ratio_text(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:,.0f}"


def table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """Lines of a Markdown table."""
    header = list(header)
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]


def table_of(frame: pd.DataFrame) -> list[str]:
    """Lines of a Markdown table of a frame of texts."""
    return table(map(str, frame.columns), frame.itertuples(index=False))


def set_name(rows: pd.DataFrame) -> pd.Series:
    """Name and kind of the set of queries of each row."""
    return rows["set"].str.replace("_", " ") + " " + rows.kind.replace({"vertex-face": "VF", "edge-edge": "EE"})


def scene_name(rows: pd.DataFrame) -> pd.Series:
    """Name of the scene of each row, with the device where it is not the CPU."""
    return rows.scene.where(rows.device == "cpu", rows.scene + " (" + rows.device + ")")
