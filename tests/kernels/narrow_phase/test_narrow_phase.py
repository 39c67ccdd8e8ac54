"""Narrow phase against exact rational arithmetic: nothing missed, nothing late, nothing early beyond the tolerance."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from distance_oracle import exact_distance
from distance_queries import KINDS as EVERY_KIND
from distance_queries import SOLVE, failures, named_vector, size_of
from exact import exact_distance_tois
from hard_cases import FAMILIES
from published import all_queries, requires_data

import ccd_warp as ccd

KINDS = ["vertex-face", "edge-edge"]
LIMIT = ccd.CCDStatus.ITERATION_LIMIT
every_kind = pytest.mark.parametrize("kind, dimension", EVERY_KIND, ids=[f"{k}-{d}d" for k, d in EVERY_KIND])
of_four_points = pytest.mark.parametrize("kind", KINDS)


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
def test_family(family, kind, dimension, precision):
    """In the tolerance of the pairs' own size, and at the separation of the family, which its length scale is for."""
    case, points = FAMILIES[family], drawn(kind, [family], 110, 20, dimension)
    sharp, separation = {"tolerance": 1e-12}, case.minimum_separation
    of_case = {"minimum_separation": separation, "length_scale": case.length_scale}
    for options in ({}, sharp, of_case, of_case | sharp)[: 4 if separation else 2]:
        found, result, _ = failures(kind, *points, precision=precision, **options)
        assert not found, options
        # no family may need the limits to come to its end, and a certain miss says so, in value and status alike
        assert options or (result.status < LIMIT).all()
        assert ((result.status == ccd.CCDStatus.NO_COLLISION) == np.isinf(result.toi)).all()


TOLERANCES, TIMES = (1e-1, 1e-3, 1e-9, 1e-12, 1e-300), (0.0, 1e-9, 0.1, 0.5, 1 - 2.0**-53)
OF_BISECTION = ("random", "lattice", "random_colliding", "parallel_edges", "contact_exactly_at_end")
UNIT, BISECTION = {"length_scale": 1.0}, {"method": "bisection"}
# Families, how many of each, a seed, and options.
SETS = {
    "tolerance": [(("lattice", "random_colliding", "slivers"), 60, 21, {"tolerance": x}) for x in TOLERANCES],
    "separation": [(FAMILIES, 24, 22, UNIT | {"minimum_separation": x}) for x in (0.0, 2.0**-40, 1e-3, 0.3)],
    "t_max": [(("random_colliding", "lattice", "contact_exactly_at_end"), 100, 24, {"t_max": x}) for x in TIMES],
    "gap": [
        (("random_colliding", "slivers"), 60, 33, UNIT | {"checks_gap": True}),
        (("random",), 60, 33, UNIT | {"checks_gap": True, "minimum_separation": 0.05}),
    ],
}


@every_kind
@pytest.mark.parametrize("name", SETS)
def test_options(name, kind, dimension, precision):
    for names, n, seed, options in SETS[name]:
        found, result, _ = failures(kind, *drawn(kind, names, n, seed, dimension), precision=precision, **options)
        assert not found, options
        assert (result.toi[result.hit] <= options.get("t_max", 1.0)).all()
        assert name != "gap" or (result.width[result.status == ccd.CCDStatus.COLLISION] == 0).all()


@of_four_points
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


@of_four_points
@pytest.mark.parametrize("family", OF_BISECTION)
def test_bisection_is_conservative_and_agrees(family, kind, precision):
    points, options = drawn(kind, [family], 60, 32), BISECTION | {"tolerance": 1e-2}
    found, result, _ = failures(kind, *points, precision=precision, **options)
    capped, clipped = result.status == LIMIT, SOLVE[kind](*points, precision=precision)
    assert not [failure for failure in found if failure[1] in ("missed", "late")] and capped.mean() < 0.2
    assert not (clipped.hit & ~result.hit & ~capped).any()
    # the box is within the tolerance in time, too: what is reported is a lower bound of the sharper answer
    both = clipped.hit & result.hit
    assert (result.toi[both] <= clipped.toi[both] + 1e-5).all()


