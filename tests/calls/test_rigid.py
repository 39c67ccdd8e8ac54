"""Calls with bodies that turn: what they promise, in scenes whose answers are known."""

import warnings

import numpy as np
import pytest
import trimesh
from expected_warnings import OF_ROUNDING

import ccd_warp as ccd
from ccd_warp._rigid import motion_worlds

pytestmark = [OF_ROUNDING, pytest.mark.filterwarnings("ignore:motion is None")]

AT_REST = [0.0, 0, 0, 0, 0, 0, 1]
BLADE, FACE, NO_FACES = np.array([[0.25, 0, 0], [2, 0, 0], [2, 0, 0.5]]), [[0, 1, 2]], np.zeros((0, 3), dtype=int)
POINT, GROUND = (np.zeros((1, 3)), NO_FACES), ccd.HalfSpace([0, 0, 0], [0, 0, 1])
BOX = trimesh.creation.box((1, 1, 1))


def about_z(angle, place=(0.0, 0, 0)):
    return [*place, 0, 0, np.sin(angle / 2), np.cos(angle / 2)]


def at_angle(angle, radius=1.5):
    return [radius * np.cos(angle), radius * np.sin(angle), 0.05]


def fan(angles, places, **options):
    """Blades about z at these angles, points in their way, static ones, as further bodies; and the poses of all."""
    bodies = [*[(BLADE, FACE)] * len(angles), *[POINT] * len(places)]
    rigid = range(len(bodies))
    options = {"static": rigid[len(angles) :], "rigid": rigid} | options
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, **options)
    return mesh, np.array([*map(about_z, angles), *([*place, 0, 0, 0, 1] for place in places)])


def spins(poses, *turns):
    """A motion in which the first bodies turn about z by these angles."""
    twist = np.zeros((len(poses), 6))
    twist[: len(turns), 5] = turns
    return ccd.RigidMotion(poses, twist=twist)


@pytest.mark.filterwarnings("default:motion is None")
@pytest.mark.parametrize("call", ["mesh_ccd", "find_candidates", "line_search", "launch", "launch_line_search"])
def test_rigid_bodies_without_a_motion_are_said_to_move_straight_once(call):
    (mesh, _), (still, _) = fan([0.0], [at_angle(2.0)]), fan([], [at_angle(1.0)])
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh)
    with pytest.warns(RuntimeWarning, match="motion is None, and body 0 is rigid: vertices move on straight lines"):
        getattr(pipeline, call)(x, x.copy())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        getattr(pipeline, call)(x, x.copy())
        pipeline.is_step_collision_free(x, x)
        getattr(ccd.CollisionPipeline(still), call)(still.vertices, still.vertices.copy())
        ccd.rigid_ccd(mesh, [AT_REST] * 2, [AT_REST] * 2)


def test_bodies_that_turn_beside_one_that_deforms_have_a_result_without_any_pair_of_the_kinds_asked_for():
    mesh = ccd.CollisionMesh.from_arrays([(BLADE, FACE), (BLADE + 9.0, FACE)], rigid=[0]).replicate(2)
    end = mesh.vertices + (mesh.vertex_body % 2)[:, None]
    turns = spins([AT_REST] * 2, 2.0)
    assert ccd.mesh_ccd(mesh, mesh.vertices, end, motion=turns, pair_kinds=["point_point"]).toi == np.inf


@pytest.mark.parametrize(("distance", "motion"), [(4, 10), (5, 16), (4001, 10000)])
def test_particles_as_near_as_subnormal_numbers_meet_while_a_body_turns(distance, motion):
    """Between slices positions are rounded to multiples of the smallest number, a large part of these motions."""
    bodies = [POINT, POINT, (BLADE + [5.0, 0, 0], FACE)]
    mesh, least = ccd.CollisionMesh.from_arrays(bodies, rigid=[2], codimensional_points=True), 2.0**-1074
    start = mesh.vertices.copy()
    start[0, 0] = distance * least
    end = start.copy()
    end[1, 0] = motion * least
    turn = ccd.RigidMotion([[0, 0, 9, 0, 0, 0, 1]], twist=[[0, 0, 0, 0, 0, 0.5]])
    assert ccd.mesh_ccd(mesh, start, end, motion=turn, length_scale=motion * least).toi <= distance / motion


