"""How far points of bodies on paths go in slices of the step: never farther than their bound, and about as far."""

import numpy as np
import pytest

import ccd_warp as ccd
from ccd_warp._body_sweeps import BodySweeps

COUNT, SAMPLES = 200, 41


def motions(path, scale, turn, seed=0):
    rng = np.random.default_rng(seed)
    poses = np.concatenate([scale * rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 4))], axis=1)
    twist = np.concatenate([rng.normal(size=(COUNT, 3)), turn * rng.normal(size=(COUNT, 3))], axis=1)
    twist[::4, :3] = 0.0  # turns alone, and straight ones
    twist[1::4, 3:] = 0.0
    pivot = {} if path == "screw" else {"pivot": rng.normal(size=(COUNT, 3))}
    return ccd.RigidMotion(poses, twist=twist, path=path, **pivot), rng


def places(motion, points, t):
    """Where a point of each body is, at a time of each."""
    return motion._body_paths.positions(points, np.arange(COUNT), t)


@pytest.mark.parametrize("path", ["linear", "screw"])
@pytest.mark.parametrize(("scale", "turn"), [(1.0, 0.2), (1.0, 10.0), (1e8, 0.5), (1e-8, 1e-9)])
def test_points_go_no_farther_than_their_bound_from_the_middle_of_a_slice(path, scale, turn):
    motion, rng = motions(path, scale, turn)
    begin = rng.uniform(0, 0.9, COUNT)
    end = begin + rng.uniform(0, 0.1, COUNT)
    paths = motion._body_paths
    found = [BodySweeps(paths.rows(np.array([k])), 1)._sweeps(begin[[k]], end[[k]]) for k in range(COUNT)]
    moved, turned = (np.array([getattr(x, name)[0, 0] for x in found]) for name in ("moved", "turned"))
    points = rng.normal(size=(COUNT, 3)) * rng.choice([0.0, 0.1, 10.0], (COUNT, 1))
    middle = places(motion, points, 0.5 * begin + 0.5 * end)
    times = [begin + share * (end - begin) for share in np.linspace(0, 1, SAMPLES)]
    goes = np.max([np.linalg.norm(places(motion, points, t) - middle, axis=1) for t in times], axis=0)
    bound = moved + turned * np.linalg.norm(points, axis=1)
    assert (goes <= bound).all()
    if scale == 1.0:
        assert np.median(goes / bound) > 0.3 and (goes / bound)[1::4].min() > 0.999  # straight ones go as far
    at = np.array([x.position[0, :, 0] for x in found])
    assert np.abs(at - places(motion, np.zeros((COUNT, 3)), 0.5 * begin + 0.5 * end)).max() <= 1e-13 * max(scale, 1)


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_bodies_come_no_nearer_to_each_other_than_their_bound(path):
    motion, rng = motions(path, 1.0, 1.0, seed=1)
    begin, end = np.array([0.3]), np.array([0.4])
    pairs = [(k, k + 1) for k in range(COUNT - 1)]
    length, first, second = BodySweeps(motion._body_paths, 1)._relative_sweeps(pairs, begin, end)
    points = rng.normal(size=(COUNT, 3))
    arms = np.linalg.norm(points, axis=1)

    def apart(t):
        return np.linalg.norm(np.diff(places(motion, points, np.full(COUNT, t)), axis=0), axis=1)

    nearer = apart(0.35) - np.min([apart(t) for t in np.linspace(0.3, 0.4, SAMPLES)], axis=0)
    bound = length[:, 0] + first[:, 0] * arms[:-1] + second[:, 0] * arms[1:]
    assert (nearer <= bound).all() and (nearer / bound).max() > 0.6
