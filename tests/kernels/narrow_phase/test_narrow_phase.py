"""Narrow phase against exact rational arithmetic: nothing missed, nothing late, nothing early beyond the tolerance."""

import itertools

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from exact import exact_tois
from hard_cases import FAMILIES
from oracle import exact_gap
from published import all_queries, requires_data

import ccd_warp as ccd

SOLVE = {"vertex-face": ccd.vertex_face_ccd, "edge-edge": ccd.edge_edge_ccd}
KINDS = list(SOLVE)

# Gap that rounding alone may leave, as a multiple of the pair's size. The kernel accepts at 8 E plus the tolerance and
# two E, with E = 8.25 u per unit of size after normalisation (kernels/pair/rounding.py): below 100 u in all.
ROUNDING = {"float64": 100 * 2.0**-53, "float32": 100 * 2.0**-24}


def size_of(points_t0, points_t1):
    """Longest side of the box around each query's motion: its default length scale."""
    both = np.concatenate([points_t0, points_t1], axis=1)
    return (both.max(axis=1) - both.min(axis=1)).max(axis=1)


def assert_never_missed_never_late(exact, result):
    missed = [i for i, e in enumerate(exact) if e.hit and not result.hit[i]]
    late = [i for i, e in enumerate(exact) if e.hit and e.late(float(result.toi[i]))]
    assert not missed
    assert not late


def assert_gap_within_tolerance(kind, points_t0, points_t1, result, tolerance, precision, separation=0.0):
    """Every finite toi is a place where the exact gap is below separation + tolerance + rounding."""
    scale = size_of(points_t0, points_t1)
    for i in np.flatnonzero(result.hit):
        bound = (separation + tolerance + ROUNDING[precision]) * scale[i]
        gap = exact_gap(kind, points_t0[i], points_t1[i], float(result.toi[i]))
        assert gap <= bound, (i, gap, bound)


# --- against the oracle ---


@requires_data
@pytest.mark.parametrize("queries", all_queries() if not requires_data.args[0] else [], ids=lambda q: q.name)
def test_published_queries(queries, precision):
    result = SOLVE[queries.kind](queries.points_t0, queries.points_t1, precision=precision)
    assert not (queries.truth & ~result.hit).any()
    exact = exact_tois(queries.kind, queries.points_t0, queries.points_t1)
    assert_never_missed_never_late(exact, result)
    assert (result.status < ccd.CCDStatus.ITERATION_LIMIT).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("family", FAMILIES)
def test_family(family, kind, precision):
    p0, p1 = FAMILIES[family](kind, 110, np.random.default_rng(20))
    exact = exact_tois(kind, p0, p1)
    result = SOLVE[kind](p0, p1, precision=precision)
    assert_never_missed_never_late(exact, result)
    assert_gap_within_tolerance(kind, p0, p1, result, 1e-6, precision)
    # no family may need the limits to come to its end
    assert (result.status < ccd.CCDStatus.ITERATION_LIMIT).all()
    # a certain miss says so, in value and status alike
    assert ((result.status == ccd.CCDStatus.NO_COLLISION) == np.isinf(result.toi)).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-9, 1e-12, 1e-300])
def test_tolerance(tolerance, kind, precision):
    for family in ("lattice", "random_colliding", "slivers"):
        p0, p1 = FAMILIES[family](kind, 60, np.random.default_rng(21))
        result = SOLVE[kind](p0, p1, tolerance=tolerance, precision=precision)
        assert_never_missed_never_late(exact_tois(kind, p0, p1), result)
        assert_gap_within_tolerance(kind, p0, p1, result, tolerance, precision)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("family", ["random", "lattice", "one_plane", "parallel_edges", "slivers", "touching_at_start"])
@pytest.mark.parametrize("separation", [2.0**-40, 1e-3, 0.25])
def test_minimum_separation(separation, family, kind, precision):
    p0, p1 = FAMILIES[family](kind, 24, np.random.default_rng(22))
    result = SOLVE[kind](p0, p1, minimum_separation=separation, length_scale=1.0, precision=precision)
    assert_never_missed_never_late(exact_tois(kind, p0, p1, separation), result)
    for i in np.flatnonzero(result.hit):
        gap = exact_gap(kind, p0[i], p1[i], float(result.toi[i]))
        assert gap <= separation + 1e-6 + ROUNDING[precision] * (size_of(p0, p1)[i] + separation)


