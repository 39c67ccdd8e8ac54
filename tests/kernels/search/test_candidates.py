"""Candidates equal the overlapping boxes of all pairs, computed by NumPy without a tree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import check_candidates
from published import requires_data, simulation_boxes, simulation_scenes, simulation_step
from scenes import cables_and_particles, single, soup, with_static_at_rest

import ccd_warp as ccd
from ccd_warp import CollisionMesh, find_candidates


@pytest.mark.parametrize("inflation", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("size", [1e-3, 0.05, 0.5])
def test_random_soup(device, size, inflation):
    rng = np.random.default_rng(1)
    start, faces = soup(rng, 150, size)
    check_candidates(single(start, faces), start, start + size * rng.standard_normal(start.shape), inflation, device)


def test_shared_vertices_and_duplicate_faces(device):
    rng = np.random.default_rng(2)
    start, faces = soup(rng, 150, 0.2, num_vertices=40)
    faces = np.concatenate([faces, faces[:20], [[3, 3, 4], [5, 5, 5]]])
    assert check_candidates(single(start, faces), start, start + 0.1, device=device)


@pytest.mark.parametrize("spread", [3, 6, 20, 250])
def test_sizes_over_many_orders_of_magnitude(device, spread):
    rng = np.random.default_rng(3)
    start, faces = soup(rng, 200, 0.0)
    size = 10.0 ** -rng.uniform(0, spread, (200, 1, 1)) * rng.standard_normal((200, 3, 3))
    centre = rng.random((200, 1, 3)) * 10.0 ** -rng.uniform(0, spread, (200, 1, 1))
    start = (centre + size).reshape(-1, 3)
    end = (centre + 1.5 * size).reshape(-1, 3)
    assert check_candidates(single(start, faces), start, end, device=device)


def test_giant_face_among_small_ones(device):
    rng = np.random.default_rng(4)
    start, faces = soup(rng, 300, 0.01)
    start[:3] = [[-1e3, -1e3, 0.5], [1e3, -1e3, 0.5], [0, 1e3, 0.55]]
    assert check_candidates(single(start, faces), start, start + [0, 0, 0.1], device=device)


def test_all_boxes_in_one_cell(device):
    rng = np.random.default_rng(5)
    start = rng.random((120, 3))
    assert check_candidates(single(start, np.arange(120).reshape(-1, 3)), start, rng.random((120, 3)), device=device)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_flat_scene(device, axis):
    rng = np.random.default_rng(6)
    start, faces = soup(rng, 150, 0.05)
    start[:, axis] = 0.25
    assert check_candidates(single(start, faces), start, start, device=device)


def test_boxes_without_extent(device):
    lattice = np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
    vertices = np.repeat(np.tile(lattice, (3, 1)), 3, axis=0)
    mesh = single(vertices, np.arange(len(vertices)).reshape(-1, 3))
    assert check_candidates(mesh, vertices, vertices, device=device)
    assert check_candidates(mesh, 0 * vertices, 0 * vertices, device=device)  # one point


def test_stacked_duplicates(device):
    rng = np.random.default_rng(7)
    one, faces = soup(rng, 12, 0.1)
    mesh = CollisionMesh.from_arrays([(one, faces)] * 4)
    start = np.tile(one, (4, 1))
    assert check_candidates(mesh, start, start, device=device)


@pytest.mark.parametrize("distance", [1e6, 1e15, 1e300])
def test_vertex_that_flies_far_away(device, distance):
    rng = np.random.default_rng(8)
    start, faces = soup(rng, 150, 0.05)
    end = start + 0.01
    end[7] = distance
    assert check_candidates(single(start, faces), start, end, device=device)


@pytest.mark.parametrize("distance", [1e6, 1e12, 1e100])
def test_two_clusters_far_apart(device, distance):
    rng = np.random.default_rng(9)
    start, faces = soup(rng, 80, 0.05)
    mesh = CollisionMesh.from_arrays([(start, faces), (start + distance, faces)])
    assert check_candidates(mesh, mesh.vertices, mesh.vertices + 0.01, device=device)


@pytest.mark.parametrize("small", [5e-324, 1e-300, 1e-100, 1.0, 1e200])
def test_box_whose_extent_overflows(device, small):
    rng = np.random.default_rng(18)
    start, faces = soup(rng, 60, 0.05)
    start *= small
    start[:3] = [[-1.7e308] * 3, [1.7e308] * 3, [0, 1.7e308, 0]]
    assert check_candidates(single(start, faces), start, start, device=device)


def test_offset_of_1e7(device):
    rng = np.random.default_rng(10)
    start, faces = soup(rng, 200, 0.05)
    start += [1e7, -1e7, 1e7]
    assert check_candidates(single(start, faces), start, start + 0.01, device=device)


@pytest.mark.parametrize("scale", [5e-324, 1e-310, 1e-300, 1e-150, 1e150, 1e300, 1.7e308])
@pytest.mark.parametrize("inflation", [0.0, 0.1])
def test_scale(device, scale, inflation):
    rng = np.random.default_rng(11)
    start, faces = soup(rng, 150, 0.05)
    end = start + 0.05 * rng.standard_normal(start.shape)
    start, end = np.clip(2 * start - 1, -1, 1) * scale, np.clip(2 * end - 1, -1, 1) * scale
    assert check_candidates(single(start, faces), start, end, inflation * scale, device)


def test_scaling_by_a_power_of_two_changes_nothing():
    rng = np.random.default_rng(12)
    start, faces = soup(rng, 300, 0.05)
    reference = find_candidates(single(start, faces), start, start + 0.01)
    for scale in (2.0**-400, 2.0**400):
        found = find_candidates(single(start, faces), start * scale, (start + 0.01) * scale)
        assert np.array_equal(found.edge_edge, reference.edge_edge)
        assert np.array_equal(found.vertex_face, reference.vertex_face)


@pytest.mark.parametrize("static", [(), (0,), (1, 2), (0, 1, 2)])
@pytest.mark.parametrize("self_collision", [True, False, [True, False, True], [False, True, True]])
def test_static_bodies_and_self_collision(device, static, self_collision):
    rng = np.random.default_rng(13)
    bodies = [soup(rng, n, size) for n, size in ((60, 0.1), (40, 0.02), (50, 0.4))]
    mesh = CollisionMesh.from_arrays(bodies, static=static, self_collision=self_collision)
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices + 0.1)
    count = check_candidates(mesh, mesh.vertices, end, 0.01, device)
    assert (count > 0) == (len(static) < 3)


def test_rows_of_static_bodies_may_be_left_out():
    rng = np.random.default_rng(14)
    mesh = CollisionMesh.from_arrays([soup(rng, 40, 0.1), soup(rng, 40, 0.1)], static=[0])
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices + 0.1)
    found = find_candidates(mesh, mesh.vertices, end)
    alone = find_candidates(mesh, mesh.vertices, end[120:])
    assert len(found.edge_edge) and np.array_equal(found.edge_edge, alone.edge_edge)
    check_candidates(mesh, mesh.vertices, end)


@pytest.mark.parametrize("bodies", [[([], [])], [(np.eye(3), [])], [(np.eye(3), [[0, 1, 2]])]])
def test_scenes_without_pairs(device, bodies):
    mesh = CollisionMesh.from_arrays(bodies)
    assert check_candidates(mesh, mesh.vertices, mesh.vertices, 1.0, device) == 0


@pytest.mark.parametrize("lattice", [None, 8])
@pytest.mark.parametrize("inflation", [0.0, 0.125])
@pytest.mark.parametrize("num_worlds", [2, 3, 9, 70])
def test_worlds_in_one_place(device, num_worlds, inflation, lattice):
    """Each world has the pairs that it has alone; on a lattice many boxes touch exactly."""
    rng = np.random.default_rng(num_worlds)
    bodies, ends = [], []
    for _ in range(num_worlds):
        vertices, faces = soup(rng, int(rng.integers(1, 6)), 0.3)
        end = vertices + 0.3 * rng.standard_normal(vertices.shape)
        if lattice:
            vertices, end = (np.round(x * lattice) / lattice for x in (vertices, end))
        bodies.append((vertices, faces))
        ends.append(end)
    counts = [len(vertices) for vertices, _ in bodies]
    world = np.repeat(np.arange(num_worlds), counts)
    mesh = CollisionMesh.from_arrays(bodies, vertex_world=world)
    assert mesh.num_worlds == num_worlds
    together = find_candidates(mesh, mesh.vertices, np.concatenate(ends), inflation, device=device).sorted()
    one, other = (world[mesh.edges[together.edge_edge[:, k], 0]] for k in range(2))
    assert (one == other).all()
    first = np.concatenate([[0], np.cumsum(counts)])
    number = 0
    for k, (vertices, faces) in enumerate(bodies):
        alone = CollisionMesh.from_arrays([(vertices, faces)])
        expected = find_candidates(alone, vertices, ends[k], inflation, device=device).sorted()
        check_candidates(alone, vertices, ends[k], inflation, device)
        ours = together.vertex_face[world[together.vertex_face[:, 0]] == k] - [first[k], first[k] // 3]
        np.testing.assert_array_equal(ours, expected.vertex_face)
        number += len(expected.edge_edge)
    assert number == len(together.edge_edge)


@pytest.mark.parametrize("inflation", [0.0, 0.03])
@pytest.mark.parametrize("size", [0.01, 0.3])
def test_cables_and_particles(device, size, inflation):
    rng = np.random.default_rng(19)
    body = cables_and_particles(rng, 30, size)
    mesh = CollisionMesh.from_arrays([body], codimensional_points=True)
    assert len(mesh.codimensional_points) == 90 and len(mesh.codimensional_edges) == 60
    end = mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)
    found = find_candidates(mesh, mesh.vertices, end, inflation, device=device)
    assert len(found.point_segment) and len(found.point_point)
    check_candidates(mesh, mesh.vertices, end, inflation, device, num_threads=2)


@pytest.mark.parametrize("static", [(), (0,), (1, 2), (0, 1, 2)])
@pytest.mark.parametrize("self_collision", [True, False, [False, True, True]])
def test_cables_and_particles_of_static_bodies_and_without_self_collision(device, static, self_collision):
    rng = np.random.default_rng(20)
    bodies = [cables_and_particles(rng, 10, 0.1) for _ in range(3)]
    mesh = CollisionMesh.from_arrays(bodies, static, self_collision, codimensional_points=[True, False, True])
    assert len(mesh.codimensional_points) == 60
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices + 0.1)
    count = check_candidates(mesh, mesh.vertices, end, 0.01, device)
    assert (count > 0) == (len(static) < 3)


def test_long_cable_among_particles(device):
    rng = np.random.default_rng(21)
    particles = rng.random((400, 3)) * [1.0, 1e-3, 1e-3]
    start = np.concatenate([[[-1e3, -1e3, 0], [1e3, 1e3, 1e-3]], particles])
    mesh = CollisionMesh.from_arrays([(start, [], [[0, 1]])], codimensional_points=True)
    assert len(find_candidates(mesh, start, start, device=device).point_segment) == 400
    check_candidates(mesh, start, start + 1e-3 * rng.standard_normal(start.shape), device=device)


def test_stationary_particles_in_one_place(device):
    start = np.zeros((50, 3))
    mesh = CollisionMesh.from_arrays([(start, [])], codimensional_points=True)
    assert check_candidates(mesh, start, start, device=device) == 50 * 49 // 2


@pytest.mark.parametrize(
    ("body", "codimensional_points", "expected"),
    [
        ((np.zeros((4, 3)), [[0, 1, 2]]), False, ["vertex-face", "edge-edge"]),
        ((np.zeros((3, 3)), [[0, 1, 2]]), True, ["vertex-face", "edge-edge"]),
        ((np.zeros((3, 3)), [], [[0, 1]]), False, ["edge-edge"]),
        ((np.zeros((3, 3)), []), True, ["point-point"]),
        ((np.zeros((3, 3)), []), False, []),
        ((np.zeros((3, 3)), [], [[0, 1]]), True, ["edge-edge", "point-segment", "point-point"]),
    ],
)
def test_only_kinds_that_occur_are_looked_for(body, codimensional_points, expected):
    mesh = CollisionMesh.from_arrays([body], codimensional_points=codimensional_points)
    pipeline = ccd.CollisionPipeline(mesh)
    found = pipeline.find_candidates(mesh.vertices, mesh.vertices)
    searched = [kind.name.lower().replace("_", "-") for kind, n in pipeline.counts.num_searches.items() if n]
    assert searched == expected
    if not len(mesh.codimensional_points):
        assert found.point_segment.shape == found.point_point.shape == (0, 2)


lattice_points = st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=6, max_size=36)


@settings(max_examples=60, deadline=None)
@given(lattice_points, st.sampled_from([1.0, 0.1, 2.0**-60, 1e200]), st.randoms(use_true_random=False))
def test_boxes_that_touch_on_a_lattice(points, cell, random):
    """Closed boxes: ties in every coordinate, and on every cell boundary, count as overlap."""
    start = cell * np.array(points[: len(points) // 3 * 3], dtype=np.float64)
    end = start[random.sample(range(len(start)), len(start))] if random.random() < 0.5 else start
    check_candidates(single(start, np.arange(len(start)).reshape(-1, 3)), start, end)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=36, max_size=108))
def test_any_finite_numbers(values):
    start = np.array(values[: len(values) // 9 * 9]).reshape(-1, 3)
    check_candidates(single(start, np.arange(len(start)).reshape(-1, 3)), start, start)


def test_inflation_is_rounded_outward(device):
    """Two points 2/10 apart in exact arithmetic of the inputs' float64 values: rounding inward would miss them."""
    start = np.array([[0.0, 0, 0]] * 3 + [[0.2, 0, 0]] * 3)
    mesh = single(start, [[0, 1, 2], [3, 4, 5]])
    assert check_candidates(mesh, start, start, 0.1, device)
    assert check_candidates(mesh, start, start, np.nextafter(0.1, 0), device)


