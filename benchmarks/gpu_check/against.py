"""Stage: steps beside what else there is for them: the same launches and calls on the CPU, and newton's detection.

newton has no time of impact. Its detector of self-contacts finds at one time which vertices and triangles, and which
edges, are within a distance; `launch_proximity` is what answers that here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target, middle
from ccd_warp.benchmarks.scenes import Scene, cloth_over_sphere, long_step, pile

import ccd_warp as ccd

_REPEATS = 5
_NEAR = 0.8  # of the mean length of an edge: what lies around a vertex or an edge, and is not connected to it
_MOST_NEAR = 64  # partners of a vertex or an edge that newton keeps


def cases(target: Target, **_: Any) -> Cases:
    """The scenes, the smallest first."""
    sizes = (400,) if target.is_short else (10_000, 50_000, 200_000)
    made = [(f"cloth {n:,}", lambda n=n: cloth_over_sphere(n)) for n in sizes]
    if not target.is_short:
        made += [("pile 50,000", lambda: pile(500, 100)), ("long step 20,000", lambda: long_step(20_000))]
    found: Cases = {}
    for name, make in made:
        found[f"{name}, the CPU"] = partial(beside_cpu, target, name, make)
        if name.startswith("cloth"):
            found[f"{name}, newton"] = partial(beside_newton, target, name, make)
    return found


def beside_cpu(target: Target, name: str, make: Callable[[], Scene], record: Record) -> None:
    """The calls of the host and a launch, on the device and on the CPU."""
    scene, repeats = make(), 1 if target.is_short else _REPEATS
    frames = (scene.vertices_t0, scene.vertices_t1)
    seconds: dict[str, dict[str, float]] = {}
    for device in (target.device, "cpu"):
        pipeline = ccd.CollisionPipeline(scene.mesh(ccd), device=device)
        pipeline.reserve(vertices=frames[0])
        arrays = [wp.array(x, dtype=wp.vec3d, device=device) for x in frames]
        calls: dict[str, Callable[[], Any]] = {
            "launch": partial(pipeline.launch, *arrays),
            "mesh_ccd": partial(pipeline.mesh_ccd, *frames),
            "collision_free_step": partial(pipeline.collision_free_step, *frames),
        }
        where = "device" if device == target.device and "device" not in seconds else "cpu"
        seconds[where] = {n: middle(target.seconds_on_host(call, repeats))["median"] for n, call in calls.items()}
    ratios = {call: seconds["cpu"][call] / seconds["device"][call] for call in seconds["cpu"]}
    said = ", ".join(
        f"{call} {seconds['device'][call] * 1e3:.2f} ms ({x:.1f} times as fast)" for call, x in ratios.items()
    )
    record.add(f"{name}, beside the CPU: {said}", scene=name, other="the CPU", seconds=seconds, ratios=ratios)


def beside_newton(target: Target, name: str, make: Callable[[], Scene], record: Record) -> None:
    """What is within a distance at one time: boxes, search and distances of both, in a cloth alone."""
    newton = pytest.importorskip("newton", reason="newton is not installed")
    from newton._src.geometry.tri_mesh_collision import TriMeshCollisionDetector  # its public solvers call this

    scene, repeats = make(), 1 if target.is_short else _REPEATS
    mesh = scene.mesh(ccd)
    count = mesh.body_vertex_range[1]
    faces = mesh.faces[(mesh.faces < count).all(axis=1)]
    x = scene.vertices_t0[:count]
    distance = _NEAR * float(np.linalg.norm(x[faces[:, 1]] - x[faces[:, 0]], axis=1).mean())
    builder = newton.ModelBuilder()
    builder.add_cloth_mesh(
        pos=wp.vec3(), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(), density=1.0,
        vertices=[wp.vec3(*v) for v in x], indices=faces.ravel().tolist(),
    )  # fmt: skip
    detector = TriMeshCollisionDetector(
        builder.finalize(device=target.device),
        vertex_collision_buffer_pre_alloc=_MOST_NEAR,
        edge_collision_buffer_pre_alloc=_MOST_NEAR,
        init_collision_info=True,
    )

    def theirs() -> None:
        detector.refit()
        detector.vertex_triangle_collision_detection(distance)
        detector.edge_edge_collision_detection(distance)

    alone = ccd.CollisionMesh.from_arrays([(x, faces)])
    pipeline = ccd.CollisionPipeline(alone, device=target.device)
    start = target.array(x, wp.vec3d)
    pipeline.reserve(vertices=x, max_pairs=1 << 20 if target.is_short else 1 << 24)
    pipeline.reserve(max_contacts=2 * int(pipeline.launch_proximity(start, distance).count.numpy()[0]) + 1)
    ours = middle(target.seconds_on_device(lambda: pipeline.launch_proximity(start, distance), repeats))["median"]
    other = middle(target.seconds_on_device(theirs, repeats))["median"]
    result = pipeline.launch_proximity(start, distance)
    near, flags = int(result.count.numpy()[0]), int(result.flags.numpy()[0])
    found = int(detector.vertex_colliding_triangles_count.numpy().sum())
    found += int(detector.edge_colliding_edges_count.numpy().sum()) // 2  # each edge lists the other
    record.add(
        f"{name}, beside newton: launch_proximity {ours * 1e3:.3f} ms, {near:,} pairs in float64; "
        f"newton's detector {other * 1e3:.3f} ms, {found:,} in float32",
        scene=name,
        other="newton",
        seconds={"device": {"launch_proximity": ours}, "newton": {"detection": other}},
        ratios={"launch_proximity": other / ours},
        pairs={"ours": near, "newton": found},
        flags=flags,
    )
