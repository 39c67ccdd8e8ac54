"""Read XDMF files: grids whose numbers lie in the XML, in HDF5 or in binary files, each item of the stated shape."""

import math
import posixpath
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ccd_warp._files.cells import VTK_CELLS, Blocks, Grid
from ccd_warp._files.opened import PLAIN_BYTES, check_size, note, read_file
from ccd_warp._files.text import CUT, all_numbers
from ccd_warp._input.messages import InputError

_KINDS = {"Float": "f", "Int": "i", "UInt": "u", "Char": "i", "UChar": "u"}
# Number of a cell's type in a topology of the type Mixed, and what each topology is called, as VTK's cells are.
_MIXED = {4: "triangle", 5: "quad", 6: "tetra", 7: "pyramid", 8: "wedge", 9: "hexahedron"}
_MIXED |= {36: "triangle6", 37: "quad8", 38: "tetra10", 48: "hexahedron20"}
_TOPOLOGIES = {
    **{"Triangle": "triangle", "Quadrilateral": "quad", "Tetrahedron": "tetra", "Pyramid": "pyramid", "Wedge": "wedge"},
    **{"Hexahedron": "hexahedron", "Polyvertex": "vertex", "Polyline": "line", "Edge_3": "line3"},
    **{"Triangle_6": "triangle6", "Tri_6": "triangle6", "Quadrilateral_8": "quad8", "Quad_8": "quad8"},
    **{"Tetrahedron_10": "tetra10", "Tet_10": "tetra10", "Hexahedron_20": "hexahedron20", "Hex_20": "hexahedron20"},
}
_WIDTHS = dict(VTK_CELLS.values())
_ATTRIBUTES = {"Name", "Dimensions", "DataType", "NumberType", "Precision", "Format", "Endian", "Reference", "ItemType"}
_ATTRIBUTES |= {"Compression", "Seek"}


