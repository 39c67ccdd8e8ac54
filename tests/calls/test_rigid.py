"""Calls with bodies that turn: what they say of scenes whose answers are known."""

import warnings

import numpy as np
import pytest
import trimesh
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


@pytest.mark.parametrize("call", ["mesh_ccd", "find_candidates", "line_search", "launch", "launch_line_search"])
def test_rigid_bodies_without_a_motion_are_said_to_move_straight_once(call):
    mesh, _ = blade_and_points([at_angle(1.0), at_angle(2.0)], static=[1], rigid=[0, 1])
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh, device="cpu")
    with pytest.warns(RuntimeWarning, match="motion is None, and body 0 is rigid: vertices move on straight lines"):
        getattr(pipeline, call)(x, x.copy())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        getattr(pipeline, call)(x, x.copy())
        pipeline.is_step_collision_free(x, x)
        still, _ = blade_and_points([at_angle(1.0)], static=[0], rigid=[0])
        getattr(ccd.CollisionPipeline(still, device="cpu"), call)(still.vertices, still.vertices.copy())
        ccd.rigid_ccd(mesh, [AT_REST] * 3, [AT_REST] * 3, device="cpu")


@pytest.mark.parametrize(
    ("poses", "found"),
    [
        ([AT_REST], "1 body; expected 3 bodies, those of the mesh but half-spaces, static ones included$"),
        ([[AT_REST] * 2] * 4, "2 bodies in each of 4 worlds; expected 3 bodies, .* included$"),
        ([AT_REST] * 6, "6 bodies; expected 3 bodies, .* included; those of several worlds have an axis of worlds in"),
    ],
)
def test_as_many_poses_as_there_are_bodies_no_others(poses, found):
    mesh, _ = blade_and_points([at_angle(1.0), at_angle(2.0)], static=[1])
    with pytest.raises(ValueError, match=f"poses_t0 is of {found}"):
        ccd.rigid_ccd(mesh, poses, poses, device="cpu")
    with pytest.raises(ValueError, match="poses_t0 is of 3 bodies; expected 6 bodies"):
        ccd.rigid_ccd(mesh.replicate(2), [AT_REST] * 3, [AT_REST] * 3, device="cpu")


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


