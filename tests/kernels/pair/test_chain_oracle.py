"""The oracle of links of an arm, against times known by analysis, rigid paths, and dense samples."""

import math

import numpy as np
import pytest
from chain_pairs import chain_sets, positions, trajectories_of
from chain_paths import ChainJoint, chain
from flint import arb, arb_poly, ctx
from laws.trajectories import BITS, first_contact, straight
from laws.turning import quaternion, turning

HERE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
WALL = [[0.0, -9.0, -9.0], [0.0, 9.0, -9.0], [0.0, 0.0, 9.0]]  # in the plane x = 0


@pytest.fixture(autouse=True)
def many_digits():
    with ctx.workprec(BITS):
        yield


def reaches_the_wall(joints, point, expected):
    """A point of the last link gets to x = 0 at a time."""
    lo, hi, _ = first_contact("vertex-face", chain([point], joints), straight(WALL, WALL))
    assert lo <= hi and hi - lo < 1e-20
    assert abs(float(lo) - expected) < 1e-15  # what is expected is rounded


def test_two_links_that_turn_back_go_straight():
    """A shoulder turns by φ and an elbow by −2φ: the tip is at 2 cos φ on the x axis, 0 at 90 degrees."""
    shoulder = ChainJoint("revolute", HERE, (0, 0, 3), ends=(0.0, 2.0))
    elbow = ChainJoint("revolute", (1.0, 0, 0, 0, 0, 0, 1), (0, 0, 1), ends=(0.0, -4.0))
    reaches_the_wall([shoulder, elbow], (1, 0, 0), math.pi / 4)


def test_a_slide_shortens_an_arm_that_turns():
    """The tip is at (2 − 4t) cos 2t: the slide is at 0 before the arm is across."""
    arm = ChainJoint("revolute", HERE, (0, 0, 1), ends=(0.0, 2.0))
    slide = ChainJoint("prismatic", HERE, (2, 0, 0), ends=(2.0, -2.0))
    reaches_the_wall([arm, slide], (0, 0, 0), 0.5)


def test_a_cubic_is_reached_where_it_is():
    """The angle is 4t³, and the quaternion of the origin turns the axis y to z."""
    turned = np.concatenate([[0, 0, 0], quaternion(np.array([math.pi / 2, 0, 0]))])
    reaches_the_wall([ChainJoint("revolute", turned, (0, 1, 0), q=(0.0, 0, 0, 4))], (2, 0, 0), (math.pi / 8) ** (1 / 3))


def test_a_free_joint_is_a_rigid_path():
    rng = np.random.default_rng(1)
    start, end, local = rng.normal(size=7), rng.normal(size=7), rng.normal(size=(1, 3))
    wall = rng.normal(size=(3, 3)) + 0.5 * (start[:3] + end[:3])
    joint = ChainJoint("free", HERE, ends=(start, end))
    found, expected = (
        first_contact("vertex-face", points, straight(wall, wall), 1.0)
        for points in (chain(local, [joint]), turning(local, start, end))
    )
    assert found[0] is not None and abs(found[0] - expected[0]) < arb(1e-20)


def test_samples_and_enclosures_are_of_one_trajectory():
    pairs = chain_sets(1)["edge-edge, 0.5 rad, two links"]
    for t in (0.0, 0.3, 1.0):
        for side, path in enumerate(trajectories_of(pairs, 0)):
            seen = positions(pairs, side, np.array([[t]]))[0, 0]
            exact = path(arb_poly([arb(t)]))
            assert np.abs(seen - [[float(arb_poly(x)[0]) for x in point] for point in exact]).max() < 1e-15
