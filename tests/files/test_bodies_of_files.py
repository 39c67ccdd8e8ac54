"""Objects, groups, nodes and files of an archive are bodies with their names, told apart by reports and answers."""

import io
import json
import zipfile

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._files.frames import read_frames, read_static

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def _obj(*blocks) -> str:
    """Triangles behind lines of labels, each a block of vertices and a face."""
    text, count = "", 0
    for labels, vertices in blocks:
        text += "".join(f"{label}\n" for label in labels)
        text += "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(vertices).tolist())
        text += f"f {count + 1} {count + 2} {count + 3}\n"
        count += len(vertices)
    return text


@pytest.fixture
def passing(tmp_path):
    """An OBJ of two objects, the second of which passes through the first within the step."""
    for name, height in (("start", 1.0), ("end", -1.0)):
        blocks = ((["o lower plate"], TRIANGLE), (["o drop"], 0.1 * TRIANGLE + [0.2, 0.2, height]))
        (tmp_path / f"{name}.obj").write_text(_obj(*blocks))
    return tmp_path


def _run(folder, *options):
    return main(["run", str(folder / "start.obj"), str(folder / "end.obj"), *map(str, options)])


def test_object_that_passes_through_another_is_found_without_self_collision(passing, capfd):
    """One body for the whole file would leave the pair out, and the answer would be a certain none."""
    assert _run(passing, "--no-self-collision", "--output", passing / "out.json") == 0
    out = capfd.readouterr().out
    assert "lower plate  moving" in out and "drop         moving" in out and "of drop and face 0 of lower plate" in out
    data = json.loads((passing / "out.json").read_text())
    assert data["toi"] == pytest.approx(0.5, abs=1e-5) and data["toi"] <= 0.5
    assert [body["name"] for body in data["bodies"]] == ["lower plate", "drop"]
    assert all(sorted(row["bodies"]) == ["drop", "lower plate"] for row in data["contacts"])


def test_kinds_that_the_bodies_cannot_form_are_refused(passing, capfd):
    assert _run(passing, "--pair-kinds", "point-point") == 2
    error = capfd.readouterr().err
    assert "--pair-kinds holds point-point, which these bodies cannot form" in error
    assert "expected some of vertex-face, edge-edge" in error and error.count("\n") == 1


def test_what_was_left_out_is_named(passing, capfd):
    assert _run(passing, "--t-max", "0.25", "--pair-kinds", "vertex-face", "--no-self-collision") == 0
    out = capfd.readouterr().out
    assert "certain for the pairs looked at: vertex-face, in [0, 0.25]" in out
    left_out = "edge-edge pairs (--pair-kinds); pairs within a body (--no-self-collision); pairs that share a vertex"
    assert f"left out  {left_out}\n" in out


def test_public_reader_gives_the_same_bodies(passing):
    frames = ccd.read_frames(passing / "start.obj", passing / "end.obj", static=[passing / "end.obj"])
    assert frames.mesh.names == ("lower plate", "drop", "lower plate (2)", "drop (2)")
    assert frames.mesh.static.tolist() == [False, False, True, True]


def test_vertices_of_bodies_are_found_again_in_the_file(tmp_path):
    """Faces of two groups in turn, whose vertices lie in turn, and one that no face uses."""
    vertices = np.random.default_rng(0).uniform(size=(7, 3))
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    text += "g even\nf 1 3 5\ng odd/side\nf 2 4 6\ng even\nf 5 3 1\n"
    (tmp_path / "a.obj").write_text(text)
    body = read_static(tmp_path / "a.obj")
    even, odd = body.split()
    assert (even.name, odd.name) == ("even", "odd/side") and even.is_static
    assert even.source_index.tolist() == [0, 2, 4] and odd.source_index.tolist() == [1, 3, 5, 6]
    assert even.faces.tolist() == [[0, 1, 2], [2, 1, 0]] and odd.faces.tolist() == [[0, 1, 2]]
    for part in (even, odd):
        assert np.array_equal(part.vertices_t0, vertices[part.source_index])


