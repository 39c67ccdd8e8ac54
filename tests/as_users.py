"""Three users of an installed package, each with a program of their own; run by `.ci/run` and `nox`, not by pytest.

One replaces ipc-toolkit's CCD in a line search, one has a loop on the device with a graph and arrays of Warp and NumPy,
one has STL and OBJ files and a command line. The environment holds the package and what it depends on, nothing else,
and the current folder is empty: `python -P …/tests/as_users.py [OBJECTS]`. OBJECTS is a folder in which Pythons that
are checked one after another leave what they have compiled.
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path

import numpy as np
import trimesh
import warp as wp
from warp._src import build

import ccd_warp as ccd

BARE = {"ccd-warp", "numpy", "trimesh", "warp-lang", "pip", "setuptools"}
COMMAND = Path(sysconfig.get_path("scripts"), "ccd-warp")


def check_surroundings() -> None:
    """The package is the installed one, in an environment and a folder without anything that could help it."""
    assert Path(sysconfig.get_path("purelib")) in Path(ccd.__file__).parents, ccd.__file__
    installed = {str(found.metadata["Name"]).lower().replace("_", "-") for found in metadata.distributions()}
    assert installed <= BARE, f"more is installed than the package needs: {sorted(installed - BARE)}"
    assert not list(Path.cwd().iterdir()), f"{Path.cwd()} is not empty"


class SharedObjects:
    """What Pythons have compiled: where one writes the same C++ as another, it takes the other's object code.

    Each Python reads the source of the kernels by itself, which is where they may differ; the compiler is the same.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.compiled, self.taken = folder, 0, 0
        self._build = build.build_cpu
        build.build_cpu = self._build_once

    def _build_once(self, object_path: str, source_path: str, **options: object) -> None:
        lines = Path(source_path).read_text(encoding="utf-8").splitlines()
        source = [line for line in lines if not line.startswith("//")]  # these name files of the environment
        flags = sorted((name, str(value)) for name, value in options.items() if name != "pch_dir")
        name = hashlib.sha256(repr((wp.__version__, flags, source)).encode()).hexdigest()
        if (kept := self.folder / f"{name}.o").exists():
            shutil.copy(kept, object_path)
            self.taken += 1
            return
        self._build(object_path, source_path, **options)
        shutil.copy(object_path, made := kept.with_suffix(f".{os.getpid()}"))
        made.rename(kept)
        self.compiled += 1


