"""Read STL files: binary ones of the length given by their count, ASCII ones to the end of every solid."""

from itertools import repeat

import numpy as np

from ccd_warp._files.text import CUT, Rows, Tokens, shown, text_rows
from ccd_warp._input.messages import InputError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes, the last four of them the number of facets
# The lines of a facet, by their first word.
_LINES = (b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")
_KINDS = (b"solid", b"endsolid", b"facet", b"outer", b"vertex", b"endloop", b"endfacet")


def read_stl(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an STL file, three vertices for each triangle.

    Raises:
        InputError: If the file is malformed or truncated.
    """
    count = int.from_bytes(data[_HEADER - 4 : _HEADER], "little")
    if len(data) >= _HEADER and len(data) == _HEADER + count * _FACET.itemsize:
        corners = np.frombuffer(data, _FACET, count, _HEADER)["corners"].astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        corners = _read_ascii(data)
    elif len(data) < _HEADER or (data.isascii() and b"\0" not in data):
        raise InputError(f"is neither an ASCII STL file, which begins with 'solid', nor a binary one; {CUT}")
    else:
        expected = _HEADER + count * _FACET.itemsize
        raise InputError(f"has {len(data)} bytes, but its header says {count} faces, which take {expected}; {CUT}")
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _read_ascii(data: bytes) -> np.ndarray:
    """Corners of all facets, [n, 3, 3]."""
    rows = text_rows(data.lower())
    kinds = np.concatenate([np.zeros(0, dtype=np.int8), *map(_kinds, rows.blocks())])
    is_vertex = kinds == _KINDS.index(b"vertex")
    at = 0
    while at < len(kinds):
        if kinds[at] != _KINDS.index(b"solid"):
            raise _unexpected(rows, at, b"solid")
        ends = np.flatnonzero(kinds[at:] == _KINDS.index(b"endsolid"))
        if not ends.size:
            raise InputError(f"ends without 'endsolid'; {CUT}")
        end = at + int(ends[0])
        found = kinds[at + 1 : end]
        wrong = np.flatnonzero(found != np.resize([_KINDS.index(line) for line in _LINES], len(found)))
        if wrong.size:
            k = int(wrong[0])
            raise _unexpected(rows, at + 1 + k, _LINES[k % len(_LINES)])
        if len(found) % len(_LINES):
            raise InputError(f"line {rows.lines[end]} ends the solid within a facet; {CUT}")
        at = end + 1
    bad = np.flatnonzero(is_vertex & (rows.counts != 4))
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} is a vertex of {rows.counts[k] - 1} numbers; expected 3: {CUT}")
    values = [np.zeros(0)]
    begin = 0
    for block in rows.blocks():
        end = begin + len(block.counts)
        values.append(block.pick(is_vertex[begin:end]).columns(1).numbers(float))
        begin = end
    return np.concatenate(values).reshape(-1, 3, 3)


def _kinds(block: Tokens) -> np.ndarray:
    """The index of the known word with which each row begins, -1 if there is none."""
    numbers = {word: k for k, word in enumerate(_KINDS)}
    return np.fromiter(map(numbers.get, block.beginnings(), repeat(-1)), np.int8, len(block.counts))


def _unexpected(rows: Rows, k: int, expected: bytes) -> InputError:
    found = shown(rows.row(k)[0])
    return InputError(f"line {rows.lines[k]} begins with {found}; expected {expected.decode()}: {CUT}")
