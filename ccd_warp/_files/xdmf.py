"""Read XDMF files, a grid or a temporal collection, with arrays in the XML or in HDF5 of exactly the stated shape."""

import math
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ccd_warp._files.cells import Grid, load_meshio, mesh_of_grid, reading
from ccd_warp._files.content import Mesh
from ccd_warp._files.opened import check_file, read_file
from ccd_warp._files.text import CUT, all_numbers
from ccd_warp._scene.input.messages import InputError


class Xdmf:
    """The frames of a temporal collection, or the one grid of a file; each has points of its own, or displacements."""

    def __init__(self, path: Path, *, displacement: str | None = None, surface: bool = False) -> None:
        """Refuse a file of other grids, and a collection in which nothing moves."""
        self.path, self.name, self.displacement, self.surface = path, path.name, displacement, surface
        with reading(path):
            grids = ET.fromstring(read_file(path)).findall("Domain/Grid")
            collections = [grid for grid in grids if grid.get("GridType") == "Collection"]
            beside = [grid for grid in grids if grid not in collections]
            self.is_series = bool(collections)
            self.frames = collections[0].findall("Grid") if collections else grids
            if (
                not self.frames
                or max(len(collections), len(beside)) > 1
                or any(grid.get("CollectionType") != "Temporal" for grid in collections)
                or any(grid.get("GridType", "Uniform") != "Uniform" for grid in (*self.frames, *beside))
            ):
                raise InputError("holds other grids than one, or one temporal collection and one beside it")
            self._base = beside[0] if beside else self.frames[0]  # has the points and cells that a frame lacks
            if displacement is None and any(frame.find("Geometry") is None for frame in self.frames[1:]):
                names = ", ".join(map(repr, self._fields(0))) or "no field at the points"
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
        load_meshio()
        from meshio.xdmf.common import translate_mixed_cells, xdmf_to_meshio_type

        geometry, topology = self._part(k, "Geometry"), self._part(k, "Topology")
        layout, kind = (part.get("Type") or part.get(f"{part.tag}Type") or "XYZ" for part in (geometry, topology))
        points, corners = _array(self.path, geometry, "f"), _array(self.path, topology, "iu")
        if layout != "XYZ":
            raise InputError(f"has a geometry of the type {layout!r}; expected XYZ")
        if kind == "Mixed":
            blocks = [(block.type, block.data) for block in translate_mixed_cells(corners)]
        else:
            blocks = [(xdmf_to_meshio_type[kind], corners)]
        stated, count = topology.get("NumberOfElements"), sum(len(cells) for _, cells in blocks)
        if stated is not None and math.prod(map(int, stated.split())) != count:
            raise InputError(f"holds {count} cells, and says that it has {stated}; {CUT}")
        return Grid(points, blocks, {name: partial(_array, self.path, x, "fiu") for name, x in self._fields(k).items()})

    def _fields(self, k: int) -> dict[str, ET.Element]:
        """The fields at the points."""
        attributes = [field for field in self.frames[k].findall("Attribute") if field.get("Center", "Node") == "Node"]
        fields = {field.get("Name", ""): field for field in attributes}
        if len(fields) != len(attributes):
            raise InputError(f"frame {k} has two fields of one name; {CUT}")
        return fields

    def _part(self, k: int, tag: str) -> ET.Element:
        elements = self.frames[k].findall(tag) or self._base.findall(tag)
        if len(elements) != 1:
            raise InputError(f"frame {k} has {len(elements)} {tag}; expected one")
        return elements[0]


def _array(path: Path, parent: ET.Element, kinds: str) -> np.ndarray:
    """The array of a part of a grid, of numbers of one of these kinds: from the XML, or from a file of HDF5."""
    items = parent.findall("DataItem")
    if len(items) != 1 or items[0].get("ItemType", "Uniform") != "Uniform":
        raise InputError(f"a {parent.tag} has {len(items)} DataItem; expected one, of the type Uniform: {CUT}")
    text, shape = (items[0].text or "").strip(), tuple(map(int, items[0].attrib["Dimensions"].split()))
    match items[0].get("Format"):
        case "XML":
            values = all_numbers(text.encode(), float if "f" in kinds else int)
            values = values.reshape(shape) if len(values) == math.prod(shape) else values
        case "HDF":
            values = _of_hdf5(path, text)
        case other:
            raise InputError(f"the data of a {parent.tag} have the format {other!r}; expected XML or HDF")
    if values.shape != shape or values.dtype.kind not in kinds:
        expected = f"{'numbers' if 'f' in kinds else 'integers'} of shape {shape}"
        raise InputError(
            f"the data of a {parent.tag} are {values.dtype} of shape {values.shape}; expected {expected}: {CUT}"
        )
    return values


def _of_hdf5(path: Path, place: str) -> np.ndarray:
    """A dataset of a file beside that of the XML."""
    import h5py

    name, _, key = place.rpartition(":")
    check_file(path.parent / name)
    with h5py.File(path.parent / name, "r") as file:
        if not isinstance(dataset := file.get(key), h5py.Dataset):
            raise InputError(f"in {place} is no dataset; {CUT}")
        return np.asarray(dataset[()])
