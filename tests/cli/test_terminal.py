"""What a person sees at a terminal while the command works, and after Ctrl-C: one process, all else in this one."""

import io
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mesh_files import ply

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._cli.progress_line import line_of
from ccd_warp._runtime import launch
from ccd_warp._runtime.progress import Progress

PATIENCE = 600.0  # a guard against hanging, not a demand: the answer to Ctrl-C is due within half a second
# The command, whose lines are shown at once; a shell may have had Ctrl-C ignored.
PROGRAM = """
import signal, ccd_warp._cli.command, ccd_warp._cli.progress_line
signal.signal(signal.SIGINT, signal.default_int_handler)
ccd_warp._cli.progress_line.PATIENCE = 0.0
ccd_warp._cli.command.run_program()
"""


def plane(count):
    """Triangles that lie over each other in a plane, most pairs of which touch: positions and faces."""
    x = np.random.default_rng(0).uniform(-1, 1, (3 * count, 2))
    return np.pad(x, ((0, 0), (0, 1))), np.arange(3 * count).reshape(-1, 3)


def frames(count):
    """Writes two frames of such triangles into the current folder; their names."""
    x, faces = plane(count)
    for k in (0, 1):
        Path(f"{k}.ply").write_bytes(ply(x + [0.1 * k, 0.0, 0.0], faces))
    return ["0.ply", "1.ply"]


def screen_of(shown) -> list[str]:
    """Lines that stay on a terminal, but for that of a machine so busy that to load kernels takes seconds."""
    lines, column = [""], 0
    for letter in shown.replace("\r\n", "\n").replace("\x1b[K", "\0"):
        if letter == "\0":
            lines[-1] = lines[-1][:column]
            continue
        if letter == "\n":
            lines.append("")
        elif letter != "\r":
            lines[-1] = lines[-1][:column] + letter + lines[-1][column + 1 :]
        column = 0 if letter in "\r\n" else column + 1
    return [line.rstrip() for line in lines if line.strip() and "compiling kernels" not in line]


def test_ctrl_c_at_a_terminal_ends_a_long_run_and_leaves_the_terminal_as_it_was(tmp_path, monkeypatch):
    """All pairs of 4,000 triangles would take minutes."""
    pty = pytest.importorskip("pty", reason="terminals of POSIX")
    monkeypatch.chdir(tmp_path)
    ours, theirs = pty.openpty()
    command = [sys.executable, "-P", "-c", PROGRAM, "run", *frames(4000), "--device", "cpu"]
    process = subprocess.Popen(command, stderr=theirs, stdout=subprocess.PIPE, text=True, start_new_session=True)
    os.close(theirs)
    shown, is_pressed, end = b"", False, time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if select.select([ours], [], [], 0.1)[0]:
            try:
                shown += os.read(ours, 1 << 16)
            except OSError:  # all has been read, and nobody writes
                break
        if b"narrow phase  [" in shown and not is_pressed:
            process.send_signal(signal.SIGINT)
            is_pressed = True
    os.close(ours)
    assert (process.communicate(timeout=PATIENCE)[0], process.returncode) == ("", 130) and is_pressed
    assert [line for line in screen_of(shown.decode().replace("^C", "")) if "warning" not in line] == []


@pytest.fixture
def terminal(monkeypatch):
    """Stderr as a terminal, on which lines are shown at once."""

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    shown = Terminal()
    monkeypatch.setattr("ccd_warp._cli.progress_line.PATIENCE", 0.0)
    monkeypatch.setattr("ccd_warp._runtime.threads._TICK", 1e-3)
    shown.open = lambda: monkeypatch.setattr(sys, "stderr", shown)
    return shown


@pytest.mark.parametrize(
    "line, words",
    [
        ("sequence {} {} --output out", ["steps  [", " 33%"]),
        ("run {} --quiet", None),
    ],
)
def test_progress_is_shown_and_the_terminal_is_left_as_it_was(tmp_path, terminal, monkeypatch, line, words):
    terminal.open()
    monkeypatch.chdir(tmp_path)
    main(line.replace("{}", " ".join(frames(40))).split())
    shown = terminal.getvalue()
    assert shown == "" if words is None else [each for each in words if each not in shown] == []
    assert "narrow phase" not in shown and screen_of(shown) == []


def test_ctrl_c_while_kernels_are_compiled_is_told_in_few_lines(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(launch, "run_aside", interrupted)
    monkeypatch.setattr(launch, "_loaded", set())
    mesh = ccd.CollisionMesh.from_arrays([plane(2)])
    with pytest.raises(KeyboardInterrupt, match="while kernels were compiled") as raised:
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices)
    assert len(raised.traceback) <= 4, "as many frames as a caller can use"


def test_line_says_the_share_that_is_done_and_what_the_rest_will_take():
    assert "#" * 12 + " " in line_of(Progress(None, "compiling kernels", 0, 1), 8.0, 8.0), (
        "it moves while a module compiles"
    )
    assert line_of(Progress(None, "pairs", 25, 100), 10.0) == f"pairs  [{'#' * 6}{' ' * 18}]  25%  about 30 s left"


def test_warning_of_overlaps_names_the_bodies_in_the_line_of_the_caller(monkeypatch):
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS", 1000)
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS_EACH", 1)
    mesh = ccd.CollisionMesh.from_arrays([plane(50)] * 2, names=["sheet", "lining"], self_collision=False)
    often = (
        r"lie in each other, or .*memory_limit bounds the memory.*most often of sheet and lining \(\d+ % of a sample\)$"
    )
    with pytest.warns(RuntimeWarning, match=often) as said:
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + 0.1)
    assert [warning.filename for warning in said] == [__file__]
