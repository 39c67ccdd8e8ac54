"""Read one mesh file of any format as arrays in full precision, completely or not at all."""

import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple
from urllib.parse import unquote

import numpy as np

from ccd_warp._files.archive import MAX_BYTES, unpack
from ccd_warp._files.cells import Grid, displaced, reading, triangles
from ccd_warp._files.counts import stated_triangles
from ccd_warp._files.obj import read_obj
from ccd_warp._files.off import read_off
from ccd_warp._files.opened import read_file
from ccd_warp._files.parts import Parts, Split, parts_of
from ccd_warp._files.ply import read_ply
from ccd_warp._files.stl import read_stl
from ccd_warp._files.vtk import read_vtk
from ccd_warp._files.vtu import read_vtu
from ccd_warp._files.xdmf import Xdmf
from ccd_warp._scene.input.messages import InputError, printable, reason_of
from ccd_warp._scene.input.trimesh_bodies import transformed

# How a format stores a vertex that several faces share.
#   indexed: once; the file's own vertices are taken as they are.
#   split:   once per normal, texture coordinate or material (glTF), so one vertex may appear several times.
#   soup:    once per face corner (STL).
Sharing = Literal["indexed", "split", "soup"]
_SHARING: dict[str, Sharing] = {
    **{".stl": "soup", ".stl_ascii": "soup"},
    **{".glb": "split", ".gltf": "split", ".dae": "split"},
}
_BY_SHARING: tuple[Sharing, ...] = ("indexed", "split", "soup")

# trimesh would read these formats leniently: it pads, skips and truncates inconsistent data.
_READERS: dict[str, Callable[[bytes], tuple[Any, ...]]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    ".stl": read_stl,
    ".stl_ascii": read_stl,
}
_OF_TRIMESH = (".glb", ".gltf", ".3mf", ".dae")
# Endings of files that accompany meshes in an archive; any other file might be a mesh that would be missed.
_BESIDE = frozenset(
    [
        *("", ".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif", ".webp", ".ktx2"),
        *(".txt", ".md", ".rst", ".html", ".pdf", ".csv", ".json", ".yaml", ".yml"),
    ]
)
_ADVICE = "save it as PLY, OBJ, STL, OFF or GLB"
MESH_SUFFIXES = (*_READERS, *_OF_TRIMESH, ".zip")
# Endings of files of cells, which may hold fields, too.
XDMF_SUFFIXES = (".xdmf", ".xmf")
CELL_SUFFIXES = (".vtu", ".vtk", *XDMF_SUFFIXES)


class Reading(NamedTuple):
    """How files are read.

    Attributes:
        max_bytes: Limit on the unpacked size of an archive; a plain file may have as much, or 1 GiB.
        displacement: Field that is added to the positions of VTK and XDMF files.
        surface: Whether volume cells of these stand for their boundary surface.
        split: How their cells are to be split, see :mod:`ccd_warp._files.parts`; other files are split by their faces.
        needs_field: Whether a file must have the field by which it is split.
    """

    max_bytes: int = MAX_BYTES
    displacement: str | None = None
    surface: bool = False
    split: Split = False
    needs_field: bool = True


class Part(NamedTuple):
    """A part of a scene: its positions and triangles, the names in it, and the index of the name of each triangle."""

    vertices: np.ndarray
    faces: np.ndarray
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None  # None where there is one name


@dataclass(frozen=True)
class Mesh:
    """The content of one file: vertices in double precision, nothing merged or reordered.

    Attributes:
        path: The file.
        vertices: Positions, float64, shape [n, 3].
        faces: Vertex indices, shape [m, 3].
        sharing: How it stores a vertex that several faces share.
        names: Names of its objects, groups and nodes; "" stands for what has none.
        face_name: Index of the name of each face, shape [m]; None where there is one name.
        is_surface: Whether it is the surface of volumes, so that the other vertices are inside them.
        midsides: Ends of the edges of quadratic cells and the node in the middle of each, shape [k, 3].
        parts: The parts of its cells, where it is to be split by these.
    """

    path: Path
    vertices: np.ndarray
    faces: np.ndarray
    sharing: Sharing
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None
    is_surface: bool = False
    midsides: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    parts: Parts | None = None


