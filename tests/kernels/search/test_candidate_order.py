"""The order of candidates is that of the mesh and the frames, whatever threads, limits and calls before find them."""

import re

import numpy as np
import pytest
import trimesh
from scenes import soup, with_static_at_rest

import ccd_warp as ccd
from ccd_warp import CollisionMesh, CollisionPipeline, PairKind, find_candidates

NAMES = ("vertex_face", "edge_edge", "point_segment", "point_point")


def three_bodies(rng, **options):
    """Three bodies in one place, moved."""
    mesh = CollisionMesh.from_arrays([soup(rng, n, 0.1) for n in (900, 300, 600)], **options)
    end = mesh.vertices + 0.05 * rng.standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, end)


def worlds(rng):
    """Six worlds in one place."""
    bodies = [soup(rng, 60, 0.2) for _ in range(6)]
    mesh = CollisionMesh.from_arrays(bodies, vertex_world=np.repeat(np.arange(6), 180))
    return mesh, mesh.vertices, mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)


def rings(rng):
    """A ball that shrinks, whose close neighbours are left out."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = CollisionMesh.from_arrays([(ball.vertices, ball.faces)], exclusion_rings=2)
    return mesh, mesh.vertices, 0.7 * mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)


def body_pairs(rng):
    """Three bodies, two of which ignore each other."""
    allowed = np.ones((3, 3), dtype=bool)
    allowed[0, 2] = allowed[2, 0] = False
    return three_bodies(rng, body_pairs=allowed)


def one_place(rng, num_faces=60, num_particles=200):
    """All boxes hold the origin, those of a moving body, a static body, cables and particles."""
    bodies = [(*soup(rng, num_faces, 0.2, spread=0.0), []) for _ in range(2)]
    particles = 0.01 * rng.standard_normal((num_particles, 3))
    cables = np.arange(num_particles // 2).reshape(-1, 2)
    mesh = CollisionMesh.from_arrays([*bodies, (particles, [], cables)], static=[0], codimensional_points=True)
    return mesh, mesh.vertices, with_static_at_rest(mesh, mesh.vertices, -mesh.vertices)


SCENES = {
    "three bodies": three_bodies,
    "static": lambda rng: three_bodies(rng, static=[1]),
    "rigid": lambda rng: three_bodies(rng, self_collision=False),
    "worlds": worlds,
    "rings": rings,
    "body pairs": body_pairs,
    "one place": one_place,
}


def assert_same(found, expected):
    for name in NAMES:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def least_limit(mesh, frames, inflation, num_threads):
    """The smallest memory limit with which the search of a scene runs."""
    with pytest.raises(ValueError, match="memory_limit is 1 bytes; expected at least") as error:
        CollisionPipeline(mesh, memory_limit=1, num_threads=num_threads).find_candidates(*frames, inflation)
    return int(re.search(r"at least (\d+)", str(error.value)).group(1))


@pytest.mark.parametrize("inflation", [0.0, 0.02])
@pytest.mark.parametrize("scene", SCENES)
def test_neither_threads_nor_memory_limit_nor_repetition(device, scene, inflation):
    mesh, *frames = SCENES[scene](np.random.default_rng(1))
    expected = find_candidates(mesh, *frames, inflation, device=device, num_threads=1)
    assert len(expected.edge_edge) > 1000
    # of a limit, how much is above the least in eighths of it
    for num_threads, spare in ((1, 0), (2, None), (3, 1), (4, 0)):
        limit = None
        if spare is not None:
            limit = least_limit(mesh, frames, inflation, num_threads)
            limit += spare * (limit >> 3)
        pipeline = CollisionPipeline(mesh, device=device, num_threads=num_threads, memory_limit=limit)
        for _ in range(2):
            assert_same(pipeline.find_candidates(*frames, inflation), expected)


def test_blocks_of_boxes_that_exceed_the_memory_limit(device):
    """The least limit holds the partners of one box a thread; a block of sixteen, which have more, is cut."""
    mesh, *frames = one_place(np.random.default_rng(2), 280, 900)
    expected = find_candidates(mesh, *frames, device=device, num_threads=1)
    for num_threads in (1, 3):
        limit = least_limit(mesh, frames, 0.0, num_threads)
        pipeline = CollisionPipeline(mesh, device=device, memory_limit=limit, num_threads=num_threads)
        assert_same(pipeline.find_candidates(*frames), expected)
        assert pipeline.counts.num_batches > 10
        if device == "cpu":  # a block that is not cut takes a launch at most
            for kind, queries in (("EDGE_EDGE", 1900), ("POINT_POINT", 450), ("VERTEX_FACE", 2600)):
                assert pipeline.counts.num_searches[PairKind[kind]] > queries // 16


def test_static_bodies_whose_boxes_an_earlier_step_has_made(device):
    """Static bodies keep their boxes while others move far in one step and little in the next."""
    rng = np.random.default_rng(3)
    still, faces = soup(rng, 600, 0.03, spread=1.4)
    moving, moving_faces = soup(rng, 600, 0.03, spread=1.4)
    mesh = CollisionMesh.from_arrays([(moving, moving_faces), (still, faces)], static=[1])
    start = mesh.vertices.copy()
    start[1800:] = still.reshape(-1, 3, 3)[rng.permutation(600)].reshape(
        -1, 3
    )  # neighbours of the rest configuration are no longer near
    near, far = (
        with_static_at_rest(mesh, start, start + size * rng.standard_normal(start.shape)) for size in (0.01, 0.1)
    )
    expected = [CollisionPipeline(mesh, device=device).find_candidates(start, end) for end in (near, far)]
    assert len(expected[0].edge_edge) > 500
    pipeline = CollisionPipeline(mesh, device=device)
    for k in (0, 1, 0, 1, 1, 0):
        assert_same(pipeline.find_candidates(start, (near, far)[k]), expected[k])
    pipeline = CollisionPipeline(mesh, device=device)
    for k in (1, 0):
        assert_same(pipeline.find_candidates(start, (near, far)[k]), expected[k])


def test_calls_with_other_frames_and_other_functions_in_between(device):
    mesh, start, end = three_bodies(np.random.default_rng(4), static=[2])
    pipeline = CollisionPipeline(mesh, device=device)
    expected = pipeline.find_candidates(start, end)
    for inflation in (0.5, 0.0):
        pipeline.find_candidates(start, start, inflation)
        pipeline.mesh_ccd(start, end)
        assert_same(pipeline.find_candidates(start, end), expected)
    ccd.collision_free_step(mesh, start, end, device=device)
    assert_same(find_candidates(mesh, start, end, device=device), expected)


def test_result_belongs_to_the_caller(device):
    mesh, start, end = three_bodies(np.random.default_rng(5))
    pipeline = CollisionPipeline(mesh, device=device)
    pipeline.find_candidates(start, end)
    found = pipeline.find_candidates(start, end)
    kept = {name: getattr(found, name).copy() for name in NAMES}
    other = pipeline.find_candidates(start, end + 0.1)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(found, name), kept[name])
        assert not np.shares_memory(getattr(found, name), getattr(other, name))
        assert getattr(found, name).flags.writeable and getattr(found, name).flags.c_contiguous


@pytest.mark.parametrize("num_faces", [0, 40, 900])
def test_sorted_gives_the_pairs_in_lexicographic_order(num_faces):
    start, faces = soup(np.random.default_rng(6), num_faces, 0.3)
    found = find_candidates(CollisionMesh.from_arrays([(start, faces)]), start, start)
    kept = {name: getattr(found, name).copy() for name in NAMES}
    ordered = found.sorted()
    assert num_faces < 900 or len(found.edge_edge) > 100_000
    for name in NAMES:
        pairs, given = getattr(ordered, name), getattr(found, name)
        assert pairs.dtype == np.int32 and pairs.flags.c_contiguous and not np.shares_memory(pairs, given)
        np.testing.assert_array_equal(pairs, given[np.lexsort(given.T[::-1])])
        np.testing.assert_array_equal(given, kept[name])
