"""Read OBJ files: vertices and faces as they stand in the file, with every line that could hold them understood."""

import re

import numpy as np

from ccd_warp._file_text import CUT, Rows, fan, shown, text_rows
from ccd_warp._messages import InputError

# What may stand in a file beside vertices and faces: attributes, points and lines, groups, materials, display.
_BESIDE = frozenset(
    b"vn vt vp p l g s o mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj "
    b"ctech stech".split()
)
_VERTEX_LENGTHS = (3, 4, 6, 7)  # with a weight, a colour, or a colour with its opacity


def read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an OBJ file; polygons become fans.

    An OBJ file has no counts, so a file that was cut between two lines cannot be told from a whole one.

    Raises:
        InputError: If a line is malformed, or the last one has no line end.
    """
    if not data.endswith((b"\n", b"\r")):
        raise InputError(
            "the last line has no line end, and an OBJ file says nowhere how much it holds, so that it may have been "
            "cut there; copy or export it again, or add a line end if it is whole"
        )
    text = re.sub(rb"#[^\r\n]*", b"", data)
    if b"\\" in text:
        text = re.sub(rb"\\\r?\n", b" ", text)
    if b"/" in text:
        text = re.sub(rb"(?<=[0-9])/\S*", b"", text)
    rows = text_rows(text)
    beginnings = rows.beginnings()
    unknown = set(beginnings) - _BESIDE - {b"v", b"f"}
    if unknown:
        k = next(k for k, beginning in enumerate(beginnings) if beginning in unknown)
        raise InputError(
            f"line {rows.lines[k]} begins with {shown(beginnings[k])}, which is not read; expected v, vn, vt or f"
        )
    is_vertex, is_face = (np.fromiter(map(word.__eq__, beginnings), bool, len(rows)) for word in (b"v", b"f"))
    vertices = _vertices(rows.pick(is_vertex).columns(1))
    return vertices, _faces(rows.pick(is_face).columns(1), len(vertices), np.cumsum(is_vertex)[is_face])


def _vertices(rows: Rows) -> np.ndarray:
    bad = np.flatnonzero(~np.isin(rows.counts, _VERTEX_LENGTHS))
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} is a vertex of {rows.counts[k]} numbers; expected 3, 4, 6 or 7: {CUT}")
    return rows.numbers(float)[rows.first[:, None] + np.arange(3)]


def _faces(rows: Rows, num_vertices: int, num_above: np.ndarray) -> np.ndarray:
    """Triangles; ``num_above`` is the number of vertices above each face."""
    counts = rows.counts
    bad = np.flatnonzero(counts < 3)
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} is a face of {counts[k]} corners; expected 3 or more: {CUT}")
    corners = rows.numbers(int)
    # A negative index counts back from the last vertex above the face.
    found = np.where(corners < 0, np.repeat(num_above, counts) + corners, corners - 1)
    bad = np.flatnonzero((found < 0) | (found >= num_vertices))
    if bad.size:
        line = np.repeat(rows.lines, counts)[bad[0]]
        raise InputError(
            f"line {line} is a face of vertex {corners[bad[0]]}, but the file has {num_vertices} vertices, counted "
            "from 1; repair the file"
        )
    return fan(found, counts)
