"""Whole steps: what is left out, batches under a memory limit, threads, and scenes made to break a broad phase."""

import os
import re
import subprocess
import sys
import textwrap
import threading
import weakref

import numpy as np
import pytest
import scenes
import trimesh
from exact import exact_tois
from expected_warnings import OF_ROUNDING
from hard_cases import FAMILIES
from oracles import brute_force, check_candidates, corners_of
from scenes import crowd, leaning_stack, single, soup, with_static_at_rest

import ccd_warp as ccd

pytestmark = OF_ROUNDING

FIELDS = ("kind", "primitives", "toi", "parameters", "normal", "status", "gap", "width")


def check_contacts(mesh, start, end, **options):
    """Contacts are the candidates that the narrow phase alone gives a finite toi, but for some that are certainly free.

    Returns the result. The exact oracle decides on those that the boxes of the ends or the cull left out.
    """
    result = ccd.mesh_ccd(mesh, start, end, **options)
    step = ccd.collision_free_step(mesh, start, end, **options)
    candidates = ccd.find_candidates(mesh, start, end)
    frames = mesh.frames(start, end)
    scale = mesh.length_scale
    least = np.inf
    for kind, solve, pairs, name in (
        (ccd.PairKind.VERTEX_FACE, ccd.vertex_face_ccd, candidates.vertex_face, "vertex-face"),
        (ccd.PairKind.EDGE_EDGE, ccd.edge_edge_ccd, candidates.edge_edge, "edge-edge"),
    ):
        corners = corners_of(mesh, kind, pairs)
        alone = solve(*(frame[corners] for frame in frames), length_scale=scale)
        ours = result.contacts.kind == kind
        found = {
            tuple(pair): toi
            for pair, toi in zip(result.contacts.primitives[ours].tolist(), result.contacts.toi[ours], strict=True)
        }
        left_out = []
        for k in np.flatnonzero(alone.hit):
            toi = found.pop(tuple(pairs[k].tolist()), None)
            if toi is None:
                left_out.append(k)
            else:
                assert toi == alone.toi[k]
                least = min(least, toi)
        assert not found
        exact = exact_tois(name, *(frame[corners[left_out]] for frame in frames)) if left_out else []
        assert not any(truth.hit for truth in exact)
    assert result.toi == least
    # the step's bound leaves out pairs that are free up to it, and only those
    assert step <= min(least, 1.0) and step >= min(least, 1.0) - 1e-6
    check_minima(mesh, result)
    return result


def check_minima(mesh, result):
    """Toi of vertices and bodies, and the contacts they belong to, recomputed from the contacts."""
    contacts = result.contacts
    vertex = np.full(mesh.num_vertices, np.inf)
    body = np.full(mesh.num_bodies, np.inf)
    first = np.full(mesh.num_vertices, -1)
    for k in range(len(contacts)):
        for v in corners_of(mesh, contacts.kind[k], contacts.primitives[k : k + 1])[0]:
            if contacts.toi[k] < vertex[v]:
                vertex[v], first[v] = contacts.toi[k], k
            body[mesh.vertex_body[v]] = min(body[mesh.vertex_body[v]], contacts.toi[k])
    assert np.array_equal(vertex, result.vertex_toi) and np.array_equal(body, result.body_toi)
    assert np.array_equal(first, result.vertex_contact)
    for b in range(mesh.num_bodies):
        assert (result.body_contact[b] < 0) == np.isinf(body[b])
        assert result.body_contact[b] < 0 or contacts.toi[result.body_contact[b]] == body[b]
    order = np.lexsort((*contacts.primitives.T[::-1], contacts.kind))
    assert np.array_equal(order, np.arange(len(contacts)))


def as_bytes(result):
    arrays = [getattr(result.contacts, name) for name in FIELDS]
    arrays += [result.vertex_toi, result.body_toi, result.vertex_contact, result.body_contact]
    return b"".join(array.tobytes() for array in arrays)


def least_bytes(error):
    return int(re.search(r"expected at least (\d+)", str(error.value)).group(1))


# --- against the narrow phase alone and the oracle ---


@pytest.mark.parametrize("seed", range(3))
def test_crowd(seed):
    result = check_contacts(*crowd(np.random.default_rng(seed)))
    assert len(result.contacts) > 20


def test_crowd_that_moves_far_together():
    mesh, start, end = crowd(np.random.default_rng(3))
    assert len(check_contacts(mesh, start, end + [5.0, -3.0, 2.0]).contacts) > 20


