"""A minimum distance: pairs that graze it, and lengths near the ends of the range."""

import numpy as np
import pytest
from distance_oracle import exact_distance
from distance_queries import KINDS, SOLVE, failures
from exact import exact_distance_tois
from hard_cases import FAMILIES

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])


def grazing(kind, n, rng, dimension, distance):
    """Random queries scaled so that the least distance of the step is the given one, up to rounding."""
    points_t0, points_t1 = FAMILIES["random"](kind, n, rng, dimension=dimension)
    for start, end in zip(points_t0, points_t1, strict=True):
        least = exact_distance(kind, start, end, 0.0)
        low, high = 0.0, 1.0
        for _ in range(8):
            times = np.linspace(low, high, 9)
            at = [exact_distance(kind, start, end, t) for t in times.tolist()]
            k = int(np.argmin(at))
            least = min(least, at[k])
            low, high = times[max(k - 1, 0)], times[min(k + 1, 8)]
        if least > 0.0:
            start *= distance / least
            end *= distance / least
    return points_t0, points_t1


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
