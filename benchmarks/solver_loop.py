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
import scenes

_SPHERES = ("40 faces", "160", "640", "2,560")
_SCENES = (*_SPHERES, "178, one static", "with a ground", "20,000, one static", "pile of 125")
_CALLS = ("mesh_ccd", "collision_free_step", "launch")
_STEPS, _FASTEST = 200, 10
_MOTION = 1e-3  # of each coordinate from one step of the loop to the next, beside the motion of the step


def scene(name: str) -> scenes.Scene:
    """One of the scenes."""
    if name in _SPHERES:
        return scenes.two_small_spheres(_SPHERES.index(name))
    if name.startswith("pile"):
        return scenes.pile(125, 80)
    return scenes.sheet_on_ball(88, 4) if name.startswith("20,000") else scenes.sheet_on_ball(8, 1)


def seconds_of(name: str) -> dict[str, float]:
    """Processor seconds of each call in the loop of a scene."""
    import ccd_warp as ccd

    made = scene(name)
    ground = [ccd.HalfSpace([0, 0, -0.32], [0, 0, 1])] if name == "with a ground" else []
    mesh, start, end = made.mesh(ccd, *ground), made.vertices_t0, made.vertices_t1
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
