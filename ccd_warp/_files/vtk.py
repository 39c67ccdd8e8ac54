"""Read legacy VTK files of unstructured grids, in text and binary: every section as long as its line says."""

import re
from functools import partial
from urllib.parse import unquote

import numpy as np

from ccd_warp._files.cells import Grid, vtk_blocks
from ccd_warp._files.text import CUT, shown, text_rows
from ccd_warp._input.messages import InputError

_TYPES = {
    **{b"char": "i1", b"unsigned_char": "u1", b"short": "i2", b"unsigned_short": "u2", b"int": "i4", b"float": "f4"},
    **{b"unsigned_int": "u4", b"long": "i8", b"unsigned_long": "u8", b"double": "f8", b"vtkidtype": "i4"},
    **{f"vtktypeint{8 * size}".encode(): f"i{size}" for size in (1, 2, 4, 8)},
    **{f"vtktypeuint{8 * size}".encode(): f"u{size}" for size in (1, 2, 4, 8)},
}
# Components of the attributes whose lines have a name and a type.
_WIDTHS = {b"VECTORS": 3, b"NORMALS": 3, b"TENSORS": 9, b"TENSORS6": 6, b"GLOBAL_IDS": 1, b"PEDIGREE_IDS": 1}


def read_vtk(data: bytes) -> Grid:
    """Points, cells and fields at the points.

    Raises:
        InputError: If a section is damaged, or not as long as stated.
    """
    head = re.match(rb"# vtk DataFile Version (\d)\.\d+\s*\n[^\n]*\n\s*(ASCII|BINARY)\s*\n", data)
    if not head:
        raise InputError(f"does not begin as a VTK file, with '# vtk DataFile Version', ASCII or BINARY; {CUT}")
    content = data[head.end() :]
    stream: _Text | _Binary = _Text(content) if head[2] == b"ASCII" else _Binary(content)
    if stream.words() != [b"DATASET", b"UNSTRUCTURED_GRID"]:
        raise InputError("holds another dataset than an UNSTRUCTURED_GRID; save it as PLY or VTU")
    found: dict[bytes, np.ndarray] = {}
    corners, ends = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    fields: dict[bytes, dict[str, np.ndarray]] = {b"POINT_DATA": {}, b"CELL_DATA": {}, b"": {}}
    at, count = b"", -1
    while words := _line(stream):
        section = words[0].upper()
        if section in found and section in (b"POINTS", b"CELLS", b"CELL_TYPES", b"POINT_DATA", b"CELL_DATA"):
            raise InputError(f"has the section {shown(section)} twice; {CUT}")
        match [section, *words[1:]]:
            case [b"POINTS", number, kind] if _type(kind)[0] == "f":
                found[section] = stream.values(3 * _number(number), _type(kind)).reshape(-1, 3)
            case [b"CELLS", number, size]:
                read = _new_cells if int(head[1]) >= 5 else _old_cells
                corners, ends = read(stream, _number(number), _number(size))
                found[section] = ends
            case [b"CELL_TYPES", number]:
                found[section] = stream.values(_number(number), "i4")
            case [b"POINT_DATA" | b"CELL_DATA", number]:
                at, count = section, _number(number)
                found[section] = np.zeros(0)
                if count != len(found.get(b"POINTS" if at == b"POINT_DATA" else b"CELL_TYPES", ())):
                    raise InputError(f"its section {shown(at)} is of {count}, not of as many as there are; {CUT}")
            case [b"FIELD", _, number]:
                for _ in range(_number(number)):
                    name, width, length, kind = _line(stream)
                    values = stream.values(_number(width) * _number(length), _type(kind))
                    _keep(fields[at], name, values, _number(width))
            case [b"SCALARS", name, kind, *width] if len(width) < 2 and stream.words()[:1] == [b"LOOKUP_TABLE"]:
                components = _number(width[0]) if width else 1
                _keep(fields[at], name, stream.values(components * count, _type(kind)), components)
            case [b"TEXTURE_COORDINATES", name, width, kind]:
                stream.values(_number(width) * count, _type(kind))
            case [b"LOOKUP_TABLE", name, number]:
                stream.values(4 * _number(number), stream.colours)
            case [b"COLOR_SCALARS", name, width]:
                stream.values(_number(width) * count, stream.colours)
            case [keyword, name, kind] if keyword in _WIDTHS:
                _keep(fields[at], name, stream.values(_WIDTHS[keyword] * count, _type(kind)), _WIDTHS[keyword])
            case _:
                raise InputError(f"holds the line {shown(b' '.join(words))}, which is not read; {CUT}")
    if not {b"POINTS", b"CELLS", b"CELL_TYPES"} <= found.keys() or len(found[b"CELL_TYPES"]) != len(ends):
        raise InputError(f"has no points, or no cells, or other types than cells; {CUT}")
    blocks = vtk_blocks(found[b"CELL_TYPES"], ends, corners)
    of_points, of_cells = (
        {name: partial(np.asarray, values) for name, values in fields[at].items()}
        for at in (b"POINT_DATA", b"CELL_DATA")
    )
    return Grid(found[b"POINTS"], blocks, of_points, of_cells)


