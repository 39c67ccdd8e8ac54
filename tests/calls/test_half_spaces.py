"""Half-spaces as bodies: vertices that meet their planes, judged by rational arithmetic and against ground meshes."""

import copy
import pickle
from fractions import Fraction

import numpy as np
import pytest
import trimesh
import warp as wp
from exact_planes import VERTEX_PLANE, Truth, U, check_never_late, hostile_queries, particles, random_queries, tois_of
from expected_warnings import OF_ROUNDING
from launches import CAPACITIES, check_same, on_device
from oracles import brute_force, check_candidates, plane_value
from scenes import FACE, NO_FACES, TRIANGLE, sheet, sheet_over_ball

import ccd_warp as ccd

pytestmark = OF_ROUNDING

UP = [0.0, 0.0, 1.0]
GROUND = ccd.HalfSpace([0, 0, 0], UP)


def sheet_over_ground(height=0.5, fall=1.0, **arguments):
    """A tilted sheet of two bodies' worth of vertices that falls on a tilted ground: mesh, start and end positions."""
    vertices, faces = sheet(6)
    vertices = vertices + np.array([0.03, 0.01, height]) + 0.1 * vertices[:, :1] * UP
    mesh = ccd.CollisionMesh.from_arrays(
        [(vertices, faces), ccd.HalfSpace([0.3, 0, 0], [0.1, -0.2, 3.0])], names=["sheet", "ground"], **arguments
    )
    return mesh, mesh.vertices, mesh.vertices - fall * np.array(UP)


@pytest.mark.parametrize(
    ("options", "distance"),
    [({}, 0.0), ({"minimum_distance": 0.03}, 0.03), ({"minimum_separation": 0.03, "length_scale": 1.0}, 0.03)],
)
def test_random_vertices_meet_planes_in_time_and_no_earlier(options, distance):
    mesh, start, end = random_queries(np.random.default_rng(1))
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", **options)
    assert check_never_late(mesh, start, end, result, distance, "minimum_distance" in options) > 400


@pytest.mark.parametrize("distance", [0.0, 0.02])
def test_a_vertex_keeps_the_radius_of_the_thickest_primitive_around_it(distance):
    """A cable whose ends are thinner than its middle is as thick there; a particle has its own radius."""
    rng = np.random.default_rng(12)
    cable, dust = rng.uniform(-1, 1, (20, 3)), rng.uniform(-1, 1, (20, 3))
    edges = np.stack([np.arange(0, 20, 2), np.arange(1, 20, 2)], axis=1)
    radius = 0.1 * rng.random(40) * (np.arange(40) % 3)
    slope = ccd.HalfSpace([0.1, 0, 0], [-1, 2, 3])
    mesh = ccd.CollisionMesh.from_arrays([(cable, NO_FACES, edges), (dust, NO_FACES), slope], radius=radius)
    start, end = mesh.vertices, rng.uniform(-1, 1, (40, 3))
    largest = radius.copy()
    largest[edges] = radius[edges].max(axis=1, keepdims=True)
    options = {"minimum_distance": distance, "device": "cpu", "pair_kinds": ["vertex_plane"]}
    result = ccd.mesh_ccd(mesh, start, end, **options)
    toi, gap = tois_of(result, 40, 1)
    for v in range(40):
        truth, own, t = Truth(mesh, start, end, v, 0), Fraction(distance) + Fraction(largest[v]), float(toi[v, 0])
        assert not truth.is_late(t, own, is_euclidean=True)
        assert t == np.inf or truth.excess(truth.at(t), own + Fraction(gap[v, 0]), True) <= 0 <= gap[v, 0] + 1e-15
        assert t in (0, np.inf) or gap[v, 0] < 1e-14
    assert 10 < np.isfinite(toi).sum() and 3 < (np.isfinite(toi) & (toi > 0)).sum()
    pipeline = ccd.CollisionPipeline(mesh, **options)
    check_same(pipeline.launch(on_device(start), on_device(end)), result)
    pipeline.radius.zero_()
    thin = ccd.CollisionMesh.from_arrays([(cable, NO_FACES, edges), (dust, NO_FACES), slope])
    launched = pipeline.launch(on_device(start), on_device(end))
    assert np.array_equal(launched.vertex_toi.numpy(), ccd.mesh_ccd(thin, start, end, **options).vertex_toi)
    near = ccd.find_candidates(mesh, start, end, 0.5 * distance).vertex_plane
    assert set(result.contacts.primitives[:, 0]) <= set(near[:, 0])


