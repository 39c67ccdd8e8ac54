"""Read OBJ files: vertices and faces as in the file; lines that are not understood are rejected."""

import re

import numpy as np

from ccd_warp._files.text import CUT, NO_INDICES, Tokens, fan, shown, text_rows
from ccd_warp._input.messages import InputError

# Keywords other than those of vertices and faces: attributes, points and lines, groups, materials, display.
_BESIDE = frozenset(
    b"vn vt vp p l g s o mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj "
    b"ctech stech".split()
)
_VERTEX_LENGTHS = (3, 4, 6, 7)  # with a weight, a colour, or a colour with its opacity


def read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an OBJ file; polygons become fans.

    An OBJ file has no counts, so a file truncated between two lines cannot be distinguished from a complete one.

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
    vertices, num_vertices = [np.zeros((0, 3))], 0
    faces: list[tuple[np.ndarray, ...]] = []
    for block in text_rows(text).blocks():
        beginnings = block.beginnings()
        unknown = set(beginnings) - _BESIDE - {b"v", b"f"}
        if unknown:
            k = next(k for k, beginning in enumerate(beginnings) if beginning in unknown)
            raise InputError(
                f"line {block.lines[k]} begins with {shown(beginnings[k])}, which is not read; expected v, vn, vt or f"
            )
        is_vertex, is_face = (np.fromiter(map(word.__eq__, beginnings), bool, len(beginnings)) for word in (b"v", b"f"))
        vertices.append(_vertices(block.pick(is_vertex).columns(1)))
        faces.append(_faces(block.pick(is_face).columns(1), num_vertices + np.cumsum(is_vertex)[is_face]))
        num_vertices += len(vertices[-1])
    if not faces:
        return np.concatenate(vertices), NO_INDICES.reshape(-1, 3)
    corners, found, counts, lines = (np.concatenate(arrays) for arrays in zip(*faces, strict=True))
    bad = np.flatnonzero((found < 0) | (found >= num_vertices))
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"line {np.repeat(lines, counts)[k]} is a face of vertex {corners[k]}, but the file has {num_vertices} "
            "vertices, counted from 1; repair the file"
        )
    return np.concatenate(vertices), fan(found, counts)


def _vertices(rows: Tokens) -> np.ndarray:
    bad = np.flatnonzero(~np.isin(rows.counts, _VERTEX_LENGTHS))
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} is a vertex of {rows.counts[k]} numbers; expected 3, 4, 6 or 7: {CUT}")
    return rows.numbers(float)[rows.first[:, None] + np.arange(3)]


def _faces(rows: Tokens, num_above: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners as stated in the file and counted from 0, the number of corners of each face, and its line.

    ``num_above`` is the number of vertices above each face.
    """
    bad = np.flatnonzero(rows.counts < 3)
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} is a face of {rows.counts[k]} corners; expected 3 or more: {CUT}")
    corners = rows.numbers(int)
    # A negative index counts back from the last vertex above the face.
    found = np.where(corners < 0, np.repeat(num_above, rows.counts) + corners, corners - 1)
    return corners, found, rows.counts, rows.lines
