"""Motions of many worlds for a mesh of one: the bits of copies of the mesh, however many are searched at a time."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp import _motion_worlds
from ccd_warp._engine.host import near_worlds, part_mesh

WORLDS = 7
NO_FACES = np.zeros((0, 3), dtype=int)
BOX = trimesh.creation.box((1, 1, 1))
FLOOR = ccd.HalfSpace([0, 0, -1.2], [0, 0, 1])
LIFT = ccd.HalfSpace([0, 0, -1.5], [0, 0.1, 1])
SHEET = np.array([[-2.0, -2, 1.1], [2, -2, 1.1], [0, 3, 1.1]])
PARTICLES = np.array([[0.0, 1, 0.9], [1, 0.7, 0.9]])


@pytest.fixture(params=["all at once", "two at a time", "one at a time"])
def batches(request, monkeypatch):
    """How many of the boxes' worlds are searched at a time."""
    size = {"all at once": 1 << 19, "two at a time": 200, "one at a time": 1}[request.param]
    monkeypatch.setattr(_motion_worlds, "_PRIMITIVES", size)


def boxes(**options):
    """Two boxes that turn, a face that falls, particles and two half-spaces, of which one rises."""
    bodies = [(BOX.vertices, BOX.faces)] * 2 + [FLOOR, (SHEET, [[0, 1, 2]]), (PARTICLES, NO_FACES), LIFT]
    return ccd.CollisionMesh.from_arrays(
        bodies, rigid=[0, 1], kinematic=[5], codimensional_points=True, exclude_pairs={"bodies": [(1, 4)]}, **options
    )


def tumbling(seed=0):
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(WORLDS, 2, 4))
    places = np.array([[-0.8, 0, 0], [0.8, 0, 0]]) + 0.1 * rng.normal(size=(WORLDS, 2, 3))
    return ccd.RigidMotion(np.concatenate([places, quaternions], axis=2), twist=0.5 * rng.normal(size=(WORLDS, 2, 6)))


def step_of(mesh):
    start = mesh.vertices
    end = start.copy()
    end[mesh.vertex_body == 3] -= [0, 0, 0.4]
    end[mesh.vertex_body == 5] += [0, 0, 0.3]
    return start, end


def in_copies(contacts, mesh):
    """The contacts in a mesh of copies by world, kind and primitives."""
    rows = contacts.primitives.copy()
    is_plane = contacts.kind == int(ccd.PairKind.VERTEX_PLANE)
    rows[is_plane, 1] = mesh.planes.vertices[rows[is_plane, 1]] >= 0  # the floor is the first of two in one world
    return contacts[np.lexsort((rows[:, 1], rows[:, 0], contacts.kind, contacts.world))]


@pytest.mark.usefixtures("batches")
@pytest.mark.parametrize("radius", [None, [0.01, 0.02, 0, 0.005, 0.03, 0]])
def test_bodies_that_turn_in_worlds_have_the_bits_of_copies(radius):
    mesh, motion = boxes(radius=radius), tumbling()
    result = ccd.mesh_ccd(mesh, *step_of(mesh), motion=motion, device="cpu")
    copies = mesh.replicate(WORLDS)
    start, end = (np.tile(x, (WORLDS, 1)) for x in step_of(mesh))
    expected = ccd.mesh_ccd(copies, start, end, motion=motion, device="cpu")
    assert 2 < np.isfinite(expected.world_toi).sum()
    assert {*expected.contacts.kind.tolist()} >= {int(ccd.PairKind.VERTEX_FACE), int(ccd.PairKind.VERTEX_PLANE)}
    assert result.toi == expected.toi and np.array_equal(result.world_toi, expected.world_toi)
    assert np.array_equal(result.vertex_toi, expected.vertex_toi.reshape(WORLDS, -1))
    own = [0, 1, 3, 4, 5]  # the floor is one body of all copies
    assert np.array_equal(result.body_toi[:, own], expected.body_toi[:-1].reshape(WORLDS, -1))
    assert result.body_toi[:, 2].min() == expected.body_toi[-1]
    found, of_copies = result.contacts, in_copies(expected.contacts, copies)
    names = ("kind", "toi", "parameters", "normal", "status", "gap", "width", "points", "relative_velocity", "world")
    assert [name for name in names if not np.array_equal(getattr(found, name), getattr(of_copies, name))] == []
    assert np.array_equal(found.vertices, of_copies.vertices % mesh.num_vertices)
    of_bodies = [copies.names[b].split("[")[0] for b in of_copies.bodies.ravel()]
    assert of_bodies == [mesh.names[b] for b in found.bodies.ravel()]
    for part in ("world", "body", "vertex"):
        toi, first = getattr(result, f"{part}_toi"), getattr(result, f"{part}_contact")
        touched = first >= 0
        assert np.array_equal(touched, np.isfinite(toi)) and np.array_equal(found.toi[first[touched]], toi[touched])
        assert np.array_equal(found.world[first[touched]], np.nonzero(touched)[0])
    assert result.counts.num_candidates == expected.counts.num_candidates
    assert result.counts.num_faces == expected.counts.num_faces
    assert ccd.collision_free_step(mesh, *step_of(mesh), motion=motion, device="cpu") == ccd.collision_free_step(
        copies, start, end, motion=motion, device="cpu"
    )


