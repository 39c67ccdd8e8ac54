"""Bodies that move as they are told, and static bodies that must not: what is said of them and who is tested."""

import pickle

import numpy as np
import pytest
import trimesh
from scenes import FACE, TRIANGLE

import ccd_warp as ccd


def wall_sweeps_over_a_ball(**arguments):
    """A wall sweeps two metres over a ball at rest: mesh, start and end positions."""
    ball, wall = trimesh.creation.icosphere(subdivisions=1, radius=0.1), trimesh.creation.box(extents=(0.02, 1, 1))
    wall.apply_translation([-1, 0, 0])
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall], names=["ball", "wall"], **arguments)
    return mesh, mesh.vertices, mesh.vertices + np.array([2.0, 0, 0]) * (mesh.vertex_body == 1)[:, None]


def test_a_static_body_that_moves_is_named_with_its_vertex_and_how_to_tell_that_it_may():
    mesh, start, end = wall_sweeps_over_a_ball(static=["wall"])
    pipeline, nearly = ccd.CollisionPipeline(mesh), start.copy()
    nearly[-1, 1] = np.nextafter(nearly[-1, 1], 1)
    message = (
        r"vertices_t1 moves vertex 0 of body 1 \(wall\), which is static, by 2 \(row 42\); expected its position in "
        r"vertices_t0, or kinematic=\['wall'\] in place of static=\['wall'\]"
    )
    for moved, words in ((end, message), (nearly, r"moves vertex 7 of body 1 \(wall\), which is static, by 1.1")):
        with pytest.raises(ValueError, match=words):
            pipeline.mesh_ccd(start, moved)
    assert pipeline.collision_free_step(start, start) == 1.0  # the same array
    assert pipeline.collision_free_step(start, end[: mesh.body_vertex_range[1]]) == 1.0  # rows of what moves


def test_kinematic_bodies_are_told_like_static_ones_and_meet_what_is_at_rest():
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1], FACE), (TRIANGLE + [0, 0, 2], FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=["body 2"])
    assert mesh.moving_vertices.tolist() == [3, 4, 5, 6, 7, 8]
    for copied in (mesh, pickle.loads(pickle.dumps(mesh)), mesh.excluding({"bodies": [(0, 1)]}), mesh.replicate(1)):
        assert copied.kinematic.tolist() == [False, False, True]
    assert all(f"<td>{word}</td>" in mesh._repr_html_() for word in ("static", "moving", "kinematic"))
    # one alone with a body that ignores itself shares the search radius
    mesh = ccd.CollisionMesh.from_arrays(bodies[:2], kinematic=[1], self_collision=False)
    assert ccd.displacement_bounds(mesh, mesh.vertices, 0.5) == pytest.approx([0.25] * 6)
    frames = wall_sweeps_over_a_ball(kinematic=["wall"])
    assert ccd.collision_free_step(*frames) == ccd.mesh_ccd(*frames).toi == pytest.approx(0.445, abs=1e-12)
    assert not ccd.is_step_collision_free(*frames)
