"""The earliest tois of worlds of rigid bodies: those of all contacts, and of the first of these the gradients."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._calls.rigid_tois import RigidTois
from ccd_warp._rigid import motion_worlds
from ccd_warp._rigid.parts import whole_bodies

BOX = trimesh.creation.box((1, 1, 1))
FLOOR = trimesh.creation.box((40, 40, 1)).apply_translation([0, 0, -3])


def throws(count, turn):
    """Poses of two boxes in many worlds, and twists, some of which bring them together."""
    rng = np.random.default_rng(2)
    poses, twist = np.zeros((count, 2, 7)), rng.normal(size=(count, 2, 6))
    poses[..., 3:], poses[:, 1, 0] = rng.normal(size=(count, 2, 4)), 3.0
    twist[:, 0, 0] += 2.0
    twist[..., 3:] *= turn / np.linalg.norm(twist[..., 3:], axis=2, keepdims=True)
    return poses, twist


@pytest.mark.parametrize(
    ("changed", "options"),
    [
        ({}, {}),
        ({"_FEW_PRIMITIVES": 1}, {"t_max": 0.8}),
        ({"_PRIMITIVES": 300}, {"minimum_distance": 0.05}),
        ({"_MOST_BODIES_OF_WORLDS": 0}, {}),
    ],
    ids=["at once", "by turns", "some worlds at a time", "all slices"],
)
@pytest.mark.parametrize("count", [1, 150])
def test_of_each_world_the_first_contact_is_found_and_little_more(count, changed, options, monkeypatch):
    for name, value in changed.items():
        monkeypatch.setattr(whole_bodies if name.startswith("_MOST") else motion_worlds, name, value)
    mesh = ccd.CollisionMesh.from_trimesh([BOX, BOX, FLOOR], rigid=[0, 1], static=[2])
    pipeline, x, (poses, twist) = ccd.CollisionPipeline(mesh, **options), mesh.vertices, throws(count, 5.0)
    motion = ccd.RigidMotion(poses, twist=twist)
    result = pipeline.mesh_ccd(x, x, motion=motion)
    tois = RigidTois(pipeline, None, True, poses, twist)
    np.testing.assert_array_equal(tois.toi, result.world_toi)
    touches = np.isfinite(result.world_toi)
    assert touches.any() and (count == 1 or not touches.all())
    if count > 1:
        assert 2 * sum(pipeline.counts.num_contacts.values()) < len(result.contacts)
        assert len(tois._contacts) == touches.sum()
    first = result.contacts[result.world_contact[touches]]
    by_start, by_twist = motion.gradient_by_twist(first.toi_gradient())
    expected = np.zeros((count, 3, 7)), np.zeros((count, 3, 6))
    for row, (world, bodies) in enumerate(zip(first.world, first.bodies, strict=True)):
        expected[0][world, bodies], expected[1][world, bodies] = by_start[row], by_twist[row]
    expected[0][:, :2, 3:] /= np.linalg.norm(poses[..., 3:], axis=2, keepdims=True)
    for found, of_bodies in zip(tois.gradients, expected, strict=True):
        np.testing.assert_allclose(found, of_bodies[:, :2], rtol=1e-14)
        assert found.any(axis=(1, 2))[touches].all()


def test_of_several_first_contacts_the_gradient_is_that_of_the_first_in_the_list():
    """A box that falls flat on a larger one touches it with four corners and more at once."""
    mesh = ccd.CollisionMesh.from_trimesh([BOX, trimesh.creation.box((0.5, 0.3, 0.5))], rigid=[0, 1])
    poses = np.zeros((3, 2, 7))
    poses[..., 6], poses[:, 1, 2], twist = 1.0, [2.0, 3.0, 0.75], np.zeros((3, 2, 6))
    twist[:, 1, 2] = -4.0
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=(motion := ccd.RigidMotion(poses, twist=twist)))
    assert (result.contacts.toi == result.world_toi[result.contacts.world]).sum() > 3 * 4
    tois = RigidTois(ccd.CollisionPipeline(mesh), None, True, poses, twist)
    np.testing.assert_allclose(tois.toi, [0.3125, 0.5625, 0.0], atol=1e-5)
    of_first = motion.gradient_by_twist(result.contacts[result.world_contact].toi_gradient())[1]
    is_upper = result.contacts.bodies[result.world_contact] == 1
    np.testing.assert_array_equal(tois.gradients[1][:, 1], of_first[is_upper])
    assert tois.gradients[1][:2, 1].any(axis=1).all()
    assert not tois.gradients[0][2].any() and not tois.gradients[1][2].any()  # in contact from the start
