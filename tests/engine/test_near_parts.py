"""Bounds of how far bodies go in windows of slices, and parts that may touch in them, against places at many times."""

from itertools import product

import numpy as np
import pytest
import trimesh
import warp as wp
from laws.turning import turned

import ccd_warp as ccd
from ccd_warp._body_sweeps import BodySweeps
from ccd_warp._engine.host import near_parts
from ccd_warp._engine.host.near_parts import NearParts
from ccd_warp._engine.host.near_worlds import _OfWorlds
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag

# A slide and a turn carry an arm, and a second one branches off; a link floats.
JOINTS = [
    ccd.Joint(child, parent, child, kind, axis, (0, 0, height, 0, 0, 0, 1))
    for parent, child, kind, axis, height in (
        ("base", "rail", "prismatic", (1, 0.2, 0), 0.0),
        ("rail", "trunk", "revolute", (0, 0, 1), 0.1),
        ("trunk", "upper", "revolute", (0, 1, 0), 0.3),
        ("upper", "lower", "revolute", (0, 1, 0.3), 0.3),
        ("lower", "hand", "revolute", (1, 0, 0), 0.3),
        ("trunk", "left", "revolute", (1, 0, 0), 0.3),
        ("base", "free", "free", None, 0.0),
    )
]
LINKS = ["trunk", "upper", "lower", "hand", "left", "free"]
COUNT, SAMPLES, SLICES = 100, 5, 8


# --- how far bodies go ---


def bodies(path, scale, turn):
    """Sweeps of pairs of bodies of a RigidMotion, one pair a slice; places of points at times; and the pairs."""
    rng, rows, pairs = np.random.default_rng(0), np.arange(2 * COUNT), [(0, 1)]
    poses = np.concatenate([scale * rng.normal(size=(2 * COUNT, 3)), rng.normal(size=(2 * COUNT, 4))], axis=1)
    twist = np.concatenate([rng.normal(size=(2 * COUNT, 3)), turn * rng.normal(size=(2 * COUNT, 3))], axis=1)
    twist[::8, :3] = 0.0  # turns alone, and straight ones
    twist[1::8, 3:] = 0.0
    pivot = {} if path == "screw" else {"pivot": rng.normal(size=(2 * COUNT, 3))}
    paths = ccd.RigidMotion(poses, twist=twist, path=path, **pivot)._body_paths
    place = lambda x, t: paths.positions(x.reshape(-1, 3), rows, np.repeat(t, 2)).reshape(x.shape)  # noqa: E731
    return BodySweeps(paths, COUNT)._sweeps, place, pairs


def chain(is_cubic):
    """Sweeps of links of a JointMotion, one world a slice; places of points at times; and pairs of links."""
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.5, 1.5, (4, COUNT, 13))
    q[:, :, 9:] = rng.standard_normal((COUNT, 4))
    q[0, :20] = q[1, :20]  # some stand
    if is_cubic:
        q[1:, :, 9:] = 0.0
        motion = ccd.JointMotion.from_cubics(JOINTS, q.transpose(1, 0, 2), links=LINKS)
    else:
        motion = ccd.JointMotion(JOINTS, q[0], q[1], links=LINKS)
    place = lambda x, t: motion.at(t)[..., :3] + turned(motion.at(t)[..., 3:], x)  # noqa: E731
    return motion._sweeps, place, [(0, 1), (1, 2), (0, 2), (2, 4), (4, 5)]


SWEPT = [("linear", 1.0, 0.2), ("linear", 1.0, 10.0), ("linear", 1e8, 0.5), ("linear", 1e-8, 1e-9)]
SWEPT += [("screw", 1.0, 0.2), ("screw", 1.0, 10.0), ("chain", 1.0, 0.0), ("cubic chain", 1.0, 0.0)]