def cloth_over_ball(height: float) -> tuple[ccd.CollisionMesh, int]:
    """A cloth over a static ball, and the number of its vertices."""
    x, y = np.meshgrid(*[np.linspace(-0.5, 0.5, 13)] * 2, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    low = (np.arange(12)[:, None] * 13 + np.arange(12)).reshape(-1, 1)
    faces = np.concatenate([low + [0, 13, 1], low + [1, 13, 14]])
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    bodies = [(vertices + [0.01, 0.02, height], faces), (np.asarray(ball.vertices), np.asarray(ball.faces))]
    return ccd.CollisionMesh.from_arrays(bodies, static=["ball"], names=["cloth", "ball"]), len(vertices)


def run_line_search() -> str:
    """A cloth falls on a ball by steps that CCD bounds, until it has come close."""
    mesh, _ = cloth_over_ball(0.32)
    options: ccd.MeshOptions = {"minimum_separation": 1e-4, "start_gap_fraction": 0.2, "length_scale": 1.0}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    x, down = mesh.vertices.copy(), -0.5 * np.outer(~mesh.static[mesh.vertex_body], [0, 0, 1])
    steps = []
    for _ in range(8):
        steps.append(pipeline.collision_free_step(x, x + down))
        assert 0 < steps[-1] < 1 and ccd.is_step_collision_free(mesh, x, x + steps[-1] * down)
        x = x + steps[-1] * down
    assert 0.019 < 0.5 * sum(steps) < 0.02 and ccd.mesh_ccd(mesh, x, x).first is None, steps
    result = ccd.mesh_ccd(mesh, x, x + down)
    first = result.first
    assert first is not None and first.toi > 0 and set(first.body_names) == {"cloth", "ball"}
    assert 0.29 < np.linalg.norm(first.point) < 0.31
    found = ccd.line_search(mesh, x, x + down, per="vertex")
    assert ccd.is_step_collision_free(mesh, x, found.vertices)
    return f"the cloth is {0.5 * sum(steps):.6f} lower after {len(steps)} steps; then {first!r}"


@wp.kernel
def fall(x: wp.array[wp.vec3f], velocity: wp.array[wp.vec3f], dt: float, wished: wp.array[wp.vec3f]):
    i = wp.tid()
    velocity[i] += dt * wp.vec3f(0.0, 0.0, -9.81)
    wished[i] = x[i] + dt * velocity[i]


@wp.kernel
def respond(wished: wp.array[wp.vec3f], dt: float, x: wp.array[wp.vec3f], velocity: wp.array[wp.vec3f]):
    i = wp.tid()
    velocity[i] = (wished[i] - x[i]) / dt
    x[i] = wished[i]


def run_loop_on_the_device() -> str:
    """A cloth falls on a ball in a graph, with a line search, and the contacts of the free fall where they are."""
    mesh, count = cloth_over_ball(0.5)
    start = mesh.vertices.astype(np.float32)
    pipeline, probe = (ccd.CollisionPipeline(mesh, length_scale=1.0) for _ in range(2))
    x, wished = wp.array(start, dtype=wp.vec3f), wp.array(start, dtype=wp.vec3f)
    velocity, contacts = wp.zeros_like(x), probe.launch(x, wished).contacts
    order = contacts.order_by_toi()

    def step(dt: float = 0.03) -> None:
        wp.launch(fall, dim=count, inputs=[x, velocity, dt], outputs=[wished])
        probe.launch(x, wished)
        pipeline.launch_line_search(x, wished, per="body", safety=0.99)
        wp.launch(respond, dim=count, inputs=[wished, dt], outputs=[x, velocity])

    step()
    with wp.ScopedCapture() as capture:
        step()
    for _ in range(30):
        wp.capture_launch(capture.graph)
    height = float(x.numpy()[:count, 2].min())
    contacts.order_by_toi()
    first = int(order.numpy()[0])
    point, pair = contacts.points.numpy()[first], contacts.bodies.numpy()[first]
    assert 0.3 < height < 0.31, height
    assert abs(np.linalg.norm(point) - 0.3) < 1e-2 and set(pair.tolist()) == {0, 1}

    end = start.copy()
    end[:count, 2] -= 1.0
    result = probe.launch(wp.array(start, dtype=wp.vec3f), end)
    assert ccd.LaunchFlag(int(result.flags.numpy()[0])) == ccd.LaunchFlag(0)
    host, expected = result.to_host(), ccd.mesh_ccd(mesh, start, end, length_scale=1.0)
    if wp.get_device().is_cpu:  # as other libraries take it
        assert np.array_equal(np.from_dlpack(result.vertex_toi), host.vertex_toi)
    assert host.toi == expected.toi and np.array_equal(host.contacts.points, expected.contacts.points)
    return f"the cloth stops {height:.4f} above the middle of the ball; first contact of its fall: {point.round(3)}"


def run_command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run `ccd-warp` with these arguments."""
    return subprocess.run([COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False)


def run_on_files() -> str:
    """A ball in STL flies through a wall in OBJ; the same from the command line and in Python."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    for name, x in (("t0", -1.0), ("t1", 1.0)):
        trimesh.Trimesh(ball.vertices + [x, 0, 0], ball.faces).export(f"ball_{name}.stl")
    wall = trimesh.creation.box(extents=(0.02, 2.0, 2.0))
    wall.export("wall.obj")
    done = run_command("run", "ball_t0.stl", "ball_t1.stl", "--static", "wall.obj", "--output", "result.json")
    assert (done.returncode, done.stderr) == (0, ""), done
    frames = ccd.read_frames("ball_t0.stl", "ball_t1.stl", static=["wall.obj"])
    result = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1)
    assert json.loads(Path("result.json").read_text(encoding="utf-8"))["toi"] == result.toi
    # the tip at x = 0.1 - 1 meets the wall at x = -0.01 after 0.89 of a way of 2; STL holds single precision
    assert abs(result.toi - 0.445) < 1e-6 and np.allclose(result.first.point, [-0.01, 0, 0], atol=1e-6)
    done = run_command("run", "ball_t0.stl", "wall.obj")
    assert done.returncode == 2 and "same format" in done.stderr and "Traceback" not in done.stderr, done
    assert run_command("--version").stdout == f"ccd-warp {ccd.__version__}\n"
    done = run_command("demo", "--output-dir", "demo")
    assert done.returncode == 0 and len(list(Path("demo").iterdir())) > 4, done
    return f"the ball meets {result.first.body_names[1]} at t = {result.toi:.6f}"


def main() -> None:
    check_surroundings()
    shared = SharedObjects(Path(sys.argv[1])) if len(sys.argv) > 1 else None
    for user in (run_line_search, run_loop_on_the_device, run_on_files):
        print(f"{user.__name__}: {user()}", flush=True)
    if shared:
        print(f"{shared.compiled} modules compiled, {shared.taken} written in the same C++ as by an earlier Python")


if __name__ == "__main__":
    main()
