"""Motions of bodies: conventions against rotations written by hand, both paths, twists, worlds, and bad arguments."""

import copy
import pickle

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd

HALF = np.sqrt(0.5)
IDENTITY = [0.0, 0, 0, 0, 0, 0, 1]
QUARTER_ABOUT_Z = [0.0, 0, 0, 0, 0, HALF, HALF]
TURNED_Z = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
X, Y, Z = np.eye(3)
# of sines, cosines and products of numbers of about 1; their errors are those of test_body_paths
CLOSE = {"rtol": 0.0, "atol": 4e-15}


def placed(motion, point, t, body=0):
    """Where a point of a body's frame is at a time."""
    return motion._body_paths.positions(np.array([point], dtype=float), np.array([body]), t)[0]


def check_at_ends(motion):
    for t, poses in ((0.0, motion.poses_t0), (1.0, motion.poses_t1)):
        np.testing.assert_array_equal(motion.at(t), poses)
        ends = motion._at(np.full(motion.turns.size, t)).reshape(poses.shape)  # by the path's formula
        np.testing.assert_allclose(ends[..., :3], poses[..., :3], **CLOSE)
        np.testing.assert_allclose(np.abs((ends[..., 3:] * poses[..., 3:]).sum(axis=-1)), 1.0, **CLOSE)


# ---- Conventions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "motion",
    [
        ccd.RigidMotion([IDENTITY], [QUARTER_ABOUT_Z]),
        ccd.RigidMotion([IDENTITY], [[0, 0, 0, 0, 0, -3, -3]]),  # of any length and sign
        ccd.RigidMotion([np.eye(4)], [TURNED_Z]),
        ccd.RigidMotion([IDENTITY], [TURNED_Z]),
        ccd.RigidMotion([IDENTITY], twist=[[0, 0, 0, 0, 0, np.pi / 2]]),
        ccd.RigidMotion.from_scalar_first([[0, 0, 0, 1, 0, 0, 0]], [[0, 0, 0, 1, 0, 0, 1]]),
        ccd.RigidMotion([IDENTITY], [QUARTER_ABOUT_Z], path="screw"),
    ],
    ids=["scalar last", "any length", "matrices", "both forms", "twist", "scalar first", "screw"],
)
def test_a_quarter_turn_about_z_takes_x_to_y_on_an_arc(motion):
    np.testing.assert_allclose(placed(motion, X, 0.0), X, **CLOSE)
    np.testing.assert_allclose(placed(motion, X, 0.5), [HALF, HALF, 0], **CLOSE)
    np.testing.assert_allclose(placed(motion, X, 1.0), Y, **CLOSE)
    np.testing.assert_allclose(motion.turns, [np.pi / 2], **CLOSE)
    np.testing.assert_allclose(motion.at(0.5), [[0, 0, 0, 0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)]], **CLOSE)
    np.testing.assert_allclose(np.abs(motion.poses_t1), [QUARTER_ABOUT_Z], **CLOSE)
    check_at_ends(motion)


def test_a_twist_is_linear_first_and_in_the_frame_of_the_world():
    lying = [5.0, 0, 0, HALF, 0, 0, HALF]  # the body's y is the world's z
    motion = ccd.RigidMotion([lying], twist=[[0, 0, 2, 0, 0, np.pi / 2]])
    np.testing.assert_allclose(placed(motion, Y, 1.0), [5, 0, 3], **CLOSE)  # on the axis
    np.testing.assert_allclose(placed(motion, X, 0.0), [6, 0, 0], **CLOSE)
    np.testing.assert_allclose(placed(motion, X, 1.0), [5, 1, 2], **CLOSE)
    check_at_ends(motion)


def test_a_matrix_is_read_by_columns_wherever_its_diagonal_is_largest():
    rng = np.random.default_rng(0)
    quaternions = np.vstack([rng.normal(size=(40, 4)), np.eye(4), -np.eye(4), np.ones((1, 4)) - np.eye(4)])
    motion = ccd.RigidMotion(np.hstack([rng.normal(size=(len(quaternions), 3)), quaternions]), twist=np.zeros((52, 6)))
    bodies = np.arange(52)
    origin = motion._body_paths.positions(np.zeros((52, 3)), bodies, 0.0)
    columns = [motion._body_paths.positions(np.tile(axis, (52, 1)), bodies, 0.0) - origin for axis in (X, Y, Z)]
    matrices = np.tile(np.eye(4), (52, 1, 1))
    matrices[:, :3] = np.stack([*columns, origin], axis=2)
    again = ccd.RigidMotion(matrices, motion.poses_t0)
    assert again.turns.max() < 1e-15 * 8
    rough = matrices + 2e-7 * rng.uniform(-1, 1, matrices.shape) * [[1], [1], [1], [0]]  # as float32 rounds them
    nearest = rough.copy()
    left, _, right = np.linalg.svd(rough[:, :3, :3])
    nearest[:, :3, :3] = left @ right
    assert ccd.RigidMotion(rough, nearest).turns.max() < 1e-15 * 8
    np.testing.assert_allclose(np.linalg.norm(ccd.RigidMotion(rough, rough).poses_t0[:, 3:], axis=1), 1.0, **CLOSE)
    assert not ccd.RigidMotion(rough, rough).turns.any()


