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


def _hollow_cube(place):
    """The hexahedra of a hollow cube, 3 x 3 x 3 without the middle: its two surfaces are of one part."""
    places = np.array([place for place in np.ndindex(3, 3, 3) if place != (1, 1, 1)])
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    nodes, cells = np.unique((places[:, None] + corners).reshape(-1, 3), axis=0, return_inverse=True)
    return nodes / 3.0 + place, cells.reshape(-1, 8)


@pytest.fixture(params=["vtu", "vtk", "xdmf"])
def cubes(request, tmp_path):
    """Files of three hollow cubes above one another, cells of all in turn; the highest comes down on the middle one."""
    meshio = pytest.importorskip("meshio", reason="the extra examples is not installed")
    parts = [_hollow_cube([0.0, 0.0, 2.0 * k]) for k in range(3)]
    nodes = np.concatenate([part for part, _ in parts])
    cells = np.concatenate([cells + k * len(parts[0][0]) for k, (_, cells) in enumerate(parts)])
    material = np.repeat([7, 3, 7], len(parts[0][1]))
    order = np.random.default_rng(0).permutation(len(cells))
    order = np.append(0, order[order != 0])  # the cells of the first cube come first
    end = nodes.copy()
    end[-len(parts[0][0]) :, 2] -= 1.5
    for name, x in (("start", nodes), ("end", end)):
        data = {"material": [material[order]], "vector": [np.zeros((len(cells), 3))]}
        mesh = meshio.Mesh(x, [("hexahedron", cells[order])], cell_data=data)
        mesh.write(tmp_path / f"{name}.{request.param}")
    return [tmp_path / f"{name}.{request.param}" for name in ("start", "end")], nodes, end


def test_what_hangs_together_by_its_cells_is_a_body(cubes):
    paths, nodes, end = cubes
    frames = ccd.read_frames(*paths, surface=True, split=True, static=paths[:1])
    names = [f"{paths[0].name}#{k}" for k in range(3)]
    assert {*frames.mesh.names[:3]} == {*names} and frames.mesh.names[3:] == tuple(
        f"{n} (2)" for n in frames.mesh.names[:3]
    )
    assert frames.mesh.body_vertex_range.tolist() == [64 * k for k in range(7)]
    count = len(nodes)
    assert sorted(frames.source_index[:count]) == sorted(frames.source_index[count:]) == list(range(count))
    assert np.array_equal(frames.vertices_t0, nodes[frames.source_index])
    assert np.array_equal(frames.vertices_t1[:count], end[frames.source_index[:count]])


def test_cells_of_one_value_of_a_field_are_a_body(cubes):
    paths, *_ = cubes
    frames = ccd.read_frames(*paths, surface=True, split="material", kinematic=["material 3"])
    assert frames.mesh.names == ("material 3", "material 7") and frames.mesh.kinematic.tolist() == [True, False]
    assert frames.source_index.tolist() == [*range(64, 128), *range(64), *range(128, 192)]
    whole = ccd.read_frames(*paths, surface=True)
    split, one = (ccd.mesh_ccd(each.mesh, each.vertices_t0, each.vertices_t1) for each in (frames, whole))
    assert split.toi == one.toi == pytest.approx(2 / 3) and len(split.contacts) == len(one.contacts)
    assert {*split.first.body_names} == {"material 3", "material 7"}


def test_a_command_names_the_parts(cubes, capfd):
    paths, *_ = cubes
    options = ["--surface", "--kinematic", f"{paths[0].name}#0", "--radius", f"{paths[0].name}#1=0.05"]
    assert main(["run", *options, "--split", *map(str, paths)]) == 0
    assert f"{paths[0].name}#0  kinematic" in capfd.readouterr().out
    options = ["--split=material", "--surface", "--radius", "material 3=0.25", "--no-self-collision", *map(str, paths)]
    assert main(["run", *options]) == 0
    out = capfd.readouterr().out
    assert "scene toi  0.499999" in out and "material 3  moving" in out and "of material 7" in out


