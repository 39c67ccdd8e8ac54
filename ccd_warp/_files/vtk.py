"""Read VTK files, XML or legacy, of unstructured grids and PolyData: by VTK, in full as their headers announce them."""

import atexit
import base64
import os
import pickle
import re
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from ccd_warp._files.cells import Grid, grid_of
from ccd_warp._files.opened import not_installed, read_file
from ccd_warp._files.text import CUT, all_numbers
from ccd_warp._scene.input.messages import InputError

_HEAD = re.compile(rb"# vtk DataFile Version (\d)\.\d+\s*\n[^\n]*\n\s*(ASCII|BINARY)\s*\n\s*DATASET\s+(\w+)", re.I)
_LISTS = ("CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")
_STATED = re.compile(rf"\n(POINTS|CELL_TYPES|{'|'.join(_LISTS)})[ \t]+(\d+)[ \t]*(\w*)[ \t\r]*(?:\n|\Z)".encode(), re.I)
# Of fields: how many rows each array of a section has, an array of so many, or one that says its columns and rows.
_VALUES = re.compile(
    rb"^(?:(?:POINT|CELL)_DATA[ \t]+(\d+)|(SCALARS|VECTORS|NORMALS)[ \t]+\S+[ \t]+(\w+)[ \t]*(\d*)"
    rb"|\S+[ \t]+(\d+)[ \t]+(\d+)[ \t]+([a-z]\w*))[ \t\r]*(?:\n|\Z)(?:LOOKUP_TABLE[^\n]*(?:\n|\Z))?",
    re.I | re.M,
)
_CONNECTIVITY = re.compile(rb"CONNECTIVITY[ \t]+(\w+)[ \t\r]*\n", re.I)
# Bytes of a number, by its type in a legacy file, where these are not 4.
_BYTES = {"char": 1, "short": 2, "long": np.dtype("long").itemsize, "double": 8}
_BYTES |= {f"unsigned_{name}": _BYTES[name] for name in ("char", "short", "long")}
_BYTES |= {"vtktypeint64": 8, "vtktypeuint64": 8}
_READ = "UnstructuredGrid", "PolyData", "UNSTRUCTURED_GRID", "POLYDATA"
# The parts of a piece in XML, and the attribute that says how many cells each has.
_PARTS = {tag: f"NumberOf{tag}" for tag in ("Cells", "Verts", "Lines", "Strips", "Polys")}
_SOLID = ("hexahedron", "wedge", "pyramid")
# Cells by VTK's number, those of higher order by the corners that come first.
_NAMES = {
    **{1: "vertex", 2: "poly_vertex", 3: "line", 4: "poly_line", 5: "triangle", 6: "strip", 7: "polygon", 8: "pixel"},
    **{9: "quad", 10: "tetra", 11: "voxel", 12: "hexahedron", 13: "wedge", 14: "pyramid", 21: "line3"},
    **{22: "triangle6", 23: "quad8", 24: "tetra10", 25: "hexahedron20", 26: "wedge15", 27: "pyramid13", 28: "quad9"},
    **{29: "hexahedron27", 30: "quad6", 31: "wedge12", 32: "wedge18", 33: "hexahedron24", 34: "triangle7"},
    **{35: "line4", 37: "pyramid19"},
    # Of Lagrange and Bézier, of any order.
    **{68 + k: f"{name}0" for k, name in enumerate(("line", "triangle", "quad", "tetra", *_SOLID) * 2)},
}


class _Content(NamedTuple):
    """The points, the types, sizes and corners of all cells, and the values of a field at the points."""

    points: np.ndarray
    types: np.ndarray
    sizes: np.ndarray
    corners: np.ndarray
    values: np.ndarray | None
    names: list[str]  # of all fields
    is_copy: np.ndarray  # which cells are those of another piece
    num_pieces: int = 1


def read_vtk(path: Path, field: str | None) -> Grid:
    """Points and cells of a file, with the values of one field at its points.

    Raises:
        InputError: If it is damaged, or holds more or less than it announces.
    """
    files = [path]
    if path.suffix.lower() in (".pvtu", ".pvtp"):
        files = [path.parent / piece.attrib["Source"] for piece in ET.fromstring(read_file(path)).iterfind("*/Piece")]
    pieces = [_read_file(file, field) for file in files]
    offsets = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    points, types, sizes = (np.concatenate(rows) for rows in list(zip(*pieces, strict=True))[:3])
    corners = np.concatenate([piece.corners + offset for piece, offset in zip(pieces, offsets, strict=False)])
    num_pieces = sum(piece.num_pieces for piece in pieces)
    kept, begins, blocks = np.ones(len(types), dtype=bool), np.cumsum(sizes) - sizes, []
    if num_pieces > 1:
        kept = ~np.concatenate([piece.is_copy for piece in pieces])
    for pair in np.unique((types << 32 | sizes)[kept]).tolist():
        number, size = divmod(pair, 1 << 32)
        rows = np.flatnonzero(kept & (types == number) & (sizes == size))
        name = _NAMES.get(number, f"VTK_{number}")
        blocks.append((name, corners[begins[rows, None] + np.arange(size)], rows))
    fields = dict.fromkeys(set(pieces[0].names).intersection(*(piece.names for piece in pieces)))
    if field in fields:
        fields[field] = np.concatenate([piece.values for piece in pieces])
    return grid_of(points, blocks, fields, num_pieces)


