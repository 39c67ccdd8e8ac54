"""What is near and how far vertices may go, beside ipctk: python benchmarks/near.py [--across 128 32 --rounds 7].

Two wavy layers of so many vertices across. For `find_proximity` the upper one lies 0.72 grid spacings above the lower,
and pairs within 0.9 are asked for; the collision set of ipctk is that of the same distance. In a line search the upper
layer is pressed by 1.5 spacings through the lower one, which is 0.5 below it, and all vertices are moved at random
besides. Milliseconds by the clock, the least of interleaved rounds.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import ipctk
import numpy as np
from fine_meshes import grid

import ccd_warp as ccd

REACH = 0.9  # grid spacings, as all lengths here


def layers(across: int, gap: float) -> ccd.CollisionMesh:
    """Two layers above each other."""
    lower, faces = grid(across, across, 1.0, 1.0)
    lower[:, 2] = 0.02 * np.sin(9 * lower[:, 0]) * np.cos(8 * lower[:, 1])
    return ccd.CollisionMesh.from_arrays([(lower, faces), (lower + [0, 0, gap / (across - 1)], faces)])


def calls(across: int) -> dict[str, Callable[[], Any]]:
    """The calls by name."""
    near, pressed, spacing = layers(across, 0.8 * REACH), layers(across, 0.5), 1 / (across - 1)
    x, start = near.vertices, pressed.vertices
    end = start + 0.2 * spacing * np.random.default_rng(0).standard_normal(start.shape)
    end[len(end) // 2 :, 2] -= 1.5 * spacing
    pipelines = [ccd.CollisionPipeline(mesh) for mesh in (near, pressed)]
    of_peer = ipctk.CollisionMesh(x, near.edges, near.faces)

    def read(found: ccd.Proximities) -> None:
        for name in ("kind", "primitives", "parameters", "distance", "direction", "features"):
            getattr(found, name)

    def build() -> None:
        ipctk.NormalCollisions().build(of_peer, x, REACH * spacing, broad_phase=ipctk.LBVH())

    reach = REACH * spacing
    return {
        "find_proximity": lambda: pipelines[0].find_proximity(x, reach),
        "its columns read": lambda: read(pipelines[0].find_proximity(x, reach)),
        "unique=True, read": lambda: read(pipelines[0].find_proximity(x, reach, unique=True)),
        "displacement_bounds": lambda: pipelines[0].displacement_bounds(x, reach),
        "NormalCollisions.build": build,
        "mesh_ccd": lambda: pipelines[1].mesh_ccd(start, end),
        "line_search per vertex": lambda: pipelines[1].line_search(start, end, per="vertex"),
    }


def main() -> None:
    """Print a table with a row for each number of vertices."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--across", type=int, nargs="+", default=[128, 32])
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    for k, across in enumerate(given.across):
        of_name = calls(across)
        least = dict.fromkeys(of_name, np.inf)
        for call in of_name.values():
            call()
        for _ in range(given.rounds):
            for name, call in of_name.items():
                begin = time.perf_counter()
                call()
                least[name] = min(least[name], time.perf_counter() - begin)
        if k == 0:
            print("| faces |", " | ".join(least), "|\n|", "---|" * (len(least) + 1), sep="")
        cells = (f"{1e3 * seconds:.3g}" for seconds in least.values())
        print(f"| {4 * (across - 1) ** 2:,} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()
