"""Calls with bodies that turn: what they say of scenes whose answers are known, and that nothing else changes them."""

import numpy as np
import pytest
import scenes
import trimesh
from ccd_warp.benchmarks.gpu_check.outputs import different, outputs_of
from expected_warnings import OF_ROUNDING

import ccd_warp as ccd

pytestmark = OF_ROUNDING

AT_REST = [0.0, 0, 0, 0, 0, 0, 1]
BLADE = np.array([[0.0, 0, 0], [2, 0, 0], [2, 0, 0.5]])
NO_FACES = np.zeros((0, 3), dtype=int)
GROUND = ccd.HalfSpace([0, 0, 0], [0, 0, 1])


def about_z(angle, place=(0.0, 0, 0)):
    return [*place, 0, 0, np.sin(angle / 2), np.cos(angle / 2)]


def blade_and_points(places, **options):
    """A triangle that may turn about z, and points at these places as further bodies, in their own frames."""
    bodies = [(BLADE, [[0, 1, 2]]), *[(np.zeros((1, 3)), NO_FACES) for _ in places]]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, **options)
    return mesh, [[*place, 0, 0, 0, 1] for place in places]


def at_angle(angle, radius=1.5):
    return [radius * np.cos(angle), radius * np.sin(angle), 0.05]


@pytest.mark.parametrize("turn", [0.01, 0.5, 2.0, 3.0])
def test_blade_that_sweeps_a_point_meets_it_where_the_arc_does(turn):
    mesh, at_rest = blade_and_points([at_angle(0.7 * turn)], static=[1])
    result = ccd.rigid_ccd(mesh, [AT_REST, *at_rest], [about_z(turn), *at_rest], device="cpu")
    assert result.toi == pytest.approx(0.7, abs=1e-11 / turn)
    assert result.toi <= 0.7
    assert result.contacts.points == pytest.approx(np.array([at_angle(0.7 * turn)]), abs=1e-10)
    normal = [-np.sin(0.7 * turn), np.cos(0.7 * turn), 0.0]  # the blade has no thickness, and comes from behind
    assert result.contacts.normal[0] @ normal == pytest.approx(1.0, abs=1e-9)


def test_half_a_turn_is_not_a_chord():
    """On chords the blade would shrink into its middle, and pass under what lies beside its arc."""
    mesh, at_rest = blade_and_points([at_angle(np.pi / 2), at_angle(np.pi / 2, 2.01)], static=[1, 2])
    twist = [[0, 0, 0, 0, 0, np.pi], *np.zeros((2, 6))]
    result = ccd.rigid_ccd(mesh, [AT_REST, *at_rest], twist=twist, device="cpu")
    assert result.body_toi[1] == pytest.approx(0.5, abs=1e-12)
    assert result.body_toi[2] == np.inf


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_arc_meets_what_no_box_of_its_chord_does(broad_phase):
    """A point at the end of a long arm, and a small face at the middle of its arc, a twentieth beyond the chord."""
    face = np.array([[9.99, 0, -0.01], [10.01, 0, -0.01], [10.0, 0, 0.02]])
    bodies = [(np.array([[10.0, 0, 0]]), NO_FACES), (face, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, static=[1])
    options = {"broad_phase": broad_phase, "device": "cpu"}
    for turn in (0.01, 0.2, 0.39):
        poses_t0, poses_t1 = ([about_z(angle), AT_REST] for angle in (-0.5 * turn, 0.5 * turn))
        result = ccd.rigid_ccd(mesh, poses_t0, poses_t1, **options)
        assert result.toi == pytest.approx(0.5, abs=1e-11 / turn)
    motion = ccd.RigidMotion(poses_t0, poses_t1)
    bodies = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, static=[1], rigid=[0, 1])
    found = ccd.find_candidates(bodies, bodies.vertices, bodies.vertices, motion=motion, **options)
    assert found.vertex_face.tolist() == [[0, 0]]


def test_several_turns_in_a_step_list_each_pair_once_and_first():
    places = [at_angle(angle) for angle in (1.0, 4.0, 6.0)]
    mesh, at_rest = blade_and_points(places, static=[1, 2, 3])
    twist = [[0, 0, 0, 0, 0, 6 * np.pi], *np.zeros((3, 6))]
    result = ccd.rigid_ccd(mesh, [AT_REST, *at_rest], twist=twist, device="cpu")
    assert len(result.contacts) == 3
    assert result.contacts.toi == pytest.approx(np.array([1.0, 4.0, 6.0]) / (6 * np.pi), abs=1e-12)
    assert result.vertex_contact[0] == result.body_contact[0] == 0  # that of the least toi


