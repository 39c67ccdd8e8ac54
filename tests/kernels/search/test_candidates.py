"""Candidates and results of both broad phases where no drawn scene of the laws goes: numbers, counts, order."""

import re

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.template import specialised
from expected_warnings import OF_DISTANCES, OF_ROUNDING
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from laws.outputs import different, outputs_of
from laws.truth import Pairs, candidates
from published import requires_data, simulation_boxes, simulation_scenes, simulation_step
from scenes import NO_FACES, sheet, single, soup, with_static_at_rest

import ccd_warp as ccd
from ccd_warp._engine.host.candidate_step import CandidateStep
from ccd_warp._engine.mesh import body_groups
from ccd_warp._engine.mesh.topology import Topology

pytestmark = [OF_DISTANCES, OF_ROUNDING, pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")]
BOTH = ("tree", "hash")


def tuples_of(found):
    return [[*map(tuple, pairs.tolist())] for pairs in vars(found).values()]


def check(mesh, start, end, inflation=0.0):
    """Both broad phases find what brute force finds, and all calls have the same bits; the number of candidates."""
    expected, answers = candidates(Pairs(mesh), start, end, inflation), []
    for name in BOTH:
        assert tuples_of(ccd.find_candidates(mesh, start, end, inflation, broad_phase=name).sorted()) == expected
        options = {"broad_phase": name, "length_scale": 1.0}
        result, step = ccd.mesh_ccd(mesh, start, end, **options), ccd.collision_free_step(mesh, start, end, **options)
        answers.append(outputs_of({"host": result.contacts, "counts": result.counts, "step": step}))
    assert different(*answers) == []
    return sum(map(len, expected))


# --- numbers ---


def test_points_far_beyond_the_ends_of_the_grid_and_in_one_place():
    """They stand in one row of cells there, and the box around them covers any number of coarser ones."""
    rng = np.random.default_rng(0)
    points = 1.7e308 * rng.uniform(-1.0, 1.0, (120, 3))
    motion = 10.0 ** rng.uniform(301, 307, (120, 1)) * rng.standard_normal((120, 3)) * (np.arange(120) % 2)[:, None]
    mesh = ccd.CollisionMesh.from_arrays([(points, NO_FACES)], codimensional_points=True)
    check(mesh, points, np.clip(points + motion, -1.7e308, 1.7e308))
    assert check(mesh, 0 * points, 0 * points) == 120 * 119 // 2


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_edge_over_three_cells_whose_rounded_length_is_that_of_one(axis):
    """It begins by less than a rounding below a face of the cells; at its upper end, two cells on, is a particle."""
    sides = np.float32(2.0) ** np.float32(-np.arange(8) / 4)  # as cells have them, and the floats beside those
    for upper in np.concatenate([np.nextafter(sides, np.float32(0)), sides, np.nextafter(sides, np.float32(2))]):
        edges = np.zeros((40, 3))  # the first one, and short ones far away, by which the cells are small
        edges[2:, (axis + 1) % 3] = np.repeat(np.arange(19) - 9, 2) / 8 + 0.5
        edges[3::2, axis] = 2.0**-10
        edges[0, axis], edges[1, axis] = -(2.0**-60), upper
        particle = np.where(np.arange(3) == axis, upper, 0.0)[None].astype(float)
        bodies = [(edges, NO_FACES, np.arange(40).reshape(-1, 2)), (particle, NO_FACES)]
        mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, self_collision=False)
        found = ccd.find_candidates(mesh, mesh.vertices, mesh.vertices, broad_phase="hash")
        assert found.point_segment.tolist() == [[40, 0]]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=36, max_size=108))
