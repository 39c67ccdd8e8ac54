"""Calls with bodies that turn: nothing else changes what they find, and a line search, launches and worlds agree."""

import numpy as np
import pytest
import scenes
import trimesh
from expected_warnings import OF_STRAIGHT_MOTION
from laws.outputs import different, outputs_of

import ccd_warp as ccd

AT_REST = [0.0, 0, 0, 0, 0, 0, 1]
BLADE = np.array([[0.0, 0, 0], [2, 0, 0], [2, 0, 0.5]])
NO_FACES = np.zeros((0, 3), dtype=int)
GROUND = ccd.HalfSpace([0, 0, 0], [0, 0, 1])


def tumbling_boxes(**options):
    """A static box, three that turn, a sheet that bends, and a ground; and their motion."""
    box = trimesh.creation.box((1, 1, 1))
    sheet, faces = scenes.sheet(6)
    rng = np.random.default_rng(3)
    mesh = ccd.CollisionMesh.from_arrays(
        [(box.vertices, box.faces)] * 4 + [(2 * sheet - [1, 1, -1.5], faces), GROUND],
        static=[0],
        rigid=[0, 1, 2, 3],
        **options,
    )
    places = [[0, 0, 0.6], [1.4, 0, 0.9], [-1.3, 0.5, 0.9], [0.2, 1.5, 1.0]]
    poses = np.hstack([places, rng.standard_normal((4, 4))])
    poses[0, 3:] = AT_REST[3:]
    twist = np.hstack([rng.uniform(-0.5, 0.5, (4, 3)) - [0, 0, 0.5], 1.2 * rng.standard_normal((4, 3))])
    twist[0] = 0.0
    end = mesh.vertices + np.where(mesh.rigid[mesh.vertex_body], 0.0, 1.0)[:, None] * [0.1, 0, -0.9]
    return mesh, end, ccd.RigidMotion(poses, twist=twist)


def result_of(mesh, end, motion, **options):
    return ccd.mesh_ccd(mesh, mesh.vertices, end, motion=motion, device="cpu", **options)


def outputs(result):
    return outputs_of(result, "result")


def test_threads_broad_phases_and_memory_change_no_bit():
    mesh, end, motion = tumbling_boxes()
    expected = result_of(mesh, end, motion, num_threads=1)
    assert len(expected.contacts) > 10
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", num_threads=2)
    least = 0
    with pytest.raises(ValueError, match="expected at least") as error:
        result_of(mesh, end, motion, memory_limit=1000)
    least = int(str(error.value).split("at least ")[1].split()[0])
    for result in (
        result_of(mesh, end, motion, num_threads=3),
        result_of(mesh, end, motion, broad_phase="hash"),
        result_of(mesh, end, motion, memory_limit=2 * least),
        pipeline.mesh_ccd(mesh.vertices, end, motion=motion),
        pipeline.mesh_ccd(mesh.vertices, end, motion=motion),
    ):
        assert different(outputs(expected), outputs(result)) == []


def test_step_up_to_the_toi_is_free_and_the_least_toi_is_that_of_all_contacts():
    mesh, end, motion = tumbling_boxes()
    for options in ({}, {"minimum_distance": 0.01}):
        toi = result_of(mesh, end, motion, **options).toi
        assert 0.0 < toi < 1.0
        arguments = (mesh, mesh.vertices, end)
        assert ccd.collision_free_step(*arguments, motion=motion, device="cpu", **options) == toi
        assert not ccd.is_step_collision_free(*arguments, motion=motion, device="cpu", **options)
        before = {"t_max": 0.999 * toi, "motion": motion, "device": "cpu", **options}
        assert ccd.is_step_collision_free(*arguments, **before)


@OF_STRAIGHT_MOTION
def test_straight_calls_in_a_pipeline_are_not_changed_by_those_on_arcs():
    mesh, end, motion = tumbling_boxes()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    start = result_of(mesh, end, motion).contacts  # so that both plans of one workspace are in use
    assert len(start)
    expected = pipeline.mesh_ccd(mesh.vertices, end)
    pipeline.mesh_ccd(mesh.vertices, end, motion=motion)
    assert different(outputs(expected), outputs(pipeline.mesh_ccd(mesh.vertices, end))) == []


