"""The command `ccd-warp sequence`: every step of a sequence of frames, interrupted and resumed."""

import csv
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
from conftest import loaded_example

import ccd_warp as ccd
from ccd_warp._cli import sequence as sequence_command
from ccd_warp._cli.command import main
from ccd_warp._cli.sequence_records import draw_plot, ranges_text
from ccd_warp._files.frames import write_mesh

# A separation at which the cloth of the example, which keeps clear of the globe, has contacts in most steps.
OPTIONS = ["--length-scale", "1", "--minimum-separation", "0.01"]
NUM_FRAMES = 30


@pytest.fixture(scope="module")
def cloth():
    """Thirty frames of examples/cloth_drop.py: positions [T, V, 3], and the faces of the cloth and of the globe."""
    with loaded_example("cloth_drop") as module:
        scene = module.ClothDrop(21)
        frames = np.array(list(scene.frames(NUM_FRAMES)))
        faces = scene.mesh.faces.astype(np.int64)
        is_cloth = scene.mesh.face_body == 0
        yield scene.num_cloth, frames, faces[is_cloth], faces[~is_cloth] - scene.num_cloth


@pytest.fixture(scope="module")
def drop(cloth, tmp_path_factory):
    """A folder with the frames as files of both bodies."""
    count, frames, cloth_faces, globe_faces = cloth
    folder = tmp_path_factory.mktemp("drop")
    for k, frame in enumerate(frames):
        write_mesh(folder / f"cloth_{k}.ply", frame[:count], cloth_faces)
        write_mesh(folder / f"globe_{k}.ply", frame[count:], globe_faces)
    return folder


@pytest.fixture(scope="module")
def expected(cloth):
    """Results of all steps through the Python interface."""
    count, frames, cloth_faces, globe_faces = cloth
    mesh = ccd.CollisionMesh.from_arrays([(frames[0, :count], cloth_faces), (frames[0, count:], globe_faces)])
    with_options = ccd.CollisionPipeline(mesh, length_scale=1.0, minimum_separation=0.01)
    return [with_options.mesh_ccd(*step) for step in itertools.pairwise(frames)]


@pytest.fixture
def ball(tmp_path):
    """Eleven frames of a ball that falls onto a box in the step from frame 5 to frame 6, and the box."""
    shape = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    box = trimesh.creation.box(extents=(4.0, 4.0, 1.0))
    for k in range(11):
        write_mesh(tmp_path / f"ball_{k}.ply", shape.vertices + [0.1, 0.2, 3.25 - 0.5 * k], shape.faces)
    write_mesh(tmp_path / "floor.ply", box.vertices - [0.0, 0.0, 0.5], box.faces)
    return tmp_path


def _rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def _run(*arguments):
    return main(["sequence", *map(str, arguments)])


def _frames_of(folder):
    """The frames of the ball, as a shell lists them: 10 before 2."""
    return sorted(map(str, folder.glob("ball_*.ply")))


def _refused(capfd, *arguments) -> str:
    assert _run(*arguments) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.startswith("ccd-warp: error: ") and captured.err.count("\n") == 1
    return captured.err


def test_cloth_of_thirty_frames_is_interrupted_and_goes_on_where_it_was(drop, expected, tmp_path, capfd, monkeypatch):
    """Each step is computed once, and the answers are those of a run that was left alone, and of the library."""
    folder, solved, stops = tmp_path / "out", [], [7, 18]
    solve = sequence_command.solve

    def solve_and_press(*arguments, **options):
        if stops and len(solved) == stops[0]:
            stops.pop(0)
            raise KeyboardInterrupt
        solved.append(arguments)
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", solve_and_press)
    for done in tuple(stops):
        assert _run(drop, *OPTIONS, "--output", folder) == 130
        captured = capfd.readouterr()
        assert f"interrupted after {done} of 29 steps; what was computed is kept" in captured.err
        assert len(_rows(folder / "steps.csv")) == done
    assert _run(drop, *OPTIONS, "--output", folder) == 0
    assert "18 of 29 steps were computed before" in capfd.readouterr().out
    assert len(solved) == NUM_FRAMES - 1
    assert _run(drop, *OPTIONS, "--output", tmp_path / "at_once", "--quiet") == 0
    assert (folder / "steps.csv").read_bytes() == (tmp_path / "at_once" / "steps.csv").read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["steps.csv", "steps.png"]
    assert capfd.readouterr() == ("", "")

    rows = _rows(folder / "steps.csv")
    assert [float(row["toi"]) for row in rows] == [result.toi for result in expected]
    assert [int(row["contacts"]) for row in rows] == [len(result.contacts) for result in expected]
    assert 0 < sum(result.hit for result in expected) < NUM_FRAMES - 1
    for row, result in zip(rows, expected, strict=True):
        if result.hit:
            assert [float(row[axis]) for axis in "xyz"] == result.first.point.tolist()
            assert {row["body_0"], row["body_1"]} <= {"cloth", "globe"}


