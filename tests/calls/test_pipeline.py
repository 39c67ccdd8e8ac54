"""The main calls on meshes: promised times of scenes laid out by hand, what an option does, and what is counted."""

import numpy as np
import pytest
from exact import exact_tois
from laws.outputs import tois_of
from published import requires_data, simulation_boxes, simulation_queries, simulation_step
from scenes import FACE, NO_FACES, TRIANGLE, crowd, crowd_in_plane, sheet_over_floor, stacked

import ccd_warp as ccd

SEGMENT, EDGE, NO_EDGES = np.array([[-1.0, 0], [1, 0]]), [[0, 1]], np.zeros((0, 2), dtype=int)
CABLES = [([[0, -1, 0], [0, 1, 0]], [], EDGE), ([[2, 0, -1], [2, 0, 1]], [], EDGE)]
FALLING = [(TRIANGLE, FACE), ([[0.1, 0.2, 1]], [])]


def answers(mesh, start, end, **options):
    """The result of `mesh_ccd`, once the other calls have said the same."""
    result = ccd.mesh_ccd(mesh, start, end, **options)
    launched = ccd.CollisionPipeline(mesh, **options).launch(start, end).to_host()
    assert launched.toi == result.toi and np.array_equal(launched.vertex_toi, result.vertex_toi)
    step = ccd.collision_free_step(mesh, start, end, **options)
    assert min(result.toi, options.get("t_max", 1.0)) - 1e-6 <= step <= result.toi
    assert ccd.is_step_collision_free(mesh, start, end, **options) == (not result.hit)
    return result


# --- what is promised of scenes laid out by hand ---


@pytest.mark.parametrize(
    "bodies, moves, toi",
    [
        ([([[0.0, 0], [1, 0]], NO_EDGES)], [[1, 0], [0, 0]], 1.0),  # point to point
        ([(SEGMENT, EDGE), (SEGMENT * 0 + [0, 1], EDGE)], [[0, 0], [0, 0], [0, -2], [0, -2]], 0.5),  # no length
        ([(SEGMENT, EDGE), (SEGMENT + [3, 0], EDGE)], [[2, 0], [2, 0], [0, 0], [0, 0]], 0.5),  # along one line
        ([(SEGMENT, EDGE), (SEGMENT + [0, 1], EDGE)], [[0, 1], [0, 1], [0, -1], [0, -1]], 0.5),  # flat on flat
        ([(SEGMENT, EDGE), (SEGMENT + [2, 0], EDGE)], [[0, 0]] * 4, 0.0),  # they touch from the start
        ([(SEGMENT, EDGE), (SEGMENT + [0, 1], EDGE)], [[0, 1], [0, 1], [0, 1], [0, 1]], np.inf),  # together
        ([(SEGMENT, [[0, 1], [1, 0], [0, 0]])], [[3, 1], [0, 0]], np.inf),  # an edge alone, given three times
        ([(TRIANGLE, FACE), (TRIANGLE, FACE)], np.zeros((6, 3)), 0.0),  # in one place
        (CABLES, [[0, 0, 0]] * 2 + [[-4, 0, 0]] * 2, 0.5),
        (FALLING, [[0, 0, 0]] * 3 + [[0, 0, -2]], 0.5),
        (FALLING, [[0, 0, 0]] * 3 + [[0, 0, -1]], 1.0),  # which ends on the face
        (FALLING, [[0, 0, 0]] * 3 + [[0, 0, -0.99]], np.inf),
        ([(TRIANGLE[[0, 0, 0]], FACE)] * 2, np.zeros((6, 3)), 0.0),  # of no extent
        ([(NO_FACES * 1.0, NO_FACES), (TRIANGLE, FACE)], np.ones((3, 3)), np.inf),  # beside an empty body
        ([([], [])], np.ones((0, 3)), np.inf),
        ([(np.zeros((0, 2)), NO_EDGES)], np.ones((0, 2)), np.inf),
    ],
)
def test_what_meets_when(bodies, moves, toi):
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    result = answers(mesh, mesh.vertices, mesh.vertices + moves, tolerance=1e-9)
    assert result.toi <= toi and result.toi == pytest.approx(toi, abs=1e-6)
    assert result.counts.num_contacts_at_start == (len(result.contacts) if toi == 0 else 0)


