"""Gradients of tois by poses and twists: of worlds of one mesh, of launches, and what has none."""

import pickle

import numpy as np
import pytest
from scenes import TETRAHEDRON

import ccd_warp as ccd
from ccd_warp._gradients import toi_slopes
from ccd_warp._rigid import motion_worlds
from ccd_warp._rigid.turn_gradient import _inverse_jacobian, _jacobian

CORNERS, FACES = TETRAHEDRON
PIVOT = [[0.1, 0.2, 0], [0, 0.3, -0.1], [0, 0, 0]]


def thrown(seed):
    """Poses at both ends of three tetrahedra that turn as they are thrown into each other."""
    rng = np.random.default_rng(seed)
    places, turns = 2.0 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3, 4))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    return np.concatenate([[places, -0.3 * places + 0.3 * rng.standard_normal((3, 3))], turns], axis=2)


def step(is_still=False):
    """The mesh of these and one that deforms, or stays, and positions at both ends."""
    rng = np.random.default_rng(0)
    bodies = [*((CORNERS + 0.2 * rng.standard_normal((4, 3)) - 0.25, FACES) for _ in range(3)), (CORNERS - 0.2, FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1, 2], static=[3] * is_still, self_collision=False)
    end = mesh.vertices + (mesh.vertex_body == 3)[:, None] * (0.3 * (not is_still)) * rng.standard_normal((16, 3))
    return mesh, mesh.vertices.copy(), end


def gradients_of(motion, contacts):
    gradient = contacts.toi_gradient()
    of_motion = (*motion.gradient_by_poses(gradient), *motion.gradient_by_twist(gradient))
    return gradient.start, gradient.end, gradient.distance, *of_motion


@pytest.mark.parametrize("large", [10**9, 0], ids=["alone as they are", "alone by parts"])
def test_worlds_of_one_mesh_have_the_gradients_of_each_alone(large, monkeypatch):
    """Also where positions of the call, which belong to the caller, are overwritten before anything is asked for."""
    for name, value in (("_LARGE_ALONE", large), ("_FEW", 9.0), ("_PRIMITIVES", 150)):  # two worlds at a time
        monkeypatch.setattr(motion_worlds, name, value)
    mesh, *ends = step(is_still=large == 0)  # what deforms is in no part
    pipeline = ccd.CollisionPipeline(mesh, tolerance=1e-13, minimum_distance=0.05)
    poses = np.stack([thrown(seed) for seed in (0, 1, 6)], axis=1)
    motion, given = ccd.RigidMotion(*poses, pivot=PIVOT), [x.copy() for x in ends]
    contacts = pipeline.mesh_ccd(*given, motion=motion).contacts
    for x in given:
        x[:] = np.nan
    found = gradients_of(motion, contacts)
    for world in range(3):
        own, alone = contacts.world == world, ccd.RigidMotion(*poses[:, world], pivot=PIVOT)
        expected = pipeline.mesh_ccd(*ends, motion=alone).contacts
        assert own.any() and np.array_equal(contacts.primitives[own], expected.primitives)
        launched = pipeline.launch(*ends, motion=alone).to_host().contacts
        for x, y, z in zip(found, *(gradients_of(alone, each) for each in (expected, launched)), strict=True):
            np.testing.assert_allclose(x[own], y, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(z, y, rtol=1e-9, atol=1e-12)
    one = pickle.loads(pickle.dumps(contacts))[np.flatnonzero(contacts.world == 1)[:1]]
    assert np.array_equal(motion.gradient_by_twist(one.toi_gradient())[1][0], found[6][contacts.world == 1][0])


@pytest.mark.parametrize("angle", [1e-12, 1e-3, 0.0156, 0.0157, 1.0, 3.0])
def test_small_and_large_turns_have_a_jacobian_and_its_inverse_to_rounding(angle):
    omega, vectors = np.random.default_rng(0).standard_normal((2, 100, 3))
    omega *= angle / np.linalg.norm(omega, axis=1, keepdims=True)
    np.testing.assert_allclose(_inverse_jacobian(omega, _jacobian(omega, vectors)), vectors, rtol=0, atol=1e-13)


def test_tangents_end_where_all_eight_of_them_would_and_are_no_more_than_needed():
    """Tois that stay, lead to one that stays, go to and fro, or round in threes; and one that is not regular."""
    leads_to, toi, asked = np.array([0, 2, 3, 3, 5, 4, 7, 4, 9, 10, 8, 0]), np.arange(12.0), []

    def slopes_of(rows, t):
        asked.append(len(rows))
        return {"time": leads_to[t.astype(int)].astype(float), "is_regular": rows < 11, "at": t.copy()}

    slopes = slopes_of(np.arange(12), toi)
    toi_slopes._go_to_roots(slopes, slopes_of, toi)
    at = toi
    for _ in range(7):
        at = np.where(np.arange(12) < 11, leads_to[at.astype(int)], toi)
    np.testing.assert_array_equal(slopes["at"], at)
    np.testing.assert_array_equal(slopes["time"], leads_to[at.astype(int)])
    assert len(asked) == 8 and asked[-1] == 3  # those that go round


def test_a_motion_that_has_no_such_gradients_says_so():
    (mesh, *ends), poses = step(), thrown(6)
    motion, points = ccd.RigidMotion(*poses), np.random.default_rng(0).standard_normal((2, 3, 4, 3))
    contacts = ccd.mesh_ccd(mesh, *ends, motion=motion).contacts
    gradient, of_pairs = contacts.toi_gradient(), ccd.vertex_face_ccd(*points).toi_gradient(*points)
    six = ccd.RigidMotion(*np.stack([poses, poses], axis=1))
    for call, message in (
        (lambda: ccd.RigidMotion(*poses, path="screw").gradient_by_poses(gradient), "with path='linear' alone"),
        (lambda: six.gradient_by_poses(gradient), "a motion of 3 bodies; expected one of 6, 3 in each of 2 worlds"),
        (lambda: ccd.RigidMotion(*poses[:, :2]).gradient_by_twist(gradient), "a motion of 3 bodies; expected one of 2"),
        (lambda: motion.gradient_by_twist(of_pairs), "no motion"),
        (lambda: motion.gradient_by_poses(contacts), "gradient is"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