@pytest.mark.parametrize("t_max", [0.0, 0.3, 1.0])
def test_part_of_a_step_is_the_whole_of_it_up_to_there(t_max):
    mesh, start, end = crowd(np.random.default_rng(4))
    whole = ccd.mesh_ccd(mesh, start, end)
    part = ccd.mesh_ccd(mesh, start, end, t_max=t_max)
    early = whole.contacts.toi <= t_max
    assert np.array_equal(part.contacts.primitives, whole.contacts.primitives[early])
    assert part.contacts.toi == pytest.approx(whole.contacts.toi[early], abs=1e-9)
    assert ccd.collision_free_step(mesh, start, end, t_max=t_max) <= min(whole.toi, t_max)


def test_minimum_separation_reaches_beyond_the_boxes():
    mesh, start, end = crowd(np.random.default_rng(5), 150, 0.03, 0.02)
    options = {"minimum_separation": 0.03, "length_scale": 1.0}
    result = ccd.mesh_ccd(mesh, start, end, **options)
    every = np.array([(v, f) for v in range(mesh.num_vertices) for f in range(mesh.num_faces)])
    every = every[~(mesh.faces[every[:, 1]] == every[:, :1]).any(axis=1)]
    corners = corners_of(mesh, ccd.PairKind.VERTEX_FACE, every)
    alone = ccd.vertex_face_ccd(start[corners], end[corners], **options)
    ours = result.contacts.primitives[result.contacts.kind == ccd.PairKind.VERTEX_FACE]
    assert len(ours) > 100 and np.array_equal(ours, every[alone.hit])


@pytest.mark.parametrize("seed", range(3))
def test_crowd_on_a_lattice_touches_at_ties(seed):
    """Boxes that only touch, at both ends and in quantized coordinates, may contain contacts."""
    rng = np.random.default_rng(100 + seed)
    start = rng.integers(0, 8, (90, 3)).astype(np.float64)
    end = start + rng.integers(-1, 2, (90, 3)) * rng.integers(0, 2, (90, 1))
    assert len(check_contacts(single(start, np.arange(90).reshape(-1, 3)), start, end).contacts) > 50


@pytest.mark.parametrize("kind", ["vertex-face", "edge-edge"])
@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_hard_pairs_in_one_mesh_are_all_found(family, kind):
    """Queries of every hard family side by side, of whatever scales: no box and no cull may lose one."""
    count = 40
    points_t0, points_t1 = FAMILIES[family](kind, count, np.random.default_rng(21))
    first = np.arange(count) * 4
    face = [0, 1, 1] if kind == "edge-edge" else [1, 2, 3]
    faces = first[:, None] + np.array(face)
    if kind == "edge-edge":
        faces = np.concatenate([faces, first[:, None] + np.array([2, 3, 3])])
    start, end = points_t0.reshape(-1, 3), points_t1.reshape(-1, 3)
    mesh = ccd.CollisionMesh.from_arrays([(start, faces)], codimensional_points=kind == "vertex-face")
    length_scale = 1e-300  # the tolerance is out of the way
    result = ccd.mesh_ccd(mesh, start, end, length_scale=length_scale)
    step = ccd.collision_free_step(mesh, start, end, length_scale=length_scale)
    wanted = ccd.PairKind[kind.replace("-", "_").upper()]
    toi = {
        tuple(sorted(corners_of(mesh, wanted, pair[None])[0].tolist())): t
        for pair, t in zip(
            result.contacts.primitives[result.contacts.kind == wanted],
            result.contacts.toi[result.contacts.kind == wanted],
            strict=True,
        )
    }
    for k, truth in enumerate(exact_tois(kind, points_t0, points_t1)):
        corners = tuple(range(4 * k, 4 * k + 4))
        if truth.hit:
            assert corners in toi and not truth.late(toi[corners])
            assert not truth.late(step)


# --- what is left out ---