def test_body_that_turns_alone_meets_nothing():
    """A triangle has no pair at all, so no slice of the step has a list of contacts."""
    mesh = ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]])])
    result = ccd.rigid_ccd(mesh, [AT_REST], twist=[[0, 0, 0, 0, 0, 1.0]], device="cpu")
    assert result.toi == np.inf
    assert len(result.contacts) == 0


@pytest.mark.parametrize(("distance", "motion"), [(4, 10), (5, 16), (4001, 10000)])
def test_particles_as_near_as_subnormal_numbers_meet_while_a_body_turns(distance, motion):
    """Between slices positions are rounded to multiples of the smallest number, a large part of these motions."""
    point, face = (np.zeros((1, 3)), NO_FACES), (BLADE + [5.0, 0, 0], [[0, 1, 2]])
    mesh = ccd.CollisionMesh.from_arrays([point, point, face], rigid=[2], codimensional_points=True)
    least = 2.0**-1074
    start = mesh.vertices.copy()
    start[0, 0] = distance * least
    end = start.copy()
    end[1, 0] = motion * least
    turn = ccd.RigidMotion([[0, 0, 9, 0, 0, 0, 1]], twist=[[0, 0, 0, 0, 0, 0.5]])
    toi = ccd.mesh_ccd(mesh, start, end, motion=turn, length_scale=motion * least, device="cpu").toi
    assert toi <= distance / motion


def test_gap_of_a_blade_that_meets_points_is_that_of_the_arc_not_of_its_chord():
    """The distance of a point is its radius times the sine of the angle that is left of many turns."""
    angles = np.linspace(0.3, 6.0, 24)
    mesh, at_rest = blade_and_points([at_angle(angle) for angle in angles], static=range(1, 25))
    twist = [[0, 0, 0, 0, 0, 40.0], *np.zeros((24, 6))]
    result = ccd.rigid_ccd(mesh, [AT_REST, *at_rest], twist=twist, device="cpu")
    contacts = result.contacts[result.contacts.kind == int(ccd.PairKind.VERTEX_FACE)]
    assert len(contacts) == 24
    places = mesh.body_vertex_range[:-1].tolist()
    of_point = [at_rest[places.index(v) - 1] for v in contacts.primitives[:, 0]]
    x, y, _, *_ = np.array(of_point, dtype=np.longdouble).T
    turned = np.longdouble(40.0) * contacts.toi.astype(np.longdouble)
    distance = np.cos(turned) * y - np.sin(turned) * x
    assert (np.abs(distance) <= contacts.gap).all()
    assert contacts.gap.max() < 1e-10


def test_pendulum_that_dips_into_a_ground_is_counted_in_all_slices():
    """It is under the ground in the middle of the step, and far from it where the step ends."""
    bob = (np.array([[0.0, 0, -1]]), NO_FACES)
    mesh = ccd.CollisionMesh.from_arrays([bob, GROUND], rigid=[0], codimensional_points=True)
    poses = [[[0, 0, 0.99, 0, np.sin(angle / 2), 0, np.cos(angle / 2)]] for angle in (-1.0, 1.0)]
    x = mesh.vertices
    counts = ccd.mesh_ccd(mesh, x, x, motion=ccd.RigidMotion(*poses), device="cpu").counts
    kind = ccd.PairKind.VERTEX_PLANE
    assert counts.num_contacts[kind] == 1 <= counts.num_after_cull[kind] == counts.num_candidates[kind]
    assert counts.num_searches[kind] == 10  # slices of 0.2 rad


