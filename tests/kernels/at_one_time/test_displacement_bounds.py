"""How far vertices may move: bounds from exact distances, and moves within them that never touch."""

import itertools

import numpy as np
import pytest
import scenes
from exact_proximity import SCENES, exact_bounds, few
from launches import on_device
from scenes import FACE, TRIANGLE

import ccd_warp as ccd

CAPACITIES = {"max_pairs": 20_000, "max_contacts": 20_000}


# --- against all pairs ---


@pytest.mark.parametrize("scene", SCENES)
def test_bounds_are_those_of_exact_distances_rounded_down(scene, device):
    mesh = SCENES[scene]()
    kept = 0.005 if scene == "every kind" else 0.0
    found = ccd.displacement_bounds(mesh, mesh.vertices, 0.06, minimum_distance=kept, device=device)
    expected, size = exact_bounds(mesh, mesh.vertices, 0.06, kept)
    assert (found <= expected).all() and (found >= expected - 2e-15 * size).all()
    assert (found[mesh.static[mesh.vertex_body]] == 0).all()
    assert len({*found.tolist()}) > 5


def test_radii_and_the_minimum_distance_are_kept():
    radius = np.random.default_rng(5).uniform(0, 0.01, 54)
    mesh = few(radius=radius)
    found = ccd.displacement_bounds(mesh, mesh.vertices, 0.06, minimum_distance=0.002)
    expected, size = exact_bounds(mesh, mesh.vertices, 0.06, 0.002)
    assert (found <= expected).all() and (found >= expected - 2e-15 * size).all()


def test_two_bodies_share_the_gap_and_a_static_one_leaves_all_of_it():
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 0.5], FACE)]
    both = ccd.CollisionMesh.from_arrays(bodies)
    below = 0.25 * (1 - 1e-14)
    assert ((below < (bounds := ccd.displacement_bounds(both, both.vertices, 9.0))) & (bounds <= 0.25)).all()
    assert (ccd.displacement_bounds(both, both.vertices, 0.3) == 0.15).all()
    beside_static = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False)
    bounds = ccd.displacement_bounds(beside_static, both.vertices, 9.0)
    assert ((2 * below < bounds[:3]) & (bounds[:3] <= 0.5)).all() and (bounds[3:] == 0).all()
    # nothing else moves, so the whole search radius is free
    assert ccd.displacement_bounds(beside_static, both.vertices, 0.3).tolist() == [0.3] * 3 + [0] * 3


def test_vertices_of_a_pair_that_touches_have_bound_zero():
    mesh, x = scenes.stacked(0.0, 0.0, 5.0)
    assert ccd.displacement_bounds(mesh, x, 1.0).tolist() == [0] * 6 + [0.5] * 3


# --- moves within the bounds ---


def stays_free(mesh, path, kept=0.0):
    """Whether no pair touches, or comes within a distance, along straight lines from one place to the next."""
    options = {"minimum_distance": kept, "tolerance": 1e-13, "length_scale": 1.0}
    return all(ccd.is_step_collision_free(mesh, a, b, **options) for a, b in itertools.pairwise(path))


