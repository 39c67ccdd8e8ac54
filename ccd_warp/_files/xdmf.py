"""Read XDMF files by meshio, a grid or a temporal collection, with arrays in the XML or in HDF5 as stated."""

import copy
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from ccd_warp._files.by_meshio import quiet_meshio
from ccd_warp._files.cells import Grid, grid_of_meshio, load_meshio, mesh_of_grid, reading
from ccd_warp._files.content import Mesh
from ccd_warp._files.opened import check_file, read_file
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError


class Xdmf:
    """The frames of a temporal collection, or the one grid of a file; each has points of its own, or displacements."""

    def __init__(self, path: Path, *, displacement: str | None = None, surface: bool = False) -> None:
        """Refuse a file of other grids, and a collection in which nothing moves."""
        self.path, self.name, self.displacement, self.surface = path, path.name, displacement, surface
        with reading(path):
            grids = ET.fromstring(read_file(path)).findall("Domain/Grid")
            collections = [grid for grid in grids if grid.get("GridType") == "Collection"]
            others = [grid for grid in grids if grid not in collections]
            self.is_series = bool(collections)
            self.frames = collections[0].findall("Grid") if collections else grids
            if (
                not self.frames
                or max(len(collections), len(others)) > 1
                or any(grid.get("CollectionType") != "Temporal" for grid in collections)
                or any(grid.get("GridType", "Uniform") != "Uniform" for grid in (*self.frames, *others))
            ):
                raise InputError("holds other grids than one, or one temporal collection and one beside it")
            self._base = others[0] if others else self.frames[0]  # has the points and cells that a frame lacks
            if displacement is None and any(frame.find("Geometry") is None for frame in self.frames[1:]):
                names = ", ".join(repr(field.get("Name")) for field in self._fields(0)) or "no field at the points"
                raise InputError(
                    "all its frames have the same geometry; expected --displacement NAME with the field that moves "
                    f"it, and found {names}"
                )
            times = [time.get("Value", "") for grid in self.frames for time in grid.findall("Time")]
            self.times = [float(time) for time in times] if len(times) == len(self.frames) else None
        self.labels = [f"{self.name}[{k}]" for k in range(len(self.frames))]

    def read(self, k: int) -> Mesh:
        """Frame ``k``."""
        path = self.path.with_name(self.labels[k]) if self.is_series else self.path
        with reading(path):
            return mesh_of_grid(path, self._grid(k), self.displacement, self.surface)

    def _grid(self, k: int) -> Grid:
        """A frame as meshio reads a file of it alone, of which other fields are only named."""
        load_meshio()
        from meshio.xdmf import main

        class Reader(main.XdmfReader):
            def _read_data_item(self, item: ET.Element, root: ET.Element | None = None) -> Any:
                return _checked(self.filename, item, partial(super()._read_data_item, item, root))

        fields, topology = self._fields(k), self._part(k, "Topology")
        asked = [field for field in fields if field.get("Name") == self.displacement]
        root = ET.Element("Xdmf")
        grid = ET.SubElement(ET.SubElement(root, "Domain"), "Grid")
        for part in copy.deepcopy([self._part(k, "Geometry"), topology, *asked]):
            default = {"Geometry": ("GeometryType", "XYZ"), "Attribute": ("Center", "Node")}.get(part.tag)
            if default and "Type" not in part.attrib:
                part.attrib.setdefault(*default)
            grid.append(part)
        with quiet_meshio():
            mesh = Reader(self.path).read_xdmf3(root)
        stated, count = topology.get("NumberOfElements"), sum(len(block.data) for block in mesh.cells)
        if stated is not None and math.prod(map(int, stated.split())) != count:
            raise InputError(f"holds {count} cells, and says that it has {stated}; {CUT}")
        return grid_of_meshio(mesh)._replace(
            fields={name: mesh.point_data.get(name) for name in (field.get("Name", "") for field in fields)}
        )

    def _fields(self, k: int) -> list[ET.Element]:
        """The fields at the points."""
        fields = [field for field in self.frames[k].findall("Attribute") if field.get("Center", "Node") == "Node"]
        if len({field.get("Name") for field in fields}) != len(fields):
            raise InputError(f"frame {k} has two fields of one name; {CUT}")
        return fields

    def _part(self, k: int, tag: str) -> ET.Element:
        elements = self.frames[k].findall(tag) or self._base.findall(tag)
        if len(elements) != 1:
            raise InputError(f"frame {k} has {len(elements)} {tag}; expected one")
        return elements[0]


def _checked(path: Path, item: ET.Element, read: Callable[[], Any]) -> Any:
    """What meshio reads of an item, which must be numbers in the XML or in HDF5, of the stated shape."""
    form, shape = item.get("Format"), tuple(map(int, item.attrib["Dimensions"].split()))
    is_float = item.get("DataType", item.get("NumberType", "Float")) == "Float"
    if item.get("ItemType", "Uniform") != "Uniform" or "Reference" in item.attrib or form not in ("XML", "HDF"):
        raise InputError(f"has data of the format {form!r}, or that refer to others; expected XML or HDF")
    if form == "HDF":
        check_file(path.parent / (item.text or "").strip().rpartition(":")[0])
    elif is_float:
        item.set("Precision", "8")  # decimals in full
    values = read()
    if values.shape != shape or values.dtype.kind not in ("f" if is_float else "iu"):
        expected = f"{'numbers' if is_float else 'integers'} of shape {shape}"
        raise InputError(f"its data are {values.dtype} of shape {values.shape}; expected {expected}: {CUT}")
    return values
