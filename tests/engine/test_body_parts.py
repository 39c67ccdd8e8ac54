"""Which parts of bodies come near each other in slices of a motion, against their places at many times."""

import copy

import numpy as np
import pytest
import trimesh
import warp as wp
from laws.turning import turned, unit

import ccd_warp as ccd
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.motion import Slices
from ccd_warp._rigid.parts import near_search, whole_bodies
from ccd_warp._rigid.parts.near_search import find_near
from ccd_warp._rigid.parts.overlap import BodyParts

WORLDS, SLICES, T_MAX, BODIES = 4, 2, 0.8, 6
MANY = 1500


def near(mesh, motion, parts=None, vertices=None, *, num_slices=SLICES, reach=0.0, t_max=T_MAX, wants_parts=False):
    """Which bodies, whole or by their parts, are near in each slice of each world, [S, W, B], and parts, [W, P]."""
    vertices = mesh.vertices if vertices is None else vertices
    of_step = (vertices, vertices), motion._body_paths, Slices(num_slices, t_max), reach, 2
    found = find_near(Topology.of(mesh, wp.get_device("cpu")), parts, *of_step, wants_parts=wants_parts)
    bodies = np.zeros((num_slices, motion.num_worlds, mesh.num_bodies), dtype=bool)
    bodies[found.number] = found.bodies
    return found._replace(bodies=bodies)


def placed(motion, corners, t):
    """Corners of bodies, [n, 3] of each, at a time of each world, [W, n, 3] of each."""
    poses = motion.at(np.broadcast_to(np.reshape(t, (-1, 1)), motion.turns.shape))
    many = [np.broadcast_to(x, (len(poses), *x.shape)) for x in corners]
    return [turned(poses[:, k, None, 3:], x) + poses[:, k, None, :3] for k, x in enumerate(many)]


# --- bodies of many parts ---


def scene(radius=0.0):
    """Bodies of a few parts, boxes and a plate that stand, a half-space, and a motion of several worlds."""
    rng = np.random.default_rng(3)
    body = trimesh.creation.capsule(0.25, 0.05, count=[9, 9])
    boxes = [trimesh.creation.box(rng.uniform(0.05, 0.3, 3)).apply_translation(c) for c in rng.uniform(-1, 1, (6, 3))]
    boxes += [trimesh.creation.box([2, 2, 0.01]).apply_translation([0, 0, -0.3])]
    ground, count = ccd.HalfSpace((0, 0, -0.6), (0.1, 0, 1)), BODIES + 7
    may = np.abs(np.subtract.outer(*2 * [np.arange(count + 1)])) > 1
    may[:, BODIES:] = may[BODIES:] = True
    mesh = ccd.CollisionMesh.from_trimesh(
        [*BODIES * [body], *boxes, ground], rigid=range(BODIES), static=range(BODIES, count + 1), body_pairs=may,
        radius=radius,
    )  # fmt: skip
    poses = rng.normal(size=(WORLDS, BODIES, 7)) * [0.5, 0.5, 0.5, 1, 1, 1, 1]
    twist = rng.normal(size=(WORLDS, BODIES, 6)) * rng.choice([0.0, 0.3, 1.0], (WORLDS, BODIES, 1))
    return mesh, ccd.RigidMotion(poses, twist=twist, within=rng.choice([0.0, 0.03], (WORLDS, BODIES)))