def in_balls(rng, x, bounds, share):
    """A place at random in the ball of each vertex; the share of the radius decides how near to its surface."""
    direction = rng.standard_normal(x.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return x + (share * bounds)[:, None] * direction


@pytest.mark.parametrize("scene", ["every kind", "a static body", "in the plane, a static body", "half-spaces"])
def test_whatever_way_vertices_move_within_their_bounds_nothing_touches(scene):
    mesh, rng = SCENES[scene](), np.random.default_rng(0)
    x, kept = mesh.vertices, 0.003
    bounds = ccd.displacement_bounds(mesh, x, 0.2, minimum_distance=kept)
    # pairs that start within the distance, whose vertices stay where they are, would touch all the same
    moving = np.flatnonzero((bounds > 0) | mesh.static[mesh.vertex_body])
    near = ccd.find_proximity(mesh, x, 1.01 * kept)
    stuck = [pair for pair in near.vertices.tolist() if not (bounds[pair] > 0).any()]
    excluded = [(a, b) for p, q, r, s in stuck for a, b in ((p, s), (p, r), (q, s), (q, r)) if a != b]
    in_solid = near.primitives[(near.kind == int(ccd.PairKind.VERTEX_PLANE)) & (bounds[near.vertices[:, 0]] == 0)]
    mesh = mesh.excluding({"vertex_plane": in_solid}) if len(in_solid) else mesh
    mesh = mesh.excluding({"vertices": excluded}) if excluded else mesh
    assert len(moving) > len(x) / 3
    path = [x]
    for _ in range(12):
        path.append(in_balls(rng, x, bounds, rng.choice([1.0 - 1e-9, rng.random()], len(x))))
    assert stays_free(mesh, path, kept * (1 - 1e-9))
    # and what crossed at the start, an edge through a face, is what crosses afterwards
    before, *after = (ccd.find_intersections(mesh, place) for place in path[::4])
    for found in after:
        np.testing.assert_array_equal(found[found.is_crossing].primitives, before[before.is_crossing].primitives)


def test_vertices_that_all_move_straight_at_what_is_nearest_leave_a_gap_and_farther_than_that_touch():
    mesh = few(4, spread=1.0)
    x = mesh.vertices
    bounds = ccd.displacement_bounds(mesh, x, 0.5)
    found = ccd.find_proximity(mesh, x, 0.5)
    touched = 0
    for k in range(0, len(found), 5):
        for share, kind in ((1.0 - 1e-9, "free"), (1.0 + 1e-9, "beyond")):
            end = x.copy()
            for v, weight in zip(found.vertices[k], found.weights[k], strict=True):
                if weight != 0:
                    end[v] = x[v] - np.sign(weight) * share * bounds[v] * found.direction[k]
            free = stays_free(mesh, [x, end])
            assert free or kind == "beyond"
            touched += not free
    assert touched > 0  # the bounds are as large as they can be


# --- on the device ---


def test_copies_of_a_body_that_moves_alone_have_its_bounds():
    bodies = [(np.eye(3), [[0, 1, 2]]), (np.eye(3) - [0.0, 0.0, 0.3], [[0, 1, 2]])]
    one = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False)
    copies, x = one.replicate(3), np.tile(one.vertices, (3, 1, 1))
    expected = np.tile(ccd.displacement_bounds(one, one.vertices, 1.0), 3)
    assert 0.15 < expected.max() < 0.5
    np.testing.assert_array_equal(ccd.displacement_bounds(copies, x, 1.0), expected)
    np.testing.assert_array_equal(
        ccd.CollisionPipeline(copies).launch_displacement_bounds(on_device(x), 1.0).to_host(), expected
    )
    free = ccd.CollisionMesh.from_arrays([bodies[0]], self_collision=False).replicate(2)
    assert (ccd.displacement_bounds(free, free.vertices, 1.0) == 1.0).all()
    # two that move share what is between them, in whatever world they are
    pairs = ccd.CollisionMesh.from_arrays(bodies, self_collision=False).replicate(2)
    assert ccd.displacement_bounds(pairs, pairs.vertices, 1.0).max() <= 0.5


def test_pairs_beyond_the_capacity_bound_their_vertices_by_zero():
    mesh = few(6)
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=60)
    result = pipeline.launch_displacement_bounds(on_device(mesh.vertices), 0.1)
    assert result.flags.numpy()[0] == ccd.LaunchFlag.PAIRS_OVERFLOW
    found, whole = result.to_host(), ccd.displacement_bounds(mesh, mesh.vertices, 0.1)
    assert (found <= whole).all() and ((found == whole) | (found == 0)).all() and (found < whole).any()
    pipeline.reserve(max_pairs=20_000)
    np.testing.assert_array_equal(pipeline.launch_displacement_bounds(on_device(mesh.vertices), 0.1).to_host(), whole)


def test_a_coordinate_that_is_not_finite_stops_its_world_and_no_other():
    mesh = few(vertex_world=[1] * 27 + [0] * 27)
    pipeline = ccd.CollisionPipeline(mesh, **CAPACITIES)
    expected = ccd.displacement_bounds(mesh, mesh.vertices, 0.1)
    for value in (np.nan, -np.inf):
        x = mesh.vertices.copy()
        x[30, 2] = value
        result = pipeline.launch_displacement_bounds(on_device(x), 0.1)
        assert result.world_flags.numpy().tolist() == [ccd.LaunchFlag.INVALID_INPUT, 0]
        np.testing.assert_array_equal(result.to_host(), np.where(mesh.vertex_world == 0, 0.0, expected))
        with pytest.raises(ValueError, match=r"^positions"):
            ccd.displacement_bounds(mesh, x, 0.1)


# --- arguments ---


def test_a_separation_in_the_maximum_norm_is_refused():
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE)])
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=0.1)
    for call, x in (
        (pipeline.displacement_bounds, TRIANGLE),
        (pipeline.launch_displacement_bounds, on_device(TRIANGLE)),
    ):
        with pytest.raises(ValueError, match=r"minimum_separation is 0\.1; expected 0, and minimum_distance"):
            call(x, 0.1)
    with pytest.raises(TypeError, match=r"^displacement_bounds\(\) does not take the option 'minimum_separation'"):
        ccd.displacement_bounds(mesh, TRIANGLE, 0.1, minimum_separation=0.1)
