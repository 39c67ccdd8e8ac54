"""Drawn glTF scenes are placed as the specification says: nodes, morph weights, skins, and accessors of every kind."""

import base64
import json
import struct

import numpy as np
import pytest

import ccd_warp as ccd

_NUMBERS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class _Drawn:
    """A scene of a few nodes, of which two have a mesh; `placed` has the positions of each by its name."""

    def __init__(self, seed) -> None:
        self.rng, self.buffer = np.random.default_rng(seed), bytearray()
        self.tree = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "nodes": [], "meshes": []}
        own, self.places, self.placed, self.faces = [], [], {}, {}
        for k in range(6):
            node, matrix = self._node()
            self.tree["nodes"].append({"name": f"n{k}", **node})
            own.append(matrix)
            self.places.append(matrix)
            if k and (parent := int(self.rng.integers(-1, k))) >= 0:
                self.tree["nodes"][parent].setdefault("children", []).append(k)
                self.places[k] = self.places[parent] @ matrix
        children = {child for node in self.tree["nodes"] for child in node.get("children", ())}
        self.tree["scenes"] = [{"nodes": [k for k in range(6) if k not in children]}]
        for k, with_skin in ((4, False), (5, True)):
            self._mesh(k, with_skin)
        self.tree["buffers"] = [{"byteLength": len(self.buffer)}]

    def _node(self):
        """A node with a matrix, or with a turn about an axis of space, a scale and a place; and its matrix."""
        matrix, turn = np.eye(4), int(self.rng.integers(3))
        angle, scale, move = self.rng.uniform(-3, 3), self.rng.uniform(0.5, 2, 3), self.rng.uniform(-5, 5, 3)
        i, j = (turn + 1) % 3, (turn + 2) % 3
        matrix[[i, j], [i, j]], matrix[j, i], matrix[i, j] = np.cos(angle), np.sin(angle), -np.sin(angle)
        matrix[:3, :3] *= scale
        matrix[:3, 3] = move
        if self.rng.random() < 0.4:
            return {"matrix": matrix.T.ravel().tolist()}, matrix
        rotation = [*(np.sin(angle / 2) * np.eye(3)[turn]), np.cos(angle / 2)]
        return {"rotation": rotation, "scale": scale.tolist(), "translation": move.tolist()}, matrix

    def _add(self, values, number, *, is_normalized=False):
        """An accessor of these values, at any stride or, of some, sparse; and what it says, in float64."""
        values, draw = np.asarray(values).astype(f"<{number}"), self.rng.random()
        entry = {"componentType": _NUMBERS[number], "count": len(values), "type": _KINDS[values.shape[1]]}
        stored, changed = values.copy(), np.sort(self.rng.choice(len(values), len(values) // 2, replace=False))
        if draw < 0.3 and len(changed):
            stored[changed] = 7
            if draw < 0.15:
                changed, stored = np.arange(len(values)), None
            at = {"bufferView": self._view(changed[:, None].astype("<u2")), "componentType": _NUMBERS["u2"]}
            entry["sparse"] = {
                "count": len(changed),
                "indices": at,
                "values": {"bufferView": self._view(values[changed])},
            }
        if stored is not None:
            entry |= {"bufferView": self._view(stored, int(self.rng.choice([0, 0, 4]))), "byteOffset": 4}
        if is_normalized:
            entry["normalized"] = True
            values = np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1, values.astype(np.float64)

    def _view(self, values, gap=None) -> int:
        """A part of the buffer; of what an accessor refers to, rows begin 4 bytes in, with a gap between them."""
        rows = [row.tobytes() + b"\7" * (gap or 0) for row in values]
        data = (b"" if gap is None else b"\7" * 4) + b"".join(rows)
        view = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": len(data)}
        self.tree["bufferViews"].append(view | ({"byteStride": len(rows[0])} if gap else {}))
        self.buffer += data
        return len(self.tree["bufferViews"]) - 1

    def _mesh(self, k, with_skin) -> None:
        rng, n = self.rng, int(self.rng.integers(6, 12))
        number = str(rng.choice(["f4", "f4", "i2", "u1"]))
        values = rng.normal(size=(n, 3)) if number == "f4" else rng.permutation(3 * n).reshape(n, 3)
        position, x = self._add(values, number, is_normalized=number != "f4" and rng.random() < 0.7)
        targets, weights = [], rng.uniform(-1, 1, int(rng.integers(3)))
        for weight in weights:
            target, offset = self._add(rng.normal(size=(n, 3)), "f4")
            targets.append({"POSITION": target})
            x = x + weight * offset
        node, mesh = self.tree["nodes"][k], {"primitives": []}
        if len(weights):
            mesh["weights"] = (weights if k == 4 else 0 * weights).tolist()
            node |= {"weights": weights.tolist()} if k == 5 else {}
        attributes, place = {"POSITION": position}, np.broadcast_to(self.places[k], (n, 4, 4))
        if with_skin:
            joints = rng.permutation(6)[:3]
            affine = np.where(np.arange(16) % 4 == 3, np.eye(4).ravel(), rng.normal(size=(3, 16)))
            inverse, matrices = self._add(affine, "f4")
            self.tree["skins"] = [{"joints": joints.tolist(), "inverseBindMatrices": inverse}]
            node["skin"] = 0
            matrices = np.stack([self.places[j] for j in joints]) @ matrices.reshape(3, 4, 4).transpose(0, 2, 1)
            place, total = np.zeros((n, 4, 4)), 0.0
            for k_set in range(int(rng.integers(1, 3))):
                indices = rng.integers(0, 3, (n, 4))
                attributes[f"JOINTS_{k_set}"], _ = self._add(indices, str(rng.choice(["u1", "u2"])))
                number = str(rng.choice(["f4", "u1", "u2"]))
                drawn = rng.uniform(0.1, 1, (n, 4)) * (1 if number == "f4" else np.iinfo(number).max)
                attributes[f"WEIGHTS_{k_set}"], w = self._add(drawn, number, is_normalized=number != "f4")
                place, total = place + np.einsum("nk,nkij->nij", w, matrices[indices]), total + w.sum(axis=1)
            place = place / total[:, None, None]
        mode, corners = int(rng.integers(4, 7)), rng.permutation(n)
        corners = corners if mode != 4 else corners[: n // 3 * 3]
        primitive = {"attributes": attributes, "targets": targets, "mode": mode}
        primitive["indices"], _ = self._add(corners[:, None], str(rng.choice(["u1", "u2", "u4"])))
        self.tree["meshes"].append(mesh | {"primitives": [primitive]})
        node["mesh"] = len(self.tree["meshes"]) - 1
        self.placed[f"n{k}"] = np.einsum("nij,nj->ni", place, np.column_stack([x, np.ones(n)]))[:, :3]
        three = {4: lambda i: (3 * i, 3 * i + 1, 3 * i + 2), 5: lambda i: (i, i + 1, i + 2)[:: 1 - 2 * (i % 2)]}
        order = [three.get(mode, lambda i: (0, i + 1, i + 2))(i) for i in range(n // 3 if mode == 4 else n - 2)]
        self.faces[f"n{k}"] = corners[np.array(order)]

    def file(self, path):
        """The scene in a file, whose buffer is within or, of a glTF of some, beside it."""
        if path.suffix == ".glb":
            chunks = b""
            for kind, part in ((b"JSON", json.dumps(self.tree).encode()), (b"BIN\0", bytes(self.buffer))):
                part += b" " * (-len(part) % 4)
                chunks += struct.pack("<I", len(part)) + kind + part
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        else:
            text = base64.b64encode(self.buffer).decode()
            self.tree["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{text}"
            path.write_text(json.dumps(self.tree))
        return path


@pytest.mark.parametrize("seed", range(40))
def test_scenes_are_placed_as_the_specification_says(tmp_path, seed):
    drawn = _Drawn(seed)
    path = drawn.file(tmp_path / ("a.glb" if seed % 2 else "a.gltf"))
    frames = ccd.read_frames(path, path)
    assert {*frames.mesh.names} == {"n4", "n5"}
    for body, name in enumerate(frames.mesh.names):
        begin, end = frames.mesh.body_vertex_range[body : body + 2]
        expected = drawn.placed[name]
        # some twenty roundings of sums of products
        assert np.abs(frames.vertices_t0[begin:end] - expected).max() <= 1e-13 * max(1.0, np.abs(expected).max()) * 40
        found = (frames.mesh.faces[frames.mesh.face_body == body] - begin, drawn.faces[name])
        turned = [[min((*row[k:], *row[:k]) for k in range(3)) for row in faces.tolist()] for faces in found]
        assert turned[0] == turned[1]


def _attribute(tree, key):
    """The accessor of an attribute of the mesh with a skin."""
    return tree["accessors"][tree["meshes"][1]["primitives"][0]["attributes"][key]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "change, message",
    [
        (lambda tree: tree["asset"].update(version="1.0"), r"is glTF 1\.0; expected 2\.0"),
        (lambda tree: tree.update(extensionsRequired=["KHR_d"]), "requires the extension 'KHR_d'"),
        (lambda tree: tree["nodes"][5].update(extensions={"EXT_mesh_gpu_instancing": {}}), "has instances by EXT_mesh"),
        (lambda tree: tree["nodes"][5].update(weights=[1.0] * 9), "has 9 weights of . morph targets"),
        (lambda tree: tree["skins"][0]["joints"].pop(), r"has the joint 2, and its skin has 2"),
        (lambda tree: tree["scenes"][0].update(nodes=[]), "its node 'n.' is in no scene that is read"),
        (lambda tree: tree["nodes"][4].update(children=[4]), "is at two places of the scene"),
        (lambda tree: tree.update(meshes=[{"primitives": []}] * 2), "holds no triangles"),
        (lambda tree: tree.pop("bufferViews"), "cannot be read as a mesh .it lacks 'bufferViews'."),
        (lambda tree: tree["nodes"][4].update(matrix=[np.inf] * 16), "vertex 0 is .* are not finite"),
        (lambda tree: tree["buffers"][0].update(byteLength=10**6), r"its buffer 0 has \d+ of 1000000 bytes"),
        (lambda tree: _attribute(tree, "POSITION").update(count=9999), r"states \d+ bytes of|expected 9999|count"),
        (lambda tree: _attribute(tree, "WEIGHTS_0").update(count=9999), "has 9999 VEC4; expected"),
    ],
)
def test_what_is_no_scene_is_refused_in_words_and_without_a_warning(tmp_path, change, message):
    drawn = _Drawn(1)
    change(drawn.tree)
    path = drawn.file(tmp_path / "a.glb")
    with pytest.raises(ValueError, match=message) as caught:
        ccd.read_frames(path, path)
    assert str(path) in str(caught.value)
