"""Motions of bodies: conventions against rotations written by hand, both paths, twists, worlds, and bad arguments."""

import copy
import pickle

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd

HALF = np.sqrt(0.5)
IDENTITY, QUARTER_ABOUT_Z = np.eye(7)[6], np.array([0.0, 0, 0, 0, 0, HALF, HALF])
TURNED_Z = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
ORIGIN, X, Y, Z = np.eye(4, 3, -1)
# of sines, cosines and products of numbers of about 1; their errors are those of test_body_paths
CLOSE = {"rtol": 0.0, "atol": 4e-15}
RIGID = ccd.RigidMotion


def check_places(motion, *places):
    """Where points of the body are at times; and that its poses are those of its path at both ends."""
    for point, t, expected in places:
        found = motion._body_paths.positions(np.array([point], dtype=float), np.array([0]), t)[0]
        np.testing.assert_allclose(found, expected, **CLOSE)
    for t, poses in ((0.0, motion.poses_t0), (1.0, motion.poses_t1)):
        np.testing.assert_array_equal(motion.at(t), poses)
        ends = motion._at(np.full(motion.turns.size, t)).reshape(poses.shape)  # by the path's formula
        np.testing.assert_allclose(ends[..., :3], poses[..., :3], **CLOSE)
        np.testing.assert_allclose(np.abs((ends[..., 3:] * poses[..., 3:]).sum(axis=-1)), 1.0, **CLOSE)


# ---- Conventions and paths -------------------------------------------------------------------------------------------


QUARTERS = [
    RIGID([IDENTITY], [QUARTER_ABOUT_Z]),
    RIGID([IDENTITY], [[0, 0, 0, 0, 0, -3, -3]]),  # of any length and sign
    RIGID([np.eye(4)], [TURNED_Z]),
    RIGID([IDENTITY], [TURNED_Z]),
    RIGID([IDENTITY], twist=[[0, 0, 0, 0, 0, np.pi / 2]]),
    RIGID.from_scalar_first([[0, 0, 0, 1, 0, 0, 0]], [[0, 0, 0, 1, 0, 0, 1]]),
    RIGID([IDENTITY], [QUARTER_ABOUT_Z], path="screw"),
]


@pytest.mark.parametrize("motion", QUARTERS)
def test_a_quarter_turn_about_z_takes_x_to_y_on_an_arc(motion):
    check_places(motion, (X, 0.0, X), (X, 0.5, [HALF, HALF, 0]), (X, 1.0, Y))
    np.testing.assert_allclose(motion.turns, [np.pi / 2], **CLOSE)
    np.testing.assert_allclose(motion.at(0.5), [[0, 0, 0, 0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)]], **CLOSE)
    np.testing.assert_allclose(np.abs(motion.poses_t1), [QUARTER_ABOUT_Z], **CLOSE)


def test_a_matrix_is_read_by_columns_wherever_its_diagonal_is_largest():
    rng = np.random.default_rng(0)
    quaternions = np.vstack([rng.normal(size=(40, 4)), np.eye(4), -np.eye(4), np.ones((1, 4)) - np.eye(4)])
    motion = RIGID(np.hstack([rng.normal(size=(len(quaternions), 3)), quaternions]), twist=np.zeros((52, 6)))
    origin, *ends = (motion._body_paths.positions(np.tile(x, (52, 1)), np.arange(52), 0.0) for x in (ORIGIN, X, Y, Z))
    matrices = np.tile(np.eye(4), (52, 1, 1))
    matrices[:, :3] = np.stack([*(x - origin for x in ends), origin], axis=2)
    rough = matrices + 2e-7 * rng.uniform(-1, 1, matrices.shape) * [[1], [1], [1], [0]]  # as float32 rounds them
    nearest, (left, _, right) = rough.copy(), np.linalg.svd(rough[:, :3, :3])
    nearest[:, :3, :3] = left @ right
    for start, end, most in ((matrices, motion.poses_t0, 8e-15), (rough, nearest, 8e-15), (rough, rough, 0.0)):
        assert RIGID(start, end).turns.max() <= most
    np.testing.assert_allclose(np.linalg.norm(RIGID(rough, rough).poses_t0[:, 3:], axis=1), 1.0, **CLOSE)


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_a_twist_of_many_turns_ends_in_the_pose_that_is_given_with_it_to_3e_6(path):
    """And turns by as much as sine and cosine are proved for; where bodies are on the way, test_body_paths says."""
    most = np.nextafter(1e6, 0)
    assert RIGID([IDENTITY], twist=[[0, 0, 0, 0, -most, 0]], path=path).turns == most
    twist, ends = [[0.0, 0, 3, 0, 0, 2.5 * np.pi]], [[[0.0, 0, 3 + x, 0, 0, HALF, HALF]] for x in (2e-6, 4e-6, 0.0)]
    motion = RIGID([IDENTITY], ends[0], twist=twist, path=path)
    np.testing.assert_allclose(motion.turns, [2.5 * np.pi], **CLOSE)
    np.testing.assert_allclose(np.abs(motion.poses_t1), ends[2], **CLOSE)  # that of the twist
    with pytest.raises(ValueError, match=r"twist ends 4e-06 and .* rad away from poses_t1 for body 0"):
        RIGID([IDENTITY], ends[1], twist=twist, path=path)