def test_many_pairs_a_query(device):
    """More pairs than the first guess of the capacity."""
    rng = np.random.default_rng(16)
    start, faces = soup(rng, 700, 0.0)
    start = start * [1.0, 1e-3, 1e-3]
    start[:3] = [[-1, -1, -1], [2, 2, 2], [-1, 2, -1]]
    assert check_candidates(single(start, faces), start, start, device=device) > 2000
    start = np.zeros((600, 3))
    mesh = single(start, np.arange(600).reshape(-1, 3))
    found = find_candidates(mesh, start, start, device=device, num_threads=2)
    assert len(found.vertex_face) == 600 * 199 and len(found.edge_edge) == 600 * 599 // 2 - 600


@requires_data
@pytest.mark.parametrize("scene", simulation_scenes())
def test_published_pairs_are_found(scene, device):
    step = simulation_step(scene)
    mesh = single(step.vertices_t0, step.faces)
    found = find_candidates(mesh, step.vertices_t0, step.vertices_t1, device=device)
    offset = {"v": 0, "e": mesh.num_vertices, "f": mesh.num_vertices + mesh.num_edges}
    for kind, pairs, (first, second) in (
        ("vertex-face", found.vertex_face, "vf"),
        ("edge-edge", found.edge_edge, "ee"),
    ):
        ours = set(map(tuple, pairs.tolist()))
        published = np.sort(simulation_boxes(scene, kind), axis=1) - [offset[first], offset[second]]
        assert len(published) and ours.issuperset(map(tuple, published.tolist()))