def test_vertices_that_take_no_part_make_no_body_larger(monkeypatch):
    """Of a body, and of its sphere in a tree of parts."""
    for name, value in (("_LARGE_ALONE", 0), ("_FEW", 9.0)):
        monkeypatch.setattr(motion_worlds, name, value)
    ball, tois = trimesh.creation.icosphere(subdivisions=2), []
    strays = [(np.vstack([[[far] * 3], ball.vertices]), ball.faces + 1) for far in (np.nan, 1e9)]
    for body in ((ball.vertices, ball.faces), *strays):
        mesh = ccd.CollisionMesh.from_arrays([body, body, (BLADE - [0, 0, 3], FACE)], rigid=[0, 1], static=[2])
        x, end = mesh.vertices, mesh.vertices.copy()
        end[mesh.unused_vertices] = 0.0  # and stand in no frame
        poses = np.array([[[0.0, 0, 5, 0, 0, 0, 1], AT_REST], [[0.0, 0, 0, 0, 0, 1, 1], about_z(0.2)]])
        motion, pipeline = ccd.RigidMotion(*poses), ccd.CollisionPipeline(mesh)
        many = ccd.RigidMotion(*np.repeat(poses[:, None], 3, axis=1))
        found = [pipeline.mesh_ccd(x, end, motion=each).world_toi.tolist() for each in (motion, motion, many)]
        found += [pipeline.line_search(x, end, motion=motion, per="body").fraction]
        tois.append([*found, pipeline.launch(x, end, motion=motion).toi.numpy().tolist()])
    assert tois[0] == tois[1] == tois[2] and 0.5 < tois[0][0][0] < 0.7


# --- paths that are known up to a length ---


def approaching(within, gap=1.0, speed=2.0):
    """A cube that falls on another one through a gap, which may be off its path by as much as that one."""
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX], rigid=[0, 1])
    poses = np.array([[0.1, 0.2, 0.5 + gap, 0, 0, 0, 1], [0, 0, -0.5, 0, 0, 0, 1]])
    twist = np.eye(1, 6, 2) * [[-speed], [0.0]]
    return mesh, ccd.RigidMotion(poses, twist=twist, within=within)


def test_bodies_that_may_be_off_their_paths_touch_as_much_earlier(precision):
    for within, lands in ((0.0, 0.5), (0.1, 0.4), ([0.25, 0.0], 0.375), ([0.25, 0.5], 0.125), ([1.0, 1.0], 0.0)):
        mesh, motion = approaching(within)
        pipeline, x = ccd.CollisionPipeline(mesh, precision=precision), mesh.vertices
        result, found = pipeline.mesh_ccd(x, x, motion=motion), pipeline.line_search(x, x, motion=motion)
        assert result.toi == pytest.approx(lands, abs=1e-5) and result.toi <= lands
        of_poses = {"poses_t1": motion.poses_t1, "within": within, "precision": precision}
        assert ccd.rigid_ccd(mesh, motion.poses_t0, **of_poses).toi == result.toi
        assert pipeline.launch(x, x.copy(), motion=motion).to_host().toi == result.toi
        assert found.fraction == pytest.approx(0.9 * lands, abs=1e-5) and np.array_equal(
            found.motion.within, motion.within
        )
        assert pipeline.mesh_ccd(x, x, motion=found.motion).toi == (np.inf if lands else 0.0)
        worlds = ccd.RigidMotion(*2 * [np.repeat(motion.poses_t0[None], 2, axis=0)], within=[[1.0, 1.0], [0.1, 0.1]])
        assert pipeline.mesh_ccd(x, x, motion=worlds).world_toi.tolist() == [0.0, np.inf]
    assert "rounding, or within of the motion, up to 1, hides the gaps of" in str(result.hidden_gaps)
    assert "rounding" not in str(pipeline.mesh_ccd(x, x, motion=approaching(0.1)[1]).hidden_gaps)


@pytest.mark.parametrize("within", [0.24, 0.26, 1e308])
def test_bodies_that_stand_on_their_paths_and_may_be_beside_them_are_no_stationary_pair(within):
    """With a gap of a half; a pair of which nothing moves may touch, and a line search leaves it."""
    mesh, motion = approaching(within, gap=0.5, speed=0.0)
    pipeline, is_free = ccd.CollisionPipeline(mesh), within < 0.25
    result = pipeline.launch_line_search(*step_of(mesh), per="body", motion=motion).to_host()
    found = pipeline.line_search(*step_of(mesh), per="body", motion=motion)
    struck = pipeline.mesh_ccd(*step_of(mesh), motion=motion)
    assert struck.toi == (np.inf if is_free else 0.0)
    assert found.vertex_fraction.tolist() == [float(is_free)] * 16 and (len(found.touching) == 0) == is_free
    assert result.body_fraction.tolist() == [float(is_free)] * 2
    assert len(pipeline.find_candidates(*step_of(mesh), motion=motion).vertex_face) > 0 or is_free
    assert (motion.poses_t1 == motion.at(0.5)).all() and not struck.contacts.relative_velocity.any()  # it shows nowhere


