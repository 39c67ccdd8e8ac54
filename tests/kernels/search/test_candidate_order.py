"""Candidates belong to the caller, are sorted on demand, and keep their order where static boxes are kept."""

import re

import numpy as np
import pytest
from scenes import all_in_one_place, soup, three_bodies, with_static_at_rest

from ccd_warp import CollisionMesh, CollisionPipeline, PairKind, find_candidates

NAMES = ("vertex_face", "edge_edge", "point_segment", "point_point")


def assert_same(found, expected):
    for name in NAMES:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_blocks_of_boxes_that_exceed_the_memory_limit(device):
    """The least limit holds the partners of one box a thread; a block of sixteen, which have more, is cut."""
    mesh, *frames = all_in_one_place(2, 280, 900)
    expected = find_candidates(mesh, *frames, device=device, num_threads=1)
    for num_threads in (1, 3):
        with pytest.raises(ValueError, match="memory_limit is 1 bytes; expected at least") as error:
            CollisionPipeline(mesh, memory_limit=1, num_threads=num_threads).find_candidates(*frames)
        limit = int(re.search(r"at least (\d+)", str(error.value)).group(1))
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


def test_result_belongs_to_the_caller(device):
    mesh, start, end = three_bodies(5, (900, 300, 600))
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
