"""Files and streams that fail: one line on stderr and status 2; what was written before stays as it was."""

import os
import resource
import sys
from contextlib import contextmanager

import numpy as np
import pytest
import trimesh

import ccd_warp._cli.sequence as sequence_command
from ccd_warp._cli import command
from ccd_warp._cli.command import main, run_program
from ccd_warp._files.frames import write_mesh


@pytest.fixture
def ball(tmp_path):
    """Four frames of a ball that falls through a box, which it touches in the second step."""
    shape, box = trimesh.creation.icosphere(subdivisions=2, radius=0.5), trimesh.creation.box()
    for k in range(4):
        write_mesh(tmp_path / f"ball_{k}.ply", shape.vertices + [0.1, 0.2, 2.0 - 0.7 * k], shape.faces)
    write_mesh(tmp_path / "box.ply", box.vertices, box.faces)
    return tmp_path


def _step(ball, *options) -> list[str]:
    return list(map(str, ["run", ball / "ball_1.ply", ball / "ball_2.ply", "--static", ball / "box.ply", *options]))


def _sequence(ball, *options) -> list[str]:
    frames = [ball / f"ball_{k}.ply" for k in range(4)]
    return list(map(str, ["sequence", *frames, "--static", ball / "box.ply", *options]))


def _refused(capfd) -> str:
    error = capfd.readouterr().err
    assert error.startswith("ccd-warp: error: ") and error.count("\n") == 1
    return error


@contextmanager
def _pipe_without_reader():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream:
        yield stream


@pytest.mark.parametrize("make, options", [(_step, []), (_step, ["--output", "-"]), (_sequence, ["--output", "-"])])
def test_a_pipe_without_a_reader_keeps_the_status(ball, make, options, monkeypatch):
    for asked, status in (([], 0), (["--fail-on-contact"], 1)):
        with _pipe_without_reader() as stream, monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", stream)
            assert main(make(ball, *options, *asked)) == status


@pytest.mark.parametrize("make", [_step, _sequence])
def test_a_full_standard_output_is_an_error(ball, make, monkeypatch, capfd):
    with open("/dev/full", "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(make(ball, "--output", "-", "--quiet", "--fail-on-contact")) == 2
    assert "cannot write to standard output (No space left on device)" in _refused(capfd)


@pytest.mark.parametrize("make", [_step, _sequence])
def test_a_closed_standard_output_is_an_error_where_the_result_goes_there(ball, make, monkeypatch, capfd):
    monkeypatch.setattr(sys, "stdout", None)
    assert main(make(ball, "--output", "-")) == 2
    assert "--output -: there is no standard output" in _refused(capfd)
    assert main(make(ball, "--output", ball / "out.json")) == 0


def test_a_closed_stderr_leaves_the_result_alone_on_standard_output(ball, monkeypatch, capfd):
    monkeypatch.setattr(sys, "stderr", None)
    assert main(_step(ball, "--output", "-")) == 0
    assert capfd.readouterr().out.startswith("{\n")


@contextmanager
def _full_disk():
    """No file can grow beyond a kilobyte, as on a disk with as much left."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("name", ["out.json", "out.npz", "out.csv"])
def test_an_earlier_result_survives_a_full_disk(ball, name, capfd):
    assert main(_step(ball, "--quiet", "--output", ball / name)) == 0
    before = {path: path.read_bytes() for path in ball.iterdir()}
    with _full_disk():
        assert main(_step(ball, "--quiet", "--t-max", "0.9", "--output", ball / name)) == 2
    assert f"cannot write {ball / name} (File too large)" in _refused(capfd)
    assert {path: path.read_bytes() for path in ball.iterdir()} == before


def test_a_disk_that_fills_up_in_a_sequence_is_an_error_and_keeps_what_was_written(ball, capfd):
    out = ball / "out"
    assert main(_sequence(ball, "--quiet", "--output", out)) == 0
    before = (out / "steps.csv").read_bytes()
    with _full_disk():
        assert main(_sequence(ball, "--quiet", "--t-max", "0.9", "--output", out)) == 2
    assert "File too large" in _refused(capfd)
    assert (out / "steps.csv").read_bytes() == before
    assert main(_sequence(ball, "--quiet", "--t-max", "0.9", "--output", out)) == 0


def test_results_go_where_a_link_leads(ball):
    (ball / "kept").mkdir()
    (ball / "out.json").symlink_to(ball / "kept" / "result.json")
    assert main(_step(ball, "--quiet", "--output", ball / "out.json")) == 0
    assert (ball / "out.json").is_symlink() and (ball / "kept" / "result.json").stat().st_size > 1000


FOREIGN = b"""\xff\xfe not text
[1, 2]
{"key": 2, "record": {}}
{"key": "2", "record": {"toi": 0.5}}
{"key": "nine", "record": {"step": 9}}
"""


def test_foreign_lines_in_the_journal_are_passed_over(ball, monkeypatch, capfd):
    solve, solved = sequence_command.solve, []

    def press_at_two(*arguments, **options):
        solved.append(arguments)
        if len(solved) == 3:
            raise KeyboardInterrupt
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", press_at_two)
    assert main(_sequence(ball, "--output", ball / "out")) == 130
    with (ball / "out" / "sequence.journal").open("ab") as file:
        file.write(FOREIGN)
    capfd.readouterr()
    assert main(_sequence(ball, "--output", ball / "out", "--fail-on-contact")) == 1
    captured = capfd.readouterr()
    assert "sequence.journal: 5 lines are no records of a step" in captured.err and captured.err.count("\n") == 1
    assert "2 of 3 steps were computed before" in captured.out and len(solved) == 4
    assert np.loadtxt(ball / "out" / "steps.csv", delimiter=",", skiprows=1, usecols=0).tolist() == [0, 1, 2]


def test_a_fault_of_the_command_itself_does_not_look_like_a_contact(ball, monkeypatch, capfd):
    def fail(argv=None):
        raise RuntimeError("a fault")

    monkeypatch.setattr(command, "main", fail)
    with pytest.raises(SystemExit) as end:
        run_program()
    assert end.value.code == 3 and "RuntimeError: a fault" in capfd.readouterr().err
