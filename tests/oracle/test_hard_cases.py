"""The catalogue of hard cases: what each family promises, and that ours is never late on them."""

from fractions import Fraction

import numpy as np
import pytest
from exact import exact_tois
from hard_cases import FAMILIES, POINTS
from oracle import exact_gap
from pair_functions import SOLVE

KINDS = [(kind, d) for kind, count in POINTS.items() for d in ((3,) if count == 4 else (2, 3))]
every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
four_points = pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])


@every_kind
def test_families_have_shapes_seeds_and_reasons(kind: str, dimension: int) -> None:
    for name, case in FAMILIES.items():
        assert case.name == name and case.fails and case.why == case.generate.__doc__.strip() and "\n" not in case.why
        first, again, other = (np.stack(case(kind, 6, np.random.default_rng(seed), dimension)) for seed in (0, 0, 1))
        assert first.shape == (2, 6, POINTS[kind], dimension) and np.isfinite(first).all()
        assert np.array_equal(first, again) and not np.array_equal(first, other)


@every_kind
def test_contacts_are_where_and_when_the_families_say(kind: str, dimension: int) -> None:
    def exact(family: str) -> list:
        return exact_tois(kind, *FAMILIES[family](kind, 60, np.random.default_rng(0), dimension))

    assert all(e.compare(0.0) == 0 for e in exact("touching_at_start"))
    assert sum(e.compare(1.0) == 0 for e in exact("contact_exactly_at_end")) > 20
    for family in ("contact_exactly_at_end", "double_root", "simultaneous_contacts", "needle_against_needle"):
        assert all(e.hit for e in exact(family)), family
    case = FAMILIES["separation_exactly_the_gap"]
    separation = case.minimum_separation * case.length_scale
    points = case(kind, 60, np.random.default_rng(0), dimension)
    truth = exact_tois(kind, *points, separation=separation)
    assert not any(e.hit for e in exact_tois(kind, *points, separation=np.nextafter(separation, 0.0)))
    for start, end, e in zip(*points, truth, strict=True):
        assert e.hit and (not e.rational or exact_gap(kind, start, end, e.lo) == separation)
    toi = np.array([e.approx for e in truth])
    assert (toi == 0.0).any() and (toi == 1.0).any() and ((toi > 0.0) & (toi < 1.0)).any()


def vectors_at(kind: str, points: tuple[np.ndarray, np.ndarray], t: Fraction) -> np.ndarray:
    """P, Q and R of each pair at t, exactly, shape [3, n, 3]."""
    at = [np.vectorize(Fraction, otypes=[object])(x) for x in points]
    x = (1 - t) * at[0] + t * at[1]
    pairs = ((0, 1), (1, 2), (1, 3)) if kind == "vertex-face" else ((0, 2), (1, 0), (2, 3))
    return np.stack([x[:, i] - x[:, j] for i, j in pairs])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[:, i - 2] * b[:, i - 1] - a[:, i - 1] * b[:, i - 2] for i in range(3)], axis=1)


@four_points
def test_shapes_are_as_degenerate_as_the_families_say(kind: str) -> None:
    points = {name: case(kind, 40, np.random.default_rng(0), 3) for name, case in FAMILIES.items()}
    along = np.zeros(40, dtype=bool)  # contact all along a line
    for k in range(1, 8):
        p, q, r = vectors_at(kind, points["simultaneous_contacts"], Fraction(k, 8))
        along |= np.all([cross(*of) == 0 for of in ((q, r), (p, q), (p, r))], axis=(0, 2))
    assert along.all()
    for t in range(4):  # a cubic with four roots is zero
        p, q, r = vectors_at(kind, points["infinite_roots"], Fraction(t))
        assert ((p * cross(q, r)).sum(axis=1) == 0).all()
    assert (np.ptp(points["infinite_roots"][0], axis=1) > 0).all(axis=1).mean() > 0.8
    for k in (0, 1):
        _, q, r = vectors_at(kind, points["needle_against_needle"], Fraction(k)).astype(float)
        size = np.maximum((q * q).sum(axis=1), (r * r).sum(axis=1))
        assert np.median(np.linalg.norm(np.cross(q, r), axis=1) / size) < 1e-5
    for family, least in (("huge_motion", 1e5), ("fast_and_thin", 50.0)):
        start, end = points[family]
        size = np.ptp(start[:, 1:] if kind == "vertex-face" else start[:, 2:], axis=1).max(axis=1)
        assert np.median(np.abs(end - start).max(axis=(1, 2)) / size) > least
    assert np.abs(np.subtract(*points["tiny_motion"])).max() < 1e-8


@every_kind
def test_ours_is_never_late_at_the_separation_of_the_family(kind: str, dimension: int, precision: str) -> None:
    for case in FAMILIES.values():
        points = case(kind, 50, np.random.default_rng(2), dimension)
        separation = case.minimum_separation  # without one, the tolerance refers to the pair's own length
        options = {"minimum_separation": separation, "length_scale": case.length_scale if separation else None}
        exact = exact_tois(kind, *points, separation=separation * case.length_scale)
        for tolerance in (1e-6, 1e-12):
            toi = SOLVE[kind](*points, tolerance=tolerance, precision=precision, **options).toi
            assert not any(e.late(t) for e, t in zip(exact, toi, strict=True)), case.name
