"""Caches that hold the positions of all frames in one file: NumPy archives, and series of XDMF."""

import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ccd_warp._files.archive import plain_members
from ccd_warp._files.cells import displaced, reading, triangles
from ccd_warp._files.mesh import Mesh, check_part, read_mesh
from ccd_warp._files.opened import PLAIN_BYTES, check_size, note
from ccd_warp._files.parts import Split, groups_of_field, parts_of
from ccd_warp._files.xdmf import Xdmf
from ccd_warp._input.messages import InputError, reason_of

_EXPECTED = "expected 'positions', numbers of shape (frames, n, 3), and 'faces', integers of shape (m, 3)"


@dataclass
class NpzSeries:
    """The frames of a NumPy archive: ``positions`` of shape [T, n, 3] and ``faces`` of shape [m, 3]."""

    name: str
    files: list[Path]
    positions: np.ndarray
    faces: np.ndarray
    field: tuple[str, np.ndarray] | None = None

    @classmethod
    def open(cls, path: Path, max_bytes: int, faces_path: Path | None, split: Split = False) -> "NpzSeries":
        """Read an archive.

        Args:
            path: The archive.
            max_bytes: Limit on its unpacked size, where it is compressed.
            faces_path: Mesh file whose faces it takes if it holds none.
            split: Name of the array with a number or a text for each face that tells the parts.

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
        if isinstance(split, str) and split not in arrays:
            raise InputError(f"{path}: holds no array {split!r}; expected one with a number or a text for each face")
        field = (split, arrays[split]) if isinstance(split, str) else None
        return cls(path.name, files, positions, faces.astype(np.int64), field)

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
        mesh = _mesh(self.files[0], self.labels[k], self.positions[k].astype(np.float64), self.faces)
        if self.field is None or k > 0:
            return mesh
        with reading(self.files[0]):
            return replace(mesh, parts=groups_of_field(*self.field, [self.faces], len(mesh.vertices)))


def npz_arrays(path: Path, max_bytes: int) -> dict[str, np.ndarray]:
    """All arrays of a NumPy archive that unpacks to at most ``max_bytes``, or to no more than it takes on the disk."""
    size = note(path)
    check_size(f"{path}: it", size, max(max_bytes, PLAIN_BYTES))
    try:
        with zipfile.ZipFile(path) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in plain_members(archive)}
            if len(members) != len(archive.infolist()):
                raise InputError("holds two arrays of one name")
            unpacked = sum(member.file_size for member in members.values())
            if unpacked > max(max_bytes, size):
                limit = f"the limit is {max_bytes:,}; raise it with --max-bytes"
                raise InputError(f"unpacks to {unpacked:,} bytes, and {limit}")
            return {name: _npy(archive, member) for name, member in members.items()}
    except InputError as error:
        raise InputError(f"{path}: {reason_of(error)}") from error
    except Exception as error:  # zipfile, zlib and NumPy each raise their own
        raise InputError(f"{path}: cannot be read as a NumPy archive ({reason_of(error)}); write it again") from error


def _npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """An array, whose data must be as long as its header says: NumPy would take memory for what this claims."""
    with archive.open(member) as stream:
        is_short = np.lib.format.read_magic(stream) == (1, 0)
        read_header = np.lib.format.read_array_header_1_0 if is_short else np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read_header(stream)
        if dtype.hasobject or min(shape, default=0) < 0:
            raise ValueError(f"{member.filename} holds {dtype} of shape {shape}")
        size = math.prod(shape) * dtype.itemsize
        data = stream.read(min(size, member.file_size) + 1)  # with a length, or it would unpack all that there is
    if len(data) != size:
        raise ValueError(f"{member.filename} holds {len(data)} bytes, not {dtype} of shape {shape}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")


@dataclass
class XdmfSeries:
    """The frames of a temporal collection of XDMF; each has a geometry of its own, or displacements of the first."""

    name: str
    files: list[Path]
    xdmf: Xdmf
    displacement: str | None
    surface: bool
    split: Split = False

    @classmethod
    def open(cls, xdmf: Xdmf, displacement: str | None, surface: bool, split: Split = False) -> "XdmfSeries":
        """The series of a file.

        Raises:
            InputError: If the file is damaged, or nothing in it moves.
        """
        path = xdmf.path
        if displacement is None and not all(xdmf.has_points(k) for k in range(1, len(xdmf.frames))):
            with reading(path):
                grid = xdmf.grid(len(xdmf.frames) - 1)
                names = [repr(name) for name, read in grid.fields.items() if read().shape == grid.points.shape]
            raise InputError(
                f"{path}: all its frames have the same geometry; expected --displacement NAME with the field that "
                f"moves it, and found {', '.join(names) or 'no field of vectors at the points'}"
            )
        return cls(path.name, [path], xdmf, displacement, surface, split)

    @property
    def labels(self) -> list[str]:
        """Number of each frame."""
        return [f"{self.name}[{k}]" for k in range(len(self.xdmf.frames))]

    @property
    def times(self) -> list[float] | None:
        """Time of each frame, if the file says it."""
        try:
            found = [float(time.attrib["Value"]) for grid in self.xdmf.frames for time in grid.findall("Time")]
            return found if len(found) == len(self.xdmf.frames) else None
        except (KeyError, ValueError):
            return None

    def read(self, k: int) -> Mesh:
        """Frame ``k``."""
        path = self.files[0]
        with reading(path):
            grid = self.xdmf.grid(k)
            vertices, (faces, midsides) = displaced(path, grid, self.displacement), triangles(path, grid, self.surface)
            mesh = _mesh(path, self.labels[k], vertices, faces)
            parts = parts_of(path, grid, self.split, needs_field=True) if k == 0 else None
        return replace(mesh, is_surface=self.surface, midsides=midsides, parts=parts)


def open_xdmf(path: Path, max_bytes: int) -> Xdmf:
    """The grids of an XDMF file."""
    with reading(path):
        return Xdmf(path, max_bytes)


def _mesh(path: Path, label: str, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    try:
        check_part(vertices, faces)
    except InputError as error:
        raise InputError(f"{label}: {error}") from error
    return Mesh(path.with_name(label), vertices, faces, "indexed")
