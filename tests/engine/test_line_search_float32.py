"""Line searches whose gaps are lost beside the length of the step: they move on, and say what stopped the others."""

import numpy as np
import pytest
import trimesh
import warp as wp
from oracles import num_touching
from scenes import FACE, TRIANGLE, with_static_at_rest

import ccd_warp as ccd
from ccd_warp._pairs import pair_vertices

every_per = pytest.mark.parametrize("per", ["scene", "world", "body", "vertex"])
LENGTH = 0.1  # of the wished steps


def _cloth_on_a_ball(gap: float, seed: int = 0) -> tuple[ccd.CollisionMesh, np.ndarray, np.ndarray]:
    """A cap of the ball as a cloth, one to two gaps outside it, that wishes to go into it and a little aside."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    of_cap = faces[(vertices[faces][:, :, 2] > 0.75).all(axis=1)]
    used, cloth_faces = np.unique(of_cap, return_inverse=True)
    gaps = gap * np.random.default_rng(seed).uniform(1, 2, (len(used), 1))
    cloth = vertices[used] * (1 + gaps)
    mesh = ccd.CollisionMesh.from_arrays([(cloth, cloth_faces.reshape(-1, 3)), (vertices, faces)], static=[1])
    end = mesh.vertices.copy()
    end[: len(cloth)] += LENGTH * np.array([0.3, 0.06, -1.0])
    return mesh, mesh.vertices, end


@every_per
@pytest.mark.parametrize("gap", [1e-6, 1e-7, 1e-8])
def test_cloth_that_is_close_to_a_ball_moves_on_in_float32(per, gap):
    mesh, start, end = _cloth_on_a_ball(gap)
    exact = ccd.mesh_ccd(mesh, start, end).toi
    assert exact > 0 and ccd.mesh_ccd(mesh, start, end, precision="float32").toi == 0
    step = ccd.line_search(mesh, start, end, per=per, precision="float32")
    assert step.fraction > (0.1 * exact if per != "vertex" else 0.0)
    assert step.vertex_fraction[mesh.moving_vertices].mean() > 0.1 * exact
    assert len(step.touching) == 0 and not step.is_limited and step.num_rounds <= 6
    assert num_touching(mesh, start, step.vertices) == 0


@every_per
def test_cloth_that_is_close_to_a_ball_moves_on_in_float64(per):
    mesh, start, end = _cloth_on_a_ball(1e-10)
    end[mesh.moving_vertices] += 1e6 * (end - start)[mesh.moving_vertices]
    assert ccd.mesh_ccd(mesh, start, end).toi == 0
    step = ccd.line_search(mesh, start, end, per=per)
    assert step.fraction > 0 and len(step.touching) == 0
    assert num_touching(mesh, start, step.vertices) == 0


@every_per
@pytest.mark.parametrize("gap", [1e-6, 1e-7])
def test_cloth_that_is_close_to_a_ball_moves_on_on_the_device(per, gap, device):
    mesh, start, wished = _cloth_on_a_ball(gap)
    exact = ccd.mesh_ccd(mesh, start, wished).toi
    pipeline = ccd.CollisionPipeline(mesh, precision="float32", length_scale=2.0, max_pairs=100_000, device=device)
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device=device) for x in (start, wished))
    result = pipeline.launch_line_search(vertices_t0, vertices_t1, per=per)
    end = vertices_t1.numpy()
    moved = np.linalg.norm(end - start, axis=1)[mesh.moving_vertices]
    assert moved.min() > 0 and moved.mean() > 0.05 * exact * LENGTH
    assert np.isinf(result.toi.numpy()[0]) and result.flags.numpy()[0] == 0
    assert num_touching(mesh, start, end) == 0


def test_a_toi_above_0_costs_no_round_more():
    mesh, start, end = _cloth_on_a_ball(1e-3)
    for per in ("scene", "vertex"):
        step = ccd.line_search(mesh, start, end, per=per, precision="float32")
        assert step.num_rounds == 2 and 0 < step.fraction < 1


def test_what_touches_stops_its_vertices_alone_and_is_named_once_in_order():
    """A tip exactly on an oblique face, pushed into it, beside a cloth whose gaps float32 loses."""
    mesh, start, end = _cloth_on_a_ball(1e-7)
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    tip = np.array([[0, 0, 0], [0.5, 0.2, 1], [-0.5, 0.2, 1]])
    bodies = [(body @ turn.T + 5, FACE) for body in (TRIANGLE, tip, tip)]  # at the origin the three meet exactly
    ball = mesh.num_vertices
    parts = [(start[mesh.vertex_body == k], mesh.faces[mesh.vertex_body[mesh.faces[:, 0]] == k]) for k in (0, 1)]
    parts[1] = (parts[1][0], parts[1][1] - len(parts[0][0]))
    both = ccd.CollisionMesh.from_arrays([*parts, *bodies], static=[1, 2])
    wished = both.vertices.copy()
    wished[:ball] = end
    wished[ball + 3 :] -= turn @ [0, 0, 0.5]
    step = ccd.line_search(both, both.vertices, wished, per="vertex", precision="float32")
    stopped = np.flatnonzero(step.vertex_fraction == 0)
    corners = pair_vertices(both, step.touching)
    assert set(stopped) >= {ball + 3, ball + 6} and stopped.min() >= ball
    assert np.isin(stopped, corners).all() and corners.min() >= ball
    assert (both.vertices[corners] == step.vertices[corners]).all()
    keys = np.column_stack([step.touching.kind, step.touching.primitives])
    np.testing.assert_array_equal(keys, np.unique(keys, axis=0))
    assert (step.touching.toi == 0).all()


@every_per
def test_a_search_without_rounds_to_shorten_says_what_stopped_it(per):
    mesh, start, end = _cloth_on_a_ball(1e-8)
    step = ccd.line_search(mesh, start, end, per=per, precision="float32", max_rounds=3)
    assert step.fraction == 0
    stopped = np.flatnonzero(step.vertex_fraction == 0)
    corners = pair_vertices(mesh, step.touching)
    assert len(corners) > 0 and np.isin(corners, stopped).any(axis=1).all()
    assert (start[corners] == step.vertices[corners]).all()


def test_a_step_that_is_lost_in_the_rounding_of_positions_says_what_stopped_it():
    """One rounding above a face, far from the origin: nine tenths of the gap are the gap again, or none of it."""
    at = 2.0**20
    above = np.nextafter(at, np.inf) - at
    mesh = ccd.CollisionMesh.from_arrays(
        [(TRIANGLE * 0.5 + [0, 0, at + above], FACE), (TRIANGLE + [0, 0, at], FACE)], static=[1]
    )
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices - [0, 0, 1.0])
    step = ccd.line_search(mesh, mesh.vertices, end, per="vertex")
    np.testing.assert_array_equal(step.vertices[:3], mesh.vertices[:3])
    assert set(range(3)) <= set(pair_vertices(mesh, step.touching).ravel())


@pytest.mark.parametrize("static", [[], [1]])
def test_the_positions_returned_are_never_the_callers_array(static):
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=static)
    for start, end in (
        (mesh.vertices.copy(), mesh.vertices + [0.0, 0, 0]),
        (mesh.vertices.copy(), mesh.vertices + np.array([[0.1, 0, 0]] * 3 + [[0, 0, 0]] * 3)),
    ):
        step = ccd.line_search(mesh, start, end)
        np.testing.assert_array_equal(step.vertices, end)
        arrays = [step.vertices, step.vertex_fraction, *vars(step.touching).values()]
        assert not any(np.shares_memory(array, given) for array in arrays for given in (start, end, mesh.vertices))
        step.vertices[:] = np.nan
        assert np.isfinite(start).all() and np.isfinite(end).all()


def test_a_search_that_takes_too_long_leaves_bodies_of_free_worlds_where_they_were_found_free():
    """A is stopped in world 0, so in world 1 E runs into it, which holds A back in world 0, where B runs into it; B has
    a part in world 2, where D follows it: held back there in the last round, it would be in the way of D."""
    layers = [  # body, world, height at the start, at the end
        ("wall", 0, 0.0, 0.0),
        ("A", 0, 1.0, -1.0),
        ("A", 1, 1.0, -1.0),
        ("B", 0, 1.1, 0.05),
        ("B", 2, 1.0, -1.0),
        ("E", 1, 1.5, -0.8),
        ("D", 2, 1.5, -0.8),
    ]
    bodies: dict[str, list[np.ndarray]] = {}
    for k, (body, _, height, _) in enumerate(layers):
        bodies.setdefault(body, []).append(TRIANGLE + [0.05 * k, 0.04 * k, height])
    mesh = ccd.CollisionMesh.from_arrays(
        [(np.vstack(parts), np.arange(3 * len(parts)).reshape(-1, 3)) for parts in bodies.values()],
        vertex_world=np.repeat([world for _, world, _, _ in layers], 3),
    )
    end = mesh.vertices.copy()
    end[:, 2] = np.repeat([height for *_, height in layers], 3)
    step = ccd.line_search(mesh, mesh.vertices, end, per="body", max_rounds=3, length_scale=1.0)
    assert step.is_limited
    assert num_touching(mesh, mesh.vertices, step.vertices, length_scale=1.0) == 0
    assert (step.vertices != mesh.vertices).any()
