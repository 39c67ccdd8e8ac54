"""Certified slices of motions of joints: no point of a link is farther from its path than stated (60 digits, arb)."""

import numpy as np
import pytest
from flint import arb, arb_poly, ctx
from laws.trajectories import add, cross, dot, exact, scaled, sub
from laws.turning import rotated, shortest_rotation_vector

import ccd_warp as ccd

EPS = 2.0**-52
KINDS = ("revolute", "prismatic", "free", "fixed")


@pytest.fixture(autouse=True)
def many_digits():
    with ctx.workprec(256):
        yield


def rotation(axis, angle, x):
    """A vector turned about an axis of any length."""
    axis = scaled(1 / dot(axis, axis).sqrt(), axis)
    across = add(scaled(angle.cos(), x), scaled(angle.sin(), cross(axis, x)))
    return add(across, scaled(dot(axis, x) * (1 - angle.cos()), axis))


def exact_place(joints, point, t):
    """A point of the last link at a time, carried from link to link, by the joints as they were given."""
    x = exact(point)
    for kind, axis, origin, coordinates in reversed(joints):
        q, origin = [polynomial(t) for polynomial in coordinates], exact(origin)
        if kind == "revolute":
            x = rotation(exact(axis), q[0], x)
        elif kind == "prismatic":
            axis = exact(axis)
            x = add(x, scaled(q[0] / dot(axis, axis).sqrt(), axis))
        elif kind == "free":
            start, end = ([polynomial(arb(side)) for polynomial in coordinates[3:]] for side in (0, 1))
            omega, x = shortest_rotation_vector(start, end), rotated(start, x)
            turn = dot(omega, omega).sqrt()
            x = add(q[:3], rotation(omega, turn * t, x) if turn > 0 else x)
        x = add(origin[:3], rotated(origin[3:], x))
    return x


def place_on_path(paths, row, point, s):
    """A point of a body on its path, by the formula that the paths state."""
    omega, turning = exact(paths.omega[row]), exact(paths.turning[row])
    arm = rotated(exact(paths.rotation[row]), sub(exact(point), exact(paths.pivot[row])))
    turned, theta = add(cross(omega, arm), turning), dot(omega, omega).sqrt()
    place = add(add(exact(paths.pivot_t0[row]), scaled(s, exact(paths.velocity[row]))), arm)
    s1, half = ((theta * s).sin() / theta, (theta * s / 2).sin() / theta) if theta > 0 else (s, s / 2)
    return add(place, add(scaled(s1, turned), scaled(2 * half * half, cross(omega, turned))))


def farthest(paths, row, joints, points, begin, end):
    """How far points are from their path, at a few times of a slice."""
    apart = 0.0
    for s in (0.0, 0.3, 0.5, 0.62, 1.0):
        t = arb(float(begin)) + (arb(float(end)) - arb(float(begin))) * s
        for point in points:
            d = sub(exact_place(joints, point, t), place_on_path(paths, row, point, arb(s)))
            apart = max(apart, float(dot(d, d).sqrt().upper()))
    return apart


def random_chain(rng, kinds, turn, cubic, size=1.0):
    """The motion of a chain with these joints, and of each its kind, axis, origin and coordinates as polynomials."""
    joints, of_oracle, columns, most = [], [], [], 4 if cubic else 2
    for k, kind in enumerate(kinds):
        origin = np.concatenate([rng.normal(size=3) * 0.3 * size, rng.normal(size=4) if k % 2 else [0, 0, 0, 1]])
        axis = rng.normal(size=3)
        along = axis if kind in KINDS[:2] else None
        joints.append(ccd.Joint(f"{k}", f"link {k}", f"link {k + 1}", kind, along, origin))
        powers = np.zeros((4, joints[-1].num_coordinates))
        powers[:most] = rng.normal(size=(4, powers.shape[1]))[:most]
        powers[1:] *= turn
        powers *= size if kind == "prismatic" else 1.0
        if kind == "free":
            powers[:, :3] *= size
            powers[1:, 3:] *= 0.0 if cubic else 0.5
        columns.append(powers)
        ends = [exact(powers[0]), exact(powers[0] + powers[1])]
        rows = map(exact, powers) if cubic else [ends[0], sub(ends[1], ends[0])]
        of_oracle.append((kind, axis, origin, [arb_poly(list(row)) for row in zip(*rows, strict=True)]))
    powers = np.concatenate(columns, axis=1)
    if cubic:
        return ccd.JointMotion.from_cubics(joints, powers), of_oracle
    return ccd.JointMotion(joints, powers[0], powers[0] + powers[1]), of_oracle


CHAINS = {
    "of seven revolute joints": ["revolute"] * 7,
    "of all kinds": ["free", "revolute", "prismatic", "fixed", "revolute", "prismatic", "revolute"],
    "of a free joint on an arm": ["revolute", "revolute", "free", "fixed", "revolute"],
    "of slides": ["prismatic", "revolute", "prismatic", "prismatic", "revolute"],
}


