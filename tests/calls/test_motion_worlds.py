"""Where only parts that may touch are searched: in many worlds of one mesh, and among many bodies of one shape."""

import warnings

import numpy as np
import pytest
import trimesh
import warp as wp
from laws.outputs import different, outputs_of

import ccd_warp as ccd
from ccd_warp._engine.host import oddities
from ccd_warp._rigid import motion_worlds
from ccd_warp._rigid.parts import whole_bodies
from ccd_warp._rigid.parts.trees import PartTrees

WORLDS, NO_FACES, BOX = 7, np.zeros((0, 3), dtype=int), trimesh.creation.box((1, 1, 1))


def poses_of(places, count=WORLDS):
    """Bodies at rest in these places, in all worlds."""
    poses = np.zeros((count, len(places), 7))
    poses[..., 6], poses[..., :3] = 1, places
    return poses


@pytest.mark.parametrize("count", [1, WORLDS])
def test_parts_stay_as_long_as_bodies_stand_where_they_did(count, monkeypatch):
    """A wall that stands elsewhere in a later call is met there."""
    for name, value in (("_LARGE_ALONE", 0), ("_FEW", 9.0)):
        monkeypatch.setattr(motion_worlds, name, value)
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX], rigid=[0], static=[1])
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]], count), twist=np.tile([4.0, 0, 0, 0, 0, 0.1], (count, 1, 1)))
    for place in (2.0, 3.0, 2.0, 9.0):
        x = mesh.vertices + np.where(mesh.vertex_body[:, None] == 1, [place, 0, 0], 0.0)
        toi = ccd.mesh_ccd(mesh, x, x, motion=motion).world_toi
        assert (toi == toi[0]).all() and (toi[0] == np.inf if place == 9.0 else abs(4.0 * toi[0] - place + 1) < 0.1)


def test_worlds_are_searched_some_at_a_time_and_all_of_them_count(monkeypatch):
    monkeypatch.setattr(motion_worlds, "_PRIMITIVES", 300)  # of two worlds
    mesh, twist = ccd.CollisionMesh.from_trimesh([BOX] * 3, rigid=[0, 1, 2]), np.zeros((WORLDS, 3, 6))
    twist[:, 0, 0] = np.linspace(0.1, 0.5, WORLDS)
    motion = ccd.RigidMotion(poses_of([[-1.2, 0, 0], [0, 0, 0], [1.2, 0, 0]]), twist=twist)
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh)
    result = pipeline.mesh_ccd(x, x, motion=motion)
    assert np.isfinite(result.world_toi).sum() == (twist[:, 0, 0] > 0.2).sum()
    assert result.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > 0 and pipeline.counts is result.counts
    assert pipeline.collision_free_step(x, x, motion=motion) == result.toi and pipeline.counts is not result.counts
    assert pipeline.counts.num_faces == WORLDS * 36 and pipeline.timings["total"] > 0.0


@pytest.mark.parametrize("kind", ["beside a ball", "beside a ball, as asked", "alone"])
def test_vertex_of_no_face_flies_into_a_wall_where_it_is_a_particle(kind):
    """Alone it is in no part of its body, and meets faces all the same; beside a ball it has to be asked for."""
    ball, particle = trimesh.creation.icosphere(4, 0.1), np.array([[0.0, 1, 0]])
    wall = (np.array([[-1.0, 2, -1], [1, 2, -1], [0, 2, 1]]), np.array([[0, 1, 2]]))
    is_alone, is_point = kind == "alone", kind.endswith("asked")
    body = (particle, NO_FACES) if is_alone else (np.vstack([ball.vertices, particle]), ball.faces)
    options = {"rigid": [0], "static": [1, 2], "self_collision": False, "codimensional_points": is_point}
    mesh = ccd.CollisionMesh.from_arrays([body, wall, (ball.vertices + 50.0, ball.faces)], **options)
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]], 2), twist=np.tile([0, 1.5, 0, 0, 0, 0], (2, 1, 1)))
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion).world_toi
    np.testing.assert_allclose(toi, 2 / 3 if is_alone or is_point else np.inf, atol=1e-12)


# --- many bodies of one shape in one world ---

COUNT = 40


def die():
    return trimesh.creation.box([0.5, 0.5, 0.5]).subdivide().subdivide()


def throw(spacing):
    """Poses of dice in a lattice, and twists."""
    rng = np.random.default_rng(0)
    places = spacing * np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:COUNT]
    poses = np.hstack([places, rng.standard_normal((COUNT, 4))])
    return ccd.RigidMotion(poses, twist=np.hstack([c * rng.standard_normal((COUNT, 3)) for c in (0.15, 0.3)]))