@pytest.mark.parametrize("per", ["scene", "body", "vertex"])
@pytest.mark.parametrize("distance", [0.0, 0.02])
def test_line_search_keeps_bodies_rigid_and_ends_free_of_collisions(per, distance):
    mesh, end, motion = tumbling_boxes()
    options = {"minimum_distance": distance, "device": "cpu"}
    found = ccd.line_search(mesh, mesh.vertices, end, motion=motion, per=per, **options)
    assert 0.0 < found.fraction < 1.0
    for body in (1, 2, 3):
        rows = slice(*mesh.body_vertex_range[body : body + 2])
        assert np.ptp(found.vertex_fraction[rows]) == 0.0
        assert trimesh.points.PointCloud(found.vertices[rows]).bounds is not None
        sides = np.linalg.norm(found.vertices[rows][1:] - found.vertices[rows][:-1], axis=1)
        own = np.linalg.norm(np.diff(mesh.vertices[rows], axis=0), axis=1)
        assert sides == pytest.approx(own, abs=1e-12)
    assert found.motion.poses_t1[1:] == pytest.approx(
        motion.at([1.0, *(found.vertex_fraction[mesh.body_vertex_range[1:4]])])[1:], abs=1e-12
    )
    is_rigid = mesh.rigid[mesh.vertex_body][:, None]
    shortened = np.where(is_rigid, mesh.vertices, found.vertices)
    arguments = (mesh, mesh.vertices, shortened)
    assert ccd.is_step_collision_free(*arguments, motion=found.motion, device="cpu", minimum_distance=0.99 * distance)


def test_candidates_hold_all_contacts_and_those_of_boxes_over_the_whole_arc_more():
    mesh, end, motion = tumbling_boxes()
    found = {}
    for broad_phase in ("tree", "hash"):
        options = {"motion": motion, "device": "cpu", "broad_phase": broad_phase}
        found[broad_phase] = ccd.find_candidates(mesh, mesh.vertices, end, **options)
    contacts = result_of(mesh, end, motion).contacts
    for name, pairs in vars(found["tree"]).items():
        keys = set(map(tuple, pairs.tolist()))
        of_kind = contacts.primitives[contacts.kind == int(ccd.PairKind[name.upper()])]
        assert keys.issuperset(map(tuple, of_kind.tolist()))
        assert len(keys) == len(pairs)
        assert (pairs == vars(found["hash"])[name]).all()
    assert len(contacts) < sum(map(len, vars(found["tree"]).values()))


@OF_STRAIGHT_MOTION
@pytest.mark.parametrize("options", [{}, {"minimum_distance": 0.01, "broad_phase": "hash"}])
def test_launches_find_what_the_host_does(options):
    mesh, end, motion = tumbling_boxes()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", **options)
    for shown in (motion, motion.shortened(0.5), motion):
        expected = result_of(mesh, end, shown, **options)
        result = pipeline.launch(mesh.vertices, end[mesh.moving_vertices], motion=shown)
        ours = result.to_host()
        for name in ("toi", "vertex_toi", "body_toi"):
            assert (np.atleast_1d(getattr(expected, name)) == np.atleast_1d(getattr(ours, name))).all()
        assert different(outputs(expected.contacts), outputs(ours.contacts)) == []
        assert (ours.contacts.points == expected.contacts.points).all()
        assert not ours.flags
    with pytest.raises(ValueError, match="known on the device"):
        _ = result.contacts.points
    assert pipeline.launch(mesh.vertices, mesh.vertices).toi.numpy()[0] == 0.0  # all bodies in one place, as they stand


def test_particle_that_has_grown_between_launches_lands_earlier():
    point = (np.zeros((1, 3)), NO_FACES)
    mesh = ccd.CollisionMesh.from_arrays([point, GROUND], rigid=[0], codimensional_points=True, radius=[0.1])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    motion = ccd.RigidMotion([[0, 0, 1, 0, 0, 0, 1]], twist=[[0, 0, -2, 0, 0, 1.0]])
    for radius in (0.1, 0.3, 0.1):
        pipeline.radius.assign(np.array([radius]))
        toi = pipeline.launch(mesh.vertices, mesh.vertices, motion=motion).to_host().toi
        assert toi == pytest.approx(0.5 * (1.0 - radius), abs=1e-12)
        assert toi <= 0.5 * (1.0 - radius)


