"""The command `ccd-warp sequence`: every step of a sequence of frames, interrupted and resumed."""

import csv
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from mesh_files import gltf_files, ply

import ccd_warp as ccd
from ccd_warp._cli import sequence as sequence_command
from ccd_warp._cli.command import main

SHAPE, FLOOR = trimesh.creation.icosphere(subdivisions=1, radius=0.5), trimesh.creation.box(extents=(4.0, 4.0, 1.0))
FALL = [SHAPE.vertices + [0.1, 0.2, 3.25 - 0.5 * k] for k in range(11)]
BALLS = [f"ball_{k}.ply" for k in sorted(range(11), key=str)]  # as a shell lists them: 10 before 2
ON = ["--static", "floor.ply"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Eleven frames of a ball that falls onto a box in the step from frame 5 to frame 6, and the box."""
    for k, vertices in enumerate(FALL):
        (tmp_path / f"ball_{k}.ply").write_bytes(ply(vertices, SHAPE.faces))
    (tmp_path / "floor.ply").write_bytes(ply(FLOOR.vertices - [0.0, 0.0, 0.5], FLOOR.faces))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def solved(monkeypatch):
    """The number of steps that were solved; Ctrl-C is pressed in place of that with the number of `stop`."""
    solve, state = sequence_command.solve, SimpleNamespace(count=0, stop=None)

    def solve_or_press(*arguments, **options):
        if state.count == state.stop:
            state.stop = None
            raise KeyboardInterrupt
        state.count += 1
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", solve_or_press)
    return state


def run(*arguments, status=0):
    assert main(["sequence", *map(str, arguments)]) == status


def rows(folder):
    with open(f"{folder}/steps.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


FOREIGN = b'\xff\xfe not text\n[1, 2]\n{"key": 9, "record": {}}\n{"key": "9", "record": {"toi": 0.5}}\n'


def test_sequence_that_is_interrupted_goes_on_where_it_was(folder, solved, capfd):
    """Each step is computed once, and the answers are those of a run that was left alone, and of the library."""
    options = ["--length-scale", "1", "--minimum-separation", "0.01"]
    for solved.stop in (3, 7):
        run(*BALLS, *ON, *options, "--output", "out", status=130)
        done = solved.count
        assert f"interrupted after {done} of 10 steps; what was computed is kept" in capfd.readouterr().err
        assert len(rows("out")) == done
    with open("out/sequence.journal", "ab") as file:
        file.write(FOREIGN)
    run(*BALLS, *ON, *options, "--output", "out")
    shown = capfd.readouterr()
    assert "7 of 10 steps were computed before" in shown.out and solved.count == 10
    assert "sequence.journal: 4 lines are no records of a step" in shown.err and shown.err.count("\n") == 1
    run(*BALLS, *ON, *options, "--output", "at_once", "--quiet")
    assert (folder / "out" / "steps.csv").read_bytes() == (folder / "at_once" / "steps.csv").read_bytes()
    assert sorted(path.name for path in (folder / "out").iterdir()) == ["steps.csv", "steps.png"]
    assert capfd.readouterr() == ("", "")
    steps = [*ccd.read_sequence([folder / name for name in BALLS], static=["floor.ply"]).steps()]
    how = {"length_scale": 1.0, "minimum_separation": 0.01}
    expected = [ccd.mesh_ccd(step.mesh, step.vertices_t0, step.vertices_t1, **how) for step in steps]
    assert [float(row["toi"]) for row in rows("out")] == [result.toi for result in expected]
    (k, *_) = np.flatnonzero([result.hit for result in expected])
    assert [float(rows("out")[k][axis]) for axis in "xyz"] == expected[k].first.point.tolist()


def test_other_options_or_frames_or_files_beside_them_begin_anew(folder, solved):
    """The positions lie in files beside those that are given, which stay as they are."""
    given = [*(f"ball_{k}.gltf" for k in range(4, 8)), *ON, "--quiet", "--output"]
    for k in range(4, 8):
        tree, buffer = gltf_files(FALL[k], SHAPE.faces)
        tree["buffers"][0]["uri"] = f"{k}.bin"
        (folder / f"{k}.bin").write_bytes(buffer)
        (folder / f"ball_{k}.gltf").write_text(json.dumps(tree))
    solved.stop = 2
    run(*given, "out", status=130)  # the steps 4 to 5 and 5 to 6 are kept; the ball strikes in the second
    shutil.copy("5.bin", "6.bin")
    run(*given, "out")
    assert solved.count == 2 + 2  # the second step again, and the last one
    run(*given, "afresh")
    assert (folder / "out" / "steps.csv").read_bytes() == (folder / "afresh" / "steps.csv").read_bytes()
    solved.stop = 8
    run(*given, "out", "--t-max", "0.9", status=130)
    run(*given, "out")
    assert solved.count == 7 + 1 + 3


def test_report_names_the_steps_with_contacts_and_the_first(capfd):
    run(*BALLS, *ON, "--output", "out", "--fail-on-contact", status=1)
    out = capfd.readouterr().out
    assert "11 frames of ball" in out and "steps with contacts  5 of 10: 5-9\n" in out
    (first,) = [line for line in out.splitlines() if line.startswith("the first")]
    assert first.startswith("the first  step 5, ball_5.ply -> ball_6.ply, toi 0.4999")
    assert "of ball" in out and "of floor.ply" in out and "not seen  what surfaces that cross" in out
    assert "surfaces cross at the start of  4 of 10 steps: 6-9\n" in out
    found = rows("out")
    assert [row["start"] for row in found] == [f"ball_{k}.ply" for k in range(10)]
    assert [np.isfinite(float(row["toi"])) for row in found] == [k >= 5 for k in range(10)]
    run(*BALLS[:3], "--output", "-", "--pair-kinds", "edge-edge", "--fail-on-contact")
    shown = capfd.readouterr()  # standard output takes the CSV alone
    assert len([*csv.DictReader(shown.out.splitlines())]) == 2
    assert "none of 2   (certain for the pairs looked at: edge-edge, in [0, 1])" in shown.err


def test_a_sequence_of_poses_is_resumed_unless_its_path_is_another(folder, solved, capfd):
    poses = [f"{t},ball_0.ply,0,0,{-t},0,0,{np.sin(t)},{np.cos(t)}\n" for t in range(3)]
    (folder / "all.csv").write_text("".join(poses))
    given = ["ball_0.ply", "--poses", "all.csv", *ON, "--output", "out"]
    for solved.stop, path in ((1, "screw"), (2, "linear")):
        run(*given, "--path", path, status=130)
    assert "computed before" not in capfd.readouterr().out
    run(*given, "--path", path)
    assert "1 of 2 steps were computed before" in capfd.readouterr().out
