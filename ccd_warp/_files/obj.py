"""Read OBJ files: vertices, faces and objects as in the file; lines that are not understood are rejected."""

import re
from array import array

import numpy as np

from ccd_warp._files.text import CUT, fan, shown
from ccd_warp._scene.input.messages import InputError

# Keywords other than those of vertices and faces: attributes, points and lines, groups, materials, display.
_BESIDE = frozenset(
    b"vn vt vp p l s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj "
    b"ctech stech".split()
)
_VERTEX_LENGTHS = (3, 4, 6, 7)  # with a weight, a colour, or a colour with its opacity


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
    vertices, corners = array("d"), array("q")  # 8 bytes a number, where a list takes 32
    counts, lines, face_name = array("q"), array("q"), array("q")
    numbers: dict[tuple[bytes, bytes], int] = {(b"", b""): 0}  # of objects and groups
    part = group = b""
    label = num_vertices = 0
    text = re.sub(rb"\\\r?\n", b" ", re.sub(rb"#[^\r\n]*", b"", data))
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
            elif keyword == b"f":
                if len(words) < 4:
                    raise InputError(f"is a face of {len(words) - 1} corners; expected 3 or more")
                # behind a slash there is a texture coordinate or a normal
                stated = [int(word.partition(b"/")[0]) for word in words[1:]]
                # a negative index counts back from the last vertex above the face
                corners.extend([corner - 1 if corner >= 0 else num_vertices + corner for corner in stated])
                counts.append(len(stated))
                lines.append(number)
                face_name.append(label)
            elif keyword in (b"o", b"g"):
                name = line.strip()[1:].strip()
                part, group = (name, b"") if keyword == b"o" else (part, name)  # an object ends the group before it
                label = numbers.setdefault((part, group), len(numbers))
            elif keyword not in _BESIDE:
                raise InputError(f"begins with {shown(keyword)}, which is not read; expected v, vn, vt or f")
            if b"_" in line and keyword in (b"v", b"f"):  # Python allows it between digits
                raise ValueError
        except InputError as error:
            raise InputError(f"line {number} {error}: {CUT}") from None
        except (ValueError, OverflowError):
            raise InputError(f"line {number} holds {shown(line)}; expected numbers: {CUT}") from None
    names = [b"/".join(filter(None, pair)).decode("utf-8", "backslashreplace") for pair in numbers]
    flat, of_face = np.array(corners, dtype=np.int64), np.array(counts, dtype=np.int64)
    bad = np.flatnonzero((flat < 0) | (flat >= num_vertices))
    if bad.size:
        line = np.repeat(lines, of_face)[bad[0]]
        raise InputError(
            f"line {line} is a face of a vertex that is none of the {num_vertices} of the file, counted from 1; {CUT}"
        )
    triangles = fan(flat, of_face)
    return np.array(vertices).reshape(-1, 3), triangles, names, np.repeat(np.array(face_name), of_face - 2)
