"""Bodies that move as they are told, and static bodies that must not: who is tested, and what a line search says."""

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from scenes import FACE, TRIANGLE

import ccd_warp as ccd

EVERY_PER = ("scene", "world", "body", "vertex")


def wall_sweeps_over_a_ball(*more, **arguments):
    """A wall sweeps two metres over a ball at rest, beside other bodies: mesh, start and end positions."""
    ball, wall = trimesh.creation.icosphere(subdivisions=1, radius=0.1), trimesh.creation.box(extents=(0.02, 1, 1))
    wall.apply_translation([-1, 0, 0])
    names = ["ball", "wall", "other"][: 2 + len(more)]
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall, *more], names=names, **arguments)
    return mesh, mesh.vertices, mesh.vertices + np.array([2.0, 0, 0]) * (mesh.vertex_body == 1)[:, None]


def test_a_static_body_that_moves_is_refused():
    mesh, start, end = wall_sweeps_over_a_ball(static=["wall"])
    message = (
        r"vertices_t1 moves vertex 0 of body 1 \(wall\), which is static, by 2 \(row 42\); expected its position in "
        r"vertices_t0, or kinematic=\['wall'\] in place of static=\['wall'\]"
    )
    pipeline = ccd.CollisionPipeline(mesh)
    calls = [pipeline.mesh_ccd, pipeline.collision_free_step, pipeline.is_step_collision_free, pipeline.line_search]
    for call in [*calls, pipeline.find_candidates]:
        with pytest.raises(ValueError, match=message):
            call(start, end)
    nearly = start.copy()
    nearly[-1, 1] = np.nextafter(nearly[-1, 1], 1)
    with pytest.raises(ValueError, match=r"vertices_t1 moves vertex 7 of body 1 \(wall\), which is static, by 1.1"):
        pipeline.mesh_ccd(start, nearly)
    assert pipeline.collision_free_step(start, start) == 1.0  # the same array
    assert pipeline.collision_free_step(start, end[: mesh.body_vertex_range[1]]) == 1.0  # rows of what moves


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f])
def test_a_static_body_that_moves_in_a_launch_stops_its_world(dtype):
    one, start, _ = wall_sweeps_over_a_ball(static=["wall"])
    pipeline, count = ccd.CollisionPipeline(one.replicate(3)), int(one.body_vertex_range[1])
    still = np.tile(start, (3, 1, 1))
    moved, signed = still.copy(), np.where(still == 0, -0.0, still)
    moved[1, -1] = np.nextafter(np.float32(moved[1, -1]), np.float32(9))

    def array(x):
        return wp.array(x.reshape(-1, 3).astype(np.float32 if dtype is wp.vec3f else np.float64), dtype=dtype)

    t0, t0_of_balls = array(still), array(still[:, :count])
    for vertices_t0, vertices_t1, is_moved in (
        *((t0, array(moved), True), (t0, array(signed), False), (t0, t0, False)),
        # rows of static bodies that are not given, a launch before has placed
        *((t0_of_balls, array(moved), True), (t0_of_balls, t0_of_balls, False), (t0_of_balls, t0, False)),
    ):
        found, flag = pipeline.launch(vertices_t0, vertices_t1).to_host(), ccd.LaunchFlag.STATIC_MOVED * is_moved
        assert found.flags == flag and found.world_flags.tolist() == [0, flag, 0]
        assert (found.world_toi == 0).tolist() == [False, is_moved, False]
    by_displacement = pipeline.launch(t0, displacements=array(moved - still))
    assert by_displacement.world_toi.numpy().tolist() == [np.inf, 0.0, np.inf]
    # a line search leaves that world where it is, and the others move on
    wished = moved.copy()
    wished[:, :count, 1] += 3.0
    y = array(wished)
    result = pipeline.launch_line_search(t0, y, per="world")
    assert result.world_flags.numpy().tolist() == [0, ccd.LaunchFlag.STATIC_MOVED, 0]
    rise = (y.numpy() - t0.numpy()).reshape(3, -1, 3)[:, :count, 1]
    assert np.allclose(rise, np.array([3.0, 0.0, 3.0])[:, None])


def test_kinematic_bodies_are_told_like_static_ones():
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE), (TRIANGLE + [0, 0, 2], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=["body 2"])
    assert mesh.kinematic.tolist() == [False, False, True] and mesh.moving_vertices.tolist() == [3, 4, 5, 6, 7, 8]
    for copied in (pickle.loads(pickle.dumps(mesh)), mesh.excluding({"bodies": [(0, 1)]}), mesh.replicate(1)):
        assert copied.kinematic.tolist() == [False, False, True]
    table = mesh._repr_html_()
    assert all(f"<td>{word}</td>" in table for word in ("static", "moving", "kinematic"))
    with pytest.raises(ValueError, match="static and kinematic both hold body 0; expected it in one of them"):
        ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=[0])
    with pytest.raises(ValueError, match=r"kinematic holds 'lid'; expected body indices in \[0, 3\) or names"):
        ccd.CollisionMesh.from_arrays(bodies, kinematic=["lid"])
    # one alone with a body that ignores itself shares the search radius
    mesh = ccd.CollisionMesh.from_arrays(bodies[:2], kinematic=[1], self_collision=False)
    assert ccd.displacement_bounds(mesh, mesh.vertices, 0.5) == pytest.approx([0.25] * 6)


def test_a_wall_that_sweeps_meets_a_ball_at_rest():
    mesh, start, end = wall_sweeps_over_a_ball(kinematic=["wall"])
    assert mesh.kinematic.tolist() == [False, True] and not mesh.static.any()
    assert ccd.mesh_ccd(mesh, start, end).toi == pytest.approx(0.445, abs=1e-12)
    assert ccd.collision_free_step(mesh, start, end) == ccd.mesh_ccd(mesh, start, end).toi
    assert not ccd.is_step_collision_free(mesh, start, end)