# ---- Paths -----------------------------------------------------------------------------------------------------------


def test_a_body_turns_about_its_pivot_which_moves_straight():
    start, end = [1.0, 0, 0, 0, 0, 0, 1], [4.0, 1, 2, 0, 0, HALF, HALF]
    for pivot in ([0, 0, 0], [1, 0, 0], [-2, 3, 7]):
        motion = ccd.RigidMotion([start], [end], pivot=pivot)
        ends = [np.array(start[:3]) + pivot, np.array(end[:3]) + TURNED_Z[:3, :3] @ pivot]
        for t in (0.0, 0.25, 0.5, 1.0):
            np.testing.assert_allclose(placed(motion, pivot, t), (1 - t) * ends[0] + t * ends[1], **CLOSE)
        check_at_ends(motion)


def test_a_nut_on_a_bolt_moves_on_a_screw():
    start, end = [1.0, 0, 0, 0, 0, 0, 1], [0.0, 1, 4, 0, 0, HALF, HALF]
    screw, linear = (ccd.RigidMotion([start], [end], path=path) for path in ("screw", "linear"))
    np.testing.assert_allclose(placed(screw, [0, 0, 0], 0.5), [HALF, HALF, 2], **CLOSE)
    np.testing.assert_allclose(placed(linear, [0, 0, 0], 0.5), [0.5, 0.5, 2], **CLOSE)
    for t in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(placed(screw, [-1, 0, 0], t), [0, 0, 4 * t], **CLOSE)  # on the axis
    np.testing.assert_allclose(screw._body_paths.velocity, [[0, 0, 4]], **CLOSE)
    check_at_ends(screw)


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_a_twist_of_whole_turns_comes_back_at_each_of_them(path):
    screw = np.array([[0.0, 0, 3, 0, 0, 6 * np.pi]])  # three turns down a bolt
    motion = ccd.RigidMotion([[0.0, 0, 0, 0, 0, 0, 1]], twist=screw, path=path)
    np.testing.assert_allclose(motion.turns, [6 * np.pi], rtol=1e-15)
    for k in range(4):
        np.testing.assert_allclose(placed(motion, X, k / 3), X + [0, 0, k], **CLOSE)
        np.testing.assert_allclose(placed(motion, X, (k + 0.5) / 3), -X + [0, 0, k + 0.5], **CLOSE)
    assert np.abs(motion.poses_t1[0, 6]) == pytest.approx(1.0)
    check_at_ends(motion)


def test_the_linear_part_of_a_screw_s_twist_is_the_velocity_of_the_origin_at_the_start():
    """A car on a circle of radius 2 about the origin, a quarter of it."""
    motion = ccd.RigidMotion([[2.0, 0, 0, 0, 0, 0, 1]], twist=[[0, np.pi, 0, 0, 0, np.pi / 2]], path="screw")
    np.testing.assert_allclose(motion.at(0.5)[0, :3], [2 * HALF, 2 * HALF, 0], **CLOSE)
    np.testing.assert_allclose(motion.poses_t1, [[0, 2, 0, 0, 0, HALF, HALF]], **CLOSE)


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_a_twist_and_the_end_pose_may_be_given_both(path):
    twist = [[0.0, 0, 3, 0, 0, np.pi / 2 + 2 * np.pi]]
    end = [[0.0, 0, 3 + 2e-6, 0, 0, HALF, HALF]]
    motion = ccd.RigidMotion([IDENTITY], end, twist=twist, path=path)
    np.testing.assert_allclose(motion.turns, [2.5 * np.pi], **CLOSE)
    np.testing.assert_allclose(np.abs(motion.poses_t1), [[0, 0, 3, 0, 0, HALF, HALF]], **CLOSE)  # that of the twist
    with pytest.raises(ValueError, match=r"twist ends 4e-06 and .* rad away from poses_t1 for body 0"):
        ccd.RigidMotion([IDENTITY], [[0.0, 0, 3 + 4e-6, 0, 0, HALF, HALF]], twist=twist, path=path)


