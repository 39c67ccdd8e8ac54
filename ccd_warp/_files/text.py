"""Strict reading of rows of numbers: each token must be one number, and truncated lines are rejected."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from ccd_warp._input.messages import InputError

CUT = "the file is damaged or cut short; copy or export it again"
NO_INDICES = np.zeros(0, dtype=np.int64)
_IS_SPACE = np.zeros(256, dtype=bool)
_IS_SPACE[list(b" \t\n\r\v\f")] = True  # as bytes.split


_BLOCK = 1 << 15  # rows split into tokens at a time, which take some ten times the memory of their text


@dataclass(frozen=True)
class Tokens:
    """Rows as tokens, in one flat list, because many short lists take longer.

    Attributes:
        tokens: Tokens of all rows, one row after another.
        counts: Number of tokens of each row, shape [n].
        lines: Number of the line of each row in the file, shape [n].
    """

    tokens: list[bytes]
    counts: np.ndarray
    lines: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """Where each row begins among the tokens, shape [n]."""
        return np.cumsum(self.counts) - self.counts

    def beginnings(self) -> list[bytes]:
        """The first token of each row."""
        return [self.tokens[k] for k in self.first.tolist()]

    def pick(self, rows: np.ndarray) -> "Tokens":
        """The rows for which ``rows`` is true."""
        tokens = list(compress(self.tokens, np.repeat(rows, self.counts).tolist()))
        return Tokens(tokens, self.counts[rows], self.lines[rows])

    def columns(self, begin: int | np.ndarray, end: int | np.ndarray | None = None) -> "Tokens":
        """Tokens ``begin`` to ``end`` of each row; both may differ from row to row."""
        begin = np.minimum(begin, self.counts)
        end = self.counts if end is None else np.clip(end, begin, self.counts)
        column = np.arange(len(self.tokens)) - np.repeat(self.first, self.counts)
        keep = (column >= np.repeat(begin, self.counts)) & (column < np.repeat(end, self.counts))
        return Tokens(list(compress(self.tokens, keep.tolist())), end - begin, self.lines)

    def numbers(self, kind: Callable[[bytes], Any]) -> np.ndarray:
        """All tokens as one array.

        Args:
            kind: ``float`` or ``int``.

        Raises:
            InputError: If a token is not a number; the message names its line.
        """
        dtype = np.float64 if kind is float else np.int64
        try:
            if b"_" in b"".join(self.tokens):  # Python allows it between digits, but no format does
                raise ValueError
            return np.fromiter(map(kind, self.tokens), dtype, len(self.tokens))
        except (ValueError, OverflowError):
            k = next(k for k, token in enumerate(self.tokens) if _is_bad(token, kind))
            line = np.repeat(self.lines, self.counts)[k]
            expected = "a number" if kind is float else "an integer"
            raise InputError(f"line {line} holds {shown(self.tokens[k])}; expected {expected}: {CUT}") from None


@dataclass(frozen=True)
class Rows:
    """The non-empty lines of a text.

    Attributes:
        text: The whole text.
        begins: Offset of each row in the text, and the end of the last one, shape [n + 1].
        counts: Number of tokens of each row, shape [n].
        lines: Number of the line of each row in the file, shape [n].
    """

    text: bytes
    begins: np.ndarray
    counts: np.ndarray
    lines: np.ndarray

    def __len__(self) -> int:
        return len(self.counts)

    def row(self, k: int) -> list[bytes]:
        """The tokens of one row."""
        return self.text[self.begins[k] : self.begins[k + 1]].split()

    def part(self, begin: int, end: int | None = None) -> "Rows":
        """Rows ``begin`` to ``end``."""
        end = len(self) if end is None else min(end, len(self))
        return Rows(self.text, self.begins[begin : end + 1], self.counts[begin:end], self.lines[begin:end])

    def blocks(self) -> Iterator[Tokens]:
        """All rows as tokens, some thousands at a time."""
        for k in range(0, len(self), _BLOCK):
            part = self.part(k, k + _BLOCK)
            yield Tokens(self.text[part.begins[0] : part.begins[-1]].split(), part.counts, part.lines)


def text_rows(text: bytes, first_line: int = 1) -> Rows:
    """Split a text into rows; ``first_line`` is the number of its first line in the file."""
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    characters = np.frombuffer(text, dtype=np.uint8)
    is_space = _IS_SPACE[characters]
    begins_token = ~is_space
    begins_token[1:] &= is_space[:-1]
    line_begins = np.append(0, np.flatnonzero(characters == ord("\n")) + 1)
    line_begins = line_begins[line_begins < len(text)]
    counts = np.add.reduceat(begins_token, line_begins, dtype=np.int64) if len(text) else np.zeros(0, dtype=np.int64)
    filled = np.flatnonzero(counts)
    return Rows(text, np.append(line_begins[filled], len(text)), counts[filled], filled + first_line)


def _is_bad(token: bytes, kind: Callable[[bytes], Any]) -> bool:
    try:
        return b"_" in token or (kind is int and not -(1 << 63) <= int(token) < 1 << 63) or kind(token) is None
    except ValueError:
        return True


def shown(token: bytes) -> str:
    """A token as shown in a message."""
    text = token.decode("utf-8", "replace")
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


def counted_polygons(rows: Rows, *, most_behind: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Faces whose rows begin with the number of their corners.

    Args:
        rows: One face for each row.
        most_behind: Largest number of values that may follow the corners in a row.

    Returns:
        The corners of all faces, and the number of corners of each face.

    Raises:
        InputError: If the length of a row is not the stated one, or a token is not a number.
    """
    corners, counts = [NO_INDICES], [NO_INDICES]
    for block in rows.blocks():
        stated = block.columns(0, 1).numbers(int)
        bad = np.flatnonzero((stated < 3) | (block.counts < stated + 1) | (block.counts > stated + 1 + most_behind))
        if bad.size:
            k = int(bad[0])
            raise InputError(
                f"line {block.lines[k]} says {stated[k]} corners and holds {block.counts[k] - 1} numbers behind that; "
                f"expected a face of 3 corners or more, and as many indices: {CUT}"
            )
        if (block.counts > stated + 1).any():
            block.numbers(float)
        corners.append(block.columns(1, stated + 1).numbers(int))
        counts.append(stated)
    return np.concatenate(corners), np.concatenate(counts)


def fan(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangles (0, k, k + 1) of every polygon, in the order of the polygons.

    Args:
        corners: Vertices of all polygons, one polygon after another.
        counts: Number of corners of each, at least 3.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    triangles = counts - 2
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    k = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return corners[np.stack([first, first + k + 1, first + k + 2], axis=1)]


def all_numbers(text: bytes, kind: Callable[[bytes], Any]) -> np.ndarray:
    """The numbers of a text, in its order; ``kind`` is ``float`` or ``int``."""
    blocks = [block.numbers(kind) for block in text_rows(text).blocks()]
    return np.concatenate(blocks) if blocks else np.zeros(0)