@pytest.mark.usefixtures("batches")
def test_a_world_that_is_free_is_certain_and_one_that_is_not_makes_all_uncertain():
    mesh = ccd.CollisionMesh.from_trimesh([BOX] * 2, rigid=[0, 1])
    poses = np.zeros((WORLDS, 2, 7))
    poses[..., 6], poses[:, 1, 0] = 1, 3
    twist = np.zeros((WORLDS, 2, 6))
    twist[..., 5] = 1.0
    x = mesh.vertices
    assert ccd.is_step_collision_free(mesh, x, x, motion=ccd.RigidMotion(poses, twist=twist), device="cpu")
    twist[4, 1, 0] = -2.0
    motion = ccd.RigidMotion(poses, twist=twist)
    assert not ccd.is_step_collision_free(mesh, x, x, motion=motion, device="cpu")
    tois = ccd.rigid_ccd(mesh, poses, twist=twist, device="cpu").world_toi
    assert np.array_equal(np.isfinite(tois), np.arange(WORLDS) == 4)


@pytest.mark.parametrize("size", [1 << 19, 20, 1])
@pytest.mark.parametrize("ground", [False, True])
def test_arm_among_obstacles_has_the_bits_of_copies(size, ground, monkeypatch):
    """Links alone are searched by their parts; with a ground, which has none, worlds are searched in batches."""
    monkeypatch.setattr(_motion_worlds, "_PRIMITIVES", size)
    blade = np.array([[0.0, 0, -0.1], [1, 0, -0.1], [1, 0, 0.1]])
    place = [1, 0, 0, 0, 0, 0, 1]
    arm = [
        ccd.Joint("shoulder", "base", "upper", "revolute", axis=[0, 0, 1]),
        ccd.Joint("elbow", "upper", "lower", "revolute", axis=[0, 0, 1], origin=place),
    ]
    bodies = [(blade, [[0, 1, 2]])] * 2 + [(np.array([[1.3, 0.9, 0]]), NO_FACES)] + [FLOOR] * ground
    mesh = ccd.CollisionMesh.from_arrays(
        bodies, rigid=[0, 1], static=[2], codimensional_points=True, exclude_pairs={"bodies": [(0, 1)]}
    )
    rng = np.random.default_rng(0)
    q0 = rng.uniform(-0.5, 0.5, (WORLDS, 2))
    motion = ccd.JointMotion(arm, q0, q0 + rng.uniform(-2, 2, (WORLDS, 2)), links=["upper", "lower"])
    x = mesh.vertices
    result = ccd.mesh_ccd(mesh, x, x, motion=motion, device="cpu")
    copies = mesh.replicate(WORLDS)
    y = copies.vertices
    expected = ccd.mesh_ccd(copies, y, y, motion=motion, device="cpu")
    assert 0 < np.isfinite(expected.world_toi).sum() < WORLDS
    assert np.array_equal(result.world_toi, expected.world_toi)
    of_copies = in_copies(expected.contacts, copies)
    assert np.array_equal(result.contacts.toi, of_copies.toi)
    assert np.array_equal(result.contacts.points, of_copies.points)
    assert np.array_equal(result.contacts.world, of_copies.world)
    assert ccd.collision_free_step(mesh, x, x, motion=motion, device="cpu") == expected.toi


