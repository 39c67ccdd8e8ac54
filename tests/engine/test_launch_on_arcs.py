"""Line searches on the device in which bodies turn: where they stop, and that they stay rigid and free."""

import numpy as np
import pytest
import scenes
import trimesh
from expected_warnings import OF_STRAIGHT_MOTION

import ccd_warp as ccd
from ccd_warp import LaunchFlag

AT_REST = [0.0, 0, 0, 0, 0, 0, 1]
BLADE = np.array([[0.25, 0, 0], [2, 0, 0], [2, 0, 0.5]])
NO_FACES = np.zeros((0, 3), dtype=int)
GROUND = ccd.HalfSpace([0, 0, 0], [0, 0, 1])


def searched(mesh, start, end, motion, pipeline=None, search=None, **options):
    """What a line search on the device leaves, and the end positions of the bodies that do not turn."""
    pipeline = pipeline or ccd.CollisionPipeline(mesh, device="cpu", **options)
    rigid = (mesh.rigid & ~mesh.static)[mesh.vertex_body][:, None]
    written = np.where(rigid, -7.0, end)  # rows of bodies that turn are neither read nor written
    found = pipeline.launch_line_search(start, written, motion=motion, **(search or {})).to_host()
    assert (written == -7.0).all(axis=1).tolist() == rigid[:, 0].tolist()
    return found, np.where(rigid, start, written)


def check_free(mesh, start, found, written, **options):
    assert ccd.is_step_collision_free(mesh, start, written, motion=found.motion, device="cpu", **options)


def tumbling():
    """Boxes that turn over a ground, a static one, and a sheet that falls on them."""
    box, rng = trimesh.creation.box((1, 1, 1)), np.random.default_rng(3)
    sheet, faces = scenes.sheet(6)
    bodies = [*[(box.vertices, box.faces)] * 4, (2 * sheet - [1, 1, -1.5], faces), GROUND]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], rigid=[0, 1, 2, 3])
    poses = np.hstack([[[0, 0, 0.6], [1.4, 0, 0.9], [-1.3, 0.5, 0.9], [0.2, 1.5, 1.0]], rng.standard_normal((4, 4))])
    poses[0, 3:] = AT_REST[3:]
    twist = np.hstack([rng.uniform(-0.5, 0.5, (4, 3)) - [0, 0, 0.5], 1.2 * rng.standard_normal((4, 3))])
    twist[0] = 0.0
    falls = np.where(mesh.rigid[mesh.vertex_body], 0.0, 1.0)[:, None] * [0.1, 0, -0.9]
    return mesh, mesh.vertices + falls, ccd.RigidMotion(poses, twist=twist)


@pytest.mark.parametrize("distance", [0.0, 0.02])
def test_boxes_that_tumble_stop_where_the_host_stops_them_in_bits(distance):
    mesh, end, motion = tumbling()
    options = {"minimum_distance": distance, "device": "cpu"}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    for per, shown in (("body", motion), ("scene", motion.shortened(0.4)), ("world", motion), ("body", motion)):
        found, written = searched(mesh, mesh.vertices, end, shown, pipeline, {"per": per})
        expected = ccd.line_search(mesh, mesh.vertices, end, motion=shown, per=per, **options)
        assert 0.0 < expected.fraction < 1.0
        assert expected.num_rounds == 2  # further ones differ: those on the device are fixed
        of_bodies = expected.vertex_fraction[mesh.body_vertex_range[:4]]
        assert found.body_fraction[:4].tolist() == of_bodies.tolist()
        assert (found.body_fraction[4:] == 1.0).all()
        assert (found.motion.poses_t1 == expected.motion.poses_t1).all()
        deforms = mesh.vertex_body == 4
        assert (written[deforms] == expected.vertices[deforms]).all()
        assert not found.flags and found.toi == np.inf and len(found.contacts) == 0
        check_free(mesh, mesh.vertices, found, written, minimum_distance=0.99 * distance)


def test_sheet_that_is_stopped_by_vertices_lets_boxes_go_on():
    """More passes than two, each from the whole path: what the last has left is free."""
    mesh, end, motion = tumbling()
    found, written = searched(mesh, mesh.vertices, end, motion, search={"per": "vertex", "safety": 0.5})
    check_free(mesh, mesh.vertices, found, written)
    fractions = found.body_fraction[1:4]
    assert 0.0 < fractions.min() < fractions.max() == 1.0
    deforms = mesh.vertex_body == 4
    assert (written[deforms] == end[deforms]).all(axis=1).any()


