"""A ground as a half-space, as a mesh of one giant face, and none at all: what a step of a cloth above it takes.

python -m ccd_warp.benchmarks.ground
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks import scenes
from ccd_warp.benchmarks.numbers import table, time_text

import ccd_warp as ccd

NUM_FACES = 100_000
ROUNDS = 15
CALLS = ("mesh_ccd", "collision_free_step", "launch")


def grounds(num_faces: int) -> dict[str, tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]]:
    """The cloth with each ground, which it meets or stays above: mesh, start and end positions."""
    scene = scenes.ground_under_cloth(num_faces)
    start, end = scene.vertices_t0, scene.vertices_t1
    cloth, num_vertices = scene.faces[: scene.body_faces[0]], len(start) - 3
    sheet = (start[:num_vertices], cloth)
    made = {"none": ccd.CollisionMesh.from_arrays([sheet])}
    positions = {"none": (start[:num_vertices], end[:num_vertices])}
    for name, below in (("", 0.0), (", below", 0.05)):
        down = np.array([0.0, 0.0, below])
        half_space = ccd.HalfSpace(-down, [0, 0, 1])
        made[f"half-space{name}"] = ccd.CollisionMesh.from_arrays([sheet, half_space])
        positions[f"half-space{name}"] = positions["none"]
        face = (start[num_vertices:] - down, scene.faces[scene.body_faces[0] :] - num_vertices)
        made[f"giant face{name}"] = ccd.CollisionMesh.from_arrays([sheet, face], static=[1])
        positions[f"giant face{name}"] = tuple(np.concatenate([x, face[0]]) for x in positions["none"])
    return {name: (mesh, *positions[name]) for name, mesh in made.items()}


def measure(num_faces: int, rounds: int = ROUNDS) -> list[dict]:
    """A row for each ground: its toi, and the least CPU time of each call on one thread in interleaved rounds."""
    calls: dict[tuple[str, str], Callable[[], Any]] = {}
    rows = []
    for name, (mesh, start, end) in grounds(num_faces).items():
        pipeline = ccd.CollisionPipeline(mesh, num_threads=1, device="cpu")
        arrays = [wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end)]
        calls[name, "mesh_ccd"] = lambda p=pipeline, a=start, b=end: p.mesh_ccd(a, b)
        calls[name, "collision_free_step"] = lambda p=pipeline, a=start, b=end: p.collision_free_step(a, b)
        calls[name, "launch"] = lambda p=pipeline, x=arrays: p.launch(*x)
        result = pipeline.mesh_ccd(start, end)
        rows.append({"ground": name, "toi": result.toi, "contacts": len(result.contacts)})
    seconds = dict.fromkeys(calls, float("inf"))
    for k in range(rounds + 1):  # the first warms up
        for case, call in calls.items():
            begin = time.process_time()
            call()
            seconds[case] = min(seconds[case], time.process_time() - begin) if k else float("inf")
    return [row | {call: seconds[row["ground"], call] for call in CALLS} for row in rows]


def rows_table(rows: list[dict]) -> list[str]:
    """The rows as a table."""
    cells = (
        [row["ground"], f"{row['toi']:.6g}", f"{row['contacts']:,}", *(time_text(row[call]) for call in CALLS)]
        for row in rows
    )
    return table(["ground", "toi", "contacts", *(f"`{call}`" for call in CALLS)], cells)


def main() -> None:
    """Measure, and print the table."""
    options = argparse.ArgumentParser(description="What a step of a cloth takes, by the ground below it.")
    options.add_argument("--faces", type=int, default=NUM_FACES, help="faces of the cloth")
    print("\n".join(rows_table(measure(options.parse_args().faces))))


if __name__ == "__main__":
    main()
