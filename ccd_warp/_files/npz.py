"""Sequences of frames whose positions lie in one NumPy archive."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from ccd_warp._files.archive import unpack
from ccd_warp._files.cells import reading
from ccd_warp._files.mesh import Mesh, Reading, check_part, read_mesh
from ccd_warp._files.opened import read_file
from ccd_warp._files.parts import groups_of_field
from ccd_warp._scene.input.messages import InputError

_EXPECTED = "expected 'positions', numbers of shape (frames, n, 3), and 'faces', integers of shape (m, 3)"


class NpzSeries:
    """The frames of a NumPy archive: ``positions`` of shape [T, n, 3] and ``faces`` of shape [m, 3]."""

    def __init__(self, path: Path, how: Reading, faces_path: Path | None) -> None:
        """Read an archive; ``faces_path`` is a mesh file whose faces it takes if it holds none.

        Raises:
            InputError: If the archive is damaged, too large, or lacks an array, such as that by which it is split.
        """
        with reading(path):
            files = unpack(read_file(path, how.max_bytes), how.max_bytes)
            arrays = {name.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(data)) for name, data in files}
        if "positions" not in arrays:
            raise InputError(f"{path}: holds {', '.join(map(repr, arrays)) or 'nothing'}; {_EXPECTED}")
        if "faces" not in arrays and faces_path is None:
            raise InputError(f"{path}: holds no 'faces'; add them, or give a mesh that has them with --faces FILE")
        faces = arrays["faces"] if "faces" in arrays else read_mesh(faces_path or path, Reading(how.max_bytes)).faces
        positions, split = arrays["positions"], how.split
        for name, values, ndim, kinds in (("positions", positions, 3, "fiu"), ("faces", faces, 2, "iu")):
            if values.ndim != ndim or values.shape[-1] != 3 or values.dtype.kind not in kinds or not values.size:
                raise InputError(f"{path}: {name!r} is {values.dtype} of shape {values.shape}; {_EXPECTED}")
        if isinstance(split, str) and split not in arrays:
            raise InputError(f"{path}: holds no array {split!r}; expected one with a number or a text for each face")
        self.path, self.name, self.positions, self.faces = path, path.name, positions, faces.astype(np.int64)
        self.field = (split, arrays[split]) if isinstance(split, str) else None
        self.labels, self.times = [f"{self.name}[{k}]" for k in range(len(positions))], None

    def read(self, k: int) -> Mesh:
        """Frame ``k``."""
        mesh = Mesh(self.path, self.positions[k].astype(np.float64), self.faces, "indexed")
        label = self.path.with_name(self.labels[k])
        with reading(label):
            check_part(mesh.vertices, mesh.faces)
        if self.field is None or k > 0:
            return replace(mesh, path=label)
        with reading(self.path):
            parts = groups_of_field(*self.field, [self.faces], len(mesh.vertices))
        return replace(mesh, path=label, parts=parts)
