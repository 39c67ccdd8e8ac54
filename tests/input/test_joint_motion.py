"""Motions of joints: where links are, worlds, waypoints and cubics, and what is refused."""

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

import ccd_warp as ccd

HALF = np.sqrt(0.5)


def arm():
    """A turning base, a slide along x at height 1, and a hand fixed 0.5 above it; the order is not that of the tree."""
    return [
        ccd.Joint("wrist", "carriage", "hand", "fixed", origin=(0, 0, 0.5, 0, 0, 0, 2)),
        ccd.Joint("turn", "ground", "base", "revolute", (0, 0, 3)),
        ccd.Joint("slide", "base", "carriage", "prismatic", (1, 0, 0), (0, 0, 1, 0, 0, 0, 1)),
    ]


def near(found, expected):
    assert np.shape(found) == np.shape(expected) and np.abs(found - np.array(expected)).max() < 1e-15


def test_links_are_where_the_joints_put_them():
    motion = ccd.JointMotion(arm(), [0.0, 1.0], [np.pi, 3.0])
    assert motion.names == ("carriage", "hand", "ground", "base")
    assert (motion.num_links, motion.num_worlds, motion.num_coordinates) == (4, 1, 2)
    near(motion.poses_t0[1], [1, 0, 1.5, 0, 0, 0, 1])
    near(motion.at(0.5)[0], [0, 2, 1, 0, 0, HALF, HALF])
    near(motion.poses_t1[0, :3], [-3, 0, 1])
    near(motion.at(0.5)[2:, :3], np.zeros((2, 3)))
    assert np.array_equal(motion.at(0), motion.poses_t0) and np.array_equal(motion.at(1), motion.poses_t1)
    near(motion.configuration(0.5), [np.pi / 2, 2])
    assert repr(motion) == "JointMotion(4 links, 2 moving joints)"


def test_a_free_joint_turns_the_shortest_way_while_it_goes_straight():
    ship = [ccd.Joint("float", "sea", "ship", "free"), ccd.Joint("mast", "ship", "flag", "revolute", (0, 0, 1))]
    start, end = [0, 0, 0, 0, 0, 0, 1, 0.0], [4, 0, 2, 0, 0, -3, -3, 1.0]
    motion = ccd.JointMotion(ship, start, end, links=["ship"])
    rigid = ccd.RigidMotion([start[:7]], [end[:7]])
    for t in (0.0, 0.3):
        near(motion.at(t), rigid.at(t))
    near(motion.configuration(0.5)[:7], rigid.at(0.5)[0])
    near(motion.poses_t1[0], [4, 0, 2, 0, 0, HALF, HALF])  # the rotation of the quaternion of the other sign


def test_worlds_and_waypoints():
    path = np.array([[0.0, 1.0], [0.5, 1.0], [0.5, 2.0], [1.0, 0.0]])
    motion = ccd.JointMotion.from_waypoints(arm(), path, links=["hand", "base"])
    assert motion.poses_t0.shape == (3, 2, 7) and motion.names == ("hand", "base")
    assert repr(motion) == "JointMotion(2 links, 2 moving joints in each of 3 worlds)"
    near(motion.poses_t1[:-1], motion.poses_t0[1:])
    times = [0.0, 0.5, 0.25]
    each = [ccd.JointMotion(arm(), path[k], path[k + 1], links=["hand", "base"]).at(t) for k, t in enumerate(times)]
    near(motion.at(times), each)
    fan = ccd.JointMotion(arm(), path[0], path[1:])
    near(fan.poses_t0, np.repeat(fan.poses_t0[:1], 3, axis=0))


def test_configurations_of_other_libraries_are_read():
    import warp as wp

    q = np.array([[0.0, 1.0], [0.5, 2.0]], dtype=np.float32)
    motion = ccd.JointMotion(arm(), wp.array(q, device="cpu"), wp.array(q[0], dtype=wp.float32, device="cpu"))
    near(motion.poses_t0, ccd.JointMotion(arm(), q.tolist(), [0, 1]).poses_t0)
    cubic = ccd.JointMotion.from_cubics(arm(), wp.array(np.repeat(q, 2, axis=0), device="cpu"))
    near(cubic.configuration(1.0), [1.0, 6.0])


def test_cubics():
    c = np.array([[0.0, 1.0], [0.0, 2.0], [3.0, 0.0], [-2.0, 0.0]])  # 3t² − 2t³, from rest to rest
    motion = ccd.JointMotion.from_cubics(arm(), c)
    near(motion.configuration(0.25), [0.15625, 1.5])
    near(motion.at(0.25), ccd.JointMotion(arm(), [0.15625, 1.5], [0, 0]).poses_t0)
    assert ccd.JointMotion.from_cubics(arm(), [c, c]).poses_t1.shape == (2, 4, 7)
    near(motion.shortened(0.5).at(0.5), motion.at(0.25))


def test_shortened_goes_the_same_way():
    ship = [ccd.Joint("float", "sea", "ship", "free"), *arm()]
    q = np.random.default_rng(0).normal(size=(2, 3, 9))
    motion = ccd.JointMotion(ship + [ccd.Joint("deck", "ship", "ground", "fixed")], *q)
    short = motion.shortened([0.5, 0.0, 1.0])
    assert np.abs(short.at(0.5) - motion.at([0.25, 0.0, 0.5])).max() < 1e-14
    assert np.array_equal(short.poses_t1[2], motion.poses_t1[2])
    assert np.abs(short.configuration(1.0) - motion.configuration([0.5, 0.0, 1.0])).max() < 1e-14


