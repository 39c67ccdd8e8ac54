"""Objects, groups, nodes and files of an archive are bodies with their names, told apart by reports and answers."""

import zipfile

import numpy as np
import pytest
import trimesh
from mesh_files import of_extra, polygon_file

import ccd_warp as ccd

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def _vertices(vertices) -> str:
    return "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(vertices).tolist())


def _obj(*blocks) -> str:
    """Triangles behind a label, each a block of vertices and a face."""
    return "".join(f"{label}\n{_vertices(vertices)}f -3 -2 -1\n" for label, vertices in blocks)


def _read(path, content=None, **options) -> ccd.Frames:
    if content is not None:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return ccd.read_frames(path, path, **options)


def test_object_that_passes_through_another_is_found_without_self_collision(tmp_path):
    """One body for the whole file would leave the pair out, and the answer would be a certain none."""
    paths = [tmp_path / f"{name}.obj" for name in ("start", "end")]
    for path, height in zip(paths, (1.0, -1.0), strict=True):
        path.write_text(_obj(("o lower plate", TRIANGLE), ("o drop", 0.1 * TRIANGLE + [0.2, 0.2, height])))
    obstacles = [str(paths[0]), *paths[1:]]
    frames = ccd.read_frames(*paths, static=obstacles, kinematic=["drop"], self_collision=False)
    assert frames.mesh.names == tuple(f"{name}{k}" for k in ("", " (2)", " (3)") for name in ("lower plate", "drop"))
    assert frames.mesh.static.tolist() == [False] * 2 + [True] * 4 and not frames.mesh.self_collision.any()
    assert frames.mesh.kinematic.tolist() == [False, True] + [False] * 4
    assert repr(frames).startswith("Frames(CollisionMesh(6 bodies (lower plate, drop, ")
    frames = ccd.read_frames(*paths, self_collision=False)
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    assert result.toi == pytest.approx(0.5, abs=1e-5) and result.toi <= 0.5
    assert {*result.first.body_names} == {"lower plate", "drop"}


@pytest.mark.parametrize(
    "text, names, counts",
    [
        # As a mesh that is cut into groups by material: a body cannot own half a vertex.
        ("o shirt\ng front\n{}f 1 2 3\ng back\nf 2 4 3\no ball\n{}f 5 6 7\n", ("shirt", "ball"), [2, 1]),
        ("g front\n{}f 1 2 3\ng back\nf 2 4 3\n", ("a.obj",), [2]),
        # What looks like a label.
        ("o a#o no\n{}g\nf 1 2 3 4\n\to  b c \r\n{}# o comment\nf 5/1 6/1 7/1 8/1\n", ("a", "b c"), [2, 2]),
    ],
)
def test_labels_of_an_obj_are_bodies_where_these_share_no_vertex(tmp_path, text, names, counts):
    mesh = _read(tmp_path / "a.obj", text.replace("{}", _vertices(np.arange(12.0).reshape(4, 3)))).mesh
    assert mesh.names == names and np.bincount(mesh.face_body).tolist() == counts


def test_vertices_of_bodies_are_found_again_in_the_file(tmp_path):
    """Faces of two groups in turn, whose vertices lie in turn, and one that no face uses."""
    vertices = np.random.default_rng(0).uniform(size=(7, 3))
    text = _vertices(vertices) + "g even\nf 1 3 5\ng odd/side\nf 2 4 6\ng even\nf 5 3 1\n"
    frames = _read(tmp_path / "a.obj", text)
    assert frames.mesh.names == ("even", "odd/side") and frames.source_index.tolist() == [0, 2, 4, 1, 3, 5, 6]
    assert frames.mesh.faces.tolist() == [[0, 1, 2], [2, 1, 0], [3, 4, 5]]
    assert np.array_equal(frames.vertices_t0, vertices[frames.source_index])


def test_lines_and_points_of_files_are_cables_and_particles(tmp_path):
    """Beside a face, too; a file of vertices alone, of which another could have been cut, is one of PLY."""
    rope, drops = _vertices(np.arange(9.0).reshape(3, 3)), _vertices(np.arange(6.0).reshape(2, 3) + 50.0)
    text = f"o rope\n{rope}l -3 -2 -1\no drops\n{drops}p -2 -1\n" + _obj(("o face", TRIANGLE + 90.0))
    mesh = _read(tmp_path / "a.obj", text).mesh
    assert mesh.names == ("rope", "drops", "face") and mesh.num_faces == 1
    assert mesh.vertex_body[mesh.edges[mesh.codimensional_edges]].tolist() == [[0, 0]] * 2
    assert mesh.vertex_body[mesh.codimensional_points].tolist() == [1, 1] and not len(mesh.unused_vertices)
    cloud = _read(tmp_path / "b.ply", polygon_file("b.ply", TRIANGLE, [])).mesh
    assert cloud.codimensional_points.tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match="holds no triangles"):
        _read(tmp_path / "a.obj", rope)


