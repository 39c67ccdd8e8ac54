"""Edges of the example's roadmap are free where they say so, and the path goes from the start to the goal over them."""

from itertools import pairwise

import numpy as np
import pytest
from conftest import loaded_example


@pytest.fixture(scope="module")
def module():
    with loaded_example("robot_path") as module:
        yield module


@pytest.fixture(scope="module")
def roadmap(module):
    return module.Roadmap(120, seed=1)


@pytest.fixture(scope="module")
def toi(roadmap):
    return roadmap.check()


def test_edges_are_as_free_as_they_say_and_no_longer(roadmap, toi):
    is_free = toi == np.inf
    assert 0.1 * len(toi) < is_free.sum() < 0.9 * len(toi) and len(toi) == len(roadmap.edges) <= 120
    motion = roadmap.motion(*roadmap.nodes[roadmap.edges.T])
    for t in (0.3, 0.6):
        touches = roadmap.touches(motion, t)
        assert not (touches & (t < toi)).any() and touches.any()


def test_the_path_goes_over_free_edges_and_is_the_shortest(module, roadmap):
    apart = np.linalg.norm(roadmap.nodes[roadmap.edges[:, 0]] - roadmap.nodes[roadmap.edges[:, 1]], axis=1)
    is_free = np.ones(len(roadmap.edges), dtype=bool)
    path = roadmap.path(is_free)
    # the lengths of all shortest ways, by Floyd and Warshall
    ways = np.full((len(roadmap.nodes),) * 2, np.inf)
    ways[tuple(roadmap.edges.T)] = ways[tuple(roadmap.edges.T[::-1])] = apart
    for k in range(len(ways)):
        ways = np.minimum(ways, ways[:, k, None] + ways[k])
    steps = np.linalg.norm(np.diff(roadmap.nodes[path], axis=0), axis=1)
    assert (path[0], path[-1]) == (0, 1) and steps.sum() == pytest.approx(ways[0, 1])
    assert {tuple(sorted(pair)) for pair in pairwise(path)} <= {*map(tuple, roadmap.edges.tolist())}
    assert roadmap.path(~is_free) == []


def test_start_and_goal_are_free_and_the_straight_way_is_not(module, roadmap):
    ends = np.stack([module.START, module.GOAL])
    assert not roadmap.touches(roadmap.motion(ends, ends), 0.0).any()
    np.testing.assert_array_equal(roadmap.nodes[:2], ends)
    roadmap.edges = np.array([[0, 1]])
    assert 0.0 < roadmap.check()[0] < 1.0
