"""What docs/coming_from_ipc_toolkit.md says of ipc-toolkit and of this package is what both do."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd

ipctk = pytest.importorskip("ipctk", reason="the extra bench is not installed")
ipctk.set_logger_level(ipctk.off)  # which else tells of a start in contact
FACE = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]])
FACES = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
TIGHT, ADDITIVE = ipctk.TightInclusionCCD, ipctk.AdditiveCCD
KEEP = {"minimum_separation": 1e-4, "length_scale": 1.0}


def _both(x, faces, edges=(), **of_ours):
    """The mesh of both libraries."""
    faces, edges = (np.array(rows, dtype=np.int32).reshape(-1, width) for rows, width in ((faces, 3), (edges, 2)))
    theirs = ipctk.CollisionMesh(x, ipctk.edges(faces) if len(faces) else edges, faces)
    return theirs, ccd.CollisionMesh.from_arrays([(x, faces, edges)], **of_ours)


def _falling(height, end):
    start = np.vstack([FACE, FACE * 0.1 + [0, 0, height]])
    return start, np.where(np.arange(6)[:, None] < 3, start, start * [1, 1, 0] + [0, 0, end])


@pytest.mark.parametrize(
    ("gap", "narrow", "of_theirs", "of_ours", "theirs_keeps", "ours_keeps"),
    [
        *((gap, TIGHT(), {}, KEEP | {"start_gap_fraction": 0.2}, *[min(1e-4, 0.2 * gap)] * 2) for gap in (1.0, 1e-4)),
        (1e-2, TIGHT(conservative_rescaling=0.5), {}, KEEP | {"start_gap_fraction": 0.5}, 1e-4, 1e-4),
        (1e-5, TIGHT(conservative_rescaling=0.5), {}, KEEP | {"start_gap_fraction": 0.5}, 5e-6, 5e-6),
        (1.0, ADDITIVE(), {}, {}, 0.1, 0.0),
        (1.0, TIGHT(tolerance=1e-3), {"min_distance": 0.1}, KEEP | {"minimum_separation": 0.1}, 0.1, 0.1),
        (1.0, ADDITIVE(), {"min_distance": 0.1}, {"minimum_distance": 0.1}, 0.1 + 0.1 * 0.9, 0.1),
    ],
)
def test_a_step_keeps_of_the_gap_what_the_page_says(gap, narrow, of_theirs, of_ours, theirs_keeps, ours_keeps):
    start, end = _falling(gap, -1.0)
    theirs, ours = _both(start, FACES)
    step = ipctk.compute_collision_free_stepsize(theirs, start, end, narrow_phase_ccd=narrow, **of_theirs)
    tolerance = getattr(narrow, "tolerance", 1e-6)  # it bisects to that of the motion, and stops that much earlier
    assert gap - step * (1 + gap) == pytest.approx(theirs_keeps, abs=max(1e-6, tolerance) * (1 + gap))
    kept = gap - ccd.collision_free_step(ours, start, end, **of_ours) * (1 + gap)
    assert kept == pytest.approx(ours_keeps, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(("height", "end", "is_free"), [(1.0, 1e-9, True), (1.0, -1.0, False), (0.0, -1.0, False)])
def test_a_free_step_is_true_in_both_and_a_start_in_contact_gives_none(height, end, is_free):
    start, stop = _falling(height, end)
    theirs, ours = _both(start, FACES)
    assert ipctk.is_step_collision_free(theirs, start, stop) is is_free
    assert ccd.is_step_collision_free(ours, start, stop, tolerance=1e-12) is is_free
    steps = [ipctk.compute_collision_free_stepsize(theirs, start, stop), ccd.collision_free_step(ours, start, stop)]
    assert (steps == [0.0, 0.0]) == (height == 0.0)


@pytest.mark.parametrize("obstacle", [(FACE, FACES[:1]), (FACE[:2], [], [[0, 1]]), (FACE[:1], [])])
def test_a_point_meets_a_face_a_cable_or_a_point_here_where_it_is_asked_for(obstacle):
    at = obstacle[0].mean(axis=0)
    start = np.vstack([obstacle[0], at + [0, 0, 1]])
    end = np.vstack([obstacle[0], at - [0, 0, 1]])
    for asked, step in ((False, 1.0), (True, 0.5)):
        theirs, ours = _both(start, *obstacle[1:], codimensional_points=asked)
        assert ipctk.compute_collision_free_stepsize(theirs, start, end) == pytest.approx(0.5, abs=1e-3)
        assert ccd.collision_free_step(ours, start, end) == pytest.approx(step, abs=1e-3)


def test_obstacles_are_left_out_edges_have_the_same_numbers_and_candidates_are_the_same_pairs():
    start, end = _falling(1.0, -1.0)
    theirs, ours = _both(start, FACES, kinematic=[0])
    theirs.can_collide = ipctk.make_static_obstacle_filter(0)
    assert ipctk.compute_collision_free_stepsize(theirs, start, end) == ccd.collision_free_step(ours, start, end) == 1.0
    box = trimesh.creation.box().subdivide()  # its pairs that share a vertex are left out by both
    x = np.ascontiguousarray(box.vertices)
    theirs, ours = _both(x, box.faces)
    assert np.array_equal(ipctk.edges(box.faces.astype(np.int32)), ours.edges)
    found = ipctk.Candidates()
    found.build(theirs, x, 1.01 * x, 0.0)
    pairs = ccd.find_candidates(ours, x, 1.01 * x).vertex_face
    assert {(pair.vertex_id, pair.face_id) for pair in found.fv_candidates} == set(map(tuple, pairs)) and len(pairs)


def test_both_say_where_surfaces_intersect():
    for small, is_touching, is_crossing in (
        ([[0, 0, -1], [0, 0, 1], [3, 3, 1]], True, True),
        ([[0, 0, 0], [0, 0, 1], [3, 3, 1]], True, False),
        ([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], True, False),
        ([[0, 0, 1], [0, 0, 2], [3, 3, 1]], False, False),
    ):
        x = np.vstack([FACE, small])
        theirs, ours = _both(x, FACES)
        found = ccd.find_intersections(ours, x)
        assert ipctk.has_intersections(theirs, x) == (len(found) > 0) == is_touching
        assert found.is_crossing.any() == is_crossing


def test_the_collision_set_holds_each_proximity_once_as_unique_does_and_bounds_are_half_the_safe_distances():
    rng = np.random.default_rng(0)
    x = (rng.random((60, 1, 3)) + 0.1 * rng.normal(size=(60, 3, 3))).reshape(-1, 3)
    theirs, ours = _both(x, np.arange(180).reshape(-1, 3))
    collisions, candidates = ipctk.NormalCollisions(), ipctk.Candidates()
    collisions.build(theirs, x, 0.05)
    candidates.build(theirs, x, 0.025)
    near = ccd.find_proximity(ours, x, 0.05)
    assert len(near.unique()) == len(collisions) > 50
    assert near.distance.min() == pytest.approx(collisions.compute_minimum_distance(theirs, x) ** 0.5, rel=1e-9)
    safe = candidates.compute_per_vertex_safe_distances(theirs, x, 0.05, 0.0)
    assert ccd.displacement_bounds(ours, x, 0.05) == pytest.approx(0.5 * safe, abs=1e-15)


def test_pairs_have_the_parameters_norms_and_defaults_of_the_page():
    point = FACE[0] + 0.2 * (FACE[1] - FACE[0]) + 0.3 * (FACE[2] - FACE[0])
    start, end = (np.vstack([point + [0, 0, z], FACE]) for z in (1, -1))
    assert ipctk.point_triangle_closest_point(point, *FACE) == pytest.approx([0.2, 0.3])
    assert ccd.vertex_face_ccd(start[None], end[None]).parameters[0] == pytest.approx([0.2, 0.3])
    assert ipctk.point_triangle_distance(*start) == pytest.approx(1.0)  # squared
    assert not TIGHT().point_triangle_ccd(*start, *start)[0]
    assert ccd.vertex_face_ccd(start[None], start[None]).toi[0] == np.inf
    edges = np.array([[-1.0, 0, 0], [3, 0, 0], [0, -1, 1], [0, 4, 1]])
    below = edges - [[0, 0, 0], [0, 0, 0], [0, 0, 2], [0, 0, 2]]
    assert ipctk.edge_edge_closest_point(*edges) == pytest.approx([0.25, 0.2])
    assert ccd.edge_edge_ccd(edges[None], below[None]).parameters[0] == pytest.approx([0.25, 0.2])
    plane = np.array([[0.5, 1.0], [0, 0], [1, 0]]), np.array([[0.5, -1.0], [0, 0], [1, 0]])
    assert TIGHT().point_edge_ccd(*plane[0], *plane[1])[1] <= 0.5
    assert ccd.point_segment_ccd(plane[0][None], plane[1][None]).toi[0] == pytest.approx(0.5)
    # a point that crosses a face at right angles, both oblique to all axes: the maximum norm keeps √3 of the distance
    normal, side = np.ones(3) / np.sqrt(3), np.array([1.0, -1, 0]) / np.sqrt(2)
    other = np.cross(normal, side)
    face = 9 * np.array([side - other / 2, -side - other / 2, other])
    start, end = (np.vstack([height * normal, face]) for height in (2, -2))
    tight, additive = (narrow.point_triangle_ccd(*start, *end, min_distance=0.3)[1] for narrow in (TIGHT(), ADDITIVE()))
    ours = ccd.vertex_face_ccd(start[None], end[None], minimum_separation=0.3, length_scale=1.0).toi[0]
    assert [2 - 4 * tight, 2 - 4 * ours] == pytest.approx([0.3 * np.sqrt(3)] * 2, abs=1e-3)
    assert 2 - 4 * additive == pytest.approx(0.3 + 0.1 * 1.7)  # a tenth of what is beyond the distance
    assert (TIGHT().tolerance, TIGHT().max_iterations, TIGHT().conservative_rescaling) == (1e-6, 10_000_000, 0.8)