def test_groups_that_share_a_vertex_are_one_body(tmp_path):
    """As a mesh that is cut into groups by material; a body cannot own half a vertex."""
    shared = "o shirt\ng front\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\ng back\nf 2 4 3\no ball\n"
    (tmp_path / "a.obj").write_text(shared + "v 0 0 9\nv 1 0 9\nv 0 1 9\nf -1 -2 -3\n")
    assert [body.name for body in read_static(tmp_path / "a.obj").split()] == ["shirt", "ball"]
    (tmp_path / "a.obj").write_text(shared.replace("o shirt\n", "").replace("o ball\n", ""))
    (body,) = read_static(tmp_path / "a.obj").split()
    assert body.name == "a.obj" and len(body.faces) == 2


def test_polygons_and_what_looks_like_a_label_keep_their_body(tmp_path):
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    text = f"o a#o no\n{square}g\nf 1 2 3 4\n\to  b c \r\n{square}{square}"
    text += "# o comment\nf 5/1 6/1 7/1 8/1\nusemtl o\nf 9 10 11\n"
    (tmp_path / "a.obj").write_bytes(text.encode())
    a, b = read_static(tmp_path / "a.obj").split()
    assert (a.name, len(a.faces), b.name, len(b.faces)) == ("a", 2, "b c", 3)


def test_nodes_of_a_scene_are_bodies_even_where_they_coincide(tmp_path):
    """Copies at a seam are merged within a node alone: of two nodes they are two bodies in contact."""
    box = trimesh.creation.box()
    scene = trimesh.Scene()
    for name, offset in (("left", 0.0), ("right", 1.0)):
        scene.add_geometry(
            box.copy(), node_name=name, transform=trimesh.transformations.translation_matrix([offset, 0, 0])
        )
    scene.export(tmp_path / "a.glb")
    left, right = read_frames(tmp_path / "a.glb", tmp_path / "a.glb").split()
    assert {left.name, right.name} == {"left", "right"}
    assert len(left.vertices_t0) == len(right.vertices_t0) == 8


def test_materials_of_a_mesh_are_one_body_and_its_seam_is_merged(tmp_path):
    """glTF holds a part of a mesh for each material; trimesh makes a node of each."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
    other = TRIANGLE.astype("<f4") + np.float32(5.0)
    buffers = [square[[0, 1, 2]], square[[0, 2, 3]], other]
    data = b"".join(buffer.tobytes() for buffer in buffers)
    primitives = [{"attributes": {"POSITION": k}, "material": k % 2} for k in range(3)]
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "name": "square"}, {"mesh": 1, "name": "other"}],
        "meshes": [{"primitives": primitives[:2], "name": "m"}, {"primitives": primitives[2:], "name": "n"}],
        "materials": [{"name": "red"}, {"name": "blue"}],
        "accessors": [{"bufferView": k, "componentType": 5126, "count": 3, "type": "VEC3"} for k in range(3)],
        "bufferViews": [{"buffer": 0, "byteOffset": 36 * k, "byteLength": 36} for k in range(3)],
        "buffers": [{"uri": "data.bin", "byteLength": len(data)}],
    }
    for k, accessor in enumerate(tree["accessors"]):
        accessor |= {"min": buffers[k].min(axis=0).tolist(), "max": buffers[k].max(axis=0).tolist()}
    (tmp_path / "data.bin").write_bytes(data)
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    bodies = {body.name: body for body in read_static(tmp_path / "a.gltf").split()}
    assert bodies.keys() == {"square", "other"}
    assert (len(bodies["square"].vertices_t0), bodies["square"].merged, len(bodies["square"].faces)) == (4, 2, 2)
    assert (len(bodies["other"].vertices_t0), bodies["other"].merged) == (3, 0)


def test_files_of_an_archive_are_bodies(tmp_path):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("a/one.obj", _obj(([], TRIANGLE)))
        archive.writestr("b/one.obj", _obj((["o x"], TRIANGLE), (["o y"], TRIANGLE + 3.0)))
    (tmp_path / "a.zip").write_bytes(content.getvalue())
    assert [body.name for body in read_static(tmp_path / "a.zip").split()] == [
        "a/one.obj",
        "b/one.obj/x",
        "b/one.obj/y",
    ]
