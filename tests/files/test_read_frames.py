"""Frames of a step read from files in Python, with the readers of the command line."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._files.frames import write_mesh


@pytest.fixture
def files(tmp_path):
    """A ball that falls on a box, as PLY in double precision and as STL."""
    ball, box = trimesh.creation.icosphere(subdivisions=1), trimesh.creation.box(extents=(4.0, 4.0, 1.0))
    rng = np.random.default_rng(0)
    start = ball.vertices + [0.1, 0.2, 3.0] + 1e-12 * rng.standard_normal(ball.vertices.shape)
    for name, vertices in (("start", start), ("end", start - [0, 0, 3.0])):
        write_mesh(tmp_path / f"{name}.ply", vertices, ball.faces)
        trimesh.Trimesh(vertices, ball.faces, process=False).export(tmp_path / f"{name}.stl")
    write_mesh(tmp_path / "box.ply", box.vertices, box.faces)
    return tmp_path, start, ball, box


def test_frames_hold_every_bit_of_the_file_and_go_to_every_function(files):
    folder, start, _, box = files
    frames = ccd.read_frames(folder / "start.ply", folder / "end.ply", static=[folder / "box.ply", folder / "box.ply"])
    assert frames.mesh.names == ("start.ply", "box.ply", "box.ply (2)")
    assert frames.mesh.static.tolist() == [False, True, True]
    assert np.array_equal(frames.vertices_t0[:42], start) and np.array_equal(frames.vertices_t1[:42], start - [0, 0, 3])
    assert np.array_equal(frames.vertices_t0[42:], np.tile(box.vertices, (2, 1)))
    assert frames.num_merged.tolist() == [0, 0, 0]
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    assert 0.49 < result.toi < 0.51 and {*result.first.body_names} <= {*frames.mesh.names}
    assert repr(frames).startswith("Frames(CollisionMesh(3 bodies (start.ply, box.ply, box.ply (2)), 58 vertices")


def test_vertices_of_a_file_that_are_in_no_face_meet_nothing(tmp_path):
    """One that would fly through the table, and one that is no number."""
    for name, z, stray in (("a", 5.0, "0 0 1"), ("b", 3.0, "0 0 -1")):
        text = f"v 50 0 {z}\nv 51 0 {z}\nv nan 0 0\nv 50 1 {z}\nv {stray}\nf 1 2 4\n"
        (tmp_path / f"{name}.obj").write_text(text)
    (tmp_path / "table.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nv 0 0 99\nf 1 2 3\n")
    frames = ccd.read_frames(tmp_path / "a.obj", tmp_path / "b.obj", static=[tmp_path / "table.obj"])
    assert "3 vertices take no part" in repr(frames)
    assert ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1).toi == np.inf
    sequence = ccd.read_sequence([tmp_path / "a.obj", tmp_path / "b.obj"])
    assert sequence.mesh.unused_vertices.tolist() == [2, 4] and np.isnan(sequence[1][2, 0])


def test_bodies_of_frames_may_be_kinematic(files):
    folder, *_ = files
    paths = folder / "start.ply", folder / "end.ply"
    frames = ccd.read_frames(*paths, static=[folder / "box.ply"], kinematic=["start.ply"])
    assert frames.mesh.kinematic.tolist() == [True, False] and frames.mesh.static.tolist() == [False, True]
    assert ccd.collision_free_step(frames.mesh, frames.vertices_t0, frames.vertices_t1) == 1.0


def test_corners_of_stl_files_are_merged(files):
    folder, *_ = files
    frames = ccd.read_frames(str(folder / "start.stl"), str(folder / "end.stl"), self_collision=False)
    assert frames.mesh.num_vertices == 42 and frames.mesh.num_edges == 120 and frames.num_merged.tolist() == [198]
    assert frames.source_index.shape == (42,) and "198 vertices merged" in repr(frames)
    assert not frames.mesh.self_collision.any()


def test_files_that_do_not_fit_are_refused_in_one_line(files):
    folder, *_ = files
    for arguments, message in (
        ((folder / "start.ply", folder / "box.ply"), "topology differs"),
        ((folder / "start.ply", folder / "none.ply"), r"none\.ply: no such file"),
        ((folder / "start.ply", 7), "end_path is 7; expected a path"),
    ):
        with pytest.raises(ValueError, match=message) as error:
            ccd.read_frames(*arguments)
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"static is 'box\.ply'; expected a list of paths and half-spaces"):
        ccd.read_frames(folder / "start.ply", folder / "end.ply", static="box.ply")
