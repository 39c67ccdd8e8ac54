"""Read OBJ files: vertices, faces, lines, points and objects as in the file; lines not understood are rejected."""

import re
from array import array

import numpy as np

from ccd_warp._files.content import FilePart
from ccd_warp._files.polygons import fan
from ccd_warp._files.text import CUT, check_last_index, shown
from ccd_warp._scene.input.messages import InputError

# Keywords other than those of vertices and elements: attributes, groups, materials, display.
_BESIDE = frozenset(
    b"vn vt vp s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj ctech stech".split()
)
_VERTEX_LENGTHS = (3, 4, 6, 7)  # with a weight, a colour, or a colour with its opacity
_MANY = 8  # faces of as many corners, before a last one that may have lost some is taken for whole
_ELEMENTS = {b"f": ("face", 3), b"l": ("line", 2), b"p": ("point", 1)}  # and their least number of corners


class _Elements:
    """The elements of one kind: their corners, and of each their number, its line and the index of its name."""

    def __init__(self) -> None:
        self.corners, self.counts, self.lines, self.names = array("q"), array("q"), array("q"), array("q")

    def arrays(self, kind: str, num_vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The corners, their number and the index of the name of each; an InputError if there is no such vertex."""
        corners, counts = np.array(self.corners, dtype=np.int64), np.array(self.counts, dtype=np.int64)
        bad = np.flatnonzero((corners < 0) | (corners >= num_vertices))
        if bad.size:
            line = np.repeat(self.lines, counts)[bad[0]]
            raise InputError(
                f"line {line} is a {kind} of a vertex that is none of the {num_vertices} of the file, counted from 1; "
                f"{CUT}"
            )
        return corners, counts, np.array(self.names, dtype=np.int64)


def read_obj(data: bytes) -> FilePart:
    """Vertices, polygons, edges of lines and points of an OBJ file, and the object or group of each.

    An OBJ file has no counts, so a file truncated between two lines cannot be distinguished from a complete one. A
    group within an object is called OBJECT/GROUP; what precedes the first has the name "".

    Raises:
        InputError: If a line is malformed, or the last one has no line end and may not be whole.
    """
    vertices = array("d")  # 8 bytes a number, where a list takes 32
    elements = {keyword: _Elements() for keyword in _ELEMENTS}
    numbers: dict[tuple[bytes, bytes], int] = {(b"", b""): 0}  # of objects and groups
    part = group = line = keyword = b""
    label = num_vertices = 0
    text = re.sub(rb"\\(?:\r?\n|\r)", b" ", re.sub(rb"#[^\r\n]*", b"", data))
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        keyword = words[0]
        try:
            if keyword == b"v":
                if len(words) - 1 not in _VERTEX_LENGTHS:
                    raise InputError(f"is a vertex of {len(words) - 1} numbers; expected 3, 4, 6 or 7")
                vertices.extend([float(word) for word in words[1:]][:3])
                num_vertices += 1
            elif keyword in _ELEMENTS:
                kind, least = _ELEMENTS[keyword]
                if len(words) <= least:
                    raise InputError(f"is a {kind} of {len(words) - 1} corners; expected {least} or more")
                # behind a slash there is a texture coordinate or a normal
                stated = [int(word.partition(b"/")[0]) for word in words[1:]]
                of_kind = elements[keyword]
                # a negative index counts back from the last vertex above the element
                of_kind.corners.extend([corner - 1 if corner >= 0 else num_vertices + corner for corner in stated])
                of_kind.counts.append(len(stated))
                of_kind.lines.append(number)
                of_kind.names.append(label)
            elif keyword in (b"o", b"g"):
                name = line.strip()[1:].strip()
                part, group = (name, b"") if keyword == b"o" else (part, name)  # an object ends the group before it
                label = numbers.setdefault((part, group), len(numbers))
            elif keyword not in _BESIDE:
                raise InputError(f"begins with {shown(keyword)}, which is not read; expected v, vn, vt, f, l or p")
            if b"_" in line and (keyword == b"v" or keyword in _ELEMENTS):  # Python allows it between digits
                raise ValueError
        except InputError as error:
            raise InputError(f"line {number} {error}: {CUT}") from None
        except (ValueError, OverflowError):
            raise InputError(f"line {number} holds {shown(line)}; expected numbers: {CUT}") from None
    faces, counts, face_names = elements[b"f"].arrays("face", num_vertices)
    if not text.endswith((b"\n", b"\r")):  # nor a backslash before it
        _check_last_face(data, line, counts, num_vertices)
    chains, chain_counts, chain_names = elements[b"l"].arrays("line", num_vertices)
    points, point_counts, point_names = elements[b"p"].arrays("point", num_vertices)
    is_begin = np.ones(len(chains), dtype=bool)
    is_begin[np.cumsum(chain_counts) - 1] = False
    begins = np.flatnonzero(is_begin)
    element_names = ((face_names, counts - 2), (chain_names, chain_counts - 1), (point_names, point_counts))
    return FilePart(
        np.array(vertices).reshape(-1, 3),
        fan(faces, counts),
        counts,
        np.stack([chains[begins], chains[begins + 1]], axis=1),
        points,
        [b"/".join(filter(None, pair)).decode("utf-8", "backslashreplace") for pair in numbers],
        np.concatenate([np.repeat(names, times) for names, times in element_names]),
    )


def _check_last_face(data: bytes, line: bytes, counts: np.ndarray, num_vertices: int) -> None:
    """Refuse a last line without an end, but that of a face like many others that has lost no digit of its vertex.

    It may only be one of more corners than all before it.

    Args:
        data: The file.
        line: Its last line, without its comment.
        counts: Number of corners of each face.
        num_vertices: Number of vertices.
    """
    words = line.split() if data.endswith(line) else [b"#"]
    if words[:1] == [b"f"] and counts[-1] == counts.max() and (counts == counts.max()).sum() > _MANY:
        vertex, slash, _ = words[-1].partition(b"/")
        if slash:  # and another number of this corner has begun
            return
        check_last_index(line, int(vertex) if vertex.isdigit() else None, num_vertices + 1)
    elif words:
        check_last_index(b"#", None, num_vertices)
