"""The sets of queries of the sweep: published ones from a folder, and generated ones that need no download."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from accuracy import ExactTimes
from checkout import ROOT
from distance_queries import size_of as size_of_motion
from hard_cases import FAMILIES
from methods import KINDS
from public_data import find_queries

GENERATED = ("random_colliding", "cloth_like")


@dataclass(frozen=True)
class QuerySet:
    """Queries of one source and kind in a fixed random order, with the exact answers.

    Attributes:
        name: Source.
        kind: "vertex-face" or "edge-edge".
        points_t0: Start positions, float64, shape [n, 4, 3].
        points_t1: End positions.
        exact: Exact times of impact.
        separation: Minimum separation, in length scales.
        length_scale: Unit of tolerance and separation; None stands for the size of each query's own motion.
        total: Number of queries of the source, of which these are a sample.
        truth_disagreements: Queries whose published truth differs from exact arithmetic; None without truth.
    """

    name: str
    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    exact: ExactTimes
    separation: float = 0.0
    length_scale: float | None = 1.0
    total: int = 0
    truth_disagreements: int | None = None

    def __len__(self) -> int:
        return len(self.points_t0)

    def unit(self) -> np.ndarray:
        """Length scale of each query, shape [n], by which tolerances are multiplied for methods that take lengths."""
        if self.length_scale is not None:
            return np.full(len(self), self.length_scale)
        return size_of_motion(self.points_t0, self.points_t1)

    def describe(self) -> dict:
        """The description of the set for the raw file."""
        return {
            "set": self.name,
            "kind": self.kind,
            "queries": len(self),
            "of": self.total,
            "contacts": int(self.exact.hit.sum()),
            "length_scale": self.length_scale,
            "truth_disagreements": self.truth_disagreements,
        }


def make_set(
    name: str,
    kind: str,
    points_t0: np.ndarray,
    points_t1: np.ndarray,
    *,
    most: int,
    truth: np.ndarray | None = None,
    separation: float = 0.0,
    length_scale: float | None = 1.0,
) -> QuerySet:
    """A set of at most ``most`` queries, drawn with a fixed seed, in random order."""
    chosen = np.random.default_rng(0).permutation(len(points_t0))[:most]
    p0, p1 = (np.ascontiguousarray(points[chosen]) for points in (points_t0, points_t1))
    exact = ExactTimes.of(kind, p0, p1, separation * (length_scale or 1.0))
    disagreements = None if truth is None else int((truth[chosen] != exact.hit).sum())
    return QuerySet(name, kind, p0, p1, exact, separation, length_scale, len(points_t0), disagreements)


def published_sets(folder: Path, most: int) -> list[QuerySet]:
    """Sets of a folder in the public formats; the scenes of each part, such as ``handcrafted``, form one set."""
    parts: dict[tuple[str, str], list] = {}
    for queries in find_queries(folder):
        parts.setdefault((queries.name.split("/")[0], queries.kind), []).append(queries)
    sets = []
    for (name, kind), queries in parts.items():
        truths = [q.truth for q in queries]
        sets.append(
            make_set(
                name,
                kind,
                np.concatenate([q.points_t0 for q in queries]),
                np.concatenate([q.points_t1 for q in queries]),
                most=most,
                truth=None if any(t is None for t in truths) else np.concatenate(truths),
            )
        )
    return sets


def generated_sets(count: int, hard_each: int, names: tuple[str, ...] = GENERATED) -> list[QuerySet]:
    """Sets of families of unit size, and one of all hard cases, whose unit is each query's own size."""
    sets = []
    for name in names:
        for kind in KINDS:
            points = FAMILIES[name](kind, count, np.random.default_rng(6))
            sets.append(make_set(name, kind, *points, most=count))
    for kind in KINDS:
        every = [family(kind, hard_each, np.random.default_rng(7)) for family in FAMILIES.values()]
        p0, p1 = (np.concatenate(frames) for frames in zip(*every, strict=True))
        sets.append(make_set("hard cases", kind, p0, p1, most=len(p0), length_scale=None))
    return sets


def default_data() -> Path | None:
    """Folder of the published data, if any: that of CCD_WARP_DATA, or ``../shared/data`` beside a checkout."""
    named = os.environ.get("CCD_WARP_DATA")
    if named:
        return Path(named)
    beside = ROOT.parent / "shared" / "data"
    return beside if beside.is_dir() else None
