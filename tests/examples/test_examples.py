"""Every example runs as it stands, from any folder, and prints what it promises."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import loaded_example

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def _run(name: str, folder: Path, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _number(text: str, label: str) -> float:
    found = re.search(rf"^{label}\s+([^\s,]+)", text, flags=re.MULTILINE)
    assert found, f"{label!r} is not in:\n{text}"
    return float(found[1])


FEM = ("barrier_ipctk", "barrier_solver", "valve")
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py") if path.stem != "key_frames")


def _refused(name: str, monkeypatch, *arguments: str) -> SystemExit:
    """How an example ends that does not get to run."""
    for module in {"newton_cloth": ["newton"], "barrier_ipctk": ["skfem", "ipctk"]}.get(
        name, ["skfem"] * (name in FEM)
    ):
        pytest.importorskip(module, reason="an extra is not installed")
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    monkeypatch.syspath_prepend(EXAMPLES)  # one example imports another
    with loaded_example(name) as module:
        if arguments[0] == "--output":
            monkeypatch.setattr(module, "find_spec", lambda _: None)
        with pytest.raises(SystemExit) as error:
            module.main()
    return error.value


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_read_in_ten_minutes_and_says_how_long_it_takes(name, monkeypatch, capsys):
    lines = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 200 and re.search(r"\btakes\b", "\n".join(lines[:30]))
    if name == "mpi_cloth":  # in a process of its own, as MPI starts with its import
        done = subprocess.run([sys.executable, EXAMPLES / "mpi_cloth.py", "--help"], capture_output=True, text=True)
        if "needs mpi4py and an MPI" in done.stderr:
            pytest.skip("no MPI")
        text = done.stdout
    else:
        assert _refused(name, monkeypatch, "--help").code == 0
        text = capsys.readouterr().out
    assert "--output" in text and re.search(r"\d s\b|some\s+seconds|minute", text)


# the extras of newton and of finite elements have that of pictures, and MPI starts with the import of its example
@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("newton_cloth", "mpi_cloth", *FEM)])
def test_a_picture_without_its_extra_is_refused_by_the_name_of_the_extra(name, monkeypatch, capsys, tmp_path):
    assert _refused(name, monkeypatch, "--output", str(tmp_path)).code == 2
    assert "pip install 'ccd-warp[viz]'" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "module"), [("newton_cloth", "newton"), ("mpi_cloth", "mpi4py")])
def test_what_cannot_run_without_an_extra_names_it(name, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SystemExit, match=r"pip install 'ccd-warp\["), loaded_example(name):
        pass


def test_no_example_is_left_out():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "aim.py",
        "barrier_ipctk.py",
        "barrier_solver.py",
        "bounce_gradient.py",
        "bullet_2d.py",
        "bullet_through_wall.py",
        "cloth_drop.py",
        "dice.py",
        "fsi_membrane.py",
        "key_frames.py",
        "many_worlds.py",
        "mesh_against_mesh.py",
        "mpi_cloth.py",
        "newton_cloth.py",
        "nut_on_bolt.py",
        "robot_path.py",
        "rotor.py",
        "two_layers.py",
        "valve.py",
    }


def test_key_frames_of_both_runs_are_drawn_from_any_folder(tmp_path):
    output = _run("dice.py", tmp_path, "--frames", "2", "--dice", "2", "--output", "new/folder")
    assert len(re.findall(r"^with(?:out)? CCD: \d of 2 frames", output, re.M)) == 2
    image = pytest.importorskip("PIL.Image").open(tmp_path / "new" / "folder" / "dice.png")
    assert image.size == (2 * 360, 2 * 300)  # two frames of two runs
    assert len(image.convert("RGB").getcolors(1 << 16)) > 50


def test_bullet_through_wall(tmp_path):
    output = _run("bullet_through_wall.py", tmp_path, "--output", str(tmp_path))
    assert (tmp_path / "bullet_through_wall.png").stat().st_size > 10_000
    assert re.search(r"test at the start of the step:\s+MISS", output)
    assert re.search(r"test at the end of the step:\s+MISS", output)
    toi = _number(output, r"CCD over the whole step:\s+toi =")
    # Never later than the exact 0.5; earlier by at most the tolerance 1e-6 of the motion's 9 units over the speed 9.
    assert 0.5 - 1e-6 <= toi <= 0.5


def test_bounce_gradient(tmp_path):
    output = _run("bounce_gradient.py", tmp_path)
    truth = _number(output, "true")
    for steps, error in ((25, 0.02), (200, 0.005)):  # in proportion to the size of a step
        assert _number(output, rf"\s+{steps}") == pytest.approx(truth, abs=error)
        assert float(re.search(rf"^\s+{steps}\s+\S+\s+(\S+)", output, re.MULTILINE)[1]) == 1.0


def test_aim(tmp_path):
    output = _run("aim.py", tmp_path, "--throws", "60")
    assert "60 of 60 throws hit on time" in output


def test_bullet_2d(tmp_path):
    output = _run("bullet_2d.py", tmp_path)
    for method in ("bisection", "clipping"):
        # Never later than the exact 0.5; earlier by at most δ = 1e-4 over the speed 9, and the bisection's box.
        assert 0.5 - 1e-4 <= _number(output, rf"{method}\s+toi =") <= 0.5
        assert _number(output, rf"{method}.* at") == 0.5 and _number(output, rf"{method}.*gap <=") <= 1e-4
    steps = {name: int(re.search(rf"(\d+) {name}", output)[1]) for name in ("boxes", "steps")}
    assert steps["steps"] < steps["boxes"] < 1000


def test_mesh_against_mesh(tmp_path):
    output = _run("mesh_against_mesh.py", tmp_path, "--output", str(tmp_path))
    toi, step = _number(output, "first contact +toi ="), _number(output, "free step")
    assert 0.0 < step < toi < 1.0
    assert _number(output, "contacts") >= 1
    # a vertex of the small ball, which comes from the left, and a face of the large one: the normal points to the left
    found = re.search(r", vertex (\d+) of the small ball and face (\d+) of the large ball$", output, re.M)
    vertex, face = map(int, found.groups())
    assert vertex < 642 and face >= 1280
    normal = [float(number) for number in re.search(r"normal \((.*)\)", output)[1].split(", ")]
    assert normal[0] < -0.9 and math.isclose(math.hypot(*normal), 1.0, abs_tol=1e-3)
    assert re.search(r"^free step .* 0 intersections", output, re.M)
    assert int(re.search(r"^whole step .* (\d+) intersections", output, re.M)[1]) > 0
    assert (tmp_path / "mesh_against_mesh.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["bullet", "cloth"])
def test_demo_scenes_are_what_their_titles_say(name):
    from ccd_warp._cli.demo import bullet_scene, cloth_scene, static_test, surfaces_intersect

    scene = {"bullet": bullet_scene, "cloth": cloth_scene}[name]()
    moving, static = scene.bodies
    assert static.is_static and not moving.is_static
    if name == "bullet":
        assert static_test(scene.bodies) == (False, False)
        middle = moving.vertices_t0 + 0.5 * (moving.vertices_t1 - moving.vertices_t0)
        assert surfaces_intersect(middle, moving.faces, static.vertices_t0, static.faces)
    else:
        assert 10_000 <= len(moving.faces) <= 11_000
        assert math.isclose(float(abs(static.vertices_t0).max()), 1.0)
        # It starts outside the sphere and ends with vertices inside.
        assert (moving.vertices_t0**2).sum(axis=1).min() > 1.0
        assert (moving.vertices_t1**2).sum(axis=1).min() < 0.9