class Xdmf:
    """The grids of an XDMF file.

    Attributes:
        frames: The grids of its temporal collection; the one grid of a file without one.
        is_series: Whether it has a collection.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path, self.max_bytes = path, max_bytes
        self.root = ET.fromstring(read_file(path, max_bytes))
        domains = self.root.findall("Domain")
        if self.root.tag != "Xdmf" or len(domains) != 1:
            raise InputError(f"has {len(domains)} Domain in {self.root.tag}; expected one in Xdmf: {CUT}")
        grids = domains[0].findall("Grid")
        collections = [grid for grid in grids if grid.get("GridType") == "Collection"]
        beside = [grid for grid in grids if grid not in collections]
        self.is_series = bool(collections)
        # Some programs write a collection for each field.
        self._series = [each.findall("Grid") for each in collections] if collections else [grids]
        self.frames = self._series[0]
        times = [[time.get("Value") for grid in each for time in grid.findall("Time")] for each in self._series]
        if (
            not self.frames
            or len(beside) > 1
            or any(grid.get("CollectionType") != "Temporal" for grid in collections)
            or any(grid.get("GridType", "Uniform") != "Uniform" for each in (*self._series, beside) for grid in each)
            or any(len(each) != len(self.frames) for each in self._series)
            or any(each != times[0] for each in times)
        ):
            raise InputError("holds other grids than one, or temporal collections of the same times and one beside")
        # A frame without points or cells has those of this grid.
        self._base = beside[0] if beside else self.frames[0]

    def has_points(self, k: int) -> bool:
        """Whether frame ``k`` has points of its own."""
        return self.frames[k].find("Geometry") is not None

    def grid(self, k: int) -> Grid:
        """Frame ``k``, with the points and cells of the first where it has none."""
        geometry, topology = self._part(k, "Geometry"), self._part(k, "Topology")
        if (kind := geometry.get("Type") or geometry.get("GeometryType", "XYZ")) != "XYZ":
            raise InputError(f"has a geometry of the type {kind!r}; expected XYZ")
        points = self._read(geometry, "f")
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(f"its points have shape {points.shape}; expected (n, 3)")
        return Grid(points, self._cells(topology), self._fields(k, "Node", "f"), self._fields(k, "Cell", "fiu"))

    def _fields(self, k: int, centre: str, kinds: str) -> dict[str, Callable[[], np.ndarray]]:
        """The fields at the nodes or of the cells, of numbers of these kinds."""
        found = [field for each in self._series for field in each[k].findall("Attribute")]
        found = [field for field in found if field.get("Center", "Node") == centre]
        fields: dict[str, Callable[[], np.ndarray]] = {
            each.get("Name", ""): partial(self._read, each, kinds) for each in found
        }
        if centre == "Node" and len(fields) != len(found):
            raise InputError(f"frame {k} has two fields of one name; {CUT}")
        return fields

    def _part(self, k: int, tag: str) -> ET.Element:
        found = self.frames[k].findall(tag) or self._base.findall(tag)
        if len(found) != 1:
            raise InputError(f"frame {k} has {len(found)} {tag}; expected one")
        return found[0]

    def _cells(self, topology: ET.Element) -> Blocks:
        name = topology.get("Type") or topology.get("TopologyType")
        values = self._read(topology, "iu").astype(np.int64)
        if name == "Mixed":
            blocks = _mixed(values.ravel().tolist())
        elif name not in _TOPOLOGIES:
            raise InputError(f"has cells of the type {name!r}, which is not read; save triangles")
        elif values.ndim != 2 or values.shape[1] != _WIDTHS[_TOPOLOGIES[name]]:
            raise InputError(f"has cells of the type {name} in the shape {values.shape}; {CUT}")
        else:
            blocks = [(_TOPOLOGIES[name], values)]
        stated = topology.get("NumberOfElements")
        count = sum(len(cells) for _, cells in blocks)
        if stated is not None and math.prod(map(int, stated.split())) != count:
            raise InputError(f"holds {count} cells, and says that it has {stated}; {CUT}")
        return blocks

    def _read(self, parent: ET.Element, kinds: str) -> np.ndarray:
        items = parent.findall("DataItem")
        if len(items) != 1:
            raise InputError(f"a {parent.tag} has {len(items)} DataItem; expected one: {CUT}")
        item = items[0]
        reference = item.get("Reference")
        if reference is not None:
            place = ((item.text or "") if reference == "XML" else reference).strip()
            found = self.root.findall("./" + place.partition("/Xdmf/")[2]) if place.startswith("/Xdmf/") else []
            if len(found) != 1 or found[0].tag != "DataItem" or "Reference" in found[0].attrib:
                raise InputError(f"refers to {place!r}, which is no DataItem in it")
            item = found[0]
        try:
            return self._values(item, kinds)
        except InputError as error:
            raise InputError(f"the data of a {parent.tag}: {error}") from error

    def _values(self, item: ET.Element, kinds: str) -> np.ndarray:
        """The numbers of an item, which must be of one of these kinds and of the stated shape."""
        unknown = set(item.keys()) - _ATTRIBUTES
        usual = {"ItemType": "Uniform", "Compression": "Raw", "Seek": "0"}
        if unknown or any(item.get(name, value) != value for name, value in usual.items()):
            raise InputError(f"have attributes that are not read: {', '.join(sorted(unknown or usual))}; {CUT}")
        shape = tuple(map(int, item.attrib["Dimensions"].split()))
        stated = item.get("DataType") or item.get("NumberType")
        kind = _KINDS[stated] if stated else kinds[0]
        if kind not in kinds or min(shape, default=-1) < 0 or {"DataType", "NumberType"} <= set(item.keys()):
            expected = "reals" if kinds == "f" else "integers"
            raise InputError(f"are {stated} of shape {shape}; expected {expected}: {CUT}")
        count, text, how = math.prod(shape), (item.text or "").strip(), item.get("Format")
        check_size("the array", 8 * count, max(self.max_bytes, PLAIN_BYTES))
        if item.get("Precision", "8") not in ("1", "2", "4", "8"):
            raise InputError(f"have the precision {item.get('Precision')!r}; expected 1, 2, 4 or 8: {CUT}")
        if how == "XML":
            values = all_numbers(text.encode(), float if kind == "f" else int)
        elif how == "Binary":
            order = {"Little": "<", "Big": ">"}.get(item.get("Endian", "Little"), "=")
            dtype = np.dtype(f"{order}{kind}{int(item.attrib['Precision'])}")
            values = np.frombuffer(read_file(self.path.parent / text, self.max_bytes), dtype)
        elif how == "HDF":
            values = self._of_hdf5(text, shape)
        else:
            raise InputError(f"have the format {how!r}; expected XML, HDF or Binary")
        if values.size != count or (count and values.dtype.kind not in kinds):
            raise InputError(f"are {values.size} numbers of {values.dtype}; expected {count} of {stated}: {CUT}")
        return values.reshape(shape)

    def _of_hdf5(self, place: str, shape: tuple[int, ...]) -> np.ndarray:
        try:
            import h5py
        except ImportError as error:
            raise InputError("lie in an HDF5 file; install with: pip install 'ccd-warp[formats]'") from error
        name, _, key = place.rpartition(":")
        path = self.path.parent / name
        note(path)
        with h5py.File(path, "r") as file:
            group: Any = file
            for part in posixpath.normpath(key.strip("/")).split("/"):
                if not isinstance(group.get(part, getlink=True), h5py.HardLink):
                    raise InputError(f"has no {key!r} in {name}, or as a link alone, which is not read")
                group = group[part]
            if not isinstance(group, h5py.Dataset) or group.is_virtual or group.external or group.shape != shape:
                raise InputError(f"in {name} are no dataset of shape {shape} with the values in this file; {CUT}")
            stored = group.id.get_storage_size()
            limit = max(self.max_bytes, PLAIN_BYTES) if stored >= group.nbytes else self.max_bytes
            check_size(f"the dataset {key!r} in {name}", group.nbytes, limit)
            _check_chunks(group, limit)
            return np.asarray(group[()])


def _check_chunks(dataset: Any, limit: int) -> None:
    """Refuse a deflated chunk that unpacks to more than a chunk holds: HDF5 would unpack all that there is."""
    if dataset.compression != "gzip":
        return
    size = math.prod(dataset.chunks) * dataset.dtype.itemsize
    check_size("a chunk", size, limit)
    for k in range(dataset.id.get_num_chunks()):
        mask, packed = dataset.id.read_direct_chunk(dataset.id.get_chunk_info(k).chunk_offset)
        most = size + 4  # with a checksum
        if not mask and len(zlib.decompressobj().decompress(packed, most + 1)) > most:
            raise InputError(f"hold a chunk that unpacks to more than its {size:,} bytes; {CUT}")


def _mixed(values: list[int]) -> Blocks:
    """Cells of a list in which each begins with the number of its type, as blocks of one type."""
    blocks: list[tuple[str, list[list[int]]]] = []
    at = 0
    while at < len(values):
        if values[at] not in _MIXED:
            raise InputError(f"has a cell of XDMF's type {values[at]}, which is not read; save triangles")
        name = _MIXED[values[at]]
        corners = values[at + 1 : at + 1 + _WIDTHS[name]]
        if len(corners) < _WIDTHS[name]:
            raise InputError(f"ends within a cell; {CUT}")
        if not blocks or blocks[-1][0] != name:
            blocks.append((name, []))
        blocks[-1][1].append(corners)
        at += 1 + len(corners)
    return [(name, np.array(cells, dtype=np.int64)) for name, cells in blocks]
