"""Numbers and tables as text, and the selection of rows for tables."""

from __future__ import annotations

from collections.abc import Iterable

from methods import REFERENCE, SHORT

OURS = "ours float64"
PEERS = (REFERENCE, "additive CCD")
DEFAULT_TOLERANCE = 1e-6


def time_text(seconds: float) -> str:
    """The time of a query or a call with three digits, in a suitable unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}" if seconds < 1000 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def count_text(value: float) -> str:
    """A count or a rate, in words of thousands and millions."""
    for letter, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {letter}"
    return f"{value:.3g}"


def error_text(value: float | None) -> str:
    return "–" if value is None or value != value else ("0" if value == 0 else f"{value:.0e}")


def memory_text(value: int | None) -> str:
    return "–" if value is None else f"{value / 2**20:.1f}"


def ratio_text(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:,.0f}"


def table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """Lines of a Markdown table."""
    header = list(header)
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]


def rows_of(unit: dict) -> dict[str, dict]:
    """Rows of a point of the sweep or of a family, by method."""
    return {row["method"]: row for row in unit["rows"]}


def at_default(raw: dict) -> list[dict]:
    """The points of the sweep at the default tolerance."""
    return [unit for unit in raw["sweep"] if unit["tolerance"] == DEFAULT_TOLERANCE]


def set_name(unit: dict) -> str:
    return f"{unit['set'].replace('_', ' ')} {SHORT[unit['kind']]}"


def is_peer(row: dict) -> bool:
    """Whether a row is of a peer that is called query by query."""
    return "call_overhead" in row


def bound(row: dict) -> str:
    """Mark of a time that is a lower bound (some queries were stopped) or an upper bound (lost in the overhead)."""
    if not is_peer(row):
        return ""
    return "> " if row["limited"] else "< " if row["below_resolution"] else ""


def share_text(part: int | None, whole: int) -> str:
    """A share in per cent."""
    return "–" if part is None else "0 %" if part == 0 else f"{100 * part / whole:.2g} %"


def error_of(row: dict, name: str) -> float | None:
    return None if row["error"] is None else row["error"][name]
