"""Read ASCII and binary PLY files: exactly as many elements as the header says."""

from dataclasses import dataclass, field

import numpy as np

from ccd_warp._files.text import CUT, NO_INDICES, Rows, check_last_index, fan, integers, lists_in, shown, text_rows
from ccd_warp._input.messages import InputError

_TYPES = {
    **{b"char": "i1", b"uchar": "u1", b"short": "i2", b"ushort": "u2", b"int": "i4", b"uint": "u4"},
    **{f"int{8 * size}".encode(): f"i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}".encode(): f"u{size}" for size in (1, 2, 4, 8)},
    **{b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"},
}
_FORMATS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_CORNERS = (b"vertex_indices", b"vertex_index")


@dataclass(frozen=True)
class _Element:
    """An element of the header, which describes one kind of rows.

    Attributes:
        name: Name, such as vertex.
        count: Number of rows.
        types: Type of each property, by its name.
        count_types: Type of the length of each property that is a list.
    """

    name: bytes
    count: int
    types: dict[bytes, str] = field(default_factory=dict)
    count_types: dict[bytes, str] = field(default_factory=dict)

    def corners(self) -> bytes:
        """The property that holds the vertices of a face."""
        for name in _CORNERS:
            if name in self.count_types:
                break
        else:
            if len(self.count_types) != 1:
                raise InputError("the header gives its faces no list vertex_indices; export the file again")
            (name,) = self.count_types
        if self.types[name][0] == "f":
            raise InputError(f"the header gives {shown(name)} a type of real numbers; expected integers")
        return name


def read_ply(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a PLY file; polygons become fans.

    Raises:
        InputError: If the file is malformed or does not hold what its header says.
    """
    order, elements, start, num_lines = _header(data)
    if order:
        vertices, faces, counts = _read_binary(data, start, elements, order)
    else:
        vertices, faces, counts = _read_ascii(data[start:], num_lines + 1, elements)
    return vertices, fan(faces, counts)


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
        match words:
            case [b"ply"] if number == 1:
                pass
            case [b"comment" | b"obj_info", *_] | []:
                pass
            case [b"format", name, b"1.0"] if name in _FORMATS and order is None:
                order = _FORMATS[name]
            case [b"element", name, count] if count.isdigit() and len(count) < 19:
                if name in [element.name for element in elements]:
                    raise InputError(f"line {number} states the element {shown(name)} a second time; {CUT}")
                elements.append(_Element(name, int(count)))
            case [b"property", kind, name] if kind in _TYPES and elements and name not in elements[-1].types:
                elements[-1].types[name] = _TYPES[kind]
            case [b"property", b"list", count, kind, name] if (
                count in _TYPES
                and _TYPES[count][0] != "f"
                and kind in _TYPES
                and elements
                and name not in elements[-1].types
            ):
                elements[-1].types[name] = _TYPES[kind]
                elements[-1].count_types[name] = _TYPES[count]
            case [b"end_header"]:
                break
            case _:
                line = shown(b" ".join(words))
                raise InputError(f"line {number} of the header is {line}; expected format, element or property: {CUT}")
    if order is None:
        raise InputError(f"the header states no format; {CUT}")
    _check_elements(elements)
    return order, elements, start, number


def _check_elements(elements: list[_Element]) -> None:
    for element in elements:
        if element.name == b"vertex" and not {b"x", b"y", b"z"} <= element.types.keys() - element.count_types.keys():
            raise InputError("the header gives its vertices no x, y and z; export the file again")
        if element.name == b"tristrips" and element.count:
            raise InputError("holds strips of triangles, which are not read; export the file with faces")


def _read_ascii(text: bytes, first_line: int, elements: list[_Element]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = text_rows(text, first_line)
    vertices, corners, counts = np.zeros((0, 3)), NO_INDICES, NO_INDICES
    last_index = None
    at = 0
    for element in elements:
        part = rows.part(at, at + element.count)
        if len(part) < element.count:
            _refuse_count(element, len(part))
        at += element.count
        if not element.count:
            continue
        columns, last_index = _columns(element, part), None
        if element.name == b"vertex":
            vertices = np.column_stack([columns[axis][0] for axis in (b"x", b"y", b"z")])
        elif element.name == b"face":
            numbers, counts = columns[element.corners()]
            corners = integers(numbers, part, counts)
            part.refuse_where(counts < 3, "is a face of {} corners; expected 3 or more", counts)
            last_index = int(corners[-1]) if len(element.types) == 1 else None
    if at < len(rows):
        raise InputError(f"line {rows.lines[at]} is one more than the header says; {CUT}")
    check_last_index(text, last_index, len(vertices))
    return vertices, corners, counts


def _columns(element: _Element, rows: Rows) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
    """The numbers of each property of an element, and how many each row has."""
    columns: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
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


def _refuse_count(element: _Element, found: int) -> None:
    raise InputError(
        f"holds {found} rows of the element {shown(element.name)}, and its header says {element.count}; {CUT}"
    )


def _read_binary(
    data: bytes, start: int, elements: list[_Element], order: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, corners, counts = np.zeros((0, 3)), NO_INDICES, NO_INDICES
    for element in elements:
        if not element.count:
            continue
        dtype = _row_dtype(data, start, element, order)
        available = (len(data) - start) // max(dtype.itemsize, 1)
        rows = np.frombuffer(data, dtype, min(element.count, available), start)
        for name in element.count_types:
            lengths = rows[_length_name(name)]
            bad = np.flatnonzero(lengths != lengths[0]) if len(lengths) else lengths
            if bad.size:
                raise InputError(
                    f"the lists of {shown(element.name)} differ in length, {lengths[0]} and {lengths[bad[0]]} in row "
                    f"{bad[0]}, which is read in ASCII alone; save triangles, or copy the file again if it was cut"
                )
        if available < element.count:
            _refuse_count(element, available)
        start += element.count * dtype.itemsize
        if element.name == b"vertex":
            vertices = np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])
        elif element.name == b"face":
            lists = rows[element.corners().decode("latin-1")].astype(np.int64)
            if lists.shape[1] < 3:
                raise InputError(f"face 0 has {lists.shape[1]} corners; expected 3 or more: {CUT}")
            corners, counts = lists.reshape(-1), np.full(len(lists), lists.shape[1])
    if start != len(data):
        raise InputError(f"holds {len(data) - start} bytes more than its header says; {CUT}")
    return vertices, corners, counts


def _length_name(name: bytes) -> str:
    return f"length of {name.decode('latin-1')}"


def _row_dtype(data: bytes, start: int, element: _Element, order: str) -> np.dtype:
    """Layout of the rows of an element, all of whose lists must be as long as those of its first row."""
    fields: list[tuple] = []
    size = 0
    for name, kind in element.types.items():
        plain = name.decode("latin-1")
        if name not in element.count_types:
            fields.append((plain, order + kind))
            size += np.dtype(kind).itemsize
            continue
        count_type = np.dtype(order + element.count_types[name])
        if len(data) < start + size + count_type.itemsize:
            _refuse_count(element, 0)
        length = int(np.frombuffer(data, count_type, 1, start + size)[0])
        size += count_type.itemsize + length * np.dtype(kind).itemsize
        if length < 0 or start + size > len(data):
            _refuse_count(element, 0)
        fields += [(_length_name(name), count_type), (plain, order + kind, (length,))]
    return np.dtype(fields)