def test_ctrl_c_keeps_the_steps_so_far(cloth, tmp_path):
    """A process of its own: the same command, interrupted while it works, ends with what one run gives."""
    count, frames, faces, _ = cloth
    positions = np.tile(frames[:, :count], (6, 1, 1))
    np.savez(tmp_path / "cloth.npz", positions=positions, faces=faces)
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell may have had it ignored
        "from ccd_warp._cli.command import run_program; run_program()"
    )
    command = [sys.executable, "-P", "-c", program, "sequence", "cloth.npz", *OPTIONS, "--output", "out"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    journal, end = tmp_path / "out" / "sequence.journal", time.monotonic() + 600.0  # a guard against hanging
    while process.poll() is None and time.monotonic() < end:
        if journal.exists() and journal.read_text().count("\n") > 3:
            process.send_signal(signal.SIGINT)
            break
        time.sleep(0.001)
    _, said = process.communicate(timeout=600.0)
    if process.returncode == 130:
        assert "the same command goes on from there" in said
        again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert again.returncode == 0 and "steps were computed before" in again.stdout
    assert len(_rows(tmp_path / "out" / "steps.csv")) == len(positions) - 1
    assert not journal.exists()


def test_other_options_or_frames_begin_anew(ball, capfd, monkeypatch):
    solve, solved = sequence_command.solve, []

    def press_at_three(*arguments, **options):
        solved.append(arguments)
        if len(solved) == 4:
            raise KeyboardInterrupt
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", press_at_three)
    assert _run(*_frames_of(ball), "--output", ball / "out") == 130
    shutil.copy(ball / "ball_9.ply", ball / "ball_10.ply")
    assert _run(*_frames_of(ball), "--output", ball / "out") == 0
    assert len(solved) == 4 + 10
    assert "computed before" not in capfd.readouterr().out


def test_report_names_the_steps_with_contacts_and_the_first(ball, capfd):
    assert _run(*_frames_of(ball), "--static", ball / "floor.ply", "--output", ball / "out") == 0
    out = capfd.readouterr().out
    assert "11 frames of ball" in out
    assert "steps with contacts  5 of 10: 5-9\n" in out
    (first,) = [line for line in out.splitlines() if line.startswith("the first")]
    assert first.startswith("the first  step 5, ball_5.ply -> ball_6.ply, toi 0.4999")
    assert "of ball" in out and "of floor.ply" in out and "not seen  what surfaces that cross" in out
    assert "surfaces cross at the start of  4 of 10 steps: 6-9\n" in out
    rows = _rows(ball / "out" / "steps.csv")
    assert [row["start"] for row in rows] == [f"ball_{k}.ply" for k in range(10)]
    # The ball comes down half a unit a step from a gap of 2.75, and is still passing through the box at the end.
    assert float(rows[5]["toi"]) == pytest.approx(0.5, abs=1e-5) and float(rows[5]["toi"]) <= 0.5
    assert [np.isfinite(float(row["toi"])) for row in rows] == [k >= 5 for k in range(10)]
    assert (ball / "out" / "steps.png").read_bytes().startswith(b"\x89PNG")


def test_no_contact_is_certain_for_the_pairs_looked_at_alone(ball, capfd):
    assert _run(*_frames_of(ball)[:3], "--output", ball / "out", "--pair-kinds", "edge-edge", "--fail-on-contact") == 0
    out = capfd.readouterr().out
    assert "none of 2   (certain for the pairs looked at: edge-edge, in [0, 1])" in out
    assert "left out  vertex-face pairs (--pair-kinds)" in out


def test_exit_status_tells_a_script_of_a_contact(ball):
    arguments = (*_frames_of(ball), "--static", ball / "floor.ply", "--output", ball / "out", "--quiet")
    assert _run(*arguments) == 0
    assert _run(*arguments, "--fail-on-contact") == 1


def _in_gltf(ball):
    """Frames whose positions lie in a file beside each; returns what to give, and what makes the third the second."""
    for k in range(4, 8):
        mesh = trimesh.load(ball / f"ball_{k}.ply", process=False)
        files = trimesh.Scene(mesh).export(file_type="gltf", merge_buffers=True)
        tree, (buffer,) = json.loads(files.pop("model.gltf")), files.values()
        tree["buffers"][0]["uri"] = f"{k}.bin"
        (ball / f"{k}.bin").write_bytes(buffer)
        (ball / f"ball_{k}.gltf").write_text(json.dumps(tree))
    return sorted(ball.glob("ball_*.gltf")), lambda: (ball / "6.bin").write_bytes((ball / "5.bin").read_bytes())


def _in_xdmf(ball):
    """The same as a series whose geometries lie in a binary file for each frame."""
    item = '<DataItem DataType="{}" Precision="8" Dimensions="{} 3" Format="{}">{}</DataItem>'
    grids = []
    for k in range(4, 8):
        mesh = trimesh.load(ball / f"ball_{k}.ply", process=False)
        mesh.vertices.astype(np.float64).tofile(ball / f"{k}.bin")
        faces = item.format("Int", len(mesh.faces), "XML", " ".join(map(str, mesh.faces.ravel())))
        points = item.format("Float", len(mesh.vertices), "Binary", f"{k}.bin")
        grids.append(
            f'<Grid><Time Value="{k}"/><Topology TopologyType="Triangle" NumberOfElements="{len(mesh.faces)}">{faces}'
            f'</Topology><Geometry GeometryType="XYZ">{points}</Geometry></Grid>'
        )
    series = f'<Grid GridType="Collection" CollectionType="Temporal">{"".join(grids)}</Grid>'
    (ball / "ball.xdmf").write_text(f'<Xdmf Version="3.0"><Domain>{series}</Domain></Xdmf>')
    return [ball / "ball.xdmf"], lambda: (ball / "6.bin").write_bytes((ball / "5.bin").read_bytes())


@pytest.mark.parametrize("frames_in", [_in_gltf, _in_xdmf])
def test_step_is_computed_again_where_a_file_beside_its_frames_has_changed(ball, monkeypatch, frames_in):
    """The positions lie in files beside the one that is given, which stays as it is."""
    frames, make_third_the_second = frames_in(ball)
    given = [*frames, "--static", ball / "floor.ply", "--quiet", "--output"]
    solve, solved = sequence_command.solve, []

    def solve_and_press(*arguments, **options):
        if len(solved) == 2:
            raise KeyboardInterrupt
        solved.append(arguments)
        return solve(*arguments, **options)

    monkeypatch.setattr(sequence_command, "solve", solve_and_press)
    assert _run(*given, ball / "out") == 130  # the steps 4 to 5 and 5 to 6 are kept; the ball strikes in the second
    make_third_the_second()
    solved.append(None)
    assert _run(*given, ball / "out") == 0
    assert len(solved) == 3 + 2  # the second step again, and the last one
    assert _run(*given, ball / "afresh") == 0
    assert (ball / "out" / "steps.csv").read_bytes() == (ball / "afresh" / "steps.csv").read_bytes()
    assert _rows(ball / "out" / "steps.csv")[1]["toi"] == "inf"


def test_standard_output_takes_the_csv_alone(ball, capfd):
    assert _run(*_frames_of(ball), "--static", ball / "floor.ply", "--output", "-") == 0
    captured = capfd.readouterr()
    assert len(list(csv.DictReader(captured.out.splitlines()))) == 10
    assert "steps with contacts" in captured.err
    assert not (ball / "ccd_warp_sequence").exists()


def test_every_step_gives_what_run_gives_for_its_frames(ball):
    """Also of a format in which vertices are split: there each step merges what coincides at its own ends."""
    for k in range(5, 7):
        mesh = trimesh.load(ball / f"ball_{k}.ply", process=False)
        mesh.export(ball / f"ball_{k}.glb")
    frames = [ball / "ball_5.glb", ball / "ball_6.glb"]
    scene = ["--static", str(ball / "floor.ply"), "--quiet", "--output"]
    assert main(["run", *map(str, frames), *scene, str(ball / "run.json")]) == 0
    assert _run(*frames, *scene, ball / "out") == 0
    (row,) = _rows(ball / "out" / "steps.csv")
    assert float(row["toi"]) == json.loads((ball / "run.json").read_text())["toi"]


@pytest.mark.parametrize("suffix", [".gif", pytest.param(".mp4", marks=pytest.mark.long), ".png"])
def test_pictures_of_a_sequence(ball, suffix):
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    if suffix == ".mp4":
        from ccd_warp.viz._animation import encoder

        if encoder() is None:
            pytest.skip("no ffmpeg found")
    picture = ball / f"fall{suffix}"
    frames = _frames_of(ball)[-5:]  # 5 to 9
    assert _run(*frames, "--static", ball / "floor.ply", "--output", "-", "--picture", picture, "--quiet") == 0
    content = picture.read_bytes()
    if suffix == ".mp4":
        assert content[4:8] == b"ftyp"
        return
    from PIL import Image

    with Image.open(picture) as image:
        # Five frames and the toi of the four steps with a contact.
        assert getattr(image, "n_frames", 1) == (9 if suffix == ".gif" else 1)


def test_steps_at_whose_start_surfaces_cross_are_marked(tmp_path, monkeypatch):
    """In the plot and the animation: a triangle comes down through another, and stays there without a contact."""
    from PIL import Image

    vertices = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [0.5, 0.5, -1], [0.6, 0.5, 1], [0.5, 0.6, 2]])
    for k, height in enumerate((4.0, 3.0, 0.0, 0.0, 0.0)):
        frame = vertices + height * np.outer(np.arange(6) > 2, [0, 0, 1])
        write_mesh(tmp_path / f"a_{k}.ply", frame, np.array([[0, 1, 2], [3, 4, 5]]))
    plots = []
    monkeypatch.setattr("ccd_warp._cli.sequence.draw_plot", lambda *arguments: plots.append(draw_plot(*arguments)))
    output = ["--quiet", "--output", tmp_path / "out", "--picture", tmp_path / "out.gif"]
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    assert _run(*sorted(tmp_path.glob("*.ply")), *output) == 0
    rows = _rows(tmp_path / "out" / "steps.csv")
    assert [(row["toi"] == "inf", int(row["crossing_at_start"])) for row in rows] == [
        *((True, 0), (False, 0)),
        *((True, 2), (True, 2)),
    ]
    lines = {line.get_label(): line.get_xdata().tolist() for line in plots[0].axes[0].lines}
    assert lines == {"no contact": [0], "toi": [1], "surfaces cross at the start": [2, 3]}
    assert [text.get_text() for text in plots[0].axes[0].get_legend().get_texts()] == [*lines]
    with Image.open(tmp_path / "out.gif") as image:
        marked = []
        for k in range(image.n_frames):
            image.seek(k)
            is_marked = np.abs(np.asarray(image.convert("RGB")).astype(int) - [214, 0, 143]).max(axis=2) < 24
            marked.append(bool(is_marked.sum() > 100))
    assert marked == [False, False, False, True, True, False]  # the third is at the toi, the last begins no step


