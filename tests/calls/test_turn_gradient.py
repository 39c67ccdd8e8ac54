"""Gradients of tois by poses and twists of rigid bodies, against differences."""

import numpy as np
import pytest

import ccd_warp as ccd
from ccd_warp import _motion_worlds, _turn_gradient
from ccd_warp._rotations import arcs

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
NUM_RIGID = 3


class Thrown:
    """Three rigid tetrahedra that turn as they are thrown into each other and into one that deforms."""

    def __init__(self, seed, **options):
        self.rng = rng = np.random.default_rng(seed)
        bodies = [(CORNERS + 0.2 * rng.standard_normal((4, 3)) - 0.25, FACES) for _ in range(NUM_RIGID)]
        bodies.append((0.8 * CORNERS - 0.2, FACES))
        mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1, 2], self_collision=False)
        self.pipeline = ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-13, **options)
        self.pivot = 0.3 * rng.standard_normal((NUM_RIGID, 3))
        places = 2.0 * rng.standard_normal((NUM_RIGID, 3))
        ends = -0.3 * places + 0.3 * rng.standard_normal((NUM_RIGID, 3))
        turns = rng.standard_normal((2, NUM_RIGID, 4))
        turns /= np.linalg.norm(turns, axis=2, keepdims=True)
        self.poses = [np.hstack([x, q]) for x, q in zip((places, ends), turns, strict=True)]
        self.start, self.end = mesh.vertices.copy(), mesh.vertices.copy()
        self.end[4 * NUM_RIGID :] += 0.3 * rng.standard_normal((4, 3))

    def contacts(self, *poses, end=None, **motion):
        motion = ccd.RigidMotion(*poses, **motion, pivot=self.pivot)
        found = self.pipeline.mesh_ccd(self.start, self.end if end is None else end, motion=motion)
        return motion, found.contacts

    def moves(self, columns, size=1e-7):
        return size * self.rng.standard_normal((NUM_RIGID, columns))


def by_pair(contacts):
    return dict(zip(zip(contacts.kind, *contacts.primitives.T, strict=True), contacts.toi, strict=True))


def errors(contacts, gradient, predicted, late, early):
    """Relative errors of regular contacts that are there after both moves."""
    late, early, found = by_pair(late), by_pair(early), []
    for k, pair in enumerate(by_pair(contacts)):
        if gradient.is_regular[k] and pair in late and pair in early:
            expected = 0.5 * (late[pair] - early[pair])
            found.append(abs(predicted[k] - expected) / max(abs(expected), 1e-9))
    return np.array(found)


def change(contacts, gradients, moves):
    """What the moves of the bodies on both sides change to first order."""
    total = np.zeros(len(contacts))
    for gradient, move in zip(gradients, moves, strict=True):
        of_bodies = np.vstack([move, np.zeros_like(move[:1])])  # the last body is not rigid
        total += (gradient * of_bodies[contacts.bodies]).sum(axis=(1, 2))
    return total


@pytest.mark.parametrize(
    "seed", [0, 6, pytest.param(4, marks=pytest.mark.long), pytest.param(11, marks=pytest.mark.long)]
)
@pytest.mark.parametrize("options", [{}, {"minimum_distance": 0.05}])
def test_gradients_by_poses_and_positions_agree_with_differences(seed, options):
    thrown = Thrown(seed, **options)
    motion, contacts = thrown.contacts(*thrown.poses)
    gradient = contacts.toi_gradient()
    of_poses = motion.gradient_by_poses(gradient)
    moves = [thrown.moves(7) for _ in range(2)]
    of_end = np.zeros_like(thrown.end)
    of_end[4 * NUM_RIGID :] = 1e-7 * thrown.rng.standard_normal((4, 3))
    predicted = change(contacts, of_poses, moves) + (gradient.end * of_end[gradient.vertices]).sum(axis=(1, 2))
    late, early = (
        thrown.contacts(*(p + s * d for p, d in zip(thrown.poses, moves, strict=True)), end=thrown.end + s * of_end)[1]
        for s in (1, -1)
    )
    found = errors(contacts, gradient, predicted, late, early)
    assert len(found) > 0.8 * len(contacts) > 20 and np.median(found) < 1e-7 and found.max() < 1e-5
    for values, poses in zip(of_poses, (motion.poses_t0, motion.poses_t1), strict=True):
        turned = np.vstack([poses[:, 3:], np.zeros((1, 4))])[contacts.bodies]
        along = (values[..., 3:] * turned).sum(axis=2)  # a unit quaternion stays one
        np.testing.assert_allclose(along, 0.0, atol=1e-12)


