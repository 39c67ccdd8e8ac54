"""What a person sees at a terminal while the command works, and after Ctrl-C: each run in a terminal of its own."""

import os
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import ccd_warp as ccd
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.progress_line import ProgressLine, line_of

pty = pytest.importorskip("pty", reason="terminals of POSIX")

# Guards against hanging, not demands: the answer to Ctrl-C is due within half a second.
_PATIENCE = 600.0
# The command, whose lines are shown at once; `overlaps` is the number of pairs from which on it warns.
_RUN = """
import signal, sys, threading
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have had it ignored
import ccd_warp._runtime.progress_line, ccd_warp._runtime.threads, ccd_warp._engine.host.oddities
ccd_warp._runtime.progress_line.PATIENCE = 0.0
ccd_warp._runtime.threads._TICK = 1e-2
class AtOnce(threading.Timer):
    def start(self):
        self.function()
        super().start()
        self.join()
    def run(self):
        pass
threading.Timer = AtOnce
ccd_warp._engine.host.oddities._MANY_PAIRS = {overlaps}
from ccd_warp._cli.command import run_program
run_program()
"""
# A program that calls the library, whose line is shown at once.
_CALL = """
import warp
import ccd_warp as ccd
import ccd_warp._runtime.progress_line, ccd_warp._runtime.threads
ccd_warp._runtime.progress_line.PATIENCE = 0.0
ccd_warp._runtime.threads._TICK = 1e-3
{setting}
frames = ccd.read_frames(*{paths})
pipeline = ccd.CollisionPipeline(frames.mesh, device="cpu", max_pairs=1 << 20, num_threads=2)
pipeline.{name}(frames.vertices_t0, frames.vertices_t1)
"""
# The module of the mesh reader is imported by code that catches whatever an import raises, as trimesh itself does.
_INTERRUPTED_IMPORT = """
import importlib.abc, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, *_):
        if name == "trimesh":
            try:
                signal.raise_signal(signal.SIGINT)
            except BaseException:
                pass
sys.meta_path.insert(0, Finder())
from ccd_warp._cli.command import run_program
run_program()
"""


@pytest.fixture
def triangles_in_a_plane(tmp_path):
    """Files of triangles that lie over each other, most pairs of which touch."""

    def write(count):
        rng = np.random.default_rng(0)
        start = np.pad(rng.uniform(-1, 1, (3 * count, 2)), ((0, 0), (0, 1)))
        faces = "".join(f"f {k} {k + 1} {k + 2}\n" for k in range(1, 3 * count, 3))
        paths = [str(tmp_path / name) for name in ("start.obj", "end.obj")]
        for path, x in zip(paths, (start, start + [0.1, 0.0, 0.0]), strict=True):
            with open(path, "w") as file:
                file.writelines(f"v {a!r} {b!r} {c!r}\n" for a, b, c in x.tolist())
                file.write(faces)
        return paths

    return write


def at_terminal(arguments, *, stop_at=None, overlaps=10**6, name="run"):
    """Status of a command, and what stderr, a terminal, was sent; Ctrl-C is pressed once it shows some words."""
    command = ["-c", _RUN.format(overlaps=overlaps), name, *arguments, "--device", "cpu"]
    return shown_by(command, stop_at=stop_at)