@pytest.mark.parametrize("kind", KINDS)
def test_minimum_separation_is_monotone(kind, precision):
    p0, p1 = FAMILIES["random"](kind, 200, np.random.default_rng(23))
    # a toi is reported to within tolerance and rounding in gap; steps of the separation are larger than that
    separations = (0.0, 1e-6, 1e-4, 1e-2, 0.1, 1.0) if precision == "float64" else (0.0, 1e-4, 1e-2, 0.1, 1.0)
    tois = [SOLVE[kind](p0, p1, minimum_separation=d, precision=precision).toi for d in separations]
    for smaller, larger in itertools.pairwise(tois):
        assert (larger <= smaller).all()
    assert (tois[-1] == 0).all()  # a separation of the whole size of the pair: always too close


def test_start_gap_fraction_gives_a_positive_step_from_a_close_start(precision):
    p0, p1 = falling_vertex(height=0.01)
    options = {"minimum_separation": 0.1, "length_scale": 1.0, "precision": precision}
    stuck = ccd.vertex_face_ccd(p0, p1, **options)
    assert stuck.toi[0] == 0
    assert stuck.status[0] == ccd.CCDStatus.INITIAL_CONTACT
    result = ccd.vertex_face_ccd(p0, p1, start_gap_fraction=0.5, **options)
    # half of the gap of 0.01 at a speed of 1.01, early by no more than the tolerance
    assert 0.005 / 1.01 - 1e-5 <= result.toi[0] <= 0.005 / 1.01
    touching = ccd.vertex_face_ccd(*falling_vertex(height=0.0), start_gap_fraction=0.5, **options)
    assert touching.toi[0] == 0
    assert touching.status[0] == ccd.CCDStatus.INITIAL_CONTACT


@pytest.mark.parametrize("kind", KINDS)
def test_start_gap_fraction_against_the_oracle(kind, precision):
    fraction, separation = 0.5, 0.2
    p0, p1 = FAMILIES["random_colliding"](kind, 60, np.random.default_rng(31))
    result = SOLVE[kind](
        p0, p1, minimum_separation=separation, start_gap_fraction=fraction, length_scale=1.0, precision=precision
    )
    for i in range(len(p0)):
        reduced = min(separation, fraction * exact_gap(kind, p0[i], p1[i], 0.0))
        # the kernel's start gap is a lower bound: its separation is smaller by rounding, never larger
        slack = ROUNDING[precision] * (1 + size_of(p0, p1)[i])
        (exact,) = exact_tois(kind, p0[i : i + 1], p1[i : i + 1], max(reduced - slack, 0.0))
        assert not (exact.hit and exact.late(float(result.toi[i])))
        if reduced > 1e-4:
            assert result.toi[i] > 0
            gap = exact_gap(kind, p0[i], p1[i], min(float(result.toi[i]), 1.0))
            assert gap >= reduced - slack


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("t_max", [0.0, 1e-9, 0.1, 0.5, 1 - 2.0**-53])
def test_t_max(t_max, kind, precision):
    for family in ("random_colliding", "lattice", "contact_exactly_at_end"):
        p0, p1 = FAMILIES[family](kind, 100, np.random.default_rng(24))
        result = SOLVE[kind](p0, p1, t_max=t_max, precision=precision)
        assert_never_missed_never_late(exact_tois(kind, p0, p1, t_max=t_max), result)
        assert (result.toi[result.hit] <= t_max).all()


