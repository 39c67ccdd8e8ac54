"""The exact oracles against published truth and slower methods that they do not use themselves."""

import math
from fractions import Fraction
from functools import reduce
from itertools import combinations, pairwise

import numpy as np
import oracle
import published
import pytest
from algebraic import unit_roots
from daily import marked
from distance_oracle import exact_distance, exact_distance_tois, is_within
from distance_queries import KINDS
from flint import fmpq, fmpq_mat, fmpz_poly
from hard_cases import FAMILIES, POINTS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracle import exact_gap, exact_toi, exact_tois
from oracle_corners import CORNERS

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
OF_KINDS = [(family, *kind) for family in FAMILIES for kind in KINDS]


def by_turns(first):
    """Every family with every kind, of which each run of the tests has half, by turns from family to family."""
    daily = [case for k, case in enumerate(OF_KINDS) if (k + k // len(KINDS)) % 2 == first]
    return pytest.mark.parametrize("family, kind, dimension", marked(OF_KINDS, daily))


def touches(kind, points_t0, points_t1, t):
    """Whether the pair touches at t: by Caratheodory some three corners or fewer combine to zero, uniquely."""
    both = (points_t0.tolist(), points_t1.tolist())
    start, end = (fmpq_mat([[fmpq(*x.as_integer_ratio()) for x in point] for point in points]) for points in both)
    at = ((1 - t) * start + t * end).tolist()
    corners = [[x - y for x, y in zip(at[i], at[j], strict=True)] for i, j in CORNERS[kind]]
    if any(all(x > 0 for x in axis) or all(x < 0 for x in axis) for axis in zip(*corners, strict=True)):
        return False
    for chosen in (of for n in (1, 2, 3) for of in combinations(corners, n)):
        n, axes = len(chosen), [[*axis, fmpq(0)] for axis in zip(*chosen, strict=True)]
        reduced, rank = fmpq_mat([*axes, [fmpq(1)] * (n + 1)]).rref()
        if rank == n and all(reduced[k, k] == 1 and reduced[k, n] >= 0 for k in range(n)):
            return True
    return False


@published.requires_data
def test_oracle_agrees_with_every_published_truth():
    for queries in published.all_queries():
        results = exact_tois(queries.kind, queries.points_t0, queries.points_t1)
        assert len(queries) and [i for i, r in enumerate(results) if r.hit != queries.truth[i]] == []


def test_float64_beside_no_time_a_rational_and_an_irrational_one():
    above, *ends = ([[0.25, 0.25, z], [0, 0, 0], [1, 0, 0], [0, 1, 0]] for z in (1, 1, -2, -1))
    none, third, half = (exact_toi("vertex-face", above, end) for end in ends)
    assert not half.late(0.5) and half.late(np.nextafter(0.5, 1))
    assert not (none.hit or none.late(0.5) or none.late(math.inf)) and third.late(math.inf)
    assert third.lo == third.hi == fmpq(1, 3) and third.approx == 1 / 3 and third.early_by(1 / 3) == 2.0**-54 / 3
    assert not third.late(1 / 3) and third.late(np.nextafter(1 / 3, 1))
    # p = (t, 1/2) on the segment from the origin to (2, 2 t): 2 t^2 = 1
    root = exact_toi("point-segment", [[0, 0.5], [0, 0], [2, 0]], [[1, 0.5], [0, 0], [2, 2]])
    lo, hi = root.refine(200)
    assert not root.rational and lo * lo < fmpq(1, 2) < hi * hi and hi - lo < fmpq(1, 2**200)
    for x in (math.sqrt(0.5), np.nextafter(math.sqrt(0.5), 0), np.nextafter(math.sqrt(0.5), 1)):
        assert root.late(x) == (2 * Fraction(float(x)) ** 2 > 1)


def product(factors):
    return tuple(map(int, reduce(np.convolve, (np.array(factor, dtype=object) for factor in factors))))


rationals = st.fractions(-1, 2, max_denominator=10**6) | st.sampled_from([0, 1, Fraction(1, 3), 1 - Fraction(1, 2**70)])


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(rationals.map(Fraction), min_size=1, max_size=3), st.sampled_from([1, -1, 12]))
def test_all_rational_roots_are_found_in_order(values, scale):
    roots = unit_roots(product([(-x.numerator, x.denominator) for x in values] + [(scale,)]))
    inside = sorted({x for x in values if 0 <= x <= 1})
    assert [r.value for r in roots] == [fmpq(x.numerator, x.denominator) for x in inside]


def test_roots_that_are_equal_or_two_to_the_minus_hundreds_apart():
    first, second = unit_roots((-1, 0, 2))[0], unit_roots(product([(-1, 0, 2), (-3, 1000)]))[1]
    near = unit_roots((-(2**200) - 1, 0, 2**201))[0]
    assert first.compare(second) == second.compare(first) == 0 and first.compare(near) == -1 == -near.compare(first)
    assert first.sign_of((-3, 2, 2)) == -1 and near.sign_of((-1, 0, 2)) == 1 and near.sign_of((0, 0, 0)) == 0
    roots = unit_roots(product([(-(2**300), 3 * 2**300), (-(2**300) - 1, 3 * 2**300)]))
    assert [r.value for r in roots] == [fmpq(1, 3), fmpq(2**300 + 1, 3 * 2**300)]


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.integers(-(10**30), 10**30), min_size=2, max_size=4), st.integers(0, 500))
def test_refinement_keeps_the_root(poly, bits):
    roots = unit_roots(tuple(poly)) if any(poly) else []
    assert all(x.compare(y) < 0 for x, y in pairwise(roots))
    for root in (root for root in roots if root.value is None):
        lo, hi = root.bounds(bits)
        values = [fmpz_poly(list(root.poly))(x) for x in (lo, hi)]
        assert hi - lo <= hi / 2**bits and values[0] * values[1] < 0 and root.sign_of(tuple(poly)) == 0


