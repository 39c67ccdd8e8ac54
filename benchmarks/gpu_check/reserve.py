"""Stage: the time and the memory that ``reserve()`` and a first launch take, for many worlds and for large meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.steps import worlds
from ccd_warp.benchmarks.gpu_check.target import Target
from ccd_warp.benchmarks.scenes import cloth_over_sphere

import ccd_warp as ccd

Made = tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]


def cases(target: Target, **_: Any) -> Cases:
    """The meshes."""
    made: dict[str, Callable[[], Made]]
    if target.is_short:
        made = {"6 worlds": lambda: of_worlds(6), "400 faces": lambda: of_cloth(400)}
    else:
        made = {
            "10,000 worlds": lambda: of_worlds(10_000),
            "200,000 faces": lambda: of_cloth(200_000),
            "1,000,000 faces": lambda: of_cloth(1_000_000),
        }
    return {name: partial(measure, target, name, make) for name, make in made.items()}


def of_worlds(count: int) -> Made:
    """Worlds with a sheet over a ball each."""
    step = worlds(count)
    return step.mesh, step.start, step.end


def of_cloth(faces: int) -> Made:
    """One large mesh."""
    scene = cloth_over_sphere(faces)
    return scene.mesh(ccd), scene.vertices_t0, scene.vertices_t1


def measure(target: Target, name: str, make: Callable[[], Made], record: Record) -> None:
    """``reserve()`` at the positions of the mesh, then at others, and the first launch and line search."""
    mesh, start, end = make()
    before = target.free_memory()
    arrays = [target.array(x, wp.vec3d) for x in (start, end)]
    pipeline = ccd.CollisionPipeline(mesh, device=target.device)
    calls: dict[str, Callable[[], Any]] = {
        "reserve": pipeline.reserve,
        "reserve again": pipeline.reserve,
        "reserve at positions": lambda: pipeline.reserve(vertices=start),
        "first launch": lambda: pipeline.launch(*arrays),
        "launch": lambda: pipeline.launch(*arrays),
        "first line search": lambda: pipeline.launch_line_search(*arrays, per="world"),
    }
    seconds = {what: target.seconds_on_host(call, 1, warm_up=False)[0] for what, call in calls.items()}
    after = target.free_memory()
    taken = before - after if before is not None and after is not None else None
    record.add(
        f"{name}: " + ", ".join(f"{what} {value * 1e3:.1f} ms" for what, value in seconds.items()),
        mesh=name,
        vertices=mesh.num_vertices,
        bytes=taken,
        **seconds,
    )