def fan(angles, points, **options):
    """Blades about z at these angles, and static points in their way."""
    bodies = [*[(BLADE, [[0, 1, 2]])] * len(angles), *[(np.zeros((1, 3)), NO_FACES)] * len(points)]
    rigid = range(len(bodies))
    options = {"static": rigid[len(angles) :]} | options
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, rigid=rigid, **options)
    poses = [[0, 0, 0, 0, 0, np.sin(a / 2), np.cos(a / 2)] for a in angles]
    poses += [[np.cos(a), np.sin(a), 0.1, 0, 0, 0, 1] for a in points]
    return mesh, np.array(poses)


def test_blades_of_a_fan_close_up_one_behind_another():
    mesh, poses = fan([0.0, 0.3, 0.6], [0.9])
    twist = np.zeros((4, 6))
    twist[:3, 5] = 1.0
    motion = ccd.RigidMotion(poses, twist=twist)
    found, written = searched(mesh, mesh.vertices, mesh.vertices, motion, search={"per": "body"})
    check_free(mesh, mesh.vertices, found, written)
    assert found.body_fraction[2] == pytest.approx(0.9 * 0.3, abs=1e-12)
    angles = np.array([0.0, 0.3, 0.6]) + found.body_fraction[:3]
    assert (np.diff(angles) > 0.0).all() and angles[-1] < 0.9
    assert (found.motion.turns[:3] == found.body_fraction[:3]).all()


def test_blade_that_was_shortened_once_is_shortened_from_there():
    """A small blade is stopped by a point, and then by a large one, which another point has stopped."""
    bodies = [(scale * BLADE, [[0, 1, 2]]) for scale in (0.5, 1.0)] + [(np.zeros((1, 3)), NO_FACES)] * 2
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, static=[2, 3], rigid=range(4))
    places = [[r * np.cos(a), r * np.sin(a), 0.05, 0, 0, 0, 1] for r, a in ((0.7, 1.5), (1.8, 0.7))]
    poses = [AT_REST, [0, 0, 0, 0, 0, np.sin(0.25), np.cos(0.25)], *places]
    motion = ccd.RigidMotion(poses, twist=np.eye(6)[[5, 5, 0, 0]] * [[2.0], [2.0], [0.0], [0.0]])
    found, written = searched(mesh, mesh.vertices, mesh.vertices, motion, search={"per": "body"})
    check_free(mesh, mesh.vertices, found, written)
    first = 0.9 * np.array([1.5, 0.2])
    meets = 0.5 / (first[0] - first[1])
    assert found.motion.turns[:2] == pytest.approx(0.9 * meets * first, abs=1e-12)


@pytest.mark.parametrize(("per", "expected"), [("world", [0.45, 1.0, 0.225]), ("scene", [0.225] * 3)])
def test_blades_in_worlds_of_their_own_shorten_their_own_time(per, expected):
    mesh, poses = fan([0.0], [0.5])
    copies = mesh.replicate(3)
    twist = np.zeros((3, 2, 6))
    twist[:, 0, 5] = [1.0, 0.25, 2.0]
    motion = ccd.RigidMotion(np.repeat(poses[None], 3, axis=0), twist=twist)
    worlds = copies.vertices.reshape(3, -1, 3)
    written = worlds.copy()
    pipeline = ccd.CollisionPipeline(copies, device="cpu")
    found = pipeline.launch_line_search(worlds, written, per=per, motion=motion)
    assert found.body_fraction.numpy()[::2] == pytest.approx(expected, abs=1e-12)
    assert found.motion.turns[:, 0] == pytest.approx(np.array(expected) * [1.0, 0.25, 2.0], abs=1e-12)


@pytest.mark.parametrize(("up", "expected"), [(0.5, 1.0), (-0.1, 0.0)])
def test_box_within_its_distance_of_another_spins_away_from_it_and_comes_no_nearer(up, expected):
    """In the slices after the first it is not near any more."""
    boxes = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((3, 3, 1))]
    mesh = ccd.CollisionMesh.from_trimesh(boxes, static=[1], rigid=[0])
    motion = ccd.RigidMotion([[0, 0, 1.005, 0, 0, 0, 1]], twist=[[0, 0, up, 0, 0, 1.0]])
    found, _ = searched(mesh, mesh.vertices, mesh.vertices, motion, minimum_distance=0.01)
    assert found.body_fraction[0] == pytest.approx(expected, abs=1e-9)
    assert found.motion.poses_t1[0, 2] >= 1.005


