"""Pairs within bodies of long thin parts: boxes in the frame of a body lose none, and the search for them is short."""

import copy
from itertools import islice

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes import body_frames as kernels
from laws.outputs import different, outputs_of
from scenes import TURN, sheet, squeezed, tube

import ccd_warp as ccd
from ccd_warp._engine.mesh import slender, topology

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
    """Of integers times a power of two it is exact, and perhaps away by both reaches, half of which is a radius."""
    rng, num = np.random.default_rng(0), 4000
    corners = 4.0 * rng.integers(-(2**30), 2**30, (2, num, 3, 3)) + 4.0 * offset
    # edges, which have nothing but rounding across, other sizes, and sides that are a few numbers long
    corners[:, : num // 4, 2] = corners[:, : num // 4, 0]
    corners[:, num // 4 : num // 2] *= rng.choice([1.0, 0.0, 2.0**10], (2, num // 4, 1, 1))
    corners[:, num // 2 : 3 * num // 4, 1] = corners[:, num // 2 : 3 * num // 4, 0] + 4.0 * rng.integers(-2, 3, 3)
    weights = np.array([[2, 2, 0], [1, 3, 0], [1, 1, 2], [2, 1, 1]])[rng.integers(4, size=num)] / 4.0
    point = (weights[:, :, None] * corners).sum(axis=2) + 2.0 * reach * rng.choice([-1.0, 1.0], (num, 3))
    points = np.ldexp(np.concatenate([corners, point[:, :, None]], axis=2), exponent)
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
    rng, num = np.random.default_rng(1), 4000
    points = rng.integers(-(2**30), 2**30, (2, num, 4, 3)) + 1.0 * offset
    points[1, : num // 2, :2] = points[0, : num // 2, :2] + rng.integers(-(2**20), 2**20, (num // 2, 2, 3))
    apart = rng.integers(-(2**28), 2**28, (num, 3)) // rng.choice([1, 2**20], (num, 1))
    points[:, :, 3] = points[:, :, 2] + 4.0 * np.array([t, t - 1.0])[:, None, None] * apart
    lower, upper = aabbs(np.ldexp(points, exponent), np.tile([0, 1], (num, 1)), t_end, 0.0, np.zeros(0))
    assert are_met(lower[:, 2], upper[:, 2], lower[:, 3], upper[:, 3]).all()


# --- searches ---


def needles_side_by_side():
    """Tubes that are squeezed: far from the origin, thick and turned in worlds, and two with a face between them."""
    vertices, faces = tube()
    yield ccd.CollisionMesh.from_arrays([(vertices + 1e6, faces)]), squeezed(vertices, 1.2) + 1e6, {"t_max": 0.9}
    turn = np.linalg.qr(np.eye(3) + np.array([[0, 0.03, 0], [-0.03, 0, 0.02], [0, -0.02, 0]]))[0]
    end = squeezed(vertices, 0.7) @ (turn * np.sign(np.diag(turn))).T
    thick = ccd.CollisionMesh.from_arrays([(vertices, faces)], radius=1.25e-4)
    yield thick.replicate(2), np.concatenate([end, vertices + [200.0, 50.0, 30.0]]), {}
    other, face = (vertices + [0.0, 0.0, 0.3])[:, [1, 2, 0]], np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0, 1, 0.5]])
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (other, faces), (face, [[0, 1, 2]])])
    end = np.concatenate([squeezed(vertices, 1.2), other - [1.0, 0.0, 0.3], face + [0.3, 0.0, 0.0]])
    yield mesh, end, {"minimum_distance": 1e-6}


@pytest.mark.filterwarnings("ignore:[0-9,]* pairs of:RuntimeWarning")
@pytest.mark.parametrize(("which", "saved"), [(0, 20), (1, 20), (2, 1)])
def test_needles_side_by_side_have_the_same_answers_and_few_candidates(which, saved, monkeypatch):
    mesh, end, options = next(islice(needles_side_by_side(), which, None))
    start = mesh.vertices

    def answers(mesh, **more):
        given = options | {"length_scale": 1.0} | more
        result = ccd.mesh_ccd(mesh, start, end, **given)
        assert len(result.contacts) > 1000
        found = {"contacts": result.contacts, "vertices": result.vertex_toi}
        found["step"] = ccd.collision_free_step(mesh, start, end, **given)
        found["near"] = ccd.find_proximity(mesh, end, 2e-4).distance
        found["bounds"] = ccd.displacement_bounds(mesh, end, 2e-4)
        return outputs_of(found), result.counts.num_candidates[1]

    found = {broad_phase: answers(mesh, broad_phase=broad_phase) for broad_phase in ("tree", "hash")}
    for broad_phase, (result, _) in found.items():
        given = {"max_pairs": 200_000, "max_contacts": 60_000, "broad_phase": broad_phase, "length_scale": 1.0}
        launched = ccd.CollisionPipeline(mesh, **options | given).launch(start, end)
        assert launched.flags.numpy()[0] == 0 and np.array_equal(launched.vertex_toi.numpy(), result[".vertices"])
    monkeypatch.setattr(topology, "slender_bodies", lambda mesh: None)
    expected, before = answers(copy.copy(mesh))
    assert all(different(result, expected) == [] and after < before / saved for result, after in found.values())


def test_which_bodies_are_slender_depends_on_their_form_alone():
    """Not on how they lie, how large they are, or on what is beside them."""
    ball = np.random.default_rng(0).standard_normal((2000, 3)), np.arange(1998).reshape(-1, 3)
    (vertices, faces), flat = tube(), sheet(40)
    for turn in (np.eye(3), TURN, TURN.T):
        for size in (1e-200, 1.0, 1e150):
            bodies = [flat, (size * vertices @ turn, faces), ball, tube(200)]
            mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0])
            assert slender.slender_bodies(mesh).bodies.tolist() == [1]
    alone = ccd.CollisionMesh.from_arrays([tube(), tube()], static=[0], self_collision=[True, False])
    assert slender.slender_bodies(alone) is None
