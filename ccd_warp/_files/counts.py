"""How many triangles a glTF, COLLADA or 3MF file says it holds: trimesh passes over what it does not know.

And what else would make trimesh read it in part without a word.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

from ccd_warp._files.archive import unpack
from ccd_warp._files.text import CUT, shown
from ccd_warp._scene.input.messages import InputError

_GLB_HEADER = 12  # bytes: magic, version, length
# Extensions that a file may require and that do not affect its triangles.
_HARMLESS = (
    *("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "KHR_lights_"),
    *("EXT_texture_", "EXT_lights_", "MSFT_texture_"),
)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives; others are points and lines


def stated_triangles(suffix: str, data: bytes, max_bytes: int) -> int:
    """Number of triangles in all instances of meshes in the scene of a file.

    Raises:
        InputError: If the file is cut, or holds what is not read.
    """
    match suffix:
        case ".3mf":
            return _of_3mf(dict(unpack(data, max_bytes)))
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

    def of_node(node: dict[str, Any]) -> int:
        if "EXT_mesh_gpu_instancing" in node.get("extensions", ()):
            raise InputError("has instances by EXT_mesh_gpu_instancing, which are not read; export a node for each")
        mesh = tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ()
        return sum(map(of_primitive, mesh)) + sum(of_node(tree["nodes"][k]) for k in node.get("children", ()))

    scenes = tree.get("scenes") or [{}]
    return sum(of_node(tree["nodes"][k]) for k in scenes[tree.get("scene", 0)].get("nodes", ()))


def _of_collada(root: ET.Element) -> int:
    geometries: dict[str, int] = {}
    for geometry in _all(root, "geometry"):
        for array in _all(geometry, "float_array"):  # of which three numbers less are a vertex less
            if len((array.text or "").split()) != int(array.attrib["count"]):
                raise InputError(f"the array {array.get('id')!r} does not hold {array.get('count')} values; {CUT}")
        geometries[geometry.get("id", "")] = sum(map(_of_primitives, geometry.iter()))
    nodes = {node.get("id", ""): node for node in _all(root, "node")}

    def of_node(node: ET.Element) -> int:
        count = 0
        for part in node:
            target = part.get("url", "").removeprefix("#")
            match _name(part):
                case "node":
                    count += of_node(part)
                case "instance_node":
                    count += of_node(nodes[target])
                case "instance_geometry":
                    count += geometries[target]
                case "instance_controller":
                    raise InputError("has a mesh that a controller moves, which is not read; export it without")
        return count

    urls = {each.get("url", "").removeprefix("#") for each in _all(root, "instance_visual_scene")}
    scenes = [scene for scene in _all(root, "visual_scene") if scene.get("id") in urls]
    return sum(of_node(node) for scene in scenes for node in scene if _name(node) == "node")


def _of_primitives(element: ET.Element) -> int:
    kind, count = _name(element), int(element.get("count", "0"))
    words = {name: [(part.text or "").split() for part in element if _name(part) == name] for name in ("vcount", "p")}
    stride = 1 + max((int(part.get("offset", "0")) for part in element), default=0)
    match kind:
        case "triangles":
            return count
        case "polylist":
            corners = [int(word) for words in words["vcount"] for word in words]
        case "polygons":
            corners = [len(numbers) // stride for numbers in words["p"]]
        case "trifans" | "tristrips":
            raise InputError(f"holds {kind}, which are not read; export triangles")
        case _:
            return 0
    if len(corners) != count:
        raise InputError(f"{kind} of {len(corners)} polygons say that they are {count}; {CUT}")
    return sum(corners) - 2 * count


def _of_3mf(files: Mapping[str, bytes]) -> int:
    roots = [data for name, data in files.items() if "3d/3dmodel.model" in name.lower()]
    if not roots:
        raise InputError(f"holds no 3D/3dmodel.model; {CUT}")
    root = ET.fromstring(roots[0])

    def of_object(model: ET.Element, number: str) -> int:
        (found,) = (each for each in _all(model, "object") if each.get("id") == number)
        triangles = sum(1 for _ in _all(found, "triangle"))
        return triangles + sum(of_component(model, each) for each in _all(found, "component"))

    def of_component(model: ET.Element, part: ET.Element) -> int:
        path = next((value.strip("/") for key, value in part.items() if _name_of(key) == "path"), None)
        return of_object(model if path is None else ET.fromstring(files[path]), part.attrib["objectid"])

    return sum(of_component(root, item) for item in _all(root, "item"))


def _all(root: ET.Element, name: str) -> list[ET.Element]:
    return [element for element in root.iter() if _name(element) == name]


def _name(element: ET.Element) -> str:
    return _name_of(str(element.tag))


def _name_of(tag: str) -> str:
    return tag.rpartition("}")[2]
