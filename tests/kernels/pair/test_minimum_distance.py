"""A minimum distance: Euclidean, in the unit of the positions, the same however the scene is turned."""

import numpy as np
import pytest
from distance_queries import KINDS, SOLVE, drawn_batches, failures, grazing
from exact import exact_distance_tois
from hard_cases import FAMILIES

import ccd_warp as ccd

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
PLAIN = ("random", "random_colliding")
HOSTILE = [name for name in FAMILIES if name not in PLAIN]


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
