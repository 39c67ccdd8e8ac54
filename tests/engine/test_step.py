"""Whole steps: what is left out, batches under a memory limit, threads, and scenes made to break a broad phase."""

import re
import weakref
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from exact import exact_tois
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from held_memory import held_bytes, requires_status
from scenes import FACE, TETRAHEDRON, TRIANGLE, crowd, leaning_stack, sheet, single, soup

import ccd_warp as ccd
from ccd_warp._engine.boxes import step_boxes
from ccd_warp._engine.mesh.topology import Topology, choose_quantization

pytestmark = OF_ROUNDING

STEPS = ("mesh_ccd", "collision_free_step", "find_candidates")


def least_bytes(error):
    return int(re.search(r"expected at least (\d+)", str(error.value)).group(1))


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
@pytest.mark.parametrize(("family", "scale"), [*product(FAMILIES, (0, (700, -537, -530)))])
def test_hard_pairs_in_one_mesh_are_all_found(family, scale, kind):
    """Queries of every hard family side by side, of whatever scales: no box and no cull may lose one."""
    count = 40
    points = [np.ldexp(x, scale) for x in FAMILIES[family](kind, count, np.random.default_rng(21))]
    start, end = (x.reshape(-1, 3) for x in points)
    sides = [[0, 1, 1], [2, 3, 3]] if kind == "edge-edge" else [[1, 2, 3]]
    faces = np.concatenate([4 * np.arange(count)[:, None] + side for side in sides])
    mesh = ccd.CollisionMesh.from_arrays([(start, faces)], codimensional_points=kind == "vertex-face")
    result, step = (call(mesh, start, end, length_scale=1e-300) for call in (ccd.mesh_ccd, ccd.collision_free_step))
    contacts = result.contacts[result.contacts.kind == ccd.PairKind[kind.replace("-", "_").upper()]]
    toi = {tuple(sorted(corners)): t for corners, t in zip(contacts.vertices.tolist(), contacts.toi, strict=True)}
    for k, truth in enumerate(exact_tois(kind, *points)):
        if truth.hit:
            corners = tuple(range(4 * k, 4 * k + 4))
            assert corners in toi and not truth.late(toi[corners]) and not truth.late(step)


# --- what is left out ---


def test_positions_as_near_others_as_these_allow_have_their_quantization():
    """All moved along an axis, away from the middle, or at random; and of those four times as far not all have it."""
    rng, num_other = np.random.default_rng(12), 0
    for _ in range(40):
        mesh = ccd.CollisionMesh.from_arrays([soup(rng, int(rng.integers(1, 60)), 0.3)])
        topology = Topology.of(mesh, wp.get_device("cpu"))
        start = np.ldexp(mesh.vertices * rng.uniform(0.5, 1, 3) + rng.uniform(-3, 3, 3), int(rng.integers(-30, 30)))
        both = np.stack([start, start + 0.1 * np.ptp(start) * rng.standard_normal(start.shape)])
        found = choose_quantization(topology, tuple(both), 2)
        slack = found.slack(np.abs(both).max())
        ways = [sign * axis + 0 * both for axis in np.eye(3) for sign in (-1, 1)]
        ways += [np.sign(both - found.centre), -np.sign(both - found.centre), rng.uniform(-1, 1, both.shape)]
        for way in ways:
            near, far = (choose_quantization(topology, tuple(both + k * slack * way), 2) for k in (1, 4))
            assert near[:2] == found[:2]
            num_other += far[:2] != found[:2]
    assert num_other > 40


def test_a_loop_of_equal_steps_of_a_scene_whose_size_is_a_power_of_two_chooses_coordinates_a_few_times(monkeypatch):
    chosen = []
    monkeypatch.setattr(step_boxes, "choose_quantization", lambda *a: chosen.append(a) or choose_quantization(*a))
    plate = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    bodies = [(plate, [[0, 1, 2], [0, 2, 3]]), (0.1 * TETRAHEDRON[0] + [0, 0, 0.5], TETRAHEDRON[1])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0])
    pipeline, end = ccd.CollisionPipeline(mesh), mesh.vertices - [[0, 0, 1]] * (mesh.vertex_body == 1)[:, None]
    for _ in range(20):
        pipeline.collision_free_step(mesh.vertices, end)
    assert 0 < len(chosen) <= 4