@pytest.mark.parametrize("up", [0.0, 0.15])
def test_kinematic_rotor_goes_on_through_what_stays_or_is_stopped_and_says_so(up):
    """A point that stays is passed through; one that rises is shortened first, again and again, until it stays."""
    mesh, poses = fan([0.0], [0.5], static=[], kinematic=[0])
    motion = ccd.RigidMotion(poses, twist=[[0, 0, 0, 0, 0, 1.0], [0, 0, up, 0, 0, 0]])
    found, _ = searched(mesh, mesh.vertices, mesh.vertices, motion)
    assert found.flags == LaunchFlag.STRUCK
    assert found.body_fraction.tolist() == [1.0, 1.0 if up == 0.0 else 0.0]
    assert found.contacts.toi == pytest.approx(0.5, abs=1e-12)
    assert found.contacts.points == pytest.approx(poses[1:, :3], abs=1e-12)


def test_cloth_that_lies_on_another_does_not_stop_a_rotor_beside_it():
    """Both stay where they are, also in the slices of the step, to the last bit."""
    sheet, faces = scenes.sheet(4)
    sheet = sheet * [1.0, 1.0, 0.0] + [3.1, 0.7, 0.3]
    mesh = ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]]), (sheet, faces), (sheet, faces)], rigid=[0])
    motion = ccd.RigidMotion([AT_REST], twist=[[0, 0, 0, 0, 0, 3.0]])
    found, written = searched(mesh, mesh.vertices, mesh.vertices, motion)
    assert (found.body_fraction == 1.0).all() and found.toi == np.inf
    assert (written == mesh.vertices).all()


def test_motions_that_launches_do_not_take_are_refused_with_what_takes_them():
    mesh, poses = fan([0.0], [0.5])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    joint = ccd.Joint("turn", "base", "arm", "revolute", axis=[0, 0, 1])
    affine = ccd.AffineMotion(np.array([np.eye(3, 4)] * 2), np.array([np.eye(3, 4)] * 2))
    for motion, words in (
        (ccd.JointMotion([joint], [0.0], [1.0]), "expected a RigidMotion for a launch, or a call on the host"),
        (affine, "vertices_t0 and vertices_t1 at motion.positions_t0"),
        (ccd.RigidMotion(poses[:1], poses[:1]), "1 row for 2 rigid bodies"),
    ):
        for launch in (pipeline.launch, pipeline.launch_line_search):
            with pytest.raises(ValueError, match=words):
                launch(mesh.vertices, mesh.vertices.copy(), motion=motion)


@OF_STRAIGHT_MOTION
@pytest.mark.parametrize("moves", ["straight", "on arcs"])
@pytest.mark.parametrize("other", ["box", "ground"])
def test_launch_after_a_line_search_says_what_starts_within_its_distance(moves, other):
    """A box that leaves another, or a ground: it is nearer at the start than it may be, which a search alone allows."""
    box = trimesh.creation.box((1, 1, 1))
    bodies = [(box.vertices, box.faces), (box.vertices - [0, 0, 1.01], box.faces) if other == "box" else GROUND]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], rigid=[0])
    start = mesh.vertices + np.where(mesh.vertex_body[:, None] == 0, [0, 0, 0.51 if other == "ground" else 0.0], 0.0)
    motion = ccd.RigidMotion([AT_REST], twist=[[0, 0, 0.5, 0, 0, 0.3]])
    options = {"minimum_distance": 0.02, "device": "cpu"}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    end = start + np.where(mesh.vertex_body[:, None] == 0, [0, 0, 0.5], 0.0)
    ends = (end, None) if moves == "straight" else (start, motion)
    found = pipeline.launch_line_search(start, ends[0].copy(), motion=ends[1]).to_host()
    assert found.toi == np.inf
    assert pipeline.launch(start, ends[0], motion=ends[1]).to_host().toi == 0.0
    assert pipeline.mesh_ccd(start, ends[0], motion=ends[1]).toi == 0.0


def rolling(count, wall, **options):
    """Points that roll out to x = 1 and back to where they were, each through a wall at 0.998."""
    rng = np.random.default_rng(0)
    turns = rng.uniform(0.19, 0.199, count)  # within one slice
    places = np.arange(count)[:, None] * [0.0, 0, 3]
    bodies = [(np.array([[1.0, 0, 0]]), NO_FACES)] * count + [wall(place) for place in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, rigid=range(count), **options)
    none = np.zeros(count)
    poses = np.column_stack([places, none, none, np.sin(-turns / 4), np.cos(turns / 4)])
    twist = np.column_stack([none, -2 * np.sin(turns / 2), none, none, none, turns])
    return mesh, ccd.RigidMotion(poses, twist=twist)


def face_at(place):
    return np.array([[0.998, -1, -1], [0.998, 1, -1], [0.998, 0, 1]]) + place, [[0, 1, 2]]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("wall", ["static", "kinematic", "half-space"])