@pytest.mark.parametrize("seed", range(3))
def test_hostile_vertices_and_planes_are_never_late(seed):
    rng = np.random.default_rng(seed)
    mesh, start, end = hostile_queries(rng)
    assert check_never_late(mesh, start, end, ccd.mesh_ccd(mesh, start, end, device="cpu")) > 300
    for distance in (1e-323, 1e-5, 1e200, 1.7e308):
        options = {"minimum_distance": distance} if seed % 2 else {"minimum_separation": distance, "length_scale": 1.0}
        toi, _ = tois_of(ccd.mesh_ccd(mesh, start, end, device="cpu", **options), len(start), len(mesh.planes))
        for vertex, plane in np.ndindex(toi.shape):
            truth = Truth(mesh, start, end, vertex, plane)
            assert not truth.is_late(float(toi[vertex, plane]), distance, bool(seed % 2))


def test_positions_in_float32_meet_planes_at_the_time_of_their_rounded_motion():
    mesh, start, end = random_queries(np.random.default_rng(4))
    start, end = (x.astype(np.float32) for x in (start, end))
    result = ccd.CollisionPipeline(mesh, device="cpu", precision="float32", max_contacts=2000).launch(
        on_device(start, dtype=wp.vec3f), on_device(end, dtype=wp.vec3f)
    )
    found = result.to_host()
    assert found.flags == 0
    assert check_never_late(mesh, start.astype(np.float64), end.astype(np.float64), found) > 400


def test_a_start_gap_fraction_leaves_every_vertex_outside_a_way_to_go():
    mesh, start, end = random_queries(np.random.default_rng(5))
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", minimum_distance=0.5, start_gap_fraction=0.25)
    toi, _ = tois_of(result, len(start), len(mesh.planes))
    for vertex, plane in np.ndindex(toi.shape):
        truth, t = Truth(mesh, start, end, vertex, plane), float(toi[vertex, plane])
        assert (t == 0) == (truth.f[0] <= 0)
        gap = max(truth.f[0], Fraction(0)) / max(abs(n) for n in truth.normal)
        assert not truth.is_late(t)
        if 0 < t < np.inf:  # at least three quarters of its gap, or half the unit of the distance, are left to go
            assert truth.at(t) >= min(Fraction(1, 4) * truth.f[0] * (1 - 99 * U), truth.f[0]) or gap == 0


@pytest.mark.parametrize(
    ("start", "end", "toi"),
    [
        ([0, 0, 1.0], [5, 5, 1.0], np.inf),  # parallel above
        ([0, 0, 0.0], [5, 5, 0.0], 0.0),  # slides on the plane
        ([0, 0, 0.0], [0, 0, 1.0], 0.0),  # starts on it and rises
        ([0, 0, -1.0], [0, 0, 1.0], 0.0),  # rises out of the solid
        ([0, 0, 1.0], [0, 0, 0.0], 1.0),  # ends on it
        ([0, 0, 1.0], [0, 0, 5e-324], np.inf),  # ends the least number above it, which float64 cannot tell
        ([0, 0, 5e-324], [0, 0, 1.0], 0.0),  # starts there
        ([1e300, 0, 2.0], [-1e300, 0, -2.0], 0.5),
    ],
)
def test_where_a_vertex_is_beside_the_ground(start, end, toi):
    mesh = particles([start], GROUND)
    result = ccd.mesh_ccd(mesh, [start], [end], device="cpu")
    is_close = result.toi == toi or (toi < np.inf and toi * (1 - 2e-15) <= result.toi <= toi)
    # what float64 cannot tell from the plane counts as touching, which is early and never late
    assert is_close or (5e-324 in (start[2], end[2]) and result.toi <= toi)
    assert ccd.is_step_collision_free(mesh, [start], [end], device="cpu") == (result.toi == np.inf)


