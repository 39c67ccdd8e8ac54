"""What a type checker says of calls: mistakes in options are found before anything runs, right calls pass."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SETUP = """
import numpy as np
import ccd_warp as ccd
x = np.zeros((1, 4, 3))
mesh = ccd.CollisionMesh.from_arrays([(x[0], np.array([[0, 1, 2]]))])
pair_options: ccd.PairOptions = {"tolerance": 1e-9, "device": None, "num_threads": 2}
mesh_options: ccd.MeshOptions = {"t_max": 0.5, "pair_kinds": ["vertex_face"], "max_work": 10}
"""
RIGHT = """
ccd.vertex_face_ccd(x, x, precision="float32", method="bisection", tolerance=1, device="cpu", num_threads=None)
ccd.point_point_ccd(x[:, :2], x[:, :2], **pair_options)
ccd.mesh_ccd(mesh, x[0], x[0], pair_kinds=["vertex_face", ccd.PairKind.EDGE_EDGE], memory_limit=None, t_max=0.5)
ccd.mesh_ccd(mesh, x[0], x[0], **mesh_options)
ccd.collision_free_step(mesh, x[0], x[0], start_gap_fraction=0.5, length_scale=1.0, max_work=10)
free: bool = ccd.is_step_collision_free(mesh, x[0], x[0], t_max=0.5)
ccd.line_search(mesh, x[0], x[0], per="vertex", safety=0.5, minimum_separation=0.1)
ccd.find_candidates(mesh, x[0], x[0], 0.1, pair_kinds=("edge_edge",), num_threads=1)
ccd.CollisionPipeline(mesh, max_pairs=10, **mesh_options).line_search(x[0], x[0], per="world")
ccd.viz.draw_step(mesh.replicate(2), x[0], x[0], ccd.mesh_ccd(mesh, x[0], x[0])).save("step.png")
ccd.datasets.find_queries("folder")[0].points_t0
frames = ccd.read_frames("a.stl", "b.stl", static=["wall.stl"])
contacts = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1).contacts
height: float = contacts[0].point[2] + contacts[1:].points[0, 2] + sum(contact.toi for contact in contacts)
"""
WRONG = """
ccd.vertex_face_ccd(x, x, precision="float16")
ccd.vertex_face_ccd(x, x, presicion="float32")
ccd.edge_edge_ccd(x, x, method=3)
ccd.edge_edge_ccd(x, x, max_work=10)
ccd.point_segment_ccd(x, x, tolerance="small")
ccd.point_point_ccd(x, x, 1e-6)
ccd.mesh_ccd(mesh, x[0], x[0], pair_kinds=["vertex-face"])
ccd.mesh_ccd(mesh, x[0], x[0], pair_kinds="vertex_face")
ccd.mesh_ccd(mesh, x[0], x[0], memory_limits=10)
ccd.mesh_ccd(mesh, x[0], x[0], device=0)
ccd.collision_free_step(mesh, x[0], x[0], max_iterations=0.5)
ccd.line_search(mesh, x[0], x[0], t_max=0.5)
ccd.line_search(mesh, x[0], x[0], per="face")
ccd.find_candidates(mesh, x[0], x[0], tolerance=0.1)
ccd.CollisionPipeline(mesh, tolerence=0.1)
bad_options: ccd.MeshOptions = {"method": "bisect"}
ccd.read_frames("a.stl", "b.stl", static=3)
ccd.mesh_ccd(mesh, x[0], x[0]).first.toi
ccd.CollisionMesh.from_trimesh([], names=3)
"""


def test_mistakes_in_options_are_found_and_right_calls_pass(monkeypatch):
    api = pytest.importorskip("mypy.api", reason="the extra lint is not installed")
    monkeypatch.chdir(ROOT)  # where mypy finds the package, however it was installed
    code = (SETUP + RIGHT + WRONG).splitlines()
    arguments = ["--config-file=", "--strict", "--ignore-missing-imports", "--follow-imports=silent", "--no-pretty"]
    output, errors, _ = api.run([*arguments, "--cache-dir=.mypy_cache/tests", "-c", "\n".join(code)])
    assert not errors
    found = dict.fromkeys(code[int(line) - 1] for line in re.findall(r"^<string>:(\d+): error:", output, re.M))
    assert list(found) == WRONG.split("\n")[1:-1], output
