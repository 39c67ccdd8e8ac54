"""Motions of many worlds for a mesh of one: parts that may touch, batches, memory, and bad motions."""

import numpy as np
import pytest
import trimesh
from laws.outputs import different, outputs_of

import ccd_warp as ccd
from ccd_warp import _motion_worlds
from ccd_warp._engine.host import near_worlds, part_mesh

WORLDS, NO_FACES, BOX = 7, np.zeros((0, 3), dtype=int), trimesh.creation.box((1, 1, 1))
# what does not depend on how worlds are searched
_OF_SEARCH = (".counts", ".timings")


def poses_of(places, count=WORLDS):
    """Bodies at rest in these places, in all worlds."""
    poses = np.zeros((count, len(places), 7))
    poses[..., 6], poses[..., :3] = 1, places
    return poses


def different_but_counts(*results):
    kept = ({k: x for k, x in outputs_of(r).items() if not k.startswith(_OF_SEARCH)} for r in results)
    return different(*kept)


@pytest.mark.parametrize("options", [{}, {"minimum_distance": 0.05}, {"minimum_separation": 0.1}])
@pytest.mark.parametrize("path", ["linear", "screw"])
def test_parts_that_may_touch_have_the_bits_of_whole_bodies(path, options, monkeypatch):
    """Balls that turn about points beside them, a rod without faces and a board; in some worlds nothing meets."""
    ball, rod = trimesh.creation.icosphere(2), np.array([[0.0, 0, -1], [0, 0, 0], [0, 0, 1]])
    bodies = [(ball.vertices, ball.faces)] * 2 + [(rod, NO_FACES, [[0, 1], [1, 2]])]
    bodies += [(trimesh.creation.box((6, 6, 0.1)).vertices - [0, 0, 1.6], BOX.faces)]
    radius = None if "minimum_separation" in options else [0.01] * 2 * len(ball.vertices) + [0.02] * 11
    apart = {"exclude_pairs": {"bodies": [(0, 2)]}, "radius": radius}
    mesh, rng = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1, 2], static=[3], **apart), np.random.default_rng(2)
    places = [[-1.2, 0, 0], [1.2, 0, 0], [0, 2.5, 0]] + 0.2 * rng.normal(size=(WORLDS, 3, 3))
    places[2, :, 0] *= 20  # where nothing comes near but the board
    places[3, :, 2] += 50 * np.arange(3)
    poses = np.concatenate([places, rng.normal(size=(WORLDS, 3, 4))], axis=2)
    twist = np.concatenate([0.4 * rng.normal(size=(WORLDS, 3, 3)), 0.5 * rng.normal(size=(WORLDS, 3, 3))], axis=2)
    twist[:, 2, 1] -= 1.5
    pivot = {} if path == "screw" else {"pivot": [0.2, -0.1, 0.3]}
    options = options | {"motion": ccd.RigidMotion(poses, twist=twist, path=path, **pivot)}
    x, found = mesh.vertices, []
    for large in (0, 10**9):
        monkeypatch.setattr(_motion_worlds, "_LARGE", large)
        found.append(ccd.mesh_ccd(mesh, x, x, **options))
        assert ccd.collision_free_step(mesh, x, x, **options) == found[0].toi
        assert not ccd.is_step_collision_free(mesh, x, x, **options)
    assert 1 < np.isfinite(found[1].world_toi).sum() < WORLDS and len({*found[1].contacts.kind.tolist()}) > 1
    assert different_but_counts(*found) == []


