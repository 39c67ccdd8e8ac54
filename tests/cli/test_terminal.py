"""What a person sees at a terminal while the command works, and after Ctrl-C: one process, all else in this one."""

import os
import select
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._cli.process import start_quietly
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.progress_line import ProgressLine, line_of

pty = pytest.importorskip("pty", reason="terminals of POSIX")

# A guard against hanging, not a demand: the answer to Ctrl-C is due within half a second.
PATIENCE = 600.0
# The command, whose lines are shown at once; a shell may have had Ctrl-C ignored.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import ccd_warp._runtime.progress_line
ccd_warp._runtime.progress_line.PATIENCE = 0.0
from ccd_warp._cli.command import run_program
run_program()
"""


def plane(count):
    """Triangles that lie over each other in a plane, most pairs of which touch: positions and faces."""
    return np.pad(np.random.default_rng(0).uniform(-1, 1, (3 * count, 2)), ((0, 0), (0, 1))), np.arange(3 * count)


@pytest.fixture
def frames(tmp_path, monkeypatch):
    """Writes two frames of such triangles; their names."""
    monkeypatch.chdir(tmp_path)

    def write(count):
        x, corners = plane(count)
        faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (corners.reshape(-1, 3) + 1).tolist())
        for name, positions in (("start.obj", x), ("end.obj", x + [0.1, 0.0, 0.0])):
            (tmp_path / name).write_text("".join(f"v {a!r} {b!r} {c!r}\n" for a, b, c in positions.tolist()) + faces)
        return ["start.obj", "end.obj"]

    return write


def read_all(master, stop=lambda shown: None) -> str:
    """What a terminal is sent until nobody writes to it any more."""
    shown, end = b"", time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if select.select([master], [], [], 0.1)[0]:
            try:
                shown += os.read(master, 1 << 16)
            except OSError:  # all has been read, and nobody writes
                break
        stop(shown)
    os.close(master)
    return shown.decode()


@pytest.fixture
def at_terminal(monkeypatch):
    """Makes a call while stderr of this process is a terminal, on which lines are shown at once; what it was sent."""

    class AtOnce(threading.Timer):
        def start(self):
            self.function()

        def join(self):
            pass

    monkeypatch.setattr("threading.Timer", AtOnce)
    monkeypatch.setattr("ccd_warp._runtime.progress_line.PATIENCE", 0.0)
    monkeypatch.setattr("ccd_warp._runtime.threads._TICK", 1e-3)

    def sent_by(call):
        master, slave = pty.openpty()
        shown = []
        reader = threading.Thread(target=lambda: shown.append(read_all(master)))
        reader.start()
        before = os.dup(2)
        os.dup2(slave, 2)
        os.close(slave)
        try:
            with os.fdopen(os.dup(2), "w") as stream, monkeypatch.context() as patch:
                patch.setattr(sys, "stderr", stream)
                call()
        finally:
            os.dup2(before, 2)
            os.close(before)
        reader.join()
        return shown[0]

    return sent_by


def screen_of(shown) -> list[str]:
    """Lines that stay on the terminal, but for that of a machine so busy that to load kernels takes seconds."""
    lines, column = [""], 0
    for letter in shown.replace("\r\n", "\n"):
        if letter == "\n":
            lines.append("")
        elif letter != "\r":
            lines[-1] = lines[-1][:column] + letter + lines[-1][column + 1 :]
        column = 0 if letter in "\r\n" else column + 1
    return [line.rstrip() for line in lines if line.strip() and "compiling kernels" not in line]


def test_ctrl_c_at_a_terminal_ends_a_long_run_and_leaves_the_terminal_as_it_was(frames):
    """All pairs of 4,000 triangles would take minutes."""
    master, slave = pty.openpty()
    command = [sys.executable, "-P", "-c", PROGRAM, "run", *frames(4000), "--device", "cpu"]
    process = subprocess.Popen(command, stderr=slave, stdout=subprocess.PIPE, text=True, start_new_session=True)
    os.close(slave)
    pressed = []

    def press(shown):
        if b"narrow phase  [" in shown and not pressed:
            pressed.append(process.send_signal(signal.SIGINT))

    shown = read_all(master, press)
    assert (process.communicate(timeout=PATIENCE)[0], process.returncode) == ("", 130) and pressed
    assert [line for line in screen_of(shown.replace("^C", "")) if "warning" not in line] == []


def test_ctrl_c_that_an_import_catches_ends_the_command(monkeypatch):
    """As trimesh does, whose modules catch whatever their imports raise."""

    class Finder:
        def find_spec(self, name, *_):
            if name == "trimesh":
                with pytest.raises(KeyboardInterrupt):
                    signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.delitem(sys.modules, "trimesh")
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    kept = {name: module for name, module in sys.modules.items() if name.startswith("trimesh.")}
    try:
        with pytest.raises(KeyboardInterrupt):
            start_quietly("cpu")
    finally:
        signal.signal(signal.SIGINT, before)
        sys.modules.update(kept)


PARTS = ["reading the files", "loading kernels", "making the mesh", "writing the results", "drawing the picture"]


@pytest.mark.parametrize(
    "line, words, stays",
    [
        ("run {} --output out.json --picture out.png", [f"\r{part} ..." for part in PARTS], None),
        ("sequence {} {} --output out", ["steps  [", " 33%"], None),
        ("sequence {} --output out --picture out.gif", ["\rreading the first step ...", "pictures  [", "100%"], None),
        ("run {} --memory-limit 9000", ["\r"], "error: memory_limit is 9000 bytes; expected at least "),
        ("run {} --quiet", [], None),
    ],
)
def test_parts_of_a_command_are_named_and_the_terminal_is_left_as_it_was(frames, at_terminal, line, words, stays):
    if "picture" in line:
        pytest.importorskip("pyvista", reason="the extra viz is not installed")
    shown = at_terminal(lambda: main(line.replace("{}", " ".join(frames(100))).split()))
    assert [each for each in words if each not in shown] == [] and (words or shown == "")
    assert "narrow phase" not in shown or line.startswith("run")
    assert screen_of(shown) == [] if stays is None else screen_of(shown)[0].startswith(f"ccd-warp: {stays}")


@pytest.mark.parametrize("level, is_shown", [("LOG_WARNING", True), ("LOG_ERROR", False)])
@pytest.mark.parametrize("name, stage", [("mesh_ccd", "narrow phase"), ("launch", "step")])
def test_a_long_call_of_the_library_shows_how_far_it_is_unless_warp_is_silent(
    at_terminal, monkeypatch, name, stage, level, is_shown
):
    monkeypatch.setattr(wp.config, "log_level", getattr(wp, level))
    x, corners = plane(400)
    mesh = ccd.CollisionMesh.from_arrays([(x, corners.reshape(-1, 3))])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", max_pairs=1 << 20, num_threads=2)
    shown = at_terminal(lambda: getattr(pipeline, name)(x, x + [0.1, 0.0, 0.0]))
    assert (f"\rccd_warp: {stage}  [" in shown) is is_shown and screen_of(shown) == []


def test_line_says_what_the_stage_has_taken_and_its_share_and_is_cleared_whole_after_an_interrupt(at_terminal):
    assert line_of(Progress(None, "pairs", 25, 100), 10.0) == f"pairs  [{'#' * 6}{' ' * 18}]  25%  about 30 s left"
    assert line_of(Progress(None, "pairs", 1, 1000), 10.0).endswith("0%  ...")
    assert line_of(Progress(None, "pairs", 50, 100), 600.0).endswith("about 10 min left")
    assert "100%" in line_of(Progress(None, "pairs", 101, 100), 1.0)

    def interrupted():
        line = ProgressLine(is_quiet=False)
        line.show(Progress(None, "pairs", 0, 100))
        flush = sys.stderr.flush

        def press():
            flush()
            raise KeyboardInterrupt

        sys.stderr.flush = press  # directly after it has shown a line
        with pytest.raises(KeyboardInterrupt):
            line.show(Progress(None, "narrow phase", 50, 100))
        sys.stderr.flush = flush
        line.clear()

    shown = at_terminal(interrupted)
    assert "narrow phase" in shown and screen_of(shown) == []


def test_warning_of_overlaps_names_the_bodies_in_the_line_of_the_caller(monkeypatch, frames, capfd):
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS", 1000)
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS_EACH", 1)
    flat, corners = plane(100)
    faces = corners.reshape(-1, 3)
    sheets = [(flat, faces), (flat + [9, 9, 9], faces), (flat, faces)]
    many = r"lie in each other, or .*memory_limit bounds the memory"
    for bodies, options, pair_bytes, words in (
        # in one batch, and in several
        (sheets, {"names": ["sheet", "far", "lining"], "self_collision": False}, 1 << 30, "sheet and lining"),
        (sheets, {"names": ["sheet", "far", "lining"], "self_collision": False}, 1, "sheet and lining"),
        (sheets[:2], {"names": ["cloth", "far"]}, 1 << 30, "cloth and itself"),
        ([sheets[0]] * 12, {"self_collision": False}, 1 << 30, None),  # no two have a tenth of the pairs
    ):
        monkeypatch.setattr("ccd_warp._engine.host.step.DEFAULT_PAIR_BYTES", pair_bytes)
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
        end = mesh.vertices + 0.1 * (mesh.vertex_body[:, None] != 1 if words else 1)
        for call in (ccd.mesh_ccd, lambda mesh, *x: ccd.CollisionPipeline(mesh).mesh_ccd(*x)):
            often = "$" if words is None else rf".*most often of {words} \(\d+ % of a sample\)$"
            with pytest.warns(RuntimeWarning, match=many + often) as caught:
                result = call(mesh, mesh.vertices, end)
            assert [warning.filename for warning in caught] == [__file__]
            assert (result.counts.num_batches > 1) == (pair_bytes == 1)
    monkeypatch.setattr("ccd_warp._engine.host.step.DEFAULT_PAIR_BYTES", 1 << 30)
    assert main(["run", *frames(100)]) == 0
    error = capfd.readouterr().err
    assert error.startswith("ccd-warp: warning: ") and error.count("\n") == 1
    assert all(word in error for word in ("pair_kinds", "exclusion_rings", "memory_limit"))
