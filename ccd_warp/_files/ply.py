"""Read ASCII and binary PLY files: exactly as many elements as the header says."""

from dataclasses import dataclass, field

import numpy as np

from ccd_warp._files.text import CUT, NO_INDICES, Tokens, check_last_index, counted_polygons, fan, shown, text_rows
from ccd_warp._input.messages import InputError

_TYPES = {
    b"char": "i1",
    b"int8": "i1",
    b"uchar": "u1",
    b"uint8": "u1",
    b"short": "i2",
    b"int16": "i2",
    b"ushort": "u2",
    b"uint16": "u2",
    b"int": "i4",
    b"int32": "i4",
    b"uint": "u4",
    b"uint32": "u4",
    b"int64": "i8",
    b"uint64": "u8",
    b"float": "f4",
    b"float32": "f4",
    b"double": "f8",
    b"float64": "f8",
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
        if element.name == b"face" and element.count:
            element.corners()
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
        last_index = None
        if element.name == b"face" and len(element.types) == 1:
            corners, counts = counted_polygons(part)
            last_index = int(corners[-1])
            continue
        if element.name == b"vertex":
            vertices = np.concatenate([_vertices(element, block) for block in part.blocks()])
            continue
        blocks = [_columns(element, block) for block in part.blocks()]
        if element.name == b"face":
            lists = [columns[element.corners()] for columns in blocks]
            corners = np.concatenate([block.numbers(int) for block in lists])
            counts = np.concatenate([block.counts for block in lists])
            if (counts < 3).any():
                k = int(np.argmax(counts < 3))
                raise InputError(f"line {part.lines[k]} is a face of {counts[k]} corners; expected 3 or more: {CUT}")
    if at < len(rows):
        raise InputError(f"line {rows.lines[at]} is one more than the header says; {CUT}")
    check_last_index(text, last_index, len(vertices))
    return vertices, corners, counts


def _refuse_count(element: _Element, found: int) -> None:
    raise InputError(
        f"holds {found} rows of the element {shown(element.name)}, and its header says {element.count}; {CUT}"
    )


def _vertices(element: _Element, rows: Tokens) -> np.ndarray:
    if element.count_types:
        columns = _columns(element, rows)
        return np.column_stack([columns[axis].numbers(float) for axis in (b"x", b"y", b"z")])
    _check_lengths(rows, len(element.types))
    names = list(element.types)
    values = rows.numbers(float).reshape(-1, len(names))
    return values[:, [names.index(axis) for axis in (b"x", b"y", b"z")]]


def _columns(element: _Element, rows: Tokens) -> dict[bytes, Tokens]:
    """The tokens of each property of an element, with one row for each row of the element."""
    columns: dict[bytes, Tokens] = {}
    end = np.zeros(len(rows.counts), dtype=np.int64)
    for name in element.types:
        length: int | np.ndarray = 1
        if name in element.count_types:
            _check_lengths(rows, end + 1, at_least=True)
            length = np.maximum(rows.columns(end, end + 1).numbers(int), 0)
            end = end + 1
        columns[name] = rows.columns(end, end + length)
        end = end + length
    _check_lengths(rows, end)
    return columns


def _check_lengths(rows: Tokens, lengths: int | np.ndarray, *, at_least: bool = False) -> None:
    lengths = np.broadcast_to(lengths, rows.counts.shape)
    bad = np.flatnonzero(rows.counts < lengths if at_least else rows.counts != lengths)
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"line {rows.lines[k]} holds {rows.counts[k]} numbers; expected {lengths[k]}, as the header says: {CUT}"
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
