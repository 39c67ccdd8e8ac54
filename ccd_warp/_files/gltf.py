"""Read the triangles of glTF 2.0, each mesh where its node, its morph weights and its skin place it at rest."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from ccd_warp._files.content import FilePart
from ccd_warp._files.opened import read_file
from ccd_warp._files.text import CUT, shown
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.trimesh_bodies import transformed

_GLB_HEADER, _CHUNK_HEADER = 12, 8  # bytes: magic, version, length; length, type
# Extensions that a file may require and that do not affect its triangles, or are read.
_HARMLESS = (
    *("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "KHR_lights_"),
    *("EXT_texture_", "EXT_lights_", "MSFT_texture_"),
)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives; others are points and lines
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def read_gltf(path: Path, data: bytes) -> list[FilePart]:
    """Every primitive of triangles in the scene of a glTF or GLB file, called by its node.

    Raises:
        InputError: If the file is cut, or holds what is not read.

    References: Khronos Group, glTF 2.0 specification, 2021: 3.6.2 accessors, 3.7.2 meshes, 3.7.3 skins, 3.7.4 order.
    """
    return list(_File(path, data).parts())


class _File:
    """A file, whose buffers are read when they are asked for."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        text, self.binary = _chunks(data) if path.suffix.lower() == ".glb" else (data, None)
        self.tree: dict[str, Any] = json.loads(text)
        version = str(self.tree.get("asset", {}).get("version", ""))
        if not version.startswith("2"):
            raise InputError(f"is glTF {version}; expected 2.0: export the file again")
        required = [name for name in self.tree.get("extensionsRequired", ()) if not name.startswith(_HARMLESS)]
        if required:
            raise InputError(f"requires the extension {required[0]!r}, which is not read; export the file without it")
        self.nodes: list[dict[str, Any]] = self.tree.get("nodes", [])
        if any("EXT_mesh_gpu_instancing" in node.get("extensions", ()) for node in self.nodes):
            raise InputError("has instances by EXT_mesh_gpu_instancing, which are not read; export a node for each")
        self.places, self.buffers = self._places(), dict[int, bytes]()

    def parts(self) -> Iterator[FilePart]:
        """The primitives of each node of the scene that has triangles."""
        from trimesh.util import unique_name

        names: dict[str, int] = {}
        for k, node in enumerate(self.nodes):
            names[unique_name(str(node.get("name", k)), names)] = k
        order = self._order()
        for k, name in zip(order, (list(names)[k] for k in order), strict=True):
            yield from (FilePart(*arrays, names=[name]) for arrays in self._meshes(k))
        for k in {*range(len(self.nodes))} - {*order}:
            if any(True for _ in self._meshes(k)):
                raise InputError(f"its node {list(names)[k]!r} is in no scene that is read; export one scene")

    def _order(self) -> list[int]:
        """The nodes of the scene, the last root first and parents before their children."""
        children = [child for node in self.nodes for child in node.get("children", ())]
        roots = [k for k in range(len(self.nodes)) if k not in children]
        if self.tree.get("scenes"):
            roots = self.tree["scenes"][self.tree.get("scene", 0)].get("nodes", [])
        order: list[int] = []
        left = list(roots)
        while left and len(order) <= len(self.nodes):
            order.append(k := left.pop())
            left += self.nodes[k].get("children", [])
        if len({*order}) < len(order) or len({*children}) < len(children):
            raise InputError("one of its nodes is at two places of the scene; export the file again")
        return order

    def _places(self) -> list[np.ndarray]:
        """The transformation of each node to the scene, shape [4, 4]."""
        parents = {child: k for k, node in enumerate(self.nodes) for child in node.get("children", ())}
        own = [_matrix(node) for node in self.nodes]
        places = []
        for node, place in enumerate(own):
            parent, above = parents.get(node), 0
            while parent is not None and above < len(own):  # and a circle has an end
                with np.errstate(all="ignore"):
                    place, parent, above = own[parent] @ place, parents.get(parent), above + 1
            places.append(place)
        return places

    def _meshes(self, k: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Positions in the scene and triangles of each primitive of a node."""
        node = self.nodes[k]
        mesh = self.tree["meshes"][node["mesh"]] if "mesh" in node else {"primitives": []}
        for primitive in mesh["primitives"]:
            attributes, mode = primitive["attributes"], primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
                continue
            positions = self.accessor(attributes["POSITION"], "VEC3").astype(np.float64)
            corners = np.arange(len(positions))
            if "indices" in primitive:
                corners = self.accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
            faces = _triangles(corners, mode)
            with np.errstate(all="ignore"):  # what is not finite is refused with the vertex
                targets = primitive.get("targets", [])
                weights = node.get("weights", mesh.get("weights", [0.0] * len(targets)))
                if len(weights) != len(targets):
                    raise InputError(f"has {len(weights)} weights of {len(targets)} morph targets; {CUT}")
                for weight, target in zip(weights, targets, strict=True):
                    if weight and "POSITION" in target:
                        positions += weight * self.accessor(target["POSITION"], "VEC3", len(positions))
                if "skin" in node:
                    positions = self._skinned(positions, attributes, self.tree["skins"][node["skin"]])
                else:
                    positions = transformed(positions, self.places[k])
            if len(faces):
                yield positions, faces

    def _skinned(self, positions: np.ndarray, attributes: dict[str, int], skin: dict[str, Any]) -> np.ndarray:
        """Positions where the joints place them; the transformation of the node itself is not used.

        Weights are divided by their sum, which is 1 but for roundings.
        """
        matrices = np.stack([self.places[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            inverse = self.accessor(skin["inverseBindMatrices"], "MAT4").reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(inverse) < len(matrices):
                raise InputError(f"a skin of {len(matrices)} joints has {len(inverse)} inverse bind matrices; {CUT}")
            matrices = matrices @ inverse[: len(matrices)]
        placed, total, k = np.zeros((len(positions), 3)), np.zeros((len(positions), 1)), 0
        while f"JOINTS_{k}" in attributes:
            joints = self.accessor(attributes[f"JOINTS_{k}"], "VEC4", len(positions)).astype(np.int64)
            weights = self.accessor(attributes[f"WEIGHTS_{k}"], "VEC4", len(positions))
            joints[weights == 0.0] = 0
            if joints.max(initial=0) >= len(matrices):
                raise InputError(f"a vertex has the joint {joints.max()}, and its skin has {len(matrices)}; {CUT}")
            for joint, weight in zip(joints.T, weights.T[:, :, None], strict=True):
                of_joint = matrices[joint]
                placed += weight * (np.einsum("nij,nj->ni", of_joint[:, :3, :3], positions) + of_joint[:, :3, 3])
                total += weight
            k += 1
        if not (total > 0.0).all():
            raise InputError(f"vertex {int(np.argmin(total > 0.0))} of a skin has no weights; expected a sum of 1")
        return placed / total

    def accessor(self, k: int, kind: str, count: int | None = None) -> np.ndarray:
        """The values of an accessor of this type, and of so many elements: integers or float64, [count, components]."""
        stated = self.tree["accessors"][k]
        if stated["type"] != kind or (count is not None and stated["count"] != count):
            raise InputError(f"its accessor {k} has {stated['count']} {stated['type']}; expected {count or ''} {kind}")
        count, size, component = int(stated["count"]), _SIZES[kind], _COMPONENTS[stated["componentType"]]
        if "bufferView" not in stated and "sparse" not in stated:
            raise InputError("has a mesh that is compressed, which is not read; export it without that")
        values = np.zeros((count, size), component)
        if "bufferView" in stated:
            values = self._view(stated, count, size, component)
        if sparse := stated.get("sparse"):
            index = self._view(sparse["indices"], sparse["count"], 1, _COMPONENTS[sparse["indices"]["componentType"]])
            if index.max(initial=0) >= count:
                raise InputError(f"the sparse accessor {k} of {count} elements has the element {index.max()}; {CUT}")
            values[index[:, 0]] = self._view(sparse["values"], sparse["count"], size, component)
        if stated.get("normalized"):
            values = np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values if values.dtype.kind in "iu" else values.astype(np.float64)

    def _view(self, place: dict[str, Any], count: int, size: int, component: str) -> np.ndarray:
        """So many elements at a place in a part of a buffer."""
        view, item = self.tree["bufferViews"][place["bufferView"]], np.dtype(component).itemsize
        buffer = self._buffer(view["buffer"])
        begin, stride = place.get("byteOffset", 0), view.get("byteStride", size * item)
        end, first = begin + stride * (count - 1) + size * item, view.get("byteOffset", 0)
        if count < 1 or min(begin, first) < 0 or stride < size * item:
            raise InputError(f"states {count} elements of {size * item} bytes every {stride} from {begin} on; {CUT}")
        if end > view["byteLength"] or first + view["byteLength"] > len(buffer):
            raise InputError(
                f"states {end} bytes of {view['byteLength']} from byte {first} on in a buffer of {len(buffer)}; {CUT}"
            )
        return np.ndarray((count, size), component, buffer, first + begin, (stride, item)).copy()

    def _buffer(self, k: int) -> bytes:
        if k not in self.buffers:
            stated = self.tree["buffers"][k]
            uri, data = stated.get("uri"), self.binary if k == 0 else None
            if uri is not None and uri.startswith("data:"):
                head, _, body = uri.partition(",")
                is_base64 = head.endswith(";base64")
                data = base64.b64decode(body, validate=True) if is_base64 else unquote_to_bytes(body)
            elif uri is not None:
                data = read_file(self.path.parent / unquote(uri))
            if data is None or len(data) < stated["byteLength"]:
                raise InputError(f"its buffer {k} has {len(data or b'')} of {stated['byteLength']} bytes; {CUT}")
            self.buffers[k] = data
        return self.buffers[k]


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON of a GLB file, whose length must be as stated, and its buffer."""
    if data[:4] != b"glTF" or len(data) < _GLB_HEADER:
        raise InputError(f"begins with {shown(data[:4])}; expected a GLB file, which begins with 'glTF'")
    version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != 2:
        raise InputError(f"is glTF {version}.0; expected 2.0: export the file again")
    if length != len(data):
        raise InputError(f"has {len(data)} bytes, but its header says {length}; {CUT}")
    chunks: dict[bytes, bytes] = {}
    at = _GLB_HEADER
    while at < length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + _CHUNK_HEADER]
        chunks.setdefault(kind, data[at + _CHUNK_HEADER : (at := at + _CHUNK_HEADER + size)])
    if at != length or b"JSON" not in chunks:
        raise InputError(f"its chunks end at byte {at} of {length}, or none is JSON; {CUT}")
    return chunks[b"JSON"], chunks.get(b"BIN\0")


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """The transformation of a node to its parent: its matrix, or scaled, turned and moved."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    with np.errstate(all="ignore"):
        s = 2.0 / (x * x + y * y + z * z + w * w)
        turned = [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
        ]
        matrix = np.eye(4)
        matrix[:3, :3] = turned * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """The triangles of a list, a strip or a fan of corners; those of a strip that only lead it on are left out."""
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise InputError(f"has triangles of {len(corners)} corners; {CUT}")
        return corners.reshape(-1, 3)
    k = np.arange(max(len(corners) - 2, 0))
    if mode == _FAN:
        return corners[np.stack([k + 1, k + 2, 0 * k], axis=1)]
    faces = corners[np.stack([k, k + 1 + k % 2, k + 2 - k % 2], axis=1)]
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
