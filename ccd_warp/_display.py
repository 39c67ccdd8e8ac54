"""How objects show themselves: in a line or two as text, and as a table in a notebook."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

_MOST_LISTED = 4
_MOST_LETTERS = 32  # of a name
MOST_ROWS = 30


def counted(count: int, singular: str, plural: str) -> str:
    """A number and what it counts: "1 body", "2 bodies"."""
    return f"{count:,} {singular if count == 1 else plural}"


def listed(words: Sequence[str]) -> str:
    """The first few of some words, and how many more there are."""
    shown = ", ".join(shortened(word) for word in words[:_MOST_LISTED])
    return shown if len(words) <= _MOST_LISTED else f"{shown}, … {len(words) - _MOST_LISTED} more"


def shortened(word: str) -> str:
    """A name, cut where it is long."""
    return word if len(word) <= _MOST_LETTERS else f"{word[: _MOST_LETTERS - 1]}…"


def point_text(point: Iterable[float]) -> str:
    """A position in six digits, for reading only."""
    return f"({', '.join(f'{x + 0.0:.6g}' for x in point)})"


def html_table(title: str, header: Sequence[str], rows: Sequence[Sequence[Any]], total: int | None = None) -> str:
    """A table for a notebook: its first rows, and how many more there are; ``total`` where not all are given."""
    total = len(rows) if total is None else total

    def line(cells: Iterable[Any], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"

    body = "".join(line(row, "td") for row in rows[:MOST_ROWS])
    more = f"<p>… {total - MOST_ROWS:,} more</p>" if total > MOST_ROWS else ""
    return f"<p>{escape(title)}</p><table><thead>{line(header, 'th')}</thead><tbody>{body}</tbody></table>{more}"
