"""Read VTU files, VTK's unstructured grids in XML: every array exactly as long as the header of its piece says."""

import base64
import re
import zlib
from functools import partial
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from ccd_warp._files.cells import Blocks, Grid
from ccd_warp._files.text import CUT, all_numbers
from ccd_warp._scene.input.messages import InputError

_TYPES = {f"{name}{8 * size}": f"{kind}{size}" for name, kind in (("Int", "i"), ("UInt", "u")) for size in (1, 2, 4, 8)}
_TYPES |= {"Float32": "f4", "Float64": "f8"}
# Cells of a fixed number of corners, by VTK's number: their names and corners.
_CELLS = {
    **{1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4), 12: ("hexahedron", 8)},
    **{13: ("wedge", 6), 14: ("pyramid", 5), 21: ("line3", 3), 22: ("triangle6", 6), 23: ("quad8", 8)},
    **{24: ("tetra10", 10), 25: ("hexahedron20", 20)},
}
_ATTRIBUTES = {"type", "version", "byte_order", "header_type", "compressor"}


def read_vtu(data: bytes) -> Grid:
    """Points, cells and fields of a VTU file; the arrays lie in text, in base64, or as they are behind the XML.

    Raises:
        InputError: If an array is damaged, or has another length than stated.
    """
    appended = re.search(rb"<AppendedData[^>]*>", data)
    body = b""
    if appended:
        end = data.rfind(b"</AppendedData>")
        body, data = data[appended.end() : end].lstrip(), data[: appended.end()] + data[end:]
        if end < appended.end() or not body.startswith(b"_"):
            raise InputError(f"its appended data do not begin with '_'; {CUT}")
    root = ET.fromstring(data)
    if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid" or set(root.keys()) - _ATTRIBUTES:
        raise InputError(f"is no VTKFile of the type UnstructuredGrid with {', '.join(sorted(_ATTRIBUTES))} alone")
    arrays = _Arrays(root, body[1:])
    piece = _one(_one(root, "UnstructuredGrid"), "Piece")
    num_points, num_cells = int(piece.attrib["NumberOfPoints"]), int(piece.attrib["NumberOfCells"])
    points = arrays.read(_one(_one(piece, "Points"), "DataArray"), "f", num_points, 3)
    at_points = [array for parent in piece.findall("PointData") for array in parent]
    fields = {array.get("Name", ""): partial(arrays.read, array, "fiu", num_points) for array in at_points}
    return Grid(points, _blocks(arrays, _one(piece, "Cells"), num_cells), fields)


def _blocks(arrays: "_Arrays", parent: ET.Element, num_cells: int) -> Blocks:
    """The cells of a piece, those of one type that follow one another in a block."""
    by_name = {array.get("Name"): array for array in parent}
    if len(by_name) != len(parent):
        raise InputError(f"two arrays of its cells have one name; {CUT}")
    ends = arrays.read(by_name["offsets"], "iu", num_cells).astype(np.int64)
    types = arrays.read(by_name["types"], "iu", num_cells)
    corners = arrays.read(by_name["connectivity"], "iu", int(ends[-1]) if num_cells else 0).astype(np.int64)
    begins = np.append(0, ends[:-1])
    blocks: Blocks = []
    bounds = [0, *(np.flatnonzero(types[1:] != types[:-1]) + 1).tolist(), num_cells] if num_cells else []
    for begin, end in pairwise(bounds):
        if int(types[begin]) not in _CELLS:
            raise InputError(f"cell {begin} is of VTK's type {types[begin]}, which is not read; save triangles")
        name, count = _CELLS[int(types[begin])]
        bad = np.flatnonzero(ends[begin:end] - begins[begin:end] != count)
        if bad.size:
            k = begin + int(bad[0])
            raise InputError(f"cell {k} is a {name} of {ends[k] - begins[k]} corners; expected {count}: it is damaged")
        cells = corners[begins[begin] : ends[end - 1]].reshape(-1, count)
        # VTK's wedge is the mirror image of everybody else's.
        blocks.append((name, cells[:, [0, 2, 1, 3, 5, 4]] if name == "wedge" else cells))
    return blocks


def _one(parent: ET.Element, tag: str) -> ET.Element:
    elements = parent.findall(tag)
    if len(elements) != 1:
        raise InputError(f"has {len(elements)} {tag} in its {parent.tag}; expected one: {CUT}")
    return elements[0]


