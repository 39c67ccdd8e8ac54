"""What touches or passes through another at one time: hostile numbers, single pairs, points, and what is said of it."""

import copy
from fractions import Fraction

import numpy as np
import pytest
import trimesh
from laws.truth import Pairs, intersections
from scenes import FACE, NO_FACES, single

import ccd_warp as ccd

KIND = ccd.IntersectionKind
TRIANGLE = [[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]
THROUGH = [[1, 1, -1], [1, 1, 1], [9, 9, 0.5]]


def found_in(mesh, x=None):
    """The pairs as (kind, first, second), which are those of exact linear programs."""
    x = mesh.vertices if x is None else x
    found = ccd.find_intersections(mesh, x)
    rows = [(k, *pair) for k, pair in zip(found.kind.tolist(), found.primitives.tolist(), strict=True)]
    assert rows == intersections(Pairs(mesh), x)
    return found


def two_triangles(second, **options):
    return ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (second, FACE)], **options)


def test_two_edges_pass_through_a_face_by_the_last_bit_of_the_last_bits():
    """Volumes of one unit, which a shear of determinant 1 leaves as they are."""
    small, shear = np.array([[0, 1, 0], [1, 2, 2], [1, 0, 1], [0, 1, 1], [1, 1, 1], [0, 9, 0]]), np.tri(3)
    shear = shear + 9998 * np.tri(3, k=-1)
    found = found_in(single(1.0 + 2.0**-52 * small @ (shear @ shear.T), [[0, 1, 2], [3, 4, 5]]))
    assert found.kind.tolist() == [int(KIND.EDGE_FACE)] * 2


def exact_parameters(x):
    """(u, v) of an edge through a face, and the place on the edge, rational, of vertices e0, e1, f0, f1, f2."""
    e0, e1, a, b, c = np.vectorize(Fraction, otypes=[object])(x)
    n = np.cross(b - a, c - a)
    s = (a - e0) @ n / ((e1 - e0) @ n)
    p = e0 + s * (e1 - e0) - a
    return [float(np.cross(p, c - a) @ n / (n @ n)), float(np.cross(b - a, p) @ n / (n @ n)), float(s)]