@pytest.mark.parametrize(("reach", "radius"), [(0.05, 0.0), (0.1, 0.05)])
def test_parts_that_come_near_in_a_slice_are_found_and_most_others_are_not(reach, radius, monkeypatch):
    mesh, motion = scene(radius)
    parts = BodyParts(mesh, mesh.vertices)
    assert np.bincount(parts.body)[0] > 8  # so that there is a tree of them
    monkeypatch.setattr(near_search, "_MOST_ITEMS", 4 * len(parts.pairs))  # worlds in several searches
    monkeypatch.setattr(whole_bodies, "_RUN", 8)
    by_parts, every, whole = (
        near(mesh, motion, *how, reach=reach, wants_parts=len(how) == 2)
        for how in ((parts,), (parts, mesh.vertices), ())
    )
    np.testing.assert_array_equal(by_parts.bodies, every.bodies)
    assert not by_parts.parts.size and not whole.parts.size and every.parts.shape == (WORLDS, len(parts.body))
    assert not whole.bodies[..., :BODIES].all()
    # the parts of each pair of bodies, and those of which the pair is
    of_pairs, number = [], np.full((len(parts.body), len(parts.body)), -1)
    for k, (x, y) in enumerate(parts.pairs):
        one = copy.copy(parts)
        one.pairs, one.idle, one._on_device = parts.pairs[k : k + 1], {}, {}
        of_pairs.append(near(mesh, motion, one, reach=reach, wants_parts=True).parts)
        is_pair = (parts.body[:, None] == x) & (parts.body == y) if y >= 0 else np.diag(parts.body == x)
        number[is_pair | is_pair.T] = k
    is_near = np.stack(of_pairs, axis=1)
    assert is_near.mean() < 0.1
    part, vertex = np.unique(
        np.column_stack([
            np.repeat(np.arange(len(parts.body)), 3 * np.diff(parts.begins)),
            parts.primitives(np.arange(parts.begins[-1]))[0].ravel(),
        ]), axis=0,
    ).T  # fmt: skip
    body, num_near = parts.body[part], 0
    stands = np.broadcast_to(mesh.vertices[vertex[body >= BODIES]], (WORLDS, (body >= BODIES).sum(), 3))
    corners, within = [mesh.vertices[vertex[body == k]] for k in range(BODIES)], np.zeros((WORLDS, mesh.num_bodies))
    within[:, :BODIES] = motion.within
    for k, share in np.ndindex(SLICES, 6):
        moved = placed(motion, corners, np.full(WORLDS, T_MAX * (k + share / 5) / SLICES))
        places = np.concatenate([*moved, stands], axis=1)
        for world, x in enumerate(places):
            squares, most = (x * x).sum(axis=1), reach + 2.0 * radius - 1e-6 + within[world, body]
            apart = squares[:, None] + squares - 2.0 * x @ x.T
            first, second = part[np.argwhere(apart <= (most[:, None] + within[world, body]) ** 2).T]
            height = (x - mesh.planes.points[0]) @ mesh.planes.normals[0] / np.linalg.norm(mesh.planes.normals[0])
            lies = part[(height <= most - radius) & (body < BODIES)]
            meets = (number[first, second] >= 0) & (first != second)
            first, second = np.append(first[meets], lies), np.append(second[meets], lies)
            for y in (first, second):
                assert is_near[world, number[first, second], y].all() and every.parts[world, y].all()
                assert by_parts.bodies[k, world, parts.body[y]].all() and whole.bodies[k, world, parts.body[y]].all()
            num_near += len(first)
    assert num_near > 1000


def test_parts_with_coordinates_that_are_no_numbers_are_near_everything():
    mesh, motion = scene()
    vertices = mesh.vertices.copy()
    vertices[5] = np.nan
    parts = BodyParts(mesh, vertices)
    corners = parts.primitives(np.arange(parts.begins[-1]))[0]
    wrong = np.flatnonzero([np.isnan(vertices[x]).any() for x in np.split(corners, parts.begins[1:-1])])
    partners = {y for pair in parts.pairs.tolist() if 0 in pair for y in pair if y > 0}
    for found in (near(mesh, motion, parts, wants_parts=True), near(mesh, motion, vertices=vertices)):
        assert found.bodies[..., [0, *partners]].all()
    is_partner = np.isin(parts.body, list(partners))
    near_parts = near(mesh, motion, parts, wants_parts=True).parts
    assert len(wrong) > 0 and near_parts[:, wrong].all() and near_parts[:, is_partner].all()


# --- two bodies of one part ---


def spins(kind, rng, turn):
    """Rotation vectors of two bodies in each world, of about that length."""
    first, other = (np.reshape(turn, (-1, 1)) * unit(rng.normal(size=(MANY, 3))) for _ in range(2))
    if kind == "nearly common":
        return np.stack([first, first + rng.choice([1e-12, 0.01, 0.1, 0.5], (MANY, 1)) * other], axis=1)
    return np.stack([first, {"one": 0.0 * first, "common": first, "any": other}[kind]], axis=1)


