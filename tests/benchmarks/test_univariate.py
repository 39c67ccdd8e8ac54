"""The univariate baseline: right on easy queries, silent on clear misses, and known to miss in a common plane."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from ccd_warp.benchmarks.cubic_roots import ROOTS
from ccd_warp.benchmarks.univariate import coplanarity_cubic, ends_ccd, univariate_ccd
from exact import exact_tois
from hard_cases import FAMILIES

KINDS = ("vertex-face", "edge-edge")
every_kind = pytest.mark.parametrize("kind", KINDS)
every_finder = pytest.mark.parametrize("roots", ROOTS)


def _passing(end: float) -> tuple[np.ndarray, np.ndarray]:
    """A vertex that falls from height 1 over the inside of a stationary face to the height `end`."""
    start = np.array([[[0.25, 0.25, 1.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    after = start.copy()
    after[0, 0, 2] = end
    return start, after


# ---- Roots -----------------------------------------------------------------------------------------------------------

# Coefficients, lowest degree first, and the roots in [0, 1].
_CUBICS = {
    "three_roots": (np.poly1d([0.25, 0.5, 0.75], True), [0.25, 0.5, 0.75]),
    "one_root_of_three_inside": (np.poly1d([-2.0, 0.5, 3.0], True), [0.5]),
    "one_real_root": (np.poly1d([0.25], True) * np.poly1d([1.0, 0.0, 1.0]), [0.25]),
    "no_root_inside": (np.poly1d([-0.5, 1.5, 2.0], True), []),
    "both_ends": (np.poly1d([0.0, 1.0, 2.0], True), [0.0, 1.0]),
    "root_of_a_billion": (np.poly1d([0.25, 0.75, 1e9], True), [0.25, 0.75]),
    "root_of_a_million": (np.poly1d([0.25, 0.75, -1e6], True), [0.25, 0.75]),
    "quadratic": (np.poly1d([0.25, 0.75], True), [0.25, 0.75]),
    "quadratic_without_roots": (np.poly1d([1.0, 0.0, 1.0]), []),
    "linear": (np.poly1d([4.0, -1.0]), [0.25]),
    "constant": (np.poly1d([3.0]), []),
    "zero": (np.poly1d([0.0]), []),
}


@every_finder
@pytest.mark.parametrize("case", _CUBICS)
@pytest.mark.parametrize("scale", [1.0, -(2.0**-300), 2.0**300])
def test_roots_of_each_degree(case: str, roots: str, scale: float) -> None:
    cubic, expected = _CUBICS[case]
    coefficients = scale * np.pad(cubic.coeffs[::-1], (0, 4 - len(cubic.coeffs)))[None]
    found = ROOTS[roots](coefficients)
    assert found.shape == (1, 3)
    # Simple roots that are an eighth apart or more: a few units of rounding.
    np.testing.assert_allclose(found[0], expected + [np.inf] * (3 - len(expected)), rtol=0, atol=1e-14)


@every_finder
@pytest.mark.parametrize("multiplicity", [2, 3])
def test_multiple_root_is_found_to_the_accuracy_that_it_has(multiplicity: int, roots: str) -> None:
    cubic = np.poly1d([0.3] * multiplicity + [4.0] * (3 - multiplicity), True)
    found = ROOTS[roots](cubic.coeffs[::-1][None])
    finite = found[np.isfinite(found)]
    assert len(finite) > 0
    # An error of 1e-16 in the coefficients moves a root of multiplicity m by the m-th root of it.
    np.testing.assert_allclose(finite, 0.3, atol=10 * 1e-16 ** (1 / multiplicity))


@every_finder
def test_random_cubics_have_no_root_beyond_the_companion_matrix_of_numpy(roots: str) -> None:
    coefficients = np.random.default_rng(0).normal(size=(500, 4))
    for row, found in zip(coefficients, ROOTS[roots](coefficients), strict=True):
        exact = np.roots(row[::-1])
        exact = np.sort(exact.real[(exact.imag == 0) & (exact.real >= 0) & (exact.real <= 1)])
        # The slope at a root of these is above 1e-4.
        np.testing.assert_allclose(found[np.isfinite(found)], exact, rtol=0, atol=1e-11)


@every_kind
def test_cubic_is_the_triple_product(kind: str) -> None:
    points_t0, points_t1 = FAMILIES["random"](kind, 50, np.random.default_rng(1))
    coefficients = coplanarity_cubic(kind, points_t0, points_t1)
    times = np.array([0.0, 0.3, 0.7, 1.0])
    values = coefficients @ times ** np.arange(4)[:, None]
    expected = np.empty_like(values)
    for k, t in enumerate(times):
        a, b, c, d = np.moveaxis((1 - t) * points_t0 + t * points_t1, 1, 0)
        frame = (a - b, b - c, b - d) if kind == "vertex-face" else (a - c, b - a, c - d)
        expected[:, k] = np.linalg.det(np.stack(frame, axis=1))
    factor = np.median(values / expected, axis=1, keepdims=True)
    assert (np.frexp(np.round(factor, 12))[0] == 0.5).all()  # a power of two
    np.testing.assert_allclose(values, factor * expected, rtol=0, atol=1e-13)


# ---- Queries ---------------------------------------------------------------------------------------------------------


@every_finder
@every_kind
def test_easy_contacts_are_found_where_they_are(kind: str, roots: str) -> None:
    points = FAMILIES["random_colliding"](kind, 300, np.random.default_rng(2))
    toi = univariate_ccd(kind, *points, roots=roots)
    exact = exact_tois(kind, *points)
    assert all(e.hit for e in exact) and np.isfinite(toi).all()
    # Rounding of 1e-16 over the slope of the cubic at the root, which is above 1e-6 in general position.
    np.testing.assert_allclose(toi, [e.approx for e in exact], rtol=0, atol=1e-9)
    # A root is rounded to either side: nothing makes the answer conservative.
    assert any(e.late(t) for e, t in zip(exact, toi, strict=True))


@every_finder
@every_kind
@pytest.mark.parametrize("inside", ["distance", "barycentric"])
def test_clear_misses_stay_misses(kind: str, roots: str, inside: str) -> None:
    points_t0, points_t1 = FAMILIES["random"](kind, 300, np.random.default_rng(3))
    for points in (points_t0, points_t1):
        points[:, : 2 if kind == "edge-edge" else 1, 0] += 5.0
    assert np.isinf(univariate_ccd(kind, points_t0, points_t1, roots=roots, inside=inside)).all()
    assert np.isinf(ends_ccd(kind, points_t0, points_t1)).all()


@every_finder
@every_kind
def test_collisions_in_a_common_plane_are_missed(kind: str, roots: str) -> None:
    points = FAMILIES["one_plane"](kind, 200, np.random.default_rng(4))
    assert not coplanarity_cubic(kind, *points).any()
    toi = univariate_ccd(kind, *points, roots=roots)
    exact = exact_tois(kind, *points)
    missed = sum(e.hit and np.isinf(t) for e, t in zip(exact, toi, strict=True))
    assert missed > 0.2 * sum(e.hit for e in exact)


@every_finder
def test_vertex_slides_through_the_face_in_its_plane(roots: str) -> None:
    start = np.array([[[-1.0, 0.25, 0.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    end = start.copy()
    end[0, 0, 0] = 2.0
    assert exact_tois("vertex-face", start, end)[0].approx == pytest.approx(1 / 3)
    assert np.isinf(univariate_ccd("vertex-face", start, end, roots=roots)).all()


@every_finder
def test_face_without_area_is_found_by_distance_and_missed_by_barycentric_coordinates(roots: str) -> None:
    # At t = 1/2 the three corners are on one line, with the vertex between two of them.
    start = np.array([[[0.5, 1.0, 1.0], [0, 0, 0], [1, 0, 0], [2, 1, 0]]])
    end = np.array([[[0.5, -1.0, -1.0], [0, 0, 0], [1, 0, 0], [2, -1, 0]]])
    assert univariate_ccd("vertex-face", start, end, roots=roots)[0] == pytest.approx(0.5)
    assert np.isinf(univariate_ccd("vertex-face", start, end, roots=roots, inside="barycentric")).all()


def test_parallel_edges_meet_side_by_side() -> None:
    start = np.array([[[0, 0, 1.0], [2, 0, 1], [1, 0, 0], [3, 0, 0]]])
    end = np.array([[[0, 0, -1.0], [2, 0, -1], [1, 0, 0], [3, 0, 0]]])
    # They stay in one plane, so that the passage is missed; an edge that ends on the other is found.
    assert np.isinf(univariate_ccd("edge-edge", start, end)).all()
    end[0, :2, 2] = 0.0
    assert univariate_ccd("edge-edge", start, end)[0] == 1.0


def test_ends_are_blind_between_them() -> None:
    assert np.isinf(ends_ccd("vertex-face", *_passing(-1.0))).all()
    assert univariate_ccd("vertex-face", *_passing(-1.0))[0] == pytest.approx(0.5)
    assert ends_ccd("vertex-face", *_passing(0.0))[0] == 1.0
    assert ends_ccd("vertex-face", *_passing(0.0)[::-1])[0] == 0.0


@every_kind
def test_ends_see_the_touching_families(kind: str) -> None:
    rng = np.random.default_rng(5)
    assert (ends_ccd(kind, *FAMILIES["touching_at_start"](kind, 100, rng), tolerance=0.0) <= 1.0).mean() > 0.5
    assert (ends_ccd(kind, *FAMILIES["touching_at_start"](kind, 100, rng)) == 0.0).all()
    assert (ends_ccd(kind, *FAMILIES["contact_exactly_at_end"](kind, 100, rng)) <= 1.0).all()


@pytest.mark.parametrize("tolerance", [0.0, 1e-3, 0.2])
def test_tolerance_is_a_distance_in_sizes_of_the_query(tolerance: float) -> None:
    # The vertex comes down to 0.1 above the face: 0.1 in a box whose longest side is 1.
    found = ends_ccd("vertex-face", *_passing(0.1), tolerance=tolerance)[0]
    assert found == (1.0 if tolerance >= 0.1 else np.inf)
    assert univariate_ccd("vertex-face", *_passing(0.1), tolerance=tolerance)[0] == found


@every_kind
def test_t_max_ends_the_step(kind: str) -> None:
    points = FAMILIES["random_colliding"](kind, 200, np.random.default_rng(6))
    whole = univariate_ccd(kind, *points)
    cut = univariate_ccd(kind, *points, t_max=0.5)
    assert (cut[np.isfinite(cut)] <= 0.5).all()
    np.testing.assert_array_equal(cut[whole <= 0.5], whole[whole <= 0.5])


@every_finder
@every_kind
@pytest.mark.parametrize("exponent", [-1000, -200, 200, 1000])
def test_power_of_two_scale_changes_no_bit(kind: str, roots: str, exponent: int) -> None:
    points = FAMILIES["random_colliding"](kind, 50, np.random.default_rng(7))
    scaled = [np.ldexp(p, exponent) for p in points]
    np.testing.assert_array_equal(
        univariate_ccd(kind, *points, roots=roots), univariate_ccd(kind, *scaled, roots=roots)
    )


@every_finder
@every_kind
@pytest.mark.parametrize("inside", ["distance", "barycentric"])
def test_hostile_input_raises_nothing_and_warns_of_nothing(kind: str, roots: str, inside: str) -> None:
    rng = np.random.default_rng(8)
    points = [family(kind, 20, rng) for family in FAMILIES.values()]
    points += [tuple(np.full((3, 4, 3), x) for x in pair) for pair in ((0.0, 0.0), (1e308, -1e308), (5e-324, 0.0))]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for pair in points:
            for toi in (univariate_ccd(kind, *pair, roots=roots, inside=inside), ends_ccd(kind, *pair)):
                assert toi.shape == (len(pair[0]),) and not np.isnan(toi).any()


def test_no_queries_give_no_answers() -> None:
    none = np.empty((0, 4, 3))
    for roots in ROOTS:
        assert univariate_ccd("edge-edge", none, none, roots=roots).shape == (0,)
    assert ends_ccd("edge-edge", none, none).shape == (0,)


@pytest.mark.parametrize(
    "arguments, options, named",
    [
        (("point-point", np.zeros((1, 2, 3)), np.zeros((1, 2, 3))), {}, "kind is 'point-point'"),
        (("edge-edge", np.zeros((1, 3, 3)), np.zeros((1, 3, 3))), {}, "points have shapes"),
        (("edge-edge", np.zeros((1, 4, 3)), np.zeros((1, 4, 3))), {"roots": "guess"}, "roots is 'guess'"),
        (("edge-edge", np.zeros((1, 4, 3)), np.zeros((1, 4, 3))), {"inside": "guess"}, "inside is 'guess'"),
    ],
)
def test_bad_arguments_are_named(arguments: tuple, options: dict, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        univariate_ccd(*arguments, **options)


@pytest.mark.parametrize("method", [univariate_ccd, ends_ccd])
def test_a_length_scale_is_the_unit_of_the_tolerance(method):
    """A point that ends 0.01 above a face of size 100: within a tolerance of 0.02, and far within that of the size."""
    face = [[-50.0, -50, 0], [50, -50, 0], [0, 50, 0]]
    p0, p1 = (np.array([[[0.0, 0, z], *face]]) for z in (1.0, 0.01))
    assert np.isinf(method("vertex-face", p0, p1, tolerance=0.005, length_scale=1.0))
    assert method("vertex-face", p0, p1, tolerance=0.02, length_scale=1.0) == 1.0
    assert method("vertex-face", p0, p1, tolerance=0.005) == 1.0
    for scale in (2.0**-600, 2.0**600):  # powers of two change nothing
        assert method("vertex-face", scale * p0, scale * p1, tolerance=0.02, length_scale=scale) == 1.0
        assert np.isinf(method("vertex-face", scale * p0, scale * p1, tolerance=0.005, length_scale=scale))