def test_any_finite_numbers(values):
    start = np.array(values[: len(values) // 9 * 9]).reshape(-1, 3)
    mesh = single(start, np.arange(len(start)).reshape(-1, 3))
    found = [tuples_of(ccd.find_candidates(mesh, start, start, broad_phase=name).sorted()) for name in BOTH]
    assert found == [candidates(Pairs(mesh), start, start, 0.0)] * 2


# --- many bodies and pairs ---


@pytest.mark.parametrize("most_rows", [1 << 10, 3])
def test_bodies_that_may_not_meet_in_one_place(most_rows, monkeypatch):
    """Bodies of scenes, of teams, of any pairs, or of worlds; in a table of few rows several groups share one."""
    monkeypatch.setattr(body_groups, "_MOST_ROWS", most_rows)
    rng, found = np.random.default_rng(most_rows), 0
    for kind in (0, 1, 2, 3) * 3:
        count = int(rng.integers(2, 30))
        bodies, team = [soup(rng, int(rng.integers(1, 6)), 0.3) for _ in range(count)], rng.integers(0, 3, count)
        may = rng.random((count, count)) < rng.choice([0.0, 0.05, 0.3, 0.9])
        same, of_worlds = team[:, None] == team, np.repeat(rng.permutation(count) // 2, [len(x) for x, _ in bodies])
        may = (same, ~same | (team == 2), may | may.T, np.ones_like(may))[kind]
        roles = rng.choice(3, count, p=[0.5, 0.2, 0.3])
        options = {name: np.flatnonzero(roles == k + 1).tolist() for k, name in enumerate(("static", "kinematic"))}
        options |= {"body_pairs": may | may.T, "vertex_world": of_worlds if kind == 3 else None}
        options["exclude_pairs"] = {"bodies": rng.integers(0, count, (count // 3, 2))}
        options["self_collision"] = (rng.random(count) < 0.5).tolist()
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
        end = mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)
        found += check(mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, end))
    assert found > 500


@pytest.mark.parametrize("name", BOTH)
def test_bodies_that_may_not_meet_in_one_place_are_not_compared(name):
    """Twice as many bodies, each of which meets itself alone or one other, are twice the work, not four times."""
    body = soup(np.random.default_rng(0), 80, 0.3)

    def num_compared(num_bodies, each):
        may = np.arange(num_bodies)[:, None] // each == np.arange(num_bodies) // each
        mesh = ccd.CollisionMesh.from_arrays([body] * num_bodies, body_pairs=may, self_collision=each == 1)
        # so that all pairs are counted of boxes that the search compares
        Topology.of(mesh, wp.get_device("cpu")).collision_filter.applies = 0
        return sum(ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, broad_phase=name).counts.num_candidates.values())

    for each in (1, 2):
        assert num_compared(80, each) < 2.4 * num_compared(40, each)


def test_sets_that_may_not_meet_and_kinds_that_do_not_occur_are_not_searched():
    body, may = soup(np.random.default_rng(1), 40, 0.3), np.zeros((4, 4), dtype=bool)
    may[3] = may[:, 3] = True
    cases = (([body] * 4, {"static": [3], "body_pairs": may, "self_collision": False}, {0: 2, 1: 1}),)
    cases += ([body], {}, {0: 1, 1: 1}), ([(*body[:1], [], [[0, 1]])], {}, {1: 1}), ([(body[0], [])], {}, {})
    for bodies, options, expected in cases:
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
        found = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices).counts.num_searches
        assert {int(kind): count for kind, count in found.items() if count} == expected


def test_a_large_mesh_is_sorted_by_several_threads_and_sampled_first():
    (upper, faces), lower = sheet(160), sheet(120, 1.1)
    mesh = ccd.CollisionMesh.from_arrays([(upper + [0.003, 0.001, 0.05], faces), lower], static=[1])
    frames = mesh.vertices, mesh.vertices - [0, 0, 0.1] * (mesh.vertex_body == 0)[:, None]
    options = {}, {"broad_phase": "hash", "num_threads": 1}, {"broad_phase": "hash", "num_threads": 4}
    steps = [ccd.collision_free_step(mesh, *frames, **each) for each in options]
    assert steps[0] == steps[1] == steps[2] < 1


def test_many_pairs_a_query():
    """More pairs than the first guess of the capacity."""
    start, faces = soup(np.random.default_rng(16), 300, 0.0)
    start *= [1.0, 1e-3, 1e-3]
    start[:3] = [[-1, -1, -1], [2, 2, 2], [-1, 2, -1]]
    assert check(single(start, faces), start, start) > 1500
    found = ccd.find_candidates(single(start[:600], faces[:200]), 0 * start[:600], 0 * start[:600], num_threads=2)
    assert len(found.vertex_face) == 600 * 199 and len(found.edge_edge) == 600 * 599 // 2 - 600


@requires_data
@pytest.mark.parametrize("scene", simulation_scenes())
def test_published_pairs_are_found(scene):
    step = simulation_step(scene)
    mesh = single(step.vertices_t0, step.faces)
    found = ccd.find_candidates(mesh, step.vertices_t0, step.vertices_t1)
    v, e, f = 0, mesh.num_vertices, mesh.num_vertices + mesh.num_edges
    for kind, pairs, sides in (("vertex-face", found.vertex_face, [v, f]), ("edge-edge", found.edge_edge, [e, e])):
        published = np.sort(simulation_boxes(scene, kind), axis=1) - sides
        assert len(published) and np.isin(published @ [1 << 32, 1], pairs.astype(np.int64) @ [1 << 32, 1]).all()


# --- order, and whose the arrays are ---


def test_searches_that_exceed_the_memory_limit_keep_the_order():
    """The least limit holds the partners of sixteen boxes; of three threads one has all of it for some blocks."""
    rng, cables = np.random.default_rng(2), np.arange(450).reshape(-1, 2)
    bodies = [(*soup(rng, 280, 0.2, spread=0.0), []) for _ in range(2)]
    bodies.append((0.01 * rng.standard_normal((900, 3)), [], cables))  # all boxes hold the origin
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], codimensional_points=True)
    frames = mesh.vertices, with_static_at_rest(mesh, mesh.vertices, -mesh.vertices)
    expected = [*vars(ccd.find_candidates(mesh, *frames, num_threads=1)).values()]
    for num_threads in (1, 3):
        with pytest.raises(ValueError, match="memory_limit is 1 bytes; expected at least") as error:
            ccd.CollisionPipeline(mesh, memory_limit=1, num_threads=num_threads).find_candidates(*frames)
        limit = int(re.search(r"at least (\d+)", str(error.value))[1])
        pipeline = ccd.CollisionPipeline(mesh, memory_limit=limit, num_threads=num_threads)
        found = vars(pipeline.find_candidates(*frames)).values()
        assert all(map(np.array_equal, found, expected)) and pipeline.counts.num_batches > 10


