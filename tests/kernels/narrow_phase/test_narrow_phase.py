"""Narrow phase against exact rational arithmetic: nothing missed, nothing late, nothing early beyond the tolerance."""

import itertools

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from distance_queries import KINDS as EVERY_KIND
from distance_queries import SOLVE, UNIT_ROUNDOFF, failures, named_vector, size_of
from exact import exact_tois
from hard_cases import FAMILIES
from oracle import exact_gap
from published import all_queries, requires_data

import ccd_warp as ccd

KINDS = ["vertex-face", "edge-edge"]
POINT_KINDS = EVERY_KIND[2:]
LIMIT = ccd.CCDStatus.ITERATION_LIMIT
every_kind = pytest.mark.parametrize("kind", KINDS)


def drawn(kind, names, n, seed, dimension=3):
    """Pairs of several families as one set."""
    points = [FAMILIES[name](kind, n, np.random.default_rng(seed), dimension) for name in names]
    return tuple(np.concatenate(parts) for parts in zip(*points, strict=True))


# --- against the oracle ---


@requires_data
@pytest.mark.parametrize("queries", all_queries() if not requires_data.args[0] else [], ids=lambda q: q.name)
def test_published_queries(queries, precision):
    found, result, _ = failures(queries.kind, queries.points_t0, queries.points_t1, precision=precision)
    assert not [failure for failure in found if failure[1] in ("missed", "late")]
    assert not (queries.truth & ~result.hit).any() and (result.status < LIMIT).all()


@every_kind
@pytest.mark.parametrize("family", FAMILIES)
def test_family(family, kind, precision):
    found, result, _ = failures(kind, *drawn(kind, [family], 110, 20), precision=precision)
    assert not found
    # no family may need the limits to come to its end, and a certain miss says so, in value and status alike
    assert (result.status < LIMIT).all()
    assert ((result.status == ccd.CCDStatus.NO_COLLISION) == np.isinf(result.toi)).all()


TOLERANCES, TIMES = (1e-1, 1e-3, 1e-9, 1e-12, 1e-300), (0.0, 1e-9, 0.1, 0.5, 1 - 2.0**-53)
CLOSE = ("random", "lattice", "one_plane", "parallel_edges", "slivers", "touching_at_start")
UNIT = {"length_scale": 1.0}
# Families, how many of each, a seed, and options.
SETS = {
    "tolerance": [(("lattice", "random_colliding", "slivers"), 60, 21, {"tolerance": x}) for x in TOLERANCES],
    "separation": [(CLOSE, 24, 22, UNIT | {"minimum_separation": x}) for x in (2.0**-40, 1e-3, 0.25)],
    "t_max": [(("random_colliding", "lattice", "contact_exactly_at_end"), 100, 24, {"t_max": x}) for x in TIMES],
    "gap": [
        (("random_colliding", "slivers"), 60, 33, UNIT | {"checks_gap": True}),
        (("random",), 60, 33, UNIT | {"checks_gap": True, "minimum_separation": 0.05}),
    ],
}


def check_set(name, kind, precision):
    for names, n, seed, options in SETS[name]:
        found, result, _ = failures(kind, *drawn(kind, names, n, seed), precision=precision, **options)
        assert not found, options
        assert (result.toi[result.hit] <= options.get("t_max", 1.0)).all()
        assert name != "gap" or (result.width[result.status == ccd.CCDStatus.COLLISION] == 0).all()


@every_kind
def test_tolerance(kind, precision):
    check_set("tolerance", kind, precision)


@every_kind
@pytest.mark.parametrize("name", ["separation", "t_max", "gap"])
def test_options(name, kind, precision):
    check_set(name, kind, precision)


@pytest.mark.parametrize(("kind", "dimension"), POINT_KINDS)
@pytest.mark.parametrize("separation", [0.0, 1e-3, 0.3])
def test_points_and_segments(separation, kind, dimension, precision):
    options = {"minimum_separation": separation, "length_scale": 1.0, "precision": precision}
    found, result, _ = failures(kind, *drawn(kind, FAMILIES, 30, 34, dimension), **options)
    assert not found
    # rounding at the size of some families hides gaps of the unit in which the tolerance is
    is_hidden = (result.status == ccd.CCDStatus.ROUNDING_LIMIT) & (result.toi == 0.0)
    assert ((result.status < LIMIT) | is_hidden).all()


