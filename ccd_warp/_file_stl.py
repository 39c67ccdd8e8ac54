"""Read STL files: binary ones as long as their count says, ASCII ones to the end of every solid."""

import numpy as np

from ccd_warp._file_text import CUT, shown, text_rows
from ccd_warp._messages import InputError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes, the last four of them the number of facets
# The lines of a facet, by how they begin.
_LINES = (b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")


def read_stl(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an STL file, three vertices a triangle.

    Raises:
        InputError: If the file is malformed or cut.
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
    beginnings = rows.beginnings()
    is_vertex = np.zeros(len(rows), dtype=bool)
    at = 0
    while at < len(rows):
        if beginnings[at] != b"solid":
            raise InputError(f"line {rows.lines[at]} begins with {shown(beginnings[at])}; expected solid: {CUT}")
        try:
            end = beginnings.index(b"endsolid", at)
        except ValueError:
            raise InputError(f"ends without 'endsolid'; {CUT}") from None
        wrong = []
        for k, expected in enumerate(_LINES):
            found = beginnings[at + 1 + k : end : len(_LINES)]
            if found.count(expected) != len(found):
                i = next(i for i, beginning in enumerate(found) if beginning != expected)
                wrong.append((at + 1 + k + len(_LINES) * i, expected))
        if wrong:
            j, expected = min(wrong)
            raise InputError(
                f"line {rows.lines[j]} begins with {shown(beginnings[j])}; expected {expected.decode()}: {CUT}"
            )
        if (end - at - 1) % len(_LINES):
            raise InputError(f"line {rows.lines[end]} ends the solid within a facet; {CUT}")
        for k in (2, 3, 4):
            is_vertex[at + 1 + k : end : len(_LINES)] = True
        at = end + 1
    vertices = rows.pick(is_vertex)
    bad = np.flatnonzero(vertices.counts != 4)
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {vertices.lines[k]} is a vertex of {vertices.counts[k] - 1} numbers; expected 3: {CUT}")
    return vertices.columns(1).numbers(float).reshape(-1, 3, 3)