def test_no_more_copies_are_made_than_are_searched_at_a_time(monkeypatch):
    """So thousands of worlds of a large mesh fit, and a pipeline makes its copies once."""
    monkeypatch.setattr(_motion_worlds, "_PRIMITIVES", 200)
    made = []
    replicate = ccd.CollisionMesh.replicate
    monkeypatch.setattr(ccd.CollisionMesh, "replicate", lambda mesh, n: made.append(n) or replicate(mesh, n))
    mesh = boxes()
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    for seed in range(3):
        result = pipeline.mesh_ccd(*step_of(mesh), motion=tumbling(seed))
        again = ccd.mesh_ccd(mesh, *step_of(mesh), motion=tumbling(seed), device="cpu")
        assert np.array_equal(result.vertex_toi, again.vertex_toi)
        assert pipeline.counts is result.counts and pipeline.timings is result.timings
    assert made == [2]


def test_bad_motions_of_worlds_are_refused_by_name():
    mesh, motion = boxes(static=[0]), tumbling()
    x = mesh.vertices
    with pytest.raises(ValueError, match=r"motion moves body 0 in world 0, which is static"):
        ccd.mesh_ccd(mesh, x, x, motion=motion, device="cpu")
    mesh = boxes()
    three = ccd.RigidMotion(np.tile([0.0, 0, 0, 0, 0, 0, 1], (4, 3, 1)), twist=np.zeros((4, 3, 6)))
    with pytest.raises(ValueError, match=r"motion has 3 rows .* 2 rigid bodies"):
        ccd.mesh_ccd(mesh, x, x, motion=three, device="cpu")
    with pytest.raises(ValueError, match=r"vertices_t1 has another row for vertex 0"):
        ccd.mesh_ccd(mesh, x, x + 1e-3, motion=motion, device="cpu")
    with pytest.raises(ValueError, match=r"check_start is True with a motion of 7 worlds .* mesh.replicate\(7\)"):
        ccd.mesh_ccd(mesh, x, x, motion=motion, check_start=True, device="cpu")
    with pytest.raises(ValueError, match=r"14 rows .* mesh.replicate\(7\)"):
        ccd.line_search(mesh, x, x, motion=motion, device="cpu")
    with pytest.raises(ValueError, match=r"method is 'bisection'"):
        ccd.mesh_ccd(mesh, x, x, motion=motion, method="bisection", device="cpu")