def test_body_pairs_and_rings_against_brute_force(device):
    rng = np.random.default_rng(6)
    bodies = [soup(rng, n, size, num_vertices=60) for n, size in ((60, 0.1), (40, 0.1), (50, 0.4))]
    allowed = np.ones((3, 3), dtype=bool)
    allowed[0, 2] = allowed[2, 0] = False
    for self_collision in (True, False, [True, False, True]):
        mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=self_collision, body_pairs=allowed)
        start, end = mesh.vertices, mesh.vertices + 0.1
        found = ccd.find_candidates(mesh, start, end, device=device).sorted()
        everything = ccd.CollisionMesh.from_arrays(bodies, self_collision=self_collision)
        vertex_face, edge_edge, *_ = brute_force(everything, start, end)
        body = mesh.vertex_body
        expected = [(v, f) for v, f in vertex_face if {body[v], mesh.face_body[f]} != {0, 2}]
        assert found.vertex_face.tolist() == [list(pair) for pair in expected] and len(expected) < len(vertex_face)
        expected = [(a, b) for a, b in edge_edge if {mesh.edge_body[a], mesh.edge_body[b]} != {0, 2}]
        assert found.edge_edge.tolist() == [list(pair) for pair in expected] and len(expected) < len(edge_edge)


@pytest.mark.parametrize("rings", [1, 2, 3])
def test_rings_leave_out_neighbours(rings):
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = ccd.CollisionMesh.from_arrays([(ball.vertices, ball.faces)], exclusion_rings=rings)
    start = np.array(ball.vertices)
    found = ccd.find_candidates(mesh, start, start, inflation=0.2).sorted()
    near = np.eye(mesh.num_vertices, dtype=bool)
    joined = near.copy()
    joined[mesh.edges[:, 0], mesh.edges[:, 1]] = joined[mesh.edges[:, 1], mesh.edges[:, 0]] = True
    for _ in range(rings - 1):
        near = near @ joined
    _, edge_edge, *_ = brute_force(mesh, start, start, 0.2)
    expected = [(a, b) for a, b in edge_edge if not near[np.ix_(mesh.edges[a], mesh.edges[b])].any()]
    assert found.edge_edge.tolist() == [list(pair) for pair in expected]
    assert len(expected) < len(edge_edge) or rings == 1


def test_kinds_that_are_not_asked_for_are_not_searched():
    mesh, start, end = crowd(np.random.default_rng(7))
    whole = ccd.mesh_ccd(mesh, start, end)
    for kind in (ccd.PairKind.VERTEX_FACE, ccd.PairKind.EDGE_EDGE):
        pipeline = ccd.CollisionPipeline(mesh, pair_kinds=[kind.name.lower()])
        result = pipeline.mesh_ccd(start, end)
        assert set(result.contacts.kind.tolist()) == {kind}
        assert np.array_equal(result.contacts.toi, whole.contacts.toi[whole.contacts.kind == kind])
        assert pipeline.counts.num_searches.keys() == {kind} and pipeline.counts.num_searches[kind] > 0
        # faces have no boxes where edges alone are asked for, nor edges where faces are
        count = mesh.num_edges if kind == ccd.PairKind.EDGE_EDGE else mesh.num_vertices + mesh.num_faces
        assert result.counts.num_boxes == count


def test_boxes_of_static_bodies_are_made_once():
    rng = np.random.default_rng(8)
    mesh = ccd.CollisionMesh.from_arrays([soup(rng, 50, 0.1), soup(rng, 300, 0.1)], static=[1])
    static = (mesh.vertex_body == 1).sum() + (mesh.edge_body == 1).sum() + (mesh.face_body == 1).sum()
    every = mesh.num_vertices + mesh.num_edges + mesh.num_faces
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0)
    counts = []
    for k in range(4):
        start = mesh.vertices + 0.001 * k * (mesh.vertex_body == 0)[:, None]
        end = with_static_at_rest(mesh, start, start + 0.01)
        result = pipeline.mesh_ccd(start, end)
        counts.append(result.counts.num_boxes)
        assert as_bytes(result) == as_bytes(ccd.mesh_ccd(mesh, start, end, length_scale=1.0, num_threads=1))
    assert counts == [every, every - static, every - static, every - static]
    start = mesh.vertices + 1e-3  # the static body was moved between two steps
    assert pipeline.mesh_ccd(start, start).counts.num_boxes == every
    check_candidates(mesh, start, with_static_at_rest(mesh, start, start + 0.1))


