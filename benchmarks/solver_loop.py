"""A solver's loop in small scenes: new positions in each step, and calls in turn, beside `launch`.

`python benchmarks/solver_loop.py [--rounds N] [--against PYTHON]` prints milliseconds of processor time on one thread,
and how many launches a call takes. With the interpreter of another environment, in which another version is installed,
both are measured in turn, and the ratio of this version to the other is printed as well. Of each call the tenth part of
its times that is fastest counts, and of the rounds the median.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

_SCENES = ("40 faces", "160", "196, one static", "with a ground", "640", "2,560", "16,000, one static", "pile of 125")
_CALLS = ("mesh_ccd", "collision_free_step", "launch")
_STEPS, _FASTEST = 200, 10
_MOTION = 1e-3  # of each coordinate from one step of the loop to the next, beside the motion of the step


def scene(name: str) -> tuple:
    """Mesh, start and end of a scene."""
    import trimesh

    import ccd_warp as ccd

    bodies, options, moves = [], {}, {}
    if name in ("40 faces", "160", "640", "2,560"):
        ball = trimesh.creation.icosphere({"40 faces": 0, "160": 1, "640": 2, "2,560": 3}[name], radius=0.5)
        bodies = [(ball.vertices + [x, y, 0], ball.faces) for x, y in ((-0.8, 0.1), (0.8, 0.0))]
        moves = {0: [0.6, 0, 0], 1: [-0.6, 0, 0]}
    elif name == "pile of 125":
        ball, rng = trimesh.creation.icosphere(1, radius=0.5), np.random.default_rng(0)
        places = 1.02 * np.stack(np.meshgrid(*[np.arange(5)] * 3), -1).reshape(-1, 3)
        bodies, options = [(ball.vertices, ball.faces)] * len(places), {"self_collision": False}
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
        start = (ball.vertices + places[:, None]).reshape(-1, 3)
        return mesh, start, start + np.repeat(0.05 * rng.standard_normal((125, 3)), len(ball.vertices), axis=0)
    else:
        many = name.startswith("16,000")
        side, ball = (88, 4) if many else (8, 1)
        along = np.linspace(-0.65, 0.72, side)
        x, y = np.meshgrid(along, along, indexing="ij")
        number = np.arange(side * side).reshape(side, side)
        a, b, c, d = (number[i : i + side - 1, j : j + side - 1].ravel() for i in (0, 1) for j in (0, 1))
        faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
        ball = trimesh.creation.icosphere(ball, radius=0.3)
        bodies = [(np.stack([x, y, 0 * x + 0.33], -1).reshape(-1, 3), faces), (ball.vertices, ball.faces)]
        options, moves = {"static": [1]}, {0: [0, 0, -0.1]}
        if name == "with a ground":
            bodies.append(ccd.HalfSpace([0, 0, -0.32], [0, 0, 1]))
    mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
    return mesh, mesh.vertices, mesh.vertices + np.array([moves.get(b, [0, 0, 0]) for b in mesh.vertex_body])


def seconds_of(name: str) -> dict[str, float]:
    """Processor seconds of each call in the loop of a scene."""
    import ccd_warp as ccd

    mesh, start, end = scene(name)
    host, device = (ccd.CollisionPipeline(mesh, device="cpu", num_threads=1) for _ in range(2))
    device.reserve(vertices=start)
    calls: dict[str, Callable] = {"launch": device.launch}
    calls |= {call: getattr(host, call) for call in _CALLS if call != "launch"}
    rng, static = np.random.default_rng(0), mesh.static[mesh.vertex_body]
    seconds: dict[str, list[float]] = {call: [] for call in calls}
    for _ in range(_STEPS if mesh.num_faces < 1000 else _STEPS // 8):
        moved = np.where(static[:, None], 0.0, _MOTION * rng.standard_normal(start.shape))
        ends = start + moved, end + moved
        for call, make in calls.items():
            begin = time.process_time()
            make(*ends)
            seconds[call].append(time.process_time() - begin)
    return {call: float(np.sort(values[3:])[len(values) // _FASTEST]) for call, values in seconds.items()}


def measured(python: str, name: str) -> dict[str, float]:
    """The same in a process of its own, of the version that an interpreter has."""
    run = [python, str(Path(__file__).resolve()), "--scene", name]
    return json.loads(subprocess.run(run, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def main() -> None:
    """Print a row for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--against", metavar="PYTHON", help="the interpreter of an environment with another version")
    parser.add_argument("--scene", choices=_SCENES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.scene:
        warnings.simplefilter("ignore")
        print(json.dumps(seconds_of(arguments.scene)))
        return
    pythons = [sys.executable, *([arguments.against] if arguments.against else [])]
    for name in _SCENES:
        rounds = [[measured(python, name) for python in pythons] for _ in range(arguments.rounds)]
        row = []
        for call in _CALLS:
            of_call = np.median([[each[call] for each in of_round] for of_round in rounds], axis=0)
            in_launches = np.median([of_round[0][call] / of_round[0]["launch"] for of_round in rounds])
            ratios = [of_round[0][call] / of_round[-1][call] for of_round in rounds]
            against = f", {np.median(ratios):.2f} of the other" if arguments.against else ""
            row.append(f"{call} {1e3 * of_call[0]:.3f} ms, {in_launches:.2f} launches{against}")
        print(f"{name}: " + "; ".join(row), flush=True)


if __name__ == "__main__":
    main()