def test_candidates_keep_their_order_belong_to_the_caller_and_are_sorted_on_demand():
    """Static bodies keep their boxes while others move far in one step and little in the next, or are mixed up."""
    rng = np.random.default_rng(3)
    bodies = [soup(rng, 600, 0.03, spread=1.4) for _ in range(2)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1])
    moving = bodies[0][0]
    mixed, resting = (x.reshape(-1, 3, 3)[rng.permutation(600)].reshape(-1, 3) for x, _ in bodies)
    steps = [(np.concatenate([x, resting]), s) for x, s in ((moving, 0.01), (moving, 0.1), (mixed, 0.01))]
    steps = [(x, with_static_at_rest(mesh, x, x + s * rng.standard_normal(x.shape))) for x, s in steps]
    expected = [[*vars(ccd.CollisionPipeline(mesh).find_candidates(*step)).values()] for step in steps]
    for order in ((0, 1, 2, 0, 1, 1, 2, 0), (2, 1, 0)):
        find = ccd.CollisionPipeline(mesh).find_candidates
        found = [find(*steps[k]) for k in order]
        for each, k in zip(found, order, strict=True):
            assert all(map(np.array_equal, vars(each).values(), expected[k]))
    before, last, in_order = (vars(x).values() for x in (found[0], found[-1], found[-1].sorted()))
    for other, pairs, ordered in zip(before, last, in_order, strict=True):
        assert pairs.dtype == ordered.dtype == np.int32 and pairs.flags.writeable and pairs.flags.c_contiguous
        assert not np.shares_memory(pairs, ordered) and not np.shares_memory(pairs, other)
        np.testing.assert_array_equal(ordered, pairs[np.lexsort(pairs.T[::-1])])


def test_a_block_whose_pairs_no_batch_can_hold_is_an_error_and_no_loop(monkeypatch):
    mesh = ccd.CollisionMesh.from_arrays([sheet(9), sheet(9)])
    monkeypatch.setattr(CandidateStep, "capacity", lambda *_: 8)
    with pytest.raises(MemoryError, match="a block of boxes overlaps more than 8 others"):
        ccd.find_candidates(mesh, mesh.vertices, mesh.vertices)


@pytest.mark.parametrize("width", [4, 8])
def test_what_an_item_collects_is_as_long_as_its_array(width):
    collected = specialised("search.collected", width=width)
    assert collected.number_at + 1 == collected.partners_at == 6 * collected.capacity + 1
    assert collected.num_collected == collected.partners_at + 16