def read_mesh(path: Path, how: Reading) -> Mesh:
    """Read a mesh file or an archive of such, with every part of its scene in place, nothing merged or rounded.

    Raises:
        InputError: If the file is missing, damaged, not finite or of an unsupported format, or an archive that exceeds
            the limit.
    """
    suffix = path.suffix.lower()
    if suffix in CELL_SUFFIXES:
        with reading(path):
            return mesh_of_grid(path, _read_cells(path, suffix, how), how)
    if isinstance(how.split, str) and how.needs_field:
        raise InputError(
            f"{path}: holds no fields of cells, and is to be split by {how.split!r}; expected a VTU, VTK, XDMF or NPZ "
            "file, or --split (split=True) for connected components"
        )
    max_bytes = how.max_bytes
    data = read_file(path, max_bytes)
    if suffix == ".zip":
        parts, sharing = _read_archive(path, data, max_bytes)
    else:
        parts = _read_parts(str(path), path.name, data, _resolver(path, max_bytes), max_bytes)
        sharing = _SHARING.get(suffix, "indexed")
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.vstack([part.vertices for part in parts])
    faces = np.vstack([part.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    return Mesh(path, vertices, faces, sharing, *_joined_names(parts))


def mesh_of_grid(path: Path, grid: Grid, how: Reading) -> Mesh:
    """The surface of the cells of a file; messages call it ``path``."""
    vertices, (faces, midsides) = displaced(grid, how.displacement), triangles(grid, how.surface)
    check_part(vertices, faces)
    parts = parts_of(grid, how.split, needs_field=how.needs_field)
    return Mesh(path, vertices, faces, "indexed", is_surface=how.surface, midsides=midsides, parts=parts)


def _read_cells(path: Path, suffix: str, how: Reading) -> Grid:
    if suffix == ".vtk":
        return read_vtk(path, how.max_bytes)
    if suffix == ".vtu":
        return read_vtu(read_file(path, how.max_bytes), how.max_bytes)
    xdmf = Xdmf(path, how.max_bytes)
    if xdmf.is_series:
        raise InputError("holds a series of frames; expected one mesh")
    return xdmf.grid(0, (how.displacement, how.split))


def _joined_names(parts: list[Part]) -> tuple[Sequence[str], np.ndarray | None]:
    """The names of all parts, and the index of the name of each face; parts of one name are one."""
    numbers: dict[str, int] = {}
    face_names = []
    for part in parts:
        of_part = np.array([numbers.setdefault(name, len(numbers)) for name in part.names], dtype=np.int64)
        local = np.zeros(len(part.faces), dtype=np.int64) if part.face_name is None else part.face_name
        face_names.append(of_part[local])
    return list(numbers), np.concatenate(face_names) if len(numbers) > 1 else None


def _read_archive(path: Path, data: bytes, max_bytes: int) -> tuple[list[Part], Sharing]:
    from trimesh.resolvers import ZipResolver

    with reading(path):
        files = unpack(data, max_bytes)
    resolver = ZipResolver({name: io.BytesIO(content) for name, content in files})
    parts: list[Part] = []
    sharing: Sharing = "indexed"
    for name, content in files:
        place = PurePosixPath(name)
        suffix = place.suffix.lower()
        # macOS packs a hidden file with each file, under the same name in a separate folder.
        if place.name.startswith(".") or "__MACOSX" in place.parts or suffix in _BESIDE:
            continue
        read = _read_parts(f"{path}, {name}", place.name, content, resolver, max_bytes)
        parts += [part._replace(names=[f"{name}/{each}".rstrip("/") for each in part.names]) for part in read]
        sharing = max(sharing, _SHARING.get(suffix, "indexed"), key=_BY_SHARING.index)
    if not parts:
        raise InputError(f"{path}: holds no mesh file; {_ADVICE}")
    return parts, sharing


def _resolver(path: Path, max_bytes: int) -> Any:
    """A resolver that reads the files beside a file, as they are called, from where they are said to be."""
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        def get(self, name: str) -> bytes:
            return read_file(path.parent / unquote(name), max_bytes)

    return Beside(str(path))


def _read_parts(label: str, name: str, data: bytes, resolver: Any, max_bytes: int) -> list[Part]:
    """Vertices and triangles of every part of a file, checked; messages call the file ``label``."""
    suffix = PurePosixPath(name).suffix.lower()
    try:
        if suffix in _READERS:
            parts = [Part(*_READERS[suffix](data.removeprefix(b"\xef\xbb\xbf")))]
        elif suffix in _OF_TRIMESH:
            parts = _read_with_trimesh(suffix, data, resolver, max_bytes)
        else:
            raise InputError(f"files that end in {suffix or 'nothing'!r} are not read; {_ADVICE}")
        filled = [part for part in parts if len(part.faces)]
        for part in filled or parts[:1]:
            check_part(part.vertices, part.faces)
        return filled
    except InputError as error:
        raise InputError(f"{label}: {reason_of(error)}") from error
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise InputError(
            f"{label}: trimesh cannot read it as a mesh ({printable(reason_of(error))}); {_ADVICE}"
        ) from error


def check_part(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse no faces, faces of vertices that do not exist, and positions of vertices of faces that are not finite."""
    if not len(faces):
        raise InputError("holds no triangles; give a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        k = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise InputError(f"face {k} is {faces[k].tolist()}, but the file has {len(vertices)} vertices; repair the file")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    bad = bad[np.isin(bad, faces)]
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"vertex {k} is {vertices[k].tolist()} ({bad.size} of {len(vertices)} vertices are not finite); "
            "every coordinate of a face must be finite"
        )


def _read_with_trimesh(suffix: str, data: bytes, resolver: Any, max_bytes: int) -> list[Part]:
    """Every mesh of a scene, with the scene's transformation applied, called by its node."""
    import trimesh

    stated = stated_triangles(suffix, data, max_bytes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # `process` would merge and drop vertices; the other two keep textures from causing the same.
        keep: dict[str, Any] = {"process": False, "maintain_order": True, "skip_materials": True}
        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=resolver, **keep)
    parts = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64).reshape(-1, 3)
        if mesh.metadata.get("from_gltf_primitive"):
            # trimesh makes a node for each material of a mesh, below the node of the mesh.
            node = scene.graph.transforms.parents.get(node, node)
        parts.append(Part(transformed(mesh.vertices, matrix), faces, [str(node)]))
    if (found := sum(len(part.faces) for part in parts)) != stated or not found:
        raise InputError(f"says that its scene has {stated} triangles, and {found} of them can be read; {_ADVICE}")
    return parts
