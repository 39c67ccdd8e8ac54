"""Exact times of impact as arrays, and the faults and errors of answers against them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import checkout  # noqa: F401
import numpy as np
from exact_toi import ExactToi
from oracle import certainly_apart, exact_tois

import ccd_warp as ccd

_CHUNK = 200_000  # pairs at a time


@dataclass(frozen=True)
class ExactTimes:
    """Exact tois τ of n queries, in a form that allows comparing thousands of answers at once and still exactly.

    Attributes:
        below: Largest float64 that is not above τ, shape [n]; inf without a contact. An answer is late if and only if
            it is above this: the next float64 is above τ.
        remainder: τ − below, rounded once, shape [n]; 0 without a contact.
    """

    below: np.ndarray
    remainder: np.ndarray

    @classmethod
    def of(cls, kind: str, points_t0: np.ndarray, points_t1: np.ndarray, separation: float = 0.0) -> ExactTimes:
        """Solve queries by the oracle."""
        return cls.from_oracle(exact_tois(kind, points_t0, points_t1, separation))

    @classmethod
    def from_oracle(cls, exact: list[ExactToi]) -> ExactTimes:
        """Round answers of the oracle."""
        below = np.full(len(exact), np.inf)
        remainder = np.zeros(len(exact))
        for i, tau in enumerate(exact):
            if tau.hit:
                t = tau.approx
                below[i] = math.nextafter(t, -math.inf) if tau.late(t) else t
                remainder[i] = tau.early_by(below[i])
        return cls(below, remainder)

    def __len__(self) -> int:
        return len(self.below)

    def __getitem__(self, chosen) -> ExactTimes:
        return ExactTimes(self.below[chosen], self.remainder[chosen])

    @property
    def hit(self) -> np.ndarray:
        """Whether a query has a contact, bool, shape [n]."""
        return np.isfinite(self.below)

    def early_by(self, toi: np.ndarray) -> np.ndarray:
        """τ − toi of the queries where both are finite: positive is early, negative is late."""
        both = self.hit & np.isfinite(toi)
        return (self.below[both] - toi[both]) + self.remainder[both]

    def faults(self, toi: np.ndarray) -> dict[str, int]:
        """Numbers of missed, late and phantom answers.

        Missed: a contact, and toi is inf. Late: both finite, and toi is after τ by any amount. Phantom: a finite toi
        without a contact.
        """
        found = np.isfinite(toi)
        return {
            "missed": int((self.hit & ~found).sum()),
            "late": int((self.hit & found & (toi > self.below)).sum()),
            "phantom": int((~self.hit & found).sum()),
        }


def error_statistics(signed: np.ndarray) -> dict[str, float] | None:
    """Median, 99th percentile and maximum of |τ − toi|, and the least signed error (negative: late); None if empty."""
    if not len(signed):
        return None
    size = np.abs(signed)
    return {
        "median": float(np.median(size)),
        "p99": float(np.percentile(size, 99)),
        "max": float(size.max()),
        "least_signed": float(signed.min()),
    }


def judged(exact: ExactTimes, toi: np.ndarray) -> dict:
    """Queries, contacts, faults and errors of a batch of answers."""
    return {
        "queries": len(exact),
        "contacts": int(exact.hit.sum()),
        **exact.faults(toi),
        "error": error_statistics(exact.early_by(toi)),
    }


def corners_of(mesh: ccd.CollisionMesh, kind: str, pairs: np.ndarray) -> np.ndarray:
    """Vertices of pairs of primitives, [n, 4]."""
    first, second = pairs.reshape(-1, 2).T
    if kind == "edge-edge":
        return np.hstack([mesh.edges[first], mesh.edges[second]])
    return np.hstack([first[:, None], mesh.faces[second]])


def apart_along(kind: str, start: np.ndarray, end: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Whether a direction of each pair, [n, 3], has its primitives, [n, 4, 3], more than a reach apart throughout, [n].

    Each primitive's extreme vertices along it at both ends bound all others at all times.
    """
    split, apart = 2 if kind == "edge-edge" else 1, np.ones((2, len(start)), dtype=bool)
    for points in (start, end):
        along = np.einsum("nik,nk->in", points, directions)
        first, second = along[:split], along[split:]
        gaps = first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0)
        apart &= np.array(gaps) > reach * np.abs(directions).sum(axis=1)
    return apart.any(axis=0)


def first_contact(
    mesh: ccd.CollisionMesh, start: np.ndarray, end: np.ndarray, of_kinds: tuple, likely: ccd.Contact | None
) -> ExactTimes:
    """The exact toi of the first of candidates, [n, 2] vertex-face and [m, 2] edge-edge.

    The exact toi of a pair that is likely to be first bounds the answer from above, whichever it is. All pairs are
    asked for the time up to it: most are free by a direction, with rigorous bounds of its rounding and of that of
    positions at that time, and the others are solved in exact arithmetic.
    """
    kinds = ("vertex-face", "edge-edge")
    best, bound = ExactToi(None), 1.0
    if likely is not None:
        kind = kinds[int(likely.kind)]
        corners = corners_of(mesh, kind, np.array([likely.primitives]))
        (best,) = exact_tois(kind, start[corners], end[corners])
    for kind, pairs in zip(kinds, of_kinds, strict=True):
        for begin in range(0, len(pairs), _CHUNK):
            if best.hit:
                bound = min(1.0, math.nextafter(best.approx, math.inf))
            corners = corners_of(mesh, kind, pairs[begin : begin + _CHUNK])
            x, y = start[corners], end[corners]
            until = y if bound == 1.0 else x + bound * (y - x)
            # positions at the bound take three roundings, products along a direction as many: of numbers below 4 each
            reach = 2.0**-48 * float(max(np.abs(x).max(), np.abs(y).max()))
            near = np.arange(len(x))
            split = 2 if kind == "edge-edge" else 1
            between = (x + until)[:, :split].mean(axis=1) - (x + until)[:, split:].mean(axis=1)
            for directions in (*np.broadcast_to(np.eye(3)[:, None], (3, *between.shape)), between):
                near = near[~apart_along(kind, x[near], until[near], directions[near], 2 * reach)]
            near = near[~certainly_apart(kind, x[near], until[near], reach)]
            for toi in exact_tois(kind, x[near], y[near], t_max=bound):
                if toi.hit and (not best.hit or toi.lo < best.lo):
                    best = toi
    return ExactTimes.from_oracle([best])
