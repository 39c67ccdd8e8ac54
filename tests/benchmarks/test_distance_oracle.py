"""The exact oracle of Euclidean distances against times worked out by hand and a dense search that shares nothing."""

import math

import numpy as np
import pytest
from distance_oracle import exact_distance, exact_distance_tois, is_within
from distance_queries import KINDS
from hard_cases import FAMILIES

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])

# A vertex above a face and an edge above an edge, two units apart, so that the closest points lie inside both; the
# corner of a face; the end of a segment; a point above a point. All approach by four units within the step.
FACE = [[0.0, 0, 0], [3, 0, 0], [0, 3, 0]]
BY_HAND = [
    ("vertex-face", [[1.0, 1, 2], *FACE], 0.5),
    ("vertex-face", [[-1.0, -1, 2], *FACE], 1 / math.sqrt(2)),  # beyond the corner at the origin
    ("vertex-face", [[1.0, -1, 2], *FACE], 0.75),  # beyond the side along x
    ("edge-edge", [[-1.0, 1, 2], [1, 1, 2], [0, 0, 0], [0, 2, 0]], 0.125),
    ("point-segment", [[-3.0, 0, 2], [0, 0, 0], [5, 0, 0]], 3.5),
    ("point-point", [[1.0, 1, 2], [0, 0, 0]], 1.5),
]


@pytest.mark.parametrize(("kind", "points", "distance"), BY_HAND)
def test_time_at_which_a_pair_comes_within_a_distance_by_hand(kind, points, distance):
    start = np.array([points])
    end = start.copy()
    end[:, : 2 if kind == "edge-edge" else 1, 2] -= 4
    beside = {(-1.0, -1): 2.0, (1.0, -1): 1.0, (-3.0, 0): 9.0, (1.0, 1): 2.0 if kind == "point-point" else 0.0}
    across = beside.get(tuple(points[0][:2]), 0.0)  # squared distance across the motion
    (truth,) = exact_distance_tois(kind, start, end, distance)
    assert truth.hit == (distance**2 >= across)
    if truth.hit:
        height = math.sqrt(distance**2 - across)
        assert truth.approx == pytest.approx((2 - height) / 4, rel=1e-15)


def sampled_distance(points, t, steps=60):
    """Least distance of points of both primitives on a grid, an upper bound that no formula enters."""
    p = points[0] + t * (points[1] - points[0])
    w = np.linspace(0, 1, steps + 1)
    if len(p) == 4:
        u, v = np.meshgrid(w, w)
        u, v = u.ravel()[:, None], v.ravel()[:, None]
        in_face = p[1] + v * (1 - u) * (p[2] - p[1]) + u * (p[3] - p[1])
        of_edges = (p[0] + u * (p[1] - p[0])) - (p[2] + v * (p[3] - p[2]))
        return np.linalg.norm(p[0] - in_face, axis=1).min(), np.linalg.norm(of_edges, axis=1).min()
    segment = p[1] + w[:, None] * (p[-1] - p[1])
    return (np.linalg.norm(p[0] - segment, axis=1).min(),) * 2


@every_kind
def test_distance_is_the_least_on_a_grid_and_lies_at_the_exact_time(kind, dimension):
    rng = np.random.default_rng(61)
    points = np.stack(FAMILIES["random"](kind, 60, rng, dimension=dimension), axis=1)
    distance = 0.4
    for pair, truth in zip(points, exact_distance_tois(kind, points[:, 0], points[:, 1], distance), strict=True):
        size = np.abs(pair).max()
        for t in (0.0, 0.3, 1.0):
            exact = exact_distance(kind, *pair, t)
            grid = sampled_distance(pair, t)[kind == "edge-edge"]
            assert exact <= grid * (1 + 1e-12) and grid - exact < 0.15 * size
            assert is_within(kind, *pair, exact * (1 + 1e-12) + 1e-300, t)
            assert not is_within(kind, *pair, exact * (1 - 1e-12), t)
        at = [exact_distance(kind, *pair, t) for t in np.linspace(0, 1, 65)]
        if truth.hit:
            early = [d for d, t in zip(at, np.linspace(0, 1, 65), strict=True) if t < truth.approx]
            assert all(d > distance for d in early)
            if truth.approx > 0:
                assert exact_distance(kind, *pair, truth.approx) == pytest.approx(distance, rel=1e-12)
        else:
            assert min(at) > distance


def test_pair_whose_distance_stays_the_same_counts_from_the_start_or_never():
    start = np.array([[[0.25, 0.25, 1.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    end = start + 3.0
    below = np.nextafter(1.0, 0.0)
    assert exact_distance_tois("vertex-face", start, end, 1.0)[0].approx == 0.0
    assert not exact_distance_tois("vertex-face", start, end, below)[0].hit
    # the foot of a vertex that slides at the height of the distance enters the face at a corner's distance
    slides = start.copy()
    slides[0, 0, 0] = -1.0
    arrives = start.copy()
    arrives[0, 0, 0] = 1.0
    assert exact_distance_tois("vertex-face", slides, arrives, 1.0)[0].approx == 0.5
