"""Pairs within bodies of long thin parts: boxes in the frame of a body lose none, and the search for them is short."""

import copy

import numpy as np
import pytest
import scenes
import warp as wp
from ccd_warp.kernels.boxes import body_frames as kernels
from laws.outputs import different, outputs_of
from scenes import TURN, squeezed, tube

import ccd_warp as ccd
from ccd_warp._engine.mesh import slender, topology

BOTH = ("tree", "hash")


# --- boxes ---


def aabbs(points, edge, t_end, inflation, radius):
    """Both endpoint AABBs of each vertex, lower and upper corner, by the kernel; a row of points is a body."""
    num, each = points[0].shape[:2]
    body = np.repeat(np.arange(num, dtype=np.int32), each)
    frames = kernels.BodyFrames()
    array = lambda values, dtype=wp.int32: wp.array(values, dtype=dtype, device="cpu")  # noqa: E731
    frames.of_vertex, frames.edge = array(body), array(edge + each * np.arange(num)[:, None], wp.vec2i)
    frames.cell, frames.inner = array(np.zeros((num, 4)), wp.vec4f), 0.25
    with np.errstate(over="ignore"):
        size = np.minimum(np.abs(points).max(axis=(0, 2, 3)), 2.0**1000)
    frames.scale = array(np.ldexp(0.125, -np.frexp(np.maximum(size, 2.0**-1000))[1]), wp.float64)
    found = wp.zeros(num * each * 16, dtype=wp.float32, device="cpu")
    start, end = (array(x.reshape(-1, 3), wp.vec3d) for x in points)
    inputs = [0, array(np.arange(num * each)), array(body), array(np.ones(num)), frames, start, end]
    inputs += [t_end, inflation, array(radius, wp.float64)]
    wp.launch(kernels.fill_frame_aabbs, num * each, inputs=inputs, outputs=[found], device="cpu")
    found = found.numpy().reshape(num, each, 2, 2, 4)[..., :3]
    return found[..., 0, :], -found[..., 1, :]


def are_met(lower, upper, other_lower, other_upper):
    """Whether no axis separates two boxes in the same order in both AABBs, shape [n, 2, 3]."""
    return ~((upper < other_lower).all(axis=1) | (other_upper < lower).all(axis=1)).any(axis=1)


