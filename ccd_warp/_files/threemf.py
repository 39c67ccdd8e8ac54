"""Read the triangles of 3MF files by trimesh, and as many as their build says: each object as often as it is used."""

import io
import warnings
import xml.etree.ElementTree as ET
import zipfile
from typing import IO

import numpy as np

from ccd_warp._files.content import FilePart
from ccd_warp._files.opened import not_installed
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.trimesh_bodies import transformed

_MOST_BYTES = 1 << 30  # unpacked; as XML it takes some ten times as much memory
_ROOT = "3d/3dmodel.model"
_Object = tuple[str, str]  # a model in the archive and an identifier in it


def read_3mf(data: bytes) -> list[FilePart]:
    """Every object where the build places it, called by its name.

    Raises:
        InputError: If the file is cut or too large, or trimesh reads other triangles than those of the build.
    """
    try:
        import lxml  # noqa: F401
        import networkx  # noqa: F401
        import trimesh
    except ImportError as error:
        raise not_installed(error.name) from error
    stated = _stated_triangles(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # `process` would merge and drop vertices.
        scene = trimesh.load_scene(io.BytesIO(data), file_type="3mf", process=False, maintain_order=True)
    parts = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64).reshape(-1, 3)
        parts.append(FilePart(transformed(mesh.vertices, matrix), faces, names=[str(node)]))
    if stated != (num_read := sum(len(part.faces) for part in parts)):
        raise InputError(f"says that it has {stated} triangles, and {num_read} of its build are read; {CUT}")
    return parts


def _stated_triangles(data: bytes) -> int:
    """The triangles of all items of the build, of whose objects some consist of others."""
    triangles: dict[_Object, int] = {}
    components: dict[_Object, list[_Object]] = {}
    items: list[_Object] = []
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
        if size > _MOST_BYTES:
            raise InputError(f"holds {size:,} bytes when unpacked; expected at most {_MOST_BYTES:,}: save it as PLY")
        for name in archive.namelist():
            if name.lower().endswith(".model"):
                with archive.open(name) as file:
                    _read_model(name.lower(), file, triangles, components, items)

    used: dict[_Object, int] = {}

    def of_object(key: _Object) -> int:
        if key not in used:
            used[key] = triangles[key] + sum(map(of_object, components[key]))
        return used[key]

    total = sum(map(of_object, items))
    if unused := [name for (model, name), count in triangles.items() if count and (model, name) not in used]:
        raise InputError(f"its object {unused[0]!r} is in no item of its build; export it as one")
    return total


def _read_model(
    model: str,
    file: IO[bytes],
    triangles: dict[_Object, int],
    components: dict[_Object, list[_Object]],
    items: list[_Object],
) -> None:
    """Add the objects of a model, and the items of the build where it is the first one."""
    count, used = 0, []
    for _, element in ET.iterparse(file):
        kind = element.tag.rpartition("}")[2]
        if kind in ("component", "item"):
            path = next((value for name, value in element.items() if name.endswith("}path")), model)
            used.append((path.lstrip("/").lower(), element.attrib["objectid"]))
        count += kind == "triangle"
        if kind == "object":
            triangles[model, element.attrib["id"]], components[model, element.attrib["id"]] = count, used
            count, used = 0, []
            element.clear()
        elif kind == "build" and model.endswith(_ROOT):
            items += used
