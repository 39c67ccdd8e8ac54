"""Queries with a Euclidean distance, random and hostile, against the exact oracle.

A query fails if it is

- missed: the exact trajectories come within the distance, and toi is inf;
- late: toi is after the exact time;
- phantom: at a finite toi, no limit reached, the exact distance is above distance + tolerance + 100 u · size, with the
  unit roundoff u; the kernel accepts at ten rounding bounds of at most 8.25 u each on every axis
  (kernels/pair/rounding.py);
- gap: the reported bound of the gap is below the exact one.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from distance_oracle import exact_distance
from exact import exact_distance_tois
from hard_cases import FAMILIES
from pair_functions import SOLVE, size_of_motion

import ccd_warp as ccd

UNIT_ROUNDOFF = {"float64": 2.0**-53, "float32": 2.0**-24}
# Kinds, and the dimensions in which they are defined.
KINDS = (
    ("vertex-face", 3),
    ("edge-edge", 3),
    ("point-segment", 2),
    ("point-segment", 3),
    ("point-point", 2),
    ("point-point", 3),
)
PLAIN = ("random", "random_colliding")
LIMITS = (ccd.CCDStatus.ITERATION_LIMIT, ccd.CCDStatus.RESOLUTION_LIMIT)
BATCH = 50


def check(
    kind: str, points_t0: np.ndarray, points_t1: np.ndarray, distance: float, options: dict
) -> tuple[list[tuple[int, str, str]], Counter]:
    """Failures as (query, check, message), and counts, of queries with one distance."""
    result = SOLVE[kind](points_t0, points_t1, minimum_distance=distance, **options)
    t_max = options.get("t_max", 1.0)
    exact = exact_distance_tois(kind, points_t0, points_t1, distance, t_max)
    unit = UNIT_ROUNDOFF[options.get("precision", "float64")]
    size = size_of_motion(points_t0, points_t1)
    failures = []
    counts = Counter(queries=len(exact), contacts=sum(e.hit for e in exact), iterations=int(result.iterations.sum()))
    for i, (truth, toi, status) in enumerate(zip(exact, result.toi.tolist(), result.status.tolist(), strict=True)):
        counts[ccd.CCDStatus(status).name] += 1
        if truth.hit and np.isinf(toi):
            failures.append((i, "missed", f"exact {truth!r}, toi inf"))
        elif truth.late(toi):
            failures.append((i, "late", f"toi {toi!r} is late by {-truth.early_by(toi):.3e}"))
        if np.isinf(toi):
            continue
        found = exact_distance(kind, points_t0[i], points_t1[i], toi)
        rounding = 100 * unit * (size[i] + distance)
        bound = distance + options.get("tolerance", 1e-6) * options.get("length_scale", size[i]) + rounding
        if status not in LIMITS and found > bound:
            failures.append((i, "phantom", f"distance {found!r} above {bound!r} at toi {toi!r}"))
        # the reported gap is formed from a distance that the kernel has rounded up by 16 u
        if found > (distance + result.gap[i]) * (1 + 32 * unit) + 5e-324 and result.width[i] == 0.0:
            failures.append((i, "gap", f"distance {found!r} above {distance!r} + reported gap {result.gap[i]!r}"))
        counts["phantoms"] += not truth.hit
    return failures, counts


def grazing(
    kind: str, n: int, rng: np.random.Generator, dimension: int, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Random queries scaled so that the least distance of the step is the given one, up to rounding."""
    points_t0, points_t1 = FAMILIES["random"](kind, n, rng, dimension=dimension)
    for start, end in zip(points_t0, points_t1, strict=True):
        least = exact_distance(kind, start, end, 0.0)
        low, high = 0.0, 1.0
        for _ in range(8):
            times = np.linspace(low, high, 9)
            at = [exact_distance(kind, start, end, t) for t in times.tolist()]
            k = int(np.argmin(at))
            least = min(least, at[k])
            low, high = times[max(k - 1, 0)], times[min(k + 1, 8)]
        if least > 0.0:
            start *= distance / least
            end *= distance / least
    return points_t0, points_t1


def run(
    num_random: int,
    num_hostile: int,
    seed: int,
    method: str = "clipping",
    max_iterations: int = 10_000,
) -> tuple[list, Counter]:
    """Check batches of all kinds and both precisions, in turn, with random distances and tolerances.

    Every fifth hostile batch grazes its distance.
    """
    rng = np.random.default_rng(seed)
    hostile = [name for name in FAMILIES if name not in PLAIN]
    failures: list[tuple] = []
    counts: Counter = Counter()
    plan = [(PLAIN, num_random), (hostile, num_hostile)]
    for names, total in plan:
        for number in range(-(-total // BATCH)):
            kind, dimension = KINDS[number % len(KINDS)]
            name = names[(number // len(KINDS)) % len(names)]
            n = min(BATCH, total - number * BATCH)
            points_t0, points_t1 = FAMILIES[name](kind, n, rng, dimension=dimension)
            is_grazing = names is hostile and number % 5 == 4
            size = float(np.median(size_of_motion(points_t0, points_t1)))
            distance = size * float(10.0 ** rng.uniform(-6, 0) if rng.random() < 0.8 else 10.0 ** rng.uniform(-16, 1))
            options = {"precision": str(rng.choice(["float64", "float32"])), "method": method}
            options |= {"num_threads": 1, "tolerance": float(10.0 ** rng.uniform(-9, -3)), "t_max": 1.0}
            options["max_iterations"] = max_iterations
            if is_grazing:
                name = "grazing"
                points_t0, points_t1 = grazing(kind, n, rng, dimension, distance)
            if rng.random() < 0.2:
                options["t_max"] = float(rng.random())
            if not (0.0 < distance < np.inf):
                continue
            found, counted = check(kind, points_t0, points_t1, distance, options)
            counts.update(counted)
            failures += [(name, kind, dimension, distance, options, *failure) for failure in found]
    return failures, counts