def test_a_motion_does_not_change_and_is_pickled():
    q0, q1 = np.zeros((2, 2)), np.ones((2, 2))
    motion = ccd.JointMotion(arm(), q0, q1)
    before = motion.poses_t1.copy()
    q1[:] = 7
    again = pickle.loads(pickle.dumps(motion))
    for one in (motion, again):
        assert np.array_equal(one.at(1.0), before)
        with pytest.raises(ValueError, match="read-only"):
            one.poses_t0[0] = 1
    assert again.joints == motion.joints
    joint = arm()[1]
    assert hash(joint) == hash(replace(joint)) and joint.axis == (0.0, 0.0, 3.0)


def link(name, parent, child, kind="fixed", **options):
    return ccd.Joint(name, parent, child, kind, **options)


def elbow(kind="revolute", axis=(0, 0, 1), **options):
    return lambda: ccd.Joint("elbow", "upper", "lower", kind, axis, **options)


def motion(joints, *q, make=ccd.JointMotion, **options):
    return lambda: make(joints, *q, **options)


FREE, INFINITE = [link("float", "sea", "ship", "free")], np.zeros((4, 2))
INFINITE[2, 1] = np.inf
WAYPOINTS, CUBICS = {"make": ccd.JointMotion.from_waypoints}, {"make": ccd.JointMotion.from_cubics}
TWO = ccd.JointMotion(arm(), np.zeros((2, 2)), np.ones((2, 2)))
REFUSED = [
    # joints that form no tree
    (motion([link("a", "x", "y"), link("b", "y", "x")], [], []), "a loop of 2 joints: a, b"),
    (motion([link("c", "y", "z"), link("a", "x", "y"), link("b", "y", "x")], [], []), "a loop of 2 joints"),
    (motion([link("a", "x", "x")], [], []), "a loop of 1 joint: a"),
    (motion([link("a", "x", "y"), link("b", "z", "y")], [], []), "carry the link 'y', 'a' and 'b'"),
    (motion([link("a", "x", "y"), link("b", "Y", "z")], [], []), "2 links that no joint carries: x, Y; expected one"),
    (motion([link("a", "x", "y"), link("a", "y", "z")], [], []), "joints has 2 of the name 'a'"),
    (motion([3], [], []), "an item of joints is 3; expected a Joint"),
    (motion(arm(), [0, 0], [1, 1], links=["arm"]), "links has 'arm'; expected names of links: carriage"),
    (motion(arm(), [0, 0], [1, 1], links=[[3]]), "links has [3]; expected names of links"),
    (motion(arm(), [0, 0], [1, 1], links=["hand", "hand"]), "links has 2 of the name 'hand'"),
    # joints
    (elbow(axis=(0, 0, 0)), "axis of joint 'elbow' is (0, 0, 0), of length 0.0"),
    (elbow(axis=(np.nan, 0, 1)), "axis of joint 'elbow' is (nan, 0, 1)"),
    (elbow(axis=(0, 1)), "axis of joint 'elbow' is (0, 1)"),
    (elbow("free"), "expected none, as the joint is free"),
    (elbow(origin=(0,) * 6), "origin of joint 'elbow' has shape (6,)"),
    (elbow(origin=(0,) * 7), "origin of joint 'elbow' has a quaternion of length 0; expected"),
    (elbow(origin=(np.nan, 0, 0, 0, 0, 0, 1)), "origin of joint 'elbow' holds nan; expected finite numbers"),
    (elbow(origin=np.diag([1.0, 1, 2, 1])), "origin of joint 'elbow' holds no rotation: the products"),
    # configurations
    (motion(arm(), [0, 0, 0], [1, 1]), "q0 has shape (3,); expected shape (2,)"),
    (motion(arm(), np.zeros((2, 2)), np.zeros((3, 2))), "q1 is of 3 worlds; expected 2 like q0"),
    (motion(arm(), [0, 0], [[0, 0], [np.nan, 0]]), "q1 holds nan at [1, 0], for joint 'turn'"),
    (motion(arm(), [0, -1e308], [0, 1e308]), "link 'carriage' is at no finite pose"),
    (motion(arm(), [[0, 0]], **WAYPOINTS), "waypoints has shape (1, 2); expected (K, 2), K at least 2"),
    (motion(arm(), np.zeros((3, 2)), **CUBICS), "coefficients has shape (3, 2); expected shape (4, 2)"),
    (motion(arm(), INFINITE, **CUBICS), "coefficients holds inf at [2, 1], for joint 'slide'"),
    (motion(FREE, [0] * 7, [1] * 7), "q0 has a quaternion of length 0 for the free joint 'float', of configuration 0"),
    (motion(FREE, np.ones((4, 7)), **CUBICS), "turns the free joint 'float'; expected 0"),
    *(
        (lambda call=call, t=t: call(t), message)
        for call in (TWO.at, TWO.shortened, TWO.configuration)
        for t, message in (
            (1.5, "t is 1.5; expected a fraction in [0, 1]"),
            ([0.5, np.nan], "t is nan for world 1"),
            ([0.5] * 3, "t has shape (3,)"),
        )
    ),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_what_is_no_joint_tree_or_configuration_is_refused(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        call()


def test_an_origin_may_be_a_matrix():
    turned = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    near(link("a", "b", "c", origin=turned).origin, (5, 6, 7, 0, 0, HALF, HALF))