@requires_data
@pytest.mark.parametrize("scene", ["cloth-funnel", "rod-twist"])
def test_published_step(scene):
    step, earliest, touching = simulation_step(scene), np.inf, set()
    mesh = ccd.CollisionMesh.from_arrays([(step.vertices_t0, step.faces)])
    n = mesh.num_vertices
    for number, (kind, first) in enumerate({"vertex-face": (0, n + mesh.num_edges), "edge-edge": (n, n)}.items()):
        queries = simulation_queries(scene, kind)
        ids = simulation_boxes(scene, kind)[queries.truth] - np.array(first)
        ids = np.sort(ids, axis=1) if kind == "edge-edge" else ids
        touching |= {(number, *row) for row in ids.tolist()}
        exact = exact_tois(kind, queries.points_t0[queries.truth], queries.points_t1[queries.truth])
        earliest = min(earliest, *(e.approx for e in exact))
    for precision, tolerance in (("float64", 1e-9), ("float32", 1e-2)):
        result = ccd.mesh_ccd(mesh, step.vertices_t0, step.vertices_t1, precision=precision)
        assert {k for k, *_ in touching} == {0, 1} and touching <= tois_of(result.contacts).keys()
        assert earliest - tolerance <= result.toi <= earliest


def test_blocks_of_a_mesh_in_the_plane_have_its_coordinates():
    pytest.importorskip("pyvista")
    mesh, start, end = crowd_in_plane(np.random.default_rng(10))
    result = ccd.mesh_ccd(mesh, start, end)
    blocks = ccd.viz.to_pyvista(mesh, start, end, result, t=1.0)
    np.testing.assert_array_equal(np.asarray(blocks["dust"].points)[:, :2], end[mesh.vertex_body == 2])
    np.testing.assert_array_equal(np.asarray(blocks["contacts"].point_data["normal"])[:, :2], result.contacts.normal)


# --- what options do ---


def test_default_separation_is_the_same_however_far_the_body_falls():
    mesh, start = stacked(0.0, 1.0)
    flat = ccd.CollisionMesh.from_arrays([(np.zeros((3, 3)), FACE), (np.zeros((3, 3)), FACE)])
    unit = float(np.ptp(start, axis=0).max())
    assert mesh.length_scale == unit and flat.length_scale == 1.0
    for of, length in ((mesh, unit), (flat, 1.0)):
        for height in (1.5, 4.0, 100.0):
            end = start - [0, 0, height] * (mesh.vertex_body == 1)[:, None]
            toi = answers(of, start, end, minimum_separation=0.1).toi
            assert toi == pytest.approx((1.0 - 0.1 * length) / height, abs=1e-5)


def test_bisection_is_early_by_its_tolerance_and_earlier_where_it_is_cut_short():
    mesh, start, end = crowd(np.random.default_rng(2), 60, 0.2)
    clipped, whole, cut = (
        answers(mesh, start, end, **options)
        for options in (
            {"tolerance": 1e-4},
            {"tolerance": 1e-4, "method": "bisection"},
            {"method": "bisection", "max_iterations": 20},
        )
    )
    assert len(whole.contacts) > 20 and whole.contacts.toi.tobytes() != clipped.contacts.toi.tobytes()
    assert whole.toi == pytest.approx(clipped.toi, abs=1e-2)  # at the speeds of the scene, about one
    assert (cut.contacts.status == ccd.CCDStatus.ITERATION_LIMIT).any()
    early, late = tois_of(cut.contacts), tois_of(whole.contacts)
    assert early.keys() >= late.keys() and sum(early[key] for key in late) < sum(late.values())


# --- what is counted ---


def test_counts_and_timings_are_of_the_last_call_on_the_host():
    mesh, start, end = sheet_over_floor()
    pipeline = ccd.CollisionPipeline(mesh)
    assert pipeline.counts == ccd.Counts() and pipeline.timings == {}
    result = pipeline.mesh_ccd(start, end)
    counts = pipeline.counts
    assert counts == result.counts and (counts.num_bodies, counts.num_vertices) == (2, mesh.num_vertices)
    assert sum(counts.num_contacts.values()) == len(result.contacts) > 0
    assert set(result.timings) == {"input", "boxes", "pairs", "narrow phase", "gather", "total"}
    assert all(seconds >= 0 for seconds in result.timings.values())
    pipeline.launch_line_search(start, end.copy())
    pipeline.launch(start, end)  # which has counts of its own, on the device
    assert pipeline.counts is counts and pipeline.timings == result.timings
    pipeline.find_candidates(start, end)
    assert pipeline.counts.num_contacts == {} and all(pipeline.counts.num_candidates.values())
    # the search of a step that cannot begin ends with the first pair that touches at the start
    touching = 0.5 * (start + end)
    assert pipeline.collision_free_step(touching, end) == 0.0
    counts = pipeline.counts
    assert counts.num_contacts == {} and sum(counts.num_candidates.values()) > 0 and counts.num_batches > 0
