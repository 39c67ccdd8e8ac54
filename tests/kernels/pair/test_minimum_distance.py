"""A minimum distance: Euclidean, in the unit of the positions, the same however the scene is turned."""

import math

import numpy as np
import pytest
from distance_oracle import exact_distance
from distance_queries import KINDS, SOLVE, drawn_batches, failures, grazing, named_vector
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


@every_kind
def test_distance_lies_between_the_boxes_around_and_inside_the_ball(kind, dimension):
    points = FAMILIES["random"](kind, 400, np.random.default_rng(65), dimension=dimension)
    options = {"length_scale": 1.0, "tolerance": 1e-12}
    ball = SOLVE[kind](*points, minimum_distance=0.3, **options).toi
    around = SOLVE[kind](*points, minimum_separation=0.3, **options).toi
    inside = SOLVE[kind](*points, minimum_separation=0.3 / math.sqrt(dimension), **options).toi
    assert (around <= ball).all() and (ball <= inside).all()
    assert (around < ball).any() and (ball < inside).any()


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
def test_turning_a_scene_changes_toi_by_the_rounding_of_the_turned_positions_alone(kind):
    rng = np.random.default_rng(66)
    points = FAMILIES["random_colliding"](kind, 60, rng)
    was, before = (f(*a, 0.02) for f, a in ((_tois, (kind, *points)), (exact_distance_tois, (kind, *points))))
    for _ in range(3):
        rotation = random_rotation(rng)
        frames = [x @ rotation for x in points]
        now, exact = _tois(kind, *frames, 0.02), exact_distance_tois(kind, *frames, 0.02)
        for a, b, t, s in zip(before, exact, was, now, strict=True):
            if a.hit and b.hit and a.approx > 0 and b.approx > 0:
                # what the rotation did to the exact time, and what each answer is early by: no more than rounding,
                # except where the pair only grazes the distance
                early = a.early_by(t) + b.early_by(s)
                assert abs(s - t) <= abs(a.approx - b.approx) + early + 1e-15 and early < 1e-6


def _tois(kind, points_t0, points_t1, distance):
    return SOLVE[kind](points_t0, points_t1, minimum_distance=distance).toi


def test_scaling_by_a_power_of_two_with_the_distance_changes_no_bit(precision):
    points = FAMILIES["random_colliding"]("edge-edge", 100, np.random.default_rng(67))
    was = ccd.edge_edge_ccd(*points, minimum_distance=0.07, precision=precision)
    for exponent in (-300, -20, 20, 300):
        scaled, distance = [np.ldexp(x, exponent) for x in points], math.ldexp(0.07, exponent)
        now = ccd.edge_edge_ccd(*scaled, minimum_distance=distance, precision=precision)
        assert np.array_equal(now.toi, was.toi) and np.array_equal(now.parameters, was.parameters)
        assert np.array_equal(now.gap, np.ldexp(was.gap, exponent))


@every_kind
def test_start_gap_fraction_is_that_of_the_euclidean_gap(kind, dimension):
    points = FAMILIES["random_colliding"](kind, 60, np.random.default_rng(71), dimension=dimension)
    options = {"minimum_distance": 0.4, "start_gap_fraction": 0.25}
    for i, toi in enumerate(SOLVE[kind](*points, **options).toi):
        gap = exact_distance(kind, points[0][i], points[1][i], 0.0)
        if gap:
            own = min(0.4, 0.25 * gap)
            (truth,) = exact_distance_tois(kind, *(x[i : i + 1] for x in points), own * (1 - 1e-12))
            assert not truth.late(toi) or toi - truth.approx < 1e-9
            if truth.hit:
                assert 0 < toi <= truth.approx * (1 + 1e-9) and truth.approx - toi < 1e-5


def test_reported_gap_and_parameters_are_those_of_the_closest_points():
    points = FAMILIES["random_colliding"]("vertex-face", 200, np.random.default_rng(72))
    result = ccd.vertex_face_ccd(*points, minimum_distance=0.05)
    hit = result.hit & (result.toi > 0)
    apart = np.linalg.norm(named_vector("vertex-face", *points, result), axis=1)
    assert hit.sum() > 100 and np.abs(apart - 0.05)[hit].max() < 1e-9
    assert (apart <= (0.05 + result.gap) * (1 + 1e-14))[hit].all()
