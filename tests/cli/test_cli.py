"""The command `ccd-warp`, called in process: what it prints, what it writes, what it warns of, and what it refuses."""

import io
import json
import os
import re
import resource
import shutil
import sys

import numpy as np
import pytest
import trimesh
from mesh_files import ply

import ccd_warp as ccd
from ccd_warp._cli import command
from ccd_warp._cli.command import main

RUN = "run start.ply end.ply"
ON = f"{RUN} --static floor.ply"
# A ball of radius 0.5 comes down five units onto a box whose top is at z = 0.
BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
BOX = trimesh.creation.box(extents=(4.0, 4.0, 1.0))
TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
CROSSING = np.vstack([3.0 * TRIANGLE, [[0.5, 0.5, -1], [0.6, 0.5, 1], [0.5, 0.6, 2]]])
DROP = np.array([[0.2, 0.2, 0.0], [0.25, 0.2, 2.0], [0.2, 0.25, 2.0]])
HOSTILE, SHOWN = "bad\x1b]0;title\x07\x1b[31m\x9b2J\u202e é.ply", r"bad\x1b]0;title\x07\x1b[31m\x9b2J\u202e é.ply"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """All files of the tables below."""
    folder = tmp_path_factory.mktemp("files")
    start, three = BALL.vertices + [0.1, 0.2, 2.0], np.arange(9).reshape(-1, 3)
    for name, vertices, faces in [
        ("start", start, BALL.faces),
        ("end", start - [0, 0, 5.0], BALL.faces),
        ("floor", BOX.vertices - [0, 0, 0.5], BOX.faces),
        ("crossing", CROSSING, three[:2]),
        ("drop_1", DROP + [0, 0, 1.0], three[:1]),
        ("drop_2", DROP - [0, 0, 0.5], three[:1]),
        ("tiles", np.vstack([TRIANGLE - [9.0, 0, 0], TRIANGLE - [6.0, 0, 0], TRIANGLE]), three),
        ("sheet_1", SQUARE, [[0, 1, 2], [0, 2, 3]]),  # whose corner touches a wall, and which falls on a floor
        ("sheet_2", SQUARE - [0, 0, 2.0], [[0, 1, 2], [0, 2, 3]]),
        ("wall", 18.0 * SQUARE[:, [2, 0, 1]] - [0, 9, 9], [[0, 1, 2], [0, 2, 3]]),
        ("ground", 18.0 * SQUARE - [9, 9, 1], [[0, 1, 2], [0, 2, 3]]),
        (HOSTILE.removesuffix(".ply"), BOX.vertices - [0, 0, 0.5], BOX.faces),
    ]:
        (folder / f"{name}.ply").write_bytes(ply(vertices, faces))
    trimesh.Trimesh(start, BALL.faces, process=False).export(folder / "soup.stl")
    (folder / "escape.obj").write_bytes(b"v 0 0 \x1b[31m\n")
    (folder / "folder.png").mkdir()
    return folder


@pytest.fixture
def run(folder, monkeypatch, capfd):
    """Runs a command line in the folder; what it printed on both streams."""
    monkeypatch.chdir(folder)

    def run_command(line, *more, status=0):
        capfd.readouterr()
        assert main([*line.split(), *map(str, more)]) == status
        return capfd.readouterr()

    return run_command


def _expected():
    """The same run through the Python interface, with the length scale of the bodies at the start."""
    frames = ccd.read_frames("start.ply", "end.ply", static=["floor.ply"])
    return frames.mesh, ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1, length_scale=4.0)


# ---- The report ------------------------------------------------------------------------------------------------------


def _lines(text):
    return [" ".join(line.split()) for line in text.splitlines()]


