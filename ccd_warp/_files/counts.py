"""How many triangles a glTF, COLLADA or 3MF file says it holds: trimesh passes over what it does not know.

And what else would make trimesh read it in part without a word.
"""

import io
import json
import xml.etree.ElementTree as ET
import zipfile
from typing import Any

from ccd_warp._files.text import CUT, shown
from ccd_warp._scene.input.messages import InputError

_GLB_HEADER = 12  # bytes: magic, version, length
# Extensions that a file may require and that do not affect its triangles.
_HARMLESS = (
    *("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "KHR_lights_"),
    *("EXT_texture_", "EXT_lights_", "MSFT_texture_"),
)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives; others are points and lines


def stated_triangles(suffix: str, data: bytes) -> int:
    """The least number of triangles in the scene of a file: of its meshes, each as often as it stands there.

    Raises:
        InputError: If the file is cut, or holds what is not read.
    """
    match suffix:
        case ".3mf":
            return _of_3mf(data)
        case ".dae":
            return _of_collada(ET.fromstring(data))
    return _of_gltf(json.loads(_json_of_glb(data) if suffix == ".glb" else data))


def _json_of_glb(data: bytes) -> bytes:
    """The first chunk of a GLB file, whose length must be as stated."""
    if data[:4] != b"glTF" or len(data) < _GLB_HEADER:
        raise InputError(f"begins with {shown(data[:4])}; expected a GLB file, which begins with 'glTF'")
    length, size = (int.from_bytes(data[at : at + 4], "little") for at in (8, 12))
    if length != len(data):
        raise InputError(f"has {len(data)} bytes, but its header says {length}; {CUT}")
    return data[_GLB_HEADER + 8 : _GLB_HEADER + 8 + size]


def _of_gltf(tree: dict[str, Any]) -> int:
    required = [name for name in tree.get("extensionsRequired", ()) if not name.startswith(_HARMLESS)]
    if required:
        raise InputError(f"requires the extension {required[0]!r}, which is not read; export the file without it")
    accessors = tree.get("accessors", ())

    def of_primitive(primitive: dict[str, Any]) -> int:
        mode, position = primitive.get("mode", _TRIANGLES), primitive["attributes"].get("POSITION")
        corners = primitive.get("indices", position)
        if mode not in (_TRIANGLES, _STRIP, _FAN) or corners is None:
            return 0
        for index in (position, corners):
            if "sparse" in accessors[index] or "bufferView" not in accessors[index]:
                raise InputError("has a mesh that is compressed or sparse, which is not read; export it without that")
        if accessors[position].get("normalized"):
            raise InputError("has positions in normalized integers, which are not read; export floats")
        count = int(accessors[corners]["count"])
        return count // 3 if mode == _TRIANGLES else count - 2

    nodes = tree.get("nodes", ())  # each of which stands at one place of one scene
    if any("EXT_mesh_gpu_instancing" in node.get("extensions", ()) for node in nodes):
        raise InputError("has instances by EXT_mesh_gpu_instancing, which are not read; export a node for each")
    meshes = [tree["meshes"][node["mesh"]]["primitives"] for node in nodes if "mesh" in node]
    return sum(of_primitive(primitive) for mesh in meshes for primitive in mesh)


def _of_collada(root: ET.Element) -> int:
    geometries: dict[str, int] = {}
    for geometry in root.iterfind(".//{*}geometry"):
        for array in geometry.iterfind(".//{*}float_array"):  # of which three numbers less are a vertex less
            if len((array.text or "").split()) != int(array.attrib["count"]):
                raise InputError(f"the array {array.get('id')!r} does not hold {array.get('count')} values; {CUT}")
        geometries[geometry.get("id", "")] = sum(map(_of_primitives, geometry.iter()))
    if root.find(".//{*}instance_controller") is not None:
        raise InputError("has a mesh that a controller moves, which is not read; export it without")
    instances = root.iterfind(".//{*}instance_geometry")  # a node that is used again has more
    return sum(geometries[instance.get("url", "").removeprefix("#")] for instance in instances)


def _of_primitives(element: ET.Element) -> int:
    kind, count = element.tag.rpartition("}")[2], int(element.get("count", "0"))
    stride = 1 + max((int(part.get("offset", "0")) for part in element), default=0)
    match kind:
        case "triangles":
            return count
        case "polylist":
            corners = [int(word) for part in element.iterfind("{*}vcount") for word in (part.text or "").split()]
        case "polygons":
            corners = [len((part.text or "").split()) // stride for part in element.iterfind("{*}p")]
        case "trifans" | "tristrips":
            raise InputError(f"holds {kind}, which are not read; export triangles")
        case _:
            return 0
    if len(corners) != count:
        raise InputError(f"{kind} of {len(corners)} polygons say that they are {count}; {CUT}")
    return sum(corners) - 2 * count


def _of_3mf(data: bytes) -> int:
    """The triangles of all objects in all models of the archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        models = [archive.read(name) for name in archive.namelist() if name.lower().endswith(".model")]
    return sum(1 for model in models for _ in ET.fromstring(model).iterfind(".//{*}triangle"))
