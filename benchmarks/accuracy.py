"""Exact times of impact as arrays, and the faults and errors of answers against them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import checkout  # noqa: F401
import numpy as np
from exact_toi import ExactToi
from oracle import exact_tois


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