@pytest.mark.parametrize(
    ("split", "message"),
    [
        ("colour", "has no field 'colour' of its cells; expected one of them: 'material', 'vector'"),
        ("vector", r"the field 'vector' is .* of shape \(78, 3\); expected a finite number for each of the 78 cells"),
        (3, "split is 3; expected True, False or the name of a field of cells"),
        ("", "split is ''; expected True, False"),
    ],
)
def test_a_field_that_tells_no_parts_is_refused(cubes, split, message):
    with pytest.raises(ValueError, match=message) as caught:
        ccd.read_frames(*cubes[0], surface=True, split=split)
    assert "\n" not in str(caught.value)


def test_a_soup_and_a_group_are_split_by_what_shares_a_vertex(tmp_path):
    boxes = [trimesh.creation.box(extents=(1, 1, 1)).apply_translation([3.0 * k, 0, 0]) for k in range(3)]
    trimesh.util.concatenate(boxes).export(tmp_path / "a.stl")
    frames = ccd.read_frames(tmp_path / "a.stl", tmp_path / "a.stl", split=True)
    assert frames.mesh.names == ("a.stl#0", "a.stl#1", "a.stl#2") and frames.num_merged.tolist() == [28, 28, 28]
    assert ccd.read_frames(tmp_path / "a.stl", tmp_path / "a.stl").mesh.names == ("a.stl",)
    (tmp_path / "a.obj").write_text(_obj((["o two"], TRIANGLE), ([], TRIANGLE + 3.0), (["o one"], TRIANGLE + 6.0)))
    assert [body.name for body in read_static(tmp_path / "a.obj").split(True)] == ["two#0", "two#1", "one"]
    with pytest.raises(ValueError, match=r"a\.obj: holds no fields of cells, and is to be split by 'part'"):
        ccd.read_frames(tmp_path / "a.obj", tmp_path / "a.obj", split="part")


def test_parts_that_share_a_vertex_are_one_body_called_by_both(tmp_path):
    """Of a cache the first frame tells the parts; a number or a text for each face."""
    positions = np.random.default_rng(0).uniform(size=(12, 3)) + np.arange(3.0)[:, None, None]
    faces = np.array([[0, 1, 2], [3, 4, 5], [2, 6, 7], [8, 9, 10]])
    for values, names in (
        ([5, 4, 9, 5], ("part 4", "part 5 + part 9")),
        ([0.5, 0.25, 2.0, 4.0], ("part 0.25", "part 0.5 + part 2", "part 4")),
        (["shirt", "ball", "sleeve", "shirt"], ("ball", "shirt + sleeve")),
    ):
        np.savez(tmp_path / "a.npz", positions=positions, faces=faces, part=np.array(values))
        sequence = ccd.read_sequence(tmp_path / "a.npz", split="part")
        assert sequence.mesh.names == names
        assert all(step.mesh is sequence.mesh for step in sequence.steps())
        assert np.array_equal(sequence[2], positions[2][sequence.step(0).source_index])
    np.savez(tmp_path / "a.npz", positions=positions, faces=faces, part=np.array([1, 2, 3]))
    for split, message in (("part", r"is int64 of shape \(3,\)"), ("other", "holds no array 'other'")):
        with pytest.raises(ValueError, match=message):
            ccd.read_sequence(tmp_path / "a.npz", split=split)
    np.savez(tmp_path / "a.npz", positions=positions, faces=faces, part=np.array([1, 2, 2, 1]))
    with pytest.warns(RuntimeWarning, match="of all 2 values of the field 'part' hang together"):
        assert ccd.read_sequence(tmp_path / "a.npz", split="part").mesh.names == ("a.npz",)
    assert ccd.read_sequence(tmp_path / "a.npz", split=True).mesh.names == ("a.npz#0", "a.npz#1", "a.npz#2")