# ---- What a motion is ------------------------------------------------------------------------------------------------


def _worlds():
    rng = np.random.default_rng(2)
    return rng.normal(size=(2, 4, 3, 7))


def test_worlds_are_as_many_motions():
    start, end = _worlds()
    pivot = np.arange(9.0).reshape(3, 3)
    motion = ccd.RigidMotion(start, end, pivot=pivot)
    assert (motion.num_worlds, motion.num_bodies, motion.path) == (4, 3, "linear")
    assert motion.turns.shape == (4, 3) and motion.poses_t0.shape == motion.poses_t1.shape == (4, 3, 7)
    fractions = np.linspace(0, 1, 12).reshape(4, 3)
    for w in range(4):
        alone = ccd.RigidMotion(start[w], end[w], pivot=pivot)
        assert (alone.num_worlds, alone.num_bodies) == (1, 3)
        np.testing.assert_array_equal(motion.at(0.3)[w], alone.at(0.3))
        np.testing.assert_array_equal(motion.at(fractions)[w], alone.at(fractions[w]))
        np.testing.assert_array_equal(motion.at(fractions[0])[w], alone.at(fractions[0]))
        np.testing.assert_array_equal(motion.at([0.0, 0.5, 1.0])[w, 1], alone.at(0.5)[1])
        np.testing.assert_array_equal(motion._body_paths.velocity[3 * w : 3 * w + 3], alone._body_paths.velocity)
    same = ccd.RigidMotion(start, end, pivot=np.tile(pivot, (4, 1, 1)))
    np.testing.assert_array_equal(same.at(0.3), motion.at(0.3))
    check_at_ends(motion)


def test_arrays_of_other_libraries_are_the_same_poses():
    start, end = _worlds()
    expected = ccd.RigidMotion(start[0], end[0]).at(0.5)
    transforms = [wp.array(poses[0], dtype=wp.transformd, device="cpu") for poses in (start, end)]
    numbers = [wp.array(poses[0], dtype=wp.float64, device="cpu") for poses in (start, end)]
    for given in (transforms, numbers, [poses[0].tolist() for poses in (start, end)]):
        np.testing.assert_array_equal(ccd.RigidMotion(*given).at(0.5), expected)
    by_world = wp.array(start, dtype=wp.transformd, device="cpu")
    assert ccd.RigidMotion(by_world, by_world).num_worlds == 4


def test_a_motion_can_be_copied_and_does_not_change():
    start, end = _worlds()
    affine = np.ones((2, 3, 4))
    motions = [ccd.RigidMotion(start, end, pivot=[1, 2, 3]), ccd.AffineMotion(affine, affine)]
    before = motions[0].at(0.5)
    start[...] = end[...] = affine[...] = 0.0
    np.testing.assert_array_equal(motions[0].at(0.5), before)
    for motion in motions:
        for same in (motion, copy.copy(motion), copy.deepcopy(motion), pickle.loads(pickle.dumps(motion))):
            assert repr(same) == repr(motion)
            for name in ("poses_t0", "poses_t1", "turns", "affine_t0", "affine_t1"):
                array = getattr(same, name, None)
                assert array is None or not array.flags.writeable
                np.testing.assert_array_equal(array, getattr(motion, name, None))
            for array in vars(getattr(same, "_body_paths", None) or ccd.HalfSpace(X, X)).values():
                assert array is X or not array.flags.writeable
            with pytest.raises(AttributeError):
                same.num_worlds = 2
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(motions[0])).at(0.5), before)


def test_a_motion_shows_itself_in_a_line():
    start = _worlds()[0]
    assert (
        repr(ccd.RigidMotion([IDENTITY], [QUARTER_ABOUT_Z]))
        == "RigidMotion(1 body, path='linear', turns up to 1.57 rad)"
    )
    motion = ccd.RigidMotion(start, start, path="screw")
    assert repr(motion) == "RigidMotion(3 bodies in each of 4 worlds, path='screw', turns up to 0 rad)"
    assert repr(motion._body_paths) == "BodyPaths(12)" and len(motion._body_paths) == 12
    assert repr(ccd.RigidMotion(np.zeros((0, 7)), np.zeros((0, 4, 4)))) == "RigidMotion(0 bodies, path='linear')"
    assert repr(ccd.AffineMotion(np.zeros((1, 2, 3, 4)), np.zeros((1, 2, 3, 4)))) == (
        "AffineMotion(2 bodies in each of 1 world)"
    )


