"""Half-spaces that move as they are told: their planes in rational arithmetic, in every call that knows planes."""

import pickle

import numpy as np
import pytest
from exact_planes import check_never_late, hostile_queries, moved_planes, particles, random_queries
from exact_proximity import check_proximities, exact_bounds
from launches import check_same, on_device
from oracles import brute_force, check_candidates, plane_value

import ccd_warp as ccd

UP = [0.0, 0.0, 1.0]


def moving_queries(seed):
    """Points and planes that all move at random."""
    rng = np.random.default_rng(seed)
    mesh, start, end = random_queries(rng)
    return moved_planes(mesh, start, end, mesh.planes.points + 0.7 * rng.standard_normal(mesh.planes.points.shape))


def lift(points=((0.2, 0.1, 0.5), (0.1, 0.3, 2.5), (0.0, 0.0, -1.0))):
    """Particles, a static wall, and a floor that is to rise: the mesh and its start positions."""
    wall, floor = ccd.HalfSpace([9.0, 0, 0], [-1, 0, 0]), ccd.HalfSpace([0, 0, 0], UP)
    mesh = particles(np.array(points), wall, floor, names=["dust", "wall", "floor"], kinematic=["floor"])
    return mesh, mesh.vertices


@pytest.mark.parametrize(
    ("options", "distance"),
    [({}, 0.0), ({"minimum_distance": 0.03}, 0.03), ({"minimum_separation": 0.03, "length_scale": 1.0}, 0.03)],
)
def test_random_vertices_meet_moving_planes_in_time_and_no_earlier(options, distance):
    mesh, start, end = moving_queries(1)
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", **options)
    assert check_never_late(mesh, start, end, result, distance, "minimum_distance" in options) > 400
    assert ccd.collision_free_step(mesh, start, end, device="cpu", **options) == result.toi


@pytest.mark.parametrize("seed", range(2))
def test_hostile_vertices_and_planes_that_move_are_never_late(seed):
    rng = np.random.default_rng(seed)
    mesh, start, end = hostile_queries(rng)
    # to the point of another plane, often of another size, or by the least that float64 knows
    points = mesh.planes.points[rng.permutation(len(mesh.planes))]
    points[::3] = np.nextafter(mesh.planes.points[::3], -np.inf)
    mesh, start, end = moved_planes(mesh, start, end, points)
    assert check_never_late(mesh, start, end, ccd.mesh_ccd(mesh, start, end, device="cpu")) > 300


def test_a_floor_that_rises_meets_what_is_at_rest():
    mesh, start = lift()
    assert mesh.num_vertices == 4 and mesh.static.tolist() == [False, True, False]
    assert mesh.kinematic.tolist() == [False, False, True] and mesh.planes.vertices.tolist() == [-1, 3]
    assert mesh.length_scale == 3.5  # of the particles alone
    end = start + 2.0 * np.outer([0, 0, 0, 1], UP)
    result = ccd.mesh_ccd(mesh, start, end)
    first = result.first
    assert result.vertex_toi[[0, 1, 2]].tolist() == pytest.approx([0.25, np.inf, 0.0], abs=1e-15)
    assert result.body_toi.tolist() == [0.0, np.inf, 0.0] and first.body_names == ("dust", "floor")
    (risen,) = result.contacts[result.contacts.primitives[:, 0] == 0]
    assert np.allclose(risen.point, [0.2, 0.1, 0.5], atol=1e-15) and risen.primitives.tolist() == [0, 1]
    gone = ccd.mesh_ccd(mesh, start, start - 2.0 * np.outer([1, 1, 0, 1], UP))
    assert gone.vertex_toi.tolist()[:3] == [np.inf, np.inf, 0.0]


def test_every_call_takes_the_point_from_the_positions():
    mesh, start, end = moving_queries(2)
    assert check_candidates(mesh, start, end, 0.02) > 100
    result = ccd.mesh_ccd(mesh, start, end)
    pipeline = ccd.CollisionPipeline(mesh)
    check_same(pipeline.launch(on_device(start), on_device(end)), result)
    launched = pipeline.launch(start, displacements=end - start)
    assert np.allclose(launched.vertex_toi.numpy(), result.vertex_toi, atol=1e-14)
    points = pipeline.launch(start, end).contacts
    in_order = np.lexsort(points.primitives.numpy()[: points.count.numpy()[0]].T[::-1])
    assert np.allclose(points.points.numpy()[in_order], result.contacts.points, atol=1e-12)
    for x in (start, end):
        inside = ccd.find_intersections(mesh, x)
        free = range(mesh.num_vertices - len(mesh.planes))
        expected = [(v, k) for v in free for k in range(len(mesh.planes)) if plane_value(mesh, k, x[v], x) <= 0]
        assert list(map(tuple, inside.primitives.tolist())) == expected
    assert check_proximities(mesh, end, 0.1, ccd.find_proximity(mesh, end, 0.1)) > 50


def test_a_vertex_and_a_plane_that_moves_share_what_is_between_them():
    mesh, start = lift([(8.9, 0.1, 0.5), (0.1, 0.3, 2.5), (0.0, 0.0, 2.0)])
    start = np.concatenate([start[:3], [[0.0, 0.0, 0.25]]])
    bounds = ccd.displacement_bounds(mesh, start, 4.0)
    exact, _ = exact_bounds(mesh, start, 4.0)
    # of the first what is between it and the static wall, of the floor half of what is between it and the first
    assert exact == pytest.approx([0.1, 1.125, 0.875, 0.125])
    assert ((bounds <= exact) & (bounds >= exact - 1e-14)).all()
    device = ccd.CollisionPipeline(mesh).launch_displacement_bounds(on_device(start), 4.0).bounds.numpy()
    np.testing.assert_array_equal(device, bounds)


