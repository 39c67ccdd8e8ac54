"""The exact oracle against published truth, hand-computed times, and slower methods that it does not use itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
import oracle
import published
import pytest
from algebraic import Root, unit_roots, value_dyadic
from daily import marked
from exact_toi import ExactToi
from flint import fmpq
from hard_cases import FAMILIES
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import exact_gap, exact_toi, exact_tois
from oracle_corners import POINTS

KINDS = [
    ("vertex-face", 3),
    ("edge-edge", 3),
    ("point-segment", 2),
    ("point-segment", 3),
    ("point-point", 2),
    ("point-point", 3),
]
kind_and_dimension = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
every_family = pytest.mark.parametrize("family", FAMILIES)
_OF_KINDS = [(family, *kind) for family in FAMILIES for kind in KINDS]


def by_turns(first: int) -> pytest.MarkDecorator:
    """Every family with every kind, of which each run of the tests has half, by turns from family to family."""
    daily = [case for k, case in enumerate(_OF_KINDS) if (k + k // len(KINDS)) % 2 == first]
    return pytest.mark.parametrize("family, kind, dimension", marked(_OF_KINDS, daily))


# ---- A slower method: contact at a rational time, by trying all convex combinations --------------------------------


def _fractions(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: Fraction) -> list[list[Fraction]]:
    """Corners of the gap at t, from the definition."""

    def at(i: int) -> list[Fraction]:
        return [
            Fraction(a) + t * (Fraction(b) - Fraction(a))
            for a, b in zip(points_t0[i].tolist(), points_t1[i].tolist(), strict=True)
        ]

    pairs = {
        "vertex-face": [(0, 1), (0, 2), (0, 3)],
        "edge-edge": [(i, j) for i in (0, 1) for j in (2, 3)],
        "point-segment": [(0, 1), (0, 2)],
        "point-point": [(0, 1)],
    }
    return [[x - y for x, y in zip(at(i), at(j), strict=True)] for i, j in pairs[kind]]


def _weights(corners: list[list[Fraction]]) -> list[Fraction] | None:
    """The unique weights of sum one that combine the corners to zero; None where there are none or many."""
    rows = [[c[k] for c in corners] + [Fraction(0)] for k in range(len(corners[0]))]
    rows.append([Fraction(1)] * len(corners) + [Fraction(1)])
    done = 0
    for column in range(len(corners)):
        pivot = next((r for r in range(done, len(rows)) if rows[r][column]), None)
        if pivot is None:
            return None
        rows[done], rows[pivot] = rows[pivot], rows[done]
        rows[done] = [x / rows[done][column] for x in rows[done]]
        for r in range(len(rows)):
            if r != done and rows[r][column]:
                factor = rows[r][column]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[done], strict=True)]
        done += 1
    if any(row[-1] for row in rows[done:]):
        return None
    return [row[-1] for row in rows[:done]]


def _touches(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: Fraction) -> bool:
    """Whether the pair touches at t: by Caratheodory some three corners or fewer combine to zero, uniquely."""
    corners = _fractions(kind, points_t0, points_t1, t)
    if any(all(x > 0 for x in axis) or all(x < 0 for x in axis) for axis in zip(*corners, strict=True)):
        return False
    for count in range(1, min(len(corners), 3) + 1):
        for chosen in combinations(corners, count):
            weights = _weights(list(chosen))
            if weights is not None and min(weights) >= 0:
                return True
    return False


def _fraction(value: fmpq) -> Fraction:
    return Fraction(int(value.p), int(value.q))


def _generate(family: str, kind: str, n: int, dimension: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return FAMILIES[family](kind, n, np.random.default_rng(seed), dimension=dimension)


# ---- Published truth -------------------------------------------------------------------------------------------------


@published.requires_data
@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
@pytest.mark.parametrize("load", [published.handcrafted_queries, published.simulation_queries])
def test_oracle_agrees_with_every_published_truth(load: Callable, kind: str) -> None:
    scenes = published.handcrafted_scenes() if load is published.handcrafted_queries else published.simulation_scenes()
    assert scenes
    for scene in scenes:
        queries = load(scene, kind)
        assert len(queries) > 0
        results = exact_tois(kind, queries.points_t0, queries.points_t1)
        wrong = [queries.id(i) for i, r in enumerate(results) if r.hit != queries.truth[i]]
        assert wrong == []


@published.requires_data
def test_frames_hold_the_points_of_the_published_queries() -> None:
    for scene in published.simulation_scenes():
        step = published.simulation_step(scene)
        edges = published.edges_by_max(step.faces)
        edge_start, face_start = len(step.vertices_t0), len(step.vertices_t0) + len(edges)
        for kind in ("vertex-face", "edge-edge"):
            queries, ids = published.simulation_queries(scene, kind), published.simulation_boxes(scene, kind)
            if kind == "edge-edge":
                rows = np.concatenate([edges[ids[:, 0] - edge_start], edges[ids[:, 1] - edge_start]], axis=1)
            else:
                rows = np.concatenate([ids[:, :1], step.faces[ids[:, 1] - face_start]], axis=1)
            assert np.array_equal(step.vertices_t0[rows], queries.points_t0)
            assert np.array_equal(step.vertices_t1[rows], queries.points_t1)


# ---- Hand-computed times ---------------------------------------------------------------------------------------------

FLAT_FACE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def _falling_vertex(x: float, y: float, start: float, end: float, **options: float) -> ExactToi:
    return exact_toi("vertex-face", [[x, y, start], *FLAT_FACE], [[x, y, end], *FLAT_FACE], **options)


def test_vertex_falls_on_a_face_at_a_third() -> None:
    toi = _falling_vertex(0.25, 0.25, 1.0, -2.0)
    assert toi.hit and toi.rational and toi.lo == toi.hi == fmpq(1, 3)
    assert toi.approx == 1 / 3
    # The float64 next to 1/3 is below it.
    assert not toi.late(1 / 3) and toi.late(np.nextafter(1 / 3, 1))
    assert toi.early_by(1 / 3) == 2.0**-54 / 3


@pytest.mark.parametrize(
    "x, y, hit", [(0, 0, 1), (0.5, 0.5, 1), (1, 0, 1), (-(2.0**-60), 0, 0), (0.5, 0.5 + 2**-50, 0)]
)
def test_vertex_meets_or_misses_the_rim_of_a_face(x: float, y: float, hit: int) -> None:
    assert _falling_vertex(x, y, 1.0, -1.0).hit == bool(hit)


def test_contact_at_the_closed_ends_of_the_step() -> None:
    assert _falling_vertex(0.25, 0.25, 1.0, 0.0).lo == 1
    assert _falling_vertex(0.25, 0.25, 0.0, 1.0).lo == 0
    assert not _falling_vertex(0.25, 0.25, 1.0, 2.0**-60).hit


def test_t_max_closes_the_step() -> None:
    assert _falling_vertex(0.25, 0.25, 1.0, -1.0, t_max=0.5).lo == fmpq(1, 2)
    assert not _falling_vertex(0.25, 0.25, 1.0, -1.0, t_max=np.nextafter(0.5, 0)).hit
    toi = _falling_vertex(0.25, 0.25, 1.0, -2.0, t_max=0.4)
    assert toi.lo == fmpq(1, 3) and not toi.late(1 / 3) and toi.late(np.nextafter(1 / 3, 1))
    assert _falling_vertex(0.25, 0.25, 0.0, 1.0, t_max=0.0).lo == 0
    assert not _falling_vertex(0.25, 0.25, 1.0, 0.0, t_max=0.0).hit


def test_point_meets_a_turning_segment_at_the_root_of_a_half() -> None:
    # p = (t, 1/2) on the segment from the origin to (2, 2 t): 2 t^2 = 1.
    toi = exact_toi("point-segment", [[0, 0.5], [0, 0], [2, 0]], [[1, 0.5], [0, 0], [2, 2]])
    assert toi.hit and not toi.rational
    lo, hi = toi.refine(200)
    assert lo < hi and lo * lo < fmpq(1, 2) < hi * hi and hi - lo < fmpq(1, 2**200)
    assert toi.approx == pytest.approx(math.sqrt(0.5), rel=2e-16)
    for x in (math.sqrt(0.5), np.nextafter(math.sqrt(0.5), 0), np.nextafter(math.sqrt(0.5), 1)):
        assert toi.late(x) == (2 * Fraction(float(x)) ** 2 > 1)


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
def test_cubic_contact_at_the_cube_root_of_a_half(kind: str) -> None:
    # P = (0, -t/2, 1/4), Q = (-1, 0, -t), R = (t, 1, 0): P . (Q x R) is a multiple of t^3 - 1/2, (u, v) = (t^2, t) / 2.
    frames = []
    for t in (0.0, 1.0):
        p, q, r = np.array([[0, -t / 2, 0.25], [-1, 0, -t], [t, 1, 0]])
        o = np.zeros(3)
        frames.append([p, o, -q, -r] if kind == "vertex-face" else [p, p + q, o, -r])
    toi = exact_toi(kind, *frames)
    assert toi.hit and not toi.rational
    lo, hi = toi.refine(120)
    assert lo**3 < fmpq(1, 2) < hi**3
    assert exact_gap(kind, *frames, toi.refine(80)[0]) < 1e-20


def test_edges_cross_at_two_thirds() -> None:
    toi = exact_toi(
        "edge-edge",
        [[-1, 0, 2], [1, 0, 2], [0, -1, 0], [0, 1, 0]],
        [[-1, 0, -1], [1, 0, -1], [0, -1, 0], [0, 1, 0]],
    )
    assert toi.lo == toi.hi == fmpq(2, 3)


def test_parallel_edges_approach_and_slide() -> None:
    still = [[0, 0, 0], [1, 0, 0]]
    # Side by side, then end to end on one line.
    assert exact_toi("edge-edge", [*still, [0.5, 1, 0], [2, 1, 0]], [*still, [0.5, -3, 0], [2, -3, 0]]).lo == fmpq(1, 4)
    assert exact_toi("edge-edge", [*still, [3, 0, 0], [4, 0, 0]], [*still, [0, 0, 0], [1, 0, 0]]).lo == fmpq(2, 3)
    assert not exact_toi("edge-edge", [*still, [3, 0, 0], [4, 0, 0]], [*still, [2, 0, 0], [3, 0, 0]]).hit
    assert not exact_toi("edge-edge", [*still, [0, 1, 0], [1, 1, 0]], [*still, [5, 1, 0], [6, 1, 0]]).hit


def test_point_slides_in_the_plane_of_the_face() -> None:
    assert exact_toi("vertex-face", [[-1, 0.25, 0], *FLAT_FACE], [[2, 0.25, 0], *FLAT_FACE]).lo == fmpq(1, 3)
    assert not exact_toi("vertex-face", [[-1, 2, 0], *FLAT_FACE], [[2, 2, 0], *FLAT_FACE]).hit


def test_zero_area_face_and_zero_length_edges() -> None:
    needle = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert exact_toi("vertex-face", [[1.5, 0, 1], *needle], [[1.5, 0, -1], *needle]).lo == fmpq(1, 2)
    assert not exact_toi("vertex-face", [[2.5, 0, 1], *needle], [[2.5, 0, -1], *needle]).hit
    dots = [[1, 1, 1], [1, 1, 1], [0, 0, 0], [0, 0, 0]]
    assert exact_toi("edge-edge", dots, [[-2, -2, -2]] * 2 + [[0, 0, 0]] * 2).lo == fmpq(1, 3)
    assert not exact_toi("edge-edge", dots, [[-2, -2, -2.5]] * 2 + [[0, 0, 0]] * 2).hit


def test_points_meet_or_pass() -> None:
    assert exact_toi("point-point", [[0, 0], [3, 3]], [[1, 1], [1, 1]]).lo == 1
    assert exact_toi("point-point", [[0, 0], [3, 6]], [[3, 6], [0, 0]]).lo == fmpq(1, 2)
    assert not exact_toi("point-point", [[0, 0], [3, 6]], [[3, 6], [0, 1]]).hit


def test_separation_of_falling_vertex() -> None:
    # The gap in z is 1 - 2 t; float64 0.1 is not a tenth.
    assert _falling_vertex(0.25, 0.25, 1.0, -1.0, separation=0.25).lo == fmpq(3, 8)
    p, q = (0.1).as_integer_ratio()
    assert _falling_vertex(0.25, 0.25, 1.0, -1.0, separation=0.1).lo == (1 - fmpq(p, q)) / 2
    assert _falling_vertex(0.25, 0.25, 1.0, -1.0, separation=1.0).lo == 0
    # Outside the rim by 1/8 on one axis.
    assert _falling_vertex(-0.125, 0.25, 1.0, -1.0, separation=0.25).lo == fmpq(3, 8)
    assert _falling_vertex(-0.125, 0.25, 1.0, -1.0, separation=0.125).lo == fmpq(7, 16)
    assert not _falling_vertex(-0.125, 0.25, 1.0, -1.0, separation=np.nextafter(0.125, 0)).hit


def test_separation_is_measured_in_the_largest_coordinate() -> None:
    # The distance of (s, s) from the line x + y = 0 is s in the largest coordinate, at s = 1 - t.
    segment = [[-2, 2], [2, -2]]
    assert exact_toi("point-segment", [[1, 1], *segment], [[0, 0], *segment], separation=0.25).lo == fmpq(3, 4)
    assert exact_gap("point-segment", [[1, 1], *segment], [[0, 0], *segment], 0.5) == 0.5
    assert exact_toi("point-point", [[0, 0, 0], [4, 3, 2]], [[0, 0, 0], [0, 0, 0]], separation=1.0).lo == fmpq(3, 4)


def test_gap_of_hand_computed_pairs() -> None:
    still = [[0, 0, 0], [1, 0, 0]]
    pair = [*still, [0.5, -1, 0.75], [0.5, 1, 0.75]]
    assert exact_gap("edge-edge", pair, pair, 0.3) == 0.75
    assert (
        exact_gap("vertex-face", [[0.25, 0.25, 1], *FLAT_FACE], [[0.25, 0.25, -2], *FLAT_FACE], Fraction(1, 3)) == 0.0
    )
    assert exact_gap("vertex-face", [[0.25, 0.25, 1], *FLAT_FACE], [[0.25, 0.25, -2], *FLAT_FACE], fmpq(2, 3)) == 1.0
    assert exact_gap("point-point", [[0, 0], [2.0**-300, 0]], [[0, 0], [0, 0]], 0.5) == 2.0**-301


def test_result_without_a_hit() -> None:
    toi = _falling_vertex(2.0, 2.0, 1.0, -1.0)
    assert not toi.hit and toi.lo is None and toi.hi is None and toi.approx == math.inf
    assert not toi.late(0.5) and not toi.late(math.inf) and toi.compare(0.5) == -1 and toi.compare(math.inf) == 0
    with pytest.raises(ValueError, match="nan"):
        toi.compare(math.nan)


def test_a_hit_reported_as_none_is_late() -> None:
    assert _falling_vertex(0.25, 0.25, 1.0, 0.0).late(math.inf)
    assert not _falling_vertex(0.25, 0.25, 1.0, 0.0).late(1.0)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="kind"):
        exact_tois("face-face", np.zeros((1, 4, 3)), np.zeros((1, 4, 3)))
    with pytest.raises(ValueError, match="shapes"):
        exact_tois("vertex-face", np.zeros((1, 4, 2)), np.zeros((1, 4, 2)))
    with pytest.raises(ValueError, match="non-finite"):
        exact_tois("vertex-face", np.zeros((1, 4, 3)), np.full((1, 4, 3), np.nan))
    for options in ({"separation": -1.0}, {"t_max": 2.0}):
        with pytest.raises(ValueError, match=next(iter(options))):
            exact_tois("vertex-face", np.zeros((1, 4, 3)), np.zeros((1, 4, 3)), **options)
    assert exact_tois("vertex-face", np.zeros((0, 4, 3)), np.zeros((0, 4, 3))) == []


# ---- Roots -----------------------------------------------------------------------------------------------------------


def _product(factors: list[tuple[int, ...]]) -> tuple[int, ...]:
    poly = (1,)
    for factor in factors:
        result = [0] * (len(poly) + len(factor) - 1)
        for i, a in enumerate(poly):
            for j, b in enumerate(factor):
                result[i + j] += a * b
        poly = tuple(result)
    return poly


rationals = st.fractions(min_value=-1, max_value=2, max_denominator=10**6) | st.sampled_from(
    [Fraction(0), Fraction(1), Fraction(1, 2), Fraction(1, 3), 1 - Fraction(1, 2**70)]
)


@given(st.lists(rationals, min_size=1, max_size=3), st.sampled_from([1, -1, 12]))
def test_all_rational_roots_are_found_in_order(values: list[Fraction], scale: int) -> None:
    roots = unit_roots(_product([(-x.numerator, x.denominator) for x in values] + [(scale,)]))
    assert all(root.denominator > 0 for root in roots)
    assert [Fraction(r.numerator, r.denominator) for r in roots] == sorted({x for x in values if 0 <= x <= 1})


@given(st.fractions(0, 1, max_denominator=200), st.fractions(0, 1, max_denominator=200), rationals)
def test_roots_of_a_quadratic_times_a_linear_factor(center: Fraction, square: Fraction, other: Fraction) -> None:
    # (t - center)^2 = square, of which the sign at a rational is known without any root.
    a = ((center**2 - square).limit_denominator(10**12), -2 * center, Fraction(1))
    common = math.lcm(*(x.denominator for x in a))
    poly = _product([tuple(int(x * common) for x in a), (-other.numerator, other.denominator)])
    roots = unit_roots(poly)
    expected = {other} | {center + s * math.sqrt(square) for s in (-1, 1)}
    inside = [x for x in expected if 1e-9 < x < 1 - 1e-9]
    assert len(roots) >= len({round(float(x), 6) for x in inside})
    assert all(r.sign_of(poly) == 0 and r.compare_rational(0, 1) >= 0 >= r.compare_rational(1, 1) for r in roots)
    assert all(x.compare(y) < 0 < y.compare(x) for x, y in pairwise(roots))


def test_one_number_as_the_root_of_two_polynomials() -> None:
    # t^2 = 1/2 in both; a third one has a root 2**-200 beside it.
    first = unit_roots((-1, 0, 2))[0]
    second = unit_roots(_product([(-1, 0, 2), (-3, 1000)]))[1]
    near = unit_roots((-(2**200) - 1, 0, 2**201))[0]
    assert not first.denominator and first.compare(second) == second.compare(first) == 0
    assert first.compare(near) == -1 and near.compare(first) == 1
    assert first.sign_of((-3, 2, 2)) == -1 and first.sign_of((-(2**200) - 1, 0, 2**201)) == -1
    assert near.sign_of((-1, 0, 2)) == 1 and near.sign_of((0, 0, 0)) == 0


def test_roots_two_to_the_minus_three_hundred_apart() -> None:
    roots = unit_roots(_product([(-(2**300), 3 * 2**300), (-(2**300) - 1, 3 * 2**300)]))
    assert [Fraction(r.numerator, r.denominator) for r in roots] == [Fraction(1, 3), Fraction(2**300 + 1, 3 * 2**300)]


@settings(max_examples=50)
@given(st.lists(st.integers(-(10**30), 10**30), min_size=2, max_size=4), st.integers(0, 500))
def test_refinement_keeps_the_root(poly: list[int], bits: int) -> None:
    if not any(poly):
        return
    for root in unit_roots(tuple(poly)):
        if not root.denominator:
            root.refine(bits)
            assert root.k >= bits
            ends = [value_dyadic(root.poly, root.a + i, root.k) for i in (0, 1)]
            assert ends[0] * ends[1] < 0
            assert Root.isolated(root.poly, root.a, root.k).compare(root) == 0


# ---- Families --------------------------------------------------------------------------------------------------------


@kind_and_dimension
@every_family
def test_family_is_reproducible(family: str, kind: str, dimension: int) -> None:
    first, again = (_generate(family, kind, 5, dimension) for _ in range(2))
    for points, same in zip(first, again, strict=True):
        assert points.shape == (5, POINTS[kind], dimension) and points.dtype == np.float64
        assert np.isfinite(points).all() and np.array_equal(points, same)
    assert FAMILIES[family].__doc__


@pytest.mark.parametrize(
    "family, toi", [("touching_at_start", 0.0), ("contact_exactly_at_end", 1.0), ("double_root", None)]
)
@kind_and_dimension
def test_lattice_families_touch_exactly_where_they_say(
    family: str, toi: float | None, kind: str, dimension: int
) -> None:
    points_t0, points_t1 = _generate(family, kind, 40, dimension)
    results = exact_tois(kind, points_t0, points_t1)
    assert all(r.hit for r in results)
    if toi is not None:
        assert all(_touches(kind, a, b, Fraction(toi)) for a, b in zip(points_t0, points_t1, strict=True))
        assert sum(r.compare(toi) == 0 for r in results) > 10
    elif kind in ("vertex-face", "edge-edge"):
        assert all(r.rational and 8 % int(r.lo.q) == 0 for r in results)


@by_turns(0)
def test_no_contact_before_the_exact_toi_and_contact_at_it(family: str, kind: str, dimension: int) -> None:
    points_t0, points_t1 = _generate(family, kind, 8, dimension, seed=1)
    times = [Fraction(k, 16) for k in range(17)] + [Fraction(k, 12) for k in (1, 2, 4, 5, 7, 8, 10, 11)]
    for a, b, toi in zip(points_t0, points_t1, exact_tois(kind, points_t0, points_t1), strict=True):
        end = _fraction(toi.hi) if toi.hit else Fraction(2)
        assert not any(_touches(kind, a, b, t) for t in times if t < end)
        if toi.hit and toi.rational:
            assert _touches(kind, a, b, end)
        elif toi.hit:
            # The interval of the toi is 2**-80 wide, so that is how far from contact its end may be.
            speed = 2 * np.abs(b - a).max()
            assert exact_gap(kind, a, b, toi.hi) <= 2.0**-79 * speed


@by_turns(1)
def test_contact_is_the_limit_of_contact_with_separation(family: str, kind: str, dimension: int) -> None:
    """The two methods share nothing beyond the roots; a gap cannot be as small as 2**-700 of the size and not zero."""
    points_t0, points_t1 = _generate(family, kind, 6, dimension, seed=2)
    size = 2.0 ** math.frexp(max(np.abs(points_t0).max(), np.abs(points_t1).max()))[1]
    contact = exact_tois(kind, points_t0, points_t1)
    near = exact_tois(kind, points_t0, points_t1, separation=size * 2.0**-700)
    # One unit in the last place of a zero coordinate is 2**-1074, a gap that no separation is small enough for.
    coordinates = np.abs(np.concatenate([points_t0, points_t1], axis=1).reshape(6, -1))
    subnormal = ((coordinates > 0) & (coordinates < np.finfo(np.float64).tiny)).any(axis=1)
    for exact, close, skip in zip(contact, near, subnormal, strict=True):
        if skip:
            assert close.hit or not exact.hit
            continue
        assert exact.hit == close.hit
        if exact.hit:
            assert close.root.compare(exact.root) <= 0
            # At a double root the time moves with the square root of the separation.
            assert exact.hi - close.lo <= fmpq(1, 2**75)


@by_turns(1)
def test_gap_equals_the_separation_when_it_is_reached(family: str, kind: str, dimension: int) -> None:
    points_t0, points_t1 = _generate(family, kind, 6, dimension, seed=3)
    gap = [exact_gap(kind, a, b, 0.0) for a, b in zip(points_t0, points_t1, strict=True)]
    for a, b, start in zip(points_t0, points_t1, gap, strict=True):
        # Rounded values of both would differ at the size of the coordinates, not of the gap.
        size = max(np.abs(a).max(), np.abs(b).max())
        previous = None
        for separation in (0.0, start / 1024, start / 2, 2.0 * start + size * 2.0**-20):
            toi = exact_toi(kind, a, b, separation)
            if previous is not None and previous.hit:
                assert toi.hit and toi.root.compare(previous.root) <= 0
            previous = toi
            before = [Fraction(k, 8) for k in range(9)]
            if toi.hit:
                before = [t for t in before if t < _fraction(toi.lo)]
                reached = exact_gap(kind, a, b, toi.hi)
                if toi.lo > 0:
                    assert reached == pytest.approx(separation, rel=1e-15, abs=2.0**-78 * size)
                else:
                    assert reached <= separation
            for t in before:
                # Rounding once may bring a gap down to the separation, not below it.
                assert exact_gap(kind, a, b, t) >= separation
        assert previous.hit and previous.lo == 0


@pytest.mark.parametrize("separation", [0.0, 0.01])
@pytest.mark.parametrize("family", ["random", "cloth_like", "lattice", "slivers", "rotation_like", "mixed_axis_scales"])
@kind_and_dimension
def test_cull_changes_no_answer(
    family: str, kind: str, dimension: int, separation: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    points_t0, points_t1 = _generate(family, kind, 40, dimension, seed=4)
    culled = exact_tois(kind, points_t0, points_t1, separation)
    monkeypatch.setattr(oracle, "certainly_apart", lambda kind, p0, *_: np.zeros(len(p0), dtype=bool))
    full = exact_tois(kind, points_t0, points_t1, separation)
    assert [(r.hit, r.approx) for r in culled] == [(r.hit, r.approx) for r in full]


@pytest.mark.parametrize("exponent", [-900, -400, 400, 900])
@pytest.mark.parametrize("family", ["lattice", "random_colliding"])
@kind_and_dimension
def test_power_of_two_scale_changes_nothing(family: str, kind: str, dimension: int, exponent: int) -> None:
    points = _generate(family, kind, 20, dimension, seed=5)
    for separation in (0.0, 0.125):
        plain = exact_tois(kind, *points, separation)
        scaled = exact_tois(kind, *(2.0**exponent * p for p in points), separation=2.0**exponent * separation)
        assert [(r.hit, r.approx) for r in plain] == [(r.hit, r.approx) for r in scaled]


@kind_and_dimension
def test_shorter_step_gives_the_same_time_or_none(kind: str, dimension: int) -> None:
    for family in ("lattice", "random_colliding", "one_plane"):
        points = _generate(family, kind, 30, dimension, seed=6)
        whole = exact_tois(kind, *points)
        for t_max in (0.3, 0.5, 0.7):
            for full, cut in zip(whole, exact_tois(kind, *points, t_max=t_max), strict=True):
                assert cut.hit == (full.hit and full.compare(t_max) >= 0)
                if cut.hit:
                    assert cut.lo <= full.hi and full.lo <= cut.hi and cut.rational == full.rational


def test_axes_a_hundred_and_twenty_decades_apart() -> None:
    rng = np.random.default_rng(7)
    for kind, dimension in KINDS:
        points = _generate("random_colliding" if kind != "point-point" else "lattice", kind, 10, dimension, seed=7)
        scale = rng.permutation([2.0**-200, 1.0, 2.0**200])[:dimension]
        plain, scaled = exact_tois(kind, *points), exact_tois(kind, *(p * scale for p in points))
        assert [(r.hit, r.approx) for r in plain] == [(r.hit, r.approx) for r in scaled]