# ---- What a motion is ------------------------------------------------------------------------------------------------

ENDS = np.random.default_rng(2).normal(size=(2, 4, 3, 7))  # of three bodies in four worlds


def test_worlds_are_as_many_motions():
    pivot, fractions = np.arange(9.0).reshape(3, 3), np.linspace(0, 1, 12).reshape(4, 3)
    motion = RIGID(*ENDS, pivot=pivot)
    assert motion.turns.shape == (4, 3) and motion.poses_t0.shape == motion.poses_t1.shape == (4, 3, 7)
    for w in range(4):
        alone = RIGID(*ENDS[:, w], pivot=pivot)
        assert (alone.num_worlds, alone.num_bodies) == (1, 3)
        for t, own in ((0.3, 0.3), (fractions, fractions[w]), (fractions[0], fractions[0])):
            np.testing.assert_array_equal(motion.at(t)[w], alone.at(own))
        np.testing.assert_array_equal(motion.at([0.0, 0.5, 1.0])[w, 1], alone.at(0.5)[1])
        np.testing.assert_array_equal(motion._body_paths.velocity[3 * w : 3 * w + 3], alone._body_paths.velocity)
        for within, own in ((0.5, [0.5] * 3), (fractions, fractions[w]), (fractions[0], fractions[0])):
            motion = RIGID(*ENDS, pivot=pivot, within=within)
            np.testing.assert_array_equal(motion.within[w], own)
            np.testing.assert_array_equal(motion.shortened(0.5).within[w], own)
    np.testing.assert_array_equal(RIGID(*ENDS, pivot=np.tile(pivot, (4, 1, 1))).at(0.3), motion.at(0.3))
    check_places(motion)


def test_arrays_of_other_libraries_are_the_same_poses():
    ends, expected = ENDS[:, 0], RIGID(*ENDS[:, 0]).at(0.5)
    for given in (*([wp.array(x, dtype=d) for x in ends] for d in (wp.transformd, wp.float64)), ends.tolist()):
        np.testing.assert_array_equal(RIGID(*given).at(0.5), expected)
    assert RIGID(*2 * [wp.array(ENDS[0], dtype=wp.transformd)]).num_worlds == 4


def test_a_motion_can_be_copied_and_does_not_change():
    start, end = ENDS.copy()
    motion = RIGID(start, end, pivot=[1, 2, 3])
    before = motion.at(0.5)
    start[...] = end[...] = 0.0
    for same in (motion, copy.copy(motion), copy.deepcopy(motion), pickle.loads(pickle.dumps(motion))):
        arrays = [x for of in (same, same._body_paths) for x in vars(of).values() if isinstance(x, np.ndarray)]
        assert repr(same) == repr(motion) and arrays and not any(x.flags.writeable for x in arrays)
        for name in ("poses_t0", "poses_t1", "turns"):
            np.testing.assert_array_equal(getattr(same, name), getattr(motion, name))
        np.testing.assert_array_equal(same.at(0.5), before)
        with pytest.raises(AttributeError):
            same.num_worlds = 2


def test_a_motion_shows_itself_in_a_line():
    for shown, expected in (
        (QUARTERS[0], "RigidMotion(1 body, path='linear', turns up to 1.57 rad)"),
        (RIGID(ENDS[0], ENDS[0]), "RigidMotion(3 bodies in each of 4 worlds, path='linear', turns up to 0 rad)"),
        (
            RIGID([IDENTITY], [IDENTITY], within=0.1),
            "RigidMotion(1 body, path='linear', turns up to 0 rad, within 0.1)",
        ),
        (RIGID(np.zeros((0, 7)), np.zeros((0, 4, 4))), "RigidMotion(0 bodies, path='linear')"),
    ):
        assert repr(shown) == expected
