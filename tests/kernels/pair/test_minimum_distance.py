"""A minimum distance: Euclidean, in the unit of the positions, the same however the scene is turned."""

import math

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from distance_oracle import exact_distance
from distance_queries import KINDS, check, grazing, run
from exact import exact_distance_tois
from hard_cases import FAMILIES
from oracles import brute_force, corners_of
from pair_functions import SOLVE
from scenes import crowd
from thick_scenes import crowd as mixed_crowd

import ccd_warp as ccd
from ccd_warp._runtime import lanes

every_kind = pytest.mark.parametrize("kind, dimension", KINDS, ids=[f"{k}-{d}d" for k, d in KINDS])
PRECISIONS = ("float64", "float32")
KIND_NAMES = ("vertex-face", "edge-edge", "point-segment", "point-point")


def turned(points, rotation):
    return np.einsum("ij,...j->...i", rotation, points)


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


# ---- The guarantee ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_parts", [2, pytest.param(6, marks=pytest.mark.long)])
def test_no_query_is_missed_or_late_and_phantoms_are_within_tolerance(num_parts):
    failures, counts = run(num_random=200 * num_parts, num_hostile=300 * num_parts, seed=5)
    assert failures == []
    assert counts["contacts"] > 200 * num_parts and counts["NO_COLLISION"] > 120 * num_parts


def test_bisection_misses_nothing_either():
    failures, _ = run(num_random=300, num_hostile=600, seed=6, method="bisection", max_iterations=3000)
    assert failures == []


@pytest.mark.parametrize("precision", PRECISIONS)
@every_kind
def test_pairs_that_graze_the_distance(kind, dimension, precision):
    rng = np.random.default_rng(62)
    points = grazing(kind, 12, rng, dimension, 0.25)
    failures, _ = check(kind, *points, 0.25, {"precision": precision, "tolerance": 1e-9, "length_scale": 1.0})
    assert failures == []


# ---- What a length is ------------------------------------------------------------------------------------------------

FACE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
# Where a pair approaches, and in which direction its closest points lie then: inside a face, at a side, at a corner.
APPROACHES = {
    "face": ("vertex-face", np.vstack([[[0.25, 0.25, 1.0]], FACE]), [0.0, 0, 1]),
    "side": ("vertex-face", np.vstack([[[0.5, -0.6, 0.8]], FACE]), [0.0, -0.6, 0.8]),
    "corner": ("vertex-face", np.vstack([[[-0.48, -0.36, 0.8]], FACE]), [-0.48, -0.36, 0.8]),
    "edges": ("edge-edge", np.array([[-1.0, 0, 1], [1, 0, 1], [0, -1, 0], [0, 1, 0]]), [0.0, 0, 1]),
    "end of a segment": ("point-segment", np.array([[-0.6, 0.8, 0], [0, 0, 0], [1, 0, 0]]), [-0.6, 0.8, 0]),
    "point": ("point-point", np.array([[0.48, 0.6, 0.64], [0, 0, 0]]), [0.48, 0.6, 0.64]),
}


@pytest.mark.parametrize("approach", APPROACHES)
def test_straight_approach_ends_at_the_distance_however_the_scene_is_turned(approach):
    kind, points, direction = APPROACHES[approach]
    rng = np.random.default_rng(64)
    first = 2 if kind == "edge-edge" else 1
    for _ in range(40):
        rotation = random_rotation(rng)
        distance = float(rng.uniform(0.05, 0.9))
        end = points.copy()
        end[:first] -= direction
        frames = [turned(x, rotation)[None] for x in (points, end)]
        result = SOLVE[kind](*frames, minimum_distance=distance, device="cpu")
        assert result.hit[0]
        gap = 1.0 - result.toi[0]
        assert gap == pytest.approx(distance, rel=1e-12) and gap >= distance * (1 - 1e-15)


def test_ball_meets_the_corner_of_a_box_where_its_surface_does():
    # the maximum norm has the answer 0, for a box around the centre
    start = np.array([[[1.5, 1.5, 1.5], [0.5, 0.5, 0.5]]])
    end = start - [[[1.0, 1.0, 1.0], [0, 0, 0]]]
    ball = ccd.point_point_ccd(start, end, minimum_distance=1.0, device="cpu")
    box = ccd.point_point_ccd(start, end, minimum_separation=1.0, length_scale=1.0, device="cpu")
    assert ball.toi[0] == pytest.approx(1 - 1 / math.sqrt(3), rel=1e-12)
    assert box.toi[0] == 0.0


