"""Steps of few primitives in a tight loop, where the fixed cost of a call is most of it: ours beside ipc-toolkit.

    python -m ccd_warp.benchmarks.small_steps [--rounds 25]

Scenes: two spheres of 40 to 2,560 faces that fly into each other; and a plate with a hole in the plane, 1,680 nodes and
224 edges, that is pressed until the hole closes, as in fedoo's example of self-contact. ipc-toolkit gets the vertices
and edges of the surface, as fedoo hands them over, searches with `LBVH` and solves with `AdditiveCCD`. A round calls
each in turn, as often in a row as fits some milliseconds; the table has the medians over the rounds, and in brackets
the median of the ratio to ipc-toolkit's call in the same round.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from typing import Any

import ipctk
import numpy as np
import warp as wp
from ccd_warp.benchmarks.numbers import table, time_text
from ccd_warp.benchmarks.scenes import two_small_spheres
from ccd_warp.benchmarks.small_scenes import timed_in_turn

import ccd_warp as ccd

PEER = "LBVH, additive"


def plate_with_a_hole(
    num_radial: int = 15, num_quarter: int = 28, side: float = 100.0, radius: float = 45.0
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of rings between a circle and the square around it, and the edges of the innermost and the outermost."""
    k = side * (np.arange(num_quarter) / num_quarter - 0.5)
    end = np.full(num_quarter, side / 2)
    square = np.concatenate([np.stack(xy, axis=1) for xy in ((k, -end), (end, k), (-k, end), (-end, -k))])
    circle = radius * square / np.linalg.norm(square, axis=1, keepdims=True)
    share = np.linspace(0.0, 1.0, num_radial)[:, None, None]
    ring = np.arange(len(square))
    inner = np.stack([ring, np.roll(ring, -1)], axis=1)
    nodes = ((1.0 - share) * circle + share * square).reshape(-1, 2)
    return nodes, np.concatenate([inner, inner + len(nodes) - len(square)])


def pressed_plate() -> tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]:
    """The plate at two heights, at the lower of which the hole is nearly closed: mesh, start and end."""
    nodes, edges = plate_with_a_hole()
    mesh = ccd.CollisionMesh.from_arrays([(nodes, edges)])
    return mesh, nodes * [1.0, 0.34], nodes * [1.0, 0.31]


def toolkit_step(mesh: ccd.CollisionMesh, start: np.ndarray, end: np.ndarray) -> Callable[[], float]:
    """The step of ipc-toolkit on the vertices that have edges."""
    on_surface = np.unique(mesh.edges)
    number = np.full(mesh.num_vertices, -1, dtype=np.int32)
    number[on_surface] = np.arange(len(on_surface))
    edges, faces = (number[primitives].reshape(-1, n) for primitives, n in ((mesh.edges, 2), (mesh.faces, 3)))
    x0, x1 = start[on_surface], end[on_surface]
    theirs = ipctk.CollisionMesh(x0, edges, faces)

    def step() -> float:
        candidates = ipctk.Candidates()
        candidates.build(theirs, x0, x1, broad_phase=ipctk.LBVH())
        return candidates.compute_collision_free_stepsize(theirs, x0, x1, narrow_phase_ccd=ipctk.AdditiveCCD())

    return step


def calls_on(mesh: ccd.CollisionMesh, start: np.ndarray, end: np.ndarray) -> dict[str, Callable[[], Any]]:
    """The calls that are compared, by name."""
    pipeline, launched, of_arrays = (ccd.CollisionPipeline(mesh, device="cpu") for _ in range(3))
    vector = wp.vec3d if mesh.dimension == 3 else wp.vec2d
    arrays = [wp.array(x, dtype=vector, device="cpu") for x in (start, end)]
    return {
        PEER: toolkit_step(mesh, start, end),
        "collision_free_step": lambda: pipeline.collision_free_step(start, end),
        "mesh_ccd": lambda: pipeline.mesh_ccd(start, end),
        "launch, NumPy": lambda: launched.launch(start, end),
        "launch, Warp": lambda: of_arrays.launch(*arrays),
        "one-shot step": lambda: ccd.collision_free_step(mesh, start, end, device="cpu"),
    }


def measure(rounds: int) -> list[list[str]]:
    """A row for each scene: its name, the time of ipc-toolkit, and for each of ours the time and the ratio."""
    scenes = {}
    for k in range(4):
        scene = two_small_spheres(k)
        scenes[scene.name] = scene.mesh(ccd), scene.vertices_t0, scene.vertices_t1
    scenes["plate in the plane, 1,680 nodes"] = pressed_plate()
    rows = []
    for name, scene in scenes.items():
        seconds = timed_in_turn(calls_on(*scene), rounds)
        theirs = seconds.pop(PEER)
        cells = [
            f"{time_text(statistics.median(ours))} "
            f"({statistics.median(a / b for a, b in zip(ours, theirs, strict=True)):.2f})"
            for ours in seconds.values()
        ]
        rows.append([name, time_text(statistics.median(theirs)), *cells])
    return rows


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=25, help="rounds of each scene")
    rounds = parser.parse_args().rounds
    wp.config.log_level = wp.LOG_ERROR
    ipctk.set_logger_level(ipctk.LoggerLevel.off)
    names = ["collision_free_step", "mesh_ccd", "launch, NumPy", "launch, Warp", "one-shot step"]
    print("\n".join(table(["scene, faces", PEER, *names], measure(rounds))))


if __name__ == "__main__":
    main()
