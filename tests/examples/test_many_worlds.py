"""The way that the example learns keeps the ball clear of every wall, by distances in closed form; without CCD not."""

import numpy as np
import pytest
from conftest import loaded_example

NUM_WAYS, NUM_GENERATIONS, SAMPLES = 1000, 20, 20_001


@pytest.fixture(scope="module")
def many_worlds():
    with loaded_example("many_worlds") as module:
        yield module


def learned(module, with_ccd):
    """The search after some generations, its best way, and the costs of the best of all generations."""
    search, costs = module.Search(NUM_WAYS, with_ccd=with_ccd), []
    for _ in range(NUM_GENERATIONS):
        way, cost, _ = search.generation()
        costs.append(cost)
    return search, way, costs


def distance_to_walls(module, way):
    """The least distance of the middle of the ball to a wall, in many places of a way."""
    t = np.linspace(0.0, module.LEGS, SAMPLES)
    x, y, z = (np.interp(t, np.arange(module.LEGS + 1), values) for values in way.T)
    least = np.inf
    for place, (u, v) in module.WINDOWS.items():
        assert max(np.abs(y).max(), np.abs(z).max()) < module.HALF  # beside the window there is wall
        inside = np.maximum(module.WINDOW - np.maximum(np.abs(y - u), np.abs(z - v)), 0.0)
        least = min(least, np.hypot(x - place, inside).min())
    return least


def test_the_way_that_is_learned_is_free_and_short(many_worlds):
    _, way, costs = learned(many_worlds, True)
    assert distance_to_walls(many_worlds, way) >= many_worlds.RADIUS
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    # the cost is the length alone, it never rises, and it comes near to that of a string through the windows
    assert costs[-1] == pytest.approx(length, rel=1e-12) and np.all(np.diff(costs) <= 0.0)
    middles = np.array([many_worlds.START, *([x, *u] for x, u in many_worlds.WINDOWS.items()), many_worlds.GOAL])
    assert many_worlds.LEGS < length < 1.1 * np.linalg.norm(np.diff(middles, axis=0), axis=1).sum()


def test_without_ccd_the_way_goes_through_walls(many_worlds):
    _, way, costs = learned(many_worlds, False)
    assert distance_to_walls(many_worlds, way) < 0.1 * many_worlds.RADIUS
    assert costs[-1] == pytest.approx(many_worlds.LEGS, rel=1e-3)


def test_what_is_free_of_each_leg_is_that_of_each_world(many_worlds):
    search = many_worlds.Search(3)
    ways = search.ways()
    ways[:] = np.linspace(many_worlds.START, many_worlds.GOAL, many_worlds.LEGS + 1)
    ways[1, 1:-1, 1:] = many_worlds.WINDOWS[1.5]
    free = search.free(ways)
    # straight on, the ball comes to each wall half-way, less its radius; through the first window it does not
    expected = np.ones((3, many_worlds.LEGS))
    expected[:, [1, 2, 4]] = 0.5 - many_worlds.RADIUS
    expected[1, 1] = 1.0
    assert (free <= expected).all() and (free[[0, 2]] > expected[[0, 2]] - 1e-5).all()
    assert free[1, 1] == 1.0 and free[1, 2] == pytest.approx(expected[1, 2], abs=1e-5)