@pytest.mark.parametrize("kind", ["one", "common", "nearly common", "any"])
@pytest.mark.parametrize("path", ["linear", "screw"])
@pytest.mark.parametrize("sides", [(0.0, 0.0, 0.0), (1.0, 0.3, 0.02)])
def test_parts_are_near_at_the_distance_to_which_they_come(sides, path, kind):
    """Points, or corners of a box, which reach each other by the lengths that they may be beside their paths."""
    rng, no_faces = np.random.default_rng(7), np.zeros((0, 3), dtype=int)
    corners = [0.5 * np.array(sides) * rng.choice([-1, 1], (8, 3)) + arm for arm in ([0, 0, 0], [0.2, -0.5, 0.8])]
    bodies, plane = [(x, no_faces) for x in corners], ccd.HalfSpace((0, 0, 0), (1, 2, 2))
    of_points = {"codimensional_points": True}
    both = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1], **of_points)
    by_plane = [ccd.CollisionMesh.from_arrays([x, plane], rigid=[0], static=[1], **of_points) for x in bodies]
    turn = 10.0 ** rng.uniform(-1.5, 1, MANY) * SLICES / T_MAX
    velocity = rng.choice([0.0, 0.1, 1.0], (MANY, 1, 1)) * turn[:, None, None] * rng.normal(size=(MANY, 2, 3))
    velocity[::3, 1] = velocity[::3, 0]
    given = {"twist": np.concatenate([velocity, spins(kind, rng, turn)], axis=2), "path": path}
    pivot = rng.choice([0.0, 1.0, 10.0], (MANY, 1, 1)) * rng.normal(size=(MANY, 2, 3))
    if path == "linear":
        given["pivot"] = pivot
    places = rng.choice([0.3, 3.0], (MANY, 1, 1)) * rng.normal(size=(MANY, 2, 3))
    rotation = unit(rng.normal(size=(MANY, 2, 4)))
    places[::2, 1] = places[::2, 0]  # of pivots: a joint
    poses = np.concatenate([places - turned(rotation, given.get("pivot", 0.0 * pivot)), rotation], axis=2)
    motion, slices = ccd.RigidMotion(poses, **given), rng.integers(0, SLICES, MANY)
    apart, height = np.full(MANY, np.inf), np.full((MANY, 2), np.inf)
    for share in np.linspace(0, 1, 33):
        x = placed(motion, corners, T_MAX * (slices + share) / SLICES)
        apart = np.minimum(apart, np.linalg.norm(x[0][:, :, None] - x[1][:, None], axis=3).min(axis=(1, 2)))
        height = np.minimum(height, np.stack([y @ [1, 2, 2] / 3 for y in x], axis=1).min(axis=2))
    beside, rows = 0.5 * np.column_stack([apart, apart]), np.arange(MANY)
    for mesh, k, lengths in (
        (both, slice(0, 2), beside),
        *((mesh, slice(k, k + 1), np.maximum(height[:, k : k + 1], 0.0)) for k, mesh in enumerate(by_plane)),
    ):
        parts = BodyParts(mesh, mesh.vertices)
        of_bodies = {name: x if name == "path" else x[:, k] for name, x in given.items()}
        for share in (1.0, 0.6):  # of lengths along each axis, as the narrow phase has them: to the corner of a box
            moved = ccd.RigidMotion(poses[:, k], within=share * lengths / np.sqrt(3) + 1e-9, **of_bodies)
            is_near = near(mesh, moved, parts).bodies[slices, rows, 0]
            assert is_near.mean() == 1.0 if share == 1.0 else is_near.mean() < 0.8


def test_bodies_come_near_whose_distance_has_a_square_that_overflows():
    """Each turns on a long arm to where the other comes from the other side."""
    arm = (np.array([[1.1e154, 0, 0]]), np.zeros((0, 3), dtype=int))
    mesh = ccd.CollisionMesh.from_arrays([arm, arm], rigid=[0, 1], codimensional_points=True)
    motion = ccd.RigidMotion(
        [[0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 1, 0]], twist=[[0, 0, 0, 0, 0, x] for x in (2, -2)]
    )
    assert near(mesh, motion, BodyParts(mesh, mesh.vertices), num_slices=1).bodies.all()