def shown_by(command, *, stop_at=None):
    """The same of Python with some arguments."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-P", *command]
    process = subprocess.Popen(command, stderr=theirs, stdout=subprocess.DEVNULL, start_new_session=True)
    os.close(theirs)
    shown, end = b"", time.monotonic() + _PATIENCE
    try:
        while time.monotonic() < end:
            if select.select([ours], [], [], 0.1)[0]:
                try:
                    shown += os.read(ours, 1 << 16)
                except OSError:  # all has been read, and nobody writes
                    break
            elif process.poll() is not None:
                break
            if stop_at is not None and stop_at in shown:
                process.send_signal(signal.SIGINT)
                stop_at = None
        return process.wait(max(1.0, end - time.monotonic())), shown.decode()
    finally:
        process.kill()
        process.wait()
        os.close(ours)


def screen_of(shown):
    """Lines that stay on the terminal, but for that of a machine so busy that to load kernels takes seconds."""
    lines = [""]
    column = 0
    for letter in shown.replace("\r\n", "\n"):
        if letter == "\n":
            lines.append("")
            column = 0
        elif letter == "\r":
            column = 0
        else:
            lines[-1] = lines[-1][:column] + letter + lines[-1][column + 1 :]
            column += 1
    return [line.rstrip() for line in lines if line.strip() and "compiling kernels" not in line]


def test_long_run_shows_how_far_it_is_and_leaves_the_terminal_as_it_was(triangles_in_a_plane):
    status, shown = at_terminal(triangles_in_a_plane(700), overlaps=10**9)
    assert status == 0
    assert "narrow phase  [" in shown
    assert screen_of(shown) == []


def test_sequence_shows_how_many_steps_are_done(triangles_in_a_plane, tmp_path):
    frames = [*triangles_in_a_plane(100), *triangles_in_a_plane(100)]
    status, shown = at_terminal([*frames, "--output", str(tmp_path / "out")], name="sequence")
    assert status == 0
    assert "steps  [" in shown and " 33%" in shown and "narrow phase" not in shown
    assert screen_of(shown) == []


def test_every_part_of_a_run_is_named_while_it_takes_long(triangles_in_a_plane, tmp_path):
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    written = ["--output", str(tmp_path / "out.json"), "--picture", str(tmp_path / "out.png")]
    status, shown = at_terminal([*triangles_in_a_plane(100), *written])
    assert status == 0
    for part in (
        "reading the files",
        "loading kernels",
        "making the mesh",
        "writing the results",
        "drawing the picture",
    ):
        assert f"\r{part} ..." in shown, part
    assert screen_of(shown) == []


def test_pictures_of_an_animation_are_counted_although_stderr_is_closed_meanwhile(triangles_in_a_plane, tmp_path):
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    folder = ["--output", str(tmp_path / "out"), "--picture", str(tmp_path / "out.gif")]
    status, shown = at_terminal([*triangles_in_a_plane(20), *folder], name="sequence")
    assert status == 0
    assert "\rreading the first step ..." in shown and "pictures  [" in shown and shown.count("100%") == 2
    assert screen_of(shown) == []


@pytest.mark.parametrize("setting, is_shown", [("WARNING", True), ("ERROR", False)])
@pytest.mark.parametrize("name, stage", [("mesh_ccd", "narrow phase"), ("launch", "step")])
def test_a_long_call_of_the_library_shows_how_far_it_is_unless_warp_is_silent(
    triangles_in_a_plane, name, stage, setting, is_shown
):
    setting = f"warp.config.log_level = warp.LOG_{setting}"
    status, shown = shown_by(["-c", _CALL.format(paths=triangles_in_a_plane(700), setting=setting, name=name)])
    assert status == 0
    for each in (stage, "compiling kernels"):
        assert (f"\rccd_warp: {each}  [" in shown) is is_shown
    assert screen_of(shown) == []


def test_run_that_ctrl_c_ends_leaves_the_terminal_as_it_was(triangles_in_a_plane):
    # all pairs of 4,000 triangles would take minutes
    status, shown = at_terminal(triangles_in_a_plane(4000), stop_at=b"narrow phase")
    assert status == 130
    assert screen_of(shown.replace("^C", "")) in ([], [line for line in screen_of(shown) if "warning" in line])


def test_run_that_fails_leaves_its_error_alone_on_the_terminal(triangles_in_a_plane):
    status, shown = at_terminal([*triangles_in_a_plane(500), "--memory-limit", "9000000"])
    assert status == 2
    (line,) = screen_of(shown)
    assert line.startswith("ccd-warp: error: memory_limit is 9000000 bytes; expected at least ")


def test_exploding_overlaps_are_one_line_that_says_what_to_do(triangles_in_a_plane):
    status, shown = at_terminal(triangles_in_a_plane(150), overlaps=1000)
    assert status == 0
    (line,) = screen_of(shown)
    assert line.startswith("ccd-warp: warning: ")
    assert all(word in line for word in ("pair_kinds", "exclusion_rings", "memory_limit"))


def test_quiet_run_says_nothing(triangles_in_a_plane):
    assert at_terminal([*triangles_in_a_plane(150), "--quiet"], overlaps=1000) == (0, "")


def test_ctrl_c_while_modules_are_imported_ends_the_command(triangles_in_a_plane):
    command = [sys.executable, "-P", "-c", _INTERRUPTED_IMPORT, "run", *triangles_in_a_plane(1), "--device", "cpu"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


def test_warning_of_overlaps_points_at_the_line_of_the_caller(monkeypatch):
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS", 1000)
    rng = np.random.default_rng(0)
    start = np.pad(rng.uniform(-1, 1, (300, 2)), ((0, 0), (0, 1)))
    mesh = ccd.CollisionMesh.from_arrays([(start, np.arange(300).reshape(-1, 3))])
    for call in (ccd.mesh_ccd, lambda *frames: ccd.CollisionPipeline(*frames[:1], device="cpu").mesh_ccd(*frames[1:])):
        with pytest.warns(RuntimeWarning, match="lie in each other, or") as caught:
            call(mesh, start, start + 0.1)
        assert [warning.filename for warning in caught] == [__file__]


def test_warning_of_overlaps_names_the_bodies_that_lie_in_each_other(monkeypatch):
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS", 1000)
    monkeypatch.setattr("ccd_warp._engine.host.oddities._MANY_PAIRS_EACH", 1)
    rng = np.random.default_rng(0)
    flat = np.pad(rng.uniform(-1, 1, (300, 2)), ((0, 0), (0, 1)))
    faces = np.arange(300).reshape(-1, 3)
    options = {"names": ["sheet", "far", "lining"], "self_collision": False}
    for pair_bytes in (1 << 30, 1):  # in one batch, and in several
        mesh = ccd.CollisionMesh.from_arrays([(flat, faces), (flat + [9, 9, 9], faces), (flat, faces)], **options)
        monkeypatch.setattr("ccd_warp._engine.host.step.DEFAULT_PAIR_BYTES", pair_bytes)
        with pytest.warns(RuntimeWarning, match=r"most often of sheet and lining \(100 % of a sample\)$"):
            result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + 0.1, device="cpu")
        assert (result.counts.num_batches > 1) == (pair_bytes == 1)
    # of twelve sheets that lie in each other, no two have a tenth of the pairs
    mesh = ccd.CollisionMesh.from_arrays([(flat, faces)] * 12, self_collision=False)
    with pytest.warns(RuntimeWarning, match=r"memory_limit bounds the memory$"):
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + 0.1, device="cpu")
    mesh = ccd.CollisionMesh.from_arrays([(flat, faces), (flat + [9, 9, 9], faces)], names=["cloth", "far"])
    end = mesh.vertices + 0.1 * (mesh.vertex_body[:, None] == 0)
    with pytest.warns(RuntimeWarning, match=r"most often of cloth and itself \(\d+ % of a sample\)$"):
        ccd.mesh_ccd(mesh, mesh.vertices, end, device="cpu")


def test_estimate_is_what_the_stage_has_taken_and_its_share():
    assert line_of(Progress(None, "pairs", 25, 100), 10.0) == f"pairs  [{'#' * 6}{' ' * 18}]  25%  about 30 s left"
    assert line_of(Progress(None, "pairs", 1, 1000), 10.0).endswith("0%  ...")
    assert line_of(Progress(None, "pairs", 50, 100), 600.0).endswith("about 10 min left")
    assert "100%" in line_of(Progress(None, "pairs", 101, 100), 1.0)


def test_line_is_written_to_terminals_alone(capsys):
    line = ProgressLine(is_quiet=False)
    line.show(Progress(None, "pairs", 1, 2))
    line.clear()
    assert capsys.readouterr().err == ""


def test_line_that_an_interrupt_has_cut_short_is_cleared_whole(monkeypatch):
    class Terminal:
        """Raises Ctrl-C directly after it has shown a line."""

        def __init__(self):
            self.shown, self.is_pressed = "", False

        def isatty(self):
            return True

        def write(self, text):
            self.shown += text

        def flush(self):
            if self.is_pressed:
                self.is_pressed = False
                raise KeyboardInterrupt

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr("ccd_warp._runtime.progress_line.PATIENCE", 0.0)
    line = ProgressLine(is_quiet=False)
    line.show(Progress(None, "pairs", 0, 100))
    terminal.is_pressed = True
    with pytest.raises(KeyboardInterrupt):
        line.show(Progress(None, "narrow phase", 50, 100))
    line.clear()
    assert screen_of(terminal.shown) == []
