"""Motions of many worlds for a mesh of one: parts that may touch, batches, memory, and bad motions."""

import numpy as np
import pytest
import trimesh
from laws.outputs import different, outputs_of

import ccd_warp as ccd
from ccd_warp import _motion_worlds
from ccd_warp._engine.host import near_worlds, part_mesh

WORLDS, NO_FACES, BOX = 7, np.zeros((0, 3), dtype=int), trimesh.creation.box((1, 1, 1))


def poses_of(places, count=WORLDS):
    """Bodies at rest in these places, in all worlds."""
    poses = np.zeros((count, len(places), 7))
    poses[..., 6], poses[..., :3] = 1, places
    return poses


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
    free, kept = ({k: v for k, v in outputs_of(r).items() if not k.startswith(".counts")} for r in (free, kept))
    assert different(free, kept) == [] and np.isfinite(free[".toi"])


def test_worlds_are_searched_in_no_larger_parts_than_fit_and_all_of_them_count(monkeypatch):
    """Pairs of bodies take a byte each, so their number grows with the square of the worlds."""
    made, of = [], part_mesh.PartMesh.of.__func__
    for module, name, value in ((_motion_worlds, "_LARGE", 0), (near_worlds, "MOST_BODIES", 5)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(part_mesh.PartMesh, "of", classmethod(lambda *given: made.append(of(*given)) or made[-1]))
    mesh, twist = ccd.CollisionMesh.from_trimesh([BOX] * 3, rigid=[0, 1, 2]), np.zeros((WORLDS, 3, 6))
    twist[:, 0, 0] = np.linspace(0.1, 0.5, WORLDS)
    motion = ccd.RigidMotion(poses_of([[-1.2, 0, 0], [0, 0, 0], [1.2, 0, 0]]), twist=twist)
    x, pipeline = mesh.vertices, ccd.CollisionPipeline(mesh)
    result = pipeline.mesh_ccd(x, x, motion=motion)
    assert np.isfinite(result.world_toi).sum() == (twist[:, 0, 0] > 0.2).sum()
    assert result.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > 0 and pipeline.counts is result.counts
    assert pipeline.collision_free_step(x, x, motion=motion) == result.toi and pipeline.counts is not result.counts
    assert pipeline.counts.num_faces == WORLDS * 36 and pipeline.timings["total"] > 0.0
    assert len(made) > 2 and max(parts.mesh.num_bodies for parts in made) <= 5


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
    mesh, fixed = (ccd.CollisionMesh.from_trimesh([BOX] * 2, rigid=[0, 1], static=static) for static in ([], [0]))
    x, motion = mesh.vertices, ccd.RigidMotion(poses_of([[0, 0, 0], [3, 0, 0]]), twist=np.ones((WORLDS, 2, 6)))
    for call, message in (
        (lambda: ccd.mesh_ccd(fixed, x, x, motion=motion), "motion moves body 0 in world 0, which is static"),
        (lambda: ccd.mesh_ccd(mesh, x, x + 1e-3, motion=motion), "vertices_t1 has another row for vertex 0"),
        (lambda: ccd.mesh_ccd(mesh, x, x, motion=motion, check_start=True), r"check_start is True .*replicate\(7\)"),
        (lambda: ccd.line_search(mesh, x, x, motion=motion), r"14 rows .* mesh.replicate\(7\)"),
        (lambda: ccd.mesh_ccd(mesh, x, x, motion=motion, method="bisection"), "method is 'bisection'"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