def _line(stream: "_Text | _Binary") -> list[bytes]:
    """The words of the next line that is none of what is said about an array; such parts end with an empty line."""
    while (words := stream.words()) and words[0] in (b"METADATA", b"INFORMATION"):
        stream.skip()
    return words


def _keep(fields: dict[str, np.ndarray], name: bytes, values: np.ndarray, width: int) -> None:
    fields[unquote(name.decode(errors="replace"))] = values.reshape(-1, width) if width > 1 else values


def _number(word: bytes) -> int:
    if not word.isdigit() or len(word) > 18:
        raise InputError(f"holds {shown(word)} where a count is expected; {CUT}")
    return int(word)


def _type(word: bytes) -> str:
    if word.lower() not in _TYPES:
        raise InputError(f"holds {shown(word)} where a type of numbers is expected, which is not read; {CUT}")
    return _TYPES[word.lower()]


def _new_cells(stream: "_Text | _Binary", number: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all cells and where each cell's end, of version 5: as offsets, which begin with 0, and corners."""
    parts = []
    for keyword, count in ((b"OFFSETS", number), (b"CONNECTIVITY", size)):
        words = stream.words()
        if len(words) != 2 or words[0].upper() != keyword or _type(words[1])[0] not in "iu":
            line = shown(b" ".join(words))
            raise InputError(f"holds the line {line}; expected {keyword.decode()} and a type of integers: {CUT}")
        parts.append(stream.values(count, _type(words[1])).astype(np.int64))
    offsets, corners = parts
    if not len(offsets) or offsets[0]:
        raise InputError(f"the offsets of its cells do not begin with 0; {CUT}")
    return corners, offsets[1:]


def _old_cells(stream: "_Text | _Binary", number: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Those of earlier versions, where each cell begins with its number of corners."""
    values = stream.values(size, "i4").astype(np.int64)
    # Where cells begin is known one after another; most files have cells of one size, which is tried first.
    width = int(values[0]) + 1 if size else 1
    if number * width == size and (values[::width] == width - 1).all():
        begins = np.arange(number) * width
    else:
        rows: list[int] = []
        at = 0
        while at < size and len(rows) <= number:
            rows.append(at)
            at += max(int(values[at]), 0) + 1
        if at != size or len(rows) != number:
            raise InputError(f"the corners of its {number} cells do not take the {size} numbers that are stated; {CUT}")
        begins = np.array(rows, dtype=np.int64)
    return np.delete(values, begins), np.cumsum(values[begins])


class _Text:
    """The lines and numbers of a file in text; the numbers of a section end with a line."""

    colours = "f4"

    def __init__(self, data: bytes) -> None:
        self.rows = text_rows(data, first_line=4)
        self.ends = np.cumsum(self.rows.counts)
        self.at = 0

    def words(self) -> list[bytes]:
        self.at += 1
        return self.rows.row(self.at - 1) if self.at <= len(self.rows) else []

    def skip(self) -> None:
        """Go on behind the next empty line."""
        lines = self.rows.lines
        while self.at < len(lines) and lines[self.at] == lines[self.at - 1] + 1:
            self.at += 1

    def values(self, count: int, dtype: str) -> np.ndarray:
        if not count:
            return np.zeros(0)
        total = (int(self.ends[self.at - 1]) if self.at else 0) + count
        end = int(np.searchsorted(self.ends, total))
        if end == len(self.ends) or self.ends[end] != total:
            raise InputError(f"holds other than {count} numbers from line {self.rows.lines[self.at - 1] + 1} on; {CUT}")
        part, self.at = self.rows.part(self.at, end + 1), end + 1
        return np.concatenate([block.numbers(float if dtype[0] == "f" else int) for block in part.blocks()])


class _Binary:
    """Those of a binary file, big-endian."""

    colours = "u1"

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def words(self) -> list[bytes]:
        words: list[bytes] = []
        while not words and self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            if end < 0:
                raise InputError(f"ends within a line; {CUT}")
            words, self.at = self.data[self.at : end].split(), end + 1
        return words

    def skip(self) -> None:
        end = self.data.find(b"\n\n", self.at - 1)
        self.at = len(self.data) if end < 0 else end + 2

    def values(self, count: int, dtype: str) -> np.ndarray:
        kind = np.dtype(">" + dtype)
        end = self.at + count * kind.itemsize
        if end > len(self.data) or self.data[end : end + 1] not in (b"\n", b""):
            raise InputError(f"{count} numbers of {kind.itemsize} bytes do not end with a line end or the file; {CUT}")
        values = np.frombuffer(self.data, kind, count, self.at)
        self.at = end + 1
        return values
