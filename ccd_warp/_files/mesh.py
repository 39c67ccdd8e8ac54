"""Read one mesh file of any format as arrays in full precision, completely or not at all."""

import io
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from ccd_warp._files.cells import mesh_of_grid, reading
from ccd_warp._files.content import Mesh, check_part
from ccd_warp._files.counts import stated_triangles
from ccd_warp._files.obj import read_obj
from ccd_warp._files.off import read_off
from ccd_warp._files.opened import read_file
from ccd_warp._files.ply import read_ply
from ccd_warp._files.stl import read_stl
from ccd_warp._files.vtk import read_vtk
from ccd_warp._files.vtu import read_vtu
from ccd_warp._files.xdmf import Xdmf
from ccd_warp._scene.input.messages import InputError, printable, reason_of
from ccd_warp._scene.input.trimesh_bodies import transformed

_WITH_COPIES = (".stl", ".glb", ".gltf", ".dae")
# trimesh would read these formats leniently: it pads, skips and truncates inconsistent data.
_READERS: dict[str, Callable[[bytes], tuple[Any, ...]]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    ".stl": read_stl,
}
_OF_TRIMESH = (".glb", ".gltf", ".3mf", ".dae")
_ADVICE = "save it as PLY, OBJ, STL, OFF or GLB"
MESH_SUFFIXES = (*_READERS, *_OF_TRIMESH)
# Endings of files of cells, which may hold fields, too.
XDMF_SUFFIXES = (".xdmf", ".xmf")
CELL_SUFFIXES = (".vtu", ".vtk", *XDMF_SUFFIXES)


class Part(NamedTuple):
    """A part of a scene: its positions and triangles, the names in it, and the index of the name of each triangle."""

    vertices: np.ndarray
    faces: np.ndarray
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None  # None where there is one name


def read_mesh(path: Path, *, displacement: str | None = None, surface: bool = False) -> Mesh:
    """Read a mesh file, with every part of its scene in place, nothing merged or rounded.

    Args:
        path: The file.
        displacement: Field that is added to the positions of VTK and XDMF files.
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
            grid = read_vtk(path) if suffix == ".vtk" else read_vtu(read_file(path))
            return mesh_of_grid(path, grid, displacement, surface)
    parts = _read_parts(path, suffix)
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.vstack([part.vertices for part in parts])
    faces = np.vstack([part.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    return Mesh(path, vertices, faces, suffix in _WITH_COPIES, *_joined_names(parts))


def _joined_names(parts: list[Part]) -> tuple[Sequence[str], np.ndarray | None]:
    """The names of all parts, and the index of the name of each face; parts of one name are one."""
    numbers: dict[str, int] = {}
    face_names = []
    for part in parts:
        of_part = np.array([numbers.setdefault(name, len(numbers)) for name in part.names], dtype=np.int64)
        local = np.zeros(len(part.faces), dtype=np.int64) if part.face_name is None else part.face_name
        face_names.append(of_part[local])
    return list(numbers), np.concatenate(face_names) if len(numbers) > 1 else None


def _read_parts(path: Path, suffix: str) -> list[Part]:
    """Vertices and triangles of every part of a file, checked."""
    data = read_file(path)
    try:
        if suffix in _READERS:
            parts = [Part(*_READERS[suffix](data.removeprefix(b"\xef\xbb\xbf")))]
        elif suffix in _OF_TRIMESH:
            parts = _read_with_trimesh(path, suffix, data)
        else:
            raise InputError(f"files that end in {suffix or 'nothing'!r} are not read; {_ADVICE}")
        filled = [part for part in parts if len(part.faces)]
        for part in filled or parts[:1]:
            check_part(part.vertices, part.faces)
        return filled
    except InputError as error:
        raise InputError(f"{path}: {reason_of(error)}") from error
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise InputError(
            f"{path}: trimesh cannot read it as a mesh ({printable(reason_of(error))}); {_ADVICE}"
        ) from error


def _read_with_trimesh(path: Path, suffix: str, data: bytes) -> list[Part]:
    """Every mesh of a scene, with the scene's transformation applied, called by its node."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        """Reads the files beside a file, as they are called, from where they are said to be."""

        def get(self, name: str) -> bytes:
            return read_file(path.parent / unquote(name))

    stated = stated_triangles(suffix, data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # `process` would merge and drop vertices; the other two keep textures from causing the same.
        keep: dict[str, Any] = {"process": False, "maintain_order": True, "skip_materials": True}
        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=Beside(str(path)), **keep)
    parts = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64).reshape(-1, 3)
        if mesh.metadata.get("from_gltf_primitive"):
            # trimesh makes a node for each material of a mesh, below the node of the mesh.
            node = scene.graph.transforms.parents.get(node, node)
        parts.append(Part(transformed(mesh.vertices, matrix), faces, [str(node)]))
    if not 0 < stated <= (num_read := sum(len(part.faces) for part in parts)):
        raise InputError(f"says that it has {stated} triangles, and {num_read} of its scene can be read; {_ADVICE}")
    return parts
