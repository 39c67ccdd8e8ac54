"""Meshes in the plane: vertices against edges and points against points, judged by brute force and exactly."""

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from exact import exact_tois
from launches import CAPACITIES, check_same
from oracles import brute_force, check_candidates, corners_of, exact_pairs
from scenes import crowd_in_plane

import ccd_warp as ccd

VECTORS = {"float32": wp.vec2f, "float64": wp.vec2d}
SEGMENT = np.array([[-1.0, 0], [1, 0]])
EDGE = [[0, 1]]
NO_EDGES = np.zeros((0, 2), dtype=int)


@pytest.mark.parametrize("inflation", [0.0, 0.05])
@pytest.mark.parametrize("options", [{}, {"static": ["segments"]}, {"self_collision": False}])
def test_candidates_are_all_pairs_whose_boxes_overlap(device, options, inflation):
    mesh, start, end = crowd_in_plane(np.random.default_rng(1), **options)
    assert check_candidates(mesh, start, end, inflation, device=device)
    found = ccd.find_candidates(mesh, start, end, inflation, device=device)
    assert len(found.point_segment) > 30 and len(found.vertex_face) == len(found.edge_edge) == 0


@pytest.mark.parametrize("static", [[], ["segments"], ["dust", "chains"]])
def test_contacts_are_those_of_the_pairs_alone_and_none_that_is_exact_is_missed(device, precision, static):
    mesh, start, end = crowd_in_plane(np.random.default_rng(2), static=static)
    result = ccd.mesh_ccd(mesh, start, end, device=device, precision=precision, length_scale=1.0)
    contacts = result.contacts
    found = {
        (k, *p): t
        for k, p, t in zip(contacts.kind.tolist(), contacts.primitives.tolist(), contacts.toi.tolist(), strict=True)
    }
    exact = exact_pairs(mesh, start, end)
    assert len(exact) > 20
    assert not [pair for pair, e in exact.items() if e.late(found.get(pair, np.inf))]
    assert (
        result.toi
        == min(found.values())
        == ccd.collision_free_step(mesh, start, end, device=device, precision=precision, length_scale=1.0)
    )
    functions = {ccd.PairKind.POINT_SEGMENT: ccd.point_segment_ccd, ccd.PairKind.POINT_POINT: ccd.point_point_ccd}
    for kind, function in functions.items():
        of_kind = contacts[contacts.kind == kind]
        if len(of_kind) == 0:
            continue
        corners = corners_of(mesh, kind, of_kind.primitives)
        alone = function(start[corners], end[corners], device=device, precision=precision, length_scale=1.0)
        np.testing.assert_array_equal(of_kind.toi, alone.toi)


@pytest.mark.parametrize("separation", [0.0, 0.02])
def test_ends_of_segments_give_the_first_contact_of_two_segments(separation):
    rng = np.random.default_rng(3)
    start = rng.random((400, 4, 2))
    end = start + 0.6 * rng.standard_normal((400, 1, 2)) * [[[1], [1], [-1], [-1]]] + 0.1 * rng.random((400, 4, 2))
    start[:100, 3] = start[:100, 2] + 0.7 * (start[:100, 1] - start[:100, 0])  # parallel at the start
    start[100:150, 1] = start[100:150, 0]  # a segment of no length
    flat = [np.pad(x, ((0, 0), (0, 0), (0, 1))) for x in (start, end)]
    # the oracle's edges are those of space, and it knows nothing of points and segments here
    exact = exact_tois("edge-edge", *flat, separation=separation)
    apart = [k for k, e in enumerate(exact) if not (e.hit and e.approx == 0.0)]
    mesh = ccd.CollisionMesh.from_arrays([(SEGMENT, EDGE), (SEGMENT, EDGE)])
    num_hits = 0
    options = {"minimum_separation": separation, "tolerance": 1e-9, "length_scale": 1.0}
    for k in apart:
        toi = ccd.mesh_ccd(mesh, start[k], end[k], **options).toi
        assert not exact[k].late(toi)
        if exact[k].hit:
            assert toi == pytest.approx(exact[k].approx, abs=1e-4)  # the tolerance is one of length
        num_hits += exact[k].hit
    assert len(apart) > 200 and num_hits > 60