# --- at a distance ---


def grazing(kind, n, rng, dimension, distance):
    """Random queries scaled so that the least distance of the step is the given one, up to rounding."""
    points_t0, points_t1 = FAMILIES["random"](kind, n, rng, dimension=dimension)
    for start, end in zip(points_t0, points_t1, strict=True):
        least = exact_distance(kind, start, end, 0.0)
        low, high = 0.0, 1.0
        for _ in range(8):
            times = np.linspace(low, high, 9)
            at = [exact_distance(kind, start, end, t) for t in times.tolist()]
            k = int(np.argmin(at))
            least = min(least, at[k])
            low, high = times[max(k - 1, 0)], times[min(k + 1, 8)]
        if least > 0.0:
            start *= distance / least
            end *= distance / least
    return points_t0, points_t1


@every_kind
def test_pairs_that_graze_the_distance(kind, dimension, precision):
    points = grazing(kind, 12, np.random.default_rng(62), dimension, 0.25)
    options = {"precision": precision, "tolerance": 1e-9, "length_scale": 1.0, "minimum_distance": 0.25}
    assert not failures(kind, *points, checks_gap=True, **options)[0]


@every_kind
def test_lengths_and_distances_near_the_ends_of_the_range_are_never_late(kind, dimension, precision):
    points = FAMILIES["random_colliding"](kind, 20, np.random.default_rng(68), dimension=dimension)
    lengths = [(exponent, float(np.ldexp(0.125, exponent))) for exponent in (-1070, -1000, 1000, 1020)]
    for exponent, distance in [*lengths, *((0, x) for x in (1e-320, 1e-200, 1e200, 1.7e308))]:
        scaled = [np.ldexp(x, exponent) for x in points]
        exact = exact_distance_tois(kind, *scaled, distance)
        tois = SOLVE[kind](*scaled, minimum_distance=distance, precision=precision).toi
        assert not any(truth.late(toi) for truth, toi in zip(exact, tois.tolist(), strict=True))
        assert exponent or (tois == 0).all() == (distance > 1)


# --- parameters ---


def own_hits(kind, points, least, **options):
    """Those of the pairs that touch, what the parameters name at their toi, and the exact distances there."""
    hit = SOLVE[kind](*points, **options).hit
    assert hit.sum() > least
    points = [x[hit] for x in points]
    result = SOLVE[kind](*points, **options)
    gaps = [exact_distance(kind, *pair) for pair in zip(*points, result.toi, strict=True)]
    return points, result.parameters, named_vector(kind, *points, result), np.array(gaps)


@of_four_points
@pytest.mark.parametrize("options", [{}, BISECTION | {"tolerance": 1e-2}])
def test_parameters_name_the_point_of_contact(kind, options):
    points, _, vectors, gaps = own_hits(kind, drawn(kind, ["random_colliding"], 200, 29), 100, **options)
    if not options:  # the tolerance, and 1e-12 for the arithmetic of this check
        assert (np.abs(vectors).max(axis=1) <= 1e-6 * size_of(*points) + 1e-12).all()
    else:
        assert (np.linalg.norm(vectors, axis=1) <= gaps * (1 + 1e-12)).all()


def test_vertex_that_stops_over_a_needle_is_nearest_to_where_it_is():
    needle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1e-5, 0.0]]
    ends = [np.array([[0.7, 0.35e-5, height], *needle]) for height in (1.0, -1.0)]
    turns = np.linalg.qr(np.random.default_rng(30).standard_normal((100, 3, 3)))[0]
    points = [np.einsum("nij,kj->nki", turns, end) for end in ends]
    result = ccd.vertex_face_ccd(*points, minimum_distance=1e-6)
    assert np.allclose(result.toi, 0.5) and np.allclose(result.parameters, 0.35, rtol=0, atol=1e-9)


# --- scale and lanes ---