def test_bodies_that_nothing_comes_near_have_no_boxes_that_count():
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.4)
    places = np.arange(12)[:, None] * [3.0, 0, 0]
    places[7] = places[6] + [0.9, 0, 0]
    bodies = [(ball.vertices + place, ball.faces) for place in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    start = mesh.vertices
    end = start - [0, 0, 0.5]
    end[mesh.vertex_body == 7] -= [0.5, 0, 0]
    pipeline = ccd.CollisionPipeline(mesh)
    result = pipeline.mesh_ccd(start, end)
    assert result.counts.num_active_bodies == 2
    assert np.flatnonzero(np.isfinite(result.body_toi)).tolist() == [6, 7]
    with_all = ccd.CollisionMesh.from_arrays(bodies)
    other = ccd.mesh_ccd(with_all, start, end)
    assert other.counts.num_active_bodies == 12 and other.toi == result.toi
    assert other.counts.num_candidates[ccd.PairKind.EDGE_EDGE] > result.counts.num_candidates[ccd.PairKind.EDGE_EDGE]


def test_trees_that_do_not_meet_are_not_searched():
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball], static=[1], self_collision=False)
    start = mesh.vertices + (mesh.vertex_body == 0)[:, None] * [5.0, 0, 0]
    pipeline = ccd.CollisionPipeline(mesh)
    moves = (mesh.vertex_body == 0)[:, None]
    assert pipeline.collision_free_step(start, start + [0, 1.0, 0] * moves) == 1.0
    assert not any(pipeline.counts.num_searches.values())
    assert pipeline.collision_free_step(start, start - [3.5, 0, 0] * moves) < 1.0
    assert any(pipeline.counts.num_searches.values())


# --- memory, determinism, threads ---


def test_least_memory_limit_that_is_named_works():
    mesh, start, end = leaning_stack(300)
    for call in (ccd.mesh_ccd, ccd.collision_free_step):
        with pytest.raises(ValueError, match="memory_limit is 10000 bytes; expected at least") as error:
            call(mesh, start, end, memory_limit=10_000)
        least = least_bytes(error)
        call(mesh, start, end, memory_limit=least)
        with pytest.raises(ValueError, match="expected at least"):
            call(mesh, start, end, memory_limit=least - 1)


def test_kind_without_pairs_needs_no_memory():
    """All pairs fit the limit, though not as they were divided among the kinds before, and one kind has none."""
    excluded = {"vertex_face": [[0, 1], [2, 20], [5, 9]], "edge_edge": [[0, 9], [3, 40]], "bodies": [[0, 0]]}
    rng, count = np.random.default_rng(5), 1_800
    edges = np.stack([np.arange(0, 30, 3), np.arange(4, 34, 3)], axis=1)
    faces = np.arange(count).reshape(-1, 3) % (count - 9)
    places = [np.repeat(rng.random((600, 3)), 3, axis=0) + 0.08 * rng.standard_normal((count, 3)) for _ in range(2)]
    bodies = [(at, faces, edges) for at in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, exclude_pairs=excluded)
    frames = mesh.vertices, mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)
    limited = ccd.mesh_ccd(mesh, *frames, memory_limit=16 << 20)  # first, while nothing is allocated
    expected = ccd.mesh_ccd(mesh, *frames)
    assert expected.counts.num_after_cull[ccd.PairKind.POINT_POINT] == 0
    np.testing.assert_array_equal(limited.vertex_toi, expected.vertex_toi)
    np.testing.assert_array_equal(limited.contacts.primitives, expected.contacts.primitives)


def test_contacts_beyond_the_memory_limit_are_an_error_that_names_one_that_works():
    start, faces = soup(np.random.default_rng(10), 150, 0.0)
    mesh = single(start, faces)
    start = np.zeros_like(start)
    options = {"memory_limit": 3 << 20, "num_threads": 1}
    with pytest.raises(ValueError, match="contacts of this step, or collision_free_step") as error:
        ccd.mesh_ccd(mesh, start, start, **options)
    assert ccd.collision_free_step(mesh, start, start, **options) == 0.0
    options["memory_limit"] = least_bytes(error)
    result = ccd.mesh_ccd(mesh, start, start, **options)
    assert len(result.contacts) == 450 * 149 + 450 * 449 // 2 - 450