def test_nut_on_a_screw_meets_what_its_helix_does():
    """A point at a distance from an axis that is elsewhere: a whole turn would leave it where it was."""
    mesh = ccd.CollisionMesh.from_arrays(
        [(np.zeros((1, 3)), NO_FACES), (BLADE, [[0, 1, 2]])], codimensional_points=True, static=[1]
    )
    # two turns about the axis through (0.75, 0.75), from the origin to (1.5, 0) by a quarter of a turn; on along z
    twist = [[3 * np.pi, -3 * np.pi, 0.8, 0, 0, 4 * np.pi], np.zeros(6)]
    result = ccd.rigid_ccd(mesh, [[0, 0, -0.01, 0, 0, 0, 1], AT_REST], twist=twist, path="screw", device="cpu")
    assert result.toi == pytest.approx(0.125, abs=1e-12)
    assert result.contacts.points == pytest.approx(np.array([[1.5, 0.0, 0.09]]), abs=1e-12)


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.5, 7.0])
def test_cube_that_falls_and_tumbles_lands_on_an_edge(turn):
    cube = ccd.CollisionMesh.from_trimesh([trimesh.creation.box((1, 1, 1)), GROUND])
    t = np.linspace(0, 1, 1_000_001)
    height = 1.2 - t - 0.5 * (abs(np.cos(turn * t)) + abs(np.sin(turn * t)))
    lands = t[np.argmax(height <= 0)]
    for distance in (0.0, 0.01):
        drop = [[0, 0, 1.2 + distance, *AT_REST[3:]]]
        options = {"twist": [[0, 0, -1.0, turn, 0, 0]], "minimum_distance": distance, "device": "cpu"}
        result = ccd.rigid_ccd(cube, drop, **options)
        assert result.toi == pytest.approx(lands, abs=2e-6)
        assert (result.contacts.kind == int(ccd.PairKind.VERTEX_PLANE)).all()


@pytest.mark.parametrize("gap", [0.01, 0.005, 0.0, -0.1])
@pytest.mark.parametrize(("linear", "angular"), [([0, 0, 1], [0, 0, 0.3]), ([0.2, 0, 0], [0, 0, 3.0])])
def test_face_within_its_distance_of_a_ground_leaves_it_and_spins_on_it(gap, linear, angular):
    face = [[0.0, 0, 0], [1, 0, 0.5], [0, 1, 0.5]]
    mesh = ccd.CollisionMesh.from_arrays([(face, [[0, 1, 2]]), GROUND], rigid=[0])
    step = (mesh, mesh.vertices, mesh.vertices)
    options = {"minimum_distance": 0.01, "device": "cpu"}
    motion = ccd.RigidMotion([[0, 0, gap, 0, 0, 0, 1]], twist=[[*linear, *angular]])
    assert ccd.collision_free_step(*step, motion=motion, **options) == 1.0
    down = ccd.RigidMotion([[0, 0, gap, 0, 0, 0, 1]], twist=[[0, 0, -0.1, *angular]])
    assert ccd.collision_free_step(*step, motion=down, **options) <= 1e-9
    found = ccd.line_search(*step, motion=motion, **options)
    assert found.fraction == 1.0


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


def test_kinematic_rotor_is_not_tested_against_another_one_and_not_shortened():
    mesh, at_rest = blade_and_points([at_angle(0.5)])
    mesh = ccd.CollisionMesh.from_arrays(
        [(BLADE, [[0, 1, 2]]), (np.zeros((1, 3)), NO_FACES)], codimensional_points=True, kinematic=[0], rigid=[0, 1]
    )
    motion = ccd.RigidMotion([AT_REST, *at_rest], twist=[[0, 0, 0, 0, 0, 1.0], np.zeros(6)])
    found = ccd.line_search(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu")
    assert len(found.struck) == 1
    assert found.struck.toi[0] == pytest.approx(0.5, abs=1e-12)
    assert (found.motion.turns == [1.0, 0.0]).all()


def test_bad_motions_are_refused_by_name():
    mesh, end, motion = tumbling_boxes()
    plain = ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]])])
    plane = ccd.CollisionMesh.from_arrays([([[0.0, 0], [1, 0]], [[0, 1]])])
    one = ccd.RigidMotion([AT_REST], [AT_REST])
    moves_static = ccd.RigidMotion([AT_REST] * 4, [about_z(0.1)] * 4)
    moved = mesh.vertices.copy()
    moved[9] += 1e-9
    for words, arguments, options in (
        ("no body of the mesh is rigid", (plain, BLADE, BLADE), {"motion": one}),
        ("mesh in the plane", (plane, plane.vertices, plane.vertices), {"motion": one}),
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
    assert len(result_of(mesh, end, motion).contacts)