@pytest.mark.parametrize("turns", [0.0, 1e-9, 0.3, 9.0])
def test_gradients_by_twists_agree_with_differences(turns):
    thrown = Thrown(1)
    axes = thrown.rng.standard_normal((NUM_RIGID, 3))
    linear = thrown.poses[1][:, :3] - thrown.poses[0][:, :3]
    twist = np.hstack([linear, turns * axes / np.linalg.norm(axes, axis=1, keepdims=True)])
    motion, contacts = thrown.contacts(thrown.poses[0], twist=twist)
    gradient = contacts.toi_gradient()
    moves = [thrown.moves(7), thrown.moves(6)]
    predicted = change(contacts, motion.gradient_by_twist(gradient), moves)
    late, early = (thrown.contacts(thrown.poses[0] + s * moves[0], twist=twist + s * moves[1])[1] for s in (1, -1))
    found = errors(contacts, gradient, predicted, late, early)
    assert len(found) > 0.8 * len(contacts) > 10 and np.median(found) < 1e-7 and found.max() < 1e-4


def test_tois_that_are_early_have_the_gradients_of_the_exact_ones():
    thrown = Thrown(6)
    motion, contacts = thrown.contacts(*thrown.poses)
    options = {"motion": motion, "precision": "float32", "tolerance": 1e-4, "device": "cpu"}
    early = ccd.mesh_ccd(thrown.pipeline.mesh, thrown.start, thrown.end, **options).contacts
    places = {pair: k for k, pair in enumerate(by_pair(early))}
    rows = [(k, places[pair]) for k, pair in enumerate(by_pair(contacts)) if pair in places]
    ours, theirs = (np.array(x) for x in zip(*rows, strict=True))
    assert len(ours) > 0.9 * len(contacts) and np.abs(contacts.toi[ours] - early.toi[theirs]).max() > 1e-6
    expected, found = (motion.gradient_by_poses(c.toi_gradient()) for c in (contacts, early))
    for x, y in zip(expected, found, strict=True):
        np.testing.assert_allclose(y[theirs], x[ours], rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.999 * 2.0**-6, 1.001 * 2.0**-6, 1.0, 3.0, 6.0])
def test_jacobians_of_rotations_are_inverse_and_those_of_differences(angle):
    rng = np.random.default_rng(0)
    axis, x = rng.standard_normal((2, 5, 3))
    omega = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    moved = _turn_gradient._jacobian(omega, x)
    np.testing.assert_allclose(_turn_gradient._inverse_jacobian(omega, moved), x, rtol=1e-12, atol=1e-13)
    # J(omega) x is the integral of Rot(s omega) x over s in [0, 1], here by Gauss and Legendre
    points, weights = np.polynomial.legendre.leggauss(20)
    turned = [x + arcs(omega, x, np.full(5, 0.5 + 0.5 * s)) for s in points]
    np.testing.assert_allclose(moved, 0.5 * np.tensordot(weights, turned, 1), rtol=1e-12, atol=1e-13)


def test_gradients_in_the_plane_agree_with_differences():
    """A bar that turns onto a point of another one, which turns, too, and onto one that moves straight."""
    bar = (np.array([[-1.0, 0], [1, 0]]), [[0, 1]])
    mesh = ccd.CollisionMesh.from_arrays([bar, bar, (bar[0] * 0.1, bar[1])], rigid=[0, 1])
    x, rng = mesh.vertices, np.random.default_rng(0)
    start, end = x.copy(), x.copy()
    start[4:] += [0.5, 0.9]
    end[4:] += [0.4, 0.7]
    poses = np.array([[0.0, 0, 0, 0, 0, 0, 1], [-1.4, -0.5, 0, 0, 0, np.sin(0.11), np.cos(0.11)]])
    twist = np.array([[0.0, 0.2, 0, 0, 0, 1.5], [0.1, 0, 0, 0, 0, -0.4]])

    def found(s, moves):
        motion = ccd.RigidMotion(poses + s * moves[0], twist=twist + s * moves[1], pivot=[0.1, 0.2, 0])
        options = {"tolerance": 1e-13, "device": "cpu"}
        return motion, ccd.mesh_ccd(mesh, start, end + s * moves[2], motion=motion, **options).contacts

    moves = [1e-7 * rng.standard_normal(values.shape) for values in (poses, twist, end)]
    for values in moves[:2]:
        values[:, 2:5] = 0.0
    moves[2][:4] = 0.0
    motion, contacts = found(0, moves)
    gradient = contacts.toi_gradient()
    assert len(contacts) > 2 and gradient.is_regular.all() and gradient.end.shape[2] == 2
    predicted = (gradient.end * moves[2][gradient.vertices]).sum(axis=(1, 2))
    for values, move in zip(motion.gradient_by_twist(gradient), moves, strict=False):
        of_bodies = np.vstack([move, np.zeros_like(move[:1])])
        predicted += (values * of_bodies[contacts.bodies]).sum(axis=(1, 2))
    late, early = (found(s, moves)[1] for s in (1, -1))
    np.testing.assert_allclose(predicted, 0.5 * (late.toi - early.toi), rtol=1e-5)