@every_kind
def test_a_larger_separation_is_reached_no_later(kind, precision):
    p0, p1 = drawn(kind, ["random"], 200, 23)
    # a toi is reported to within tolerance and rounding in gap; steps of the separation are larger than that
    separations = (0.0, 1e-6, 1e-4, 1e-2, 0.1, 1.0) if precision == "float64" else (0.0, 1e-4, 1e-2, 0.1, 1.0)
    tois = [SOLVE[kind](p0, p1, minimum_separation=d, precision=precision).toi for d in separations]
    assert all((larger <= smaller).all() for smaller, larger in itertools.pairwise(tois))
    assert (tois[-1] == 0).all()  # a separation of the whole size of the pair: always too close


@every_kind
def test_start_gap_fraction_against_the_oracle(kind, precision):
    fraction, separation = 0.5, 0.2
    p0, p1 = drawn(kind, ["random_colliding"], 60, 31)
    options = {"minimum_separation": separation, "start_gap_fraction": fraction, "length_scale": 1.0}
    result = SOLVE[kind](p0, p1, precision=precision, **options)
    for i, toi in enumerate(result.toi.tolist()):
        reduced = min(separation, fraction * exact_gap(kind, p0[i], p1[i], 0.0))
        # the kernel's start gap is a lower bound: its separation is smaller by rounding, never larger
        slack = 100 * UNIT_ROUNDOFF[precision] * (1 + size_of(p0, p1)[i])
        (exact,) = exact_tois(kind, p0[i : i + 1], p1[i : i + 1], max(reduced - slack, 0.0))
        assert not (exact.hit and exact.late(toi))
        if reduced > 1e-4:
            assert toi > 0 and exact_gap(kind, p0[i], p1[i], min(toi, 1.0)) >= reduced - slack


@every_kind
def test_iteration_limit_is_conservative_and_monotone(kind, precision):
    points = drawn(kind, ("one_plane", "slivers", "random_colliding"), 40, 25)
    before, capped = np.zeros(len(points[0])), 0
    for limit in (1, 2, 3, 4, 6, 10, 20, 50, 10_000):
        found, result, _ = failures(kind, *points, max_iterations=limit, precision=precision)
        assert not found and (result.toi >= before).all() and (result.iterations <= limit).all()
        at_limit = result.status == LIMIT
        capped += at_limit.sum()
        assert not at_limit.any() or limit > 1 or (result.width[at_limit] == 1.0 - result.toi[at_limit]).all()
        before = result.toi
    assert capped > 0 and not at_limit.any()


@every_kind
@pytest.mark.parametrize(
    "family", ["random", "lattice", "random_colliding", "parallel_edges", "contact_exactly_at_end"]
)
def test_bisection_is_conservative_and_agrees(family, kind, precision):
    points, options = drawn(kind, [family], 60, 32), {"method": "bisection", "tolerance": 1e-2}
    found, result, _ = failures(kind, *points, precision=precision, **options)
    capped, clipped = result.status == LIMIT, SOLVE[kind](*points, precision=precision)
    assert not [failure for failure in found if failure[1] in ("missed", "late")] and capped.mean() < 0.2
    assert not (clipped.hit & ~result.hit & ~capped).any()
    # the box is within the tolerance in time, too: what is reported is a lower bound of the sharper answer
    both = clipped.hit & result.hit
    assert (result.toi[both] <= clipped.toi[both] + 1e-5).all()


# --- parameters ---


def sampled_gaps(kind, points_t0, points_t1, result, u, v):
    """Distances between the points of (u, v) [m, n] on each of n pairs at toi, [m, n]."""
    at = [ccd.PairResult(**vars(result) | {"parameters": np.stack([a, b], axis=1)}) for a, b in zip(u, v, strict=True)]
    return np.array([np.linalg.norm(named_vector(kind, points_t0, points_t1, each), axis=1) for each in at])


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.05, 20.0)])
@pytest.mark.parametrize("kind", [*KINDS, "point-segment"])
def test_parameters_within_a_separation_are_of_the_closest_point(kind, axes, precision):
    """Many start within the separation, where any point would do for the toi."""
    rng = np.random.default_rng(2)
    start = rng.uniform(-1, 1, (400, 3 if kind == "point-segment" else 4, 3)) * axes
    end = start + rng.uniform(-0.5, 0.5, start.shape) * axes
    options = {"minimum_separation": 0.3, "length_scale": 1.0, "precision": precision}
    hit = SOLVE[kind](start, end, **options).hit
    start, end = start[hit], end[hit]
    result = SOLVE[kind](start, end, **options)
    u, v = rng.random((2, 5_000, len(start)))
    if kind == "vertex-face":
        u, v = (np.where(u + v > 1, 1 - x, x) for x in (u, v))
    ours = np.linalg.norm(named_vector(kind, start, end, result), axis=1)
    slack = (1e-12 if precision == "float64" else 1e-4) * np.abs([start, end]).max(axis=(0, 2, 3))
    assert len(start) > 20 and (ours <= sampled_gaps(kind, start, end, result, u, v).min(axis=0) + slack).all()


