"""Reading frames: nothing is rounded, merged or reordered unless the format calls for it."""

import numpy as np
import pytest
import trimesh

from ccd_warp._files.frames import InputError, read_frames, read_static, write_mesh


@pytest.fixture
def ball():
    """A sphere whose coordinates need all 53 bits."""
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=1.0 / 3.0)
    return np.asarray(mesh.vertices) + np.pi, np.asarray(mesh.faces)


def _export(path, vertices, faces, **options):
    trimesh.Trimesh(vertices, faces, process=False).export(path, **options)
    return path


def _float32(vertices):
    return vertices.astype(np.float32).astype(np.float64)


def test_binary_ply_in_double_precision_keeps_every_bit(tmp_path, ball):
    vertices, faces = ball
    write_mesh(tmp_path / "a.ply", vertices, faces)
    write_mesh(tmp_path / "b.ply", vertices + 0.1, faces)
    body = read_frames(tmp_path / "a.ply", tmp_path / "b.ply")
    assert np.array_equal(body.vertices_t0, vertices)
    assert np.array_equal(body.vertices_t1, vertices + 0.1)
    assert np.array_equal(body.faces, faces)
    assert not body.merged and not body.is_static


def test_ascii_ply_in_double_precision_keeps_every_bit(tmp_path, ball):
    vertices, faces = ball
    rows = "\n".join(" ".join(map(repr, row)) for row in vertices.tolist())
    triangles = "\n".join("3 " + " ".join(map(str, row)) for row in faces.tolist())
    text = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{rows}\n{triangles}\n"
    )
    (tmp_path / "a.ply").write_text(text)
    body = read_frames(tmp_path / "a.ply", tmp_path / "a.ply")
    assert np.array_equal(body.vertices_t0, vertices)
    assert np.array_equal(body.faces, faces)


def _obj(vertices, faces, corner="{0}"):
    lines = ["v " + " ".join(map(repr, row)) for row in vertices.tolist()]
    lines += [f"vt 0.{k} 0.5" for k in range(len(vertices))]
    lines += [f"vn 0 {k} 1" for k in range(len(vertices))]
    for k, row in enumerate(faces.tolist()):
        # A material and a texture seam at every other face: trimesh alone would split vertices and sort faces.
        lines.append(f"usemtl {'red' if k % 2 else 'blue'}")
        lines.append("f " + " ".join(corner.format(v + 1, k % 7 + 1) for v in row))
    return "mtllib none.mtl\no ball\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize("corner", ["{0}", "{0}/{1}", "{0}//{1}", "{0}/{1}/{1}"])
def test_obj_keeps_every_bit_and_its_own_vertices(tmp_path, ball, corner):
    vertices, faces = ball
    (tmp_path / "a.obj").write_text(_obj(vertices, faces, corner))
    (tmp_path / "b.obj").write_text(_obj(vertices * 1.5, faces, corner))
    body = read_frames(tmp_path / "a.obj", tmp_path / "b.obj")
    assert np.array_equal(body.vertices_t0, vertices)
    assert np.array_equal(body.vertices_t1, vertices * 1.5)
    assert np.array_equal(body.faces, faces)


def test_obj_vertex_without_a_face_keeps_its_number(tmp_path):
    (tmp_path / "a.obj").write_text("v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 2 3 4\n")
    body = read_static(tmp_path / "a.obj")
    assert body.vertices_t0.shape == (4, 3)
    assert body.faces.tolist() == [[1, 2, 3]]


def test_off_reads_text_doubles(tmp_path, ball):
    vertices, faces = ball
    rows = "\n".join(" ".join(map(repr, row)) for row in vertices.tolist())
    triangles = "\n".join("3 " + " ".join(map(str, row)) for row in faces.tolist())
    (tmp_path / "a.off").write_text(f"OFF\n{len(vertices)} {len(faces)} 0\n{rows}\n{triangles}\n")
    body = read_frames(tmp_path / "a.off", tmp_path / "a.off")
    assert np.array_equal(body.vertices_t0, vertices)
    assert np.array_equal(body.faces, faces)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_corners_are_merged_by_the_map_of_the_start(tmp_path, ball, kind):
    vertices, faces = ball
    moved = vertices * [1.0, 2.0, 3.0]
    start = _export(tmp_path / "a.stl", vertices, faces, file_type=kind)
    end = _export(tmp_path / "b.stl", moved, faces, file_type=kind)
    body = read_frames(start, end)
    assert len(body.vertices_t0) == len(vertices)
    assert body.merged == 3 * len(faces) - len(vertices)
    if kind == "stl":  # STL holds single precision
        assert np.array_equal(body.vertices_t0[body.faces], _float32(vertices)[faces])
        assert np.array_equal(body.vertices_t1[body.faces], _float32(moved)[faces])
    corners = body.vertices_t0[body.faces].reshape(-1, 3)
    assert np.array_equal(corners[body.source_index], body.vertices_t0)


