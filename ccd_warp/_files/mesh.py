"""Read one mesh file of any format as arrays in full precision, completely or not at all."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ccd_warp._files.by_meshio import read_with_meshio
from ccd_warp._files.cells import mesh_of_grid, reading
from ccd_warp._files.content import FilePart, Mesh, check_part
from ccd_warp._files.dae import read_dae
from ccd_warp._files.gltf import read_gltf
from ccd_warp._files.obj import read_obj
from ccd_warp._files.off import read_off
from ccd_warp._files.opened import read_file
from ccd_warp._files.ply import read_ply
from ccd_warp._files.stl import read_stl
from ccd_warp._files.threemf import read_3mf
from ccd_warp._files.vtk import read_vtk
from ccd_warp._files.xdmf import Xdmf
from ccd_warp._scene.input.messages import InputError, printable, reason_of

_WITH_COPIES = (".stl", ".glb", ".gltf", ".dae")
# trimesh would read these formats leniently: it pads, skips and truncates inconsistent data.
_READERS: dict[str, Callable[[bytes], FilePart]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    ".stl": read_stl,
}
_SCENES: dict[str, Callable[[Path, bytes], list[FilePart]]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".3mf": lambda _, data: read_3mf(data),
    ".dae": lambda _, data: read_dae(data),
}
_ADVICE = "save it as PLY, OBJ, STL, OFF or GLB"
MESH_SUFFIXES = (*_READERS, *_SCENES)
# Endings of files of cells, which may hold fields, too.
XDMF_SUFFIXES = (".xdmf", ".xmf")
_VTK_SUFFIXES = (".vtu", ".vtp", ".pvtu", ".pvtp", ".vtk")
CELL_SUFFIXES = (*_VTK_SUFFIXES, ".msh", ".mesh", ".inp", *XDMF_SUFFIXES)


def read_mesh(path: Path, *, displacement: str | None = None, surface: bool = False) -> Mesh:
    """Read a mesh file, with every part of its scene in place, nothing merged or rounded.

    Args:
        path: The file.
        displacement: Field that is added to the positions of files of cells.
        surface: Whether volume cells of these stand for their boundary surface.

    Raises:
        InputError: If the file is missing, damaged, not finite or of an unsupported format.
    """
    suffix = path.suffix.lower()
    if suffix in XDMF_SUFFIXES:
        xdmf = Xdmf(path, displacement=displacement, surface=surface)
        if xdmf.is_series:
            raise InputError(f"{path}: holds a series of frames; expected one mesh")
        return xdmf.read(0)
    if suffix in CELL_SUFFIXES:
        with reading(path):
            grid = read_vtk(path, displacement) if suffix in _VTK_SUFFIXES else read_with_meshio(path)
            return mesh_of_grid(path, grid, displacement, surface)
    parts = _read_parts(path, suffix)
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.vstack([part.vertices for part in parts])
    faces, edges, points = (
        np.concatenate([getattr(part, kind) + offset for part, offset in zip(parts, offsets, strict=False)])
        for kind in ("faces", "edges", "points")
    )
    counts = None
    if any(part.counts is not None and (part.counts > 3).any() for part in parts):
        counts = np.concatenate([np.full(len(part.faces), 3) if part.counts is None else part.counts for part in parts])
    names, element_name = _joined_names(parts)
    return Mesh(
        path, vertices, faces, suffix in _WITH_COPIES, names, element_name, counts=counts, edges=edges, points=points
    )


def _joined_names(parts: list[FilePart]) -> tuple[Sequence[str], np.ndarray | None]:
    """The names of all parts, and the index of the name of each element; parts of one name are one."""
    numbers: dict[str, int] = {}
    by_kind: list[list[np.ndarray]] = [[], [], []]
    for part in parts:
        of_part = np.array([numbers.setdefault(name, len(numbers)) for name in part.names], dtype=np.int64)
        sizes = len(part.faces), len(part.edges), len(part.points)
        local = np.zeros(sum(sizes), dtype=np.int64) if part.element_name is None else part.element_name
        for of_kind, names in zip(by_kind, np.split(of_part[local], np.cumsum(sizes[:2])), strict=True):
            of_kind.append(names)
    return list(numbers), np.concatenate([*by_kind[0], *by_kind[1], *by_kind[2]]) if len(numbers) > 1 else None


def _read_parts(path: Path, suffix: str) -> list[FilePart]:
    """Vertices and triangles of every part of a file, checked."""
    data = read_file(path)
    try:
        if suffix in _READERS:
            parts = [_READERS[suffix](data.removeprefix(b"\xef\xbb\xbf"))]
        elif suffix in _SCENES:
            parts = _SCENES[suffix](path, data)
        else:
            raise InputError(f"files that end in {suffix or 'nothing'!r} are not read; {_ADVICE}")
        filled = [part for part in parts if len(part.elements)]
        if not filled:
            raise InputError("holds no triangles; give a triangle mesh")
        for part in filled:
            check_part(part.vertices, part.elements)
        return filled
    except InputError as error:
        raise InputError(f"{path}: {reason_of(error)}") from error
    except Exception as error:  # parsers of JSON, XML and archives raise anything
        reason = f"it lacks {error}" if isinstance(error, KeyError) else printable(reason_of(error))
        raise InputError(f"{path}: cannot be read as a mesh ({reason}); {_ADVICE}") from error
