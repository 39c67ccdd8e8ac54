"""Steps that stay on the device against the call on the host, and many worlds in one launch.

Rounds are interleaved; times are medians. The tois of the launch are compared with those of the call on the host.
"""

from __future__ import annotations

import time

import numpy as np
import scenes
import warp as wp
from timing import interleaved, medians

import ccd_warp as ccd

WORLDS = (1, 10, 100, 1_000, 10_000)
ROUNDS = 7


def measure(name: str, mesh: ccd.CollisionMesh, start: np.ndarray, end: np.ndarray, device: str) -> dict:
    """One row."""
    begin = time.perf_counter()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
    pipeline.reserve(vertices=start)
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3f, device=device) for x in (start, end))
    wished = wp.clone(vertices_t1)
    result = pipeline.launch(vertices_t0, vertices_t1)
    needed, contacts = int(result.num_pairs.numpy().max()), int(result.contacts.count.numpy()[0])
    if result.flags.numpy()[0]:
        pipeline.reserve(max_pairs=max(needed, 1), max_contacts=max(contacts, 1))
        result = pipeline.launch(vertices_t0, vertices_t1)
    first = time.perf_counter() - begin
    with wp.ScopedCapture(device=device) as capture:
        pipeline.launch(vertices_t0, vertices_t1)

    def line_search() -> None:
        wp.copy(wished, vertices_t1)
        pipeline.launch_line_search(vertices_t0, wished, per="vertex")

    rounded = [x.numpy().astype(np.float64) for x in (vertices_t0, vertices_t1)]
    on_host = pipeline.mesh_ccd(*rounded)
    pipeline.launch(vertices_t0, vertices_t1)
    row = {
        "scene": name,
        "device": device,
        "vertices": mesh.num_vertices,
        "worlds": mesh.num_worlds,
        "pairs": needed,
        "contacts": contacts,
        "different_toi": int((result.vertex_toi.numpy() != on_host.vertex_toi).sum()),
        "later_toi": int((result.vertex_toi.numpy() > on_host.vertex_toi).sum()),
        "first": first,
    }
    calls = {
        "mesh_ccd": lambda: pipeline.mesh_ccd(*rounded),
        "launch": lambda: pipeline.launch(vertices_t0, vertices_t1),
        "replay": lambda: wp.capture_launch(capture.graph),
        "line search": line_search,
    }
    row["seconds"] = medians(interleaved(calls, ROUNDS, wait=lambda: wp.synchronize_device(device)))
    return row


def worlds(count: int) -> tuple[str, ccd.CollisionMesh, np.ndarray, np.ndarray]:
    """``count`` worlds, each with a sheet of 32 faces above a ball of 80 faces, which some of the sheets hit."""
    sheet, faces = scenes.grid(5, 5, 1.0, 1.0)
    ball, ball_faces = scenes.sphere(80, 0.3)
    size = len(sheet) + len(ball)
    mesh = ccd.CollisionMesh.from_arrays(
        [(sheet, faces), (ball, ball_faces)] * count,
        static=range(1, 2 * count, 2),
        vertex_world=np.repeat(np.arange(count), size),
    )
    start = np.tile(np.concatenate([sheet + [0.01, 0.02, 0.5], ball]), (count, 1))
    end = start.copy()
    end[mesh.moving_vertices, 2] -= np.repeat(np.random.default_rng(0).uniform(0.0, 0.4, count), len(sheet))
    return f"{count:,} world{'s' * (count > 1)}", mesh, start, end


def measure_all(device: str) -> list[dict]:
    """The rows of all scenes."""
    cases = []
    for scene in (scenes.cloth_over_sphere(20_000), scenes.cloth_over_sphere(200_000), scenes.pile(1_000, 200)):
        cases.append((scene.name, scene.mesh(ccd), scene.vertices_t0, scene.vertices_t1))
    return [measure(*case, device) for case in [*cases, *map(worlds, WORLDS)]]