def test_what_starts_within_its_distance_keeps_it_but_for_four_times_the_lengths():
    for up, within, gap in ((1.0, 1e-3, 0.05), (-1.0, 1e-3, 0.05), (1.0, 0.02, 0.05)):
        mesh, motion = approaching(within, gap, -0.5 * up)
        pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.1)
        found = pipeline.line_search(*step_of(mesh), motion=motion)
        launched = pipeline.launch_line_search(*step_of(mesh), motion=motion).to_host()
        least = max(gap - 4 * 2 * within, 0.0) + 2 * within  # on the paths
        for shown in (found.motion, launched.motion):
            assert shown.poses_t1[0, 2] - 0.5 >= least - 1e-12
        if up > 0.0:
            assert found.fraction == launched.body_fraction[0] == 1.0
        else:
            assert 0.0 < found.fraction < 0.1


def test_contacts_of_paths_that_nobody_knows_have_no_gradient():
    mesh, motion = approaching(0.1)
    x, many = mesh.vertices, ccd.RigidMotion(*np.repeat([[motion.poses_t0], [motion.poses_t1]], 2, axis=1), within=0.1)
    for shown in (motion, many):
        contacts = ccd.mesh_ccd(mesh, x, x, motion=shown).contacts
        assert len(contacts)
        with pytest.raises(ValueError, match="those of a motion with within; expected one whose paths are known"):
            contacts.toi_gradient()


# --- line searches ---


def step_of(mesh):
    return mesh.vertices, mesh.vertices.copy()


def test_blades_close_up_one_behind_another_and_those_of_other_worlds_shorten_their_own_time():
    mesh, poses = fan([0.0, 0.3, 0.6], [at_angle(0.9)])
    found = ccd.CollisionPipeline(mesh).launch_line_search(*step_of(mesh), motion=spins(poses, 1, 1, 1), per="body")
    angles = np.array([0.0, 0.3, 0.6]) + found.to_host().body_fraction[:3]
    assert angles[2] == pytest.approx(0.6 + 0.9 * 0.3, abs=1e-12) and (np.diff(angles) > 0.0).all()
    mesh, poses = fan([0.0], [at_angle(0.5)])
    copies, twist = mesh.replicate(3), np.zeros((3, 2, 6))
    twist[:, 0, 5] = [1.0, 0.25, 2.0]
    motion, worlds = ccd.RigidMotion(np.repeat(poses[None], 3, axis=0), twist=twist), copies.vertices.reshape(3, -1, 3)
    for per, expected in (("world", [0.45, 1.0, 0.225]), ("scene", [0.225] * 3)):
        found = ccd.CollisionPipeline(copies).launch_line_search(worlds, worlds.copy(), per=per, motion=motion)
        assert found.body_fraction.numpy()[::2] == pytest.approx(expected, abs=1e-12)
        assert found.motion.turns[:, 0] == pytest.approx(np.array(expected) * twist[:, 0, 5], abs=1e-12)


@pytest.mark.parametrize("up", [0.0, 0.15])
def test_kinematic_rotor_goes_on_through_what_stays_or_is_stopped_and_says_so(up):
    """A point that stays is passed through; one that rises is shortened first, again and again, until it stays."""
    mesh, poses = fan([0.0], [at_angle(0.5)], static=[], kinematic=[0])
    motion = ccd.RigidMotion(poses, twist=[[0, 0, 0, 0, 0, 1.0], [0, 0, up, 0, 0, 0]])
    found = ccd.CollisionPipeline(mesh).launch_line_search(*step_of(mesh), motion=motion).to_host()
    assert found.flags == ccd.LaunchFlag.STRUCK and found.contacts.toi == pytest.approx(0.5, abs=1e-12)
    assert found.body_fraction.tolist() == [1.0, 1.0 if up == 0.0 else 0.0]
    struck = ccd.line_search(mesh, *step_of(mesh), motion=motion).struck
    assert struck.toi == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("other", ["box", "ground"])
