"""Read XDMF files by meshio, frame by frame, and check that all came that they say they hold.

Of a series, meshio passes over points and cells that change from frame to frame, and of an array over attributes such
as ``Seek``; and it takes a dataset of HDF5 in whatever shape it has. Text it would read in single precision where that
is not stated otherwise.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ccd_warp._files.cells import Grid, grid_of, load_meshio, reading, whole_numbers
from ccd_warp._files.opened import PLAIN_BYTES, check_file, check_size, read_file
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError

_USUAL = {"ItemType": "Uniform", "Compression": "Raw", "Seek": "0"}
_ATTRIBUTES = {"Name", "Dimensions", "DataType", "NumberType", "Precision", "Format", "Endian", *_USUAL}
_INTEGERS = ("Int", "UInt", "Char", "UChar")


class Xdmf:
    """The grids of an XDMF file.

    Attributes:
        frames: The grids of its temporal collection; the one grid of a file without one.
        is_series: Whether it has a collection.
    """

    @classmethod
    def open(cls, path: Path, max_bytes: int) -> "Xdmf":
        """The grids of a file, which messages name."""
        with reading(path):
            return cls(path, max_bytes)

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

    def fields(self, k: int, centre: str) -> dict[str, ET.Element]:
        """The fields of frame ``k`` at each Node, or of each Cell."""
        found = [field for each in self._series for field in each[k].findall("Attribute")]
        found = [field for field in found if field.get("Center", "Node") == centre]
        fields = {field.get("Name", ""): field for field in found}
        if len(fields) != len(found):
            raise InputError(f"frame {k} has two fields of one name; {CUT}")
        return fields

    def grid(self, k: int, wanted: Iterable[Any] = ()) -> Grid:
        """Frame ``k`` with the fields of these names, and the points and cells of the first where it has none."""
        reader = load_meshio().xdmf.main.XdmfReader(str(self.path))
        tree = ET.Element("Xdmf", Version="3.0")
        grid = ET.SubElement(ET.SubElement(tree, "Domain"), "Grid")
        geometry, topology = (self._part(k, tag) for tag in ("Geometry", "Topology"))
        nodes, cells = (self.fields(k, centre) for centre in ("Node", "Cell"))
        self._add(grid, geometry, ("Float",))
        self._add(grid, topology, _INTEGERS)
        for fields, kinds in ((nodes, ("Float",)), (cells, ("Float", *_INTEGERS))):
            for name in fields.keys() & {*wanted}:
                self._add(grid, fields[name], kinds, Center="Node" if fields is nodes else "Cell")
        with whole_numbers():
            mesh = reader.read_xdmf3(tree)
        if (kind := geometry.get("Type") or geometry.get("GeometryType", "XYZ")) != "XYZ" or mesh.points.ndim != 2:
            raise InputError(f"has a geometry of the type {kind!r} and the shape {mesh.points.shape}; expected XYZ")
        stated, count = topology.get("NumberOfElements"), sum(len(block.data) for block in mesh.cells)
        if stated is not None and math.prod(map(int, stated.split())) != count:
            raise InputError(f"holds {count} cells, and says that it has {stated}; {CUT}")
        read = grid_of(mesh)  # without the names of the fields that are not wanted
        return read._replace(
            fields={**dict.fromkeys(nodes, _unread), **read.fields},
            cell_fields={**dict.fromkeys(cells, _unread), **read.cell_fields},
        )

    def _part(self, k: int, tag: str) -> ET.Element:
        found = self.frames[k].findall(tag) or self._base.findall(tag)
        if len(found) != 1:
            raise InputError(f"frame {k} has {len(found)} {tag}; expected one")
        return found[0]

    def _add(self, grid: ET.Element, parent: ET.Element, kinds: tuple[str, ...], **attributes: str) -> None:
        """Add a part of a frame to a grid, with its array as it is read, which must be of one of these kinds."""
        items = parent.findall("DataItem")
        if len(items) != 1:
            raise InputError(f"a {parent.tag} has {len(items)} DataItem; expected one: {CUT}")
        item = items[0]
        try:
            kind = self._checked(item, kinds)
        except InputError as error:
            raise InputError(f"the data of a {parent.tag}: {error}") from error
        added = ET.SubElement(ET.SubElement(grid, parent.tag, {**parent.attrib, **attributes}), "DataItem")
        added.text = item.text
        stated = {"DataType": kind, "Precision": "1" if kind.endswith("Char") else "8"}
        added.attrib = {"Dimensions": item.attrib["Dimensions"], "Format": item.attrib["Format"], **stated}

    def _checked(self, item: ET.Element, kinds: tuple[str, ...]) -> str:
        """The kind of the numbers of an item."""
        unknown = set(item.keys()) - _ATTRIBUTES
        if unknown or any(item.get(name, value) != value for name, value in _USUAL.items()):
            raise InputError(f"have attributes that are not read: {', '.join(sorted(unknown or _USUAL))}; {CUT}")
        shape = tuple(map(int, item.attrib["Dimensions"].split()))
        kind = item.get("DataType") or item.get("NumberType") or kinds[0]
        if kind not in kinds or min(shape, default=-1) < 0 or {"DataType", "NumberType"} <= set(item.keys()):
            expected = "integers" if "Float" not in kinds else "numbers" if "Int" in kinds else "reals"
            raise InputError(f"are {kind} of shape {shape}; expected {expected}: {CUT}")
        check_size("the array", 8 * math.prod(shape), max(self.max_bytes, PLAIN_BYTES))
        how = item.get("Format")
        if how == "HDF":
            self._check_hdf5((item.text or "").strip(), shape, "f" if kind == "Float" else "iu")
        elif how != "XML":
            raise InputError(f"have the format {how!r}; expected XML or HDF")
        return kind

    def _check_hdf5(self, place: str, shape: tuple[int, ...], kinds: str) -> None:
        import h5py

        name, _, key = place.rpartition(":")
        path = self.path.parent / name
        check_file(path, self.max_bytes)
        with h5py.File(path, "r") as file:
            dataset = file.get(key)
            if not isinstance(dataset, h5py.Dataset) or dataset.shape != shape or dataset.dtype.kind not in kinds:
                raise InputError(f"in {place} are no dataset of shape {shape} of such numbers; {CUT}")


def _unread() -> np.ndarray:
    raise AssertionError("only fields that are wanted are read")
