"""The command `ccd-warp`: what it prints, what it writes, and how it refuses bad input."""

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from exact import exact_tois
from published import DATA, requires_data, simulation_boxes, simulation_queries, simulation_step

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._files.frames import read_frames, read_static, write_mesh
from ccd_warp._input.options import Options

# A ball of radius 0.5 comes down five units onto a box whose top is at z = 0; it touches after 1.5 units.
EXACT_TOI = 0.3


@pytest.fixture
def scene(tmp_path):
    """Files of the ball at both ends of the step, and of the box."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    box = trimesh.creation.box(extents=(4.0, 4.0, 1.0))
    write_mesh(tmp_path / "start.ply", ball.vertices + [0.1, 0.2, 2.0], ball.faces)
    write_mesh(tmp_path / "end.ply", ball.vertices + [0.1, 0.2, -3.0], ball.faces)
    write_mesh(tmp_path / "floor.ply", box.vertices - [0.0, 0.0, 0.5], box.faces)
    return tmp_path


def _run(scene, *options):
    return main(["run", str(scene / "start.ply"), str(scene / "end.ply"), *map(str, options)])


def _expected(scene, **options):
    """The same run through the Python interface, with the length scale of the bodies at the start."""
    bodies = [read_frames(scene / "start.ply", scene / "end.ply"), read_static(scene / "floor.ply")]
    mesh = ccd.CollisionMesh.from_trimesh(
        [trimesh.Trimesh(body.vertices_t0, body.faces, process=False) for body in bodies], static=[1]
    )
    frames = [np.vstack([getattr(body, end) for body in bodies]) for end in ("vertices_t0", "vertices_t1")]
    return mesh, ccd.mesh_ccd(mesh, *frames, length_scale=float(np.ptp(mesh.vertices, axis=0).max()), **options)


def _refused(capfd, *arguments) -> str:
    """The one line of a refused command line."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("ccd-warp: error: ") and captured.err.endswith("\n")
    assert captured.err.count("\n") == 1
    return captured.err