@pytest.mark.parametrize("kind", KINDS)
def test_iteration_limit_is_conservative_and_monotone(kind, precision):
    points = [
        FAMILIES[name](kind, 40, np.random.default_rng(25)) for name in ("one_plane", "slivers", "random_colliding")
    ]
    p0, p1 = (np.concatenate(parts) for parts in zip(*points, strict=True))
    exact = exact_tois(kind, p0, p1)
    before = np.zeros(len(p0))
    capped = 0
    for limit in (1, 2, 3, 4, 6, 10, 20, 50, 10_000):
        result = SOLVE[kind](p0, p1, max_iterations=limit, precision=precision)
        assert_never_missed_never_late(exact, result)
        assert (result.toi >= before).all()
        assert (result.iterations <= limit).all()
        capped += (result.status == ccd.CCDStatus.ITERATION_LIMIT).sum()
        before = result.toi
    assert capped > 0
    assert not (result.status == ccd.CCDStatus.ITERATION_LIMIT).any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "family", ["random", "lattice", "random_colliding", "parallel_edges", "contact_exactly_at_end"]
)
def test_bisection_is_conservative_and_agrees(family, kind, precision):
    p0, p1 = FAMILIES[family](kind, 60, np.random.default_rng(32))
    exact = exact_tois(kind, p0, p1)
    result = SOLVE[kind](p0, p1, method="bisection", tolerance=1e-2, precision=precision)
    assert_never_missed_never_late(exact, result)
    capped = result.status == ccd.CCDStatus.ITERATION_LIMIT
    assert capped.mean() < 0.2
    clipped = SOLVE[kind](p0, p1, precision=precision)
    assert not (clipped.hit & ~result.hit & ~capped).any()
    # the box is within the tolerance in time, too: what is reported is a lower bound of the sharper answer
    both = clipped.hit & result.hit
    assert (result.toi[both] <= clipped.toi[both] + 1e-5).all()


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_of_the_bisection_are_those_of_the_closest_points(kind):
    p0, p1 = FAMILIES["random_colliding"](kind, 60, np.random.default_rng(5))
    result = SOLVE[kind](p0, p1, method="bisection", tolerance=1e-2)
    t = result.toi[:, None, None]
    x, (u, v) = (1 - t) * p0 + t * p1, result.parameters.T[:, :, None]

    def gap(u, v):
        if kind == "vertex-face":
            return np.linalg.norm(x[:, 0] - x[:, 1] - u * (x[:, 2] - x[:, 1]) - v * (x[:, 3] - x[:, 1]), axis=1)
        return np.linalg.norm(x[:, 0] + u * (x[:, 1] - x[:, 0]) - x[:, 2] - v * (x[:, 3] - x[:, 2]), axis=1)

    least = gap(u, v)[result.hit]
    assert len(least) > 30
    for a, b in itertools.product(np.linspace(0.0, 1.0, 33), repeat=2):
        if kind == "edge-edge" or a + b <= 1.0:
            assert (least <= gap(a, b)[result.hit] * (1 + 1e-12)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_gap_bounds_the_exact_gap(kind, precision):
    for family, options in (("random_colliding", {}), ("slivers", {}), ("random", {"minimum_separation": 0.05})):
        p0, p1 = FAMILIES[family](kind, 60, np.random.default_rng(33))
        result = SOLVE[kind](p0, p1, length_scale=1.0, precision=precision, **options)
        for i in np.flatnonzero(result.hit):
            gap = exact_gap(kind, p0[i], p1[i], float(result.toi[i]))
            assert gap <= options.get("minimum_separation", 0.0) * (1 + 1e-6) + result.gap[i]
        assert (result.width[result.status == ccd.CCDStatus.COLLISION] == 0).all()
        capped = SOLVE[kind](p0, p1, length_scale=1.0, precision=precision, max_iterations=1, **options)
        at_limit = capped.status == ccd.CCDStatus.ITERATION_LIMIT
        assert at_limit.any()
        np.testing.assert_array_equal(capped.width[at_limit], 1.0 - capped.toi[at_limit])


# --- points and segments ---

POINT_KINDS = {"point-segment": ccd.point_segment_ccd, "point-point": ccd.point_point_ccd}


@pytest.mark.parametrize("kind", POINT_KINDS)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("separation", [0.0, 1e-3, 0.3])
def test_points_and_segments(separation, dimension, kind, precision):
    for family, generate in FAMILIES.items():
        p0, p1 = generate(kind, 30, np.random.default_rng(34), dimension)
        exact = exact_tois(kind, p0, p1, separation)
        result = POINT_KINDS[kind](p0, p1, minimum_separation=separation, length_scale=1.0, precision=precision)
        assert_never_missed_never_late(exact, result)
        # rounding at the size of some families hides gaps of the unit in which the tolerance is
        is_hidden = (result.status == ccd.CCDStatus.ROUNDING_LIMIT) & (result.toi == 0.0)
        assert ((result.status < ccd.CCDStatus.ITERATION_LIMIT) | is_hidden).all(), family
        for i in np.flatnonzero(result.hit):
            size = size_of(p0, p1)[i]
            gap = exact_gap(kind, p0[i], p1[i], float(result.toi[i]))
            assert gap <= separation + 1e-6 + ROUNDING[precision] * (size + separation), family


def test_bullet_of_the_literature():
    p0 = np.array([[[0.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])
    p1 = np.array([[[9.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])
    result = ccd.point_segment_ccd(p0, p1)
    assert 0.5 - 1e-12 <= result.toi[0] <= 0.5
    np.testing.assert_allclose(result.parameters[0], [0.5, 0.0], atol=1e-12)
    bisected = ccd.point_segment_ccd(p0, p1, method="bisection", tolerance=1e-4, length_scale=1.0)
    assert 0.5 - 1e-4 <= bisected.toi[0] <= 0.5
    assert bisected.iterations[0] > 10 * result.iterations[0]
    flat = wp.array(p0, dtype=wp.vec2d, device="cpu"), wp.array(p1, dtype=wp.vec2d, device="cpu")
    assert ccd.point_segment_ccd(*flat).toi.numpy()[0] == result.toi[0]


# --- invariances ---

_MIRROR = np.array([-1.0, 1.0, 1.0])
_SYMMETRIES = {
    "face_rotated": ("vertex-face", lambda p: p[:, [0, 2, 3, 1]]),
    "face_reversed": ("vertex-face", lambda p: p[:, [0, 1, 3, 2]]),
    "vertex_face_mirrored": ("vertex-face", lambda p: p * _MIRROR),
    "edges_swapped": ("edge-edge", lambda p: p[:, [2, 3, 0, 1]]),
    "edge_reversed": ("edge-edge", lambda p: p[:, [1, 0, 2, 3]]),
    "edge_edge_mirrored": ("edge-edge", lambda p: p * _MIRROR),
    "axes_permuted": ("edge-edge", lambda p: p[:, :, [2, 0, 1]]),
}


@pytest.mark.parametrize("symmetry", _SYMMETRIES)
def test_symmetry(symmetry, precision):
    kind, transform = _SYMMETRIES[symmetry]
    points = [FAMILIES[name](kind, 100, np.random.default_rng(26)) for name in ("random", "cloth_like", "lattice")]
    p0, p1 = (np.concatenate(parts) for parts in zip(*points, strict=True))
    a = SOLVE[kind](p0, p1, precision=precision)
    b = SOLVE[kind](np.ascontiguousarray(transform(p0)), np.ascontiguousarray(transform(p1)), precision=precision)
    for one, other in ((a, b), (b, a)):
        # a hit of one is a hit of the other, or a place where the gap is within the tolerance
        for i in np.flatnonzero(one.hit & ~other.hit):
            gap = exact_gap(kind, p0[i], p1[i], float(one.toi[i]))
            assert gap <= (1e-6 + ROUNDING[precision]) * size_of(p0, p1)[i]
    both = a.hit & b.hit
    assert both.sum() > 50
    # each toi is early by at most what its gap takes to close; these families close it at a speed above 1e-3
    assert np.abs(a.toi[both] - b.toi[both]).max() <= (1e-6 + ROUNDING[precision]) / 1e-3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("exponent", [-900, -200, -1, 1, 10, 200, 900])
def test_power_of_two_scale_changes_no_bit(exponent, kind, precision):
    for family in ("random_colliding", "lattice", "one_plane", "slivers"):
        p0, p1 = FAMILIES[family](kind, 60, np.random.default_rng(27))
        a = SOLVE[kind](p0, p1, precision=precision)
        b = SOLVE[kind](np.ldexp(p0, exponent), np.ldexp(p1, exponent), precision=precision)
        assert a.toi.tobytes() == b.toi.tobytes()
        assert a.parameters.tobytes() == b.parameters.tobytes()


# --- single geometries ---


def falling_vertex(height=1.0, end=-1.0):
    """A vertex that falls through the middle of a stationary face."""
    p0 = np.array([[[0.25, 0.25, height], [0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)
    p1 = p0.copy()
    p1[0, 0, 2] = end
    return p0, p1


def crossing_edges():
    """An edge along x that falls through a stationary edge along y, at a quarter and a half of their lengths."""
    p0 = np.array([[[-0.25, 0, 1], [0.75, 0, 1], [0, -0.5, 0], [0, 0.5, 0]]], dtype=float)
    p1 = p0.copy()
    p1[0, :2, 2] = -1
    return p0, p1


def test_vertex_falls_through_face(precision):
    result = ccd.vertex_face_ccd(*falling_vertex(), precision=precision)
    assert result.status[0] == ccd.CCDStatus.COLLISION
    assert 0.5 - 1e-5 <= result.toi[0] <= 0.5
    np.testing.assert_allclose(result.parameters[0], [0.25, 0.25], atol=1e-5)


def test_edges_cross(precision):
    result = ccd.edge_edge_ccd(*crossing_edges(), precision=precision)
    assert 0.5 - 1e-5 <= result.toi[0] <= 0.5
    np.testing.assert_allclose(result.parameters[0], [0.25, 0.5], atol=1e-5)


def gaps_at(kind, points, u, v):
    """Vectors between the two points of (u, v) of each pair; u and v have shape [n] or [n, m]."""
    p = points[:, :, None, :] if u.ndim == 2 else points
    u, v = u[..., None], v[..., None]
    if kind == "vertex-face":
        return p[:, 0] - (1 - u - v) * p[:, 1] - u * p[:, 2] - v * p[:, 3]
    if kind == "edge-edge":
        return (1 - u) * p[:, 0] + u * p[:, 1] - (1 - v) * p[:, 2] - v * p[:, 3]
    return p[:, 0] - (1 - u) * p[:, 1] - u * p[:, 2]


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.05, 20.0)])
@pytest.mark.parametrize("kind", [*KINDS, "point-segment"])
def test_parameters_within_a_separation_are_of_the_closest_point(kind, axes, precision):
    """Many start within the separation, where any point would do for the toi."""
    rng = np.random.default_rng(2)
    n = 400
    count = 3 if kind == "point-segment" else 4
    start = rng.uniform(-1, 1, (n, count, 3)) * axes
    end = start + rng.uniform(-0.5, 0.5, start.shape) * axes
    result = {**SOLVE, "point-segment": ccd.point_segment_ccd}[kind](
        start, end, minimum_separation=0.3, length_scale=1.0, precision=precision
    )
    u, v = result.parameters[result.hit].T
    t = result.toi[result.hit, None, None]
    at = (1 - t) * start[result.hit] + t * end[result.hit]
    ours = np.linalg.norm(gaps_at(kind, at, u, v), axis=1)
    sampled_u, sampled_v = rng.random((2, len(u), 5_000))
    if kind == "vertex-face":
        outside = sampled_u + sampled_v > 1
        sampled_u, sampled_v = (np.where(outside, 1 - x, x) for x in (sampled_u, sampled_v))
    sampled = np.linalg.norm(gaps_at(kind, at, sampled_u, sampled_v), axis=-1)
    sampled = sampled.reshape(len(u), -1).min(axis=1)
    size = np.abs(at).max(axis=(1, 2))
    assert (ours <= sampled + (1e-12 if precision == "float64" else 1e-4) * size).all()
    assert len(u) > 20


def test_parameters_name_the_point_of_contact():
    # (u, v) of 200 random collisions: the points that they name are within the tolerance at toi, in float64
    for kind in KINDS:
        p0, p1 = FAMILIES["random_colliding"](kind, 200, np.random.default_rng(29))
        result = SOLVE[kind](p0, p1)
        hit = result.hit
        t = result.toi[hit, None, None]
        x = (1 - t) * p0[hit] + t * p1[hit]
        u, v = result.parameters[hit].T[..., None]
        if kind == "vertex-face":
            gap = x[:, 0] - ((1 - u - v) * x[:, 1] + u * x[:, 2] + v * x[:, 3])
        else:
            gap = (1 - u) * x[:, 0] + u * x[:, 1] - ((1 - v) * x[:, 2] + v * x[:, 3])
        assert hit.sum() > 100
        # the tolerance, and 1e-12 for the arithmetic of this check
        assert (np.abs(gap).max(axis=1) <= 1e-6 * size_of(p0, p1)[hit] + 1e-12).all()


def test_stationary_pair_is_free_and_touching_pair_is_at_zero(precision):
    p0, _ = falling_vertex()
    apart = ccd.vertex_face_ccd(p0, p0, precision=precision)
    assert np.isinf(apart.toi[0])
    assert apart.status[0] == ccd.CCDStatus.NO_COLLISION
    q0, _ = falling_vertex(height=0.0)
    touching = ccd.vertex_face_ccd(q0, q0, precision=precision)
    assert touching.toi[0] == 0
    assert touching.status[0] == ccd.CCDStatus.INITIAL_CONTACT


def test_all_points_in_one_place(precision):
    p = np.full((1, 4, 3), 7.5)
    assert ccd.vertex_face_ccd(p, p, precision=precision).toi[0] == 0
    assert ccd.edge_edge_ccd(p, p, precision=precision).toi[0] == 0


@pytest.mark.parametrize("scale", [1e-300, 1e-60, 1e60, 1e300])
def test_extreme_coordinates(scale, precision):
    p0, p1 = falling_vertex()
    result = ccd.vertex_face_ccd(p0 * scale, p1 * scale, precision=precision)
    assert 0.5 - 1e-5 <= result.toi[0] <= 0.5


def test_differences_that_overflow(precision):
    big = np.finfo(float).max
    p0, p1 = falling_vertex(height=big, end=-big)
    result = ccd.vertex_face_ccd(p0, p1, precision=precision)
    assert 0.5 - 1e-5 <= result.toi[0] <= 0.5
    p0[0, 1:, :2] *= 1e-300  # an axis near overflow beside two near underflow, the vertex beside the face
    assert np.isinf(ccd.vertex_face_ccd(p0, p0, precision=precision).toi[0])


@pytest.mark.parametrize(
    "options", [{"minimum_separation": 0.7}, {"minimum_separation": 1.0, "length_scale": 1.05e308}]
)
def test_separation_near_overflow(options, precision):
    p0 = np.array([[[0, 0, 0], [1.5e308, 0, 0]]], dtype=float)
    p1 = np.array([[[0, 0, 0], [0.9e308, 0, 0]]], dtype=float)
    result = ccd.point_point_ccd(p0, p1, precision=precision, **options)
    # the points are 1.05e308 apart after three quarters of the step, give or take the tolerance
    assert 0.75 - 1e-5 <= result.toi[0] <= 0.75 + 1e-15
    small = ccd.point_point_ccd(p0 / 2.0**500, p1 / 2.0**500, precision=precision, minimum_separation=0.7)
    assert small.toi[0] == pytest.approx(result.toi[0], abs=1e-5)


def test_needle_that_touches_names_its_point(precision):
    # stationary slivers, 1e-6 of their length wide: the gap is measured at a point that is in contact, in float64 and
    # float32, though a closest point computed from the needle's normal is not
    rng = np.random.default_rng(35)
    n = 500
    along, across = rng.normal(size=(2, n, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    face = np.stack([-along, along + 1e-7 * across, 0.3 * along + 1e-7 * across], axis=1)
    weights = rng.dirichlet([1, 1, 1], size=n)
    points = np.concatenate([np.einsum("nk,nkd->nd", weights, face)[:, None], face], axis=1)
    result = ccd.vertex_face_ccd(points, points, precision=precision)
    assert (result.status == ccd.CCDStatus.INITIAL_CONTACT).all()
    assert (result.gap <= (1e-6 + ROUNDING[precision]) * 2 * size_of(points, points)).all()
    assert ((result.parameters >= -1e-3) & (result.parameters <= 1 + 1e-3)).all()


def test_subnormal_coordinates(precision):
    p0, p1 = falling_vertex()
    result = ccd.vertex_face_ccd(np.round(p0 * 100) * 5e-324, np.round(p1 * 100) * 5e-324, precision=precision)
    assert 0.49 <= result.toi[0] <= 0.5


def test_side_along_an_axis_that_nearly_vanishes():
    # one axis of 2^30 beside axes of 2^-443 and 2^-163, thin beside the separation: the sides are almost along y, so
    # their facets stand as well as the axis does, for an instant
    e = float.fromhex
    p0 = [
        [
            [0, 3 * 2.0**29, 2.0**-162],
            [0, 3 * 2.0**29, 3 * 2.0**-163],
            [3 * 2.0**-444, 2.0**29, 0],
            [2.0**-443, 0, 2.0**-163],
        ]
    ]
    p1 = [
        [
            [2.0**-444, 2.0**29, 2.0**-163],
            [3 * 2.0**-444, 2.0**30, 2.0**-163],
            [0, e("0x1.ffffffffffffcp+29"), 0],
            [0, 0, e("0x1.8000000000002p-162")],
        ]
    ]
    result = ccd.edge_edge_ccd(p0, p1, minimum_separation=0.0820116453693335, length_scale=1.0)
    assert result.status[0] == ccd.CCDStatus.COLLISION
    assert 2 / 3 - 1e-9 <= result.toi[0] <= 2 / 3
    assert result.iterations[0] < 10


def test_vertex_leaves_a_face_whose_squares_underflow_in_float32():
    small = 2.0**-83
    p0 = np.array([[[0, small, 0], [-(2.0**-92), 0, 2], [2.0**-92, 0, 2], [0, 0, -2]]])
    p1 = p0.copy()
    p1[0, :, 1] = small / 2
    result = ccd.vertex_face_ccd(p0, p1, tolerance=3.5e-8, precision="float32")
    assert np.isfinite(result.parameters).all()
    assert np.isfinite(result.gap).all()
    assert not exact_tois("vertex-face", p0, p1)[0].late(float(result.toi[0]))


def test_no_pairs():
    empty = np.zeros((0, 4, 3))
    result = ccd.vertex_face_ccd(empty, empty)
    assert result.toi.shape == result.hit.shape == result.status.shape == (0,)
    assert result.parameters.shape == (0, 2)


# --- interface ---


def test_lists_and_float32_arrays_are_taken(device):
    p0, p1 = falling_vertex()
    a = ccd.vertex_face_ccd(p0.tolist(), p1.tolist(), device=device)
    b = ccd.vertex_face_ccd(p0.astype(np.float32), p1.astype(np.float32), device=device)
    assert a.toi[0] == b.toi[0]
    assert a.toi.dtype == np.float64


def test_warp_arrays_stay_on_their_device(device):
    p0, p1 = FAMILIES["random"]("vertex-face", 50, np.random.default_rng(30))
    expected = ccd.vertex_face_ccd(p0, p1, device=device)
    x0, x1 = (wp.array(p, dtype=wp.vec3d, device=device) for p in (p0, p1))
    result = ccd.vertex_face_ccd(x0, x1)
    assert isinstance(result.toi, wp.array)
    assert result.toi.device == x0.device
    assert result.toi.numpy().tobytes() == expected.toi.tobytes()
    assert (result.hit.numpy() == expected.hit).all()
    y0, y1 = (wp.array(p, dtype=wp.float64, device=device) for p in (p0, p1))
    assert ccd.vertex_face_ccd(y0, y1).toi.numpy().tobytes() == expected.toi.tobytes()


def test_non_finite_warp_array_is_marked_and_conservative(device):
    p0, p1 = (np.repeat(p, 3, axis=0) for p in falling_vertex())
    p0[1, 2, 1] = np.nan
    p1[2, 0, 0] = np.inf
    result = ccd.vertex_face_ccd(*(wp.array(p, dtype=wp.vec3d, device=device) for p in (p0, p1)))
    invalid = ccd.CCDStatus.INVALID
    assert result.status.numpy().tolist() == [ccd.CCDStatus.COLLISION, invalid, invalid]
    assert result.toi.numpy()[1:].tolist() == [0, 0]


GOOD = np.zeros((2, 4, 3))


def test_bad_warp_input():
    good = wp.zeros((2, 4), dtype=wp.vec3d, device="cpu")
    with pytest.raises(ValueError, match="points_t0 has dtype vec3f and shape"):
        ccd.vertex_face_ccd(wp.zeros((2, 4), dtype=wp.vec3f, device="cpu"), good)
    with pytest.raises(ValueError, match="points_t1 is a ndarray; expected a array like points_t0"):
        ccd.vertex_face_ccd(good, GOOD)
    with pytest.raises(ValueError, match=r"points_t1 has shape \(3, 4\); expected \(2, 4\)"):
        ccd.vertex_face_ccd(good, wp.zeros((3, 4), dtype=wp.vec3d, device="cpu"))


def test_one_kernel_of_the_cpu_solves_the_pairs_of_all_calls():
    """So the solver is compiled once for each precision, number of lanes and norm."""
    kernels = [each for each in vars(specialised("narrow_phase.narrow_phase")).values() if isinstance(each, wp.Kernel)]
    assert [kernel.func.__name__ for kernel in kernels] == ["solve_pairs"]