@pytest.mark.parametrize("options", [{}, {"minimum_distance": 0.05}, {"minimum_separation": 0.1}])
@pytest.mark.parametrize("path", ["linear", "screw"])
def test_parts_that_may_touch_have_the_bits_of_whole_bodies(path, options, monkeypatch):
    """Balls that turn about points beside them, a rod without faces and a board; in some worlds nothing meets."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", 0)
    ball = trimesh.creation.icosphere(2)
    rod = np.array([[0.0, 0, -1], [0, 0, 0], [0, 0, 1]])
    bodies = [(ball.vertices, ball.faces)] * 2 + [(rod, NO_FACES, [[0, 1], [1, 2]])]
    bodies += [(trimesh.creation.box((6, 6, 0.1)).vertices - [0, 0, 1.6], BOX.faces)]
    rng = np.random.default_rng(2)
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        rigid=[0, 1, 2],
        static=[3],
        exclude_pairs={"bodies": [(0, 2)]},
        radius=None if "minimum_separation" in options else [0.01] * 2 * len(ball.vertices) + [0.02] * 11,
    )
    poses = np.concatenate([np.empty((WORLDS, 3, 3)), rng.normal(size=(WORLDS, 3, 4))], axis=2)
    poses[..., :3] = [[-1.2, 0, 0], [1.2, 0, 0], [0, 2.5, 0]] + 0.2 * rng.normal(size=(WORLDS, 3, 3))
    poses[2, :, 0] *= 20  # where nothing comes near but the board
    poses[3, :, 2] += 50 * np.arange(3)
    twist = np.concatenate([0.4 * rng.normal(size=(WORLDS, 3, 3)), 0.5 * rng.normal(size=(WORLDS, 3, 3))], axis=2)
    twist[:, 2, 1] -= 1.5
    pivot = {} if path == "screw" else {"pivot": [0.2, -0.1, 0.3]}
    motion = ccd.RigidMotion(poses, twist=twist, path=path, **pivot)
    x = mesh.vertices
    options = options | {"motion": motion, "device": "cpu"}
    result, least = ccd.mesh_ccd(mesh, x, x, **options), ccd.collision_free_step(mesh, x, x, **options)
    free = ccd.is_step_collision_free(mesh, x, x, **options)
    monkeypatch.setattr(_motion_worlds, "_LARGE", 10**9)
    expected = ccd.mesh_ccd(mesh, x, x, **options)
    assert 1 < np.isfinite(expected.world_toi).sum() < WORLDS and len({*expected.contacts.kind.tolist()}) > 1
    names = ("world_toi", "vertex_toi", "body_toi", "vertex_contact", "body_contact", "world_contact")
    assert [name for name in names if not np.array_equal(getattr(result, name), getattr(expected, name))] == []
    names = ("kind", "primitives", "toi", "parameters", "normal", "gap", "points", "relative_velocity", "world")
    of, other = result.contacts, expected.contacts
    assert [name for name in names if not np.array_equal(getattr(of, name), getattr(other, name))] == []
    assert least == ccd.collision_free_step(mesh, x, x, **options) and not free


def test_parts_stay_as_long_as_bodies_stand_where_they_did(monkeypatch):
    """A wall that stands elsewhere in a later call is met there."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", 0)
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX], rigid=[0], static=[1])
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (WORLDS, 1, 1))
    motion = ccd.RigidMotion(poses, twist=np.tile([4.0, 0, 0, 0, 0, 0.1], (WORLDS, 1, 1)))
    for place in (2.0, 3.0, 2.0, 9.0):
        x = mesh.vertices + np.where(mesh.vertex_body[:, None] == 1, [place, 0, 0], 0.0)
        toi = ccd.mesh_ccd(mesh, x, x, motion=motion, device="cpu").world_toi
        assert (toi == toi[0]).all() and (toi[0] == np.inf if place == 9.0 else abs(4.0 * toi[0] - place + 1) < 0.1)


def test_slides_as_short_as_squares_that_vanish_do_not_lose_a_face():
    """A point at the end of six slides of 1.4e-162 each, whose squares are 0, comes to a face after nine tenths."""
    count, size = 6, 1.4e-162
    slides = [ccd.Joint(f"s{k}", f"l{k}", f"l{k + 1}", "prismatic", axis=[1, 0, 0]) for k in range(count)]
    face = size * (np.array([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]]) + [0.9 * count, 0, 0])
    bodies = [(np.zeros((1, 3)), NO_FACES), (face, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], codimensional_points=True)
    motion = ccd.JointMotion(slides, np.zeros(count), np.full(count, size), links=[f"l{count}"])
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu").toi
    assert toi == pytest.approx(0.9, abs=1e-6) and toi <= 0.9


