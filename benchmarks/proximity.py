"""The cost of what is near at one time, beside a step with the same distance and the collision set of ipc-toolkit.

python -m ccd_warp.benchmarks.proximity --faces 100000

Every scene is searched within 0.3 edge lengths. Beside `find_proximity` and `displacement_bounds` at the start of its
step stand `mesh_ccd` over the step with that `minimum_distance`, and over a step in which nothing moves, whose search
finds the same pairs. `find_intersections` stands beside `mesh_ccd` without a distance. ipc-toolkit builds its
`NormalCollisions`, on all cores, where it is installed. Times are medians of interleaved rounds, and those of all
threads together, which tell more where other programs run beside.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator

import numpy as np
import warp as wp
from ccd_warp.benchmarks import scenes
from ccd_warp.benchmarks.numbers import table, time_text

import ccd_warp as ccd

EDGE_LENGTHS = 0.3
PEER = "ipc-toolkit"


def sheets(num_faces: int) -> scenes.Scene:
    """Two sheets that lie on each other and slide, rough by some hundredths of an edge: most pairs are near."""
    n = round((num_faces / 4) ** 0.5) + 1
    vertices, faces = scenes.grid(n, n)
    edge = 2.0 / (n - 1)
    rng = np.random.default_rng(0)
    start = np.concatenate([vertices, vertices + edge * np.array([0.3, 0.2, 0.15])])
    start += 0.04 * edge * rng.standard_normal(start.shape)
    end = start + 0.04 * edge * rng.standard_normal(start.shape)
    both = np.concatenate([faces, faces + len(vertices)])
    return scenes.Scene("two sheets", start, end, both, (len(faces), len(faces)), self_collision=False)


def _calls(scene: scenes.Scene, num_threads: int) -> tuple[dict[str, Callable[[], object]], float]:
    """What is timed, by its name, and the distance."""
    mesh, x = scene.mesh(ccd), scene.vertices_t0
    edges = x[mesh.edges]
    distance = EDGE_LENGTHS * float(np.median(np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1)))
    near = ccd.CollisionPipeline(mesh, num_threads=num_threads)
    apart = ccd.CollisionPipeline(mesh, num_threads=num_threads, minimum_distance=distance)
    calls: dict[str, Callable[[], object]] = {
        "mesh_ccd": lambda: apart.mesh_ccd(x, scene.vertices_t1),
        "mesh_ccd at rest": lambda: apart.mesh_ccd(x, x),
        "find_proximity": lambda: near.find_proximity(x, distance),
        "displacement_bounds": lambda: near.displacement_bounds(x, distance),
        "mesh_ccd without a distance": lambda: near.mesh_ccd(x, scene.vertices_t1),
        "find_intersections": lambda: near.find_intersections(x),
    }
    if (peer := _peer(scene, mesh, distance)) is not None:
        calls[PEER] = peer
    return calls, distance


def _peer(scene: scenes.Scene, mesh: ccd.CollisionMesh, distance: float) -> Callable[[], object] | None:
    try:
        import ipctk
    except ImportError:
        return None
    theirs = ipctk.CollisionMesh(scene.vertices_t0, np.asarray(mesh.edges), scene.faces.astype(np.int32))

    def build() -> object:
        found = ipctk.NormalCollisions()
        found.build(theirs, scene.vertices_t0, distance, broad_phase=ipctk.LBVH())
        return found

    return build


def measure(num_faces: int, rounds: int, num_threads: int) -> Iterator[dict]:
    """One row for each scene, with interleaved rounds."""
    for make in (scenes.cloth_over_sphere, scenes.crumpled_cloth, sheets):
        scene = make(num_faces)
        calls, distance = _calls(scene, num_threads)
        found = calls["find_proximity"]()
        assert isinstance(found, ccd.Proximities)
        yield {"scene": scene.name, "distance": distance, "pairs": len(found), "seconds": _interleaved(calls, rounds)}


def _interleaved(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, tuple[float, float]]:
    """Median seconds of each call, and of all threads of the process, after one call to warm up."""
    clocks = (time.perf_counter, time.process_time)
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for k in range(rounds + 1):
        for name, call in calls.items():
            begin = [clock() for clock in clocks]
            call()
            if k:
                seconds[name].append((clocks[0]() - begin[0], clocks[1]() - begin[1]))
    return {
        name: (statistics.median(s for s, _ in v), statistics.median(c for _, c in v)) for name, v in seconds.items()
    }


def rows_table(rows: list[dict]) -> list[str]:
    """The table of the log."""
    names = list(rows[0]["seconds"])
    cells = (
        [row["scene"], f"{row['pairs']:,}", *(" / ".join(map(time_text, row["seconds"][name])) for name in names)]
        for row in rows
    )
    return table(["scene", "near pairs", *(name if name == PEER else f"`{name}`" for name in names)], cells)


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description="What a search at one time costs")
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    print("\n".join(rows_table(list(measure(options.faces, options.rounds, options.threads)))))


if __name__ == "__main__":
    main()