@pytest.mark.parametrize("far", [np.nan, 1e9])
def test_vertices_that_take_no_part_make_no_body_larger(far):
    """Of a body, its sphere in a tree of parts, and its reach on joints."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    stray = (np.vstack([[[far] * 3], ball.vertices]), ball.faces + 1)
    tois = []
    for body in ((ball.vertices, ball.faces), stray):
        mesh = ccd.CollisionMesh.from_arrays([body, body, (BLADE - [0, 0, 3], [[0, 1, 2]])], rigid=[0, 1], static=[2])
        x, end = mesh.vertices, mesh.vertices.copy()
        end[mesh.unused_vertices] = 0.0  # and stand in no frame
        poses = np.array([[[0.0, 0, 5, 0, 0, 0, 1], AT_REST], [[0.0, 0, 0, 0, 0, 1, 1], about_z(0.2)]])
        motion, pipeline = ccd.RigidMotion(*poses), ccd.CollisionPipeline(mesh, device="cpu")
        joint = ccd.Joint(name="a", parent="world", child="u", kind="prismatic", axis=[0, 0, -1], origin=poses[0, 0])
        arm = ccd.JointMotion([joint], [0.0], [9.0], links=["u", "world"])
        many = ccd.RigidMotion(*(np.repeat(each[None], 3, axis=0) for each in poses))
        found = [pipeline.mesh_ccd(x, end, motion=each).world_toi.tolist() for each in (motion, motion, many, arm)]
        found += [pipeline.line_search(x, end, motion=motion, per="body").fraction]
        tois.append([*found, pipeline.launch(x, end, motion=motion).toi.numpy().tolist()])
    assert tois[0] == tois[1] and 0.5 < tois[0][0][0] < 0.7 and tois[0][3][0] < 0.4


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
def test_square_in_the_plane_that_falls_and_tumbles_lands_on_a_corner(turn):
    """By every call, on half of the plane and on the point of a wedge under its middle."""
    square = (np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]) / 2, [[0, 1], [1, 2], [2, 3], [3, 0]])
    t = np.linspace(0, 1, 1_000_001)
    height, twist = 1.2 - t, [[0, -1.0, 0, 0, 0, turn]]
    reach = (
        0.5 * (abs(np.cos(turn * t)) + abs(np.sin(turn * t))),
        0.5 / np.maximum(*np.abs([np.cos(turn * t), np.sin(turn * t)])),
    )
    drop = [[0, 1.2, 0, 0, 0, 0, 1]]
    wedge = (np.array([[-9.0, -9], [0, 0], [9, -9]]), [[0, 1], [1, 2]])
    for ground, below in zip((ccd.HalfSpace([0, 0], [0, 1]), wedge), reach, strict=True):
        mesh = ccd.CollisionMesh.from_arrays([square, ground], static=[1], rigid=[0])
        motion, x = ccd.RigidMotion(drop, twist=twist), mesh.vertices
        lands = t[np.argmax(height <= below)]
        pipeline = ccd.CollisionPipeline(mesh, device="cpu")
        result = pipeline.mesh_ccd(x, x, motion=motion)
        assert result.toi == pytest.approx(lands, abs=2e-6)
        assert result.contacts.normal[0] == pytest.approx([0, 1], abs=1e-6) or below is reach[1]
        assert result.contacts.points.shape[1] == result.contacts.relative_velocity.shape[1] == 2
        launched = pipeline.launch(x, x.copy(), motion=motion).to_host()
        assert launched.toi == result.toi == pipeline.collision_free_step(x, x, motion=motion)
        assert np.array_equal(launched.contacts.points, result.contacts.points)
        found = pipeline.line_search(x, x, motion=motion)
        assert 0.89 * lands < found.fraction < lands and pipeline.mesh_ccd(x, x, motion=found.motion).toi == np.inf
        on_device = pipeline.launch_line_search(x, x.copy(), motion=motion).motion
        assert on_device.poses_t1 == pytest.approx(found.motion.poses_t1, abs=1e-12)
        worlds = ccd.RigidMotion([drop, drop], twist=[twist, np.zeros((1, 6))])
        assert pipeline.mesh_ccd(x, x, motion=worlds).world_toi.tolist() == [result.toi, np.inf]
        assert pipeline.mesh_ccd(x, x, motion=motion, check_start=True).start.num_crossing == 0


@pytest.mark.parametrize(
    ("poses", "twist", "message"),
    [
        ([0, 0, 1, 0, 0, 0, 1], [0] * 6, "takes body 1 out of the plane of the mesh: z of its place at the start is 1"),
        ([0, 0, 0, 1, 0, 0, 0], [0] * 6, "x and y of its quaternion at the start are 1.0 and 0.0"),
        ([0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0.5, 0], "x and y of its rotation vector are 0.0 and 0.5"),
        ([0, 0, 0, 0, 0, 0, 1], [0, 0, -2, 0, 0, 3], r"z of its displacement is -2.0; expected 0, .* \(x, y, 0\)"),
    ],
)
def test_body_that_leaves_the_plane_of_its_mesh_is_refused(poses, twist, message):
    bar = (np.array([[0.0, 0], [1, 0]]), [[0, 1]])
    mesh = ccd.CollisionMesh.from_arrays([bar, bar], rigid=[0, 1])
    at_rest = [AT_REST, [0, 3, 0, 0, 0, 0, 1]]
    with pytest.raises(ValueError, match=message):
        ccd.rigid_ccd(mesh, [AT_REST, poses], twist=[[0] * 6, twist], device="cpu")
    worlds = [at_rest, [AT_REST, poses]], [np.zeros((2, 6)), [[0] * 6, twist]]
    with pytest.raises(ValueError, match="body 1 in world 1 out of the plane"):
        ccd.rigid_ccd(mesh, worlds[0], twist=worlds[1], device="cpu")
    arm = ccd.JointMotion([ccd.Joint("j", "base", "arm", "revolute", axis=[0, 0, 1])], [0], [1])
    with pytest.raises(ValueError, match="the mesh is in the plane; expected a RigidMotion about z"):
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=arm, device="cpu")


def test_bar_in_the_plane_that_stretches_and_turns_by_a_map():
    bar, point = (np.array([[0.0, 0], [1, 0]]), [[0, 1]]), (np.array([[0.0, 0]]), NO_FACES[:, :2])
    mesh = ccd.CollisionMesh.from_arrays([bar, point], rigid=[0, 1])
    start = np.array([np.eye(3, 4), [[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, 0]]])
    end = start.copy()
    end[0, :2, :2] = [[0, -4], [4, 0]]  # its end goes from (1, 0) to (0, 4), and the bar over (0.5, 0.5)
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=ccd.AffineMotion(start, end), device="cpu").toi
    assert toi == pytest.approx(0.2, abs=1e-12)  # (1 - t) = 4 t
    end[0, 2, 0] = 1
    with pytest.raises(
        ValueError, match=r"affine_t1 takes body 0 out of the plane .* third row is \[1.0, 0.0, 1.0, 0.0\]"
    ):
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=ccd.AffineMotion(start, end), device="cpu")


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