@pytest.mark.parametrize("cubic", [False, True], ids=["linear", "cubic"])
@pytest.mark.parametrize("chain", CHAINS)
def test_no_point_is_farther_from_its_path_than_stated(chain, cubic):
    rng = np.random.default_rng([len(chain), cubic])
    for turn, duration in ((0.1, 0.9), (0.3, 0.3), (1.0, 0.2), (3.0, 0.4), (1.0, 1e-3), (1.0, 1e-9), (1.0, 0.0)):
        size = 10 ** rng.uniform(-3, 3)
        motion, joints = random_chain(rng, CHAINS[chain], turn, cubic, size)
        begin = rng.uniform(0, 1 - duration)
        end = begin + duration
        centres = rng.normal(size=(motion.num_links, 3)) * 0.2 * size
        reach = rng.uniform(0.01, 0.5, motion.num_links) * size
        paths, excess = motion._slices(begin, end, reach, centres)
        for row in {1, 3, motion.num_links - 1}:
            directions = rng.normal(size=(4, 3))
            lengths = np.linalg.norm(directions, axis=1, keepdims=True)
            points = centres[row] + directions / lengths * (reach[row] * (1 - 4 * EPS))
            apart = farthest(paths, row, joints[:row], points, begin, end)
            assert apart <= excess[row]
            origin = exact_place(joints[:row], [0, 0, 0], arb(float(begin)))
            assert np.abs(motion.at(begin)[row, :3] - [float(x) for x in origin]).max() < 1e-13 * size
            if duration == 1e-3 and row == motion.num_links - 1:
                assert excess[row] < 2 * apart  # a sum of two lengths for that of a sum, at a few points


@pytest.mark.parametrize("kinds", [["revolute"], ["fixed", "revolute", "fixed"], ["prismatic"], ["free"]])
def test_one_joint_is_on_its_path_but_for_rounding(kinds):
    rng = np.random.default_rng(1)
    motion, joints = random_chain(rng, kinds, 2.0, False)
    paths, excess = motion._slices(0.1, 0.9, np.ones(motion.num_links))
    assert (excess < 4000 * EPS).all()
    assert farthest(paths, len(kinds), joints, [[0.5, -0.5, 0.7]], 0.1, 0.9) <= excess[-1]


def test_a_slide_along_the_axis_of_a_turn_is_a_screw():
    joints = [ccd.Joint("slide", "ground", "carriage", "prismatic", (0, 0, 1))]
    joints += [ccd.Joint("turn", "carriage", "drill", "revolute", (0, 0, 2), (0.3, 0, 0, 0, 0, 0, 1))]
    motion = ccd.JointMotion(joints, [0, 0], [-2, 3])
    assert (motion._slices(0.0, 1.0, [1.0, 1.0, 1.0])[1] < 1e-11).all()  # rounding in all of a turn by 3 rad


def test_the_bound_falls_as_the_square_of_the_slice_and_with_a_nearer_centre():
    motion, _ = random_chain(np.random.default_rng(2), ["revolute"] * 7, 0.5, False)
    whole, half = (motion._slices(0.5, 0.5 + h, np.full(8, 0.2))[1][2:] for h in (1e-2, 0.5e-2))
    assert (np.abs(whole / half - 4) < 0.2).all()  # what the bound adds for the ends falls as the cube
    motion, _ = random_chain(np.random.default_rng(3), ["revolute"] * 7, 0.1, False)
    centred = motion._slices(0.0, 1.0, np.full(8, 0.2), np.tile([0.0, 0.2, 0.0], (8, 1)))[1]
    assert (centred[2:] < motion._slices(0.0, 1.0, np.full(8, 0.4))[1][2:]).all()


def test_worlds_have_slices_of_their_own():
    motion, _ = random_chain(np.random.default_rng(4), CHAINS["of all kinds"], 0.5, False)
    q0 = np.stack([motion.configuration(0.0), motion.configuration(0.5)])
    both = ccd.JointMotion(motion.joints, q0, motion.configuration(1.0))
    reach = np.linspace(0.1, 0.8, 8)
    paths, excess = both._slices([0.1, 0.3], [0.2, 0.6], reach)
    turns = both._turns([0.1, 0.3], [0.2, 0.6])
    for world, (begin, end) in enumerate([(0.1, 0.2), (0.3, 0.6)]):
        alone = ccd.JointMotion(motion.joints, q0[world], motion.configuration(1.0))
        rows = slice(8 * world, 8 * world + 8)
        expected, bound = alone._slices(begin, end, reach)
        assert np.array_equal(excess[rows], bound) and np.array_equal(turns[rows], alone._turns(begin, end))
        for name, rows_of in vars(expected).items():
            assert np.array_equal(getattr(paths, name)[rows], rows_of)


def test_links_turn_no_more_than_stated():
    rng = np.random.default_rng(5)
    for cubic in (False, True):
        motion, _ = random_chain(rng, CHAINS["of all kinds"], 0.5, cubic)
        times = np.linspace(0.2, 0.7, 200)
        quaternions = np.array([motion.at(t)[:, 3:] for t in times])
        steps = 2 * np.arccos(np.minimum(np.abs((quaternions[1:] * quaternions[:-1]).sum(axis=-1)), 1))
        turned, bound = steps.sum(axis=0), motion._turns(0.2, 0.7)
        assert (turned <= bound + 1e-5).all()  # the cosine of a small angle is rounded
        assert (bound <= 3 * turned).all()