@pytest.mark.parametrize("spin", [0.0, 0.3, 3.0])
def test_box_within_its_distance_leaves_and_slides_but_comes_no_nearer(other, spin):
    """A launch that is no search says that it starts within its distance."""
    box = other == "box"
    below = (BOX.vertices * [3, 3, 1] - [0, 0, 1], BOX.faces) if box else ccd.HalfSpace([0, 0, -0.5], [0, 0, 1])
    mesh = ccd.CollisionMesh.from_arrays([(BOX.vertices, BOX.faces), below], static=[1], rigid=[0])
    pipeline, along = ccd.CollisionPipeline(mesh, minimum_distance=0.01), [0.0 if box else 0.2, 0, 0.5 * box]
    for linear, least, most in (([0, 0, 0.5], 1.0, 1.0), (along, 1.0, 1.0), ([0, 0, -0.1], 0.0, 1e-9)):
        motion = ccd.RigidMotion([[0, 0, 0.005, 0, 0, 0, 1]], twist=[[*linear, 0, 0, spin]])
        fraction = pipeline.line_search(*step_of(mesh), motion=motion).fraction
        launched = pipeline.launch_line_search(*step_of(mesh), motion=motion).to_host()
        assert least <= fraction <= most and least <= launched.body_fraction[0] <= most
        assert launched.toi == np.inf and launched.motion.poses_t1[0, 2] >= 0.005 - 1e-9 * (least == 0)
        assert pipeline.launch(*step_of(mesh), motion=motion).to_host().toi == 0.0


@pytest.mark.parametrize("wall", ["static", "kinematic", "half-space"])
def test_points_that_roll_out_and_come_back_within_a_slice_do_not_stay(wall, precision):
    """To x = 1, through a wall at 0.998; their places at both ends of the slice are often equal in every bit."""
    turns, places = np.random.default_rng(0).uniform(0.19, 0.199, 40), np.arange(40)[:, None] * [0.0, 0, 3]
    face, count, none = np.array([[0.998, -1, -1], [0.998, 1, -1], [0.998, 0, 1]]), 40, np.zeros(40)
    walls, options = [(face + place, FACE) for place in places], {wall: range(count, 2 * count)}
    if wall == "half-space":
        walls, options = [ccd.HalfSpace([0.998, 0, 0], [-1, 0, 0])], {}
    bodies = [(np.array([[1.0, 0, 0]]), NO_FACES)] * count + walls
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, rigid=range(count), **options)
    poses = np.column_stack([places, none, none, np.sin(-turns / 4), np.cos(turns / 4)])
    motion = ccd.RigidMotion(poses, twist=np.column_stack([none, -2 * np.sin(turns / 2), none, none, none, turns]))
    pipeline = ccd.CollisionPipeline(mesh, precision=precision)
    found = pipeline.launch_line_search(*step_of(mesh), per="body", motion=motion).to_host()
    assert (found.body_fraction[:count] < 0.5).all() and not found.flags & ccd.LaunchFlag.STRUCK
    of_host = pipeline.line_search(*step_of(mesh), per="body", motion=motion)
    assert (of_host.vertex_fraction[:count] < 0.5).all() and len(of_host.struck) == 0
    for shown in (found.motion, of_host.motion):
        assert ccd.is_step_collision_free(mesh, *step_of(mesh), motion=shown)


# --- launches ---


def test_static_walls_that_launches_of_both_kinds_have_placed():
    mesh = ccd.CollisionMesh.from_arrays([(BOX.vertices, BOX.faces)] * 2, static=[0], rigid=[1])
    arc = {"motion": ccd.RigidMotion([[3.0, 0, 0, 0, 0, 0, 1]], twist=[[4.0, 0, 0, 0, 0, 0.3]])}
    wall, own = mesh.vertices[:8] + [5.5, 0, 0], mesh.vertices[8:]
    placed = np.concatenate([wall, own])
    for first, second, start, end in (({}, arc, own, own), (arc, {}, own + [3.0, 0, 0], own + [7.0, 0, 0])):
        pipeline = ccd.CollisionPipeline(mesh)
        pipeline.launch(placed, placed, **first)
        with pytest.raises(RuntimeError, match="pass vertices_t0 with a row for every vertex"):
            pipeline.launch(start, end.copy(), **second)
        toi = pipeline.launch(*(np.concatenate([wall, x]) for x in (start, end)), **second).to_host().toi
        for _ in range(2):
            assert pipeline.launch(start, end.copy(), **second).to_host().toi == toi and 0.3 < toi < 0.4
            pipeline.reserve(vertices=placed)


def test_radii_that_change_between_launches():
    mesh = ccd.CollisionMesh.from_arrays([POINT, GROUND], rigid=[0], codimensional_points=True, radius=[0.1])
    motion, pipeline = (
        ccd.RigidMotion([[0, 0, 1, 0, 0, 0, 1]], twist=[[0, 0, -2, 0, 0, 1]]),
        ccd.CollisionPipeline(mesh),
    )
    for radius in (0.1, 0.3, 0.1):
        pipeline.radius.assign(np.array([radius]))
        toi = pipeline.launch(*step_of(mesh), motion=motion).to_host().toi
        assert toi == pytest.approx(0.5 * (1.0 - radius), abs=1e-12) and toi <= 0.5 * (1.0 - radius)