def test_a_ground_of_two_triangles_and_a_half_space_give_the_same_times(device):
    vertices, faces = sheet(8)
    rng = np.random.default_rng(6)
    vertices = vertices + [0.01, 0.02, 0.5] + 0.1 * rng.standard_normal(vertices.shape)
    square = 50.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    square, vertices = square @ rotation.T, vertices @ rotation.T
    end = vertices - 1.5 * rotation[:, 2]
    normal = np.cross(square[1] - square[0], square[2] - square[0])
    normal = normal if normal @ vertices[0] > 0 else -normal
    ground = (square, [[0, 1, 2], [0, 2, 3]])
    solid = ccd.CollisionMesh.from_arrays([(vertices, faces), ground], static=[1], self_collision=False)
    plane = ccd.CollisionMesh.from_arrays([(vertices, faces), ccd.HalfSpace(square[0], normal)], self_collision=False)
    for options in ({}, {"minimum_distance": 0.05}):
        options |= {"length_scale": 1.0, "device": device, "pair_kinds": ["vertex_face", "vertex_plane"]}
        expected = ccd.mesh_ccd(solid, np.concatenate([vertices, square]), np.concatenate([end, square]), **options)
        found = ccd.mesh_ccd(plane, vertices, end, **options)
        assert abs(found.toi - expected.toi) < 2e-6 < found.toi
        np.testing.assert_allclose(found.vertex_toi, expected.vertex_toi[: len(vertices)], atol=1e-5)
        distance = options.get("minimum_distance", 0.0)
        assert check_never_late(plane, vertices, end, found, distance, is_euclidean=True) == len(vertices)


def test_both_drivers_say_the_same_of_a_scene_with_bodies_and_planes(device):
    """A ball as a mesh, a tilted ground and a wall, with a cloth that meets all."""
    mesh, start, end = sheet_over_ball()
    bodies = [(start[mesh.vertex_body == b], mesh.faces[mesh.face_body == b]) for b in range(2)]
    bodies[1] = (bodies[1][0], bodies[1][1] - len(bodies[0][0]))
    walls = [ccd.HalfSpace([0, 0, 0.1], [0.1, 0, 1]), ccd.HalfSpace([-0.45, 0, 0], [3, 0, 0])]
    mesh = ccd.CollisionMesh.from_arrays([walls[0], *bodies, walls[1]], static=[2])
    options = {"length_scale": 1.0, "device": device, "minimum_separation": 1e-3}
    expected = ccd.mesh_ccd(mesh, start, end, **options)
    assert {ccd.PairKind.VERTEX_FACE, VERTEX_PLANE} <= set(expected.contacts.kind.tolist())
    assert np.isfinite(expected.body_toi).all()
    pipeline = ccd.CollisionPipeline(mesh, **options, **CAPACITIES)
    launched = pipeline.launch(on_device(start, device), on_device(end, device))
    check_same(launched, expected)
    contacts = expected.contacts
    order = np.lexsort(launched.contacts.primitives.numpy()[: len(contacts), ::-1].T)
    order = order[np.argsort(launched.contacts.kind.numpy()[order], kind="stable")]
    for name in ("points", "vertices", "bodies", "world"):
        of_device = getattr(launched.contacts, name).numpy()[order]
        np.testing.assert_array_equal(of_device, getattr(contacts, name))
    by_toi = launched.contacts.order_by_toi().numpy()[: len(contacts)]
    np.testing.assert_array_equal(launched.contacts.primitives.numpy()[by_toi], contacts.sorted_by_toi().primitives)
    assert ccd.collision_free_step(mesh, start, end, **options, start_gap_fraction=None) == expected.toi
    for b, k in enumerate(expected.body_contact):
        assert contacts.toi[k] == expected.body_toi[b] and b in contacts.bodies[k]
    for v in np.flatnonzero(np.isfinite(expected.vertex_toi)):
        assert contacts.toi[expected.vertex_contact[v]] == expected.vertex_toi[v]


