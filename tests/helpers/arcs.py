"""The truth of when primitives on rigid trajectories first touch, and the check of tois against it.

It shares no code with the kernels or the engine, and its only idea is the definition of the trajectories.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import arc_contacts
import arc_paths
import arc_search
import numpy as np
from arc_pairs import ArcPairs
from arc_paths import RigidPath, StraightPath
from arc_search import BITS, first_contact
from flint import arb, ctx
from kept import kept


@dataclass(frozen=True)
class Answers:
    """When each pair first touches; t in float64, rounded down.

    Attributes:
        lo: Before this time the pair certainly does not touch; inf where it never does, shape [n].
        hi: At this time the pair has certainly touched, and a toi is late iff it is larger; inf where no contact is
            certain, shape [n].
        width: hi − lo before rounding; inf where hi is, shape [n].

    A pair with a finite lo and an infinite hi is undecided: it comes so close to a contact that the arithmetic cannot
    tell, or touches in a single time, as where the contact is at the very end of the step.
    """

    lo: np.ndarray
    hi: np.ndarray
    width: np.ndarray

    @property
    def touches(self) -> np.ndarray:
        return np.isfinite(self.hi)

    @property
    def free(self) -> np.ndarray:
        return np.isinf(self.lo)

    @property
    def undecided(self) -> np.ndarray:
        return np.isfinite(self.lo) & np.isinf(self.hi)


def paths_of(pairs: ArcPairs, k: int) -> list[RigidPath | StraightPath]:
    """The exact trajectories of a pair."""
    paths: list[RigidPath | StraightPath] = []
    for side, local in enumerate((pairs.points_a, pairs.points_b)):
        if side == 1 and pairs.points_b_t1 is not None:
            paths.append(StraightPath(local[k], pairs.points_b_t1[k]))
            continue
        end = None if pairs.poses_t1 is None else pairs.poses_t1[k, side]
        twist = None if pairs.twist is None else pairs.twist[k, side]
        paths.append(RigidPath(local[k], pairs.poses_t0[k, side], end, pairs.path, pairs.pivot[k, side], twist))
    return paths


def solve(pairs, paths_of=paths_of) -> Answers:
    """The answers of a set of pairs of a kind, with a distance, whose trajectories are those that `paths_of` gives."""
    lo, hi, width = (np.full(len(pairs), np.inf) for _ in range(3))
    for k in range(len(pairs)):
        with ctx.workprec(BITS):
            first, by, _ = first_contact(pairs.kind, paths_of(pairs, k), pairs.distance)
            if first is not None:
                lo[k] = _rounded_down(first)
            if by is not None:
                hi[k], width[k] = _rounded_down(by), float((by - first).upper())
    return Answers(lo, hi, width)


# The answers of an earlier run are looked up.
answers = kept(
    solve, arc_paths, arc_contacts, arc_search, sys.modules[__name__], question_of=lambda pairs: vars(pairs).items()
)


@dataclass(frozen=True)
class Verdict:
    """What tois are against the truth.

    Attributes:
        missed: Pairs that certainly touch, although their toi is inf.
        late: Pairs whose toi is later than a time at which they have certainly touched, without those missed.
        errors: How much too early the tois are of all pairs that certainly touch and were not missed.
        false: Pairs that certainly do not touch in the step, although their toi is finite.
    """

    missed: np.ndarray
    late: np.ndarray
    errors: np.ndarray
    false: np.ndarray


def check(tois: np.ndarray, truth: Answers) -> Verdict:
    """Compare times of impact in [0, 1], or inf, with the truth.

    Args:
        tois: float32 or float64, whose value counts as exact, shape [n].
        truth: The answers of the same pairs.
    """
    tois = np.asarray(tois, dtype=np.float64)
    if tois.shape != truth.lo.shape or np.isnan(tois).any():
        raise ValueError(f"tois has shape {tois.shape}, or holds nan; expected {truth.lo.shape}")
    found = np.isfinite(tois)
    hit = truth.touches & found
    return Verdict(
        missed=np.flatnonzero(truth.touches & ~found),
        late=np.flatnonzero(hit & (tois > truth.hi)),
        errors=np.maximum(0.0, truth.lo[hit] - tois[hit]),
        false=np.flatnonzero(truth.free & found),
    )


def _rounded_down(t: arb) -> float:
    """The largest float64 that is no larger than an exact number of [0, 1]."""
    value = float(t)
    while not arb(value) <= t:
        value = float(np.nextafter(value, -1.0))
    return value
