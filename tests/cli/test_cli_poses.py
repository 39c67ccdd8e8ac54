"""`--poses`: rigid bodies of one mesh file that turn, in a step and in a sequence."""

import csv
import json

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._cli import sequence as sequence_command
from ccd_warp._cli.command import main
from ccd_warp._files.frames import write_mesh

# A bar, 2 long and 0.2 wide, turns about z and meets a small cube beside its path; the first contact is at an angle
# that follows from the corner of the cube.
ANGLES = (0.0, 1.0, 2.0)


@pytest.fixture
def scene(tmp_path):
    """The bar with its poses at three times, and an obstacle."""
    bar, cube = trimesh.creation.box((2.0, 0.2, 0.2)), trimesh.creation.box((0.2, 0.2, 0.2))
    write_mesh(tmp_path / "bar.ply", bar.vertices, bar.faces)
    write_mesh(tmp_path / "cube.ply", cube.vertices + [0.0, 0.7, 0.0], cube.faces)
    rows = [[t, "bar.ply", 0, 0, 0, 0, 0, float(np.sin(a / 2)), float(np.cos(a / 2))] for t, a in enumerate(ANGLES)]
    (tmp_path / "step.csv").write_text("".join(",".join(map(str, row)) + "\n" for row in rows[:2]))
    (tmp_path / "all.json").write_text(
        json.dumps([dict(zip("t body px py pz qx qy qz qw".split(), row, strict=True)) for row in rows])
    )
    return tmp_path


def run(command, scene, poses, *options):
    paths = (scene / "bar.ply", "--poses", scene / poses, "--static", scene / "cube.ply")
    return main([command, *map(str, (*paths, *options))])


def angle_of_contact():
    """Where the front of the bar, 0.1 from its middle line, reaches the corner (0.1, 0.6) of the cube."""
    return np.arctan2(0.6, 0.1) - np.arcsin(0.1 / np.hypot(0.1, 0.6))


def test_a_step_between_poses_is_on_arcs(scene, capfd):
    assert run("run", scene, "step.csv", "--output", scene / "result.json", "--fail-on-contact") == 0
    out = capfd.readouterr().out
    assert "t = 0.0 -> t = 1.0" in out and "scene toi  none" in out
    # the end of the bar has gone round by one radian
    displacement = float(next(line for line in out.splitlines() if "largest displacement" in line).split()[-1])
    assert displacement == pytest.approx(2 * np.hypot(1.0, 0.1) * np.sin(0.5), rel=1e-5)
    assert "pairs within a rigid body" in out and json.loads((scene / "result.json").read_text())["toi"] is None


def test_a_sequence_of_poses_has_what_python_gives(scene, capfd):
    output = scene / "out"
    assert run("sequence", scene, "all.json", "--output", output, "--fail-on-contact") == 1
    with (output / "steps.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["start"] for row in rows] == ["t = 0.0", "t = 1.0"] and float(rows[0]["toi"]) == np.inf
    toi = float(rows[1]["toi"])
    expected = (angle_of_contact() - ANGLES[1]) / (ANGLES[2] - ANGLES[1])
    assert expected - 1e-5 < toi <= expected
    sequence = ccd.read_poses(scene / "bar.ply", scene / "all.json", static=[scene / "cube.ply"])
    mesh, scale = sequence.mesh, 2.0  # the longest side of the box around all
    results = [ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=m, length_scale=scale) for m in sequence.steps()]
    assert [result.toi for result in results] == [np.inf, toi]


def test_a_sequence_of_poses_is_resumed_unless_it_is_another(scene, capfd, monkeypatch):
    solve, calls = sequence_command.solve, []

    def press(*arguments, **options):
        calls.append(arguments)
        if len(calls) in (2, 4):
            raise KeyboardInterrupt
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", press)
    assert run("sequence", scene, "all.json", "--output", scene / "out") == 130
    # another path is another run, which is interrupted, too
    assert run("sequence", scene, "all.json", "--output", scene / "out", "--path", "screw") == 130
    assert "computed before" not in capfd.readouterr().out
    assert run("sequence", scene, "all.json", "--output", scene / "out", "--path", "screw") == 0
    assert "1 of 2 steps were computed before" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "bar.ply", "bar.ply", "--poses", "step.csv"], "END is given with --poses"),
        (["run", "bar.ply", "--poses", "all.json"], "holds poses at 3 times; expected 2"),
        (["run", "bar.ply", "bar.ply", "--path", "screw"], "--path screw is given without --poses"),
        (["run", "bar.ply", "--poses", "none.csv"], "none.csv: no such file"),
        (["sequence", "bar.ply", "cube.ply", "--poses", "all.json"], "2 files are given with --poses; expected one"),
        (["sequence", "bar.ply", "--poses", "all.json", "--displacement", "u"], "--displacement is given with --poses"),
        (["run", "bar.ply", "--poses", "bad.csv"], "bad.csv: line 2, column py is 'two'; expected a finite number"),
    ],
)
def test_what_does_not_go_with_poses_is_refused(scene, capfd, monkeypatch, arguments, message):
    monkeypatch.chdir(scene)
    (scene / "bad.csv").write_text("0,0,0,0,0,0,0,0,1\n1,0,0,two,0,0,0,0,1\n")
    assert main(arguments) == 2
    captured = capfd.readouterr()
    assert message in captured.err and captured.err.count("\n") == 1 and captured.out == ""