def test_points_that_roll_out_and_come_back_within_a_slice_do_not_stay(wall, precision):
    """Their places at both ends of the slice are often equal in every bit."""
    count = 40
    if wall == "half-space":
        _, motion = rolling(count, face_at)
        points = [(np.array([[1.0, 0, 0]]), NO_FACES)] * count
        bodies = [*points, ccd.HalfSpace([0.998, 0, 0], [-1, 0, 0])]
        mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, rigid=range(count))
    else:
        mesh, motion = rolling(count, face_at, **{wall: range(count, 2 * count)})
    x = mesh.vertices
    ends = [motion._body_paths.positions(np.tile([1.0, 0, 0], (count, 1)), np.arange(count), t) for t in (0.0, 1.0)]
    assert (ends[0] == ends[1]).all(axis=1).sum() > 3
    pipeline = ccd.CollisionPipeline(mesh, precision=precision, device="cpu")
    found = pipeline.launch_line_search(x, x.copy(), per="body", motion=motion).to_host()
    assert (found.body_fraction[:count] < 0.5).all() and not found.flags & LaunchFlag.STRUCK
    of_host = pipeline.line_search(x, x, per="body", motion=motion)
    assert (of_host.vertex_fraction[:count] < 0.5).all() and len(of_host.struck) == 0
    assert ccd.is_step_collision_free(mesh, x, x, motion=of_host.motion, device="cpu")
    assert ccd.is_step_collision_free(mesh, x, x, motion=found.motion, device="cpu")


@pytest.mark.parametrize("name", ["launch", "launch_line_search"])
def test_twice_the_pairs_of_any_slice_is_enough(name):
    """A blade meets a wall soon after the begin of its turn, and nothing in the slices that follow."""
    wall, faces = scenes.sheet(6)
    wall = (wall - [0.5, 0.5, 0.0])[:, [0, 2, 1]] * 2 + [1, 0.3, 0.25]
    mesh = ccd.CollisionMesh.from_arrays([(BLADE, [[0, 1, 2]]), (wall, faces)], static=[1], rigid=[0])
    motion = ccd.RigidMotion([AT_REST], twist=[[0, 0, 0, 0, 0, 2.0]])
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", max_pairs=1)
    found = getattr(pipeline, name)(mesh.vertices, mesh.vertices.copy(), motion=motion).to_host()
    assert found.flags == LaunchFlag.PAIRS_OVERFLOW
    pipeline.reserve(max_pairs=2 * max(found.num_pairs.values()))
    assert getattr(pipeline, name)(mesh.vertices, mesh.vertices.copy(), motion=motion).to_host().flags == 0


@OF_STRAIGHT_MOTION
def test_walls_that_one_kind_of_launch_has_placed_are_not_forgotten_by_the_other():
    """A launch with a motion and one without know each where static bodies stand; rows of moving ones do not say it."""
    box = trimesh.creation.box((1, 1, 1))
    mesh = ccd.CollisionMesh.from_arrays([(box.vertices, box.faces)] * 2, static=[0], rigid=[1])
    motion = ccd.RigidMotion([[3.0, 0, 0, 0, 0, 0, 1]], twist=[[4.0, 0, 0, 0, 0, 0.3]])
    placed = mesh.vertices + np.where(mesh.vertex_body[:, None] == 0, [5.5, 0, 0], 0.0)
    own = mesh.vertices[8:]
    start, end = own + [3.0, 0, 0], own + [7.0, 0, 0]
    on_arcs, straight = {"motion": motion}, {}
    for first, second, rows in ((straight, on_arcs, (own, own)), (on_arcs, straight, (start, end))):
        pipeline = ccd.CollisionPipeline(mesh, device="cpu")
        pipeline.launch(placed, placed, **first)
        with pytest.raises(RuntimeError, match="pass vertices_t0 with a row for every vertex"):
            pipeline.launch(rows[0], rows[1].copy(), **second)
        whole = [np.concatenate([placed[:8], part]) for part in rows]
        toi = pipeline.launch(*whole, **second).to_host().toi
        assert 0.3 < toi < 0.4
        assert pipeline.launch(rows[0], rows[1].copy(), **second).to_host().toi == toi
        pipeline.reserve(max_pairs=5000)
        if second is on_arcs:
            with pytest.raises(RuntimeError, match="reserve"):
                pipeline.launch(rows[0], rows[1].copy(), **second)
        else:
            assert pipeline.launch(rows[0], rows[1].copy(), **second).to_host().toi == toi
        pipeline.reserve(vertices=placed)
        assert pipeline.launch(rows[0], rows[1].copy(), **second).to_host().toi == toi