def _read_file(path: Path, field: str | None) -> _Content:
    data = read_file(path)
    kind, data, stated, num_pieces = (_announced_by_legacy if data.startswith(b"#") else _announced_by_xml)(data)
    content = _Content(*_of_process(kind, data, field))._replace(num_pieces=num_pieces)
    if (found := (len(content.points), len(content.types), len(content.corners))) != stated:
        raise InputError(f"announces {_shown(stated)}, and {_shown(found)} can be read; {CUT}")
    return content


def _shown(counts: tuple[int, ...]) -> str:
    return "{} points and {} cells of {} corners".format(*counts)


def _announced_by_legacy(data: bytes) -> tuple[str, bytes, tuple[int, ...], int]:
    """The dataset of a legacy file, its text, and how many points, cells and corners it says it has."""
    head = _HEAD.match(data)
    if not head or (kind := head[3].decode().upper()) not in _READ:
        raise InputError(
            "holds the dataset " + head[3].decode() + "; expected POLYDATA or an UNSTRUCTURED_GRID: save it as PLY"
            if head
            else f"does not begin as a VTK file, with '# vtk DataFile Version', ASCII or BINARY, and DATASET; {CUT}"
        )
    is_text, is_old = head[2].upper() == b"ASCII", int(head[1]) < 5
    if is_text and not data[-1:].isspace():
        raise InputError(f"its last number may have lost digits, because no line end follows; {CUT}")
    counts = np.zeros(3, dtype=np.int64)

    def expect(numbers: int, begin: int, of_type: bytes = b"int") -> None:
        """Refuse numbers that cannot be there in full: VTK's reader makes those of what was in memory."""
        least = 2 if is_text else _BYTES.get(of_type.decode().lower(), 4)
        if numbers * least > len(data) - begin:
            raise InputError(f"announces {numbers} numbers in {len(data) - begin} bytes; {CUT}")

    for found in _STATED.finditer(data):
        section, count, last = found[1].upper(), int(found[2]), found[3]
        if section == b"CELL_TYPES":
            expect(count, found.end())
        elif section == b"POINTS":
            counts[0] += count
            expect(3 * count, found.end(), last)
        # Before version 5 each cell begins with its number of corners; since then there is one offset more than cells.
        elif is_old:
            counts[1:] += [count, int(last or 0) - count]
            expect(int(last or 0), found.end())
        elif count:
            counts[1:] += [count - 1, int(last or 0)]
            if not (corners := _CONNECTIVITY.search(data, found.end())):
                raise InputError(f"announces {int(last or 0)} corners of cells, and none follow; {CUT}")
            expect(int(last or 0), corners.end(), corners[1])
    num_rows = 0
    for found in () if is_text else _VALUES.finditer(data):  # in text VTK's reader notices itself
        if found[1]:
            num_rows = int(found[1])
        elif found[2]:
            num_columns = int(found[4] or 1) if found[2].upper() == b"SCALARS" else 3
            expect(num_rows * num_columns, found.end(), found[3])
        else:
            expect(int(found[5]) * int(found[6]), found.end(), found[7])
    if is_text:  # decimals in full
        data = re.sub(rb"(\nPOINTS\s+\d+\s+)float\b", rb"\1double", data, flags=re.I)
    return kind, data, tuple(counts.tolist()), 1