def test_parts_stay_as_long_as_bodies_stand_where_they_did(monkeypatch):
    """A wall that stands elsewhere in a later call is met there."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", 0)
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX], rigid=[0], static=[1])
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]]), twist=np.tile([4.0, 0, 0, 0, 0, 0.1], (WORLDS, 1, 1)))
    for place in (2.0, 3.0, 2.0, 9.0):
        x = mesh.vertices + np.where(mesh.vertex_body[:, None] == 1, [place, 0, 0], 0.0)
        toi = ccd.mesh_ccd(mesh, x, x, motion=motion).world_toi
        assert (toi == toi[0]).all() and (toi[0] == np.inf if place == 9.0 else abs(4.0 * toi[0] - place + 1) < 0.1)


@pytest.mark.parametrize("limit", [1 << 21, 1 << 24])
def test_parts_that_may_touch_keep_to_a_memory_limit(limit, monkeypatch):
    monkeypatch.setattr(_motion_worlds, "_LARGE", 0)
    mesh = ccd.CollisionMesh.from_trimesh([trimesh.creation.icosphere(3)] * 2, rigid=[0, 1])
    poses = poses_of([[0, 0, 0], [2.3, 0, 0]], 60)
    poses[..., 3:] = np.random.default_rng(3).normal(size=(60, 2, 4))
    motion = ccd.RigidMotion(poses, twist=np.tile([[0.2, 0, 0, 0, 0, 0.3], [-0.2, 0, 0, 0, 0, -0.3]], (60, 1, 1)))
    x = mesh.vertices
    free, kept = (ccd.mesh_ccd(mesh, x, x, motion=motion, memory_limit=most) for most in (None, limit))
    assert different_but_counts(free, kept) == [] and np.isfinite(free.toi)


@pytest.mark.parametrize("large", [0, 10**9])
def test_worlds_are_searched_in_no_larger_parts_than_fit_and_all_of_them_count(large, monkeypatch):
    """Pairs of bodies take a byte each, so their number grows with the square of the worlds; copies are made once."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", large)
    monkeypatch.setattr(_motion_worlds, "_PRIMITIVES", 200)
    monkeypatch.setattr(near_worlds, "MOST_BODIES", 5)
    made, copied, of, replicate = [], [], part_mesh.PartMesh.of.__func__, ccd.CollisionMesh.replicate
    monkeypatch.setattr(part_mesh.PartMesh, "of", classmethod(lambda *given: made.append(of(*given)) or made[-1]))
    monkeypatch.setattr(ccd.CollisionMesh, "replicate", lambda mesh, n: copied.append(n) or replicate(mesh, n))
    mesh = ccd.CollisionMesh.from_trimesh([BOX] * 3, rigid=[0, 1, 2], exclude_pairs={"bodies": [(0, 2)]})
    twist = np.zeros((WORLDS, 3, 6))
    twist[:, 0, 0] = np.linspace(0.1, 0.5, WORLDS)
    motion = ccd.RigidMotion(poses_of([[-1.2, 0, 0], [0, 0, 0], [1.2, 0, 0]]), twist=twist)
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh)
    result = pipeline.mesh_ccd(x, x, motion=motion)
    assert np.isfinite(result.world_toi).sum() == (twist[:, 0, 0] > 0.2).sum()
    assert result.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > 0 and pipeline.counts is result.counts
    assert not pipeline.is_step_collision_free(x, x, motion=motion)
    toi = pipeline.collision_free_step(x, x, motion=motion)
    assert toi == result.toi and pipeline.counts is not result.counts
    assert pipeline.counts.num_faces == WORLDS * 36 and pipeline.timings["total"] > 0.0
    if large == 0:
        assert len(made) > 2 and max(parts.mesh.num_bodies for parts in made) <= 5
    else:
        assert len(copied) == 1 and copied[0] < WORLDS
    twist[:, 0, 0] = 0.1
    assert pipeline.is_step_collision_free(x, x, motion=ccd.RigidMotion(motion.poses_t0, twist=twist))


@pytest.mark.parametrize("kind", ["beside a ball", "beside a ball, as asked", "alone"])
def test_vertex_of_no_face_flies_into_a_wall_where_it_is_a_particle(kind):
    """Alone it is in no part of its body, and meets faces all the same; beside a ball it has to be asked for."""
    ball, loose = trimesh.creation.icosphere(4, 0.1), np.array([[0.0, 1, 0]])
    wall = (np.array([[-1.0, 2, -1], [1, 2, -1], [0, 2, 1]]), np.array([[0, 1, 2]]))
    is_alone, is_point = kind == "alone", kind.endswith("asked")
    body = (loose, NO_FACES) if is_alone else (np.vstack([ball.vertices, loose]), ball.faces)
    options = {"rigid": [0], "static": [1, 2], "self_collision": False, "codimensional_points": is_point}
    mesh = ccd.CollisionMesh.from_arrays([body, wall, (ball.vertices + 50.0, ball.faces)], **options)
    motion = ccd.RigidMotion(poses_of([[0, 0, 0]], 2), twist=np.tile([0, 1.5, 0, 0, 0, 0], (2, 1, 1)))
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion).world_toi
    np.testing.assert_allclose(toi, 2 / 3 if is_alone or is_point else np.inf, atol=1e-12)


def test_bad_motions_of_worlds_are_refused_by_name():
    twist = np.ones((WORLDS, 2, 6))
    motion = ccd.RigidMotion(poses_of([[0, 0, 0], [3, 0, 0]]), twist=twist)
    three = ccd.RigidMotion(poses_of([[0, 0, 0]] * 3, 4), twist=np.zeros((4, 3, 6)))
    mesh, fixed = (ccd.CollisionMesh.from_trimesh([BOX] * 2, rigid=[0, 1], static=static) for static in ([], [0]))
    x = mesh.vertices
    for call, message in (
        (lambda: ccd.mesh_ccd(fixed, x, x, motion=motion), "motion moves body 0 in world 0, which is static"),
        (lambda: ccd.mesh_ccd(mesh, x, x, motion=three), "motion has 3 rows .* 2 rigid bodies"),
        (lambda: ccd.mesh_ccd(mesh, x, x + 1e-3, motion=motion), "vertices_t1 has another row for vertex 0"),
        (lambda: ccd.mesh_ccd(mesh, x, x, motion=motion, check_start=True), r"check_start is True .*replicate\(7\)"),
        (lambda: ccd.line_search(mesh, x, x, motion=motion), r"14 rows .* mesh.replicate\(7\)"),
        (lambda: ccd.mesh_ccd(mesh, x, x, motion=motion, method="bisection"), "method is 'bisection'"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
