"""Bounds of how far bodies go in slices, and parts that may touch in them, against places at many times."""

from itertools import product

import numpy as np
import pytest
import trimesh
import warp as wp
from laws.turning import turned

import ccd_warp as ccd
from ccd_warp._rigid.parts import overlap
from ccd_warp._rigid.parts.bounds import SweptBounds
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag

COUNT, SAMPLES, SLICES, BODIES = 100, 20, 8, 6

# --- how far bodies go ---

SWEPT = [("linear", 1.0, 0.2), ("linear", 1.0, 10.0), ("linear", 1e8, 0.5), ("linear", 1e-8, 1e-9)]
SWEPT += [("screw", 1.0, 0.2), ("screw", 1.0, 10.0)]


@pytest.mark.parametrize(("path", "scale", "turn"), SWEPT)
def test_points_keep_to_the_bounds_of_a_slice_and_come_near_them(path, scale, turn):
    """Of two bodies a slice, some of which are beside their paths."""
    rng, rows = np.random.default_rng(0), np.arange(2 * COUNT)
    poses = np.concatenate([scale * rng.normal(size=(2 * COUNT, 3)), rng.normal(size=(2 * COUNT, 4))], axis=1)
    twist = np.concatenate([rng.normal(size=(2 * COUNT, 3)), turn * rng.normal(size=(2 * COUNT, 3))], axis=1)
    twist[::8, :3] = 0.0  # turns alone, and straight ones
    twist[1::8, 3:] = 0.0
    pivot = {} if path == "screw" else {"pivot": rng.normal(size=(2 * COUNT, 3))}
    within = rng.choice([0.0, 0.1 * scale], 2 * COUNT)
    paths = ccd.RigidMotion(poses, twist=twist, path=path, within=within, **pivot)._body_paths
    begin = rng.uniform(0, 0.9, COUNT)
    end = begin + rng.uniform(0, 0.1, COUNT)
    found = SweptBounds.of(paths, begin, end)
    points = rng.normal(size=(2 * COUNT, 3)) * rng.choice([0.0, 0.1, 10.0], (2 * COUNT, 1))
    arm, velocity, omega = np.linalg.norm(points, axis=1), found.velocity.reshape(-1, 3), found.omega.reshape(-1, 3)
    origin, error, turns, wrong, bend, bend_of_arm = found.reach.reshape(-1, 6).T
    goes, bends = origin + error + (turns + wrong) * arm, bend + bend_of_arm * arm + error + wrong * arm
    middle, half = np.repeat(0.5 * (begin + end), 2), np.repeat(0.5 * (end - begin), 2)

    def at(tau, x=points):
        return paths.positions(x, rows, middle + tau * half)

    start, zero = at(0.0), at(0.0, np.zeros_like(points))
    assert np.abs(found.position.reshape(-1, 3) - zero).max() <= 1e-13 * max(scale, 1.0)
    speed, largest = velocity + np.cross(omega, start - zero), np.zeros((2, 2 * COUNT))
    for tau in np.linspace(-1, 1, 21):
        moved = at(tau) - start
        goes_now, bends_now = (np.linalg.norm(moved - x, axis=1) + within for x in (0.0, tau * speed))
        assert (goes_now <= goes).all() and (bends_now <= bends).all()
        largest = np.maximum(largest, [goes_now / goes, bends_now / bends])
    if scale == 1.0:  # the bounds are of use
        assert np.median(largest[0]) > 0.3 and np.median(largest[1]) > 0.2


# --- parts that may touch ---


def bodies_and_boxes(radius=0.0):
    """Bodies of a few parts, boxes and a plate that stand, and a motion of as many worlds as slices."""
    rng = np.random.default_rng(3)
    body = trimesh.creation.capsule(0.25, 0.05, count=[8, 8])
    boxes = [trimesh.creation.box(rng.uniform(0.05, 0.3, 3)).apply_translation(c) for c in rng.uniform(-1, 1, (6, 3))]
    boxes.append(trimesh.creation.box([2, 2, 0.01]).apply_translation([0, 0, -0.3]))
    may = np.abs(np.subtract.outer(np.arange(13), np.arange(13))) > 1
    may[:, BODIES:] = may[BODIES:] = True
    mesh = ccd.CollisionMesh.from_trimesh(
        BODIES * [body] + boxes, rigid=range(BODIES), static=range(BODIES, 13), body_pairs=may, radius=radius
    )
    places, turns = 0.5 * rng.normal(size=(SLICES, BODIES, 3)), rng.normal(size=(SLICES, BODIES, 4))
    twist = rng.normal(size=(SLICES, BODIES, 6)) * rng.choice([0.0, 0.3, 1.0], (SLICES, BODIES, 1))
    within = rng.choice([0.0, 0.03], (SLICES, BODIES))
    return mesh, ccd.RigidMotion(np.concatenate([places, turns], axis=2), twist=twist, within=within)