def test_more_contacts_than_a_step_begins_with_capacity_for():
    start = np.random.default_rng(7).uniform(0.1, 1, (3000, 3))
    mesh = particles(start, GROUND)
    end = start - [0, 0, 2.0]
    for _ in range(2):
        result = ccd.mesh_ccd(mesh, start, end, device="cpu")
        assert np.array_equal(result.contacts.primitives[:, 0], np.arange(3000))
        np.testing.assert_allclose(result.vertex_toi, start[:, 2] / 2, rtol=3e-15)
        assert result.counts.num_contacts == {VERTEX_PLANE: 3000}
    with pytest.raises(ValueError, match=r"memory_limit is 1000000 bytes; expected at least .* for the 3000 contacts"):
        ccd.mesh_ccd(mesh, start, end, device="cpu", memory_limit=1_000_000)


def test_a_contact_says_where_it_is_and_of_what():
    mesh, start, end = sheet_over_ground()
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", minimum_distance=0.02)
    contacts = result.contacts
    unit = mesh.planes.normals[0] / np.linalg.norm(mesh.planes.normals[0])
    np.testing.assert_allclose(contacts.normal, np.tile(unit, (len(contacts), 1)), rtol=1e-15)
    at_toi = start[contacts.primitives[:, 0]] - contacts.toi[:, None] * UP
    np.testing.assert_allclose(contacts.points, at_toi - 0.01 * unit, atol=1e-15)
    assert contacts.bodies.tolist() == [[0, 1]] * len(contacts)
    first = result.first
    assert first.kind == VERTEX_PLANE and first.vertices.tolist() == [first.primitives[0]]
    assert first.bodies.tolist() == [0, 1]
    assert repr(first).startswith("Contact(vertex-plane of sheet and ground at (")
    assert "1 half-space" in repr(mesh) and repr(pickle.loads(pickle.dumps(contacts))) == repr(contacts)
    assert (contacts.gap < 3e-15).all() and result.first.world == 0


@pytest.mark.parametrize("per", ["scene", "vertex"])
def test_line_searches_stop_at_the_ground(per):
    mesh, start, end = sheet_over_ground(height=0.2)
    end = end + 0.3 * np.random.default_rng(8).standard_normal(end.shape) * UP
    options = {"minimum_distance": 1e-3, "device": "cpu"}
    found = ccd.line_search(mesh, start, end, per=per, **options)
    assert 0 < found.fraction < 1
    launched = on_device(end)
    ccd.CollisionPipeline(mesh, **options, **CAPACITIES).launch_line_search(on_device(start), launched, per=per)
    for vertices in (found.vertices, launched.numpy()):
        assert not np.array_equal(vertices, start)
        for v in range(mesh.num_vertices):
            truth = Truth(mesh, start, vertices, v, 0)
            assert truth.excess(min(truth.f), 1e-3, True) > 0


@pytest.mark.parametrize("per", ["body", "vertex"])
def test_what_rests_on_the_ground_may_stay_while_the_rest_moves(per):
    """A stationary pair may touch; a strict search stops and names one that starts in contact and moves."""
    rest, rising, far = np.array([[0, 0, 0.0]]), np.array([[2.0, 0, 0]]), np.array([[4.0, 0, 1]])
    mesh = ccd.CollisionMesh.from_arrays([(rest, NO_FACES), (rising, NO_FACES), (far, NO_FACES), GROUND])
    start = np.concatenate([rest, rising, far])
    end = start + [[0, 0, 0], [0, 0, 1], [0, 0, -0.5]]
    assert ccd.line_search(mesh, start, end, per=per, device="cpu").vertex_fraction.tolist() == [1, 1, 1]
    strict = {"start_gap_fraction": None, "device": "cpu"}
    found = ccd.line_search(mesh, start, end, per=per, **strict)
    assert found.vertex_fraction.tolist() == [1, 0, 1] or found.vertex_fraction.tolist() == [0, 0, 1]
    assert found.touching.primitives.tolist() == [[0, 0], [1, 0]]
    launched = on_device(end)
    ccd.CollisionPipeline(mesh, **strict).launch_line_search(on_device(start), launched, per=per)
    assert launched.numpy().tolist() == [start[0].tolist(), start[1].tolist(), end[2].tolist()]