@every_kind
@pytest.mark.parametrize("options", [{}, {"method": "bisection", "tolerance": 1e-2}])
def test_parameters_name_the_point_of_contact(kind, options):
    p0, p1 = drawn(kind, ["random_colliding"], 200, 29)
    hit = SOLVE[kind](p0, p1, **options).hit
    p0, p1 = p0[hit], p1[hit]
    result = SOLVE[kind](p0, p1, **options)
    vectors = named_vector(kind, p0, p1, result)
    assert hit.sum() > 100
    if not options:  # the tolerance, and 1e-12 for the arithmetic of this check
        assert (np.abs(vectors).max(axis=1) <= 1e-6 * size_of(p0, p1) + 1e-12).all()
        return
    u, v = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 33)] * 2)).reshape(2, -1, 1) + np.zeros((2, 1, len(p0)))
    is_inside = (kind == "edge-edge") | (u + v <= 1.0)[:, 0]
    sampled = sampled_gaps(kind, p0, p1, result, u[is_inside], v[is_inside])
    assert (np.linalg.norm(vectors, axis=1) <= sampled.min(axis=0) * (1 + 1e-12)).all()


def test_needle_that_touches_names_its_point(precision):
    # stationary slivers, 1e-6 of their length wide: the gap is measured at a point that is in contact, in float64 and
    # float32, though a closest point computed from the needle's normal is not
    rng = np.random.default_rng(35)
    along, across = rng.normal(size=(2, 500, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    face = np.stack([-along, along + 1e-7 * across, 0.3 * along + 1e-7 * across], axis=1)
    weights = rng.dirichlet([1, 1, 1], size=500)
    points = np.concatenate([np.einsum("nk,nkd->nd", weights, face)[:, None], face], axis=1)
    result = ccd.vertex_face_ccd(points, points, precision=precision)
    assert (result.status == ccd.CCDStatus.INITIAL_CONTACT).all()
    assert (result.gap <= (1e-6 + 100 * UNIT_ROUNDOFF[precision]) * 2 * size_of(points, points)).all()
    assert ((result.parameters >= -1e-3) & (result.parameters <= 1 + 1e-3)).all()


# --- invariances ---

_SYMMETRIES = {
    "face_rotated": ("vertex-face", lambda p: p[:, [0, 2, 3, 1]]),
    "face_reversed": ("vertex-face", lambda p: p[:, [0, 1, 3, 2]]),
    "vertex_face_mirrored": ("vertex-face", lambda p: p * [-1.0, 1.0, 1.0]),
    "edges_swapped": ("edge-edge", lambda p: p[:, [2, 3, 0, 1]]),
    "edge_reversed": ("edge-edge", lambda p: p[:, [1, 0, 2, 3]]),
    "edge_edge_mirrored": ("edge-edge", lambda p: p * [-1.0, 1.0, 1.0]),
    "axes_permuted": ("edge-edge", lambda p: p[:, :, [2, 0, 1]]),
}


@pytest.mark.parametrize("symmetry", _SYMMETRIES)
def test_symmetry(symmetry, precision):
    kind, transform = _SYMMETRIES[symmetry]
    sets = [drawn(kind, ("random", "cloth_like", "lattice"), 100, 26)]
    sets.append([np.ascontiguousarray(transform(x)) for x in sets[0]])
    # a hit of one is a hit of the other, or a place where the gap is within the tolerance
    (found, a, _), (others, b, _) = (failures(kind, *points, precision=precision) for points in sets)
    both = a.hit & b.hit
    assert not found + others and both.sum() > 50
    # each toi is early by at most what its gap takes to close; these families close it at a speed above 1e-3
    assert np.abs(a.toi[both] - b.toi[both]).max() <= (1e-6 + 100 * UNIT_ROUNDOFF[precision]) / 1e-3


@every_kind
def test_power_of_two_scale_changes_no_bit(kind, precision):
    points = drawn(kind, ("random_colliding", "lattice", "one_plane", "slivers"), 60, 27)
    expected = SOLVE[kind](*points, precision=precision)
    for exponent in (-900, -200, -1, 1, 10, 200, 900):
        result = SOLVE[kind](*(np.ldexp(x, exponent) for x in points), precision=precision)
        assert result.toi.tobytes() == expected.toi.tobytes()
        assert result.parameters.tobytes() == expected.parameters.tobytes()


# --- single geometries ---


def falling_vertex(height=1.0, end=-1.0):
    """A vertex that falls through the middle of a stationary face."""
    p0 = np.array([[[0.25, 0.25, height], [0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)
    return p0, np.concatenate([[[[0.25, 0.25, end]]], p0[:, 1:]], axis=1)


BIG, IN_ONE_PLACE = np.finfo(float).max, np.full((1, 4, 3), 7.5)
FALL, RESTING = falling_vertex(), falling_vertex(0.0)[0]
# an edge along x that falls through a stationary edge along y, at a quarter and a half of their lengths
EDGES = np.array([[[-0.25, 0, 1], [0.75, 0, 1], [0, -0.5, 0], [0, 0.5, 0]]])
CLOSE_START, HALF = {"minimum_separation": 0.1, "length_scale": 1.0}, {"start_gap_fraction": 0.5}
# near overflow: the points are 1.05e308 apart after three quarters of the step, give or take the tolerance
APART = [np.array([[[0, 0, 0], [x, 0, 0]]]) for x in (1.5e308, 0.9e308)]
CROSSED = (EDGES, EDGES - [[[0, 0, 2.0]] * 2 + [[0, 0, 0]] * 2])
# Kind, points at both ends, options; the toi or its range, and parameters.
VALUES = [
    ("vertex-face", FALL, {}, (0.5 - 1e-5, 0.5), (0.25, 0.25)),
    ("edge-edge", CROSSED, {}, (0.5 - 1e-5, 0.5), (0.25, 0.5)),
    ("vertex-face", [FALL[0]] * 2, {}, np.inf, None),
    ("vertex-face", [RESTING] * 2, {}, 0, None),
    ("vertex-face", [IN_ONE_PLACE] * 2, {}, 0, None),
    ("edge-edge", [IN_ONE_PLACE] * 2, {}, 0, None),
    *(("vertex-face", [x * s for x in FALL], {}, (0.5 - 1e-5, 0.5), None) for s in (1e-300, 1e-60, 1e60, 1e300)),
    ("vertex-face", [np.round(x * 100) * 5e-324 for x in FALL], {}, (0.49, 0.5), None),
    ("vertex-face", falling_vertex(BIG, -BIG), {}, (0.5 - 1e-5, 0.5), None),
    # an axis near overflow beside two near underflow, the vertex beside the face
    ("vertex-face", [falling_vertex(BIG)[0] * [[[1.0] * 3] + [[1e-300, 1e-300, 1]] * 3]] * 2, {}, np.inf, None),
    # half of the gap of 0.01 at a speed of 1.01, early by no more than the tolerance
    ("vertex-face", falling_vertex(0.01), CLOSE_START, 0, None),
    ("vertex-face", falling_vertex(0.01), CLOSE_START | HALF, (0.005 / 1.01 - 1e-5, 0.005 / 1.01), None),
    ("vertex-face", falling_vertex(0.0), HALF, 0, None),
    ("point-point", APART, {"minimum_separation": 0.7}, (0.75 - 1e-5, 0.75 + 1e-15), None),
    ("point-point", APART, {"minimum_separation": 1.0, "length_scale": 1.05e308}, (0.75 - 1e-5, 0.75 + 1e-15), None),
    ("point-point", [x / 2.0**500 for x in APART], {"minimum_separation": 0.7}, (0.75 - 1e-5, 0.75 + 1e-5), None),
]


@pytest.mark.parametrize(("kind", "points", "options", "toi", "parameters"), VALUES)
def test_promised_values(kind, points, options, toi, parameters, precision):
    result = SOLVE[kind](*points, precision=precision, **options)
    least, most = toi if isinstance(toi, tuple) else (toi, toi)
    assert least <= result.toi[0] <= most
    status = {0: ccd.CCDStatus.INITIAL_CONTACT, np.inf: ccd.CCDStatus.NO_COLLISION}.get(toi, ccd.CCDStatus.COLLISION)
    assert result.status[0] == status or kind == "point-point"
    assert parameters is None or result.parameters[0] == pytest.approx(parameters, abs=1e-5)


def test_bullet_of_the_literature():
    p0, p1 = (np.array([[[x, 3.5], [5.0, 1.0], [5.0, 6.0]]]) for x in (0.5, 9.5))
    result = ccd.point_segment_ccd(p0, p1)
    assert 0.5 - 1e-12 <= result.toi[0] <= 0.5
    np.testing.assert_allclose(result.parameters[0], [0.5, 0.0], atol=1e-12)
    bisected = ccd.point_segment_ccd(p0, p1, method="bisection", tolerance=1e-4, length_scale=1.0)
    assert 0.5 - 1e-4 <= bisected.toi[0] <= 0.5 and bisected.iterations[0] > 10 * result.iterations[0]
    flat = wp.array(p0, dtype=wp.vec2d), wp.array(p1, dtype=wp.vec2d)
    assert ccd.point_segment_ccd(*flat).toi.numpy()[0] == result.toi[0]


def test_side_along_an_axis_that_nearly_vanishes():
    # one axis of 2^30 beside axes of 2^-443 and 2^-163, thin beside the separation: the sides are almost along y, so
    # their facets stand as well as the axis does, for an instant
    a, b, c = 2.0**-443, 2.0**29, 2.0**-163
    p0 = [[[0, 3 * b, 2 * c], [0, 3 * b, 3 * c], [1.5 * a, b, 0], [a, 0, c]]]
    nearly = float.fromhex("0x1.ffffffffffffcp+29"), float.fromhex("0x1.8000000000002p-162")
    p1 = [[[a / 2, b, c], [1.5 * a, 2 * b, c], [0, nearly[0], 0], [0, 0, nearly[1]]]]
    result = ccd.edge_edge_ccd(p0, p1, minimum_separation=0.0820116453693335, length_scale=1.0)
    assert result.status[0] == ccd.CCDStatus.COLLISION and result.iterations[0] < 10
    assert 2 / 3 - 1e-9 <= result.toi[0] <= 2 / 3


def test_vertex_leaves_a_face_whose_squares_underflow_in_float32():
    p0 = np.array([[[0, 2.0**-83, 0], [-(2.0**-92), 0, 2], [2.0**-92, 0, 2], [0, 0, -2]]])
    p1 = np.where([False, True, False], 2.0**-84, p0)
    found, result, _ = failures("vertex-face", p0, p1, tolerance=3.5e-8, precision="float32")
    assert not found and np.isfinite(result.parameters).all() and np.isfinite(result.gap).all()


# --- interface ---


def test_no_pairs_lists_and_float32_arrays_are_taken():
    result = ccd.vertex_face_ccd(*np.zeros((2, 0, 4, 3)))
    assert result.toi.shape == result.hit.shape == result.status.shape == (0,) and result.parameters.shape == (0, 2)
    a = ccd.vertex_face_ccd(*(x.tolist() for x in FALL))
    assert a.toi[0] == ccd.vertex_face_ccd(*(x.astype(np.float32) for x in FALL)).toi[0] and a.toi.dtype == np.float64


def test_warp_arrays_stay_on_their_device():
    points = drawn("vertex-face", ["random"], 50, 30)
    expected = ccd.vertex_face_ccd(*points)
    for dtype in (wp.vec3d, wp.float64):
        given = [wp.array(p, dtype=dtype) for p in points]
        result = ccd.vertex_face_ccd(*given)
        assert isinstance(result.toi, wp.array) and result.toi.device == given[0].device
        assert result.toi.numpy().tobytes() == expected.toi.tobytes()
        assert (result.hit.numpy() == expected.hit).all()


def test_non_finite_warp_array_is_marked_and_conservative():
    p0, p1 = (np.repeat(p, 3, axis=0) for p in FALL)
    p0[1, 2, 1], p1[2, 0, 0] = np.nan, np.inf
    result = ccd.vertex_face_ccd(*(wp.array(p, dtype=wp.vec3d) for p in (p0, p1)))
    invalid = ccd.CCDStatus.INVALID
    assert result.status.numpy().tolist() == [ccd.CCDStatus.COLLISION, invalid, invalid]
    assert result.toi.numpy()[1:].tolist() == [0, 0]


def test_one_kernel_of_the_cpu_solves_the_pairs_of_all_calls():
    """So the solver is compiled once for each precision, number of lanes and norm."""
    kernels = [each for each in vars(specialised("narrow_phase.narrow_phase")).values() if isinstance(each, wp.Kernel)]
    assert [kernel.func.__name__ for kernel in kernels] == ["solve_pairs"]
