"""What a type checker says of calls: mistakes in options are found before anything runs, right calls pass."""

import inspect
import re
from pathlib import Path
from typing import Any, get_overloads

import pytest
import warp as wp

import ccd_warp as ccd

SETUP = """
import numpy as np
import warp as wp
import ccd_warp as ccd
on_device = wp.zeros((1, 4), dtype=wp.vec3d)
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
free: bool = ccd.is_step_collision_free(mesh, x[0], x[0], t_max=0.5)
ccd.line_search(mesh, x[0], x[0], per="vertex", safety=0.5, minimum_separation=0.1)
ccd.find_candidates(mesh, x[0], x[0], 0.1, pair_kinds=("edge_edge",), broad_phase="hash", num_threads=1)
found = ccd.find_intersections(mesh, x[0], num_threads=1, memory_limit=None)
near = ccd.find_proximity(mesh, x[0], 0.1, pair_kinds=["vertex_face"], memory_limit=10).unique().points[0, 1, 2]
bound: float = ccd.displacement_bounds(mesh, x[0], 0.1, minimum_distance=0.01)[0]
through: int = len(found[found.is_crossing]) + found.by_bodies()["a", "b"]
ccd.CollisionPipeline(mesh, max_pairs=10, **mesh_options).line_search(x[0], x[0], per="world")
ccd.viz.draw_step(mesh.replicate(2), x[0], x[0], ccd.mesh_ccd(mesh, x[0], x[0])).save("step.png")
frames = ccd.read_frames("a.stl", "b.stl", static=["wall.stl"])
for vertices in ccd.read_sequence(["a.pvd"], static=[ccd.HalfSpace([0, 0, 0], [0, 0, 1])], surface=True)[1:]:
    inside: int = len(ccd.CollisionMesh.from_volume(vertices, {"tetra": [[0, 1, 2, 3]]}, static=[0]).inner_vertices)
contacts = ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1).contacts
launched = ccd.CollisionPipeline(mesh).launch(x[0], x[0]).contacts
places = [launched.points, launched.points_at(x[0], x[0]), launched.weights]
motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1]], twist=[[0.0] * 6], path="screw")
turned = ccd.RigidMotion.from_scalar_first(x, x, pivot=x[0, 0]).poses_t1
angle: float = motion.at(0.5)[0, 0] + motion.turns[0] + turned[0, 0]
bodies: int = motion.num_bodies + motion.num_worlds
earliest: float = ccd.edge_edge_ccd(x, x).toi.min() + ccd.edge_edge_ccd(x.tolist(), x.tolist()).gap.max()
address = ccd.edge_edge_ccd(on_device, on_device).toi.ptr
searched = ccd.line_search(mesh, x[0], x[0], motion=motion).motion
ccd.mesh_ccd(mesh, x[0], x[0], motion=searched)
height: float = contacts[0].point[2] + contacts[1:].points[0, 2] + sum(contact.toi for contact in contacts)
"""
WRONG = """
ccd.vertex_face_ccd(x, x, precision="float16")
ccd.vertex_face_ccd(x, x, presicion="float32")
ccd.edge_edge_ccd(x, x, max_work=10)
ccd.point_point_ccd(x, x, 1e-6)
ccd.mesh_ccd(mesh, x[0], x[0], pair_kinds=["vertex-face"])
ccd.mesh_ccd(mesh, x[0], x[0], pair_kinds="vertex_face")
ccd.collision_free_step(mesh, x[0], x[0], max_iterations=0.5)
ccd.line_search(mesh, x[0], x[0], t_max=0.5)
ccd.find_candidates(mesh, x[0], x[0], tolerance=0.1)
ccd.find_proximity(mesh, x[0], 0.1, minimum_distance=0.1)
ccd.RigidMotion(x, x, "screw")
ccd.CollisionPipeline(mesh, tolerence=0.1)
bad_options: ccd.MeshOptions = {"method": "bisect"}
ccd.read_frames("a.stl", "b.stl", static=3)
ccd.mesh_ccd(mesh, x[0], x[0]).first.toi
ccd.vertex_face_ccd(x, None)
ccd.CollisionPipeline(mesh).launch(x[0], x[0]).contacts.sorted_by_toi()
ccd.edge_edge_ccd(x, x).toi.numpy()
ccd.edge_edge_ccd(on_device, on_device).toi.min()
searched and searched.poses_t2
ccd.CollisionMesh.from_trimesh(3)
"""

_WRAPPED = ("fget", "__func__", "_function")  # where properties and methods of classes have their function


def _unknown(hints: dict) -> list[str]:
    return [name for name, hint in hints.items() if hint in ("Any", Any) and name[0] != "_"]


def test_no_public_argument_attribute_or_result_is_any():
    """Of overloaded functions those of the overloads count; a type checker sees no others."""
    unknown = []
    for name in ccd.__all__:
        public = getattr(ccd, name)
        classes = [of for of in getattr(public, "__mro__", ()) if of.__module__.startswith("ccd_warp")]
        members = {name: public} | {k: v for of in classes[::-1] for k, v in vars(of).items()}
        for member, value in members.items():
            function = next((f for of in _WRAPPED if (f := getattr(value, of, None))), value)
            if inspect.isfunction(function) and (member[0] != "_" or member in ("__init__", "__getitem__")):
                for each in get_overloads(function) or [function]:
                    unknown += [f"{name}.{member}: {hint}" for hint in _unknown(inspect.unwrap(each).__annotations__)]
        unknown += [f"{name}.{hint}" for of in classes for hint in _unknown(inspect.get_annotations(of))]
    assert not unknown


def test_mistakes_in_options_are_found_and_right_calls_pass(monkeypatch):
    api = pytest.importorskip("mypy.api", reason="the extra lint is not installed")
    monkeypatch.chdir(Path(__file__).resolve().parents[2])  # where mypy finds the package, however it was installed
    wp.init()  # which says where kernels are kept: what mypy knows of the packages stays there from run to run as well
    options = ["--config-file=", "--strict", "--ignore-missing-imports", "--follow-imports=silent", "--no-pretty"]
    options += [f"--cache-dir={Path(wp.config.kernel_cache_dir, 'ccd_warp_mypy')}"]
    code = (SETUP + RIGHT + WRONG).splitlines()
    output, errors, _ = api.run([*options, "-c", "\n".join(code)])
    found = dict.fromkeys(code[int(line) - 1] for line in re.findall(r"^<string>:(\d+): error:", output, re.M))
    assert not errors and list(found) == WRONG.split("\n")[1:-1], output
