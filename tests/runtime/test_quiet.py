"""What Warp says because of this library does not appear in a user's output; what it says of the user's own does."""

import subprocess
import sys

import pytest

SOLVE = """
import numpy as np
import ccd_warp as ccd
points_t0 = np.array([[[0.0, 0, 1], [-1, -1, 0], [1, -1, 0], [0, 2, 0]]])
points_t1 = points_t0 - [[[0, 0, 2], [0, 0, 0], [0, 0, 0], [0, 0, 0]]]
print(ccd.vertex_face_ccd(points_t0, points_t1).toi[0].round(3))
"""
KERNEL = """
import warp as wp
@wp.kernel
def fill(a: wp.array[float]):
    a[wp.tid()] = 1.0
a = wp.zeros(2, device="cpu")
wp.launch(fill, dim=2, inputs=[a], device="cpu")
print(a)
"""


def _run(folder, code: str) -> tuple[str, str]:
    script = folder / "script.py"  # a file, because Warp reads the source of kernels
    script.write_text(code, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def test_a_script_prints_what_it_prints_and_nothing_else(tmp_path):
    assert _run(tmp_path, SOLVE) == ("0.5\n", "")


def test_a_mesh_and_a_pipeline_are_as_quiet(tmp_path):
    code = """
import trimesh
import ccd_warp as ccd
ball = trimesh.creation.icosphere(subdivisions=1)
mesh = ccd.CollisionMesh.from_trimesh([ball, ball])
start = mesh.vertices + [[0, 0, 3 * body] for body in mesh.vertex_body]
print(ccd.collision_free_step(mesh, start, start))
ccd.CollisionPipeline(mesh, device="cpu").launch(start, start)
"""
    assert _run(tmp_path, code) == ("1.0\n", "")


def test_the_users_own_kernels_are_announced_as_ever(tmp_path):
    output, _ = _run(tmp_path, SOLVE + KERNEL)
    toi, module, values = output.splitlines()
    assert (toi, values) == ("0.5", "[1. 1.]") and module.startswith("Module __main__")


def test_a_user_who_starts_warp_sees_its_banner(tmp_path):
    output, _ = _run(tmp_path, "import ccd_warp, warp\nwarp.init()\n" + SOLVE)
    assert output.startswith("Warp ") and output.endswith("\n0.5\n") and "ccd_warp." not in output


def test_everything_is_shown_where_a_user_asks_for_it(tmp_path):
    output, _ = _run(tmp_path, "import warp\nwarp.config.log_level = warp.LOG_DEBUG\n" + SOLVE)
    assert output.startswith("Warp ") and "Module ccd_warp." in output


def test_a_logger_of_the_users_own_is_left_alone(tmp_path):
    code = """
import warp
class Logger:
    def debug(self, message): pass
    def info(self, message): print("mine:", message.split()[0])
    def warning(self, message, category=None, stacklevel=1): pass
    def error(self, message): pass
warp.set_logger(Logger())
"""
    output, _ = _run(tmp_path, code + SOLVE)
    assert output.startswith("mine: Warp\nmine: Module\n") and output.endswith("\n0.5\n")


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux's")
def test_only_the_line_about_a_missing_driver_is_kept_from_stderr(tmp_path):
    code = """
import os
from ccd_warp import _quiet
with _quiet._without_driver_warning():
    os.write(2, b"before\\nWarp CUDA warning: Could not find or load the NVIDIA CUDA driver. No GPU.\\nafter\\n")
os.write(2, b"end\\n")
"""
    assert _run(tmp_path, code) == ("", "before\nafter\nend\n")