def test_worlds_share_the_ground(device):
    mesh, start, _ = sheet_over_ground()
    worlds = mesh.replicate(3)
    assert worlds.names == ("sheet[0]", "sheet[1]", "sheet[2]", "ground")
    assert len(worlds.planes) == 1 and worlds.planes.bodies.tolist() == [3] and worlds.static.tolist() == [0, 0, 0, 1]
    starts = np.stack([start + [0, 0, height] for height in (0.0, 0.2, 2.0)])
    ends = starts - UP
    expected = [ccd.mesh_ccd(mesh, a, b, device=device).toi for a, b in zip(starts, ends, strict=True)]
    result = ccd.mesh_ccd(worlds, starts, ends, device=device)
    assert result.world_toi.tolist() == expected and expected[2] == np.inf and expected[0] < expected[1] < 1
    assert result.body_toi.tolist() == [*expected, expected[0]]
    pipeline = ccd.CollisionPipeline(worlds, device=device, **CAPACITIES)
    check_same(
        pipeline.launch(on_device(starts.reshape(-1, 3), device), on_device(ends.reshape(-1, 3), device)), result
    )


def test_copies_of_a_scene_keep_what_is_excluded_of_the_ground():
    bodies = [(TRIANGLE, FACE), GROUND, (TRIANGLE + UP, FACE), ccd.HalfSpace([0, 0, 9], [0, 0, -1])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, names=["a", "floor", "b", "roof"])
    mesh = mesh.excluding({"bodies": [("floor", "b"), ("a", "b")], "vertex_plane": [(1, 0), (4, 1)]})
    worlds = mesh.replicate(2)
    assert worlds.names == ("a[0]", "b[0]", "a[1]", "b[1]", "floor", "roof")
    named = {tuple(worlds.names[body] for body in pair) for pair in worlds.exclude_pairs["bodies"].tolist()}
    assert named == {("a[0]", "b[0]"), ("a[1]", "b[1]"), ("b[0]", "floor"), ("b[1]", "floor")}
    assert worlds.exclude_pairs["vertex_plane"].tolist() == [[1, 0], [4, 1], [7, 0], [10, 1]]
    of_one = brute_force(mesh, mesh.vertices, mesh.vertices - 10.0 * np.array(UP))[VERTEX_PLANE]
    both = brute_force(worlds, worlds.vertices, worlds.vertices - 10.0 * np.array(UP))[VERTEX_PLANE]
    assert both == sorted([*of_one, *((v + 6, plane) for v, plane in of_one)])
    result = ccd.mesh_ccd(worlds, worlds.vertices, worlds.vertices - 10.0 * np.array(UP), device="cpu")
    is_plane = result.contacts.kind == VERTEX_PLANE
    assert list(map(tuple, result.contacts.primitives[is_plane].tolist())) == both
    assert mesh.replicate(1).body_pairs is None and copy.deepcopy(worlds).planes == worlds.planes


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"exclude_pairs": {"bodies": [("cloth", "ground")]}},
        {"exclude_pairs": {"vertex_plane": [(0, 0), (3, 0), (5, 1)]}},
        {"body_pairs": np.array([[1, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 1]], dtype=bool)},
        {"static": ["box"]},
    ],
)
def test_candidates_and_contacts_are_those_that_the_filter_leaves(arguments):
    vertices, faces = sheet(3)
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    mesh = ccd.CollisionMesh.from_arrays(
        [
            (vertices, faces),
            ccd.HalfSpace([0, 0, -0.3], UP),
            (box.vertices + UP, box.faces),
            ccd.HalfSpace([9, 0, 0], [-1, 0, 0]),
        ],
        names=["cloth", "ground", "box", "wall"],
        **arguments,
    )
    start = mesh.vertices
    moves = np.random.default_rng(9).uniform(-1.2, 0, (mesh.num_vertices, 1)) * UP
    end = start + moves * ~mesh.static[mesh.vertex_body][:, None]
    for inflation in (0.0, 0.1, 4.2):
        check_candidates(mesh, start, end, inflation)
    result = ccd.mesh_ccd(mesh, start, end, device="cpu")
    found = result.contacts.primitives[result.contacts.kind == VERTEX_PLANE]
    assert list(map(tuple, found.tolist())) == brute_force(mesh, start, end)[VERTEX_PLANE]
    assert result.counts.num_candidates[VERTEX_PLANE] == len(found)


