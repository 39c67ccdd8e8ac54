"""Read OFF files: exactly as many vertices and faces as the line of counts says."""

import re

import numpy as np

from ccd_warp._files.text import CUT, Rows, check_last_index, counted_polygons, fan, shown, text_rows
from ccd_warp._input.messages import InputError


def read_off(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an OFF file; polygons become fans.

    Raises:
        InputError: If the file is malformed or does not hold what its counts say.
    """
    text = re.sub(rb"#[^\r\n]*", b" ", data)  # by a blank, because a comment ends a number
    rows = text_rows(text)
    first = rows.row(0) if len(rows) else [b""]
    # Texture coordinates, colours and normals of a vertex follow its position.
    if not re.fullmatch(rb"(ST)?C?N?OFF", first[0]):
        raise InputError(f"begins with {shown(first[0])}; expected an OFF file, in text and three dimensions")
    # The counts are on the first line or on the next.
    stated, at = (first[1:], 1) if len(first) > 1 else (rows.row(1) if len(rows) > 1 else [], 2)
    if len(stated) not in (2, 3) or not all(word.isdigit() and len(word) < 19 for word in stated):
        raise InputError(f"lacks the line that counts vertices, faces and edges; {CUT}")
    num_vertices, num_faces = int(stated[0]), int(stated[1])
    found = len(rows) - at
    if found < num_vertices + num_faces:
        raise InputError(
            f"holds {min(found, num_vertices)} vertices and {max(found - num_vertices, 0)} faces, and says that it has "
            f"{num_vertices} and {num_faces}; {CUT}"
        )
    if found > num_vertices + num_faces:
        raise InputError(f"line {rows.lines[at + num_vertices + num_faces]} is one more than its counts say; {CUT}")
    vertices = _vertices(rows.part(at, at + num_vertices))
    faces = rows.part(at + num_vertices)
    corners, counts = counted_polygons(faces, most_behind=4)
    # A colour may follow the corners of a face.
    last_index = int(corners[-1]) if len(faces) and faces.counts[-1] == counts[-1] + 1 else None
    check_last_index(text, last_index, num_vertices)
    return vertices, fan(corners, counts)


def _vertices(rows: Rows) -> np.ndarray:
    if not len(rows):
        return np.zeros((0, 3))
    length = max(int(rows.counts[0]), 3)
    bad = np.flatnonzero(rows.counts != length)
    if bad.size:
        k = int(bad[0])
        raise InputError(f"line {rows.lines[k]} holds {rows.counts[k]} numbers; expected {length}, a vertex: {CUT}")
    return np.concatenate([block.numbers(float).reshape(-1, length)[:, :3] for block in rows.blocks()])
