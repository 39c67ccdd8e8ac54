"""The catalogue of hard cases: what each family promises, what the univariate method misses, and ours does not."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from ccd_warp.benchmarks.cubic_roots import ROOTS
from ccd_warp.benchmarks.univariate import univariate_ccd
from exact import exact_tois
from exact_toi import ExactToi
from hard_cases import FAMILIES, POINTS, HardCase
from oracle import exact_gap

import ccd_warp as ccd

SOLVE = {
    "vertex-face": ccd.vertex_face_ccd,
    "edge-edge": ccd.edge_edge_ccd,
    "point-segment": ccd.point_segment_ccd,
    "point-point": ccd.point_point_ccd,
}
KINDS = [(kind, d) for kind, count in POINTS.items() for d in ((3,) if count == 4 else (2, 3))]
kind_and_dimension = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
every_family = pytest.mark.parametrize("family", FAMILIES)
four_points = pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])

# Families in which every time is a root of the cubic for many queries.
IN_PLANE = ("one_plane", "collinear", "parallel_edges", "sliding_in_plane_rotating", "infinite_roots")
# Families with contacts that are ill-conditioned: the tolerance of 1e-6 hides it, one of 1e-9 does not.
ILL_CONDITIONED = ("simultaneous_contacts", "mixed_axis_scales", "slivers", "needle_against_needle")


def _generate(family: str, kind: str, n: int, dimension: int = 3, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return FAMILIES[family](kind, n, np.random.default_rng(seed), dimension)


@cache
def _exact(family: str, kind: str) -> tuple[tuple[np.ndarray, np.ndarray], list[ExactToi]]:
    points = _generate(family, kind, 100, seed=1)
    return points, exact_tois(kind, *points)


# ---- The catalogue ---------------------------------------------------------------------------------------------------


@every_family
def test_says_why_and_what_fails(family: str) -> None:
    case = FAMILIES[family]
    assert isinstance(case, HardCase) and case.name == family
    assert case.why == case.generate.__doc__.strip() and case.why.endswith(".")
    for line in (case.why, case.fails):
        assert line and "\n" not in line
    assert case.minimum_separation >= 0.0 and case.length_scale > 0.0


@kind_and_dimension
@every_family
def test_shape_and_seed(family: str, kind: str, dimension: int) -> None:
    for n in (1, 6):
        first, again, other = (_generate(family, kind, n, dimension, seed) for seed in (0, 0, 1))
        for points, same in zip(first, again, strict=True):
            assert points.shape == (n, POINTS[kind], dimension) and points.dtype == np.float64
            assert points.flags.c_contiguous and np.isfinite(points).all()
            np.testing.assert_array_equal(points, same)
    assert not np.array_equal(np.stack(first), np.stack(other))


# ---- What the families promise ---------------------------------------------------------------------------------------


def _frames(points_t0: np.ndarray, points_t1: np.ndarray, t: Fraction) -> list[list[list[Fraction]]]:
    """Exact positions at t, [query][point][axis]."""

    def between(a: list[float], b: list[float]) -> list[Fraction]:
        return [(1 - t) * Fraction(x) + t * Fraction(y) for x, y in zip(a, b, strict=True)]

    return [
        [between(x, y) for x, y in zip(start, end, strict=True)]
        for start, end in zip(points_t0.tolist(), points_t1.tolist(), strict=True)
    ]


def _edges(kind: str, frame: list[list[Fraction]]) -> tuple[list[Fraction], ...]:
    """P, Q and R of four points."""
    pairs = ((0, 1), (1, 2), (1, 3)) if kind == "vertex-face" else ((0, 2), (1, 0), (2, 3))
    return tuple([a - b for a, b in zip(frame[i], frame[j], strict=True)] for i, j in pairs)


def _cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


@kind_and_dimension
def test_touching_at_start_has_toi_zero(kind: str, dimension: int) -> None:
    exact = exact_tois(kind, *_generate("touching_at_start", kind, 60, dimension))
    assert all(e.compare(0.0) == 0 for e in exact)


@kind_and_dimension
def test_contact_exactly_at_end_is_found_by_the_end(kind: str, dimension: int) -> None:
    exact = exact_tois(kind, *_generate("contact_exactly_at_end", kind, 60, dimension))
    assert all(e.hit for e in exact)
    assert sum(e.compare(1.0) == 0 for e in exact) > 20


@kind_and_dimension
@pytest.mark.parametrize("family", ["simultaneous_contacts", "needle_against_needle"])
def test_lattice_families_touch_in_every_query(family: str, kind: str, dimension: int) -> None:
    assert all(e.hit for e in exact_tois(kind, *_generate(family, kind, 60, dimension)))


@four_points
def test_simultaneous_contacts_are_all_along_a_line(kind: str) -> None:
    points = _generate("simultaneous_contacts", kind, 40)
    along = np.zeros(40, dtype=bool)
    for k in range(1, 8):
        for i, frame in enumerate(_frames(*points, Fraction(k, 8))):
            p, q, r = _edges(kind, frame)
            along[i] |= not any(_cross(q, r) + _cross(p, q) + _cross(p, r))
    assert along.all()


@four_points
def test_infinite_roots_stay_in_one_plane_and_collide(kind: str) -> None:
    points = _generate("infinite_roots", kind, 60)
    for t in map(Fraction, range(4)):  # a cubic with four roots is zero
        for frame in _frames(*points, t):
            p, q, r = _edges(kind, frame)
            assert sum(a * b for a, b in zip(p, _cross(q, r), strict=True)) == 0
    exact = exact_tois(kind, *points)
    assert sum(e.hit and e.lo > 0 for e in exact) > 20
    # Planes that are not parallel to two axes, of which a projection would make an easy problem.
    assert (np.ptp(points[0], axis=1) > 0).all(axis=1).mean() > 0.8


@kind_and_dimension
def test_gap_comes_down_to_the_separation_exactly(kind: str, dimension: int) -> None:
    case = FAMILIES["separation_exactly_the_gap"]
    separation = case.minimum_separation * case.length_scale
    points = _generate(case.name, kind, 60, dimension)
    exact = exact_tois(kind, *points, separation=separation)
    assert all(e.hit for e in exact)
    assert not any(e.hit for e in exact_tois(kind, *points, separation=np.nextafter(separation, 0.0)))
    for start, end, e in zip(*points, exact, strict=True):
        if e.rational:
            assert exact_gap(kind, start, end, e.lo) == separation
    toi = np.array([e.approx for e in exact])
    for part in (toi == 0.0, toi == 1.0, (toi > 0.0) & (toi < 1.0)):
        assert part.any()


@four_points
def test_needles_are_thin(kind: str) -> None:
    points_t0, points_t1 = _generate("needle_against_needle", kind, 60)
    for points in (points_t0, points_t1):
        a, b = (points[:, 2] - points[:, 1], points[:, 3] - points[:, 1])
        if kind == "edge-edge":
            a, b = points[:, 1] - points[:, 0], points[:, 3] - points[:, 2]
        length = np.sqrt(np.maximum((a * a).sum(axis=1), (b * b).sum(axis=1)))
        # Width over length; motion along the needle turns it by little.
        assert np.median(np.linalg.norm(np.cross(a / length[:, None], b / length[:, None]), axis=1)) < 1e-5


@four_points
@pytest.mark.parametrize("family, least", [("huge_motion", 1e5), ("tiny_motion", 0.0), ("fast_and_thin", 50.0)])
def test_motion_is_as_large_as_the_name_says(family: str, least: float, kind: str) -> None:
    points_t0, points_t1 = _generate(family, kind, 60)
    size = np.ptp(points_t0[:, 1:] if kind == "vertex-face" else points_t0[:, 2:], axis=1).max(axis=1)
    motion = np.abs(points_t1 - points_t0).max(axis=(1, 2))
    assert np.median(motion / size) > least
    if family == "tiny_motion":
        assert (motion < 1e-8).all()
    assert 20 < sum(e.hit for e in exact_tois(kind, points_t0, points_t1)) <= 60


# ---- Who misses ------------------------------------------------------------------------------------------------------


def _missed(family: str, kind: str, roots: str, tolerance: float) -> int:
    points, exact = _exact(family, kind)
    toi = univariate_ccd(kind, *points, roots=roots, tolerance=tolerance)
    return sum(e.hit and np.isinf(t) for e, t in zip(exact, toi, strict=True))


@pytest.mark.parametrize("roots", ROOTS)
@pytest.mark.parametrize("family", IN_PLANE)
def test_univariate_cubic_misses_in_a_common_plane(family: str, roots: str) -> None:
    missed = sum(_missed(family, kind, roots, 1e-6) for kind in ("vertex-face", "edge-edge"))
    assert missed >= 10


@four_points
@pytest.mark.parametrize("roots", ROOTS)
def test_univariate_cubic_misses_in_many_families(roots: str, kind: str) -> None:
    at = {tolerance: {f for f in FAMILIES if _missed(f, kind, roots, tolerance)} for tolerance in (1e-6, 1e-9)}
    assert at[1e-6] >= set(IN_PLANE)
    # Newton's method with bracketing comes through the double roots.
    assert at[1e-9] >= set(IN_PLANE + ILL_CONDITIONED) - ({"simultaneous_contacts"} if roots == "newton" else set())


@kind_and_dimension
@pytest.mark.parametrize(
    "family",
    [
        *(name for name, case in FAMILIES.items() if case.minimum_separation),
        *("simultaneous_contacts", "infinite_roots", "needle_against_needle", "mixed_sizes", "huge_motion"),
    ],
)
def test_ours_is_never_late_at_the_separation_of_the_family(
    family: str, kind: str, dimension: int, precision: str
) -> None:
    case = FAMILIES[family]
    points = _generate(family, kind, 100, dimension, seed=2)
    # without a separation the pair's own length, which the tolerance then refers to
    length_scale = case.length_scale if case.minimum_separation else None
    exact = exact_tois(kind, *points, separation=case.minimum_separation * case.length_scale)
    for tolerance in (1e-6, 1e-12):
        result = SOLVE[kind](
            *points,
            tolerance=tolerance,
            minimum_separation=case.minimum_separation,
            length_scale=length_scale,
            precision=precision,
        )
        assert not any(e.late(t) for e, t in zip(exact, result.toi, strict=True))