def test_every_world_has_its_own_floor():
    mesh, start = lift()
    mesh = mesh.excluding({"vertex_plane": [(2, 1)]})
    worlds = mesh.replicate(3)
    assert worlds.names == ("dust[0]", "floor[0]", "dust[1]", "floor[1]", "dust[2]", "floor[2]", "wall")
    assert worlds.planes.vertices.tolist() == [3, 7, 11, -1] and worlds.planes.bodies.tolist() == [1, 3, 5, 6]
    assert worlds.exclude_pairs["vertex_plane"].tolist() == [[2, 0], [6, 1], [10, 2]]
    vertices_t0 = np.tile(start, (3, 1, 1))
    vertices_t1 = vertices_t0 + np.array([0.0, 1.0, 2.0])[:, None, None] * np.outer([0, 0, 0, 1], UP)
    result = ccd.mesh_ccd(worlds, vertices_t0, vertices_t1)
    assert result.world_toi.tolist() == pytest.approx([np.inf, 0.5, 0.25], abs=1e-15)
    assert ccd.collision_free_step(worlds, vertices_t0, vertices_t1) == result.toi
    launched = ccd.CollisionPipeline(worlds).launch(on_device(vertices_t0), on_device(vertices_t1))
    assert launched.world_toi.numpy().tolist() == result.world_toi.tolist()
    flat_t0, flat_t1 = vertices_t0.reshape(-1, 3), vertices_t1.reshape(-1, 3)
    near = ccd.find_candidates(worlds, vertices_t0, vertices_t1).vertex_plane
    assert list(map(tuple, near.tolist())) == brute_force(worlds, flat_t0, flat_t1)[ccd.PairKind.VERTEX_PLANE]


@pytest.mark.parametrize("per", ["scene", "world", "body", "vertex"])
def test_a_piston_strikes_what_cannot_get_out_of_its_way(per):
    mesh, start = lift([(0.2, 0.1, 0.5), (0.1, 0.3, 5.0), (0.3, 0.0, 0.5)])
    wished = start + np.array([[0.0, 0, 1.7], [0.3, 0, -0.5], [0, 0, 0.5], [0, 0, 2.0]])
    found = ccd.line_search(mesh, start, wished, per=per)
    assert not found.is_limited and np.array_equal(found.vertices[3], wished[3]) and found.vertex_fraction[3] == 1
    assert found.vertex_fraction[2] == 0 and np.array_equal(found.vertices[2], start[2])
    together = per != "vertex"
    assert found.vertex_fraction[:2].tolist() == ([0, 0] if together else [1, 1])
    struck = found.struck
    assert struck.primitives.tolist() == ([[0, 1], [2, 1]] if together else [[2, 1]])
    assert struck.toi.tolist() == pytest.approx([0.25] * len(struck), abs=1e-15) and len(found.touching) == 0
    # as the documents say: cut the whole step to a little less, and nothing is struck
    share = 0.9 * struck.toi.min()
    cut = ccd.line_search(mesh, start, start + share * (wished - start), per=per)
    assert len(cut.struck) == 0 and cut.fraction > 0
    pipeline = ccd.CollisionPipeline(mesh)
    end = on_device(wished)
    result = pipeline.launch_line_search(on_device(start), end, per=per)
    np.testing.assert_array_equal(end.numpy(), found.vertices)
    assert result.flags.numpy()[0] == result.world_flags.numpy()[0] == ccd.LaunchFlag.STRUCK
    assert result.contacts.to_host().primitives.tolist() == struck.primitives.tolist()
    np.testing.assert_array_equal(result.contacts.to_host().toi, struck.toi)
    end = on_device(start + share * (wished - start))
    assert pipeline.launch_line_search(on_device(start), end, per=per).flags.numpy()[0] == 0


def test_what_is_told_of_a_half_space_that_moves():
    mesh, start = lift()
    same = pickle.loads(pickle.dumps(mesh))
    assert same.planes == mesh.planes and not same.planes.vertices.flags.writeable
    assert "kinematic" in mesh._repr_html_()
    both = [(np.zeros((1, 2)), []), ccd.HalfSpace([0, -1], [0, 1])]
    in_plane = ccd.CollisionMesh.from_arrays(both, kinematic=[1], codimensional_points=True, radius=[0.5, 0.0])
    assert in_plane.codimensional_points.tolist() == [0] and in_plane.vertices.tolist() == [[0, 0], [0, -1]]
    assert ccd.collision_free_step(in_plane, in_plane.vertices, [[0, 0], [0, 1]]) == pytest.approx(0.25, abs=1e-15)
    with pytest.raises(ValueError, match=r"vertices_t1 has shape \(3, 3\)"):
        ccd.mesh_ccd(mesh, start, start[:3])
    lost = start.copy()
    lost[3, 2] = np.nan
    result = ccd.CollisionPipeline(mesh).launch(on_device(start), on_device(lost))
    assert result.flags.numpy()[0] == ccd.LaunchFlag.INVALID_INPUT and result.toi.numpy()[0] == 0
    with pytest.raises(ValueError, match=r"expected at most \d+ copies of a mesh with kinematic half-spaces"):
        mesh.replicate(100_000)
