"""Which parts of bodies come near each other in slices of a motion, against their places at many times."""

import numpy as np
import pytest
import trimesh
import warp as wp
from laws.turning import turned, unit

import ccd_warp as ccd
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.motion import Slices
from ccd_warp._rigid.arcs import Arcs
from ccd_warp._rigid.mesh_paths import MeshPaths
from ccd_warp._rigid.parts import near_search, overlap, whole_bodies
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.parts.whole_bodies import NearBodies
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag

WORLDS, SLICES, T_MAX, BODIES = 4, 2, 0.8, 6
MANY = 1500


def near(parts, motion, num_slices=SLICES, reach=0.0, t_max=T_MAX, **how):
    execution = Execution(wp.get_device("cpu"), 2, StopFlag(wp.get_device("cpu")))
    return parts.near(motion._body_paths, Slices(num_slices, t_max), reach, execution, **how)


def near_bodies(mesh, motion, reach, vertices):
    """Which whole bodies are near in each slice of each world, bool, shape [W, S, B]."""
    topology = Topology.of(mesh, wp.get_device("cpu"))
    arcs, bodies, execution = Arcs(topology), NearBodies(topology), Execution(topology.device, 2)
    is_near = np.zeros((WORLDS, SLICES, mesh.num_bodies), dtype=bool)
    slices = Slices(SLICES, T_MAX)
    for world, of_world in enumerate(is_near):
        arcs.begin(MeshPaths.of_checked(mesh, motion._of_worlds(np.array([world]))))
        for part in bodies.slices(arcs.paths, (vertices, vertices), slices, reach, execution):
            of_world[round(part.t_begin * SLICES / T_MAX)] = part.active
    return is_near


def placed(motion, corners, t):
    """Corners of bodies, [n, 3] of each, at a time of each world, [W, n, 3] of each."""
    poses = motion.at(np.broadcast_to(np.reshape(t, (-1, 1)), motion.turns.shape))
    many = [np.broadcast_to(x, (len(poses), *x.shape)) for x in corners]
    return [turned(poses[:, k, None, 3:], x) + poses[:, k, None, :3] for k, x in enumerate(many)]


# --- bodies of many parts ---


def scene(radius=0.0):
    """Bodies of a few parts, boxes and a plate that stand, a half-space, and a motion of several worlds."""
    rng = np.random.default_rng(3)
    body = trimesh.creation.capsule(0.25, 0.05, count=[8, 8])
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
    # worlds in several launches, and more pairs than the capacity at first
    monkeypatch.setattr(overlap, "_MOST_ITEMS", 4 * len(parts.pairs))
    monkeypatch.setattr(near_search, "_CAPACITY", 16)
    monkeypatch.setattr(whole_bodies, "_RUN", 8)
    is_near = np.zeros((WORLDS, SLICES, *2 * [len(parts.body)]), dtype=bool)
    is_near[near(parts, motion, reach=reach)] = True
    # where any pair suffices, the same bodies in the same slices
    every, some = (near(parts, motion, reach=reach, any_suffices=any_suffices) for any_suffices in (False, True))
    of_bodies = [
        {*zip(x.world.tolist(), x.slice.tolist(), parts.body[x.a].tolist(), parts.body[x.b].tolist(), strict=True)}
        for x in (every, some)
    ]
    assert of_bodies[0] == of_bodies[1] and len(some.a) < 0.5 * len(every.a)
    may = np.zeros(is_near.shape[2:], dtype=bool)
    for x, y in parts.pairs:
        may |= (parts.body[:, None] == x) & (parts.body == y) if y >= 0 else np.diag(parts.body == x)
    assert not is_near[..., ~may].any() and is_near.sum() < 0.2 * may.sum() * WORLDS * SLICES
    whole = near_bodies(mesh, motion, reach, mesh.vertices)
    assert not whole[..., :BODIES].all()
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
            meets = may[first, second] & (first != second)
            assert is_near[world, k, first[meets], second[meets]].all() and is_near[world, k, lies, lies].all()
            assert all(whole[world, k, parts.body[x]].all() for x in (first[meets], second[meets], lies))
            num_near += meets.sum() + len(lies)
    assert num_near > 1000


def test_parts_with_coordinates_that_are_no_numbers_are_near_everything():
    mesh, motion = scene()
    vertices = mesh.vertices.copy()
    vertices[5] = np.nan
    parts = BodyParts(mesh, vertices)
    corners = parts.primitives(np.arange(parts.begins[-1]))[0]
    wrong = np.flatnonzero([np.isnan(vertices[x]).any() for x in np.split(corners, parts.begins[1:-1])])
    partners = {y for pair in parts.pairs.tolist() if 0 in pair for y in pair if y > 0}
    _, _, a, b = near(parts, motion)
    assert len(wrong) > 0
    assert near_bodies(mesh, motion, 0.0, vertices)[..., [0, *partners]].all()
    for part in wrong:
        found = {*b[a == part].tolist(), *a[b == part].tolist()}
        assert found - {part} == set(np.flatnonzero(np.isin(parts.body, list(partners))).tolist())


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
    bodies = [*((x, no_faces) for x in corners), ccd.HalfSpace((0, 0, 0), (1, 2, 2))]
    mesh = ccd.CollisionMesh.from_arrays(bodies, rigid=[0, 1], static=[2], codimensional_points=True)
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
    parts, beside = BodyParts(mesh, mesh.vertices), 0.5 * np.column_stack([apart, apart])
    for lengths, pairs in ((beside, [(0, 1)]), (np.maximum(height, 0.0), [(0, 0), (1, 1)])):
        for share in (1.0, 0.6):
            found = near(parts, ccd.RigidMotion(poses, within=share * lengths + 1e-9, **given))
            for a, b in pairs:
                rows = (found.a == a) & (found.b == b)
                is_near = np.zeros((MANY, SLICES), dtype=bool)
                is_near[found.world[rows], found.slice[rows]] = True
                share_near = is_near[np.arange(MANY), slices].mean()
                assert share_near == 1.0 if share == 1.0 else share_near < 0.8


def test_bodies_come_near_whose_distance_has_a_square_that_overflows():
    """Each turns on a long arm to where the other comes from the other side."""
    arm = (np.array([[1.1e154, 0, 0]]), np.zeros((0, 3), dtype=int))
    mesh = ccd.CollisionMesh.from_arrays([arm, arm], rigid=[0, 1], codimensional_points=True)
    motion = ccd.RigidMotion(
        [[0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 1, 0]], twist=[[0, 0, 0, 0, 0, x] for x in (2, -2)]
    )
    assert len(near(BodyParts(mesh, mesh.vertices), motion, num_slices=1).a) == 1