def test_colour_of_few_pixels_stays_as_it_is(tmp_path):
    """As the legend's colour of a body that another hides, in a picture of many shades of one colour."""
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    from PIL import Image

    from ccd_warp.viz._animation import write_animation

    shade = np.linspace(0.3, 1.0, 800 * 600).reshape(600, 800, 1)
    image = (shade * [230.0, 170.0, 90.0] + np.arange(800)[:, None] % 9).astype(np.uint8)
    image[580:592, 12:24] = 91, 135, 181
    write_animation(tmp_path / "a.gif", [(image, False)])
    with Image.open(tmp_path / "a.gif") as read:
        found = np.asarray(read.convert("RGB"))[586, 18].astype(int)
    assert np.abs(found - [91, 135, 181]).max() <= 16


def test_picture_that_cannot_be_made_is_refused_before_the_work(ball, capfd, monkeypatch):
    pytest.importorskip("pyvista", reason="the extra viz is not installed")
    assert ".gif, .mp4, .png" in _refused(capfd, *_frames_of(ball), "--picture", ball / "a.webm")
    monkeypatch.setattr("ccd_warp.viz._animation.encoder", lambda: None)
    assert "MP4 needs an encoder; install ffmpeg" in _refused(capfd, *_frames_of(ball), "--picture", ball / "a.mp4")
    assert "does not exist" in _refused(capfd, *_frames_of(ball), "--picture", ball / "none" / "a.gif")