SHEET = "run sheet_1.ply sheet_2.ply --static wall.ply --static ground.ply"
CERTAIN = "scene toi none (certain for the pairs looked at: vertex-face and edge-edge, in [0, {}])"
REPORTS = [  # a command, and words of its report; those behind - are not in it
    (RUN, CERTAIN.format(1), "-no part", "-(--"),
    (f"{ON} --kinematic start.ply --t-max 0.25", "start.ply kinematic", "static and kinematic", CERTAIN.format(0.25)),
    (f"{ON} --pair-kinds edge-edge", "left out vertex-face pairs", "-vertex-face and", "(--pair-kinds)"),
    (f"{RUN} --exclusion-rings 2 --no-self-collision", "fewer than 2 edges", "within a body (--no-self-collision)"),
    # The ball is at z = 2 with a radius of 0.5; the box, 4 x 4, reaches down to z = -1.
    (f"{ON} --minimum-separation 0.01", "extents at the start 4 x 4 x 3.5", "minimum separation 0.04"),
    (f"{ON} --tolerance 1e-3 --length-scale 2", "largest displacement 5", "length scale 2", "tolerance 0.002"),
    (ON, "at the start no edge passes through a face"),
    ("run soup.stl soup.stl", "(798 vertices of soup.stl merged by position)"),
    # The third face of an obstacle that comes after other bodies is the third of this body.
    ("run drop_1.ply drop_2.ply --static tiles.ply", "vertex 0 of drop_1.ply and face 2 of tiles.ply at (0.2"),
    # An edge through the inside of a face, and both at rest: no contact in CCD, and a start that is not sound.
    (
        "run crossing.ply crossing.ply",
        CERTAIN.format(1),
        "at the start 2 edges pass through a face, so surfaces cross: 2 within crossing.ply",
        "not seen what surfaces that cross at the start already do after it",
    ),
    ("run crossing.ply crossing.ply --ignore-start-contacts", "edges that pass through a face in", "-so surfaces"),
    (
        f"{SHEET} --exclude sheet_1.ply,wall.ply --exclude ground.ply,sheet_1.ply --no-self-collision",
        *("scene toi none", "2 pairs of bodies (--exclude)"),
    ),
]


@pytest.mark.parametrize("line, words", [(line, words) for line, *words in REPORTS])
def test_report_says(run, line, words):
    shown = run(line)
    text = " ".join(_lines(shown.out))
    assert shown.err == "" and [word for word in words if (word.lstrip("-") in text) == word.startswith("-")] == []
    assert run(f"{line} --quiet") == ("", "")


# ---- Results ---------------------------------------------------------------------------------------------------------


def _json(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file, parse_constant=pytest.fail)  # NaN and Infinity are no JSON