def _announced_by_xml(data: bytes) -> tuple[str, bytes, tuple[int, ...], int]:
    """The type of a file in XML, its text, how many points, cells and corners it has, and in how many pieces."""
    start = re.search(rb"<AppendedData[^>]*>", data)
    begin, end = (start.end(), data.rfind(b"</AppendedData>")) if start else (len(data), len(data))
    appended = data[begin:end].lstrip()
    if start and not (end >= begin and appended.startswith(b"_")):
        raise InputError(f"its appended data do not begin with '_'; {CUT}")
    root = ET.fromstring(data[:begin] + data[end:])
    if root.tag != "VTKFile" or (kind := root.get("type", "")) not in _READ:
        raise InputError(f"is a {root.tag} of the type {root.get('type')!r}; expected UnstructuredGrid or PolyData")
    stored, counts = _Stored(root, appended[1:]), np.zeros(3, dtype=np.int64)
    pieces = root.findall(f"{kind}/Piece")
    for piece in pieces:
        num_points = int(piece.get("NumberOfPoints", 0))
        counts[0] += num_points
        for array in piece.iterfind("Points/DataArray"):
            stored.expect(array, 3 * num_points)
        for array in piece.iterfind("PointData/DataArray"):
            stored.expect(array, num_points * int(array.get("NumberOfComponents") or 1))
        for tag, attribute in _PARTS.items():
            num_cells = int(piece.get(attribute, 0))
            counts[1] += num_cells
            for array in piece.iterfind(f"{tag}/DataArray"):
                if array.get("Name") == "connectivity":
                    counts[2] += stored.count(array)
                elif array.get("Name") in ("offsets", "types"):
                    stored.expect(array, num_cells)
    text = re.sub(rb"<DataArray[^>]*ascii[^>]*>", lambda tag: tag[0].replace(b'"Float32"', b'"Float64"'), data[:begin])
    return kind, text + data[begin:], tuple(counts.tolist()), len(pieces)


class _Stored:
    """How many numbers the arrays of a file in XML hold: those in text each, of others as many as their bytes make."""

    def __init__(self, root: ET.Element, appended: bytes) -> None:
        order = {"LittleEndian": "<", "BigEndian": ">"}[root.get("byte_order", "LittleEndian")]
        self.header = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[root.get("header_type", "UInt32")])
        self.is_packed, self.appended = root.get("compressor") is not None, appended
        self.is_raw = any(element.get("encoding") == "raw" for element in root.iterfind("AppendedData"))
        self.offsets = [int(array.attrib["offset"]) for array in root.iter("DataArray") if "offset" in array.attrib]

    def expect(self, array: ET.Element, count: int) -> None:
        """Refuse an array of another number of values."""
        if (found := self.count(array)) != count:
            raise InputError(f"its array {array.get('Name')!r} holds {found} numbers; expected {count}: {CUT}")

    def count(self, array: ET.Element) -> int:
        """The number of values of an array."""
        kind, text = array.attrib["type"], (array.text or "").encode()
        if array.get("format") == "ascii":
            return len(all_numbers(text, float if kind.startswith("Float") else int))
        if array.get("format") == "appended":
            begin = int(array.attrib["offset"])
            end = min((offset for offset in self.offsets if offset > begin), default=len(self.appended))
            text = self.appended[begin:end]
        is_raw = self.is_raw and array.get("format") == "appended"
        parts = [text] if is_raw else re.findall(rb"[^=]+=*", b"".join(text.split()))
        content = b"".join(parts if is_raw else (base64.b64decode(part, validate=True) for part in parts))
        head = np.frombuffer(content, self.header, 1 if not self.is_packed else 3).tolist()
        # Of packed ones: the number of blocks, the size of each and of the last one, and their sizes as they are here.
        size, begin = head[0], self.header.itemsize
        if self.is_packed:
            size, begin = (head[0] - (head[2] > 0)) * head[1] + head[2], (3 + head[0]) * begin
            head[0] = int(np.frombuffer(content, self.header, 3 + head[0])[3:].sum())
        if len(content[begin : begin + head[0]]) != head[0] or content[begin + head[0] :].strip():
            raise InputError(f"its array {array.get('Name')!r} has not the {head[0]} bytes that it announces; {CUT}")
        return int(size) // (int(re.sub("[A-Za-z]", "", kind)) // 8)


class _Process:
    """The process that reads, which starts with the first file; one that a file has ended is followed by another."""

    def __init__(self) -> None:
        self._lock, self._owner = threading.Lock(), 0
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, *request: Any) -> Any:
        """What the process makes of a request."""
        with self._lock:
            if self._process is None or self._owner != os.getpid():
                self._process, self._owner = self._started(), os.getpid()
            assert self._process.stdin is not None and self._process.stdout is not None
            try:
                pickle.dump(request, self._process.stdin, protocol=5)
                self._process.stdin.flush()
                return pickle.load(self._process.stdout)
            except BaseException as error:
                self.stop()
                if isinstance(error, Exception):
                    raise InputError(f"VTK fails on it; {CUT}") from error
                raise

    def stop(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.communicate()

    def _started(self) -> subprocess.Popen[bytes]:
        if find_spec("vtkmodules") is None:
            raise not_installed("vtk")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        return subprocess.Popen(
            [sys.executable, "-P", str(Path(__file__).with_name("vtk_process.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # an interrupt from the keyboard is for the one who asks
        )


_PROCESS = _Process()
atexit.register(_PROCESS.stop)


def _of_process(*request: Any) -> Any:
    answer = _PROCESS.read(*request)
    if answer is None:
        raise not_installed("vtk from 9.7 on")
    if isinstance(answer, str):
        raise InputError(f"VTK cannot read it: {answer.rpartition('):')[2].strip()}; {CUT}")
    return answer