@pytest.mark.skipif(not os.access("/proc/self/clear_refs", os.W_OK), reason="the peak of memory cannot be reset here")
def test_stack_of_faces_within_little_memory():
    """Over 13 million pairs of overlapping boxes: batches, and a peak that the limit bounds."""
    script = f"""
        import sys
        sys.path.insert(0, {os.path.dirname(scenes.__file__)!r})
        import ccd_warp as ccd
        from scenes import leaning_stack

        mesh, start, end = leaning_stack(1_500, 1e-5)
        few, few_start, few_end = leaning_stack(50)
        ccd.mesh_ccd(few, few_start, few_end)  # kernels are loaded

        def kilobytes(name):
            return int(next(line.split()[1] for line in open("/proc/self/status") if line.startswith(name)))

        open("/proc/self/clear_refs", "w").write("5")  # the peak so far is forgotten
        before = kilobytes("VmRSS")
        result = ccd.mesh_ccd(mesh, start, end, memory_limit=64 << 20)
        peak = kilobytes("VmHWM")
        pairs = sum(result.counts.num_candidates.values())
        print(result.toi, pairs, (peak - before) * 1024)
    """
    out = subprocess.run(
        [sys.executable, "-P", "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True
    ).stdout.split()
    toi, pairs, grown = float(out[-3]), int(out[-2]), int(out[-1])
    assert toi == np.inf
    # of the 3 n (n - 1) and 9/2 n (n - 1) pairs of swept boxes, those whose boxes at the ends overlap as well
    assert pairs == 6 * 1_500 * 1_499
    assert grown <= 64 << 20


def test_identical_faces_stacked_10_000_times_touch_at_once():
    mesh, start, end = leaning_stack(10_000, 0.0)
    assert ccd.collision_free_step(mesh, start, end, memory_limit=256 << 20) == 0.0


def test_steps_of_a_size_that_was_seen_allocate_nothing():
    mesh, start, end = crowd(np.random.default_rng(11), 2000, 0.05)
    pipeline = ccd.CollisionPipeline(mesh)
    for _ in range(2):  # the first finds out how much capacity the pairs need
        for call in (pipeline.mesh_ccd, pipeline.collision_free_step, pipeline.find_candidates):
            call(start, end)
    before = pipeline.num_allocations
    for _ in range(3):
        for call in (pipeline.mesh_ccd, pipeline.collision_free_step, pipeline.find_candidates):
            call(start, end)
    assert pipeline.num_allocations == before
    assert before > 5


def test_python_threads_on_different_meshes_and_on_one():
    scenes = [crowd(np.random.default_rng(k), 300) for k in range(3)]
    scenes.append(scenes[0])  # the same mesh twice
    expected = [as_bytes(ccd.mesh_ccd(*scene)) for scene in scenes]
    steps = [ccd.collision_free_step(*scene) for scene in scenes]
    pipeline = ccd.CollisionPipeline(scenes[0][0])
    faults = []

    def work(k):
        for _ in range(5):
            if as_bytes(ccd.mesh_ccd(*scenes[k])) != expected[k] or ccd.collision_free_step(*scenes[k]) != steps[k]:
                faults.append(k)
            if k in (0, 3) and as_bytes(pipeline.mesh_ccd(*scenes[k][1:])) != expected[k]:
                faults.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(scenes))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults


# --- scenes made to break a broad phase ---


def test_vertex_that_flies_a_million_scenes_away():
    mesh, start, end = crowd(np.random.default_rng(13))
    end[5] = start[5] + [1e6, 2e6, -1e6]
    assert len(check_contacts(mesh, start, end).contacts) > 20


def test_crowd_at_an_offset_of_1e7():
    mesh, start, end = crowd(np.random.default_rng(14))
    assert len(check_contacts(mesh, start + 1e7, end + 1e7).contacts) > 20


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_flat_crowd(axis):
    mesh, start, end = crowd(np.random.default_rng(15), 60)
    start[:, axis] = end[:, axis] = 0.25
    assert len(check_contacts(mesh, start, end).contacts) > 20


def test_all_in_one_place():
    mesh, start, end = crowd(np.random.default_rng(16), 40, 0.5, 0.5)
    assert len(check_contacts(mesh, start * 1e-3, end * 1e-3).contacts) > 100


def test_needles_and_faces_without_area():
    rng = np.random.default_rng(17)
    start, faces = soup(rng, 300, 0.1)
    start[2::6] = start[0::6] + 1e-9 * rng.standard_normal(start[2::6].shape)  # needles
    start[5::12] = start[4::12]  # a side of length zero
    start[8::24] = start[7::24] = start[6::24]  # points
    mesh = single(start, faces)
    assert len(check_contacts(mesh, start, start + 0.1 * rng.standard_normal(start.shape)).contacts) > 20


def test_body_inside_another_breaks_out():
    inner, outer = trimesh.creation.icosphere(radius=0.5), trimesh.creation.icosphere(radius=1.0)
    mesh = ccd.CollisionMesh.from_trimesh([inner, outer], static=[1])
    start = mesh.vertices
    assert check_contacts(mesh, start, with_static_at_rest(mesh, start, start * 2.5)).toi < 1.0
    assert ccd.collision_free_step(mesh, start, with_static_at_rest(mesh, start, start * 1.9)) == 1.0