def test_bodies_that_only_the_ground_is_near_are_checked(device):
    """Bodies without self-collision, far from one another, are left out of the search, and not of this."""
    box = trimesh.creation.box()
    mesh = ccd.CollisionMesh.from_trimesh([box, box, GROUND], self_collision=False)
    start = np.concatenate([box.vertices + [0, 0, 2], box.vertices + [50, 0, 3]])
    result = ccd.mesh_ccd(mesh, start, start - [0, 0, 4.0], device=device)
    np.testing.assert_allclose(result.body_toi, [1.5 / 4, 2.5 / 4, 1.5 / 4], rtol=1e-14)
    alone = ccd.CollisionMesh.from_trimesh([box, GROUND], self_collision=False)
    result = ccd.mesh_ccd(alone, start[:8], start[:8] - [0, 0, 4.0], device=device)
    np.testing.assert_allclose(result.toi, 1.5 / 4, rtol=1e-14)
    pipeline = ccd.CollisionPipeline(alone, device=device)
    check_same(pipeline.launch(on_device(start[:8], device), on_device(start[:8] - [0, 0, 4.0], device)), result)


def test_a_half_plane_is_met_in_the_plane():
    points, chain = np.array([[0.0, 1], [1, 2], [2, 1.5]]), [[0, 1], [1, 2]]
    mesh = ccd.CollisionMesh.from_arrays([ccd.HalfSpace([5, 0], [1, 2]), (points, chain)], names=["slope", "rope"])
    end = points - [0, 5.0]
    result = ccd.mesh_ccd(mesh, points, end, device="cpu")
    found = result.contacts[result.contacts.kind == VERTEX_PLANE]
    for (vertex, plane), toi in zip(found.primitives.tolist(), found.toi.tolist(), strict=True):
        truth = Truth(mesh, points, end, vertex, plane)
        assert not truth.is_late(toi) and not truth.is_early(toi)
    assert len(found) == 3 and found.points.shape == (3, 2) and found.bodies.tolist() == [[1, 0]] * 3
    np.testing.assert_allclose(found.normal, np.tile([1, 2], (3, 1)) / 5**0.5, rtol=1e-15)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    arrays = [wp.array(x, dtype=wp.vec2d, device="cpu") for x in (points, end)]
    check_same(pipeline.launch(*arrays), result)
    inside = ccd.find_intersections(mesh, end)
    assert inside.kind.tolist() == [ccd.IntersectionKind.VERTEX_PLANE] * 3 and inside.points.tolist() == end.tolist()


def test_vertices_in_the_solid_are_found_exactly():
    rng = np.random.default_rng(10)
    mesh, points, _ = hostile_queries(rng)
    found = ccd.find_intersections(mesh, points, device="cpu")
    of_plane = found[found.kind == ccd.IntersectionKind.VERTEX_PLANE]
    expected = [(v, k) for v, k in np.ndindex(len(points), len(mesh.planes)) if plane_value(mesh, k, points[v]) <= 0]
    assert list(map(tuple, of_plane.primitives.tolist())) == expected and len(expected) > 100
    assert np.array_equal(of_plane.points, points[of_plane.primitives[:, 0]]) and not of_plane.parameters.any()
    assert np.array_equal(of_plane.vertices, np.repeat(of_plane.primitives[:, :1], 5, axis=1))
    assert np.array_equal(of_plane.bodies[:, 1], mesh.planes.bodies[of_plane.primitives[:, 1]])


def test_a_start_in_the_solid_is_named():
    mesh, start, end = sheet_over_ground(height=0.0)
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", check_start=True)
    below = sum(plane_value(mesh, 0, x) <= 0 for x in start)
    assert result.toi == 0 and 0 < below < len(start)
    assert result.pairs_at_start == {("sheet", "ground"): below}
    assert f"{below} pairs are in contact at the start already, with toi 0: {below} of sheet and ground" in repr(result)
    assert result.start.by_bodies() == {("sheet", "ground"): below} and result.start.num_crossing == 0