def test_worlds_have_the_tois_that_each_has_alone():
    mesh, end, motion = tumbling_boxes()
    expected = result_of(mesh, end, motion)
    copies = mesh.replicate(3)
    twists = [motion._body_paths, motion.shortened(0.5)._body_paths, motion.shortened(0.0)._body_paths]
    poses = np.repeat(motion.poses_t0[None], 3, axis=0)
    twist = np.stack([np.hstack([paths.velocity, paths.omega]) for paths in twists])
    ends = np.concatenate([end, mesh.vertices + 0.5 * (end - mesh.vertices), mesh.vertices])
    # all worlds have the slices of the one that turns most, and rounding with them
    found = result_of(copies, ends, ccd.RigidMotion(poses, twist=twist), length_scale=mesh.length_scale)
    assert found.world_toi[0] == pytest.approx(expected.toi, abs=1e-12)
    assert found.world_toi[1] == pytest.approx(2 * expected.toi, abs=1e-9)
    assert found.world_toi[2] == np.inf


@OF_STRAIGHT_MOTION
def test_bodies_that_stretch_move_straight_between_the_places_of_their_maps():
    mesh, end, _ = tumbling_boxes()
    rng = np.random.default_rng(4)
    maps = [np.concatenate([np.eye(3) + 0.2 * rng.standard_normal((4, 3, 3)), rng.random((4, 3, 1))], axis=2)] * 2
    maps[1] = maps[0] + 0.3 * rng.standard_normal((4, 3, 4)) * (np.arange(4) > 0)[:, None, None]  # the first is static
    affine = ccd.AffineMotion(*maps)
    rigid = mesh.rigid[mesh.vertex_body]
    start, stop = mesh.vertices.copy(), end.copy()
    start[rigid] = affine.positions_t0(mesh.vertices[rigid], mesh.vertex_body[rigid])
    stop[rigid] = affine.positions_t1(mesh.vertices[rigid], mesh.vertex_body[rigid])
    expected = ccd.mesh_ccd(mesh, start, stop, device="cpu")
    assert len(expected.contacts) > 5
    assert different(outputs(expected), outputs(result_of(mesh, end, affine))) == []
    searched = ccd.line_search(mesh, mesh.vertices, end, motion=affine, device="cpu")
    assert searched.fraction == ccd.line_search(mesh, start, stop, device="cpu").fraction
    with pytest.raises(ValueError, match="3 rows for 4 rigid bodies"):
        result_of(mesh, end, ccd.AffineMotion(maps[0][:3], maps[1][:3]))


def test_bad_motions_are_refused_by_name():
    mesh, end, motion = tumbling_boxes()
    plain = ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]])])
    one = ccd.RigidMotion([AT_REST], [AT_REST])
    moves_static = ccd.RigidMotion([AT_REST] * 4, [[0, 0, 0, 0, 0, np.sin(0.05), np.cos(0.05)]] * 4)
    moved = mesh.vertices.copy()
    moved[9] += 1e-9
    for words, arguments, options in (
        ("no body of the mesh is rigid", (plain, BLADE, BLADE), {"motion": one}),
        ("1 row for 4 rigid bodies", (mesh, mesh.vertices, end), {"motion": one}),
        ("body 0, which is static", (mesh, mesh.vertices, end), {"motion": moves_static}),
        ("another row for vertex 9", (mesh, mesh.vertices, moved), {"motion": motion}),
        ("method is 'bisection'", (mesh, mesh.vertices, end), {"motion": motion, "method": "bisection"}),
        ("start_gap_fraction is 0.5", (mesh, mesh.vertices, end), {"motion": motion, "start_gap_fraction": 0.5}),
        ("motion is", (mesh, mesh.vertices, end), {"motion": motion.poses_t0}),
    ):
        with pytest.raises((ValueError, TypeError), match=words):
            ccd.mesh_ccd(*arguments, device="cpu", **options)
    with pytest.raises(ValueError, match="rigid holds body 5, a half-space"):
        ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]])] * 5 + [GROUND], rigid=[5])
    worlds = ccd.CollisionMesh.from_arrays(
        [(BLADE, NO_FACES)], rigid=[0], codimensional_points=True, vertex_world=[0, 0, 1]
    )
    with pytest.raises(ValueError, match="body 0, which is rigid, has vertices in worlds 0 and 1"):
        ccd.mesh_ccd(worlds, BLADE, BLADE, motion=one, device="cpu")
    assert len(result_of(mesh, end, motion).contacts)