def test_ten_faces_against_half_a_million():
    """A small tetrahedron comes down on a sheet of half a million faces, whose waves it meets at a known height."""
    n = 521
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float), indexing="ij")
    sheet = np.stack([x.ravel(), y.ravel(), 0.5 * ((x + y).ravel() % 2)], axis=1)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner.ravel() for corner in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    tip = np.array([[500.0, 501, 2.5], [500.5, 501, 3.5], [499.5, 501.5, 3.5], [499.5, 500.5, 3.5]])
    tip_faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
    mesh = ccd.CollisionMesh.from_arrays([(sheet, faces), (tip, tip_faces)])
    start = mesh.vertices
    end = start - np.where(mesh.vertex_body == 1, 4.0, 0.0)[:, None] * [0, 0, 1]
    result = ccd.mesh_ccd(mesh, start, end)
    # the tip stands over a crest at height 1/2
    assert result.toi == pytest.approx(0.5, abs=1e-9) and result.toi <= 0.5
    assert np.isfinite(result.body_toi).all() and 0 < len(result.contacts) < 500
    assert 0.5 - 1e-9 < ccd.collision_free_step(mesh, start, end) <= 0.5


def test_ten_faces_and_empty_bodies():
    rng = np.random.default_rng(18)
    empty = (np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    start, faces = soup(rng, 10, 0.3)
    mesh = ccd.CollisionMesh.from_arrays([empty, (start, faces), empty], self_collision=[False, True, False])
    check_contacts(mesh, start, start + 0.3 * rng.standard_normal(start.shape))


def test_duplicate_faces_and_edges_of_many_faces():
    rng = np.random.default_rng(19)
    start, faces = soup(rng, 80, 0.2, num_vertices=90)
    fans = [[0, 1, k] for k in range(2, 30)]
    mesh = single(start, np.concatenate([faces, faces[:30], fans]))
    assert len(check_contacts(mesh, start, start + 0.1 * rng.standard_normal(start.shape)).contacts) > 20


def test_shuffled_mesh_is_sorted_by_place():
    """A mesh that is built of other positions than those of the step: only the order is computed again."""
    rng = np.random.default_rng(20)
    sheet = trimesh.creation.box().subdivide_loop(iterations=4)
    mesh = ccd.CollisionMesh.from_arrays([(rng.random(sheet.vertices.shape), sheet.faces)])
    start = np.array(sheet.vertices)
    result = ccd.mesh_ccd(mesh, start, start * 1.1)
    assert result.counts.num_sorted_sets == 3
    told = ccd.CollisionMesh.from_arrays([(start, sheet.faces)])
    other = ccd.mesh_ccd(told, start, start * 1.1)
    assert other.counts.num_sorted_sets == 0
    assert as_bytes(result) == as_bytes(other)
    assert result.counts.num_candidates == other.counts.num_candidates


@pytest.mark.parametrize("call", ["mesh_ccd", "collision_free_step", "find_candidates"])
def test_positions_of_a_large_mesh_are_let_go(call):
    """Those of more than 2¹⁵ vertices are read where they are."""
    mesh = ccd.CollisionMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=6))
    assert mesh.num_vertices > 1 << 15
    pipeline = ccd.CollisionPipeline(mesh)
    start, end = mesh.vertices.copy(), mesh.vertices + 1e-3
    arrays = weakref.ref(start), weakref.ref(end)
    getattr(pipeline, call)(start, end)
    del start, end
    assert [array() for array in arrays] == [None, None]


def test_bodies_that_stay_far_apart_have_the_stages_and_the_least_memory_of_others():
    triangle, face = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]
    bodies = [(triangle, face), (triangle + [50.0, 0, 9], face)]
    pipeline = ccd.CollisionPipeline(ccd.CollisionMesh.from_arrays(bodies, self_collision=False), device="cpu")
    far = pipeline.mesh.vertices
    near = far - [49.5, 0, 9] * (pipeline.mesh.vertex_body == 1)[:, None]
    for call in (pipeline.mesh_ccd, pipeline.collision_free_step):
        stages = []
        for end in (far, near):
            call(far, end)
            stages.append(pipeline.timings.keys())
        assert stages[0] == stages[1]
    for call in (ccd.mesh_ccd, ccd.collision_free_step):
        with pytest.raises(ValueError, match=r"memory_limit is 1 bytes; expected at least \d{6}"):
            call(pipeline.mesh, far, far + 1.0, memory_limit=1)
