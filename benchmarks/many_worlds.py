"""Many worlds that lie in one place: processor time of a world, by the number of worlds, of calls and of launches.

The calls take NumPy arrays, the launches Warp's; each round makes every call once. Times are of the processor, of all
threads together, so that a launch that keeps fewer threads busy is not blamed for it; on a GPU they are of the wall.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scenes
import warp as wp
from timing import figures, interleaved

import ccd_warp as ccd

WORLD_CALLS = ("mesh_ccd", "launch", "collision_free_step", "launch_line_search", "mesh_ccd, hash", "launch, hash")
_CAPACITY = 160  # pairs of a kind for each world
_Frames = tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]


def balls_and_walls(count: int, share: float = 1.0) -> _Frames:
    """Worlds of a ball of 80 faces that flies at a static wall of two; this share of them meet."""
    ball, faces = scenes.sphere(80, 0.5)
    wall = np.array([[2.0, -2, -2], [2, 2, -2], [2, 2, 2], [2, -2, 2]])
    mesh = ccd.CollisionMesh.from_arrays([(ball, faces), (wall, np.array([[0, 1, 2], [0, 2, 3]]))], static=[1])
    rng = np.random.default_rng(0)
    start = np.tile(np.concatenate([ball, wall]), (count, 1, 1))
    start[:, : len(ball)] += 0.05 * rng.standard_normal((count, 1, 3))
    end = start.copy()
    end[:, : len(ball), 0] += np.where(rng.random(count) < share, 2.0, 0.2)[:, None]
    return mesh.replicate(count), start.reshape(-1, 3), end.reshape(-1, 3)


def sheets_and_balls(count: int) -> _Frames:
    """Worlds of a sheet of 32 faces above a ball of 80 faces, which some of the sheets hit."""
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
    return mesh, start, end


def unequal_worlds(count: int) -> _Frames:
    """Worlds from a tenth to ten times a size, of 20 to 320 faces before a wall of two, static in every other one."""
    rng = np.random.default_rng(0)
    wall_faces = np.array([[0, 1, 2], [0, 2, 3]])
    bodies, world, ends = [], [], []
    for w in range(count):
        size = 10.0 ** rng.uniform(-1.0, 1.0)
        ball, faces = scenes.sphere((20, 80, 320)[w % 3], 0.5 * size)
        side = size * rng.uniform(1.0, 10.0)
        wall = size * np.array([[2.0, 0, 0]]) + side * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
        bodies += [(ball, faces), (wall, wall_faces)]
        world += [w] * (len(ball) + len(wall))
        ends += [ball + [size * rng.uniform(0.2, 2.5), 0, 0], wall]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=range(1, 2 * count, 4), vertex_world=np.array(world))
    return mesh, np.concatenate([vertices for vertices, _ in bodies]), np.concatenate(ends)


SCENES: dict[str, Callable[[int], _Frames]] = {
    "ball before a wall": balls_and_walls,
    "the same, a third meet": lambda count: balls_and_walls(count, 1 / 3),
    "the same, none meets": lambda count: balls_and_walls(count, 0.0),
    "sheet over a ball": sheets_and_balls,
    "balls of many sizes": unequal_worlds,
}


def measure(name: str, count: int, device: str, rounds: int) -> dict:
    """One row: seconds of each call, and whether launches and both broad phases give the tois of the call."""
    mesh, start, end = SCENES[name](count)
    capacities = {"max_pairs": _CAPACITY * count, "max_contacts": _CAPACITY * count}
    tree, grid = (
        ccd.CollisionPipeline(mesh, device=device, broad_phase=phase, **capacities) for phase in ("tree", "hash")
    )
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device=device) for x in (start, end))
    wished = wp.clone(vertices_t1)

    def line_search() -> None:
        wp.copy(wished, vertices_t1)
        tree.launch_line_search(vertices_t0, wished, per="world")

    calls: dict[str, Callable[[], Any]] = {
        "mesh_ccd": lambda: tree.mesh_ccd(start, end),
        "launch": lambda: tree.launch(vertices_t0, vertices_t1),
        "collision_free_step": lambda: tree.collision_free_step(start, end),
        "launch_line_search": line_search,
        "mesh_ccd, hash": lambda: grid.mesh_ccd(start, end),
        "launch, hash": lambda: grid.launch(vertices_t0, vertices_t1),
    }
    expected = calls["mesh_ccd"]()
    launched = [calls[call]().to_host() for call in ("launch", "launch, hash")]
    results = [calls["mesh_ccd, hash"](), *launched]
    row = {
        "scene": name,
        "worlds": count,
        "device": device,
        "vertices": mesh.num_vertices,
        "contacts": len(expected.contacts),
        "are_equal": all(np.array_equal(r.vertex_toi, expected.vertex_toi) for r in results),
        "flags": max(int(r.flags) for r in launched),
    }
    clock = time.process_time if device == "cpu" else time.perf_counter
    seconds = interleaved(calls, rounds, clock=clock, wait=lambda: wp.synchronize_device(device))
    return row | figures(seconds)