scene = pytest.fixture(bodies_and_boxes, scope="module")


def near(parts, motion, begin, end, reach, slices=None):
    execution = Execution(wp.get_device("cpu"), 2, StopFlag(wp.get_device("cpu")))
    return parts.overlapping(motion, np.arange(SLICES) if slices is None else slices, begin, end, reach, execution)


@pytest.mark.parametrize("reach", [0.05, 0.2])
def test_parts_that_come_near_in_a_slice_are_found_and_most_others_are_not(scene, reach, monkeypatch):
    mesh, motion = scene
    parts = BodyParts(mesh, mesh.vertices)
    assert np.bincount(parts.body)[0] > 8  # so that there is a tree of them
    # slices in several launches, and more pairs than the capacity at first
    monkeypatch.setattr(overlap, "_MOST_ITEMS", 5 * len(parts.pairs))
    monkeypatch.setattr(overlap, "_CAPACITY", 16)
    rng = np.random.default_rng(5)
    begin = rng.uniform(0, 0.7, SLICES)
    end = begin + rng.uniform(0.01, 0.3, SLICES)
    is_near = np.zeros((SLICES, len(parts.body), len(parts.body)), dtype=bool)
    is_near[near(parts, motion, begin, end, reach)] = True
    may = np.zeros_like(is_near[0])
    for x, y in parts.pairs:
        may |= (parts.body[:, None] == x) & (parts.body == y)
    assert not is_near[:, ~may].any() and is_near.sum() < 0.4 * may.sum() * SLICES
    # corners of faces that come within the distance, and as near as their paths leave open
    part = np.repeat(np.arange(len(parts.body)), 3 * np.diff(parts.begins))
    points = mesh.vertices[parts.primitives(np.arange(parts.begins[-1]))[0]].reshape(-1, 3)
    chosen = np.unique(np.column_stack([part, points]), axis=0, return_index=True)[1]
    part, points, num_near = part[chosen], points[chosen], 0
    is_rigid, body = parts.body[part] < BODIES, parts.body[part]
    for share, k in product(np.linspace(0, 1, SAMPLES), range(SLICES)):
        x, poses, off = points.copy(), motion.at(begin[k] + share * (end[k] - begin[k]))[k], np.zeros(len(points))
        x[is_rigid] = turned(poses[body[is_rigid], 3:], x[is_rigid]) + poses[body[is_rigid], :3]
        off[is_rigid] = motion.within[k, body[is_rigid]]
        squares = (x * x).sum(axis=1)
        most = reach + off[:, None] + off - 1e-6
        touching = np.argwhere(squares[:, None] + squares - 2.0 * x @ x.T <= most**2)
        first, second = part[touching].T
        allowed = may[first, second]
        assert is_near[k, first[allowed], second[allowed]].all()
        num_near += int(allowed.sum())
    assert num_near > 5000


def test_parts_with_coordinates_that_are_no_numbers_are_near_everything(scene):
    mesh, motion = scene
    vertices, times = mesh.vertices.copy(), np.zeros(SLICES)
    vertices[5] = np.nan
    parts = BodyParts(mesh, vertices)
    _, a, b = near(parts, motion, times, times + 0.1, 0.0)
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
    motion, parts = ccd.RigidMotion(poses[:, moving], twist=twist[:, moving]), BodyParts(mesh, mesh.vertices)
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
    begin, end = np.array([[0.0], [1.0]])
    found = [
        [len(near(parts, motion, begin, end, s * d, np.array([k]))[0]) for k, d in enumerate(least)] for s in (1.0, 0.5)
    ]
    assert found[0] == [1] * count and sum(found[1]) < 0.8 * count


@pytest.mark.parametrize("radius", [0.0, 0.5])
def test_many_bodies_meet_by_the_boxes_of_all_slices(radius, monkeypatch):
    """Which pairs of bodies are tested at all leaves out no pair of parts."""
    (mesh, motion), begin, found = bodies_and_boxes(radius), np.linspace(0, 0.7, SLICES), []
    parts = BodyParts(mesh, mesh.vertices)
    for many in (1 << 20, 1):
        monkeypatch.setattr(overlap, "_MANY", many)
        found.append({*zip(*(x.tolist() for x in near(parts, motion, begin, begin + 0.1, 0.05)), strict=True)})
    assert found[0] == found[1] and len(found[0]) > 100