@by_turns(0)
def test_no_contact_before_the_exact_toi_and_contact_at_it(family, kind, dimension):
    points = FAMILIES[family](kind, 8, np.random.default_rng(1), dimension)
    times = [fmpq(k, 16) for k in range(17)] + [fmpq(k, 12) for k in (1, 2, 4, 5, 7, 8, 10, 11)]
    for a, b, toi in zip(*points, exact_tois(kind, *points), strict=True):
        end = toi.hi if toi.hit else fmpq(2)
        assert not any(touches(kind, a, b, t) for t in times if t < end)
        if toi.hit and toi.rational:
            assert touches(kind, a, b, end)
        elif toi.hit:  # its interval is 2**-80 wide, and so far from contact may its end be
            assert exact_gap(kind, a, b, toi.hi) <= 2.0**-79 * 2 * np.abs(b - a).max()


@by_turns(1)
def test_gap_equals_the_separation_when_it_is_reached(family, kind, dimension):
    for a, b in zip(*FAMILIES[family](kind, 4, np.random.default_rng(3), dimension), strict=True):
        start, size = exact_gap(kind, a, b, 0.0), max(np.abs(a).max(), np.abs(b).max())
        found = []
        for separation in (0.0, start / 1024, start / 2, 2.0 * start + size * 2.0**-20):
            found.append(toi := exact_toi(kind, a, b, separation))
            until = toi.lo if toi.hit else 2
            assert all(exact_gap(kind, a, b, fmpq(k, 8)) >= separation for k in range(9) if fmpq(k, 8) < until)
            if toi.hit and toi.lo > 0:
                assert exact_gap(kind, a, b, toi.hi) == pytest.approx(separation, rel=1e-15, abs=2.0**-78 * size)
        assert all(not x.hit or (y.hit and y.root.compare(x.root) <= 0) for x, y in pairwise(found))
        assert found[-1].lo == 0


@every_kind
def test_cull_scale_and_shorter_steps_change_nothing(kind, dimension, monkeypatch):
    def answers(found):
        return [(x.hit, x.approx) for x in found]

    for family in ("random_colliding", "cloth_like", "lattice", "one_plane", "slivers", "mixed_axis_scales"):
        points = FAMILIES[family](kind, 20, np.random.default_rng(4), dimension)
        for separation in (0.0, 0.01):
            expected = answers(plain := exact_tois(kind, *points, separation))
            for e in (-400, 400):
                assert answers(exact_tois(kind, *np.ldexp(points, e), np.ldexp(separation, e))) == expected
            with monkeypatch.context() as patch:
                patch.setattr(oracle, "certainly_apart", lambda kind, p0, *_: np.zeros(len(p0), dtype=bool))
                assert answers(exact_tois(kind, *points, separation)) == expected
            for cut, full in zip(exact_tois(kind, *points, separation, t_max=0.75), plain, strict=True):
                assert cut.hit == (full.hit and full.compare(0.75) >= 0)
                assert not cut.hit or (cut.lo <= full.hi and full.lo <= cut.hi and cut.rational == full.rational)


# --- of Euclidean distances ---


@every_kind
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


# --- what families of hard cases promise ---


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