def test_a_falling_point_meets_a_segment_at_its_height():
    mesh = ccd.CollisionMesh.from_arrays([(SEGMENT, EDGE), ([[0.25, 1.0]], NO_EDGES)], static=[0], names=["floor", "p"])
    start = mesh.vertices
    result = ccd.mesh_ccd(mesh, start, start - [[0, 0], [0, 0], [0, 2]])
    first = result.first
    assert first.toi == pytest.approx(0.5) and first.body_names == ("p", "floor")
    np.testing.assert_allclose(first.point, [0.25, 0.0], atol=1e-5)
    np.testing.assert_array_equal(first.normal, [0, 1])
    assert first.vertices.tolist() == [2, 0, 1] and first.parameters[0] == pytest.approx(0.625)
    assert "(0.25, " in repr(result) and "in the plane" in repr(mesh)


@pytest.mark.parametrize(
    "bodies, moves, toi",
    [
        ([([[0.0, 0], [1, 0]], NO_EDGES)], [[1, 0], [0, 0]], 1.0),  # point to point
        ([(SEGMENT, EDGE), (SEGMENT * 0 + [0, 1], EDGE)], [[0, 0], [0, 0], [0, -2], [0, -2]], 0.5),  # no length
        ([(SEGMENT, EDGE), (SEGMENT + [3, 0], EDGE)], [[2, 0], [2, 0], [0, 0], [0, 0]], 0.5),  # along one line
        ([(SEGMENT, EDGE), (SEGMENT + [0, 1], EDGE)], [[0, 1], [0, 1], [0, -1], [0, -1]], 0.5),  # flat on flat
        ([(SEGMENT, EDGE), (SEGMENT + [2, 0], EDGE)], [[0, 0]] * 4, 0.0),  # they touch from the start
        ([(SEGMENT, EDGE), (SEGMENT + [0, 1], EDGE)], [[0, 1], [0, 1], [0, 1], [0, 1]], np.inf),  # together
        ([(SEGMENT, [[0, 1], [1, 0], [0, 0]])], [[3, 1], [0, 0]], np.inf),  # an edge alone, given three times
    ],
)
def test_hand_made_cases(bodies, moves, toi):
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + moves, tolerance=1e-9)
    assert result.toi <= toi and result.toi == pytest.approx(toi, abs=1e-6)


def test_points_with_a_flag_meet_each_other_and_edges_and_others_nothing():
    start = np.array([[0.0, 0], [0, 1], [5, 0], [6, 0], [0, 3], [0, 4]])
    end = start.copy()
    end[[4, 5]] = start[[5, 4]]
    for flag, kinds in ((False, []), (True, [int(ccd.PairKind.POINT_POINT)])):
        mesh = ccd.CollisionMesh.from_arrays([(start, [[2, 3]])], codimensional_points=flag)
        assert np.unique(ccd.mesh_ccd(mesh, start, end).contacts.kind).tolist() == kinds
        through = start - [[5.5, 0]] * (np.arange(6) == 2)[:, None] + [[5.5, -2]] * (np.arange(6) == 1)[:, None]
        assert ccd.mesh_ccd(mesh, start, through).hit == flag


@pytest.mark.parametrize("per", ["scene", "body", "vertex"])
def test_shortened_steps_are_free(device, per):
    mesh, start, end = crowd_in_plane(np.random.default_rng(5), static=["segments"])
    shortened = ccd.line_search(mesh, start, end, per=per, device=device)
    assert shortened.vertices.shape == start.shape and 0 < shortened.vertex_fraction.max() <= 1
    assert ccd.is_step_collision_free(mesh, start, shortened.vertices, device=device)
    assert not ccd.is_step_collision_free(mesh, start, end, device=device)
    pipeline = ccd.CollisionPipeline(mesh, device=device, **CAPACITIES)
    for real, vector in VECTORS.items():
        x, y = (wp.array(v.astype(real), dtype=vector, device=device) for v in (start, end))
        pipeline.launch_line_search(x, y, per=per)
        x, y = (v.numpy().astype(np.float64) for v in (x, y))
        assert (x != y).any()
        moved = (x != y).any(axis=1)
        contacts = ccd.mesh_ccd(mesh, x, y, device=device).contacts
        assert not moved[contacts.vertices].any()
        assert not [p for p in exact_pairs(mesh, x, y) if moved[corners_of(mesh, p[0], [p[1:]])].any()]


def test_copies_in_worlds_of_their_own(device):
    mesh, start, end = crowd_in_plane(np.random.default_rng(6), count=10)
    mesh = mesh.excluding({"point_segment": brute_force(mesh, 0 * start, 0 * start)[2][::2]})
    alone = ccd.mesh_ccd(mesh, start, end, device=device)
    copies = mesh.replicate(3)
    frames = np.stack([start] * 3), np.stack([end, start, end])
    result = ccd.mesh_ccd(copies, *frames, device=device)
    assert result.world_toi.tolist() == [alone.toi, np.inf, alone.toi]
    launched = ccd.CollisionPipeline(copies, device=device, **CAPACITIES)
    x = [wp.array(f, dtype=wp.vec2d, device=device) for f in frames]
    y = [wp.array(f, dtype=wp.float64, device=device) for f in frames]
    for arrays in (x, y):
        check_same(launched.launch(*arrays), result)


