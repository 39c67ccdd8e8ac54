"""Rigid bodies that turn: ours and what users have today, time against what is missed, on the same steps.

Ours is one call for all steps, each a world of its own or all in one scene, and a call for each step. An answer is
missed where ours finds a contact and the other finds none; what ours says is itself held against many exact looks at
each step (`rigid_truth`). All on one thread, the processor time of each in interleaved rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
import rigid_arm, rigid_dice, rigid_nonlinear, rigid_turns
from rigid_peers import PEERS, missing, peers_of
from rigid_scenes import SCENES, RigidSteps
from rigid_truth import evidence, mesh_of, starting_apart, worlds_of
from timing import figures, interleaved

import ccd_warp as ccd

OURS, OURS_TOGETHER, OURS_EACH = "ours, a world for each step", "ours, all in one scene", "ours, a call for each step"
# A toi of another differs from that of ours by more than its tolerance and rounding.
_LATE = 1e-5


def matrices_of(steps: RigidSteps) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the body and of the obstacles at both ends of each step, shape [n, 2, 4, 4]."""
    ends = np.tile(np.eye(4), (2, len(steps), 2, 1, 1))
    ends[0, :, 0] = [steps.poses_at(k, np.zeros(1))[0] for k in range(len(steps))]
    ends[1, :, 0] = steps.ends()
    return ends[0], ends[1]


def ours(steps: RigidSteps) -> dict[str, Callable[[], np.ndarray]]:
    """The calls of ours, each of which gives the toi of every step."""
    first, last = matrices_of(steps)
    worlds = worlds_of(steps)
    count = len(steps)
    meets = np.zeros((count + 1, count + 1), dtype=bool)
    meets[-1] = meets[:, -1] = True
    scene = mesh_of(steps, count, body_pairs=meets)
    of_scene = [np.concatenate([poses[:, 0], poses[:1, 1]]) for poses in (first, last)]
    one = mesh_of(steps)

    def each(k: int) -> float:
        return ccd.rigid_ccd(one, first[k], last[k], path=steps.path, num_threads=1).toi

    return {
        OURS: lambda: ccd.rigid_ccd(worlds, first, last, path=steps.path, num_threads=1).world_toi,
        OURS_TOGETHER: lambda: ccd.rigid_ccd(scene, *of_scene, path=steps.path, num_threads=1).body_toi[:-1],
        OURS_EACH: lambda: np.array([each(k) for k in range(count)]),
    }


def judged(toi: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """Faults of an answer, and how far its tois are off where both have one."""
    hit, is_true = toi < np.inf, truth < np.inf
    both = hit & is_true
    error = np.abs(toi[both] - truth[both])
    return {
        "hits": int(hit.sum()),
        "missed": int((is_true & ~hit).sum()),
        "phantom": int((hit & ~is_true).sum()),
        "late": int((both & (toi > truth + _LATE)).sum() if both.any() else 0),
        "error": float(error.max()) if both.any() else None,
    }


def measure(make: Callable[[int], RigidSteps], count: int, samples: int, rounds: int) -> dict:
    """One record: a scene with a row for each program, and what exact samples say of ours.

    Args:
        make: Makes the steps.
        count: Their number; those that touch at their start are left out.
        samples: Times at which each step is looked at.
        rounds: Rounds of each call.
    """
    steps = starting_apart(make(count))
    calls = ours(steps) | dict(peers_of(steps))
    answers: dict[str, np.ndarray] = {}
    seconds = interleaved(calls, rounds, clock=time.process_time, after=answers.__setitem__)
    times = figures(seconds)
    truth = answers[OURS]
    rows = [
        {
            "method": name,
            "seconds": times["seconds"][name] / len(steps),
            "spread": [value / len(steps) for value in times["spread"][name]],
            **judged(answer, truth),
        }
        for name, answer in answers.items()
    ]
    return {
        "what": "steps",
        "scene": steps.name,
        "path": steps.path,
        "steps": len(steps),
        "hits": int((truth < np.inf).sum()),
        "evidence": asdict(evidence(steps, truth, samples)),
        "not_installed": missing(),
        "versions": {name: version(name) for name in PEERS if name not in missing()},
        "rows": rows,
    }


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    Attributes:
        steps: Steps of each scene.
        samples: Exact looks at each step.
        pairs: Pairs of each kind and turn whose narrow phase is timed.
        turns: Turns of these, in radians.
        counted: Pairs of each kind and turn whose steps are counted.
        nonlinear: Pairs of each kind that ipc-toolkit takes.
        dice: Number of dice.
        edges: Edges of a planner.
        rounds: Rounds of each call.
        seconds: Estimated duration of a task.
    """

    steps: int
    samples: int
    pairs: int
    turns: tuple[float, ...]
    counted: int
    nonlinear: int
    dice: int
    edges: int
    rounds: int
    seconds: float


QUICK = Sizes(100, 101, 4_000, (1e-3, 0.5, np.pi), 500, 40, 100, 30, 2, 10.0)
FULL = Sizes(1_000, 1_001, 20_000, rigid_turns.TURNS, 5_000, 200, 1_000, 500, 3, 100.0)


def calls(sizes: Sizes) -> dict[str, Callable[[], dict]]:
    """What is measured, each by its name: the scenes, the price of a pair, pairs beside a peer, dice, a planner."""
    made: dict[str, Callable[[], dict]] = {
        make.__name__: partial(measure, make, sizes.steps, sizes.samples, sizes.rounds) for make in SCENES
    }
    for kind in rigid_turns.KINDS:
        made[f"turns of {kind}"] = partial(_turns, kind, sizes)
        made[f"pairs of {kind}"] = partial(rigid_nonlinear.measure, kind, 0.5, sizes.nonlinear, sizes.rounds)
    looks = (sizes.samples + 49) // 50  # with all faces of the arm a look takes seconds
    return made | {
        "dice": partial(rigid_dice.measure, sizes.dice, sizes.rounds),
        "edges": partial(rigid_arm.measure, sizes.edges, looks),
    }


def _turns(kind: str, sizes: Sizes) -> dict:
    """The price of a pair by its turn, with the number of its steps."""
    import rigid_iterations  # whose kernel is compiled from templates that few parts need

    record = rigid_turns.measure(kind, sizes.pairs, sizes.rounds, sizes.turns)
    counted = rigid_iterations.measure(kind, sizes.counted, sizes.turns)
    rows = [
        row | {"steps": {name: steps[name] for name in ("free", "hit")}}
        for row, steps in zip(record["rows"], counted, strict=True)
    ]
    return record | {"rows": rows}