def test_positions_that_are_not_finite_stop_their_world_alone():
    mesh, start, end = sheet_over_ground()
    worlds = mesh.replicate(2)
    starts, ends = np.tile(start, (2, 1)), np.tile(end, (2, 1))
    ends[3, 2] = np.nan
    result = (
        ccd.CollisionPipeline(worlds, device="cpu", **CAPACITIES).launch(on_device(starts), on_device(ends)).to_host()
    )
    assert result.world_flags.tolist() == [ccd.LaunchFlag.INVALID_INPUT, 0]
    assert result.world_toi.tolist() == [0, ccd.mesh_ccd(mesh, start, end, device="cpu").toi]


def test_contacts_beyond_the_capacity_set_a_flag_and_lower_the_toi_all_the_same():
    start = np.random.default_rng(11).uniform(0.1, 1, (100, 3))
    mesh = particles(start, GROUND)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", max_contacts=10)
    result = pipeline.launch(on_device(start), on_device(start - [0, 0, 2.0])).to_host()
    assert (
        result.flags == ccd.LaunchFlag.CONTACTS_OVERFLOW and result.num_contacts == 100 and len(result.contacts) == 10
    )
    assert np.isfinite(result.vertex_toi).all() and result.num_pairs[VERTEX_PLANE] == 100


def test_contacts_with_planes_follow_those_of_points():
    points = np.array([[0, 0, 1.0], [1, 0, 1.0], [5, 5, 1]])
    mesh = particles(points, GROUND, ccd.HalfSpace([0, 0, 0.5], UP), codimensional_points=True)
    end = np.array([[1, 0, -1.0], [0, 0, -1.0], [5, 5, 0.7]])
    result = ccd.mesh_ccd(mesh, points, end, device="cpu")
    kinds, pairs = result.contacts.kind.tolist(), result.contacts.primitives.tolist()
    assert kinds == [ccd.PairKind.POINT_POINT] + [VERTEX_PLANE] * 4
    assert pairs == [[0, 1], [0, 0], [0, 1], [1, 0], [1, 1]]
    touching = ccd.line_search(mesh, points, points - [0, 0, 0.5], device="cpu").touching
    assert touching.primitives.tolist() == []


def test_kinds_of_pairs_choose_planes_or_leave_them_out():
    mesh, start, end = sheet_over_ground()
    assert ccd.mesh_ccd(mesh, start, end, device="cpu", pair_kinds=["vertex_face", "edge_edge"]).toi == np.inf
    result = ccd.mesh_ccd(mesh, start, end, device="cpu", pair_kinds=["vertex_plane"])
    assert result.toi < 1 and list(result.counts.num_searches) == [VERTEX_PLANE]


def test_half_spaces_have_no_radius():
    bodies, names = [(TRIANGLE, FACE), GROUND], ["cloth", "floor"]
    assert ccd.CollisionMesh.from_arrays(bodies, radius=[0.1, 0]).radius.tolist() == [0.1] * 3
    assert ccd.CollisionMesh.from_arrays(bodies, radius=0.1).radius.tolist() == [0.1] * 3
    with pytest.raises(ValueError, match=r"radius holds 0.2 for body 1 \(floor\); expected 0, as a half-space has no"):
        ccd.CollisionMesh.from_arrays(bodies, radius=[0.1, 0.2], names=names)


def test_a_mesh_keeps_its_half_spaces_as_they_were_given():
    point, normal = np.array([1, 2, 3]), np.array([0, 0, 1e-310])
    mesh = ccd.CollisionMesh.from_trimesh([ccd.HalfSpace(point, normal), trimesh.creation.box()])
    point[0] = 7
    assert mesh.planes.points.tolist() == [[1, 2, 3]] and mesh.planes.normals.tolist() == [[0, 0, 1e-310]]
    assert mesh.planes.bodies.tolist() == [0] and mesh.static.tolist() == [True, False]
    assert mesh.body_vertex_range.tolist() == [0, 0, 8] and (mesh.vertex_body == 1).all()
    assert mesh.moving_vertices.tolist() == list(range(8)) and not mesh.planes.points.flags.writeable
    same = pickle.loads(pickle.dumps(mesh))
    assert same.planes == mesh.planes and not same.planes.normals.flags.writeable and same.planes != GROUND
