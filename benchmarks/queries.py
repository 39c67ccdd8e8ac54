"""What the benchmarks share: the tests' oracle, families and loaders, the calls per pair kind, and the CSV writer."""

from __future__ import annotations

import sys
from pathlib import Path

# The oracle, the families and the loaders live with the tests, which are no package: nothing else imports them.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from families import FAMILIES, POINTS
from oracle import ExactToi, exact_gap, exact_tois
from published import PublishedQueries, all_queries, requires_data

import ccd_warp as ccd

__all__ = [
    "FAMILIES",
    "IN_PLANE",
    "POINTS",
    "SOLVE",
    "UNIT_ROUNDOFF",
    "ExactToi",
    "PublishedQueries",
    "all_queries",
    "exact_gap",
    "exact_tois",
    "has_published",
    "size_of",
    "write_csv",
]

SOLVE = {
    "vertex-face": ccd.vertex_face_ccd,
    "edge-edge": ccd.edge_edge_ccd,
    "point-segment": ccd.point_segment_ccd,
    "point-point": ccd.point_point_ccd,
}
UNIT_ROUNDOFF = {"float64": 2.0**-53, "float32": 2.0**-24}
# Motion in a common plane or on a common line: the coplanarity polynomial vanishes.
IN_PLANE = ("one_plane", "collinear", "parallel_edges", "sliding_in_plane_rotating")


def has_published() -> bool:
    """Whether the published sample queries are present."""
    return not requires_data.args[0]


def size_of(points_t0: np.ndarray, points_t1: np.ndarray) -> np.ndarray:
    """Longest side of the box around each query's motion: its default length scale, shape [n]."""
    both = np.concatenate([points_t0, points_t1], axis=1)
    return (both.max(axis=1) - both.min(axis=1)).max(axis=1)


def write_csv(path: Path, points_t0: np.ndarray, points_t1: np.ndarray, truth: np.ndarray) -> None:
    """Writes queries in the public format: one row a point, first all of t = 0, `xn,xd,yn,yd,zn,zd,truth`.

    A pair of four points takes 8 rows; other kinds take two a point, and the plane has z = 0.
    """
    with path.open("w") as file:
        for start, end, hit in zip(points_t0, points_t1, truth, strict=True):
            for point in (*start, *end):
                coordinates = [*point.tolist(), 0.0][:3]
                rationals = [str(i) for x in coordinates for i in x.as_integer_ratio()]
                file.write(",".join([*rationals, str(int(hit))]) + "\n")