def test_objects_of_a_3mf_stand_as_often_as_its_build_says(tmp_path, monkeypatch):
    """An object that is a component twice, and two items of one part number, of which trimesh from 4.9 on reads one."""
    of_extra("lxml")
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in TRIANGLE)
    triangles = '<triangles><triangle v1="0" v2="1" v3="2"/></triangles>'
    objects = f'<object id="1"><mesh><vertices>{vertices}</vertices>{triangles}</mesh></object>'
    objects += '<object id="2"><components><component objectid="1"/><component objectid="1" '
    objects += 'transform="1 0 0 0 1 0 0 0 1 0 0 9"/></components></object>'

    def read(*items):
        with zipfile.ZipFile(tmp_path / "a.3mf", "w") as archive:
            build = "".join(f"<item {item}/>" for item in items)
            archive.writestr(
                "3D/3dmodel.model",
                '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
                f"<resources>{objects}</resources><build>{build}</build></model>",
            )
        return _read(tmp_path / "a.3mf").vertices_t0

    far = 'transform="1 0 0 0 1 0 0 0 1 0 0 5"'
    assert np.unique(read('objectid="2"', f'objectid="1" {far}')[:, 2]).tolist() == [0.0, 5.0, 9.0]
    of_one_number = f'objectid="1" partnumber="a" {far}'
    try:
        assert np.unique(read('objectid="1" partnumber="a"', of_one_number)[:, 2]).tolist() == [0.0, 5.0]
    except ValueError as error:
        assert "says that it has 2 triangles, and 1 of its build are read" in str(error)
    with pytest.raises(ValueError, match="its object '1' is in no item of its build"):
        read()
    monkeypatch.setattr("ccd_warp._files.threemf._MOST_BYTES", 100)
    with pytest.raises(ValueError, match=r"a.3mf: holds \d+ bytes when unpacked; expected at most 100"):
        read('objectid="2"')


# ---- Parts of a file that names none ---------------------------------------------------------------------------------


@pytest.fixture(params=["vtu", "vtk", "xdmf"])
def cubes(request, tmp_path):
    """Files of three hollow cubes above one another, cells of all in turn; the highest comes down on the middle one."""
    meshio = of_extra("meshio")
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    places = np.array([place for place in np.ndindex(3, 3, 3) if place != (1, 1, 1)])
    nodes = np.concatenate([np.array([*np.ndindex(4, 4, 4)]) / 3.0 + [0.0, 0.0, 2.0 * k] for k in range(3)])
    order = [k % 3 * 26 + k // 3 for k in range(78)]
    cells = np.concatenate([(places[:, None] + corners) @ [16, 4, 1] + 64 * k for k in range(3)])[order]
    end = nodes - 1.5 * np.outer(np.arange(192) >= 128, [0, 0, 1])
    paths = [tmp_path / f"{name}.{request.param}" for name in ("start", "end")]
    for path, x in zip(paths, (nodes, end), strict=True):
        meshio.Mesh(x, [("hexahedron", cells)]).write(path)
    return paths, nodes, end


def test_what_hangs_together_by_its_cells_is_a_body(cubes):
    paths, nodes, end = cubes
    frames = ccd.read_frames(*paths, surface=True, split=True, static=paths[:1])
    names = [f"{paths[0].name}#{k}" for k in range(3)]
    assert frames.mesh.names == (*names, *(f"{name} (2)" for name in names))
    assert frames.mesh.body_vertex_range.tolist() == [64 * k for k in range(7)]
    assert np.array_equal(frames.vertices_t0, nodes[frames.source_index])
    assert np.array_equal(frames.vertices_t1[:192], end[frames.source_index[:192]])
    frames = ccd.read_frames(*paths, surface=True, split=True, kinematic=names[1:2])
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    assert result.toi == pytest.approx(2 / 3) and {*result.first.body_names} == {names[1], names[2]}


def test_a_soup_and_a_group_are_split_by_what_shares_a_vertex(tmp_path):
    boxes = [trimesh.creation.box().apply_translation([3.0 * k, 0, 0]) for k in range(3)]
    trimesh.util.concatenate(boxes).export(tmp_path / "a.stl")
    frames = _read(tmp_path / "a.stl", split=True)
    assert frames.mesh.names == ("a.stl#0", "a.stl#1", "a.stl#2") and frames.num_merged.tolist() == [28, 28, 28]
    assert (np.diff(frames.source_index) > 0).all()  # in the order in which they first appear
    text = _obj(("o two", TRIANGLE), ("", TRIANGLE + 3.0), ("o one", TRIANGLE + 6.0))
    assert _read(tmp_path / "a.obj", text, split=True).mesh.names == ("two#0", "two#1", "one")