@every_kind
def test_distance_lies_between_the_boxes_around_and_inside_the_ball(kind, dimension):
    rng = np.random.default_rng(65)
    points = FAMILIES["random"](kind, 400, rng, dimension=dimension)
    options = {"length_scale": 1.0, "tolerance": 1e-12, "device": "cpu"}
    ball = SOLVE[kind](*points, minimum_distance=0.3, **options).toi
    around = SOLVE[kind](*points, minimum_separation=0.3, **options).toi
    inside = SOLVE[kind](*points, minimum_separation=0.3 / math.sqrt(dimension), **options).toi
    assert (around <= ball).all() and (ball <= inside).all()
    assert (around < ball).any() and (ball < inside).any()


def test_turning_a_scene_changes_toi_by_the_rounding_of_the_turned_positions_alone():
    rng = np.random.default_rng(66)
    for kind in ("vertex-face", "edge-edge"):
        points_t0, points_t1 = FAMILIES["random_colliding"](kind, 60, rng)
        for _ in range(3):
            rotation = random_rotation(rng)
            frames = turned(points_t0, rotation), turned(points_t1, rotation)
            was = SOLVE[kind](points_t0, points_t1, minimum_distance=0.02, device="cpu")
            now = SOLVE[kind](*frames, minimum_distance=0.02, device="cpu")
            exact = exact_distance_tois(kind, *frames, 0.02)
            before = exact_distance_tois(kind, points_t0, points_t1, 0.02)
            for i in range(len(exact)):
                if not (exact[i].hit and before[i].hit) or exact[i].approx == 0 or before[i].approx == 0:
                    continue
                # what the rotation did to the exact time, and what each answer is early by
                by_input = abs(exact[i].approx - before[i].approx)
                early = before[i].early_by(was.toi[i]) + exact[i].early_by(now.toi[i])
                assert abs(now.toi[i] - was.toi[i]) <= by_input + early + 1e-15
                # neither is early by more than rounding, except where the pair only grazes the distance
                assert early < 1e-6


def test_scaling_by_a_power_of_two_with_the_distance_changes_no_bit():
    rng = np.random.default_rng(67)
    points = FAMILIES["random_colliding"]("edge-edge", 100, rng)
    for precision in PRECISIONS:
        was = ccd.edge_edge_ccd(*points, minimum_distance=0.07, precision=precision, device="cpu")
        for exponent in (-300, -20, 20, 300):
            scaled = [np.ldexp(x, exponent) for x in points]
            distance = math.ldexp(0.07, exponent)
            now = ccd.edge_edge_ccd(*scaled, minimum_distance=distance, precision=precision, device="cpu")
            assert np.array_equal(now.toi, was.toi) and np.array_equal(now.parameters, was.parameters)
            assert np.array_equal(now.gap, np.ldexp(was.gap, exponent))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("exponent", [-1070, -1000, 1000, 1020])
def test_lengths_near_the_ends_of_the_range_are_never_late(exponent, precision):
    rng = np.random.default_rng(68)
    for kind, dimension in KINDS:
        points = FAMILIES["random_colliding"](kind, 20, rng, dimension=dimension)
        with np.errstate(under="ignore"):
            points = [np.ldexp(x, exponent) for x in points]
            distance = float(np.ldexp(0.125, exponent))
        exact = exact_distance_tois(kind, *points, distance)
        result = SOLVE[kind](*points, minimum_distance=distance, precision=precision, device="cpu")
        assert not any(e.late(t) for e, t in zip(exact, result.toi.tolist(), strict=True))


@pytest.mark.parametrize("distance", [1e-320, 1e-200, 1e200, 1.7e308])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_distances_beyond_all_scales_are_never_late(precision, distance):
    rng = np.random.default_rng(69)
    for kind, dimension in KINDS:
        points = FAMILIES["random_colliding"](kind, 20, rng, dimension=dimension)
        exact = exact_distance_tois(kind, *points, distance)
        result = SOLVE[kind](*points, minimum_distance=distance, precision=precision, device="cpu")
        assert not any(e.late(t) for e, t in zip(exact, result.toi.tolist(), strict=True))
        assert (result.toi == 0).all() == (distance > 1)