@pytest.mark.parametrize(("kind", "scale", "turn"), SWEPT)
def test_points_keep_to_the_bounds_of_a_window_and_come_near_them(kind, scale, turn):
    sweeps, place, pairs = chain(kind == "cubic chain") if "chain" in kind else bodies(kind, scale, turn)
    rng, (first, second) = np.random.default_rng(2), np.array(pairs).T
    begin = rng.uniform(0, 0.9, COUNT)
    end = begin + rng.uniform(0, 0.1, COUNT)
    shares = np.concatenate([(np.arange(n) + 0.5) / n for n in (1, 2, 4)])
    found = sweeps(begin, end, begin + shares[:, None] * (end - begin), np.array(pairs))
    count = found.reach.shape[1]
    points = rng.normal(size=(COUNT, count, 3)) * rng.choice([0.0, 0.1, 10.0], (COUNT, count, 1))
    arm, relative = np.linalg.norm(points, axis=2), found.relative
    origin, error, turns, wrong, bend, bend_of_arm = np.moveaxis(found.reach, 2, 0)
    if relative.shape[1] == 0:
        a, b = found.reach[:, first], found.reach[:, second]
        relative = np.concatenate([a[..., :2] + b[..., :2], a[..., 2:4], b[..., 2:4]], axis=2)
    length, off, of_a, off_a, of_b, off_b = np.moveaxis(relative, 2, 0)
    for window, share in enumerate(shares):
        short = 0.5 ** int(np.log2(window + 1))  # half of the window, as a share of half the slice
        goes = origin * short + error + (turns * short + wrong) * arm
        bends = (bend + bend_of_arm * arm) * short**2 + error + wrong * arm
        comes = length * short + off + (of_a * short + off_a) * arm[:, first] + (of_b * short + off_b) * arm[:, second]

        def at(tau, x=points, share=share, short=short):
            return place(x, begin + (share + 0.5 * tau * short) * (end - begin))

        middle, zero = at(0.0), at(0.0, np.zeros_like(points))
        assert np.abs(found.position[:, window] - zero).max() <= 1e-13 * max(scale, 1.0)
        speed = found.velocity[:, window] + np.cross(found.omega[:, window], middle - zero)
        apart = np.linalg.norm(middle[:, first] - middle[:, second], axis=2)
        largest, rounding = np.zeros((3, COUNT)), 1e-14 * np.abs(middle).max()  # of a distance here
        for tau in np.linspace(-1, 1, 21):
            now = at(tau)
            goes_now, bends_now = (np.linalg.norm(now - middle - x, axis=2) for x in (0.0, tau * short * speed))
            nearer = apart - np.linalg.norm(now[:, first] - now[:, second], axis=2)
            assert (goes_now <= goes).all() and (bends_now <= bends).all() and (nearer <= comes + rounding).all()
            with np.errstate(invalid="ignore", divide="ignore"):
                ratios = [goes_now / goes, bends_now / bends, nearer / comes]
            largest = np.maximum(largest, [np.nan_to_num(x).max(axis=1) for x in ratios])
        if scale == 1.0:  # the bounds are of use
            assert np.median(largest[0]) > 0.3 and np.median(largest[1]) > 0.2 and largest[2].max() > 0.6


# --- parts that may touch ---


def links_and_boxes(radius=0.0):
    """Links of a few parts, boxes and a plate that stand, and a motion of as many worlds as slices."""
    rng = np.random.default_rng(3)
    link = trimesh.creation.capsule(0.25, 0.05, count=[8, 8])
    boxes = [trimesh.creation.box(rng.uniform(0.05, 0.3, 3)).apply_translation(c) for c in rng.uniform(-1, 1, (6, 3))]
    boxes.append(trimesh.creation.box([2, 2, 0.01]).apply_translation([0, 0, -0.3]))
    may = np.abs(np.subtract.outer(np.arange(13), np.arange(13))) > 1
    may[:, 6:] = may[6:] = True
    mesh = ccd.CollisionMesh.from_trimesh(
        6 * [link] + boxes, rigid=range(6), static=range(6, 13), body_pairs=may, radius=radius
    )
    q0 = rng.uniform(-1.5, 1.5, (SLICES, 13))
    q0[:, 9:] = rng.standard_normal((SLICES, 4))
    return mesh, ccd.JointMotion(JOINTS, q0, q0 + rng.uniform(-1, 1, (SLICES, 13)), links=LINKS)


scene = pytest.fixture(links_and_boxes, scope="module")


def near(parts, motion, begin, end, reach, halvings=0, slices=None):
    execution = Execution(wp.get_device("cpu"), 2, StopFlag(wp.get_device("cpu")))
    return parts.near(motion, np.arange(SLICES) if slices is None else slices, begin, end, reach, execution, halvings)


@pytest.mark.parametrize(("reach", "halvings"), [(0.05, 0), (0.2, 0), (0.05, 2)])
def test_parts_that_come_near_in_a_window_are_found_and_most_others_are_not(scene, reach, halvings, monkeypatch):
    mesh, motion = scene
    parts = NearParts(mesh, mesh.vertices)
    assert np.bincount(parts.body)[0] > 8  # so that there is a tree of them
    # slices in several launches, and more pairs than there is room for at first
    monkeypatch.setattr(near_parts, "_MOST_ITEMS", 5 * len(parts.pairs))
    monkeypatch.setattr(near_parts, "_ROOM", 16)
    rng, each = np.random.default_rng(5), 1 << halvings
    begin = rng.uniform(0, 0.7, SLICES)
    end = begin + rng.uniform(0.01, 0.3, SLICES)
    is_near = np.zeros((SLICES * each, len(parts.body), len(parts.body)), dtype=bool)
    is_near[near(parts, motion, begin, end, reach, halvings)] = True
    may = np.zeros_like(is_near[0])
    for x, y in parts.pairs:
        may |= (parts.body[:, None] == x) & (parts.body == y)
    assert not is_near[:, ~may].any() and is_near.sum() < 0.4 * may.sum() * SLICES * each
    # corners of faces that come within the distance, in parts that were not found
    part = np.repeat(np.arange(len(parts.body)), 3 * np.diff(parts.begins))
    points = mesh.vertices[parts.primitives(np.arange(parts.begins[-1]))[0]].reshape(-1, 3)
    chosen = np.unique(np.column_stack([part, points]), axis=0, return_index=True)[1]
    part, points, num_near = part[chosen], points[chosen], 0
    is_link, body = parts.body[part] < len(LINKS), parts.body[part]
    for n, share in product(range(each), np.linspace(0, 1, SAMPLES)):
        poses = motion.at(begin + (n + share) / each * (end - begin))
        for k in range(SLICES):
            x, of_links = points.copy(), poses[k, body[is_link]]
            x[is_link] = turned(of_links[:, 3:], x[is_link]) + of_links[:, :3]
            squares = (x * x).sum(axis=1)
            touching = np.argwhere(squares[:, None] + squares - 2.0 * x @ x.T <= (reach - 1e-6) ** 2)
            first, second = part[touching].T
            allowed = may[first, second]
            assert is_near[k * each + n, first[allowed], second[allowed]].all()
            num_near += int(allowed.sum())
    assert num_near > 5000


