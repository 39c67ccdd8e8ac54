"""Read OBJ files: vertices, faces and objects as in the file; lines that are not understood are rejected."""

import re
from dataclasses import replace

import numpy as np

from ccd_warp._files.text import CUT, NO_INDICES, Tokens, fan, shown, text_rows
from ccd_warp._input.messages import InputError

# Keywords other than those of vertices and faces: attributes, points and lines, groups, materials, display.
_BESIDE = frozenset(
    b"vn vt vp p l g s o mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj "
    b"ctech stech".split()
)
_VERTEX_LENGTHS = (3, 4, 6, 7)  # with a weight, a colour, or a colour with its opacity


_LABEL = re.compile(rb"(?:^|(?<=[\r\n]))[ \t\v\f]*([og])(?=[ \t\v\f\r\n]|$)([^\r\n]*)")


def read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray]:
    """Vertices and triangles of an OBJ file, and the object or group to which each belongs; polygons become fans.

    An OBJ file has no counts, so a file truncated between two lines cannot be distinguished from a complete one.

    Returns:
        Vertices [n, 3], triangles [m, 3], the names of objects and groups, and for each triangle the index of its name,
        shape [m]. A group within an object is called OBJECT/GROUP; what precedes the first has the name "".

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
    labels = [(line[1] == b"o", line[2].strip()) for line in _LABEL.finditer(text)]
    has_slashes = b"/" in text
    vertices, num_vertices = [np.zeros((0, 3))], 0
    faces: list[tuple[np.ndarray, ...]] = []
    num_labels, above = 0, [NO_INDICES]  # labels above each face
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
        of_faces = block.pick(is_face).columns(1)
        if has_slashes:  # before a texture coordinate and a normal; in a vertex they are damage
            of_faces = replace(of_faces, tokens=re.sub(rb"(?<=[0-9])/\S*", b"", b" ".join(of_faces.tokens)).split())
        faces.append(_faces(of_faces, num_vertices + np.cumsum(is_vertex)[is_face]))
        num_vertices += len(vertices[-1])
        is_label = np.fromiter((word in (b"o", b"g") for word in beginnings), bool, len(beginnings))
        above.append(num_labels + np.cumsum(is_label)[is_face])
        num_labels += int(is_label.sum())
    assert num_labels == len(labels), "both find the same lines"
    if not faces:
        return np.concatenate(vertices), NO_INDICES.reshape(-1, 3), [], NO_INDICES
    corners, found, counts, lines = (np.concatenate(arrays) for arrays in zip(*faces, strict=True))
    bad = np.flatnonzero((found < 0) | (found >= num_vertices))
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"line {np.repeat(lines, counts)[k]} is a face of vertex {corners[k]}, but the file has {num_vertices} "
            "vertices, counted from 1; repair the file"
        )
    names, of_label = _names(labels)
    return np.concatenate(vertices), fan(found, counts), names, np.repeat(of_label[np.concatenate(above)], counts - 2)


def _names(labels: list[tuple[bool, bytes]]) -> tuple[list[str], np.ndarray]:
    """The distinct pairs of an object and a group as names, and the index of that which is valid after so many lines.

    An object ends the group before it.
    """
    numbers: dict[tuple[bytes, bytes], int] = {(b"", b""): 0}
    of_label = [0]
    part = group = b""
    for is_object, name in labels:
        part, group = (name, b"") if is_object else (part, name)
        of_label.append(numbers.setdefault((part, group), len(numbers)))
    names = [b"/".join(filter(None, names)).decode("utf-8", "backslashreplace") for names in numbers]
    return names, np.array(of_label, dtype=np.int64)


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