def test_frames_that_do_not_fit_are_refused(ball, capfd):
    floor = ball / "floor.ply"
    assert "no such file or folder" in _refused(capfd, ball / "gone.ply", floor)
    assert "has 1 frame; expected two or more" in _refused(capfd, floor)
    assert "11 files ball_#.ply and 1 floor.ply; each body needs one file for each frame" in _refused(capfd, ball)
    assert "topology differs: " in _refused(capfd, ball / "ball_1.ply", floor)
    (ball / "empty").mkdir()
    assert "holds no frames" in _refused(capfd, ball / "empty")


def test_a_frame_in_another_unit_and_a_turn_by_half_are_warned_of(ball, capfd):
    square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for k, frame in enumerate((square, square, -square, -1000.0 * square)):
        write_mesh(ball / f"sheet_{k}.ply", frame, faces)
    sheets = [ball / f"sheet_{k}.ply" for k in range(4)]
    assert _run(*sheets[:3], "--output", "-") == 0
    error = capfd.readouterr().err
    assert "ccd-warp: warning: step 1: 5 of 5 edges shrink to a tenth or less within the step" in error
    assert _run(*sheets[2:], "--output", "-") == 0
    assert "2 long at the start and 2000 at the end of the step; are both frames in the same unit?" in (
        capfd.readouterr().err
    )


def test_runs_of_numbers_are_written_as_ranges():
    assert ranges_text([]) == "" and ranges_text([4]) == "4"
    assert ranges_text([0, 1, 2, 5, 7, 8]) == "0-2, 5, 7-8"