class _Arrays:
    """Reads the arrays of a file."""

    def __init__(self, root: ET.Element, appended: bytes) -> None:
        self.order = {"LittleEndian": "<", "BigEndian": ">"}[root.get("byte_order", "LittleEndian")]
        self.header = np.dtype(self.order + {"UInt32": "u4", "UInt64": "u8"}[root.get("header_type", "UInt32")])
        self.compressor = root.get("compressor")
        self.appended = appended
        encodings = [element.get("encoding") for element in root.findall("AppendedData")]
        self.is_raw = encodings == ["raw"]
        if encodings not in ([], ["raw"], ["base64"]):
            raise InputError(f"has appended data in the encodings {encodings}; expected one, raw or base64")
        self.offsets = [int(array.attrib["offset"]) for array in root.iter("DataArray") if "offset" in array.attrib]

    def read(self, array: ET.Element, kinds: str, count: int, width: int | None = None) -> np.ndarray:
        """The values of an array of ``count`` tuples, of a type of these kinds; [count, width] unless it is flat."""
        name, dtype = array.get("Name"), np.dtype(self.order + _TYPES[array.attrib["type"]])
        components = int(array.get("NumberOfComponents") or 1)
        if (
            array.tag != "DataArray"
            or dtype.kind not in kinds
            or components != (width or components)
            or components < 1
            or count < 0
        ):
            raise InputError(f"its array {name!r} has {components} components of {dtype}; expected {width or 1}: {CUT}")
        size, text = count * components * dtype.itemsize, (array.text or "").encode()
        match array.attrib["format"]:
            case "ascii":
                values = all_numbers(text, float if dtype.kind == "f" else int)
            case "binary":
                values = np.frombuffer(self._unpacked(_decoded(text), size), dtype)
            case "appended":
                values = np.frombuffer(self._unpacked(self._appended(int(array.attrib["offset"])), size), dtype)
            case how:
                raise InputError(f"its array {name!r} has the format {how!r}; expected ascii, binary or appended")
        if len(values) != count * components:
            raise InputError(f"its array {name!r} holds {len(values)} numbers; expected {count * components}: {CUT}")
        return values if width is None and components == 1 else values.reshape(count, components)

    def _appended(self, offset: int) -> bytes:
        """What lies between an offset and the next one."""
        if not 0 <= offset < len(self.appended):
            raise InputError(f"states the offset {offset} in {len(self.appended)} bytes of appended data; {CUT}")
        end = min((other for other in self.offsets if other > offset), default=len(self.appended))
        return self.appended[offset:end] if self.is_raw else _decoded(self.appended[offset:end])

    def _unpacked(self, data: bytes, size: int) -> bytes:
        """The content of an array of this size; its size or, where it is packed, those of its blocks come first."""
        unit = self.header.itemsize
        number = int(np.frombuffer(data, self.header, 1)[0])
        if self.compressor is None:
            end, content = unit + number, data[unit : unit + number]
        elif self.compressor != "vtkZLibDataCompressor":
            raise InputError(f"is packed by {self.compressor!r}, which is not read; save it with zlib")
        else:
            head = np.frombuffer(data, self.header, 3 + number if number else 1).tolist()
            _, full, _, *sizes = head if number else (0, 0, 0)
            ends = np.cumsum([len(head) * unit, *sizes]).tolist()
            end, content = ends[-1], b"".join(_block(data[a:b], full) for a, b in pairwise(ends))
        # At the end of appended data, the XML goes on with white space.
        if len(content) != size or data[end:].strip(b" \t\r\n"):
            raise InputError(f"an array has {len(content)} bytes; expected {size}, and none behind it: {CUT}")
        return content


def _block(data: bytes, size: int) -> bytes:
    """The content of a packed block, at most so many bytes."""
    stream = zlib.decompressobj()
    content = stream.decompress(data, size + 1)  # one byte more would be an excess
    if len(content) > size or not stream.eof or stream.unused_data:
        raise InputError(f"a block of an array does not unpack to {size} bytes; {CUT}")
    return content


def _decoded(text: bytes) -> bytes:
    """The bytes of base64, with no character that is not part of it; each part ends where it is filled up with '='."""
    text = b"".join(text.split())
    return b"".join(base64.b64decode(part, validate=True) for part in re.findall(rb"[^=]+=*|=+", text))
