"""Pairs that no family foresees: hard and published ones, and mutations of them, against exact arithmetic."""

import numpy as np
import published
import pytest
from daily import marked
from distance_queries import KINDS, failures, size_of
from hard_cases import FAMILIES, POINTS

import ccd_warp as ccd


def as_drawn(points, other, rng):
    return points


def with_ulp_noise(points, other, rng):
    """Some coordinates moved by up to three ulp, which leaves queries near their degeneracy but not on it."""
    return points + rng.integers(-3, 4, points.shape) * (rng.random(points.shape) < 0.2) * np.spacing(points)


def crossed(points, other, rng):
    """Queries with single points or single axes of other queries, the same at both ends of the step."""
    n, _, count, dimension = points.shape
    of_point, of_axis = rng.random((n, 1, count, 1)) < 0.25, rng.random((n, 1, 1, dimension)) < 0.25
    return np.where(np.where(rng.random((n, 1, 1, 1)) < 0.5, of_point, of_axis), other, points)


def with_scaled_axes(points, other, rng):
    """Each axis times a power of two of its own: exact, so the truth stays, but the axes cannot share a bound."""
    reach = rng.choice([8, 40, 150])
    return np.ldexp(points, rng.integers(-reach, reach + 1, (len(points), 1, 1, points.shape[3])))


def snapped(points, other, rng):
    """Coordinates on a coarse lattice of the query's own size: repeated points, common planes, exact contacts."""
    size = np.abs(points).max(axis=(1, 2, 3), keepdims=True)
    step = np.ldexp(1.0, np.frexp(size)[1] - rng.integers(2, 7, size.shape))
    return np.round(points / step) * step


def drawn(kind, dimension, n, rng):
    """Pairs of a family, or the first points of published ones, both ends together."""
    if rng.random() < 0.6 or not published.handcrafted_scenes():
        return np.stack(FAMILIES[rng.choice(list(FAMILIES))](kind, n, rng, dimension=dimension), axis=1)
    of = kind if POINTS[kind] == 4 else str(rng.choice(["vertex-face", "edge-edge"]))
    queries = published.handcrafted_queries(rng.choice(published.handcrafted_scenes()), of)
    chosen = rng.integers(0, len(queries), n)
    return np.stack([x[chosen][:, : POINTS[kind], :dimension] for x in (queries.points_t0, queries.points_t1)], axis=1)


@pytest.mark.parametrize("seed", marked(range(40), range(3)))
@pytest.mark.parametrize(
    "mutate", [as_drawn, with_ulp_noise, crossed, with_scaled_axes, snapped], ids=lambda f: f.__name__
)
def test_mutated_pairs_are_never_missed_late_or_far_apart(mutate, seed, precision):
    rng = np.random.default_rng(seed)
    for kind, dimension in KINDS:
        points = mutate(*(drawn(kind, dimension, 40, rng) for _ in range(2)), rng)
        points = [np.ascontiguousarray(x) for x in points.transpose(1, 0, 2, 3)]
        options = {"tolerance": 10.0 ** rng.uniform(-9, -2), "minimum_separation": rng.choice([0.0, 1e-3])}
        options["t_max"] = rng.choice([1.0, 0.5])
        scale = float(np.median(size_of(*points))) or 1.0
        own = np.random.default_rng([seed, POINTS[kind], dimension, len(mutate.__name__)])
        if is_distance := own.random() < 0.4:  # of any size, in place of a separation
            del options["minimum_separation"]
            share = own.uniform(-6, 0) if own.random() < 0.8 else own.uniform(-16, 1)
            options["minimum_distance"] = scale * 10.0**share
        if own.random() < 0.2:
            options |= {"method": "bisection", "max_iterations": 3000}
        options |= {"precision": precision, "length_scale": scale}
        found, result, _ = failures(kind, *points, checks_gap=is_distance, **options)
        assert not found and ((result.status == ccd.CCDStatus.NO_COLLISION) == np.isinf(result.toi)).all()
        assert not (result.toi < 0.0).any()
