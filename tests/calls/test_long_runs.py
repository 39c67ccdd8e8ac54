"""Many calls of one process: what it holds does not grow with them, whatever their options."""

from itertools import cycle

import numpy as np
import pytest
import warp as wp
from held_memory import held_bytes, requires_status
from scenes import random_pairs, sheet_over_floor

import ccd_warp as ccd

# Calls of the beginning, after which pools, caches and buffers are what they are.
_WARM_UP = 100
# What 1,000 calls may add, as the allocator's free lists settle: 7 MB at most were seen, and 1 MB for 2,000 calls more.
# The recordings of a line search alone, kept for each value of an option, take 170 kB, in 200 of the calls 34 MB.
_MOST_GROWTH = 16 << 20


def calls():
    """Calls of all sorts, of a number with which their options change."""
    mesh, start, end = frames = sheet_over_floor()
    wished, points = np.array(end), random_pairs("edge_edge")
    t0, t1 = (wp.array(x, dtype=wp.vec3d, copy=False) for x in (np.array(start), wished))
    held, grown = ccd.CollisionPipeline(mesh, length_scale=1.0, num_threads=2), ccd.CollisionPipeline(mesh)

    def launch_line_search(k):
        wished[:] = end
        held.launch_line_search(t0, t1, per="body", safety=0.3 + 1e-5 * k, num_rounds=3 + k % 5)

    def error(k):
        with pytest.raises(ValueError):
            ccd.mesh_ccd(*frames, tolerance=-1.0 - k)

    return [
        launch_line_search,
        error,
        lambda k: held.launch(*(wp.array(x, dtype=(wp.vec3d, wp.vec3f)[k % 2]) for x in (start, end))),
        launch_line_search,
        lambda k: ccd.CollisionPipeline(mesh, tolerance=1e-6 * k, max_pairs=5000 + k).launch(t0, t1),
        lambda k: ccd.collision_free_step(*frames, t_max=1.0 - 1e-5 * k),
        lambda k: ccd.find_candidates(*frames, inflation=1e-6 * k),
        lambda k: ccd.line_search(*frames, safety=0.3 + 1e-5 * k),
        lambda k: ccd.edge_edge_ccd(*(x[: 20 + k % 180] for x in points), tolerance=1e-6 * k, num_threads=2),
        lambda k: grown.reserve(max_pairs=5000 + k % 50),
        lambda k: ccd.mesh_ccd(*frames, tolerance=1e-6 * k, num_threads=1 + k % 3),
        lambda k: ccd.mesh_ccd(*sheet_over_floor(), minimum_separation=1e-5 * k),  # on a mesh that is new
    ]


@requires_status
@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.long)])
def test_memory_stays_flat_over_calls_whose_options_change(count):
    with wp.ScopedDevice("cpu"):  # of which the process holds the memory
        for k, call in zip(range(_WARM_UP + count), cycle(calls())):
            if k == _WARM_UP:
                before = held_bytes()
            call(k)
        grown = held_bytes() - before
    assert grown < _MOST_GROWTH, f"grew by {grown / 1e6:.1f} MB in {count} calls"
