"""Read STL files: binary ones of the length given by their count, ASCII ones to the end of every solid."""

import numpy as np

from ccd_warp._files.content import FilePart
from ccd_warp._files.text import CUT, floats, shown
from ccd_warp._scene.input.messages import InputError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes, the last four of them the number of facets
# The first words of the lines of a facet.
_LINES = (b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")


def read_stl(data: bytes) -> FilePart:
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
    return FilePart(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def _read_ascii(data: bytes) -> np.ndarray:
    """Corners of all facets, [n, 3, 3]."""
    numbers: list[bytes] = []
    is_open, at = False, 0  # whether a solid is, and which line of a facet is next
    for line, text in enumerate(data.lower().splitlines(), 1):
        words = text.split()
        if not words:
            continue
        if is_open and at == 0 and words[0] == b"endsolid":
            is_open = False
        elif not is_open and words[0] == b"solid":
            is_open = True
        elif not is_open or words[0] != _LINES[at]:
            expected = _LINES[at].decode() if is_open else "solid"
            raise InputError(f"line {line} begins with {shown(words[0])}; expected {expected}: {CUT}")
        else:
            if words[0] == b"vertex":
                if len(words) != 4:
                    raise InputError(f"line {line} is a vertex of {len(words) - 1} numbers; expected 3: {CUT}")
                numbers += words[1:]
            at = (at + 1) % len(_LINES)
    if is_open:
        raise InputError(f"ends without 'endsolid'; {CUT}")
    try:
        return floats(numbers).reshape(-1, 3, 3)
    except ValueError as error:
        raise InputError(f"a vertex is not of numbers ({error}); {CUT}") from None