@pytest.mark.parametrize("limit", [1 << 21, 1 << 24])
def test_parts_that_may_touch_keep_to_a_memory_limit(limit, monkeypatch):
    monkeypatch.setattr(_motion_worlds, "_LARGE", 0)
    ball = trimesh.creation.icosphere(3)
    mesh = ccd.CollisionMesh.from_trimesh([ball] * 2, rigid=[0, 1])
    rng = np.random.default_rng(3)
    poses = np.concatenate([np.zeros((60, 2, 3)), rng.normal(size=(60, 2, 4))], axis=2)
    poses[:, 1, 0] = 2.3
    motion = ccd.RigidMotion(poses, twist=np.tile([[0.2, 0, 0, 0, 0, 0.3], [-0.2, 0, 0, 0, 0, -0.3]], (60, 1, 1)))
    x = mesh.vertices
    free = ccd.mesh_ccd(mesh, x, x, motion=motion, device="cpu")
    kept = ccd.mesh_ccd(mesh, x, x, motion=motion, memory_limit=limit, device="cpu")
    assert np.array_equal(free.vertex_toi, kept.vertex_toi) and np.isfinite(free.toi)


@pytest.mark.parametrize("large", [0, 10**9])
def test_meshes_of_parts_hold_no_more_bodies_than_pairs_of_them_fit(large, monkeypatch):
    """Pairs of bodies take a byte each, so their number grows with the square of the worlds; and all steps count."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", large)
    monkeypatch.setattr(near_worlds, "MOST_BODIES", 5)
    made = []
    of = part_mesh.PartMesh.of.__func__
    monkeypatch.setattr(part_mesh.PartMesh, "of", classmethod(lambda *given: made.append(of(*given)) or made[-1]))
    mesh = ccd.CollisionMesh.from_trimesh([BOX] * 3, rigid=[0, 1, 2], exclude_pairs={"bodies": [(0, 2)]})
    poses = np.zeros((WORLDS, 3, 7))
    poses[..., 6], poses[..., 0] = 1, [-1.2, 0, 1.2]
    twist = np.zeros((WORLDS, 3, 6))
    twist[:, 0, 0] = np.linspace(0.1, 0.5, WORLDS)
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh, device="cpu")
    result = pipeline.mesh_ccd(x, x, motion=ccd.RigidMotion(poses, twist=twist))
    assert np.isfinite(result.world_toi).sum() == (twist[:, 0, 0] > 0.2).sum()
    assert large or (len(made) > 2 and max(parts.mesh.num_bodies for parts in made) <= 5)
    assert result.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > 0
    toi = pipeline.collision_free_step(x, x, motion=ccd.RigidMotion(poses, twist=twist))
    assert toi == result.toi and pipeline.counts is not result.counts
    assert pipeline.counts.num_faces == WORLDS * 36 and pipeline.timings["total"] > 0.0


WALL = (np.array([[-1.0, 2, -1], [1, 2, -1], [0, 2, 1]]), np.array([[0, 1, 2]]))
LOOSE = np.array([[0.0, 1, 0]])


@pytest.mark.parametrize("kind", ["beside a ball", "beside a ball, as asked", "alone"])
def test_vertex_of_no_face_flies_into_a_wall_where_it_is_a_particle(kind):
    """Alone it is in no part of its body, and meets faces all the same; beside a ball it has to be asked for."""
    ball = trimesh.creation.icosphere(4, 0.1)
    is_alone, is_point = kind == "alone", kind.endswith("asked")
    body = (LOOSE, np.zeros((0, 3), dtype=int)) if is_alone else (np.vstack([ball.vertices, LOOSE]), ball.faces)
    far = (ball.vertices + 50.0, ball.faces)
    options = {"rigid": [0], "static": [1, 2], "self_collision": False, "codimensional_points": is_point}
    mesh = ccd.CollisionMesh.from_arrays([body, WALL, far], **options)
    start = np.tile([0, 0, 0, 0, 0, 0, 1.0], (2, 1, 1))
    slide = ccd.Joint("slide", "base", "link", "prismatic", (0, 1, 0))
    for motion in (
        ccd.RigidMotion(start, twist=np.tile([0, 1.5, 0, 0, 0, 0], (2, 1, 1))),
        ccd.JointMotion([slide], np.zeros((2, 1)), np.full((2, 1), 1.5), links=["link"]),
    ):
        result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu")
        np.testing.assert_allclose(result.world_toi, 2 / 3 if is_alone or is_point else np.inf, atol=1e-12)