@pytest.mark.parametrize(("exponent", "offset"), [(0, 0), (0, 2**40), (-1074, 0), (-1060, 0), (-1000, 0), (981, 0)])
@pytest.mark.parametrize("t_end", [1.0, 0.5, 0.3])
@pytest.mark.parametrize("reach", [0, 3])
def test_a_point_of_a_face_that_moves_with_it_meets_its_box(exponent, offset, t_end, reach):
    """Coordinates are integers times a power of two, so the point is one in exact numbers, at every time.

    Its coordinates across an edge on which it lies are nothing but rounding. It may be farther away by the reaches of
    both, half of which is a radius, along each axis.
    """
    rng = np.random.default_rng(0)
    num = 4000
    corners = 4.0 * rng.integers(-(2**30), 2**30, (2, num, 3, 3)) + 4.0 * offset
    corners[:, : num // 4, 2] = corners[:, : num // 4, 0]  # an edge
    corners[:, num // 4 : num // 2] *= rng.choice([1.0, 0.0, 2.0**10], (2, num // 4, 1, 1))
    corners[:, num // 2 : 3 * num // 4, 1] = corners[:, num // 2 : 3 * num // 4, 0] + 4.0 * rng.integers(-2, 3, 3)
    weights = np.array([[2, 2, 0], [1, 3, 0], [1, 1, 2], [2, 1, 1]])[rng.integers(4, size=num)] / 4.0
    point = (weights[:, :, None] * corners).sum(axis=2)
    points = np.concatenate([corners, point[:, :, None]], axis=2)
    points[:, :, 3] += 2.0 * reach * rng.choice([-1.0, 1.0], (num, 3))
    points = np.ldexp(points, exponent)
    inflation = float(np.ldexp(1.0 * (reach > 0), exponent))
    radius = np.full(4 * num, float(np.ldexp(reach - 1.0, exponent))) if reach else np.zeros(0)
    lower, upper = aabbs(points, rng.permuted(np.tile([0, 1, 2], (num, 1)), axis=1)[:, :2], t_end, inflation, radius)
    assert are_met(lower[:, :3].min(axis=1), upper[:, :3].max(axis=1), lower[:, 3], upper[:, 3]).all()
    if exponent == offset == reach == 0:  # and it is no box of everything
        assert ((upper - lower)[:, :, 0].max(axis=(1, 2)) <= 1e-6).mean() > 0.7


@pytest.mark.parametrize(("exponent", "offset"), [(0, 0), (0, 2**40), (-1074, 0), (-1000, 0), (985, 0)])
@pytest.mark.parametrize(("t", "t_end"), [(0.25, 0.3), (0.25, 1.0), (0.5, 0.5), (0.5, 1.0), (0.75, 0.8), (1.0, 1.0)])
def test_points_that_meet_between_the_ends_of_a_turn_have_boxes_that_meet(t, t_end, exponent, offset):
    """They may be apart at both ends along an axis that turns, or that stays, in the same order."""
    rng = np.random.default_rng(1)
    num = 4000
    points = rng.integers(-(2**30), 2**30, (2, num, 4, 3)) + 1.0 * offset
    points[1, : num // 2, :2] = points[0, : num // 2, :2] + rng.integers(-(2**20), 2**20, (num // 2, 2, 3))
    apart = rng.integers(-(2**28), 2**28, (num, 3)) // rng.choice([1, 2**20], (num, 1))
    points[0, :, 3] = points[0, :, 2] + 4.0 * t * apart
    points[1, :, 3] = points[1, :, 2] - 4.0 * (1.0 - t) * apart
    edge = np.tile([0, 1], (num, 1))
    lower, upper = aabbs(np.ldexp(points, exponent), edge, t_end, 0.0, np.zeros(0))
    assert are_met(lower[:, 2], upper[:, 2], lower[:, 3], upper[:, 3]).all()


# --- searches ---


def squeezed_far_from_the_origin():
    vertices, faces = tube()
    return ccd.CollisionMesh.from_arrays([(vertices + 1e6, faces)]), squeezed(vertices, 1.2) + 1e6, {"t_max": 0.9}


def thick_and_turned_a_little_in_worlds():
    vertices, faces = tube()
    turn = np.linalg.qr(np.eye(3) + np.array([[0, 0.03, 0], [-0.03, 0, 0.02], [0, -0.02, 0]]))[0]
    end = squeezed(vertices, 0.7) @ (turn * np.sign(np.diag(turn))).T
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)], radius=1e-4)
    return mesh.replicate(2), np.concatenate([end, vertices + [200.0, 50.0, 30.0]]), {}


def two_tubes_and_a_face_between_them():
    other = tube(shift=[0.0, 0.0, 0.3])[0][:, [1, 2, 0]]
    face = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]])
    mesh = ccd.CollisionMesh.from_arrays([tube(), (other, tube()[1]), (face, [[0, 1, 2]])])
    end = np.concatenate([squeezed(tube()[0], 1.2), other - [1.0, 0.0, 0.3], face + [0.3, 0.0, 0.0]])
    return mesh, end, {"minimum_distance": 1e-6}


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
@pytest.mark.parametrize(
    "make", [squeezed_far_from_the_origin, thick_and_turned_a_little_in_worlds, two_tubes_and_a_face_between_them]
)
def test_needles_side_by_side_have_the_same_answers_and_few_candidates(make, broad_phase, monkeypatch):
    mesh, end, options = make()
    start, options = mesh.vertices, options | {"broad_phase": broad_phase, "length_scale": 1.0}

    def answers(mesh):
        result = ccd.mesh_ccd(mesh, start, end, **options)
        found = outputs_of(result.contacts, "contacts") | outputs_of(result.vertex_toi, "vertices")
        found |= outputs_of(ccd.collision_free_step(mesh, start, end, **options), "step")
        near = [ccd.find_proximity(mesh, end, 2e-4).distance, ccd.displacement_bounds(mesh, end, 2e-4)]
        assert len(result.contacts) > 1000
        return found | dict(zip(("near", "bounds"), near, strict=True)), result.counts.num_candidates[1]

    found, after = answers(mesh)
    launched = ccd.CollisionPipeline(mesh, max_pairs=200_000, max_contacts=60_000, **options).launch(start, end)
    assert launched.flags.numpy()[0] == 0 and np.array_equal(launched.vertex_toi.numpy(), found["vertices"])
    monkeypatch.setattr(topology, "slender_bodies", lambda mesh: None)
    expected, before = answers(copy.copy(mesh))
    assert different(found, expected) == []
    assert after < before / 20 or (make is two_tubes_and_a_face_between_them and after < before)


def test_which_bodies_are_slender_depends_on_their_form_alone():
    """Not on how they lie, how large they are, or on what is beside them."""
    ball = np.random.default_rng(0).standard_normal((2000, 3)), np.arange(1998).reshape(-1, 3)
    sheet = scenes.sheet(40)
    vertices, faces = tube()
    for turn in (np.eye(3), TURN, TURN.T):
        for size in (1e-200, 1.0, 1e150):
            bodies = [sheet, (size * vertices @ turn, faces), ball, tube(200)]
            mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0])
            assert slender.slender_bodies(mesh).bodies.tolist() == [1]
    alone = ccd.CollisionMesh.from_arrays([tube(), tube()], static=[0], self_collision=[True, False])
    assert slender.slender_bodies(alone) is None
