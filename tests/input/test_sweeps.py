"""How far points of moving bodies go in windows of slices: never farther than their bounds, and about as far."""

import numpy as np
import pytest
from laws.turning import turned

import ccd_warp as ccd
from ccd_warp._body_sweeps import BodySweeps

COUNT, SAMPLES, HALVINGS = 100, 21, 2
# A slide and a turn carry an arm, and a second one branches off; a link floats.
JOINTS = [
    ccd.Joint(child, parent, child, kind, axis, (0, 0, height, 0, 0, 0, 1))
    for parent, child, kind, axis, height in (
        ("base", "rail", "prismatic", (1, 0.2, 0), 0.0),
        ("rail", "trunk", "revolute", (0, 0, 1), 0.1),
        ("trunk", "upper", "revolute", (0, 1, 0), 0.3),
        ("upper", "lower", "revolute", (0, 1, 0.3), 0.3),
        ("trunk", "left", "revolute", (1, 0, 0), 0.3),
        ("base", "free", "free", None, 0.0),
    )
]
LINKS = ["trunk", "upper", "lower", "left", "free"]
PAIRS = [(0, 1), (1, 2), (0, 2), (2, 3), (3, 4)]


class Bodies:
    """Bodies of a RigidMotion, one a slice."""

    def __init__(self, path, scale, turn):
        rng = np.random.default_rng(0)
        poses = np.concatenate([scale * rng.normal(size=(2 * COUNT, 3)), rng.normal(size=(2 * COUNT, 4))], axis=1)
        twist = np.concatenate([rng.normal(size=(2 * COUNT, 3)), turn * rng.normal(size=(2 * COUNT, 3))], axis=1)
        twist[::8, :3] = 0.0  # turns alone, and straight ones
        twist[1::8, 3:] = 0.0
        pivot = {} if path == "screw" else {"pivot": rng.normal(size=(2 * COUNT, 3))}
        self._paths = ccd.RigidMotion(poses, twist=twist, path=path, **pivot)._body_paths
        self.count, self.pairs, self.size = 2, [(0, 1)], scale

    def sweeps(self, begin, end, middles):
        return BodySweeps(self._paths, COUNT)._sweeps(begin, end, middles, np.array(self.pairs))

    def places(self, points, t):
        rows = np.arange(2 * COUNT)
        return self._paths.positions(points.reshape(-1, 3), rows, np.repeat(t, 2)).reshape(COUNT, 2, 3)


class Chain:
    """Links of a JointMotion, one world a slice."""

    def __init__(self, is_cubic):
        rng = np.random.default_rng(1)
        q = rng.uniform(-1.5, 1.5, (4, COUNT, 12))
        q[:, :, 8:] = rng.standard_normal((COUNT, 4))
        q[0, :20] = q[1, :20]  # some stand
        if is_cubic:
            q[1:, :, 8:] = 0.0
            self._motion = ccd.JointMotion.from_cubics(JOINTS, q.transpose(1, 0, 2), links=LINKS)
        else:
            self._motion = ccd.JointMotion(JOINTS, q[0], q[1], links=LINKS)
        self.count, self.pairs, self.size = len(LINKS), PAIRS, 1.0

    def sweeps(self, begin, end, middles):
        return self._motion._sweeps(begin, end, middles, np.array(self.pairs))

    def places(self, points, t):
        poses = self._motion.at(t)
        return poses[..., :3] + turned(poses[..., 3:], points)


SCENES = [
    *(("linear", scale, turn) for scale, turn in [(1.0, 0.2), (1.0, 10.0), (1e8, 0.5), (1e-8, 1e-9)]),
    *(("screw", scale, turn) for scale, turn in [(1.0, 0.2), (1.0, 10.0)]),
    ("chain", 1.0, 0.0),
    ("cubic chain", 1.0, 0.0),
]


@pytest.mark.parametrize(("kind", "scale", "turn"), SCENES)
def test_points_keep_to_the_bounds_of_a_window_and_come_near_them(kind, scale, turn):
    motion = Chain(kind == "cubic chain") if "chain" in kind else Bodies(kind, scale, turn)
    rng = np.random.default_rng(2)
    begin = rng.uniform(0, 0.9, COUNT)
    end = begin + rng.uniform(0, 0.1, COUNT)
    shares = np.concatenate([(np.arange(n) + 0.5) / n for n in 1 << np.arange(HALVINGS + 1)])
    found = motion.sweeps(begin, end, begin + shares[:, None] * (end - begin))
    points = rng.normal(size=(COUNT, motion.count, 3)) * rng.choice([0.0, 0.1, 10.0], (COUNT, motion.count, 1))
    arm, (first, second) = np.linalg.norm(points, axis=2), np.array(motion.pairs).T
    for window, share in enumerate(shares):
        short = 0.5 ** int(np.log2(window + 1))  # half of the window, as a share of half the slice
        origin, error, turns, wrong, bend, bend_of_arm = np.moveaxis(found.reach, 2, 0)
        goes = origin * short + error + (turns * short + wrong) * arm
        bends = (bend + bend_of_arm * arm) * short**2 + error + wrong * arm
        relative = found.relative
        if relative.shape[1] == 0:
            a, b = found.reach[:, first], found.reach[:, second]
            relative = np.concatenate([a[..., :2] + b[..., :2], a[..., 2:4], b[..., 2:4]], axis=2)
        length, off, of_a, off_a, of_b, off_b = np.moveaxis(relative, 2, 0)
        comes = length * short + off + (of_a * short + off_a) * arm[:, first] + (of_b * short + off_b) * arm[:, second]

        def at(tau, x=points, share=share, short=short):
            return motion.places(x, begin + (share + 0.5 * tau * short) * (end - begin))

        middle, zero = at(0.0), at(0.0, np.zeros_like(points))
        assert np.abs(found.position[:, window] - zero).max() <= 1e-13 * max(motion.size, 1.0)
        speed = found.velocity[:, window] + np.cross(found.omega[:, window], middle - zero)
        apart = np.linalg.norm(middle[:, first] - middle[:, second], axis=2)
        largest, rounding = np.zeros((3, COUNT)), 1e-14 * np.abs(middle).max()  # of a distance here
        for tau in np.linspace(-1, 1, SAMPLES):
            now = at(tau)
            goes_now, bends_now = (np.linalg.norm(now - middle - x, axis=2) for x in (0.0, tau * short * speed))
            nearer = apart - np.linalg.norm(now[:, first] - now[:, second], axis=2)
            assert (goes_now <= goes).all() and (bends_now <= bends).all() and (nearer <= comes + rounding).all()
            with np.errstate(invalid="ignore", divide="ignore"):
                ratios = [goes_now / goes, bends_now / bends, nearer / comes]
            largest = np.maximum(largest, [np.nan_to_num(x).max(axis=1) for x in ratios])
        if scale == 1.0:  # the bounds are of use
            assert np.median(largest[0]) > 0.3 and np.median(largest[1]) > 0.2 and largest[2].max() > 0.6