def test_excluded_pairs_in_the_plane(device):
    mesh, start, end = crowd_in_plane(np.random.default_rng(7))
    every = ccd.mesh_ccd(mesh, start, end, device=device).contacts
    of_kind = {
        name: every.primitives[every.kind == ccd.PairKind[name.upper()]] for name in ("point_segment", "point_point")
    }
    assert all(map(len, of_kind.values()))
    assert ccd.is_step_collision_free(mesh.excluding(of_kind), start, end, device=device)
    half = mesh.excluding({name: pairs[::2] for name, pairs in of_kind.items()})
    assert check_candidates(half, start, end, device=device) == check_candidates(mesh, start, end) - sum(
        len(pairs[::2]) for pairs in of_kind.values()
    )


def test_points_alone_and_nothing_at_all(device):
    rng = np.random.default_rng(8)
    start = rng.random((60, 2))
    mesh = ccd.CollisionMesh.from_arrays([(start, NO_EDGES)])
    assert len(mesh.codimensional_points) == 60 and mesh.num_edges == 0
    result = ccd.mesh_ccd(mesh, start, rng.permutation(start), minimum_separation=0.01, device=device)
    assert np.unique(result.contacts.kind).tolist() == [ccd.PairKind.POINT_POINT]
    empty = ccd.CollisionMesh.from_arrays([(np.zeros((0, 2)), NO_EDGES)])
    assert empty.dimension == 2 and ccd.mesh_ccd(empty, np.zeros((0, 2)), np.zeros((0, 2))).toi == np.inf


def test_a_mesh_in_the_plane_is_copied_and_pickled():
    mesh, start, end = crowd_in_plane(np.random.default_rng(9))
    expected = ccd.mesh_ccd(mesh, start, end)
    other = ccd.mesh_ccd(pickle.loads(pickle.dumps(mesh)), start, end)
    np.testing.assert_array_equal(other.contacts.toi, expected.contacts.toi)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(expected)).contacts.points, expected.contacts.points)


def test_a_path_of_trimesh_in_the_plane_is_a_body():
    path = trimesh.load_path(np.array([[0.0, 0], [1, 0], [1, 1]]))
    mesh = ccd.CollisionMesh.from_trimesh([path, path])
    assert mesh.dimension == 2 and mesh.num_edges == 4 and mesh.num_faces == 0


def test_positions_of_the_other_dimension_are_named():
    plane = ccd.CollisionMesh.from_arrays([(SEGMENT, EDGE)])
    space = ccd.CollisionMesh.from_arrays([(np.eye(3), [[0, 1, 2]])])
    for mesh, other, shape in ((plane, np.zeros((2, 3)), "2, 2"), (space, np.zeros((3, 2)), "3, 3")):
        for frames in ((other, other), (mesh.vertices, other)):
            with pytest.raises(
                ValueError, match=rf"shape \({other.shape[0]}, {other.shape[1]}\); expected \({shape}\)"
            ):
                ccd.mesh_ccd(mesh, *frames)
        number = mesh.dimension
        with pytest.raises(ValueError, match=rf"expected vec{number}f or vec{number}d .* \(n, {number}\)"):
            ccd.CollisionPipeline(mesh, device="cpu").launch(other, other)


def test_pictures_of_a_mesh_in_the_plane(tmp_path):
    pytest.importorskip("pyvista")
    mesh, start, end = crowd_in_plane(np.random.default_rng(10))
    result = ccd.mesh_ccd(mesh, start, end)
    path = tmp_path / "plane.png"
    ccd.viz.render_step(mesh, start, end, result, path)
    assert path.stat().st_size > 10_000
    blocks = ccd.viz.to_pyvista(mesh, start, end, result, t=1.0)
    np.testing.assert_array_equal(np.asarray(blocks["dust"].points)[:, :2], end[mesh.vertex_body == 2])
    np.testing.assert_array_equal(np.asarray(blocks["contacts"].point_data["normal"])[:, :2], result.contacts.normal)
    assert ccd.viz.contact_points(mesh, start, end, result.contacts).shape == (len(result.contacts), 2)
