"""Caches that hold the positions of all frames in one file: NumPy archives, and series of XDMF through meshio."""

import xml.etree.ElementTree as ET
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.mesh import Mesh, check_part, read_mesh
from ccd_warp._files.through_meshio import displaced, import_meshio, reading, triangles
from ccd_warp._input.messages import InputError

_EXPECTED = "expected 'positions', numbers of shape (frames, n, 3), and 'faces', integers of shape (m, 3)"


@dataclass
class NpzSeries:
    """The frames of a NumPy archive: ``positions`` of shape [T, n, 3] and ``faces`` of shape [m, 3]."""

    name: str
    files: list[Path]
    positions: np.ndarray
    faces: np.ndarray

    @classmethod
    def open(cls, path: Path, max_bytes: int, faces_path: Path | None) -> "NpzSeries":
        """Read an archive.

        Args:
            path: The archive.
            max_bytes: Limit on its unpacked size, where it is compressed.
            faces_path: Mesh file whose faces it takes if it holds none.

        Raises:
            InputError: If the archive is damaged, too large, or lacks an array.
        """
        arrays = npz_arrays(path, max_bytes)
        if "positions" not in arrays:
            raise InputError(f"{path}: holds {', '.join(map(repr, arrays)) or 'nothing'}; {_EXPECTED}")
        positions, files = arrays["positions"], [path]
        if positions.ndim != 3 or positions.shape[2] != 3 or positions.dtype.kind not in "fiu":
            raise InputError(f"{path}: 'positions' is {positions.dtype} of shape {positions.shape}; {_EXPECTED}")
        if "faces" in arrays:
            faces = arrays["faces"]
        elif faces_path is not None:
            faces = read_mesh(faces_path, max_bytes).faces
            files.append(faces_path)
        else:
            raise InputError(f"{path}: holds no 'faces'; add them, or give a mesh that has them with --faces FILE")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or not len(faces):
            raise InputError(f"{path}: 'faces' is {faces.dtype} of shape {faces.shape}; {_EXPECTED}")
        return cls(path.name, files, positions, faces.astype(np.int64))

    @property
    def labels(self) -> list[str]:
        """Number of each frame."""
        return [f"{self.name}[{k}]" for k in range(len(self.positions))]

    @property
    def times(self) -> list[float] | None:
        """None: the archive holds no times."""
        return None

    def read(self, k: int) -> Mesh:
        """Frame ``k``."""
        return _mesh(self.files[0], self.labels[k], self.positions[k].astype(np.float64), self.faces)


def npz_arrays(path: Path, max_bytes: int) -> dict[str, np.ndarray]:
    """All arrays of a NumPy archive that unpacks to at most ``max_bytes``, or to no more than it takes on the disk."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        # What is stored uncompressed takes no more memory than it takes on the disk.
        if unpacked > max(max_bytes, path.stat().st_size):
            raise InputError(
                f"{path}: unpacks to {unpacked:,} bytes, and the limit is {max_bytes:,}; raise it with --max-bytes"
            )
        with np.load(path, allow_pickle=False) as data:
            return dict(data)
    except InputError:
        raise
    except Exception as error:  # zipfile, zlib and NumPy each raise their own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as a NumPy archive ({reason}); write it again") from error


@dataclass
class XdmfSeries:
    """The frames of a temporal collection of XDMF; each has a geometry of its own, or displacements of the first."""

    name: str
    files: list[Path]
    reader: Any
    points: np.ndarray
    faces: np.ndarray
    displacement: str | None
    surface: bool

    @classmethod
    def open(cls, path: Path, displacement: str | None, surface: bool) -> "XdmfSeries":
        """Read the mesh of a series.

        Raises:
            InputError: If the file is damaged, nothing in it moves, or meshio is not installed.
        """
        meshio = import_meshio(path)
        with reading(path):
            reader = meshio.xdmf.TimeSeriesReader(str(path))
            points, cells = reader.read_points_cells()
            faces = triangles(path, [(block.type, block.data) for block in cells], len(points), surface)
            has_geometry = [_has_geometry(grid) for grid in reader.collection]
            if not all(has_geometry[1:]) and displacement is None:
                _, fields, _ = reader.read_data(reader.num_steps - 1)
                names = [repr(name) for name, field in fields.items() if np.shape(field) == np.shape(points)]
                raise InputError(
                    f"{path}: all its frames have the same geometry; expected --displacement NAME with the field that "
                    f"moves it, and found {', '.join(names) or 'no field of vectors at the points'}"
                )
        return cls(path.name, [path, *_data_files(path)], reader, points, faces, displacement, surface)

    @property
    def labels(self) -> list[str]:
        """Number of each frame."""
        return [f"{self.name}[{k}]" for k in range(self.reader.num_steps)]

    @property
    def times(self) -> list[float] | None:
        """Time of each frame, if the file says it."""
        found = [grid.find("Time") for grid in self.reader.collection]
        try:
            return [float(time.attrib["Value"]) for time in found]
        except (AttributeError, KeyError, ValueError):
            return None

    def read(self, k: int) -> Mesh:
        """Frame ``k``."""
        path, points, faces = self.files[0], self.points, self.faces
        with reading(path):
            if _has_geometry(self.reader.collection[k]):
                # The reader takes points and cells from this grid.
                self.reader.mesh_grid = self.reader.collection[k]
                points, cells = self.reader.read_points_cells()
                if cells:
                    blocks = [(block.type, block.data) for block in cells]
                    faces = triangles(path, blocks, len(points), self.surface)
            fields = self.reader.read_data(k)[1] if self.displacement is not None else {}
            vertices = displaced(path, points, fields, self.displacement)
        return _mesh(path, self.labels[k], vertices, faces, self.surface)


def is_xdmf_series(path: Path) -> bool:
    """Whether an XDMF file holds a collection of frames, and not one mesh."""
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, OSError) as error:
        raise InputError(f"{path}: its XML cannot be read ({error}); write it again") from error
    return any(grid.get("CollectionType") == "Temporal" for grid in root.iter("Grid"))


def _data_files(path: Path) -> list[Path]:
    """The HDF5 files to which an XDMF file refers."""
    items = [item.text or "" for item in ET.parse(path).getroot().iter("DataItem") if item.get("Format") == "HDF"]
    return [path.parent / name for name in sorted({text.strip().partition(":")[0] for text in items})]


def _has_geometry(grid: Any) -> bool:
    return any(child.tag == "Geometry" for child in grid)


def _mesh(path: Path, label: str, vertices: np.ndarray, faces: np.ndarray, is_surface: bool = False) -> Mesh:
    try:
        check_part(vertices, faces)
    except InputError as error:
        raise InputError(f"{label}: {error}") from error
    return Mesh(path.with_name(label), vertices, faces, "indexed", is_surface=is_surface)