def test_twice_the_pairs_of_any_slice_is_enough():
    """A blade meets a wall soon after the begin of its turn, and nothing in the slices that follow."""
    mesh, poses = fan([0.0], [at_angle(a, r) for a in np.linspace(0.05, 0.4, 30) for r in (0.7, 1.7)])
    for name in ("launch", "launch_line_search"):
        pipeline = ccd.CollisionPipeline(mesh, max_pairs=1)
        call = lambda: getattr(pipeline, name)(*step_of(mesh), motion=spins(poses, 3.0)).to_host()  # noqa: B023, E731
        found = call()
        assert found.flags == ccd.LaunchFlag.PAIRS_OVERFLOW
        pipeline.reserve(max_pairs=2 * max(found.num_pairs.values()))
        assert call().flags == 0


def toothed_plate(z, teeth=150):
    """A ring in a plane, with teeth outside."""
    k, angles = np.arange(2 * teeth), np.pi * np.arange(2 * teeth) / teeth
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    outer, after = ring * (1.0 + 0.1 * (k % 2))[:, None], (k + 1) % len(k)
    faces = np.concatenate([np.stack([k, after, k + len(k)], 1), np.stack([after, after + len(k), k + len(k)], 1)])
    return np.column_stack([np.concatenate([outer, 0.3 * ring]), np.full(2 * len(k), z)]), faces


@pytest.mark.parametrize("turn", [0.1, 1.0])
def test_plates_that_turn_in_planes_side_by_side_form_no_pair(turn):
    mesh = ccd.CollisionMesh.from_arrays([toothed_plate(0.0), toothed_plate(1e-3)], rigid=[0, 1])
    pipeline, motion = ccd.CollisionPipeline(mesh), spins(np.array([AT_REST, AT_REST]), turn, -turn)
    for shift in (0.0, 0.25):  # rows that the pipeline does not know beforehand
        rows = mesh.vertices + shift
        found = [pipeline.launch(rows, rows, motion=motion).to_host(), pipeline.mesh_ccd(rows, rows, motion=motion)]
        assert [x.toi for x in found] == [np.inf, np.inf] and not any(found[0].num_pairs.values())
        assert not any(found[1].counts.num_candidates.values())


# --- bad use ---


def test_motions_that_do_not_fit_are_refused_by_name():
    mesh, poses = fan([0.0], [at_angle(0.5)])
    points = {"codimensional_points": True}
    split = ccd.CollisionMesh.from_arrays([(BLADE, NO_FACES)], rigid=[0], vertex_world=[0, 0, 1], **points)
    bar = ccd.CollisionMesh.from_arrays([(np.array([[0.0, 0], [1, 0]]), [[0, 1]])] * 2, rigid=[0, 1])
    one, motion, three = ccd.RigidMotion(poses[:1], poses[:1]), spins(poses, 1.0), np.tile(AT_REST, (3, 1))

    def moved(mesh, motion, end=0.0, **options):
        return lambda: ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + end, motion=motion, **options)

    def turned(pose, twist):
        return lambda: ccd.rigid_ccd(bar, [AT_REST, pose], twist=[[0] * 6, twist])

    for call, message in (
        (moved(mesh, one), "1 row for 2 rigid bodies of the mesh, body 0, body 1; expected one a body, or more bodies"),
        (moved(mesh, spins(poses, 1, 1)), "body 1, which is static"),
        (moved(mesh, ccd.RigidMotion(poses, poses, within=0.1)), "within of the motion lets body 1 leave .* is static"),
        (moved(mesh, motion, 1e-9 * np.eye(4, 1)), "another row for vertex 0"),
        (moved(mesh, motion, method="bisection"), "method is 'bisection'"),
        (moved(mesh, motion, start_gap_fraction=0.5), "start_gap_fraction is 0.5"),
        (moved(split, one), "body 0, which is rigid, has .* worlds 0 and 1"),
        (lambda: ccd.rigid_ccd(mesh, [*three] * 2, [*three] * 2), "6 bodies; .* of several worlds have an axis of"),
        (turned([0, 0, 0, 1, 0, 0, 0], [0] * 6), "x and y of its quaternion at the start are 1.0 and 0.0"),
        (turned(AT_REST, [0, 0, 0, 0, 0.5, 0]), "x and y of its rotation vector are 0.0 and 0.5"),
        (turned(AT_REST, [0, 0, -2, 0, 0, 3]), r"z of its displacement is -2.0; expected 0, .* \(x, y, 0\)"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
