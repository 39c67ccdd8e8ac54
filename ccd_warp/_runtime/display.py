"""How objects show themselves: in a line or two as text, and as a table in a notebook."""

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum
from html import escape
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_LISTED = 4
_MOST_LETTERS = 32  # of a name
MOST_ROWS = 30
_MOST_PAIRS = 5  # pairs of bodies that a sentence names


def counted(count: int, singular: str, plural: str) -> str:
    """A number and what it counts: "1 body", "2 bodies"."""
    return f"{count:,} {singular if count == 1 else plural}"


def kind_name(kind: Enum) -> str:
    """The name of a kind of pair in a text: "vertex-face"."""
    return kind.name.lower().replace("_", "-")


def shown_range(name: str, values: NDArray[np.float64]) -> str:
    """The name of a quantity with its value, or with the least and the greatest where they differ."""
    least, greatest = f"{values.min():.3g}", f"{values.max():.3g}"
    return f"{name} {least}" if least == greatest else f"{name} {least} to {greatest}"


def listed(words: Sequence[str]) -> str:
    """The first few of some words, and how many more there are."""
    shown = ", ".join(shortened(word) for word in words[:_MOST_LISTED])
    return shown if len(words) <= _MOST_LISTED else f"{shown}, … {len(words) - _MOST_LISTED} more"


def shortened(word: str) -> str:
    """A name, cut where it is long."""
    return word if len(word) <= _MOST_LETTERS else f"{word[: _MOST_LETTERS - 1]}…"


def pairs_of_bodies(names: Sequence[str], bodies: NDArray[np.int32]) -> Counter[tuple[str, str]]:
    """Number of pairs by the names of their bodies, given by index, shape [m, 2]; the lower index comes first."""
    both, counts = np.unique(np.sort(bodies, axis=1), axis=0, return_counts=True)
    return Counter({(names[a], names[b]): n for (a, b), n in zip(both.tolist(), counts.tolist(), strict=True)})


def named_counts(pairs: Counter[tuple[str, str]]) -> list[str]:
    """How many pairs there are of the bodies that have the most, and how many of all others."""
    most = pairs.most_common(_MOST_PAIRS)
    parts = [
        f"{n:,} within {shortened(a)}" if a == b else f"{n:,} of {shortened(a)} and {shortened(b)}"
        for (a, b), n in most
    ]
    others = pairs.total() - sum(n for _, n in most)
    return [*parts, f"and {others:,} of other bodies"] if others else parts


def start_sentence(pairs: Counter[tuple[str, str]]) -> str:
    """A sentence on the pairs that are in contact at the start, empty if there are none."""
    if not pairs:
        return ""
    total = pairs.total()
    verb, named = "is" if total == 1 else "are", ", ".join(named_counts(pairs))
    return f"{counted(total, 'pair', 'pairs')} {verb} in contact at the start already, with toi 0: {named}"


def point_text(point: Iterable[float]) -> str:
    """A position in six digits, for reading only: what is no more than rounding of the largest coordinate is 0."""
    values = [float(x) for x in point]
    rounding = 1e-12 * max((abs(x) for x in values if isfinite(x)), default=0.0)
    return f"({', '.join('0' if abs(x) <= rounding else f'{x:.6g}' for x in values)})"


def html_table(title: str, header: Sequence[str], rows: Sequence[Sequence[Any]], total: int | None = None) -> str:
    """A table for a notebook: its first rows, and how many more there are; ``total`` where not all are given."""
    total = len(rows) if total is None else total

    def line(cells: Iterable[Any], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"

    body = "".join(line(row, "td") for row in rows[:MOST_ROWS])
    more = f"<p>… {total - MOST_ROWS:,} more</p>" if total > MOST_ROWS else ""
    return f"<p>{escape(title)}</p><table><thead>{line(header, 'th')}</thead><tbody>{body}</tbody></table>{more}"