@pytest.mark.parametrize("large", [10**9, 0], ids=["in batches", "by parts"])
def test_worlds_of_one_mesh_have_the_gradients_of_each_alone(large, monkeypatch):
    """Also where positions of the call, which belong to the caller, are overwritten before anything is asked for."""
    monkeypatch.setattr(_motion_worlds, "_LARGE", large)
    monkeypatch.setattr(_motion_worlds, "_PRIMITIVES", 150)  # two worlds at a time
    options = {"minimum_distance": 0.05}
    thrown = [Thrown(seed, **options) for seed in (0, 1, 6)]
    scene = thrown[0]
    mesh, is_still = scene.pipeline.mesh, large == 0  # what deforms is in no part
    if is_still:
        mesh = ccd.CollisionMesh.from_arrays(
            [(mesh.vertices[4 * b : 4 * b + 4], FACES) for b in range(4)], rigid=[0, 1, 2], static=[3]
        )
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-13, **options)
    poses = np.stack([each.poses for each in thrown], axis=1)
    motion = ccd.RigidMotion(*poses, pivot=scene.pivot)
    start = scene.start.copy()
    end = start.copy() if is_still else scene.end.copy()
    given = start.copy(), end.copy()
    contacts = pipeline.mesh_ccd(start, end, motion=motion).contacts
    start[:], end[:] = np.nan, np.nan
    gradient = contacts.toi_gradient()
    of_worlds = [*motion.gradient_by_poses(gradient), *motion.gradient_by_twist(gradient)]
    for world in range(3):
        own = contacts.world == world
        alone = ccd.RigidMotion(*poses[:, world], pivot=scene.pivot)
        expected = pipeline.mesh_ccd(*given, motion=alone).contacts
        of_one = expected.toi_gradient()
        assert own.any() and np.array_equal(contacts.primitives[own], expected.primitives)
        for found, values in (
            (gradient.start, of_one.start),
            (gradient.end, of_one.end),
            (gradient.distance, of_one.distance),
            *zip(of_worlds, [*alone.gradient_by_poses(of_one), *alone.gradient_by_twist(of_one)], strict=True),
        ):
            np.testing.assert_allclose(found[own], values, rtol=1e-9, atol=1e-12)
    copies = mesh.replicate(3)
    of_copies = ccd.mesh_ccd(copies, *(np.tile(x, (3, 1)) for x in given), motion=motion, device="cpu", **options)
    of_copies = motion.gradient_by_twist(of_copies.contacts.toi_gradient())[1]
    np.testing.assert_allclose(np.sort(of_copies, axis=0), np.sort(of_worlds[3], axis=0), rtol=1e-6, atol=1e-9)
    one = contacts[np.flatnonzero(contacts.world == 1)[:1]]
    assert np.array_equal(motion.gradient_by_twist(one.toi_gradient())[1][0], of_worlds[3][contacts.world == 1][0])


def test_a_launch_with_a_motion_has_the_gradients_of_the_call():
    thrown = Thrown(6)
    motion, contacts = thrown.contacts(*thrown.poses)
    launched = thrown.pipeline.launch(thrown.start, thrown.end, motion=motion).to_host().contacts
    expected, found = (motion.gradient_by_twist(c.toi_gradient()) for c in (contacts, launched))
    for x, y in zip(expected, found, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-12)


def test_a_motion_that_has_no_such_gradients_says_so():
    thrown = Thrown(6)
    motion, contacts = thrown.contacts(*thrown.poses)
    gradient = contacts.toi_gradient()
    screw = ccd.RigidMotion(*thrown.poses, path="screw")
    with pytest.raises(ValueError, match="by poses with path='linear' alone"):
        screw.gradient_by_poses(gradient)
    with pytest.raises(ValueError, match="a motion of 3 bodies; expected one of 6, 3 in each of 2 worlds"):
        ccd.RigidMotion(*np.stack([thrown.poses, thrown.poses], axis=1)).gradient_by_poses(gradient)
    with pytest.raises(ValueError, match="a motion of 3 bodies; expected one of 2"):
        ccd.RigidMotion(*(p[:2] for p in thrown.poses)).gradient_by_twist(gradient)
    points = np.random.default_rng(0).standard_normal((2, 3, 4, 3))
    with pytest.raises(ValueError, match="no motion"):
        motion.gradient_by_twist(ccd.vertex_face_ccd(*points).toi_gradient(*points))
    with pytest.raises(ValueError, match="gradient is"):
        motion.gradient_by_poses(contacts)