def test_report_names_bodies_toi_counts_and_stages(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply") == 0
    assert "candidates" not in capfd.readouterr().out
    assert _run(scene, "--static", scene / "floor.ply", "--verbose") == 0
    captured = capfd.readouterr()
    assert captured.err == ""
    _, result = _expected(scene)
    assert f"scene toi  {float(result.toi)!r}" in captured.out
    assert result.toi <= EXACT_TOI
    assert result.toi >= EXACT_TOI - 1e-5  # the tolerance, 1e-6 of a motion six units long, over the speed of five
    for word in ("start.ply", "floor.ply", "moving", "static", "first contact", "read files", "load kernels", "total"):
        assert word in captured.out
    lines = [line.split() for line in captured.out.splitlines()]
    assert ["active", "bodies", "2"] in lines and ["vertices", f"{result.counts.num_vertices:,}"] in lines
    assert ["edge-edge", "candidates", f"{result.counts.num_candidates[ccd.PairKind.EDGE_EDGE]:,}"] in lines
    assert ["vertex-face", "contacts", f"{result.counts.num_contacts[ccd.PairKind.VERTEX_FACE]:,}"] in lines
    assert "codimensional" not in captured.out
    for name in result.timings:
        assert name.replace("_", " ") in captured.out


def test_no_collision_is_a_finished_run(scene, capfd):
    assert _run(scene) == 0
    assert "scene toi  none" in capfd.readouterr().out


def test_vertices_in_no_face_take_no_part_and_the_report_says_how_many(scene, capfd):
    """Below the floor at the end, far away, and no number: neither the toi nor a length of the report is of them."""
    reports = []
    for strays in ([], [[0.0, 0, 9], [1e9, 0, 0], [np.nan] * 3]):
        for path in (scene / "start.ply", scene / "end.ply"):
            mesh = read_static(path)
            write_mesh(path, np.vstack([mesh.vertices_t0, *np.reshape(strays, (-1, 1, 3))]), mesh.faces)
            strays = [[0.0, 0, -9], *strays[1:]] if strays else strays
        assert _run(scene, "--static", scene / "floor.ply", "--picture", scene / "step.png") == 0
        captured = capfd.readouterr()
        reports.append(captured.out.splitlines())
        assert captured.err == ""
    wanted = ("scene toi", "extents at the start", "largest displacement", "length scale")
    lengths = [[line for line in report if line.strip().startswith(wanted)] for report in reports]
    assert lengths[0] == lengths[1] and len(lengths[0]) == 4
    assert "  (3 vertices of start.ply in no face take no part)" in reports[1]
    assert not any("no part" in line for line in reports[0])


def test_quiet_prints_nothing(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--quiet") == 0
    assert capfd.readouterr() == ("", "")


def test_kinematic_bodies_are_not_tested_with_static_ones(scene, capfd):
    arguments = ("--static", scene / "floor.ply", "--kinematic", "start.ply")
    assert _run(scene, *arguments, "--fail-on-contact") == 0
    out = capfd.readouterr().out
    assert "kinematic" in out and "pairs of static and kinematic bodies" in out
    for name in ("wall", "floor.ply"):  # nobody, and one that does not move
        message = _refused(capfd, "run", scene / "start.ply", scene / "end.ply", *arguments[:2], "--kinematic", name)
        assert f"--kinematic {name}: no body that moves has this name; expected one of start.ply" in message


def test_any_number_of_obstacles(scene, capfd):
    write_mesh(scene / "far.ply", np.eye(3) + 50.0, np.array([[0, 1, 2]]))
    """One a time, before the frames or after them; a second of the same name is told apart."""
    obstacles = ["--static", str(scene / "far.ply"), "--static", str(scene / "floor.ply")]
    after = ["--static", str(scene / "far.ply")]
    assert main(["run", *obstacles, str(scene / "start.ply"), str(scene / "end.ply"), *after]) == 0
    out = capfd.readouterr().out
    assert "\n  far.ply      static" in out and "\n  far.ply (2)  static" in out
    # Two files after one --static would be taken for frames.
    assert "--help" in _refused(capfd, "run", scene / "start.ply", scene / "end.ply", "--static", "a.ply", "b.ply")


def test_npz_holds_the_result_bit_for_bit(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--output", scene / "out.npz") == 0
    assert "out.npz" in capfd.readouterr().out
    mesh, result = _expected(scene)
    with np.load(scene / "out.npz") as data:
        assert data["toi"] == result.toi
        assert np.array_equal(data["vertex_toi"], result.vertex_toi)
        assert np.array_equal(data["body_toi"], result.body_toi)
        assert np.array_equal(data["faces"], mesh.faces) and np.array_equal(data["edges"], mesh.edges)
        assert len(data["contact_toi"]) == len(result.contacts.toi) > 0
        assert data["contact_toi"].min() == result.toi
        for name in ("kind", "primitives", "vertices", "parameters", "normal", "status"):
            assert len(data[f"contact_{name}"]) == len(result.contacts.toi)
        kind, primitives, corners = (data[f"contact_{name}"] for name in ("kind", "primitives", "vertices"))
        first, second = primitives[kind == ccd.PairKind.VERTEX_FACE].T
        assert np.array_equal(corners[kind == 0], np.column_stack([first, mesh.faces[second]]))
        first, second = primitives[kind == ccd.PairKind.EDGE_EDGE].T
        assert np.array_equal(corners[kind == 1], np.hstack([mesh.edges[first], mesh.edges[second]]))
        assert data["body_name"].tolist() == ["start.ply", "floor.ply"]
        assert data["body_first_vertex"].tolist() == [0, 162]


def test_json_is_strict_and_holds_the_result_bit_for_bit(scene):
    assert _run(scene, "--static", scene / "floor.ply", "--output", scene / "out.json", "--quiet") == 0

    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    data = json.loads((scene / "out.json").read_text(), parse_constant=refuse)
    _, result = _expected(scene)
    assert data["toi"] == result.toi
    assert [np.inf if toi is None else toi for toi in data["vertex_toi"]] == result.vertex_toi.tolist()
    assert [body["name"] for body in data["bodies"]] == ["start.ply", "floor.ply"]
    assert [body["static"] for body in data["bodies"]] == [False, True]
    assert sorted(contact["toi"] for contact in data["contacts"]) == sorted(result.contacts.toi.tolist())
    assert {contact["kind"] for contact in data["contacts"]} <= {"vertex_face", "edge_edge"}
    counts = data["counts"]
    assert counts["num_faces"] == result.counts.num_faces
    assert counts["num_after_cull"]["edge_edge"] == result.counts.num_after_cull[ccd.PairKind.EDGE_EDGE]
    assert counts.keys() == vars(result.counts).keys()


def test_csv_comes_as_contacts_and_vertices(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--output", scene / "out.csv") == 0
    printed = capfd.readouterr().out
    assert "out.csv" in printed and "out_vertices.csv" in printed
    _, result = _expected(scene)
    with (scene / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sorted(float(row["toi"]) for row in rows) == sorted(result.contacts.toi.tolist())
    with (scene / "out_vertices.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["toi"]) for row in rows] == result.vertex_toi.tolist()


def test_standard_output_takes_the_json_alone(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--output", "-") == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["toi"] == _expected(scene)[1].toi
    assert captured.err.startswith("ccd-warp ") and "first contact" in captured.err
    assert _run(scene, "--output", "-", "--quiet") == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["toi"] is None and captured.err == ""


def test_exit_status_tells_a_script_of_a_contact(scene):
    assert _run(scene, "--static", scene / "floor.ply", "--fail-on-contact", "--quiet") == 1
    assert _run(scene, "--fail-on-contact", "--quiet") == 0


def test_every_format_says_where_the_first_contact_is_and_of_which_bodies(scene, capfd):
    """By ascending toi, with numbers within the bodies, and all that is needed to understand the numbers."""
    mesh, result = _expected(scene)
    for suffix in ("csv", "json", "npz"):
        output = ["--output", scene / f"out.{suffix}"]
        assert _run(scene, "--static", scene / "floor.ply", *output, "--minimum-separation", "0") == 0
    report = capfd.readouterr().out
    first = result.first
    point = first.point.tolist()
    assert f"at ({', '.join(f'{round(x, 13) + 0.0:.6g}' for x in point)})" in report
    data = json.loads((scene / "out.json").read_text())
    with (scene / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    with np.load(scene / "out.npz") as file:
        arrays = dict(file)
    for tois in ([float(row["toi"]) for row in rows], [row["toi"] for row in data["contacts"]], arrays["contact_toi"]):
        assert np.array_equal(tois, np.sort(result.contacts.toi))
    assert [float(rows[0][axis]) for axis in "xyz"] == data["contacts"][0]["point"] == point
    assert arrays["contact_point"][0].tolist() == point
    in_body = ["start.ply" if body == 0 else "floor.ply" for body in first.bodies]
    assert [rows[0]["body_0"], rows[0]["body_1"]] == data["contacts"][0]["bodies"] == in_body
    assert arrays["body_name"][arrays["contact_bodies"][0]].tolist() == in_body
    # The box has 12 faces, 8 vertices and 18 edges, whatever their numbers are behind those of the ball.
    for row in data["contacts"]:
        for side, name in enumerate(row["bodies"]):
            if name == "floor.ply":
                kind = row["kind"]
                size = 18 if kind == "edge_edge" else (8, 12)[side]
                assert 0 <= row["primitives_in_body"][side] < size
        first_vertex = mesh.body_vertex_range[mesh.vertex_body[row["vertices"]]]
        assert np.array_equal(row["vertices_in_body"] + first_vertex, row["vertices"])
    kinds = {"vertex_face": 0, "edge_edge": 1, "point_segment": 2, "point_point": 3, "vertex_plane": 4}
    options = json.loads(str(arrays["options"]))
    assert data["version"] == str(arrays["version"]) == ccd.__version__
    assert data["options"] == options and options["minimum_separation"] == 0.0 and options["length_scale"] > 0
    assert options.keys() == ccd.MeshOptions.__optional_keys__
    assert data["kinds"] == kinds and arrays["kind_name"].tolist() == list(kinds)
    assert data["units"]["length"] == json.loads(str(arrays["units"]))["length"] == "that of the files"


def test_a_face_is_numbered_within_its_body(tmp_path, capfd):
    """The third face of an obstacle that comes after a body of many faces."""
    floor = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    floors = np.vstack([floor - [9.0, 0, 0], floor - [6.0, 0, 0], floor])
    write_mesh(tmp_path / "floor.ply", floors, np.arange(9).reshape(-1, 3))
    drop = np.array([[0.2, 0.2, 1.0], [0.25, 0.2, 2.0], [0.2, 0.25, 2.0]])
    write_mesh(tmp_path / "start.ply", drop, [[0, 1, 2]])
    write_mesh(tmp_path / "end.ply", drop - [0, 0, 1.5], [[0, 1, 2]])
    assert _run(tmp_path, "--static", tmp_path / "floor.ply") == 0
    out = capfd.readouterr().out
    assert "first contact  vertex 0 of start.ply and face 2 of floor.ply\n               at (0.2, 0.2, " in out


def test_a_start_in_contact_is_said_in_a_sentence(tmp_path, capfd):
    floor = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    write_mesh(tmp_path / "floor.ply", floor, [[0, 1, 2]])
    drop = np.array([[0.2, 0.2, 0.0], [0.25, 0.2, 2.0], [0.2, 0.25, 2.0]])
    write_mesh(tmp_path / "start.ply", drop, [[0, 1, 2]])
    write_mesh(tmp_path / "end.ply", drop - [0, 0, 0.1], [[0, 1, 2]])
    assert _run(tmp_path, "--static", tmp_path / "floor.ply", "--pair-kinds", "vertex-face") == 0
    sentence = "1 pair is in contact at the start already, with toi 0: 1 of start.ply and floor.ply"
    assert f"at the start  {sentence}\n" in capfd.readouterr().out


def test_report_gives_the_lengths_in_the_unit_of_the_files(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--minimum-separation", "0.01", "--tolerance", "1e-3") == 0
    lines = [" ".join(line.split()) for line in capfd.readouterr().out.splitlines()]
    # The ball is at z = 2 with a radius of 0.5; the box, 4 x 4, reaches down to z = -1.
    assert "extents at the start 4 x 4 x 3.5" in lines and "largest displacement 5" in lines
    assert "length scale 4" in lines and "tolerance 0.004" in lines and "minimum separation 0.04" in lines
    assert _run(scene, "--minimum-separation", "0.01", "--length-scale", "2") == 0
    lines = [" ".join(line.split()) for line in capfd.readouterr().out.splitlines()]
    assert "length scale 2" in lines and "minimum separation 0.02" in lines


def test_report_says_where_surfaces_cross_at_the_start(tmp_path, capfd):
    """An edge through the inside of a face, and both at rest: no contact in CCD, and a start that is not sound."""
    face = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [0.5, 0.5, -1], [0.6, 0.5, 1], [0.5, 0.6, 2]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    write_mesh(tmp_path / "start.ply", face, faces)
    write_mesh(tmp_path / "end.ply", face, faces)
    assert _run(tmp_path) == 0
    out = capfd.readouterr().out
    assert "scene toi  none   (certain for the pairs looked at: " in out
    assert "at the start  2 edges pass through a face, so surfaces cross: 2 within start.ply\n" in out
    assert "not seen  what surfaces that cross at the start already do after it" in out
    assert _run(tmp_path, "--fail-on-contact", "--output", tmp_path / "out.json") == 1
    expected = [{"bodies": ["start.ply", "start.ply"], "edges_through_faces": 2}]
    assert json.loads((tmp_path / "out.json").read_text())["crossing_at_start"] == expected
    assert capfd.readouterr().err == ""
    write_mesh(tmp_path / "end.ply", face + 2.0 * np.eye(3)[[2]] * (np.arange(6) > 2)[:, None], faces)
    assert _run(tmp_path) == 0
    assert "warning: surfaces cross at the start of the step and not at its end; are START" in capfd.readouterr().err


def test_report_says_where_no_edge_passes_through_a_face(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--output", scene / "out.npz") == 0
    assert "at the start  no edge passes through a face\n" in capfd.readouterr().out
    with np.load(scene / "out.npz") as data:
        assert data["crossing_at_start"].shape == (0, 2)


def test_frames_in_different_units_are_warned_of(scene, capfd):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    write_mesh(scene / "end.ply", 1000.0 * ball.vertices, ball.faces)
    assert _run(scene) == 0
    error = capfd.readouterr().err
    assert error.startswith(
        "ccd-warp: warning: the bodies that move are 1 long at the start and 1000 at the end of the"
    )
    assert error.count("\n") == 1
    assert _run(scene, "--quiet") == 0
    assert capfd.readouterr().err == ""


def test_vertices_in_another_order_and_frames_in_the_other_are_warned_of(scene, capfd):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    write_mesh(scene / "end.ply", (ball.vertices + [0.1, 0.2, 2.0])[::-1], ball.faces)
    assert _run(scene) == 0
    renumbered, *_ = capfd.readouterr().err.splitlines()
    assert "the vertices of start.ply are at the same places at the start and at the end of the step" in renumbered
    assert main(["run", str(scene / "end.ply"), str(scene / "start.ply")]) == 0
    swapped, *_ = capfd.readouterr().err.splitlines()
    assert swapped.startswith("ccd-warp: warning: the step goes from end.ply to start.ply; are the two swapped?")
    assert main(["run", str(scene / "end.ply"), str(scene / "start.ply"), "--quiet"]) == 0
    assert capfd.readouterr().err == ""


def test_a_rotation_that_shrinks_edges_is_warned_of(scene, capfd):
    """Half a turn moves every vertex through the middle; an eighth of one leaves edges nine tenths of their length."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    for angle, is_odd in ((np.pi, True), (np.pi / 4, False)):
        turn = trimesh.transformations.rotation_matrix(angle, [0.3, 0.2, 1.0])[:3, :3]
        write_mesh(scene / "start.ply", ball.vertices, ball.faces)
        write_mesh(scene / "end.ply", ball.vertices @ turn.T, ball.faces)
        assert _run(scene) == 0
        error = capfd.readouterr().err
        assert ("edges shrink to a tenth or less within the step" in error) == is_odd
        assert ("take smaller steps" in error) == is_odd


def test_defaults_and_choices_in_the_help_are_those_of_the_library(capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    # Each option is in one line, or in two where its name is long.
    text = re.sub(r"\n {20,}", " ", capfd.readouterr().out)
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip().startswith("--")}
    options = Options()
    for name in ("tolerance", "minimum_separation", "t_max", "max_iterations", "max_work", "precision", "method"):
        default = getattr(options, name)
        shown = f"({default:g})" if isinstance(default, float) else f"({default})"
        assert lines[f"--{name.replace('_', '-')}"].endswith(shown)
    assert "length that tolerance and minimum separation are multiples of" in lines["--length-scale"]
    assert "{float64,float32}" in lines["--precision"] and "{clipping,bisection}" in lines["--method"]


def test_json_of_a_run_without_contacts(scene):
    assert _run(scene, "--output", scene / "out.json", "--quiet") == 0
    data = json.loads((scene / "out.json").read_text())
    assert data["toi"] is None and data["contacts"] == []


def test_options_reach_the_library(scene, capfd):
    assert _run(scene, "--static", scene / "floor.ply", "--t-max", "0.25") == 0
    out = capfd.readouterr().out
    assert "scene toi  none   (certain for the pairs looked at: vertex-face and edge-edge, in [0, 0.25])" in out
    options = ["--minimum-separation", "0.01", "--length-scale", "1", "--tolerance", "1e-9", "--num-threads", "1"]
    assert _run(scene, "--static", scene / "floor.ply", *options, "--output", scene / "out.json", "--quiet") == 0
    toi = json.loads((scene / "out.json").read_text())["toi"]
    # The ball stops a gap of 0.01 earlier, at a speed of five; the tolerance is 1e-9.
    assert EXACT_TOI - 0.002 - 1e-6 <= toi <= EXACT_TOI - 0.002


def test_kinds_and_memory_limit_reach_the_library(scene, capfd):
    arguments = ("--static", scene / "floor.ply", "--pair-kinds", "edge-edge", "--memory-limit", "64000000")
    assert _run(scene, *arguments, "--verbose") == 0
    out = capfd.readouterr().out
    assert "edge-edge candidates" in out and "vertex-face candidates" not in out
    assert "left out  vertex-face pairs (--pair-kinds); pairs of static bodies; pairs that share a vertex" in out
    arguments = ("run", scene / "start.ply", scene / "end.ply", "--static", scene / "floor.ply", "--memory-limit", "9")
    assert "memory_limit is 9 bytes; expected at least" in _refused(capfd, *arguments)


def test_float32_is_no_later(scene):
    arguments = ("--static", scene / "floor.ply", "--precision", "float32", "--output", scene / "out.json", "--quiet")
    assert _run(scene, *arguments) == 0
    toi = json.loads((scene / "out.json").read_text())["toi"]
    assert EXACT_TOI - 1e-4 <= toi <= EXACT_TOI  # some 2**-24 of the motion of six units, times a small constant


def test_radii_of_bodies_add_to_the_distance_that_is_kept(scene, capfd):
    arguments = ("--static", scene / "floor.ply", "--output", scene / "out.json")
    found = []
    for lengths in (("--minimum-distance", "0.375"), ("--radius", "0.125", "--radius", "floor.ply=0.25")):
        assert _run(scene, *arguments, *lengths) == 0
        found.append(json.loads((scene / "out.json").read_text()))
    assert found[0]["toi"] == found[1]["toi"] < EXACT_TOI
    assert [body["radius"] for body in found[1]["bodies"]] == [0.125, 0.25]
    assert "radius" not in found[0]["bodies"][0]
    assert "0.125 to 0.25" in capfd.readouterr().out


def test_self_collision_can_be_left_out(tmp_path, capfd):
    # Two sheets of one mesh pass through each other.
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    faces = np.arange(6).reshape(-1, 3)
    write_mesh(tmp_path / "start.ply", square, faces)
    write_mesh(tmp_path / "end.ply", np.roll(square, 3, axis=0), faces)
    assert _run(tmp_path) == 0
    assert "scene toi  none" not in capfd.readouterr().out
    assert _run(tmp_path, "--no-self-collision") == 0
    assert "scene toi  none" in capfd.readouterr().out


def test_files_that_do_not_match_are_refused(scene, capfd):
    error = _refused(capfd, "run", scene / "start.ply", scene / "floor.ply")
    assert "start.ply has 162 vertices and 320 faces" in error and "floor.ply has 8 vertices and 12 faces" in error


def test_missing_file_is_refused(scene, capfd):
    assert "nowhere.ply: no such file" in _refused(capfd, "run", scene / "nowhere.ply", scene / "end.ply")
    arguments = ("run", scene / "start.ply", scene / "end.ply", "--static", scene / "gone.obj")
    assert "gone.obj: no such file" in _refused(capfd, *arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--tolerance", "0"), "tolerance"),
        (("--tolerance", "nan"), "tolerance"),
        (("--tolerance", "small"), "--tolerance"),
        (("--minimum-separation", "-1"), "minimum_separation"),
        (("--minimum-distance", "-1"), "minimum_distance"),
        (("--minimum-distance", "1", "--minimum-separation", "1"), "minimum_distance"),
        (("--radius", "-1"), "radius holds -1.0"),
        (("--radius", "start.ply=nan"), "radius holds nan"),
        (("--radius", "thin"), "--radius thin: expected a number"),
        (("--radius", "ghost=1"), "--radius ghost=1: no body has this name; expected one of start.ply"),
        (("--radius", "1", "--minimum-separation", "1"), "minimum_separation is 1.0 and the mesh has a radius"),
        (("--t-max", "2"), "t_max"),
        (("--max-iterations", "0"), "max_iterations"),
        (("--length-scale", "-1"), "length_scale"),
        (("--precision", "float16"), "--precision"),
        (("--broad-phase", "grid"), "--broad-phase"),
        (("--device", "abacus"), "device"),
        (("--num-threads", "0"), "num_threads"),
        (("--pair-kinds", "face-face"), "pair_kinds"),
        (("--pair-kinds", "point-point"), "point-point, which these bodies cannot form"),
        (("--memory-limit", "0"), "memory_limit"),
        (("--output", "result.txt"), ".npz, .json, .csv"),
        (("--output", "no_such_folder/result.npz"), "does not exist"),
        (("--wibble",), "--wibble"),
    ],
)
def test_bad_options_are_refused_in_one_line(scene, capfd, arguments, words):
    assert words in _refused(capfd, "run", scene / "start.ply", scene / "end.ply", *arguments)


@pytest.mark.parametrize("arguments", [(), ("jump",), ("run",), ("run", "one.ply")])
def test_incomplete_command_lines_are_refused_in_one_line(capfd, arguments):
    assert "--help" in _refused(capfd, *arguments)


@pytest.mark.parametrize(
    "arguments",
    [("--help",), *((name, "--help") for name in ("run", "sequence", "demo", "explore", "bench")), ("--version",)],
)
def test_help_and_version_end_well(capfd, arguments):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 0
    captured = capfd.readouterr()
    assert captured.err == ""
    assert captured.out.strip()
    if arguments == ("--version",):
        assert captured.out == f"ccd-warp {ccd.__version__}\n"


def test_help_and_reports_are_spelled_where_a_terminal_knows_ascii_alone(scene, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    for name in ("run", "sequence", "demo", "explore", "bench"):
        with pytest.raises(SystemExit):
            main([name, "--help"])
    for name in ("start", "end"):
        shutil.copy(scene / f"{name}.ply", scene / f"{name} é.ply")
    obstacles = [each for _ in range(40) for each in ("--static", str(scene / "floor.ply"))]
    assert main(["run", str(scene / "start é.ply"), str(scene / "end é.ply"), *obstacles]) == 0
    assert main(["run", str(scene / "none é.ply"), str(scene / "end é.ply")]) == 2
    out = written.getvalue().decode("ascii")
    assert "cpu, cuda, cuda:1, ... (" in out and "  ... 11 more bodies" in out and "start \\xe9.ply" in out
    assert sys.stdout.errors == "strict"


def test_demo_says_miss_and_gives_the_toi(tmp_path, capfd):
    assert main(["demo", "--output-dir", str(tmp_path / "new" / "folder")]) == 0
    captured = capfd.readouterr()
    assert captured.err == ""
    assert captured.out.count("MISS") == 2 and "HIT" not in captured.out
    assert "toi = 0.4" in captured.out
    assert "cloth over a sphere" in captured.out
    folder = tmp_path / "new" / "folder"
    data = json.loads((folder / "bullet.json").read_text())
    # The front of the bullet, 0.1 ahead of its centre at 0.5, meets the wall's side at 4.99 at a speed of nine.
    assert (4.99 - 0.6) / 9.0 - 1e-5 <= data["toi"] <= (4.99 - 0.6) / 9.0 + 1e-15  # of the rounded coordinates
    assert 0.0 < json.loads((folder / "cloth.json").read_text())["toi"] < 1.0

    # The files that it wrote give the same answer to `run`, to the last bit.
    arguments = ["--static", folder / "bullet_wall_t0.ply", "--no-self-collision", "--output", folder / "again.json"]
    frames = [folder / "bullet_bullet_t0.ply", folder / "bullet_bullet_t1.ply"]
    assert main([str(argument) for argument in ["run", *frames, *arguments, "--quiet"]]) == 0
    assert json.loads((folder / "again.json").read_text())["toi"] == data["toi"]


@requires_data
def test_published_cloth_step_has_every_published_contact_and_the_exact_toi(tmp_path):
    frames = DATA / "simulation" / "cloth-funnel" / "frames"
    arguments = ["run", frames / "227.ply", frames / "228.ply", "--output", tmp_path / "out.npz", "--quiet"]
    assert main([str(argument) for argument in arguments]) == 0
    with np.load(tmp_path / "out.npz") as file:
        data = dict(file)
    first_edge = len(data["vertex_toi"])
    first_face = first_edge + len(data["edges"])
    step = simulation_step("cloth-funnel")
    exact = []
    for number, (kind, offsets) in enumerate(
        [("vertex-face", (0, first_face)), ("edge-edge", (first_edge, first_edge))]
    ):
        of_kind = data["contact_kind"] == number
        found = {tuple(sorted(pair)) for pair in (data["contact_primitives"][of_kind] + offsets).tolist()}
        truth = simulation_queries("cloth-funnel", kind).truth
        published = {tuple(sorted(pair)) for pair in simulation_boxes("cloth-funnel", kind)[truth].tolist()}
        assert len(published) == truth.sum() > 0
        assert published <= found
        corners = data["contact_vertices"][of_kind]
        exact += exact_tois(kind, step.vertices_t0[corners], step.vertices_t1[corners])
    scene_toi = float(data["toi"])
    assert not any(toi.late(scene_toi) for toi in exact)
    # The default tolerance; the iteration goes on far below it on pairs like the first one here.
    assert min((toi for toi in exact if toi.hit), key=lambda toi: toi.approx).early_by(scene_toi) <= 1e-6


def test_process_says_nothing_of_warp(scene):
    """In a process of its own, which has a module to compile: no banner, no compile message, on neither stream."""
    kept = Path(wp.config.kernel_cache_dir)
    own = scene / "cache" / kept.name
    own.mkdir(parents=True)
    for path in kept.glob("wp_*"):
        if "kernels.step.contacts_" not in path.name:
            (own / path.name).symlink_to(path)
    environment = os.environ | {"WARP_CACHE_PATH": str(own.parent)}
    done = subprocess.run(
        [sys.executable, "-m", "ccd_warp", "run", "start.ply", "end.ply", "--static", "floor.ply"],
        cwd=scene,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and done.stderr == ""
    assert done.stdout.startswith(f"ccd-warp {ccd.__version__}")
    assert len(list(own.glob("wp_*kernels.step.contacts_*"))) == 1
    for word in ("Warp ", "initialized", "Module", "took"):
        assert word not in done.stdout


def test_exit_status_of_the_process(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "ccd_warp", "run", "a.ply", "b.ply"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


def test_a_ground_is_a_half_space_of_the_command_line(scene, capfd):
    """It is named in the report and in every file of results, and no radius for all bodies is one for it."""
    options = (
        "--half-space",
        "ground=0,0,0,0,0,2",
        "--half-space=-9,0,0,1,0,0",
        "--radius",
        "0.25",
        "--no-self-collision",
    )
    for suffix in ("json", "npz", "csv"):
        assert _run(scene, *options, "--output", scene / f"result.{suffix}", *(["--quiet"] * (suffix != "csv"))) == 0
    out = [" ".join(line.split()) for line in capfd.readouterr().out.splitlines()]
    data = json.loads((scene / "result.json").read_text(encoding="utf-8"))
    names = [body["name"] for body in data["bodies"]]
    assert names == ["start.ply", "ground", "half-space"] or names[1:] == ["ground", "half-space"]
    assert data["bodies"][1]["half_space"] == {"point": [0, 0, 0], "normal": [0, 0, 2]}
    assert data["toi"] == pytest.approx(0.25, rel=1e-13)  # its centre comes down from 2 to 0.75
    assert data["contacts"][0]["kind"] == "vertex_plane" and data["contacts"][0]["bodies"][1] == "ground"
    assert any(line.startswith("first contact vertex ") and line.endswith(" and ground") for line in out)
    with np.load(scene / "result.npz") as arrays:
        assert arrays["plane_normal"].tolist() == [[0, 0, 2], [1, 0, 0]] and arrays["plane_body"].tolist() == [1, 2]
        assert (arrays["contact_bodies"][:, 1] == 1).all() and arrays["contact_primitives_in_body"][:, 1].max() == 0
    with (scene / "result.csv").open(newline="", encoding="utf-8") as file:
        assert {row["kind"] for row in csv.DictReader(file)} == {"vertex_plane"}
    frames = (scene / "start.ply", scene / "end.ply")
    assert main(["sequence", *map(str, frames), *options, "--output", "-", "--quiet"]) == 0
    (row,) = csv.DictReader(capfd.readouterr().out.splitlines())
    assert int(row["vertex_plane"]) == int(row["contacts"]) == data["counts"]["num_contacts"]["vertex_plane"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("0,0,0,0,0", "--half-space 0,0,0,0,0: expected X,Y,Z,NX,NY,NZ, a point and a normal"),
        ("floor=0,0,0,a,b,c", "--half-space floor=0,0,0,a,b,c: expected X,Y,Z,NX,NY,NZ"),
        ("floor=0,0,0,0,0,0", "normal of body 1 (floor) is [0.0, 0.0, 0.0]; expected a direction"),
    ],
)
def test_half_spaces_that_are_none_are_refused(scene, capfd, given, message):
    frames = (scene / "start.ply", scene / "end.ply")
    assert message in _refused(capfd, "run", *frames, "--half-space", given)