def test_boxes_of_static_bodies_are_made_once():
    rng = np.random.default_rng(8)
    mesh = ccd.CollisionMesh.from_arrays([soup(rng, 50, 0.1), soup(rng, 300, 0.1)], static=[1])
    static = sum((body == 1).sum() for body in (mesh.vertex_body, mesh.edge_body, mesh.face_body))
    every, moves = mesh.num_vertices + mesh.num_edges + mesh.num_faces, (mesh.vertex_body == 0)[:, None]
    pipeline = ccd.CollisionPipeline(mesh)
    for k in range(3):
        start = mesh.vertices + 0.001 * k * moves
        assert pipeline.mesh_ccd(start, start + 0.01 * moves).counts.num_boxes == (every - static if k else every)
    start = mesh.vertices + 1e-3  # the static body was moved between two steps
    assert pipeline.mesh_ccd(start, start).counts.num_boxes == every


def test_bodies_that_nothing_comes_near_have_no_boxes_that_count_and_trees_apart_are_not_searched():
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.4)
    places = np.arange(12)[:, None] * [3.0, 0, 0]
    places[7] = places[6] + [0.9, 0, 0]
    bodies = [(ball.vertices + place, ball.faces) for place in places]
    with_all, mesh = (ccd.CollisionMesh.from_arrays(bodies, self_collision=itself) for itself in (True, False))
    end = mesh.vertices - [0, 0, 0.5] - [0.5, 0, 0] * (mesh.vertex_body == 7)[:, None]
    result, other = (ccd.mesh_ccd(each, each.vertices, end) for each in (mesh, with_all))
    assert result.counts.num_active_bodies == 2 and other.counts.num_active_bodies == 12
    assert np.flatnonzero(np.isfinite(result.body_toi)).tolist() == [6, 7] and other.toi == result.toi
    assert other.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > result.counts.num_candidates[ccd.PairKind.EDGE_EDGE]
    mesh = ccd.CollisionMesh.from_arrays([bodies[0], bodies[2]], static=[1], self_collision=False)
    pipeline = ccd.CollisionPipeline(mesh)
    for motion, is_free in (([0, 1.0, 0], True), ([5.5, 0, 0], False)):
        end = mesh.vertices + (mesh.vertex_body == 0)[:, None] * motion
        assert (pipeline.collision_free_step(mesh.vertices, end) == 1.0) == is_free
        assert pipeline.counts.num_active_bodies == 2 - is_free  # one that is static has boxes all the same
        assert any(pipeline.counts.num_searches.values()) == (not is_free)


# --- memory and threads ---


def test_least_memory_limit_that_is_named_works_and_one_byte_less_does_not():
    # bodies that stay far apart, and many pairs, whose least is enough for all calls by a law
    bodies = [(TRIANGLE, FACE), (TRIANGLE + [50.0, 0, 9], FACE)]
    far = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    for mesh, start, end in ((far, far.vertices, far.vertices + 1.0), leaning_stack(300)):
        for call in (ccd.mesh_ccd, ccd.collision_free_step):
            least = 1
            for _ in range(2):
                with pytest.raises(ValueError, match=rf"memory_limit is {least} bytes; expected at least \d+") as error:
                    call(mesh, start, end, memory_limit=least)
                least = least_bytes(error) - 1
            assert least_bytes(error) == least + 1 >= 100_000
            call(mesh, start, end, memory_limit=least + 1)
    # of 150 faces in one point, whose contacts alone exceed it
    mesh, start = single(*soup(np.random.default_rng(10), 150, 0.0)), np.zeros((450, 3))
    options = {"memory_limit": 3 << 20, "num_threads": 1}
    with pytest.raises(ValueError, match="contacts of this step, or collision_free_step") as error:
        ccd.mesh_ccd(mesh, start, start, **options)
    assert ccd.collision_free_step(mesh, start, start, **options) == 0.0
    result = ccd.mesh_ccd(mesh, start, start, **options | {"memory_limit": least_bytes(error)})
    assert len(result.contacts) == 450 * 149 + 450 * 449 // 2 - 450