def test_both_formats_hold_the_result_bit_for_bit(run):
    """By ascending toi, with numbers within the bodies, and all that is needed to understand the numbers."""
    assert "out.npz" in run(f"{ON} --output out.npz").out
    lines, (mesh, result) = _lines(run(f"{ON} --output out.json").out), _expected()
    assert "wrote out.json" in lines
    assert f"scene toi {float(result.toi)!r} (of the step; no pair looked at touches before it)" in lines
    contacts, first = result.contacts, result.first
    data = _json("out.json")
    assert {"read_files", "intersections_at_start", *result.timings} == data["timings"].keys()
    for name, seconds in data["timings"].items():
        assert f" {name.replace('_', ' ')} {seconds:.4f}" in lines[-2], name
    with np.load("out.npz") as file:
        arrays = dict(file)
    assert data["toi"] == arrays["toi"] == result.toi and np.array_equal(arrays["body_toi"], result.body_toi)
    for tois in ([np.inf if toi is None else toi for toi in data["vertex"]["toi"]], arrays["vertex_toi"]):
        assert np.array_equal(tois, result.vertex_toi)
    found = data["contact"]
    for tois in (found["toi"], arrays["contact_toi"]):
        assert np.array_equal(tois, np.sort(contacts.toi)) and len(tois) > 0
    for name in ("primitives", "vertices", "parameters", "normal"):
        assert sorted(arrays[f"contact_{name}"].tolist()) == sorted(getattr(contacts, name).tolist()), name
    assert found["point"][0] == first.point.tolist() and {*found["status"]} == {"collision"}
    for name in found:
        assert found[name] == arrays[f"contact_{name}"].tolist(), name
    assert data["body"]["name"] == ["start.ply", "floor.ply"] and data["body"]["static"] == [False, True]
    rows = [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
    for row in rows:
        first_vertex = mesh.body_vertex_range[mesh.vertex_body[row["vertices"]]]
        assert np.array_equal(row["vertices_in_body"] + first_vertex, row["vertices"])
        if row["kind"] == "edge_edge":  # the box has 18 edges, whatever their numbers in the mesh
            assert 0 <= row["primitives_in_body"][row["bodies"].index("floor.ply")] < 18
    options = json.loads(str(arrays["options"]))
    assert data["version"] == str(arrays["version"]) == ccd.__version__ and data["options"] == options
    assert options.keys() == ccd.MeshOptions.__optional_keys__ and options["length_scale"] == 4.0
    assert data["counts"]["num_after_cull"]["edge_edge"] == result.counts.num_after_cull[ccd.PairKind.EDGE_EDGE]
    assert data["crossing"]["primitives"] == [] and arrays["crossing_primitives"].shape == (0, 2)


def test_standard_output_takes_the_json_alone(run):
    shown = run(f"{ON} --output -")
    assert json.loads(shown.out)["toi"] == _expected()[1].toi
    assert shown.err.startswith("ccd-warp ") and "first contact" in shown.err
    shown = run("run crossing.ply crossing.ply --output - --quiet --fail-on-contact", status=1)
    data = json.loads(shown.out)
    assert data["toi"] is None and data["contact"]["toi"] == [] and shown.err == ""
    assert data["crossing"]["bodies"] == [["crossing.ply", "crossing.ply"]] * 2


def test_a_ground_is_a_half_space_of_the_command_line(run):
    """It is named in the report and in files of results, and no radius for all bodies is one for it."""
    planes = "--half-space ground=0,0,0,0,0,2 --half-space=-9,0,0,1,0,0 --radius 0.25 --no-self-collision"
    out = run(f"{RUN} {planes} --output ground.json").out
    assert re.search(r"first contact  vertex .* and ground\n", out)
    data = _json("ground.json")
    assert data["body"]["name"] == ["start.ply", "ground", "half-space"] and data["plane"]["body"][0] == "ground"
    assert data["plane"]["point"][0] == [0, 0, 0] and data["plane"]["normal"][0] == [0, 0, 2]
    assert data["toi"] == pytest.approx(0.25, rel=1e-13)  # its centre comes down from 2 to 0.75
    assert {*data["contact"]["kind"]} == {"vertex_plane"} and data["contact"]["bodies"][0][1] == "ground"


# ---- Refusals --------------------------------------------------------------------------------------------------------

REFUSED = [  # of a command, what its one line says; what the library refuses, its own table holds
    (f"{RUN} --static a.ply b.ply", "--help"),  # the second would be taken for a frame
    (f"{RUN} --pair-kinds point-point", "--pair-kinds holds point-point, which these bodies cannot form"),
    (f"{ON} --kinematic floor.ply", "--kinematic floor.ply: no such body; expected one of start.ply"),
    (f"{RUN} --half-space 0,0,0,0,0", "--half-space 0,0,0,0,0: expected X,Y,Z,NX,NY,NZ, a point and a normal"),
    (f"{SHEET} --exclude wall.ply", "--exclude wall.ply: expected A,B, the names of two bodies"),
    ("sequence start.ply end.ply --output s.json", "s.json: expected the name of a folder, found that of a file"),
    ("run not_even_looked_for.ply end.ply --picture folder.png", "cannot be written"),
    (f"{RUN} --static escape.obj", r"line 1 holds 'v 0 0 \x1b[31m'"),
    (f"{RUN} --tolerance \x1b[31m", "--tolerance"),
]


@pytest.mark.parametrize("line, words", REFUSED)
def test_bad_command_lines_and_files_are_refused_in_one_line(run, folder, line, words):
    before = sorted(folder.rglob("*"))
    shown = run(line, status=2)
    assert shown.out == "" and shown.err.startswith("ccd-warp: error: ") and shown.err.endswith("\n")
    assert shown.err[:-1].isprintable() and words in shown.err and len(shown.err) < 800
    assert sorted(folder.rglob("*")) == before


def test_names_of_files_reach_the_terminal_without_their_escape_codes(run):
    shown = run(f"{RUN} --output a\x1b[2J.json --static", HOSTILE)
    assert "\x1b" not in shown.out and "\x07" not in shown.out and "\x9b" not in shown.out
    assert shown.out.count(SHOWN) == 2 and r"a\x1b[2J.json" in shown.out  # in the table and in the first contact
    # A body has one name, which everything that is written calls it by.
    assert _json("a\x1b[2J.json")["body"]["name"] == ["start.ply", SHOWN]
    assert SHOWN in (error := run(f"{RUN} --static", f"no {HOSTILE}", status=2).err) and error[:-1].isprintable()


def test_help_is_that_of_the_library_and_a_terminal_that_knows_ascii_alone_gets_it(run, monkeypatch, folder):
    monkeypatch.setenv("COLUMNS", "1000")
    shutil.copy(folder / "start.ply", folder / "start é.ply")
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    lines = ("--version", "--help", *(f"{name} --help" for name in "sequence demo bench run".split()))
    for line in (*lines, "run start_é.ply start_é.ply --output default.json"):
        monkeypatch.setattr(sys, "argv", ["ccd-warp", *(word.replace("_é", " é") for word in line.split())])
        with pytest.raises(SystemExit) as ended:
            command.run_program()
        assert ended.value.code == 0
    out = written.getvalue().decode("ascii")
    assert out.startswith(f"ccd-warp {ccd.__version__}\n") and "start \\xe9.ply" in out
    # Each option is in one line, or in two where its name is long.
    text, options = re.sub(r"\n {20,}", " ", out), _json("default.json")["options"]
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip().startswith("--")}
    for name in ("tolerance", "minimum_separation", "t_max", "max_iterations", "max_work", "precision", "method"):
        shown = f"({options[name]:g})" if isinstance(options[name], float) else f"({options[name]})"
        assert lines[f"--{name.replace('_', '-')}"].endswith(shown)


