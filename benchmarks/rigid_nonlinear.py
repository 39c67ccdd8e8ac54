"""ipc-toolkit's `NonlinearCCD` on single pairs of `rigid_turns`, whose trajectories it is given as Python callbacks.

The pairs are the first of the set. The toolkit's answer is early by its tolerance and a share of the gap at the start,
so an answer counts as late where its toi is above that of ours by more than rounding.
"""

from __future__ import annotations

import time
from typing import Any

import ipctk
import numpy as np
from ccd_warp.benchmarks.rigid_scenes import matrix_of, rotations
from ccd_warp.benchmarks.rigid_turns import Pairs
from ccd_warp.benchmarks.timing import interleaved, medians

PEER = "ipctk, NonlinearCCD"
# Beyond this the solver of the toolkit gives up on a pair; its default takes minutes for some.
_MOST_ITERATIONS = 100_000


class Arc(ipctk.NonlinearTrajectory):
    """A point of a body that turns about a pivot, which moves straight."""

    def __init__(self, pivot: np.ndarray, velocity: np.ndarray, arm: np.ndarray, omega: np.ndarray) -> None:
        super().__init__()
        self.pivot, self.velocity, self.arm, self.omega = pivot, velocity, arm, omega
        self.bend = float(omega @ omega * np.linalg.norm(arm))

    def __call__(self, t: float) -> np.ndarray:
        """Where it is at a time."""
        return self.pivot + t * self.velocity + rotations(t * self.omega[None])[0] @ self.arm

    def max_distance_from_linear(self, t0: float, t1: float) -> float:
        """Its sagitta between two times."""
        return 0.125 * self.bend * (t1 - t0) ** 2


def trajectories(pairs: Pairs, k: int) -> list[Arc]:
    """Those of the four points of a pair."""
    found = []
    for b, body in enumerate(pairs.parts):
        turn, twist = matrix_of(pairs.poses[k, b, 3:]), pairs.twist[k, b]
        found += [Arc(pairs.poses[k, b, :3], twist[:3], turn @ point, twist[3:]) for point in body]
    return found


def measure(kind: str, turn: float, count: int, rounds: int) -> dict:
    """One record: seconds of a pair, and faults of the toolkit."""
    pairs = Pairs.random(kind, turn, 20 * count)
    solver = ipctk.NonlinearCCD(max_iterations=_MOST_ITERATIONS)
    solve = solver.point_triangle_ccd if kind == "vertex-face" else solver.edge_edge_ccd
    paths = [trajectories(pairs, k) for k in range(count)]
    theirs = np.full(count, np.inf)
    begin = time.process_time()
    for k, points in enumerate(paths):
        hit, toi = solve(*points)
        theirs[k] = toi if hit else np.inf
    seconds = (time.process_time() - begin) / count
    few = pairs.chosen(np.arange(len(pairs.poses)) < 20 * count)
    answers: dict[str, Any] = {}
    times = medians(interleaved({"ours": few.on_arcs}, rounds, clock=time.process_time, after=answers.__setitem__))
    ours = answers["ours"].world_toi[:count]
    both = (theirs < np.inf) & (ours < np.inf)
    rows = [
        {"method": "ours", "seconds": times["ours"] / len(pairs.poses), "missed": 0, "phantom": 0},
        {
            "method": PEER,
            "seconds": seconds,
            "missed": int(((ours < np.inf) & (theirs == np.inf)).sum()),
            "phantom": int(((ours == np.inf) & (theirs < np.inf)).sum()),
            "late": int((both & (theirs > ours + 1e-9)).sum() if both.any() else 0),
            "error": float(np.abs(theirs[both] - ours[both]).max()) if both.any() else None,
        },
    ]
    return {
        "what": "pairs",
        "kind": kind,
        "turn": turn,
        "pairs": count,
        "hits": int((ours < np.inf).sum()),
        "rows": rows,
    }
