"""Pairs that no family foresees: mutations of hard and of published ones, against exact arithmetic."""

import numpy as np
import published
import pytest
from daily import marked
from exact import exact_tois
from hard_cases import FAMILIES, POINTS
from oracle import exact_gap
from pair_functions import SOLVE, size_of_motion

import ccd_warp as ccd

UNIT_ROUNDOFF = {"float64": 2.0**-53, "float32": 2.0**-24}
KINDS = [(kind, d) for kind, count in POINTS.items() for d in ((3,) if count == 4 else (2, 3))]


def with_ulp_noise(points: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Some coordinates moved by up to three ulp, which leaves queries near their degeneracy but not on it."""
    return points + rng.integers(-3, 4, points.shape) * (rng.random(points.shape) < 0.2) * np.spacing(points)


def crossed(points: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Queries with single points or single axes of other queries, the same at both ends of the step."""
    n, _, count, dimension = points.shape
    of_point, of_axis = rng.random((n, 1, count, 1)) < 0.25, rng.random((n, 1, 1, dimension)) < 0.25
    return np.where(np.where(rng.random((n, 1, 1, 1)) < 0.5, of_point, of_axis), other, points)


def with_scaled_axes(points: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each axis times a power of two of its own: exact, so the truth stays, but the axes cannot share a bound."""
    reach = rng.choice([8, 40, 150])
    return np.ldexp(points, rng.integers(-reach, reach + 1, (len(points), 1, 1, points.shape[3])))


def snapped(points: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Coordinates on a coarse lattice of the query's own size: repeated points, common planes, exact contacts."""
    size = np.abs(points).max(axis=(1, 2, 3), keepdims=True)
    step = np.ldexp(1.0, np.frexp(size)[1] - rng.integers(2, 7, size.shape))
    return np.round(points / step) * step


def drawn(kind: str, dimension: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """Pairs of a family, or the first points of published ones, both ends together."""
    if rng.random() < 0.6 or not published.handcrafted_scenes():
        return np.stack(FAMILIES[rng.choice(list(FAMILIES))](kind, n, rng, dimension=dimension), axis=1)
    of = kind if POINTS[kind] == 4 else str(rng.choice(["vertex-face", "edge-edge"]))
    queries = published.handcrafted_queries(rng.choice(published.handcrafted_scenes()), of)
    chosen = rng.integers(0, len(queries), n)
    return np.stack([x[chosen][:, : POINTS[kind], :dimension] for x in (queries.points_t0, queries.points_t1)], axis=1)


@pytest.mark.parametrize("seed", marked(range(40), range(3)))
@pytest.mark.parametrize("mutate", [with_ulp_noise, crossed, with_scaled_axes, snapped], ids=lambda f: f.__name__)
def test_mutated_pairs_are_never_missed_late_or_far_apart(mutate, seed, precision):
    rng = np.random.default_rng(seed)
    for kind, dimension in KINDS:
        points = mutate(*(drawn(kind, dimension, 40, rng) for _ in range(2)), rng)
        start, end = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        tolerance, separation = 10.0 ** rng.uniform(-9, -2), rng.choice([0.0, 1e-3])
        size, t_max = size_of_motion(start, end), rng.choice([1.0, 0.5])
        scale = float(np.median(size)) or 1.0
        options = {"tolerance": tolerance, "minimum_separation": separation, "length_scale": scale, "t_max": t_max}
        result = SOLVE[kind](start, end, precision=precision, **options)
        truth = exact_tois(kind, start, end, separation * scale, t_max)
        for i, (exact, toi) in enumerate(zip(truth, result.toi.tolist(), strict=True)):
            assert not (exact.hit and toi == np.inf) and not exact.late(toi), (kind, i)
            assert (result.status[i] == ccd.CCDStatus.NO_COLLISION) == (toi == np.inf) and not toi < 0.0, (kind, i)
            if toi < np.inf and result.status[i] == ccd.CCDStatus.COLLISION:
                # the kernel accepts at ten rounding bounds of at most 8.25 u each, so 100 u of the size cover them
                bound = (separation + tolerance) * scale
                bound += 100 * UNIT_ROUNDOFF[precision] * (size[i] + separation * scale)
                assert exact_gap(kind, start[i], end[i], toi) <= bound, (kind, i)