def test_points_are_those_of_rational_arithmetic():
    """Two balls through each other; and an edge that passes a face at a grazing angle, 1e-13 of it to either side."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball])
    sliver = np.array([*TRIANGLE, [-4, 1, -1e-13], [6.0, 1, 1e-13], [0, 9, 9]]) @ [[1, 2, 3], [2, -1, 1], [1, 1, -2]]
    grazing = ccd.CollisionMesh.from_arrays([(sliver[:3], FACE), (sliver[3:], FACE)])
    moved = np.vstack([ball.vertices, 0.8 * ball.vertices + [0.7, 0.3, 0.1]])
    for which, x, tolerance in ((mesh, moved, 1e-7), (grazing, sliver, 0)):
        found = ccd.find_intersections(which, x)
        found = found[found.is_crossing]
        exact = np.array([exact_parameters(x[row]) for row in found.vertices])
        np.testing.assert_allclose(np.c_[found.parameters, found.edge_parameter], exact, rtol=0, atol=tolerance)
        e0, e1 = x[found.vertices[:, 0]], x[found.vertices[:, 1]]
        s = found.edge_parameter[:, None]
        np.testing.assert_allclose(found.points, (1 - s) * e0 + s * e1, rtol=0, atol=4e-15 * np.abs(x).max())
        assert np.array_equal(found.bodies, which.vertex_body[found.vertices[:, [0, 2]]]) and len(found)


def test_points_of_edges_cables_and_particles():
    x = [[1.0, 1, -1], [1, 1, 1], [0, 2, 0.5], [2, 0, 0.5], [1, 1, 0.25], [1, 1, 0], [2, 1, 0], [2, 1, 0]]
    bodies = [(TRIANGLE, FACE), (x, NO_FACES, [[0, 1], [2, 3]])]
    found = found_in(ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True))
    points = {KIND.EDGE_FACE: [1, 1, 0], KIND.EDGE_EDGE: [1, 1, 0.5], KIND.POINT_POINT: [2, 1, 0]}
    assert all(found.points[found.kind == int(kind)].tolist() == [point] for kind, point in points.items())
    x = np.array([[0.0, 0, 0], [4, 0, 0], [1, 0, 0], [7, 0, 0]])  # edges that overlap have their middle
    found = found_in(ccd.CollisionMesh.from_arrays([(x, NO_FACES, [[0, 1], [2, 3]])]))
    assert found.points.tolist() == [[2.5, 0, 0]] and found.parameters.tolist() == [[0.625, 0.25]]
    x = np.array([[0.0, 0], [4, 0], [1, -1], [1, 1], [2, 0], [2, 3], [5, 0], [6, 0], [3.5, 0], [5.5, 0]])
    found = found_in(ccd.CollisionMesh.from_arrays([(x, np.arange(10).reshape(-1, 2))]))
    assert found.points.shape == (6, 2) and found.points[found.is_crossing].tolist() == [[1, 0]]


def test_static_bodies_may_move_between_calls_and_worlds_have_their_own_names():
    pipeline = ccd.CollisionPipeline(mesh := two_triangles([[1, 1, -1], [1, 1, 1], [2, 2, 1]], static=[0]))
    for _ in range(2):
        assert len(pipeline.find_intersections(mesh.vertices)) == 2
        assert len(pipeline.find_intersections(mesh.vertices + [0, 0, 5] * (mesh.vertex_body == 0)[:, None])) == 0
    copies = two_triangles(THROUGH).replicate(3)
    found = ccd.find_intersections(copies, copies.vertices + [0, 0, 50] * (copies.vertex_body == 3)[:, None])
    assert found.by_bodies() == {("body 0[0]", "body 1[0]"): 2, ("body 0[2]", "body 1[2]"): 2}


def test_what_intersections_say():
    found = ccd.find_intersections(
        mesh := two_triangles([[1, 1, -1], [1, 1, 1], [4, 0, 0]], names=["sheet", "blade"]), mesh.vertices
    )
    sentence = "1 pair passes through each other: 1 of sheet and blade; 6 pairs touch: 6 of sheet and blade"
    assert found.describe() == sentence and repr(found) == f"Intersections({sentence})"
    assert "edge-face" in found._repr_html_() and "sheet" in found._repr_html_()
    assert len(found[found.is_crossing]) == 1 and len(found[:0]) == len(found[[]]) == 0
    empty = ccd.find_intersections(single(TRIANGLE, FACE), TRIANGLE)
    assert empty.points.shape == (0, 3) and repr(empty) == "Intersections(nothing touches or passes through another)"
    touching = two_triangles([[1, 1, 0], [1, 1, 1], [2, 2, 1]], names=["sheet", "blade"])
    result = ccd.mesh_ccd(touching, touching.vertices, touching.vertices)
    assert result.pairs_at_start == {("sheet", "blade"): 1} and result.counts.num_contacts_at_start == 1
    assert "1 pair is in contact at the start already, with toi 0: 1 of sheet and blade" in repr(result)


def test_every_call_of_a_step_says_where_surfaces_cross_at_its_start_if_it_is_asked_to(recwarn):
    mesh = two_triangles(THROUGH, names=["sheet", "blade"])
    frames = mesh.vertices, mesh.vertices + [0, 0, 0.1] * (mesh.vertex_body == 1)[:, None]
    sentence = "at the start 2 pairs pass through each other: 2 of sheet and blade"
    calls = {"mesh_ccd": np.inf, "collision_free_step": 1.0, "is_step_collision_free": False, "line_search": 1.0}
    for name, expected in calls.items():
        for asked in (getattr(ccd, name), lambda m, *x, n=name, **o: getattr(ccd.CollisionPipeline(m), n)(*x, **o)):
            asked(copy.copy(mesh), *frames)
            assert not recwarn.list
            with pytest.warns(RuntimeWarning, match=f"^{sentence}; what crosses already is not seen in") as warned:
                result = asked(copy.copy(mesh), *frames, check_start=True)
            assert warned[0].filename == __file__
            if isinstance(result, (ccd.MeshResult, ccd.LineSearchResult)):
                assert result.start.num_crossing == 2 and sentence in repr(result)
                result = result.toi if isinstance(result, ccd.MeshResult) else result.fraction
            assert result == expected
