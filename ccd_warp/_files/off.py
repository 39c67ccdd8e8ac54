"""Read OFF files: exactly as many vertices and faces as the line of counts says."""

import re

from ccd_warp._files.content import FilePart
from ccd_warp._files.polygons import fan
from ccd_warp._files.text import CUT, check_last_index, integers, lists_in, shown, text_rows
from ccd_warp._scene.input.messages import InputError

_MOST_BEHIND = 4  # numbers of a colour that may follow the corners of a face


def read_off(data: bytes) -> FilePart:
    """Vertices and polygons of an OFF file.

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
    count = len(rows) - at
    if count < num_vertices + num_faces:
        raise InputError(
            f"holds {min(count, num_vertices)} vertices and {max(count - num_vertices, 0)} faces, and says that it has "
            f"{num_vertices} and {num_faces}; {CUT}"
        )
    if count > num_vertices + num_faces:
        raise InputError(f"line {rows.lines[at + num_vertices + num_faces]} is one more than its counts say; {CUT}")
    points, faces = rows.part(at, at + num_vertices), rows.part(at + num_vertices)
    length = max(int(points.counts[0]), 3) if len(points) else 3
    points.refuse_where(points.counts != length, f"holds {{}} numbers; expected {length}, a vertex", points.counts)
    corners, counts = lists_in(faces, faces.numbers(), faces.first)
    corners = integers(corners, faces, counts)
    faces.refuse_where(
        (counts < 3) | (faces.counts > counts + 1 + _MOST_BEHIND),
        "is a face of {} corners in {} numbers; expected 3 corners or more",
        counts,
        faces.counts,
    )
    last_index = int(corners[-1]) if len(faces) and faces.counts[-1] == counts[-1] + 1 else None
    check_last_index(text, last_index, num_vertices)
    return FilePart(points.numbers().reshape(-1, length)[:, :3], fan(corners, counts), counts)
