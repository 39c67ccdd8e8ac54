"""Frames of a step read from files in Python, with the readers of the command line."""

import re
import warnings

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


def _said(folder, start, end):
    faces = trimesh.creation.icosphere(subdivisions=1).faces
    write_mesh(folder / "a_1.ply", start, faces)
    write_mesh(folder / "a_2.ply", end, faces)
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        ccd.read_frames(folder / "a_1.ply", folder / "a_2.ply")
    assert all(each.filename == __file__ for each in record)
    return [str(each.message) for each in record]


def test_frames_in_different_units_and_renumbered_vertices_are_warned_of(files):
    folder, start, *_ = files
    (unit,) = _said(folder, start, 1000.0 * start)
    assert re.fullmatch(r"the bodies that move are 2 long .* 2000 at the end of the step; are both .* unit\?", unit)
    order = np.random.default_rng(1).permutation(len(start))
    renumbered = "the vertices of a_1.ply are at the same places at the start and at the end .*; were they renumbered"
    for offset in (0.0, 1e6):
        sentence, *_ = _said(folder, start + offset, start[order] + offset)
        assert re.match(renumbered, sentence)
    for end in (start, start - [0, 0, 3.0], np.nextafter(start[order], 9.0), 30.0 * start):
        assert not any("renumbered" in each or "unit" in each for each in _said(folder, start, end))


def test_bodies_that_change_places_are_warned_of(tmp_path):
    """As where a program writes the objects of the second frame in another order."""
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for name, heights in (("a_1", (0, 5)), ("a_2", (5, 0))):
        blocks = [triangle + [0, 0, height] for height in heights]
        rows = [f"o {k}\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in block) for k, block in enumerate(blocks)]
        faces = [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}\n" for k in range(2)]
        (tmp_path / f"{name}.obj").write_text("".join(row + face for row, face in zip(rows, faces, strict=True)))
    with pytest.warns(RuntimeWarning, match="^the vertices of all bodies that move are at the same places"):
        ccd.read_frames(tmp_path / "a_1.obj", tmp_path / "a_2.obj")


def test_frames_in_the_other_order_are_warned_of(files):
    folder, start, ball, _ = files
    for first, second in (("a 10.ply", "a 9.ply"), ("End of a.ply", "start of a.ply"), ("a_new.ply", "a_old.ply")):
        for name in (first, second):
            write_mesh(folder / name, start, ball.faces)
        with pytest.warns(RuntimeWarning, match=f"the step goes from {first} to {second}; are the two swap") as said:
            ccd.read_frames(folder / first, folder / second)
        assert len(said) == 1 and said[0].filename == __file__
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ccd.read_frames(folder / second, folder / first)


def test_steps_of_a_sequence_are_warned_of_once_each(files, recwarn):
    folder, start, ball, _ = files
    for k, size in enumerate((1.0, 1.0, 1e-3, 1.0)):
        write_mesh(folder / f"b_{k}.ply", size * start, ball.faces)
    sequence = ccd.read_sequence([folder / f"b_{k}.ply" for k in range(4)])
    for _ in range(2):
        assert len([*sequence]) == 4 and len([*sequence.steps()]) == 3
    said = [str(each.message).partition(" at the start")[0] for each in recwarn]
    assert said == ["the bodies that move are 2 long", "the bodies that move are 0.002 long"]