# ---- Files and streams that fail -------------------------------------------------------------------------------------

SEQUENCE = "sequence start.ply end.ply --static floor.ply"


@pytest.mark.parametrize("line", [ON, f"{ON} --output -", f"{SEQUENCE} --output -"])
def test_a_pipe_without_a_reader_keeps_the_status_and_a_full_output_is_an_error_where_the_result_goes_there(
    run, line, monkeypatch
):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        run(f"{line} --fail-on-contact", status=1)
    with open("/dev/full", "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        shown = run(f"{line.removesuffix(' --output -')} --output - --quiet --fail-on-contact", status=2)
    assert shown.err == "ccd-warp: error: cannot write to standard output (No space left on device)\n"


@pytest.mark.parametrize("name", ["full.json", "full.npz", "full"])
def test_a_full_disk_is_an_error_that_names_the_file(run, name):
    line = f"{ON if '.' in name else SEQUENCE} --quiet --output {name}"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000 if "." in name else 100, hard))
    try:
        error = run(line, status=2).err
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert error.startswith("ccd-warp: error: cannot write ") and name in error
    assert "(File too large)" in error and error.count("\n") == 1
    run(line)


def test_a_fault_of_the_command_itself_does_not_look_like_a_contact(monkeypatch, capfd):
    monkeypatch.setattr(command, "main", lambda: 1 / 0)
    with pytest.raises(SystemExit) as end:
        command.run_program()
    assert end.value.code == 3 and "ZeroDivisionError" in capfd.readouterr().err