@pytest.fixture
def parts_alone(monkeypatch):
    """Whether what is near is looked for, by parts of small scenes, too; to be compared with a search of all slices."""

    def look(wanted):
        monkeypatch.setattr(whole_bodies, "_MOST_PAIRS", 1 << 11 if wanted else -1)
        monkeypatch.setattr(motion_worlds, "_LARGE_ALONE", 1)

    return look


@pytest.mark.parametrize(
    ("num_grounds", "form", "options"),
    [(0, {}, {}), (1, {}, {"minimum_distance": 0.01}), (2, {"radius": 0.01}, {"t_max": 0.6})],
)
def test_dice_touch_as_they_do_when_all_of_them_are_searched(options, form, num_grounds, parts_alone):
    ground = [ccd.HalfSpace((0, 0, -0.4), (0.3, 0.1, 2)), ccd.HalfSpace((0, 3.4, 0), (0, -1, 0))][:num_grounds]
    table = trimesh.creation.box([3, 3, 0.1]).apply_translation([0.9, 0.9, -0.45])
    motion, found, counts = throw(0.95), [], []
    for wanted in (False, True):
        parts_alone(wanted)
        mesh = ccd.CollisionMesh.from_instances(die(), COUNT, [*ground, table], static=[COUNT + len(ground)], **form)
        frames = mesh, mesh.vertices, mesh.vertices
        result = ccd.mesh_ccd(*frames, motion=motion, **options)
        counts.append(result.counts)
        of_twists = motion.gradient_by_twist(result.contacts.toi_gradient())[1]
        steps = [
            call(*frames, motion=motion, **options) for call in (ccd.collision_free_step, ccd.is_step_collision_free)
        ]
        found.append(outputs_of(result) | outputs_of(of_twists, "by twists") | outputs_of(steps, "steps"))
    assert len(result.contacts) > 20 and counts[0].num_boxes > 2 * counts[1].num_boxes > 0 and of_twists.any()
    assert (counts[0].num_contacts.get(ccd.PairKind.VERTEX_PLANE, 0) > 0) == (len(ground) > 0)
    assert [line for line in different(*found) if not line.startswith(".counts")] == []
    assert counts[0].num_contacts == counts[1].num_contacts


def test_dice_that_rise_out_of_the_ground_may_take_the_whole_step(parts_alone):
    parts_alone(True)
    mesh = ccd.CollisionMesh.from_instances(die(), COUNT, [ccd.HalfSpace((0, 0, 0), (0, 0, 1))])
    motion = ccd.RigidMotion(throw(1.5).at(0), twist=np.tile([0, 0, 0.3, 0, 0, 0], (COUNT, 1)))
    pipeline = ccd.CollisionPipeline(mesh)
    assert pipeline.mesh_ccd(mesh.vertices, mesh.vertices, motion=motion).toi == 0.0
    assert pipeline.counts.num_boxes < mesh.num_faces
    assert pipeline.collision_free_step(mesh.vertices, mesh.vertices, motion=motion) == 1.0


def test_copies_have_one_tree_and_others_their_own():
    mesh = ccd.CollisionMesh.from_instances(die(), 5, [die().apply_scale(1.5), die()], static=[5], rigid=[6])
    trees = PartTrees(mesh, mesh.vertices)
    assert trees.of_body.tolist() == [0, 0, 0, 0, 0, 1, 0] and len(trees.num_parts) == 2
    numbers = np.arange(int(trees.begins[trees.first_part[1]]))
    for body in range(7):
        corners, kind, number = trees.primitives(np.full(len(numbers), body), numbers)
        own = np.flatnonzero(mesh.vertex_body[mesh.faces[:, 0]] == body)
        assert (kind == 0).all() and sorted(number.tolist()) == own.tolist()
        np.testing.assert_array_equal(corners, mesh.faces[number])
    with pytest.raises(ValueError, match="shape is 2 bodies; expected an object of trimesh that is one"):
        ccd.CollisionMesh.from_instances(trimesh.Scene([die(), die()]), 3)


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_a_launch_of_many_worlds_is_that_of_as_many_copies(real):
    """Also with other radii on the device, another number of worlds, and rows of what moves alone."""
    slab = trimesh.creation.box((4, 3, 0.2)).apply_translation([0, 0.2, -1])
    mesh = ccd.CollisionMesh.from_trimesh([BOX, slab, BOX], rigid=[0, 2], static=[1], radius=0.01)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    x = mesh.vertices.astype(real)
    for count, radius in ((3, 0.01), (5, 0.02), (5, 0.0)):
        rng = np.random.default_rng(count)
        poses = poses_of([(0, 0, 0), (1.2, 0.1, 0.3)], count)
        poses[..., 3:] += rng.normal(size=(count, 2, 4))
        motion = ccd.RigidMotion(poses, twist=0.8 * rng.normal(size=(count, 2, 6)))
        copies = ccd.CollisionPipeline(mesh.replicate(count), device="cpu")
        pipeline.radius.fill_(radius)
        copies.radius.fill_(radius)
        all_rows = np.tile(x, (count, 1))
        found = [pipeline.launch(x, x, motion=motion), copies.launch(all_rows, all_rows, motion=motion)]
        moving = wp.array(x[mesh.moving_vertices], device="cpu")
        found.append(pipeline.launch(moving, moving, motion=motion) if real is np.float64 else found[1])
        of_each = [outputs_of(result.to_host()) for result in found]
        assert np.isfinite(found[0].world_toi.numpy()).any() and len(found[0].to_host().contacts) > 0
        assert different(*of_each[:2]) == different(*of_each[1:]) == []
    with pytest.raises(ValueError, match=r"motion has 5 worlds, and the mesh one; expected a pipeline of mesh\.rep"):
        pipeline.launch_line_search(x, x.copy(), motion=motion)


