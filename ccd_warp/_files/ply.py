"""Read ASCII and binary PLY files, exactly as many elements as the header says, and write them in double precision."""

from array import array
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ccd_warp._files.content import NO_EDGES, NO_INDICES, FilePart
from ccd_warp._files.polygons import fan
from ccd_warp._files.text import CUT, Rows, check_last_index, integers, lists_in, shown, text_rows
from ccd_warp._scene.input.messages import InputError

_TYPES = {
    **{b"char": "i1", b"uchar": "u1", b"short": "i2", b"ushort": "u2", b"int": "i4", b"uint": "u4"},
    **{f"int{8 * size}".encode(): f"i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}".encode(): f"u{size}" for size in (1, 2, 4, 8)},
    **{b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"},
}
_FORMATS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_AXES = ("x", "y", "z")
_CORNERS = ("vertex_indices", "vertex_index")
_ENDS = ("vertex1", "vertex2")
_BESIDE = ("range_grid",)  # of a scanner, which pixel is which vertex
# The numbers of a property, and how many each row has: one, or those of its list.
_Column = tuple[np.ndarray, np.ndarray]


class _Element(NamedTuple):
    """An element of the header: how many rows it has, and by its name the type of each property and of its length."""

    name: str
    num_rows: int
    types: dict[str, str]
    count_types: dict[str, str]  # of properties that are lists

    def corners(self) -> str:
        """The property that holds the vertices of a face."""
        names = [name for name in _CORNERS if name in self.count_types] or list(self.count_types)
        if not names or (len(names) > 1 and names[0] not in _CORNERS) or self.types[names[0]][0] == "f":
            raise InputError("the header gives its faces no list vertex_indices of integers; export the file again")
        return names[0]

    def refuse_count(self, count: int) -> None:
        """Refuse a file that ends within the element."""
        raise InputError(f"holds {count} rows of the element {self.name!r}, and its header says {self.num_rows}; {CUT}")


def read_ply(data: bytes) -> FilePart:
    """Vertices, polygons and edges of a PLY file; without both, the vertices are points.

    Raises:
        InputError: If the file is malformed or does not hold what its header says.
    """
    order, elements, start, num_lines = _header(data)
    rows = text_rows(data[start:], num_lines + 1) if not order else None
    vertices, faces, counts, edges = np.zeros((0, 3)), NO_INDICES, NO_INDICES, NO_EDGES
    at, last_index = start if order else 0, None
    for element in elements:
        if not element.num_rows:
            continue
        part = None if rows is None else rows.part(at, at + element.num_rows)
        if part is None:
            columns, at = _binary(data, at, element, order)
        else:
            columns, at, last_index = _text(part, element), at + element.num_rows, None
        if element.name == "vertex":
            if not {*_AXES} <= element.types.keys() - element.count_types.keys():
                raise InputError("the header gives its vertices no x, y and z; export the file again")
            vertices = np.column_stack([columns[axis][0].astype(np.float64) for axis in _AXES])
        elif element.name == "face":
            corners, counts = columns[element.corners()]
            faces = _indices(corners, part, counts)
            if (counts < 3).any():
                raise InputError(f"face {int(np.argmax(counts < 3))} has fewer than 3 corners; {CUT}")
            last_index = int(faces[-1]) if len(element.types) == 1 else None
        elif element.name == "edge":
            if any(element.types.get(end, "f")[0] == "f" or end in element.count_types for end in _ENDS):
                raise InputError("the header gives its edges no integers vertex1 and vertex2; export the file again")
            edges = np.column_stack([_indices(columns[end][0], part, columns[end][1]) for end in _ENDS])
            last_index = int(edges[-1, 1]) if [*element.types] == [*_ENDS] else None
        elif element.name not in _BESIDE and {*_CORNERS, *_ENDS} & element.types.keys():
            raise InputError(
                f"holds {shown(element.name.encode())} of vertices, which is not read; export it with faces"
            )
    if rows is None:
        if at != len(data):
            raise InputError(f"holds {len(data) - at} bytes more than its header says; {CUT}")
    else:
        if at < len(rows):
            raise InputError(f"line {rows.lines[at]} is one more than the header says; {CUT}")
        check_last_index(rows.text, last_index, len(vertices))
    points = np.arange(len(vertices)) if not len(faces) and not len(edges) else NO_INDICES
    return FilePart(vertices, fan(faces, counts), counts, edges, points)


def _header(data: bytes) -> tuple[str, list[_Element], int, int]:
    """Byte order (empty for ASCII), elements, byte offset of the rows, and the number of lines before them."""
    if not data.startswith((b"ply\n", b"ply\r")):
        raise InputError("does not begin with the line 'ply'; expected a PLY file")
    order: str | None = None
    elements: list[_Element] = []
    start = number = 0
    while True:
        end = data.find(b"\n", start)
        if end < 0:
            raise InputError(f"ends within its header; {CUT}")
        words = data[start:end].split()
        start, number = end + 1, number + 1
        element, name = elements[-1] if elements else None, words[-1].decode("latin-1") if words else ""
        match words:
            case [b"ply"] if number == 1:
                pass
            case [b"comment" | b"obj_info", *_] | []:
                pass
            case [b"format", kind, b"1.0"] if kind in _FORMATS and order is None:
                order = _FORMATS[kind]
            case [b"element", kind, count] if count.isdigit() and len(count) < 19:
                if kind.decode("latin-1") in [other.name for other in elements]:
                    raise InputError(f"line {number} states the element {shown(kind)} a second time; {CUT}")
                elements.append(_Element(kind.decode("latin-1"), int(count), {}, {}))
            case [b"property", kind, _] if kind in _TYPES and element and name not in element.types:
                element.types[name] = _TYPES[kind]
            case [b"property", b"list", count, kind, _] if (
                {count, kind} <= _TYPES.keys() and _TYPES[count][0] != "f" and element and name not in element.types
            ):
                element.types[name], element.count_types[name] = _TYPES[kind], _TYPES[count]
            case [b"end_header"] if order is not None:
                return order, elements, start, number
            case _:
                line = shown(b" ".join(words))
                raise InputError(f"line {number} of the header is {line}; expected format, element or property: {CUT}")


def _text(rows: Rows, element: _Element) -> dict[str, _Column]:
    """The properties of the rows of an element."""
    if len(rows) < element.num_rows:
        element.refuse_count(len(rows))
    columns: dict[str, _Column] = {}
    values, at, ends = rows.numbers(), rows.first, rows.first + rows.counts
    one = np.ones_like(at)
    says = "holds {} numbers; expected others, as the header says"
    for name in element.types:
        if name in element.count_types:
            columns[name] = lists_in(rows, values, at)
            at = at + 1
        else:
            rows.refuse_where(at >= ends, says, rows.counts)
            columns[name] = values[at], one
        at = at + columns[name][1]
    rows.refuse_where(at != ends, says, rows.counts)
    return columns


def _indices(numbers: np.ndarray, rows: Rows | None, counts: np.ndarray) -> np.ndarray:
    """Indices of vertices; of a text, which may hold other numbers, those of these rows."""
    return numbers.astype(np.int64) if rows is None else integers(numbers, rows, counts)


def _binary(data: bytes, start: int, element: _Element, order: str) -> tuple[dict[str, _Column], int]:
    """The properties of the rows of an element that begin at a byte, and where they end."""
    (first,), _ = _lengths(data, start, element, order, 1)
    row = _row_type(element, order, first)
    end = start + row.itemsize * element.num_rows
    if end <= len(data):
        rows = np.frombuffer(data, row, element.num_rows, start)
        if all((rows[f"length of {name}"] == rows[f"length of {name}"][0]).all() for name in element.count_types):
            return {
                name: (rows[name].reshape(-1), np.full(len(rows), rows[name].shape[1])) for name in element.types
            }, end
    lengths, begins = _lengths(data, start, element, order, element.num_rows)
    counts = dict(zip(element.count_types, lengths.T, strict=True))
    columns = {}
    for name, kind in element.types.items():
        of_name = counts.get(name, np.ones(len(lengths), dtype=np.int64))
        columns[name] = np.empty(of_name.sum(), order + kind), of_name
    content = np.frombuffer(data, np.uint8)
    for alike in np.unique(lengths, axis=0):
        numbers, row = np.flatnonzero((lengths == alike).all(axis=1)), _row_type(element, order, alike)
        rows = content[begins[numbers, None] + np.arange(row.itemsize)].view(row)[:, 0]
        for name, (values, of_name) in columns.items():
            first = (np.cumsum(of_name) - of_name)[numbers]
            values[first[:, None] + np.arange(rows[name].shape[1])] = rows[name]
    return columns, int(begins[-1])


def _row_type(element: _Element, order: str, lengths: np.ndarray) -> np.dtype:
    """The type of a row whose lists have these lengths."""
    fields: list[Any] = []
    of_list = dict(zip(element.count_types, lengths.tolist(), strict=True))
    for name, kind in element.types.items():
        if name in of_list:
            fields.append((f"length of {name}", order + element.count_types[name], ()))
        fields.append((name, order + kind, (of_list.get(name, 1),)))
    return np.dtype(fields)


def _lengths(data: bytes, at: int, element: _Element, order: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The lengths of the lists in each row, shape [count, lists], and where each row begins, and the last one ends."""
    lengths, begins = array("q"), array("q", [at])
    sizes = [(element.count_types.get(name), np.dtype(kind).itemsize) for name, kind in element.types.items()]
    steps = [(count_type and np.dtype(count_type).itemsize, count_type, size) for count_type, size in sizes]
    byte_order: Any = "big" if order == ">" else "little"
    for k in range(count):
        for width, count_type, size in steps:
            if not width or not count_type:
                at += size
                continue
            length = int.from_bytes(data[at : at + width], byte_order, signed=count_type[0] == "i")
            at += width + length * size
            if length < 0 or at > len(data):
                element.refuse_count(k)
            lengths.append(length)
        if at > len(data):
            element.refuse_count(k)
        begins.append(at)
    return np.array(lengths, dtype=np.int64).reshape(count, -1), np.array(begins)


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a binary PLY file in double precision (trimesh writes single)."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    rows["count"] = 3
    rows["indices"] = faces
    path.write_bytes(header.encode() + np.ascontiguousarray(vertices, dtype="<f8").tobytes() + rows.tobytes())
