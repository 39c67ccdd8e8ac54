"""A minimum distance: Euclidean, in the unit of the positions, the same however the scene is turned."""

import math

import numpy as np
import pytest
from distance_queries import KINDS, SOLVE, drawn_batches, failures, grazing
from exact import exact_distance_tois
from hard_cases import FAMILIES

import ccd_warp as ccd

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
PLAIN = ("random", "random_colliding")
HOSTILE = [name for name in FAMILIES if name not in PLAIN]


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


# ---- The guarantee ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num_parts", "options"),
    [
        (2, {}),
        pytest.param(6, {}, marks=pytest.mark.long),
        (2, {"method": "bisection", "max_iterations": 3000}),
    ],
)
def test_no_query_is_missed_or_late_and_phantoms_are_within_tolerance(num_parts, options):
    contacts = free = 0
    for names, count, seed in ((PLAIN, 200 * num_parts, 5), (HOSTILE, 300 * num_parts, 6)):
        for name, kind, points, drawn in drawn_batches(names, count, seed, **options):
            found, result, exact = failures(kind, *points, checks_gap=True, **drawn)
            assert not found, (name, kind, drawn)
            contacts += sum(truth.hit for truth in exact)
            free += (result.status == ccd.CCDStatus.NO_COLLISION).sum()
    assert contacts > 200 * num_parts and free > 100 * num_parts


@every_kind
def test_pairs_that_graze_the_distance(kind, dimension, precision):
    points = grazing(kind, 12, np.random.default_rng(62), dimension, 0.25)
    options = {"precision": precision, "tolerance": 1e-9, "length_scale": 1.0, "minimum_distance": 0.25}
    assert not failures(kind, *points, checks_gap=True, **options)[0]


@every_kind
def test_lengths_and_distances_near_the_ends_of_the_range_are_never_late(kind, dimension, precision):
    points = FAMILIES["random_colliding"](kind, 20, np.random.default_rng(68), dimension=dimension)
    lengths = [(exponent, float(np.ldexp(0.125, exponent))) for exponent in (-1070, -1000, 1000, 1020)]
    for exponent, distance in [*lengths, *((0, x) for x in (1e-320, 1e-200, 1e200, 1.7e308))]:
        scaled = [np.ldexp(x, exponent) for x in points]
        exact = exact_distance_tois(kind, *scaled, distance)
        tois = SOLVE[kind](*scaled, minimum_distance=distance, precision=precision).toi
        assert not any(truth.late(toi) for truth, toi in zip(exact, tois.tolist(), strict=True))
        assert exponent or (tois == 0).all() == (distance > 1)


# ---- What a length is ------------------------------------------------------------------------------------------------

FACE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
# Where a pair approaches, and in which direction its closest points lie then: inside a face, at a side, at a corner.
APPROACHES = {
    "face": ("vertex-face", np.vstack([[[0.25, 0.25, 1.0]], FACE]), [0.0, 0, 1]),
    "side": ("vertex-face", np.vstack([[[0.5, -0.6, 0.8]], FACE]), [0.0, -0.6, 0.8]),
    "corner": ("vertex-face", np.vstack([[[-0.48, -0.36, 0.8]], FACE]), [-0.48, -0.36, 0.8]),
    "edges": ("edge-edge", np.array([[-1.0, 0, 1], [1, 0, 1], [0, -1, 0], [0, 1, 0]]), [0.0, 0, 1]),
    "end of a segment": ("point-segment", np.array([[-0.6, 0.8, 0], [0, 0, 0], [1, 0, 0]]), [-0.6, 0.8, 0]),
    "point": ("point-point", np.array([[0.48, 0.6, 0.64], [0, 0, 0]]), [0.48, 0.6, 0.64]),
}


@pytest.mark.parametrize("approach", APPROACHES)
def test_straight_approach_ends_at_the_distance_however_the_scene_is_turned(approach):
    kind, points, direction = APPROACHES[approach]
    rng = np.random.default_rng(64)
    end = points.copy()
    end[: 2 if kind == "edge-edge" else 1] -= direction
    for _ in range(40):
        rotation, distance = random_rotation(rng), float(rng.uniform(0.05, 0.9))
        result = SOLVE[kind]((points @ rotation)[None], (end @ rotation)[None], minimum_distance=distance)
        gap = 1.0 - result.toi[0]
        assert result.hit[0] and gap == pytest.approx(distance, rel=1e-12) and gap >= distance * (1 - 1e-15)
        if approach == "face":  # it starts within the distance of two, and may come as close as half of its gap
            frames, options = [(x @ rotation)[None] for x in (points, end)], {"minimum_distance": 2.0}
            assert ccd.vertex_face_ccd(*frames, **options).toi[0] == 0.0
            toi = ccd.vertex_face_ccd(*frames, start_gap_fraction=0.5, **options).toi[0]
            assert toi == pytest.approx(0.5, rel=1e-12) and toi <= 0.5 + 1e-15


def test_ball_meets_the_corner_of_a_box_where_its_surface_does():
    # the maximum norm has the answer 0, for a box around the centre
    start = np.array([[[1.5, 1.5, 1.5], [0.5, 0.5, 0.5]]])
    end = start - [[[1.0, 1.0, 1.0], [0, 0, 0]]]
    ball = ccd.point_point_ccd(start, end, minimum_distance=1.0)
    assert ball.toi[0] == pytest.approx(1 - 1 / math.sqrt(3), rel=1e-12)
    assert ccd.point_point_ccd(start, end, minimum_separation=1.0, length_scale=1.0).toi[0] == 0.0
