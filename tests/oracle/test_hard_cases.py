"""The catalogue of hard cases: what each family promises."""

from fractions import Fraction

import numpy as np
import pytest
from distance_queries import KINDS
from exact import exact_tois
from hard_cases import FAMILIES, POINTS
from oracle import exact_gap

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])


@every_kind
def test_families_have_shapes_seeds_and_reasons(kind, dimension):
    for name, case in FAMILIES.items():
        assert case.name == name and case.fails and case.why == case.generate.__doc__.strip() and "\n" not in case.why
        first, again, other = (np.stack(case(kind, 6, np.random.default_rng(seed), dimension)) for seed in (0, 0, 1))
        assert first.shape == (2, 6, POINTS[kind], dimension) and np.isfinite(first).all()
        assert np.array_equal(first, again) and not np.array_equal(first, other)


@every_kind
def test_contacts_are_where_and_when_the_families_say(kind, dimension):
    def exact(family):
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


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
def test_shapes_are_as_degenerate_as_the_families_say(kind):
    points = {name: np.stack(case(kind, 40, np.random.default_rng(0), 3)) for name, case in FAMILIES.items()}
    of = ([0, 1, 1], [1, 2, 3]) if kind == "vertex-face" else ([0, 1, 2], [2, 0, 3])

    def vectors(family, t):
        """P, Q and R of each pair at t, exactly, shape [3, n, 3]."""
        start, end = np.vectorize(Fraction, otypes=[object])(points[family])
        x = (1 - t) * start + t * end
        return (x[:, of[0]] - x[:, of[1]]).swapaxes(0, 1)

    along = np.zeros(40, dtype=bool)  # contact all along a line
    for k in range(1, 8):
        x = vectors("simultaneous_contacts", Fraction(k, 8))
        along |= (np.cross(x, np.roll(x, 1, axis=0)) == 0).all(axis=(0, 2))
    assert along.all()
    for t in range(4):  # a cubic with four roots is zero
        p, q, r = vectors("infinite_roots", Fraction(t))
        assert ((p * np.cross(q, r)).sum(axis=1) == 0).all()
    assert (np.ptp(points["infinite_roots"][0], axis=1) > 0).all(axis=1).mean() > 0.8
    for k in (0, 1):
        _, q, r = vectors("needle_against_needle", Fraction(k)).astype(float)
        size = np.maximum((q * q).sum(axis=1), (r * r).sum(axis=1))
        assert np.median(np.linalg.norm(np.cross(q, r), axis=1) / size) < 1e-5
    for family, least in (("huge_motion", 1e5), ("fast_and_thin", 50.0)):
        start, end = points[family]
        size = np.ptp(start[:, 1 if kind == "vertex-face" else 2 :], axis=1).max(axis=1)
        assert np.median(np.abs(end - start).max(axis=(1, 2)) / size) > least
    assert np.abs(np.subtract(*points["tiny_motion"])).max() < 1e-8
