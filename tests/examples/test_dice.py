"""The dice of the example come to rest and are never in each other, by separating axes; without CCD they are."""

import itertools

import numpy as np
import pytest
from conftest import loaded_example

NUM_DICE, NUM_FRAMES = 6, 45


@pytest.fixture(scope="module")
def dice():
    with loaded_example("dice") as module:
        yield module


def run(module, with_ccd):
    """The scene after some frames, and in how many of them the dice and the table are apart."""
    scene, num_free = module.Throw(NUM_DICE, with_ccd=with_ccd), 0
    for _ in range(NUM_FRAMES):
        scene.advance()
        num_free += are_apart(scene.positions().reshape(NUM_DICE, 8, 3))
    return scene, num_free


def are_apart(corners):
    """Whether cubes, whose corners are in binary order, are apart, and above z = 0."""
    edges = corners[:, [4, 2, 1]] - corners[:, :1]
    for a, b in itertools.combinations(range(len(corners)), 2):
        axes = np.concatenate([edges[a], edges[b], np.cross(edges[a][:, None], edges[b]).reshape(-1, 3)])
        one, other = corners[a] @ axes.T, corners[b] @ axes.T
        if not ((one.max(axis=0) < other.min(axis=0)) | (other.max(axis=0) < one.min(axis=0))).any():
            return False
    return bool((corners[..., 2] > 0.0).all())


def test_dice_come_to_rest_and_never_penetrate(dice):
    scene, num_free = run(dice, True)
    assert num_free == NUM_FRAMES and scene.num_penetrations() == 0
    assert scene.num_events > 1.2 * NUM_FRAMES  # something was met
    assert scene.speed() < 0.01
    positions = scene.positions().reshape(NUM_DICE, 8, 3)
    lowest = np.sort(positions[..., 2], axis=1)
    # most lie on a face: four corners as far above the table as they rest, and four higher by a side
    lies = np.abs(lowest - np.repeat([dice.AIM, dice.AIM + dice.SIDE], 4)).max(axis=1) < 0.01 * dice.SIDE
    assert lies.sum() >= NUM_DICE - 1
    np.testing.assert_allclose(np.ptp(positions[lies], axis=1)[:, 2], dice.SIDE, rtol=0.02)
    assert len(scene.pips()) == NUM_DICE and {*scene.pips()} <= set(range(1, 7))


def test_dice_penetrate_without_ccd(dice):
    assert run(dice, False)[1] < NUM_FRAMES


def test_the_number_of_a_die_is_that_of_its_upper_face(dice):
    scene = dice.Throw(2)
    half = np.sqrt(0.5)
    # as it is, and turned by a right angle about x: what was in front, -y, is above
    scene.poses[:, 3:] = [[0, 0, 0, 1], [-half, 0, 0, half]]
    assert scene.pips() == [dice.PIPS[5], dice.PIPS[2]]
    places = dice.pip_places()
    counts = [
        int((np.sign(places[:, axis]) * (np.abs(places[:, axis]) > 0.4 * dice.SIDE) == sign).sum())
        for axis in range(3)
        for sign in (-1, 1)
    ]
    assert counts == list(dice.PIPS)