def test_a_step_of_one_world_says_what_it_has_searched():
    """Of one slice, and of many that are searched at once."""
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX.copy().apply_translation([1.4, 0.1, 0])], rigid=[0], static=[1])
    pipeline = ccd.CollisionPipeline(mesh)
    for turn in (0.1, 6.0):
        motion = ccd.RigidMotion(poses_of([[0, 0, 0]], 1)[0], twist=[[0.8, 0, 0, 0, 0.1, turn]])
        assert pipeline.collision_free_step(mesh.vertices, mesh.vertices, motion=motion) < 1.0
        assert pipeline.counts.num_boxes > 0 and pipeline.timings["total"] > 0.0


def test_bodies_whose_rows_are_others_in_each_step_are_not_divided_in_each(monkeypatch):
    """As of a user who gives places in the world, and motions from there."""
    made, whole = [], PartTrees.__init__
    monkeypatch.setattr(PartTrees, "__init__", lambda self, *given: made.append(self) or whole(self, *given))
    ball = trimesh.creation.icosphere(2)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball.copy().apply_translation([2.1, 0, 0])], rigid=[0, 1])
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]] * 2, 1)[0], twist=[[0.2, 0, 0, 0, 0, 0.1], [0, 0, 0, 0, 0, 0.3]])
    tois = [ccd.mesh_ccd(mesh, x, x, motion=motion).toi for x in (mesh.vertices + 0.1 * k for k in range(5))]
    assert len(made) == 1 and np.all(np.diff(tois) < 0.0) and tois[0] < 1.0  # farther from where they turn
    for k in (7, 7):  # where they stay, they are
        ccd.mesh_ccd(mesh, mesh.vertices + k, mesh.vertices + k, motion=motion)
    assert len(made) == 2


def test_a_capacity_that_is_refused_leaves_those_of_worlds_as_they_are():
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX.copy().apply_translation([1.02, 0.1, 0.05])], rigid=[0, 1])
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]] * 2, 200), twist=np.full((200, 2, 6), 0.05) * [[1], [-1]])
    found = []
    for refuse in (False, True):
        pipeline = ccd.CollisionPipeline(mesh, device="cpu")
        if refuse:
            with pytest.raises(ValueError, match="max_pairs"):
                pipeline.reserve(max_contacts=9, max_pairs=0)
        found.append(outputs_of(pipeline.launch(mesh.vertices, mesh.vertices, motion=motion).to_host()))
    assert different(*found) == [] and np.isfinite(found[0][".toi"])


def test_warnings_of_slices_name_bodies_and_vertices_of_the_mesh_and_are_given_once(monkeypatch):
    """The slices of worlds are searched as copies of the mesh, which no caller has seen."""
    for name in ("_MANY_PAIRS", "_MANY_PAIRS_EACH"):
        monkeypatch.setattr(oddities, name, 0)
    ground, box = ccd.HalfSpace([0, 0, -9], [0, 0, 1]), (BOX.vertices, BOX.faces)
    names = ["ground", "here", "left", "right"]
    mesh = ccd.CollisionMesh.from_arrays([ground, box, box, box], names=names, rigid=[1, 2, 3])
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh)
    places, said = [[0, -9, 0], [0, 0, 0.5], [0, 0, 1.6]], []
    for count in (3, WORLDS):
        motion = ccd.RigidMotion(poses_of(places, count), twist=np.tile([0, 0, 0, 1.0, 0, 0], (count, 3, 1)))
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            pipeline.mesh_ccd(x, x, motion=motion)
        said += [str(warning.message) for warning in warned]
    assert len(said) == 1 and said[0].endswith("they are most often of left and right (100 % of a sample)")
    copies = mesh._copies(5, 5)
    moved = np.tile(x, (5, 1))
    moved[3 * len(x) + 9] = 1e9
    assert oddities.Farthest.of((moved, moved)).described(copies).startswith("vertex 9 (vertex 1 of left)")
    assert copies.names[0] == "here[0]"
