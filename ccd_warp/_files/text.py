"""Strict reading of rows of numbers: each word must be one number, and truncated lines are rejected."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ccd_warp._scene.input.messages import InputError

CUT = "the file is damaged or cut short; copy or export it again"
_IS_SPACE = np.zeros(256, dtype=bool)
_IS_SPACE[list(b" \t\n\r\v\f")] = True  # as bytes.split
_BLOCK = 1 << 15  # rows split into words at a time, which take some ten times the memory of their text
_MOST_INTEGER = 2.0**53  # beyond which not every integer is a float64


@dataclass(frozen=True)
class Rows:
    """The non-empty lines of a text.

    Attributes:
        text: The whole text.
        begins: Offset of each row in the text, and the end of the last one, shape [n + 1].
        counts: Number of words of each row, shape [n].
        lines: Number of the line of each row in the file, shape [n].
    """

    text: bytes
    begins: np.ndarray
    counts: np.ndarray
    lines: np.ndarray

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def first(self) -> np.ndarray:
        """Where each row begins among the words, shape [n]."""
        return np.cumsum(self.counts) - self.counts

    def row(self, k: int) -> list[bytes]:
        """The words of one row."""
        return self.text[self.begins[k] : self.begins[k + 1]].split()

    def part(self, begin: int, end: int | None = None) -> "Rows":
        """Rows ``begin`` to ``end``."""
        end = len(self) if end is None else min(end, len(self))
        return Rows(self.text, self.begins[begin : end + 1], self.counts[begin:end], self.lines[begin:end])

    def numbers(self) -> np.ndarray:
        """All words as float64, rounded to nearest.

        Raises:
            InputError: If a word is not a number; the message names its line.
        """
        blocks = [np.zeros(0)]
        for begin in range(0, len(self), _BLOCK):
            part = self.part(begin, begin + _BLOCK)
            words = self.text[part.begins[0] : part.begins[-1]].split()
            try:
                blocks.append(floats(words))
            except ValueError:
                bad = next(k for k, word in enumerate(words) if not _is_number(word))
                line = np.repeat(part.lines, part.counts)[bad]
                raise InputError(f"line {line} holds {shown(words[bad])}; expected a number: {CUT}") from None
        return np.concatenate(blocks)

    def refuse_where(self, is_bad: np.ndarray, says: str, *values: np.ndarray) -> None:
        """Refuse the first row that is bad, in words into which its values are put."""
        if is_bad.any():
            k = int(np.argmax(is_bad))
            raise InputError(f"line {self.lines[k]} {says.format(*(column[k] for column in values))}: {CUT}")


def text_rows(text: bytes, first_line: int = 1) -> Rows:
    """Split a text into rows; ``first_line`` is the number of its first line in the file."""
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    characters = np.frombuffer(text, dtype=np.uint8)
    is_space = _IS_SPACE[characters]
    begins_word = ~is_space
    begins_word[1:] &= is_space[:-1]
    line_begins = np.append(0, np.flatnonzero(characters == ord("\n")) + 1)
    line_begins = line_begins[line_begins < len(text)]
    counts = np.add.reduceat(begins_word, line_begins, dtype=np.int64) if len(text) else np.zeros(0, dtype=np.int64)
    filled = np.flatnonzero(counts)
    return Rows(text, np.append(line_begins[filled], len(text)), counts[filled], filled + first_line)


def floats(words: list[bytes]) -> np.ndarray:
    """Words as float64; a ValueError if one is no number."""
    if b"_" in b"".join(words):  # Python allows it between digits, but no format does
        raise ValueError("an underscore is no digit")
    return np.fromiter(map(float, words), np.float64, len(words))


def _is_number(word: bytes) -> bool:
    try:
        return bool(len(floats([word])))
    except ValueError:
        return False


def integers(values: np.ndarray, rows: Rows, counts: np.ndarray) -> np.ndarray:
    """Numbers as integers, int64, so many of each row.

    Raises:
        InputError: If one is no integer; the message names its line.
    """
    is_bad = ~((np.abs(values) < _MOST_INTEGER) & (values == np.rint(values)))
    if is_bad.any():
        k = int(np.argmax(is_bad))
        line = rows.lines[np.searchsorted(np.cumsum(counts), k, side="right")]
        raise InputError(f"line {line} holds {values[k]}; expected an integer: {CUT}")
    return values.astype(np.int64)


def shown(word: bytes) -> str:
    """A word as shown in a message."""
    text = word.decode("utf-8", "replace")
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def check_last_index(text: bytes, index: int | None, num_vertices: int) -> None:
    """Reject a file that ends within a number that may have lost digits.

    Args:
        text: Text of the file, without comments.
        index: The last number of the file, if it is a vertex of a face.
        num_vertices: Number of vertices; an index is complete if one more digit would make it exceed this number.
    """
    if text and not text[-1:].isspace() and (index is None or 0 < 10 * index < num_vertices):
        raise InputError(
            "the last line has no line end, so that its last number may have lost digits; copy or export the file "
            "again, or add a line end if it is whole"
        )


def lists_in(rows: Rows, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of a list in each row, one row after another, and how many each row has.

    Args:
        rows: The rows.
        values: All their numbers.
        at: Where among these the length of each list stands, shape [n]; its numbers follow.

    Raises:
        InputError: If a length is none, or a row ends before its list.
    """
    ends = rows.first + rows.counts
    rows.refuse_where(at >= ends, "holds {} numbers; expected more", rows.counts)
    counts = integers(values[at], rows, np.ones_like(at))
    behind = ends - at - 1
    rows.refuse_where(
        (counts < 0) | (counts > behind), "says {} numbers of a list and holds {}; expected as many", counts, behind
    )
    begins = np.cumsum(counts) - counts
    return values[np.arange(counts.sum()) + np.repeat(at + 1 - begins, counts)], counts


def all_numbers(text: bytes, kind: type) -> Any:
    """The numbers of a text, in its order; ``kind`` is ``float``, or ``int`` for those that must be integers."""
    rows = text_rows(text)
    values = rows.numbers()
    return values if kind is float else integers(values, rows, rows.counts)