def test_pair_that_starts_within_the_distance_can_move_with_a_start_gap_fraction():
    # a point one unit above the face, within the distance of two: it may come as close as half of its gap
    start = np.vstack([[[0.25, 0.25, 1.0]], FACE])[None]
    end = start - np.array([[0.0, 0, 1.0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    rng = np.random.default_rng(70)
    for _ in range(10):
        frames = [turned(x, random) for random in [random_rotation(rng)] for x in (start, end)]
        options = {"minimum_distance": 2.0, "device": "cpu"}
        assert ccd.vertex_face_ccd(*frames, **options).toi[0] == 0.0
        toi = ccd.vertex_face_ccd(*frames, start_gap_fraction=0.5, **options).toi[0]
        assert toi == pytest.approx(0.5, rel=1e-12) and toi <= 0.5 + 1e-15


@every_kind
def test_start_gap_fraction_is_that_of_the_euclidean_gap(kind, dimension):
    rng = np.random.default_rng(71)
    points = FAMILIES["random_colliding"](kind, 60, rng, dimension=dimension)
    for i in range(60):
        pair = points[0][i : i + 1], points[1][i : i + 1]
        gap = exact_distance(kind, pair[0][0], pair[1][0], 0.0)
        if gap == 0:
            continue
        own = min(0.4, 0.25 * gap)
        (truth,) = exact_distance_tois(kind, *pair, own * (1 - 1e-12))
        options = {"minimum_distance": 0.4, "start_gap_fraction": 0.25, "device": "cpu"}
        toi = SOLVE[kind](*pair, **options).toi[0]
        assert not truth.late(toi) or toi - truth.approx < 1e-9
        if truth.hit:
            assert 0 < toi <= truth.approx * (1 + 1e-9) and truth.approx - toi < 1e-5


def test_reported_gap_and_parameters_are_those_of_the_closest_points():
    rng = np.random.default_rng(72)
    points_t0, points_t1 = FAMILIES["random_colliding"]("vertex-face", 200, rng)
    result = ccd.vertex_face_ccd(points_t0, points_t1, minimum_distance=0.05, device="cpu")
    hit = result.hit & (result.toi > 0)
    x = points_t0 + result.toi[:, None, None] * (points_t1 - points_t0)
    u, v = result.parameters.T[:, :, None]
    apart = np.linalg.norm(x[:, 0] - (x[:, 1] + u * (x[:, 2] - x[:, 1]) + v * (x[:, 3] - x[:, 1])), axis=1)
    assert hit.sum() > 100
    assert np.abs(apart - 0.05)[hit].max() < 1e-9
    assert (apart <= (0.05 + result.gap) * (1 + 1e-14))[hit].all()


# ---- Meshes ----------------------------------------------------------------------------------------------------------


def exact_contacts(mesh, start, end, distance):
    """All pairs that come within a distance, by exact arithmetic: (kind, *pair) to the time."""
    found = {}
    for kind, pairs in zip(ccd.PairKind, brute_force(mesh, 0 * start, 0 * start), strict=True):
        if pairs:
            corners = corners_of(mesh, kind, pairs)
            exact = exact_distance_tois(KIND_NAMES[kind], start[corners], end[corners], distance)
            found |= {(int(kind), *pair): e for pair, e in zip(pairs, exact, strict=True) if e.hit}
    return found


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("distance", [1e-4, 0.01, 0.05])
def test_mesh_finds_every_pair_that_comes_within_the_distance(distance, precision):
    mesh, start, end = mixed_crowd(81, 40, largest=None, spread=1.0)
    options = {"minimum_distance": distance, "precision": precision, "device": "cpu"}
    result = ccd.mesh_ccd(mesh, start, end, **options)
    contacts = result.contacts
    found = {
        (int(kind), *map(int, pair)): toi
        for kind, pair, toi in zip(contacts.kind, contacts.primitives, contacts.toi.tolist(), strict=True)
    }
    exact = exact_contacts(mesh, start, end, distance)
    assert {0, 1} <= {key[0] for key in exact} and exact.keys() <= found.keys()
    assert not any(truth.late(found[key]) for key, truth in exact.items())
    # others only within the tolerance beyond the distance
    reach = distance + 2e-6 * mesh.length_scale + (1e-5 if precision == "float32" else 0)
    assert found.keys() <= exact_contacts(mesh, start, end, reach).keys()
    least = min(exact.values(), key=lambda e: e.approx)
    step = ccd.collision_free_step(mesh, start, end, **options)
    assert step == result.toi and not least.late(step)


def test_every_mesh_call_keeps_the_distance():
    mesh, start, end = mixed_crowd(82, 40, motion=0.03, largest=None, spread=1.0)
    options = {"minimum_distance": 0.01, "device": "cpu"}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    result = pipeline.mesh_ccd(start, end)
    assert len(result.contacts.toi) > 10
    pipeline.reserve(max_pairs=1 << 14, max_contacts=1 << 12)
    launched = pipeline.launch(start, end)
    assert np.array_equal(launched.vertex_toi.numpy(), result.vertex_toi)
    assert not ccd.is_step_collision_free(mesh, start, end, **options)

    # without the pairs that start within the distance, every line search keeps the others at it
    close = list(exact_contacts(mesh, start, start, 0.01 * (1 + 1e-9)))
    excluded = {
        kind.name.lower(): [key[1:] for key in close if key[0] == kind]
        for kind in ccd.PairKind
        if any(key[0] == kind for key in close)
    }
    mesh = mesh.excluding(excluded)
    pipeline = ccd.CollisionPipeline(mesh, **options)
    pipeline.reserve(max_pairs=1 << 14, max_contacts=1 << 12)
    for per in ("scene", "vertex"):
        found = ccd.line_search(mesh, start, end, per=per, **options).vertices
        assert not np.array_equal(found, start) and not exact_contacts(mesh, start, found, 0.01)
        launched = wp.array(end, dtype=wp.vec3d, device="cpu")
        pipeline.launch_line_search(wp.array(start, dtype=wp.vec3d, device="cpu"), launched, per=per)
        assert not np.array_equal(launched.numpy(), start)
        assert not exact_contacts(mesh, start, launched.numpy(), 0.01)


def test_scene_without_a_distance_compiles_nothing_of_it(monkeypatch):
    norms = []

    def seen(name, **parameters):
        norms.append(parameters.get("norm", "maximum"))
        return specialised(name, **parameters)

    monkeypatch.setattr(lanes, "specialised", seen)
    for options in ({}, {"minimum_separation": 1e-3}, {"minimum_distance": 0.0}):
        mesh, start, end = mixed_crowd(83, 40, largest=None, spread=1.0)
        ccd.mesh_ccd(mesh, start, end, device="cpu", **options)
        ccd.collision_free_step(mesh, start, end, device="cpu", **options)
    assert set(norms) <= {"maximum", "own_box"} and "maximum" in norms
    kernels = [specialised("narrow_phase.narrow_phase", norm=norm).solve_pairs for norm in ("maximum", "euclidean")]
    assert "euclidean" not in kernels[0].module.name and "euclidean" in kernels[1].module.name


def test_distance_of_one_call_does_not_hold_in_the_next():
    mesh, start, end = crowd(np.random.default_rng(84))
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    plain = pipeline.mesh_ccd(start, end).vertex_toi
    kept = ccd.mesh_ccd(mesh, start, end, minimum_distance=0.01, device="cpu").vertex_toi
    assert (kept < plain).any()
    assert np.array_equal(ccd.mesh_ccd(mesh, start, end, device="cpu").vertex_toi, plain)


# ---- Arguments -------------------------------------------------------------------------------------------------------


def test_only_one_of_the_two_can_be_given():
    start = np.zeros((1, 2, 3))
    with pytest.raises(ValueError, match=r"minimum_distance is 1.0 and minimum_separation is 0.1; expected one"):
        ccd.point_point_ccd(start, start, minimum_distance=1.0, minimum_separation=0.1)
    ccd.point_point_ccd(start, start, minimum_distance=1.0, minimum_separation=0.0, device="cpu")
