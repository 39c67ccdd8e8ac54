"""Parts of bodies that may touch in slices of a motion of joints, against places of all vertices at many times."""

from itertools import product

import numpy as np
import pytest
import trimesh
import warp as wp

import ccd_warp as ccd
from ccd_warp._engine.host import near_parts
from ccd_warp._engine.host.near_parts import NearParts
from ccd_warp._engine.host.near_worlds import _OfWorlds
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag

HEIGHT = (0, 0, 0.3, 0, 0, 0, 1)
# A slide and a turn carry an arm, and a second one branches off; a link floats.
JOINTS = [
    ccd.Joint("slide", "base", "rail", "prismatic", (1, 0.2, 0)),
    ccd.Joint("waist", "rail", "trunk", "revolute", (0, 0, 1), (0, 0, 0.1, 0, 0, 0, 1)),
    ccd.Joint("shoulder", "trunk", "upper", "revolute", (0, 1, 0), HEIGHT),
    ccd.Joint("elbow", "upper", "lower", "revolute", (0, 1, 0.3), HEIGHT),
    ccd.Joint("wrist", "lower", "hand", "revolute", (1, 0, 0), HEIGHT),
    ccd.Joint("other", "trunk", "left", "revolute", (1, 0, 0), HEIGHT),
    ccd.Joint("float", "base", "free", "free"),
]
LINKS = ["trunk", "upper", "lower", "hand", "left", "free"]
SAMPLES, SLICES = 5, 8


@pytest.fixture(scope="module")
def scene():
    """Links of a few parts, boxes and a plate that stand, and a motion of as many worlds as slices."""
    rng = np.random.default_rng(3)
    link = trimesh.creation.capsule(0.25, 0.05, count=[8, 8])
    boxes = [trimesh.creation.box(rng.uniform(0.05, 0.3, 3)).apply_translation(c) for c in rng.uniform(-1, 1, (6, 3))]
    boxes.append(trimesh.creation.box([2, 2, 0.01]).apply_translation([0, 0, -0.3]))
    count = len(LINKS)
    may = np.abs(np.subtract.outer(np.arange(count + 7), np.arange(count + 7))) > 1
    may[:, count:] = may[count:] = True
    bodies = [*count * [link], *boxes]
    mesh = ccd.CollisionMesh.from_trimesh(bodies, rigid=range(count), static=range(count, count + 7), body_pairs=may)
    q0 = rng.uniform(-1.5, 1.5, (SLICES, 13))
    q0[:, 9:] = rng.standard_normal((SLICES, 4))
    q1 = q0 + rng.uniform(-1, 1, (SLICES, 13))
    return mesh, ccd.JointMotion(JOINTS, q0, q1, links=LINKS)


def near(parts, motion, begin, end, reach, halvings):
    execution = Execution(wp.get_device("cpu"), 2, StopFlag(wp.get_device("cpu")))
    return parts.near(motion, np.arange(SLICES), begin, end, reach, execution, halvings)


@pytest.mark.parametrize(("reach", "halvings"), [(0.05, 0), (0.2, 0), (0.05, 2)])
def test_parts_that_come_near_in_a_window_are_found_and_most_others_are_not(scene, reach, halvings, monkeypatch):
    mesh, motion = scene
    parts = NearParts(mesh, mesh.vertices)
    assert np.bincount(parts.body)[0] > 8  # so that there is a tree of them
    # slices in several launches, and more pairs than there is room for at first
    monkeypatch.setattr(near_parts, "_MOST_ITEMS", 5 * len(parts.pairs))
    monkeypatch.setattr(near_parts, "_ROOM", 16)
    rng = np.random.default_rng(5)
    begin = rng.uniform(0, 0.7, SLICES)
    end = begin + rng.uniform(0.01, 0.3, SLICES)
    window, a, b = near(parts, motion, begin, end, reach, halvings)
    each = 1 << halvings
    is_near = np.zeros((SLICES * each, len(parts.body), len(parts.body)), dtype=bool)
    is_near[window, a, b] = True
    may = np.zeros_like(is_near[0])
    for x, y in parts.pairs:
        may |= (parts.body[:, None] == x) & (parts.body == y)
    assert not is_near[:, ~may].any() and is_near.sum() < 0.4 * may.sum() * SLICES * each
    # corners of faces that come within the distance, in parts that were not found
    part = np.repeat(np.arange(len(parts.body)), 3 * np.diff(parts.begins))
    points = mesh.vertices[parts.primitives(np.arange(parts.begins[-1]))[0]].reshape(-1, 3)
    chosen = np.unique(np.column_stack([part, points]), axis=0, return_index=True)[1]
    part, points, num_near = part[chosen], points[chosen], 0
    body = parts.body[part]
    for n, share in product(range(each), np.linspace(0, 1, SAMPLES)):
        poses = motion.at(begin + (n + share) / each * (end - begin))
        for k in range(SLICES):
            x = points.copy()
            for link, pose in enumerate(poses[k]):
                turn = trimesh.transformations.quaternion_matrix(pose[[6, 3, 4, 5]])[:3, :3]
                x[body == link] = x[body == link] @ turn.T + pose[:3]
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
    bodies = [(x - 0.5 * (x.min(axis=0) + x.max(axis=0)) + [arm, 0, 0], np.array([[0, 1, 2]])) for x in sides]
    moving = [0, 1] if both_move else [0]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=moving, static=[] if both_move else [1], self_collision=False)
    poses = np.concatenate([rng.normal(size=(count, 2, 3)), rng.normal(size=(count, 2, 4))], axis=2)
    twist = 0.6 * rng.normal(size=(count, 2, 6)) * rng.choice([0.0, 1.0], (count, 1, 6))
    motion = ccd.RigidMotion(poses[:, moving], twist=twist[:, moving])
    parts = NearParts(mesh, mesh.vertices)
    weights = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12
    execution = Execution(wp.get_device("cpu"), 1, StopFlag(wp.get_device("cpu")))
    rows, slack = len(moving) * np.arange(count), []
    for t in np.linspace(0, 1, 33):
        places = [weights @ np.broadcast_to(x, (count, 3, 3)) for x, _ in bodies]
        for k in moving:
            x = np.repeat(rows + k, len(weights))
            own = motion._body_paths.positions(places[k].reshape(-1, 3), x, np.full(len(x), t))
            places[k] = own.reshape(count, -1, 3)
        slack.append(np.linalg.norm(places[0][:, :, None] - places[1][:, None], axis=3).min(axis=(1, 2)))
    least = np.min(slack, axis=0)
    found = np.zeros((2, count))
    for (row, share), k in product(enumerate((1.0, 0.5)), range(count)):
        whole = _OfWorlds(motion), np.array([k]), np.zeros(1), np.ones(1)
        found[row, k] = len(parts.near(*whole, share * least[k], execution)[0])
    assert (found[0] == 1).all() and found[1].sum() < 0.8 * count


def test_many_bodies_meet_by_the_boxes_of_all_slices(scene, monkeypatch):
    """Which pairs of bodies are tested at all leaves out no pair of parts."""
    mesh, motion = scene
    parts = NearParts(mesh, mesh.vertices)
    begin = np.linspace(0, 0.7, SLICES)
    found = []
    for many in (1 << 20, 1):
        monkeypatch.setattr(near_parts, "_MANY", many)
        found.append(near(parts, motion, begin, begin + 0.1, 0.05, 1))
    rows = [set(zip(*(x.tolist() for x in each), strict=True)) for each in found]
    assert rows[0] == rows[1] and len(rows[0]) > 100
