"""The exact oracle of Euclidean distances against times worked out by hand and a dense search that shares nothing."""

import math

import numpy as np
import pytest
from distance_oracle import exact_distance, exact_distance_tois, is_within
from distance_queries import KINDS
from hard_cases import FAMILIES

FACE = [[0.0, 0, 0], [3, 0, 0], [0, 3, 0]]
# The first primitive comes down by four units from a height of two. Distance, and how far it is beside, squared.
BY_HAND = [
    ("vertex-face", [[1.0, 1, 2], *FACE], 0.5, 0.0),
    ("vertex-face", [[-1.0, -1, 2], *FACE], 1 / math.sqrt(2), 2.0),  # beyond the corner at the origin, and too far
    ("vertex-face", [[1.0, -1, 2], *FACE], 1.25, 1.0),  # beyond the side along x
    ("edge-edge", [[-1.0, 1, 2], [1, 1, 2], [0, 0, 0], [0, 2, 0]], 0.125, 0.0),
    ("point-segment", [[-3.0, 0, 2], [0, 0, 0], [5, 0, 0]], 3.5, 9.0),
    ("point-point", [[1.0, 1, 2], [0, 0, 0]], 1.5, 2.0),
]


@pytest.mark.parametrize(("kind", "points", "distance", "beside"), BY_HAND)
def test_time_at_which_a_pair_comes_within_a_distance_by_hand(kind, points, distance, beside):
    start = np.array([points])
    end = start.copy()
    end[:, : 2 if kind == "edge-edge" else 1, 2] -= 4
    (truth,) = exact_distance_tois(kind, start, end, distance)
    assert truth.hit == (distance**2 >= beside)
    if truth.hit:
        assert truth.approx == pytest.approx((2 - math.sqrt(distance**2 - beside)) / 4, rel=1e-15)


@pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
def test_distance_is_the_least_on_a_grid_and_is_reached_at_the_exact_time(kind, dimension):
    points = np.stack(FAMILIES["random"](kind, 60, np.random.default_rng(61), dimension=dimension), axis=1)
    w = np.linspace(0, 1, 61)
    u, v = (grid.ravel()[:, None] for grid in np.meshgrid(w, w))
    times = np.linspace(0, 1, 65)
    for pair, truth in zip(points, exact_distance_tois(kind, points[:, 0], points[:, 1], 0.4), strict=True):
        for t in (0.0, 0.3, 1.0):
            p = pair[0] + t * (pair[1] - pair[0])
            gaps = {"vertex-face": lambda p=p: p[0] - p[1] - v * (1 - u) * (p[2] - p[1]) - u * (p[3] - p[1])}
            gaps["edge-edge"] = lambda p=p: p[0] + u * (p[1] - p[0]) - p[2] - v * (p[3] - p[2])
            on_segment = p[0] - p[1] - w[:, None] * (p[-1] - p[1])
            grid = np.linalg.norm(gaps[kind]() if kind in gaps else on_segment, axis=1).min()
            exact = exact_distance(kind, *pair, t)
            assert exact <= grid * (1 + 1e-12) and grid - exact < 0.15 * np.abs(pair).max()
            assert is_within(kind, *pair, exact * (1 + 1e-12) + 1e-300, t)
            assert not is_within(kind, *pair, exact * (1 - 1e-12), t)
        assert all(exact_distance(kind, *pair, t) > 0.4 for t in times if t < truth.approx)
        if truth.hit and truth.approx > 0:
            assert exact_distance(kind, *pair, truth.approx) == pytest.approx(0.4, rel=1e-12)