def test_stl_that_tears_is_refused(tmp_path, ball):
    vertices, faces = ball
    start = _export(tmp_path / "a.stl", vertices, faces)
    corners = vertices[faces].reshape(-1, 3)
    corners[5] += 1.0
    end = _export(tmp_path / "b.stl", corners, np.arange(len(corners)).reshape(-1, 3))
    with pytest.raises(InputError, match=r"b\.stl: corner \d of face \d+ leaves corner .*save both frames"):
        read_frames(start, end)


def test_stl_frame_with_a_ply_frame_is_refused(tmp_path, ball):
    vertices, faces = ball
    start = _export(tmp_path / "a.stl", vertices, faces)
    end = _export(tmp_path / "b.ply", vertices, faces)
    with pytest.raises(InputError, match=r"a\.stl and .*b\.ply .*same format"):
        read_frames(start, end)


def test_glb_puts_the_parts_of_a_scene_in_place(tmp_path, ball):
    vertices, faces = ball
    scene = trimesh.Scene()
    shift = np.eye(4)
    shift[:3, 3] = [10.0, 0.0, 0.0]
    scene.add_geometry(trimesh.Trimesh(vertices, faces, process=False), geom_name="a")
    scene.add_geometry(trimesh.Trimesh(vertices, faces, process=False), geom_name="b", transform=shift)
    scene.export(tmp_path / "a.glb")
    body = read_frames(tmp_path / "a.glb", tmp_path / "a.glb")
    assert body.faces.shape == (2 * len(faces), 3)
    expected = np.vstack([_float32(vertices), _float32(vertices) + [10.0, 0.0, 0.0]])
    found = body.vertices_t0[np.lexsort(body.vertices_t0.T)]
    assert np.array_equal(found, expected[np.lexsort(expected.T)])


def test_glb_copies_of_a_vertex_at_a_seam_become_one(tmp_path, ball):
    vertices, faces = ball
    corners = vertices[faces].reshape(-1, 3)
    start = _export(tmp_path / "a.glb", corners, np.arange(len(corners)).reshape(-1, 3))
    end = _export(tmp_path / "b.glb", corners * 2.0, np.arange(len(corners)).reshape(-1, 3))
    body = read_frames(start, end)
    assert len(body.vertices_t0) == len(vertices)
    assert len(read_static(start).vertices_t0) == len(vertices)


def test_glb_vertices_that_touch_and_part_stay_two(tmp_path):
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
    parted = square.copy()
    parted[3:] -= 1.0
    faces = np.arange(6).reshape(-1, 3)
    start, end = _export(tmp_path / "a.glb", square, faces), _export(tmp_path / "b.glb", parted, faces)
    assert len(read_frames(start, end).vertices_t0) == 6


def test_touching_vertices_of_an_indexed_format_stay_two(tmp_path):
    corners = np.zeros((6, 3))
    write_mesh(tmp_path / "a.ply", corners, np.arange(6).reshape(-1, 3))
    assert len(read_static(tmp_path / "a.ply").vertices_t0) == 6


def test_static_body_is_the_same_at_both_ends(tmp_path, ball):
    vertices, faces = ball
    write_mesh(tmp_path / "a.ply", vertices, faces)
    body = read_static(tmp_path / "a.ply")
    assert body.is_static
    assert np.array_equal(body.vertices_t0, body.vertices_t1)


def test_different_counts_name_both_files_and_their_counts(tmp_path, ball):
    vertices, faces = ball
    write_mesh(tmp_path / "a.ply", vertices, faces)
    write_mesh(tmp_path / "b.ply", vertices[:4], np.array([[0, 1, 2], [1, 2, 3]]))
    with pytest.raises(InputError, match=r"a\.ply has 42 vertices and 80 faces, .*b\.ply has 4 vertices and 2 faces"):
        read_frames(tmp_path / "a.ply", tmp_path / "b.ply")


def test_different_faces_name_the_first(tmp_path, ball):
    vertices, faces = ball
    write_mesh(tmp_path / "a.ply", vertices, faces)
    write_mesh(tmp_path / "b.ply", vertices, np.vstack([faces[:7], faces[7:][::-1]]))
    with pytest.raises(InputError, match="face 7 is"):
        read_frames(tmp_path / "a.ply", tmp_path / "b.ply")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.ply: no such file"):
        read_static(tmp_path / "nowhere.ply")


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl", "a.off", "a.glb", "a.xyz_unknown", "a"])
def test_unreadable_file(tmp_path, name):
    (tmp_path / name).write_text("this is no mesh\n")
    with pytest.raises(InputError, match=name) as caught:
        read_static(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_points_without_faces(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(InputError, match="holds no triangles"):
        read_static(tmp_path / "a.obj")


def test_face_index_out_of_range(tmp_path):
    write_mesh(tmp_path / "a.ply", np.eye(3), np.array([[0, 1, 3]]))
    with pytest.raises(InputError, match=r"face 0 is \[0, 1, 3\], but the file has 3 vertices"):
        read_static(tmp_path / "a.ply")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_position_that_is_not_finite(tmp_path, value):
    vertices = np.eye(3)
    vertices[1, 2] = value
    write_mesh(tmp_path / "a.ply", vertices, np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match=r"vertex 1 is .*not finite"):
        read_static(tmp_path / "a.ply")