def test_parts_with_coordinates_that_are_no_numbers_are_near_everything(scene):
    mesh, motion = scene
    vertices, times = mesh.vertices.copy(), np.zeros(SLICES)
    vertices[5] = np.nan
    parts = NearParts(mesh, vertices)
    _, a, b = near(parts, motion, times, times + 0.1, 0.0, 1)
    corners = parts.primitives(np.arange(parts.begins[-1]))[0]
    wrong = np.flatnonzero([np.isnan(vertices[x]).any() for x in np.split(corners, parts.begins[1:-1])])
    partners = {y for pair in parts.pairs.tolist() if 0 in pair for y in pair if y}
    assert len(wrong) > 0
    for part in wrong:
        found = {*b[a == part].tolist(), *a[b == part].tolist()}
        assert found == set(np.flatnonzero(np.isin(parts.body, list(partners))).tolist())


@pytest.mark.parametrize("both_move", [False, True])
@pytest.mark.parametrize("arm", [0.0, 3.0])
def test_triangles_are_near_at_the_distance_to_which_they_come(arm, both_move):
    """A triangle that turns about its middle, or far from it, with a pace of its own or none, and one beside it."""
    count, rng = 60, np.random.default_rng(7)
    sides = rng.normal(size=(2, 3, 3)) * [[[1.0], [1.0], [0.1]], [[1.0], [0.2], [0.1]]]
    corners = [x - 0.5 * (x.min(axis=0) + x.max(axis=0)) + [arm, 0, 0] for x in sides]
    triangles, moving = [(x, [[0, 1, 2]]) for x in corners], [0, 1][: 1 + both_move]
    static = [] if both_move else [1]
    mesh = ccd.CollisionMesh.from_arrays(triangles, rigid=moving, static=static, self_collision=False)
    poses = np.concatenate([rng.normal(size=(count, 2, 3)), rng.normal(size=(count, 2, 4))], axis=2)
    twist = 0.6 * rng.normal(size=(count, 2, 6)) * rng.choice([0.0, 1.0], (count, 1, 6))
    motion, parts = ccd.RigidMotion(poses[:, moving], twist=twist[:, moving]), NearParts(mesh, mesh.vertices)
    weights = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12
    least, rows = np.full(count, np.inf), len(moving) * np.arange(count)
    for t in np.linspace(0, 1, 33):
        places = [weights @ np.broadcast_to(x, (count, 3, 3)) for x in corners]
        for k in moving:
            x = np.repeat(rows + k, len(weights))
            own = motion._body_paths.positions(places[k].reshape(-1, 3), x, np.full(len(x), t))
            places[k] = own.reshape(count, -1, 3)
        apart = np.linalg.norm(places[0][:, :, None] - places[1][:, None], axis=3).min(axis=(1, 2))
        least = np.minimum(least, apart)
    motion, (begin, end) = _OfWorlds(motion), np.array([[0.0], [1.0]])
    found = [
        [len(near(parts, motion, begin, end, s * d, 0, np.array([k]))[0]) for k, d in enumerate(least)]
        for s in (1.0, 0.5)
    ]
    assert found[0] == [1] * count and sum(found[1]) < 0.8 * count


@pytest.mark.parametrize("radius", [0.0, 0.5])
def test_many_bodies_meet_by_the_boxes_of_all_slices(radius, monkeypatch):
    """Which pairs of bodies are tested at all leaves out no pair of parts."""
    (mesh, motion), begin, found = links_and_boxes(radius), np.linspace(0, 0.7, SLICES), []
    parts = NearParts(mesh, mesh.vertices)
    for many in (1 << 20, 1):
        monkeypatch.setattr(near_parts, "_MANY", many)
        found.append({*zip(*(x.tolist() for x in near(parts, motion, begin, begin + 0.1, 0.05, 1)), strict=True)})
    assert found[0] == found[1] and len(found[0]) > 100
