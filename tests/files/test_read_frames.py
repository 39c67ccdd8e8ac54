"""Frames of a step read from files in Python, and what is warned of where two frames are odd."""

import re
import warnings

import numpy as np
import pytest
import trimesh
from mesh_files import ply

import ccd_warp as ccd

BALL = trimesh.creation.icosphere(subdivisions=1)
START = BALL.vertices + [0.1, 0.2, 3.0] + 1e-12 * np.random.default_rng(0).standard_normal(BALL.vertices.shape)


@pytest.fixture
def folder(tmp_path):
    """A ball that falls on a box, as PLY in double precision."""
    box = trimesh.creation.box(extents=(4.0, 4.0, 1.0))
    for name, x in (("start", START), ("end", START - [0, 0, 3.0])):
        (tmp_path / f"{name}.ply").write_bytes(ply(x, BALL.faces))
    (tmp_path / "box.ply").write_bytes(ply(box.vertices, box.faces))
    return tmp_path


def test_frames_go_to_every_function(folder):
    paths, box = (folder / "start.ply", str(folder / "end.ply")), folder / "box.ply"
    frames = ccd.read_frames(*paths, static=[box, box], kinematic=["start.ply"], self_collision=False)
    assert frames.mesh.names == ("start.ply", "box.ply", "box.ply (2)")
    assert frames.mesh.static.tolist() == [False, True, True]
    assert frames.mesh.kinematic.tolist() == [True, False, False] and not frames.mesh.self_collision.any()
    assert repr(frames).startswith("Frames(CollisionMesh(3 bodies (start.ply, box.ply, box.ply (2)), 58 vertices")
    frames = ccd.read_frames(*paths, static=[box])
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    assert 0.49 < result.toi < 0.51 and {*result.first.body_names} <= {*frames.mesh.names}


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


def said(folder, start, end, names=("a_1.ply", "a_2.ply")):
    """What is warned of for two frames of the ball, in the line of the caller."""
    for name, x in zip(names, (start, end), strict=True):
        (folder / name).write_bytes(ply(x, BALL.faces))
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        ccd.read_frames(*(folder / name for name in names))
    assert all(each.filename == __file__ for each in record)
    return [str(each.message) for each in record]


def test_frames_in_different_units_and_renumbered_vertices_are_warned_of(tmp_path):
    (unit,) = said(tmp_path, START, 1000.0 * START)
    assert re.fullmatch(r"the bodies that move are 2 long .* 2000 at the end of the step; are both .* unit\?", unit)
    order = np.random.default_rng(1).permutation(len(START))
    renumbered = "the vertices of a_1.ply are at the same places at the start and at the end .*; were they renumbered"
    for offset in (0.0, 1e6):
        sentence, *_ = said(tmp_path, START + offset, START[order] + offset)
        assert re.match(renumbered, sentence)
    for end in (START, START - [0, 0, 3.0], np.nextafter(START[order], 9.0), 30.0 * START):
        assert not any("renumbered" in each or "unit" in each for each in said(tmp_path, START, end))


def test_frames_in_the_other_order_are_warned_of(tmp_path):
    (swapped,) = said(tmp_path, START, START, names := ("a 10.ply", "a 9.ply"))
    assert swapped.startswith("the step goes from a 10.ply to a 9.ply; are the two swapped?")
    assert said(tmp_path, START, START, names[::-1]) == []