@of_four_points
@pytest.mark.parametrize("distance", [0.0, 0.07])
def test_power_of_two_scale_changes_no_bit(distance, kind, precision):
    points = drawn(kind, ("random_colliding", "lattice", "one_plane", "slivers"), 60, 27)
    expected = SOLVE[kind](*points, precision=precision, minimum_distance=distance)
    for exponent in (-900, -200, -1, 1, 10, 200, 900):
        scaled = [np.ldexp(x, exponent) for x in points]
        result = SOLVE[kind](*scaled, precision=precision, minimum_distance=np.ldexp(distance, exponent))
        assert all(getattr(result, x).tobytes() == getattr(expected, x).tobytes() for x in ("toi", "parameters"))


def test_one_kernel_solves_the_pairs_of_all_calls_and_is_compiled_anew_when_an_operator_changes(monkeypatch):
    """Warp does not look for operators in a function, so the names of the modules tell."""
    from ccd_warp.kernels.pair import simd
    from ccd_warp.kernels.search import search_types

    solver, search = specialised("narrow_phase.narrow_phase"), specialised("search.search_trees", end=search_types.CULL)
    before, source = simd.fingerprint(), simd.inspect.getsource
    assert [x for x in vars(solver).values() if isinstance(x, wp.Kernel)] == [solver.solve_pairs]
    assert before in solver.solve_pairs.module.name and before in search.search_trees.module.name
    monkeypatch.setattr(simd.inspect, "getsource", lambda module: source(module).replace("lanes(a) +", "lanes(a) -"))
    assert simd.fingerprint() != before


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
BULLET = [np.array([[[x, 3.5], [5.0, 1.0], [5.0, 6.0]]]) for x in (0.5, 9.5)]
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
    # the bullet of the literature, also with a box within the tolerance in time
    ("point-segment", BULLET, {}, (0.5 - 1e-5, 0.5), (0.5, 0.0)),
    ("point-segment", BULLET, BISECTION | {"tolerance": 1e-4, "length_scale": 1.0}, (0.5 - 1e-4, 0.5), None),
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


def test_side_along_an_axis_that_nearly_vanishes():
    """One axis of 2^30 beside thin ones: the facets of sides along it stand as well as it does, for an instant."""
    a, b, c, near = 2.0**-443, 2.0**29, 2.0**-163, 2.0**30 - 2.0**-21
    p0 = [[[0, 3 * b, 2 * c], [0, 3 * b, 3 * c], [1.5 * a, b, 0], [a, 0, c]]]
    p1 = [[[a / 2, b, c], [1.5 * a, 2 * b, c], [0, near, 0], [0, 0, float.fromhex("0x1.8000000000002p-162")]]]
    result = ccd.edge_edge_ccd(p0, p1, minimum_separation=0.0820116453693335, length_scale=1.0)
    assert result.status[0] == ccd.CCDStatus.COLLISION and result.iterations[0] < 10
    assert 2 / 3 - 1e-9 <= result.toi[0] <= 2 / 3


def test_vertex_leaves_a_face_whose_squares_underflow_in_float32():
    p0 = np.array([[[0, 2.0**-83, 0], [-(2.0**-92), 0, 2], [2.0**-92, 0, 2], [0, 0, -2]]])
    p1 = np.where([False, True, False], 2.0**-84, p0)
    found, result, _ = failures("vertex-face", p0, p1, tolerance=3.5e-8, precision="float32")
    assert not found and np.isfinite(result.parameters).all() and np.isfinite(result.gap).all()


@pytest.mark.parametrize("length_scale", [1e10, 1e12, 1e300])
def test_a_tolerance_far_larger_than_the_pair_leaves_the_parameters_finite(length_scale, precision):
    options = {"precision": precision, "tolerance": 0.01, "length_scale": length_scale}
    result = ccd.vertex_face_ccd(*falling_vertex(0.5, -0.5), **options)
    assert result.hit.all() and np.isfinite([result.gap[0], *result.parameters[0]]).all()
    assert (result.parameters >= 0).all() and result.parameters.sum() <= 1


