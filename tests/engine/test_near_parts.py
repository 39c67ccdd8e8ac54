"""Parts of bodies that may touch in slices of a motion of joints, against places of all vertices at many times."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._engine.host import near_parts
from ccd_warp._engine.host.near_parts import NearParts

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
SAMPLES, SLICES = 9, 8


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


@pytest.mark.parametrize("reach", [0.05, 0.2])
def test_parts_that_come_near_in_a_slice_are_found_and_most_others_are_not(scene, reach, monkeypatch):
    mesh, motion = scene
    parts = NearParts(mesh, mesh.vertices)
    leaves = parts.levels[-1]
    assert np.bincount(leaves.body)[0] > 8  # so that there are groups of them
    monkeypatch.setattr(near_parts, "_MOST_SLICES", 5)
    rng = np.random.default_rng(5)
    begin = rng.uniform(0, 0.7, SLICES)
    end = begin + rng.uniform(0.01, 0.3, SLICES)
    row, a, b = parts.near(motion, np.arange(SLICES), begin, end, reach)
    is_near = np.zeros((SLICES, len(leaves.body), len(leaves.body)), dtype=bool)
    is_near[row, a, b] = True
    may = np.zeros_like(is_near[0])
    for x, y in parts.pairs:
        may |= (leaves.body[:, None] == x) & (leaves.body == y)
    assert not is_near[:, ~may].any() and is_near.sum() < 0.5 * may.sum() * SLICES
    # middles of faces that come within the distance, in parts that were not found
    part = np.repeat(np.arange(len(leaves.body)), np.diff(leaves.first))
    middles = mesh.vertices[parts.primitives].mean(axis=1)
    body = leaves.body[part]
    num_near = 0
    for t in np.linspace(0, 1, SAMPLES):
        poses = motion.at(begin + t * (end - begin))
        for k in range(SLICES):
            x = middles.copy()
            for link, pose in enumerate(poses[k]):
                turn = trimesh.transformations.quaternion_matrix(pose[[6, 3, 4, 5]])[:3, :3]
                x[body == link] = x[body == link] @ turn.T + pose[:3]
            squares = (x * x).sum(axis=1)
            touching = np.argwhere(squares[:, None] + squares - 2.0 * x @ x.T <= (reach - 1e-6) ** 2)
            first, second = part[touching].T
            allowed = may[first, second]
            assert is_near[k, first[allowed], second[allowed]].all()
            num_near += int(allowed.sum())
    assert num_near > 500


def test_what_stands_still_is_near_no_more_than_it_is(scene):
    mesh, motion = scene
    parts = NearParts(mesh, mesh.vertices)
    times = np.zeros(SLICES)
    counts = [len(parts.near(motion, np.arange(SLICES), times, times + d, 0.0)[0]) for d in (0.0, 0.1, 0.3)]
    assert counts[0] < counts[1] < counts[2]