def test_affine_bodies_are_where_their_maps_put_them():
    start = np.array([np.eye(3, 4), [[0, 2, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]])
    motion = ccd.AffineMotion(start, start + [0, 0, 0, 1])
    points, body = np.array([[1.0, 2, 3], [4, 5, 6], [4, 5, 6]]), [0, 1, 0]
    np.testing.assert_array_equal(motion.positions_t0(points, body), [[1, 2, 3], [11, 6, 9], [4, 5, 6]])
    np.testing.assert_array_equal(motion.positions_t1(points, body), [[2, 3, 4], [12, 7, 10], [5, 6, 7]])
    worlds = ccd.AffineMotion([start, 2 * start], [start, start])
    assert (worlds.num_worlds, worlds.num_bodies) == (2, 2) and worlds.affine_t0.shape == (2, 2, 3, 4)
    np.testing.assert_array_equal(
        worlds.positions_t0(points, body), [motion.positions_t0(points, body), 2 * motion.positions_t0(points, body)]
    )


# ---- Bad arguments ---------------------------------------------------------------------------------------------------

TWO, MAPS = np.array([IDENTITY, IDENTITY]), np.zeros((2, 3, 4))
WORLDS, MATRICES = np.array([TWO, TWO, TWO]), np.array([np.eye(4), np.eye(4)])


def _with(array, at, value):
    array = np.array(array, dtype=float)
    array[at] = value
    return array


def rigid(*poses, **options):
    return lambda: ccd.RigidMotion(*poses, **options)


def twisted(at, value, poses=TWO, end=None):
    """A twist of zeros but for some values."""
    end = () if end is None else (end,)
    return rigid(poses, *end, twist=_with(np.zeros((*poses.shape[:-1], 6)), at, value))


MOST = "twist turns body 0 by 1e.06 rad; expected less than 1e.06 rad in a step: divide it"
BAD = [
    (rigid(TWO), "poses_t1 is None; expected the poses at the end of the step, or twist in their place"),
    (rigid(TWO[:, :6], TWO), r"poses_t0 has shape \(2, 6\); expected shape \(B, 7\), position and quaternion x y z w,"),
    (rigid(TWO[0], TWO), r"poses_t0 has shape \(7,\); expected shape \(B, 7\)"),
    (rigid(np.eye(4), TWO), r"poses_t0 has shape \(4, 4\); expected shape .* or \(B, 4, 4\)"),
    (rigid(WORLDS[None], TWO), r"poses_t0 has shape \(1, 3, 2, 7\)"),
    (rigid(TWO, TWO[:1]), "poses_t1 is of 1 body; expected 2 bodies like poses_t0"),
    (rigid(WORLDS, WORLDS[:2]), "poses_t1 is of 2 bodies in each of 2 worlds; expected 2 bodies in each of 3 worlds"),
    (rigid(WORLDS, TWO), "poses_t1 is of 2 bodies; expected 2 bodies in each of 3 worlds like poses_t0"),
    (rigid(TWO, "there"), "poses_t1 is 'there'; expected shape"),
    (rigid(TWO, [[1.0], [1.0, 2.0]]), "poses_t1 is not an array but .*; expected shape"),
    (rigid(_with(TWO, (1, 0), np.nan), TWO), "poses_t0 holds nan for body 1; expected finite numbers"),
    (rigid(WORLDS, _with(WORLDS, (2, 1, 5), -np.inf)), "poses_t1 holds -inf for body 1 of world 2; expected finite"),
    (rigid(_with(MATRICES, (1, 2, 3), np.inf), TWO), "poses_t0 holds inf for body 1"),
    (rigid(TWO, _with(TWO, (0, 6), 0)), "poses_t1 has a quaternion of length 0 for body 0; expected any other .*last"),
    (rigid(TWO, _with(MATRICES, (1, 3, 0), 0.5)), r"poses_t1 has the bottom row \[0.5, 0.0, 0.0, 1.0\] for body 1"),
    (rigid(_with(MATRICES, (0, 3, 3), 2), TWO), r"poses_t0 has the bottom row \[0.0, 0.0, 0.0, 2.0\] for body 0"),
    (rigid(TWO, _with(MATRICES, (1, 0, 0), 1.01)), "poses_t1 holds no rotation for body 1: .* 0.0201 .* at most 1e-06"),
    (rigid(_with(MATRICES, (1, 0, 1), 2e-6), TWO), "poses_t0 holds no rotation for body 1: .* are 2e-06 from"),
    (rigid(_with(MATRICES, (0, 0, 0), 1e200), TWO), "poses_t0 holds no rotation for body 0: .* are inf from"),
    (rigid(_with(MATRICES, (1, 0, 0), -1), TWO), "poses_t0 holds a reflection for body 1, with determinant -1"),
    (rigid(TWO, TWO, path="spline"), "path is 'spline'; expected 'linear' or 'screw'"),
    (rigid(TWO, TWO, path="screw", pivot=[0, 0, 0]), r"pivot is \[0, 0, 0\]; expected none with path='screw'"),
    (rigid(TWO, TWO, pivot=[0, 0]), r"pivot has shape \(2,\); expected shape \(3,\) or \(2, 3\), in the bodies'"),
    (rigid(WORLDS, WORLDS, pivot=np.zeros((3, 3))), r"pivot has shape \(3, 3\); .* \(3,\) or \(2, 3\) or \(3, 2, 3\)"),
    (rigid(TWO, TWO, pivot=[0, np.nan, 0]), "pivot holds nan for body 0; expected finite"),
    (rigid(TWO, twist=[[0.0] * 6]), "twist is of 1 body; expected 2 bodies like poses_t0"),
    (rigid(TWO, twist=np.zeros((2, 7))), r"twist has shape \(2, 7\); expected shape \(B, 6\), linear part"),
    (twisted((1, 3), np.nan), "twist holds nan for body 1"),
    (twisted((1, 0), 0.5, end=TWO), "twist ends 0.5 and 0 rad away from poses_t1 for body 1; expected the same pose"),
    (twisted((2, 0, 4), 3e-6, WORLDS, WORLDS), "ends 0 and 3e-06 rad .* body 0 of world 2"),
    (twisted((0, 5), 2.0, end=TWO), "twist ends 0 and 2 rad away"),
    (rigid(*(_with(TWO, (1, 0), x) for x in (-1.7e308, 1.7e308))), "velocity of the motion holds .* for body 1"),
    (twisted((1, 5), -1e6), "twist turns body 1 by 1e.06 rad; expected less than 1e.06"),
    (twisted((2, 1, slice(3, 6)), 1.7e308, WORLDS), "turns body 1 of world 2 by inf rad"),
    (twisted((0, 0), 1.7e308, _with(TWO, (0, 0), 1.7e308)), "the end of twist holds inf for"),
    *((lambda make=make: make([[0, 0, 0, 1, 0, 0, 0]], twist=[[0, 0, 0, 8e5, 6e5, 0]]), MOST)
      for make in (ccd.RigidMotion, ccd.RigidMotion.from_scalar_first)),
    (lambda: ccd.RigidMotion.from_scalar_first(MATRICES, MATRICES),
     r"poses_t0 has shape \(2, 4, 4\); expected .* quaternion w x y z, scalar first"),
    (lambda: ccd.RigidMotion.from_scalar_first(TWO, _with(TWO, (1, 6), 0)), "0 for body 1; .*w x y z, scalar first"),
    *((lambda t=t: ccd.RigidMotion(WORLDS, WORLDS).at(t), message) for t, message in (
        (1.5, "t is 1.5; expected a fraction in"),
        (-1e-300, "t is -1e-300"),
        (np.nan, "t is nan"),
        ("half", "t is 'half'"),
        ([0.5], r"t has shape \(1,\); expected a fraction in \[0, 1\], or such fractions of shape \(2,\) or \(3, 2\)"),
        ([0.5, np.nan], "t is nan for body 1 of world 0"),
        (np.full((3, 2), 2.0), "t is 2.0 for body 0 of world 0"))),
    (lambda: ccd.AffineMotion(np.zeros((2, 4, 4)), MAPS), r"affine_t0 has shape \(2, 4, 4\); expected shape \(B, 3"),
    (lambda: ccd.AffineMotion(MAPS, MAPS[:1]), r"affine_t1 has shape \(1, 3, 4\); expected \(2, 3, 4\) like affine_t0"),
    (lambda: ccd.AffineMotion(MAPS, MAPS * np.nan), "affine_t1 holds nan for body 0; expected finite"),
    (lambda: ccd.AffineMotion(MAPS, MAPS).positions_t0([X, Y], [0, 2]), r"body holds index 2; .* indices in \[0, 2\)"),
    (lambda: ccd.AffineMotion(MAPS, MAPS).positions_t1([X, Y], [0]), r"body has shape \(1,\); .* as many as points"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), BAD)
def test_what_is_no_motion_is_refused_by_its_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_motion_may_turn_by_as_much_as_sine_and_cosine_are_proved_for():
    most = np.nextafter(1e6, 0)
    assert ccd.RigidMotion([IDENTITY], twist=[[0, 0, 0, 0, -most, 0]]).turns == most