# Everything moves on one line, up to rounding: the four points where the step starts, then where it ends.
ON_A_LINE = """
-0.6388516524392863 0.08148762364207655 0.2996502385100188 -5.2522414168966804 0.6699406177846453 2.463538108729795
6.281232994246804 -0.8011918675717764 -2.9461815668196465 13.380664300267673 -1.7067476120954232 -6.276135045116664
11.999530110510184 -1.5305794174392684 -5.628320818407084 10.521515742135986 -1.3420538371616775 -4.935065419322945
6.281232994246804 -0.8011918675717764 -2.9461815668196465 -6.633375606654168 0.8461088124407997 3.111352335439374
"""


@pytest.mark.parametrize("limit", [3, 4, 12, 10_000])
def test_the_parameters_of_a_contact_in_one_plane_are_those_of_the_point_that_touches(limit):
    points = np.array(ON_A_LINE.split(), dtype=float).reshape(2, 1, 4, 3)
    result = ccd.vertex_face_ccd(*points, precision="float32", t_max=0.5, max_iterations=limit)
    assert np.abs(named_vector("vertex-face", *points, result)).max() <= result.gap[0] + 1e-12


# --- interface ---


def test_non_finite_warp_array_is_marked_and_conservative():
    points, invalid = [np.repeat(p, 3, axis=0) for p in FALL], ccd.CCDStatus.INVALID
    points[0][1, 2, 1], points[1][2, 0, 0] = np.nan, np.inf
    result = ccd.vertex_face_ccd(*(wp.array(p, dtype=wp.vec3d) for p in points))
    assert result.status.numpy().tolist() == [ccd.CCDStatus.COLLISION, invalid, invalid]
    assert result.toi.numpy()[1:].tolist() == [0, 0]


def test_arrays_of_few_pairs_are_such_as_warp_makes():
    """They are made without its constructor."""
    result = ccd.vertex_face_ccd(*(wp.array(np.repeat(p, 3, axis=0), dtype=wp.vec3d) for p in FALL))
    for array in vars(result).values():
        made = wp.array(ptr=array.ptr, dtype=array.dtype, shape=(3,), device="cpu", copy=False)
        assert vars(array) == vars(made) | {"_ref": array._ref} and wp.clone(array).numpy().tolist() == array.list()
        assert array._ref.ctypes.data == array.ptr and array[1:].numpy().tolist() == array.list()[1:]


@every_kind
@pytest.mark.parametrize("method", ["clipping", "bisection"])
@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_coordinate_that_is_not_finite_is_named_among_few_and_many_pairs(
    kind, dimension, precision, method, num_threads
):
    """The host looks at the coordinates of few pairs, of many only where the solver has found one."""
    options = {"precision": precision, "method": method, "num_threads": num_threads}
    drawn_once, bad = drawn(kind, ["random"], 10, 25, dimension), (np.nan, np.inf, -np.inf)
    for count in (1, 2061, 8197):  # checked before, and solved in one part and in several
        ends = [np.resize(x, (count, *x.shape[1:])) for x in drawn_once]
        for scale in (1.0, 1.7e308 / max(np.abs(x).max() for x in ends), 5e-324):  # finite all
            assert (SOLVE[kind](*(x * scale for x in ends), **options).status != ccd.CCDStatus.INVALID).all()
        places = [(end, (row, *place)) for end in (0, 1) for place in np.ndindex(ends[0].shape[1:]) for row in (0, -1)]
        for k, (end, place) in enumerate(places):
            points = [x.copy() for x in ends]
            points[end][place] = bad[k % 3]
            message = f"points_t{end} holds {bad[k % 3]} in pair {place[0] % count}; expected finite values"
            with pytest.raises(ValueError, match=message):
                SOLVE[kind](*points, **options)
        points[end][-1] = np.inf  # whose differences are NaN
        with pytest.raises(ValueError, match=f"points_t{end} holds .* in pair {place[0] % count}"):
            SOLVE[kind](*points, **options)
