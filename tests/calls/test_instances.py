"""Many rigid bodies of one shape in one world: only parts that may touch are searched, with the same answers."""

import numpy as np
import pytest
import trimesh
from laws.outputs import different, outputs_of

import ccd_warp as ccd
from ccd_warp import _pipeline
from ccd_warp._engine.host.part_trees import PartTrees

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
    """Whether parts are looked for in small scenes, too; which is to be compared with what whole bodies find."""
    return lambda wanted: monkeypatch.setattr(_pipeline, "_LARGE_SCENE", 1 if wanted else 1 << 60)


@pytest.mark.parametrize(("num_grounds", "options"), [(0, {}), (1, {"minimum_distance": 0.01}), (2, {"t_max": 0.6})])
def test_dice_touch_as_they_do_when_all_of_them_are_searched(options, num_grounds, parts_alone):
    ground = [ccd.HalfSpace((0, 0, -0.4), (0.3, 0.1, 2)), ccd.HalfSpace((0, 3.4, 0), (0, -1, 0))][:num_grounds]
    table = trimesh.creation.box([3, 3, 0.1]).apply_translation([0.9, 0.9, -0.45])
    motion, found, counts = throw(0.95), [], []
    for wanted in (False, True):
        parts_alone(wanted)
        mesh = ccd.CollisionMesh.from_instances(die(), COUNT, [*ground, table], static=[COUNT + len(ground)])
        result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, **options)
        counts.append(result.counts)
        of_twists = motion.gradient_by_twist(result.contacts.toi_gradient())[1]
        found.append(outputs_of(result) | outputs_of(of_twists, "by twists"))
    assert len(result.contacts) > 20 and counts[0].num_boxes > 2 * counts[1].num_boxes > 0 and of_twists.any()
    assert (counts[0].num_contacts.get(ccd.PairKind.VERTEX_PLANE, 0) > 0) == (len(ground) > 0)
    assert [line for line in different(*found) if not line.startswith(".counts")] == []
    assert counts[0].num_contacts == counts[1].num_contacts


@pytest.mark.parametrize(("spacing", "is_free"), [(0.9, False), (1.5, True)])
def test_steps_of_dice_are_those_of_all_of_them(spacing, is_free, parts_alone):
    found = set()
    for wanted in (False, True):
        parts_alone(wanted)
        mesh = ccd.CollisionMesh.from_instances(die(), COUNT)
        frames, motion = (mesh, mesh.vertices, mesh.vertices), throw(spacing)
        step = ccd.collision_free_step(*frames, motion=motion)
        found.add((step, step == 1.0, ccd.is_step_collision_free(*frames, motion=motion)))
    assert len(found) == 1 and found.pop()[1:] == (is_free, is_free)


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
