"""Candidates and results of both broad phases where no drawn scene of the laws goes: numbers, counts, order."""

import re

import numpy as np
import pytest
import warp as wp
from expected_warnings import OF_DISTANCES, OF_ROUNDING
from hypothesis import given, settings
from hypothesis import strategies as st
from laws.outputs import different, outputs_of
from laws.truth import Pairs, candidates
from published import requires_data, simulation_boxes, simulation_scenes, simulation_step
from scenes import NO_FACES, all_in_one_place, sheet, single, soup, with_static_at_rest

import ccd_warp as ccd
from ccd_warp._engine.mesh import body_groups
from ccd_warp._engine.mesh.topology import Topology

pytestmark = [OF_DISTANCES, OF_ROUNDING, pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")]
BOTH = ("tree", "hash")


def tuples_of(found):
    return [[*map(tuple, pairs.tolist())] for pairs in vars(found).values()]


def check(mesh, start, end, inflation=0.0):
    """Both broad phases find what brute force finds, and all calls have the same bits; the number of candidates."""
    expected = candidates(Pairs(mesh), start, end, inflation)
    answers = []
    for name in BOTH:
        assert tuples_of(ccd.find_candidates(mesh, start, end, inflation, broad_phase=name).sorted()) == expected
        options = {"broad_phase": name, "length_scale": 1.0}
        result = ccd.mesh_ccd(mesh, start, end, **options)
        counts = {
            key: np.array([*getattr(result.counts, key).values()]) for key in ("num_candidates", "num_after_cull")
        }
        step = ccd.collision_free_step(mesh, start, end, **options)
        answers.append(outputs_of(result.contacts, "contacts") | counts | {"step": np.array(step)})
    assert different(*answers) == []
    return sum(map(len, expected))


# --- numbers ---


def of_many_sizes(rng, spread):
    size, place = (
        10.0 ** -rng.uniform(0, spread, (60, 1, 1)) * x for x in (rng.normal(size=(60, 3, 3)), rng.random((60, 1, 3)))
    )
    return (place + size).reshape(-1, 3), (place + 1.5 * size).reshape(-1, 3)


def with_giants(rng, sizes):
    """Small faces, and one of each size."""
    start = soup(rng, 90, 0.01)[0]
    for k, size in enumerate(sizes):
        start[3 * k : 3 * k + 3] = size * np.array([[-1.0, -1, 0.5], [1, -1, 0.5], [0, 1, 0.55]])
    return start, start + 0.1 * rng.standard_normal(start.shape)


def on_cells(rng, sides):
    """Every corner of every box is a multiple of a power of two, as are the cells, and most boxes touch."""
    start = np.repeat(rng.integers(0, 12, (60, 1, 3)), 3, axis=1) + rng.integers(0, sides + 1, (60, 3, 3))
    return start.reshape(-1, 3) / 16.0, (start + rng.integers(-2, 3, start.shape)).reshape(-1, 3) / 16.0


def one_flies_to(rng, distance):
    start = soup(rng, 60, 0.05)[0]
    return start, np.where(np.arange(180)[:, None] == 7, distance, start + 0.01)


def scaled(rng, scale):
    start = soup(rng, 60, 0.05)[0]
    end = start + 0.05 * rng.standard_normal(start.shape)
    return tuple(np.clip(2 * x - 1, -1, 1) * scale for x in (start, end))


def that_overflows(rng, small):
    start = small * soup(rng, 30, 0.05)[0]
    start[:3] = [[-1.7e308] * 3, [1.7e308] * 3, [0, 1.7e308, 0]]
    return start, start


def around(rng, offset):
    start = soup(rng, 60, 0.05)[0] + np.array([1, -1, 1]) * offset
    start[90:] += offset * 1e90 * (offset > 1e9)
    return start, start + 0.01


def in_plane(rng, axis):
    start = soup(rng, 60, 0.05)[0]
    start[:, axis] = 0.25
    return start, start


NUMBERS = {
    of_many_sizes: (3, 20, 250),
    with_giants: ([1e3], [*4.0 ** np.arange(-9, 14)]),
    on_cells: (0, 2),
    one_flies_to: (1e6, 1e15, 1e300),
    scaled: (0.0, 5e-324, 1e-310, 1e-150, 1e150, 1.7e308),
    that_overflows: (5e-324, 1e-100, 1.0, 1e200),
    around: (1e7, 1e10),
    in_plane: (0, 1, 2),
}


@pytest.mark.parametrize("make", NUMBERS, ids=lambda make: make.__name__)
def test_numbers_of_any_size(make):
    for value in NUMBERS[make]:
        start, end = make(np.random.default_rng(4), value)
        mesh = single(start, np.arange(len(start)).reshape(-1, 3))
        assert check(mesh, start, end) > 0, value


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


def test_boxes_are_rounded_outward():
    """2/10 apart; and half of a last bit, lost once with a radius and once with an inflation."""
    x = np.array([[0.0, 0, 0]] * 3 + [[0.2, 0, 0]] * 3)
    assert check(single(x, [[0, 1, 2], [3, 4, 5]]), x, x, 0.1) and check(
        single(x, [[0, 1, 2], [3, 4, 5]]), x, x, np.nextafter(0.1, 0)
    )
    half = 2.0**-53
    x = np.array([[1.0, 0, 0], [1.0 + 4 * half, 0, 0]])
    assert (
        check(ccd.CollisionMesh.from_arrays([(x, NO_FACES)], codimensional_points=True, radius=half), x, x, half) == 1
    )


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=36, max_size=108))
def test_any_finite_numbers(values):
    start = np.array(values[: len(values) // 9 * 9]).reshape(-1, 3)
    mesh = single(start, np.arange(len(start)).reshape(-1, 3))
    expected = candidates(Pairs(mesh), start, start, 0.0)
    assert all(
        tuples_of(ccd.find_candidates(mesh, start, start, broad_phase=name).sorted()) == expected for name in BOTH
    )


# --- many worlds, bodies and pairs ---


@pytest.mark.parametrize("num_worlds", [2, 9, 70])
def test_worlds_in_one_place(num_worlds):
    rng = np.random.default_rng(num_worlds)
    bodies = [soup(rng, int(rng.integers(1, 6)), 0.3) for _ in range(num_worlds)]
    bodies = [(np.round(8 * x) / 8, faces) for x, faces in bodies]
    world = np.repeat(np.arange(num_worlds), [len(x) for x, _ in bodies])
    mesh = ccd.CollisionMesh.from_arrays(bodies, vertex_world=world)
    for inflation in (0.0, 0.125):
        assert check(
            mesh, mesh.vertices, mesh.vertices + np.round(2 * rng.standard_normal(mesh.vertices.shape)) / 8, inflation
        )


@pytest.mark.parametrize("most_rows", [1 << 10, 3])
def test_bodies_that_may_not_meet_in_one_place(most_rows, monkeypatch):
    """Bodies of scenes, of teams, or of any pairs; in a table of few rows several groups share one."""
    monkeypatch.setattr(body_groups, "_MOST_ROWS", most_rows)
    rng, found = np.random.default_rng(most_rows), 0
    for kind in (0, 1, 2) * 3:
        count = int(rng.integers(2, 30))
        bodies, team = [soup(rng, int(rng.integers(1, 6)), 0.3) for _ in range(count)], rng.integers(0, 3, count)
        may = rng.random((count, count)) < rng.choice([0.0, 0.05, 0.3, 0.9])
        may = (team[:, None] == team, (team[:, None] != team) | (team == 2), may | may.T)[kind]
        roles = rng.choice(3, count, p=[0.5, 0.2, 0.3])
        mesh = ccd.CollisionMesh.from_arrays(
            bodies,
            static=np.flatnonzero(roles == 1).tolist(),
            kinematic=np.flatnonzero(roles == 2).tolist(),
            body_pairs=may | may.T,
            exclude_pairs={"bodies": rng.integers(0, count, (count // 3, 2))},
            self_collision=(rng.random(count) < 0.5).tolist(),
        )
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
        topology = Topology.of(mesh, wp.get_device("cpu"))
        topology.collision_filter.applies = 0  # so that all pairs are counted of boxes that the search compares
        return sum(ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, broad_phase=name).counts.num_candidates.values())

    for each in (1, 2):
        assert num_compared(80, each) < 2.4 * num_compared(40, each)


def test_sets_that_may_not_meet_and_kinds_that_do_not_occur_are_not_searched():
    body, may = soup(np.random.default_rng(1), 40, 0.3), np.zeros((4, 4), dtype=bool)
    may[3] = may[:, 3] = True
    mesh = ccd.CollisionMesh.from_arrays([body] * 4, static=[3], body_pairs=may, self_collision=False)
    counts = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices).counts.num_searches
    assert counts == {ccd.PairKind.VERTEX_FACE: 2, ccd.PairKind.EDGE_EDGE: 1}
    for arrays, searched in ((body, [0, 1]), ((*body[:1], [], [[0, 1]]), [1]), ((body[0], []), [])):
        mesh = ccd.CollisionMesh.from_arrays([arrays])
        found = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices).counts.num_searches
        assert [int(kind) for kind, count in found.items() if count] == searched


def test_a_large_mesh_is_sorted_by_several_threads_and_sampled_first():
    upper, faces = sheet(160)
    lower, lower_faces = sheet(120, 1.1)
    mesh = ccd.CollisionMesh.from_arrays([(upper + [0.003, 0.001, 0.05], faces), (lower, lower_faces)], static=[1])
    end = mesh.vertices - [0, 0, 0.1] * (mesh.vertex_body == 0)[:, None]
    step = ccd.collision_free_step(mesh, mesh.vertices, end)
    for num_threads in (1, 4):
        options = {"broad_phase": "hash", "num_threads": num_threads}
        assert ccd.collision_free_step(mesh, mesh.vertices, end, **options) == step < 1


def test_many_pairs_a_query():
    """More pairs than the first guess of the capacity."""
    start, faces = soup(np.random.default_rng(16), 700, 0.0)
    start = start * [1.0, 1e-3, 1e-3]
    start[:3] = [[-1, -1, -1], [2, 2, 2], [-1, 2, -1]]
    assert check(single(start, faces), start, start) > 2000
    found = ccd.find_candidates(single(start[:600], faces[:200]), 0 * start[:600], 0 * start[:600], num_threads=2)
    assert len(found.vertex_face) == 600 * 199 and len(found.edge_edge) == 600 * 599 // 2 - 600


@requires_data
@pytest.mark.parametrize("scene", simulation_scenes())
def test_published_pairs_are_found(scene):
    step = simulation_step(scene)
    mesh = single(step.vertices_t0, step.faces)
    found = ccd.find_candidates(mesh, step.vertices_t0, step.vertices_t1)
    offset = {"v": 0, "e": mesh.num_vertices, "f": mesh.num_vertices + mesh.num_edges}
    for kind, pairs, sides in (("vertex-face", found.vertex_face, "vf"), ("edge-edge", found.edge_edge, "ee")):
        published = np.sort(simulation_boxes(scene, kind), axis=1) - [offset[side] for side in sides]
        assert len(published) and {*map(tuple, pairs.tolist())}.issuperset(map(tuple, published.tolist()))


# --- order, and whose the arrays are ---


def test_blocks_of_boxes_that_exceed_the_memory_limit_keep_the_order():
    """The least limit holds the partners of one box a thread; a block of sixteen, which have more, is cut."""
    mesh, *frames = all_in_one_place(2, 280, 900)
    expected = tuples_of(ccd.find_candidates(mesh, *frames, num_threads=1))
    for num_threads in (1, 3):
        with pytest.raises(ValueError, match="memory_limit is 1 bytes; expected at least") as error:
            ccd.CollisionPipeline(mesh, memory_limit=1, num_threads=num_threads).find_candidates(*frames)
        limit = int(re.search(r"at least (\d+)", str(error.value))[1])
        pipeline = ccd.CollisionPipeline(mesh, memory_limit=limit, num_threads=num_threads)
        assert tuples_of(pipeline.find_candidates(*frames)) == expected and pipeline.counts.num_batches > 10


def test_candidates_keep_their_order_belong_to_the_caller_and_are_sorted_on_demand():
    """Static bodies keep their boxes while others move far in one step and little in the next."""
    rng = np.random.default_rng(3)
    mesh = ccd.CollisionMesh.from_arrays(
        [soup(rng, 600, 0.03, spread=1.4), soup(rng, 600, 0.03, spread=1.4)], static=[1]
    )
    start = np.concatenate(
        [mesh.vertices[:1800], mesh.vertices[1800:].reshape(-1, 3, 3)[rng.permutation(600)].reshape(-1, 3)]
    )
    ends = [with_static_at_rest(mesh, start, start + s * rng.standard_normal(start.shape)) for s in (0.01, 0.1)]
    expected = [tuples_of(ccd.CollisionPipeline(mesh).find_candidates(start, end)) for end in ends]
    for order in ((0, 1, 0, 1, 1, 0), (1, 0)):
        pipeline = ccd.CollisionPipeline(mesh)
        found = [pipeline.find_candidates(start, ends[k]) for k in order]
        assert [tuples_of(each) for each in found] == [expected[k] for k in order]
    for name, pairs in vars(found[-1]).items():
        ordered = getattr(found[-1].sorted(), name)
        assert pairs.dtype == ordered.dtype == np.int32 and pairs.flags.writeable and pairs.flags.c_contiguous
        assert not np.shares_memory(pairs, ordered) and not np.shares_memory(pairs, getattr(found[0], name))
        np.testing.assert_array_equal(ordered, pairs[np.lexsort(pairs.T[::-1])])