@requires_status
@pytest.mark.filterwarnings("ignore:[0-9,]* pairs of:RuntimeWarning")
def test_stack_of_faces_within_little_memory():
    """Over 13 million pairs of overlapping boxes: batches, and a peak that the limit bounds."""
    scene = leaning_stack(1_500, 1e-5)
    with wp.ScopedDevice("cpu"):
        ccd.mesh_ccd(*leaning_stack(50))  # kernels are loaded
        before = held_bytes()
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak so far is forgotten
        result = ccd.mesh_ccd(*scene, memory_limit=64 << 20)
    # of the 3 n (n - 1) and 9/2 n (n - 1) pairs of swept boxes, those whose boxes at the ends overlap as well
    assert result.toi == np.inf and sum(result.counts.num_candidates.values()) == 6 * 1_500 * 1_499
    assert held_bytes("VmHWM") - before <= 64 << 20


def test_steps_of_a_size_that_was_seen_allocate_nothing():
    mesh, start, end = crowd(np.random.default_rng(11), 2000, 0.05)
    pipeline, num_allocations = ccd.CollisionPipeline(mesh), []
    for _ in range(5):  # the first finds out how much capacity the pairs need
        for name in STEPS:
            getattr(pipeline, name)(start, end)
        num_allocations.append(pipeline._workspace.buffers.num_allocations)
    assert len({*num_allocations[1:]}) == 1 and num_allocations[0] > 5


@pytest.mark.parametrize("call", STEPS)
def test_positions_of_a_large_mesh_are_let_go(call):
    """Those of more than 2¹⁵ vertices are read where they are."""
    mesh = ccd.CollisionMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=6))
    pipeline, start, end = ccd.CollisionPipeline(mesh), mesh.vertices.copy(), mesh.vertices + 1e-3
    arrays = weakref.ref(start), weakref.ref(end)
    getattr(pipeline, call)(start, end)
    del start, end
    assert mesh.num_vertices > 1 << 15 and [array() for array in arrays] == [None, None]


# --- scenes made to break a broad phase ---


def test_identical_faces_stacked_10_000_times_touch_at_once():
    assert ccd.collision_free_step(*leaning_stack(10_000, 0.0), memory_limit=256 << 20) == 0.0


def test_ten_faces_against_half_a_million():
    """A small tetrahedron comes down on a sheet of half a million faces, whose waves it meets at a known height."""
    waves, faces = sheet(520, 520.0)
    waves[:, 2] = 0.5 * (waves[:, :2].sum(axis=1) % 2)
    tip = np.array([[240.0, 241, 2.5], [240.5, 241, 3.5], [239.5, 241.5, 3.5], [239.5, 240.5, 3.5]])
    mesh = ccd.CollisionMesh.from_arrays([(waves, faces), (tip, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])])
    frames = mesh, mesh.vertices, mesh.vertices - np.where(mesh.vertex_body == 1, 4.0, 0.0)[:, None] * [0, 0, 1]
    result = ccd.mesh_ccd(*frames)
    # the tip stands over a crest at height 1/2
    assert 0.5 - 1e-9 <= result.toi <= 0.5 and 0.5 - 1e-9 < ccd.collision_free_step(*frames) <= 0.5
    assert np.isfinite(result.body_toi).all() and 0 < len(result.contacts) < 500


@pytest.mark.parametrize("call", [ccd.mesh_ccd, ccd.collision_free_step])
def test_positions_whose_differences_overflow_are_answered_as_smaller_ones(call):
    """Of two spheres whose vertices move at random all pairs are open: none reaches a limit of work."""
    ball, apart = trimesh.creation.icosphere(2), np.array([0.55, 0, 0])
    end = np.random.default_rng(1).uniform(-1, 1, (2 * len(ball.vertices), 3))
    found = []
    for scale in (1e300, 1.7e308):
        spheres = [(scale * (0.4 * ball.vertices + side * apart), ball.faces) for side in (-1, 1)]
        mesh = ccd.CollisionMesh.from_arrays(spheres)
        found.append(call(mesh, mesh.vertices, scale * end))
    if call is ccd.collision_free_step:
        assert found[1] == pytest.approx(found[0], rel=1e-9) and found[0] > 0
    else:
        small, large = (result.contacts for result in found)
        assert len(small) > 10_000 and large.status.max() < ccd.CCDStatus.ITERATION_LIMIT
        assert np.array_equal(small.primitives, large.primitives)
        assert np.abs(small.toi - large.toi).max() < 1e-5
