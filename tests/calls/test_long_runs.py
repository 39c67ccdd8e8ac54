"""Many calls of one process: what it holds does not grow with them, whatever their options.

`python tests/calls/test_long_runs.py --count 10000` makes more of them.
"""

import argparse
import ctypes
import gc
import itertools
import os
import subprocess
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import numpy as np
import pytest
import warp as wp
from scenes import random_pairs, sheet_over_floor

import ccd_warp as ccd

# Calls of the beginning, after which pools, caches and buffers are what they are.
_WARM_UP = 100
# What 1,000 calls may add, as the allocator's free lists settle: 7 MB at most were seen, and 1 MB for 2,000 calls more.
# The recordings of a line search alone, kept for each value of an option, take 170 kB, in 200 of the calls 34 MB.
_MOST_GROWTH = 16 << 20


class Calls:
    """Calls of all sorts with options that are never the same."""

    def __init__(self):
        self.mesh, self.start, self.end = sheet_over_floor()
        self.host = [np.array(self.start), np.array(self.end)]
        self.vertices_t0, self.vertices_t1 = (wp.array(x, dtype=wp.vec3d, device="cpu", copy=False) for x in self.host)
        self.held = ccd.CollisionPipeline(self.mesh, device="cpu", length_scale=1.0, num_threads=2)
        self.grown = ccd.CollisionPipeline(self.mesh, device="cpu", length_scale=1.0)
        self.points = random_pairs("edge_edge")
        self.frames = self.mesh, self.start, self.end

    def launch_line_search(self, k):
        self.host[1][:] = self.end
        self.held.launch_line_search(
            self.vertices_t0, self.vertices_t1, per="body", safety=0.3 + 1e-5 * k, num_rounds=3 + k % 5
        )

    def launch_on_new_arrays(self, k):
        dtype = (wp.vec3d, wp.vec3f)[k % 2]
        self.held.launch(*(wp.array(x, dtype=dtype, device="cpu") for x in (self.start, self.end)))

    def new_pipeline(self, k):
        pipeline = ccd.CollisionPipeline(self.mesh, device="cpu", tolerance=1e-6 * (1 + 1e-4 * k), max_pairs=5000 + k)
        pipeline.launch(self.vertices_t0, self.vertices_t1)

    def reserve(self, k):
        self.grown.reserve(max_pairs=5000 + k % 50)

    def mesh_ccd(self, k):
        ccd.mesh_ccd(*self.frames, tolerance=1e-6 * (1 + 1e-4 * k), num_threads=1 + k % 3)

    def mesh_that_is_new(self, k):
        ccd.mesh_ccd(*sheet_over_floor(), minimum_separation=1e-5 * k)

    def other_calls(self, k):
        ccd.collision_free_step(*self.frames, t_max=1.0 - 1e-5 * k)
        ccd.find_candidates(*self.frames, inflation=1e-6 * k)
        ccd.line_search(*self.frames, safety=0.3 + 1e-5 * k)

    def pairs(self, k):
        n = 20 + k % 180
        ccd.edge_edge_ccd(self.points[0][:n], self.points[1][:n], tolerance=1e-6 * (1 + 1e-4 * k), num_threads=2)

    def error(self, k):
        try:
            ccd.mesh_ccd(*self.frames, tolerance=-1.0 - k)
        except ValueError:
            return
        raise AssertionError

    def all(self):
        calls = [self.launch_line_search, self.launch_line_search, self.launch_on_new_arrays, self.new_pipeline]
        calls += [self.reserve, self.mesh_ccd, self.mesh_that_is_new, self.other_calls, self.pairs, self.error]
        return calls


def resident():
    """Bytes of the process that lie in memory, under Linux."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def held():
    """Bytes that the process holds, without what is only kept to be used again."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):  # no glibc
        pass
    return resident()


def grow(count, only=None):
    """Bytes that the process has grown by in so many calls."""
    calls = Calls().all()
    chosen = [call for call in calls if only in (None, call.__name__)]
    before = 0
    for k, call in zip(range(_WARM_UP + count), itertools.cycle(chosen)):
        if k == _WARM_UP:
            before = held()
        call(k)
    return held() - before


def growth_in_own_process(count, only=()):
    command = [sys.executable, __file__, "--run", str(count), *only]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=os.getcwd())
    assert done.returncode == 0, done.stderr[-3000:]
    return int(done.stdout)


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="tells memory as Linux does")
@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.long)])
def test_memory_stays_flat_over_calls_whose_options_change(count):
    growth = growth_in_own_process(count)
    assert growth < _MOST_GROWTH, f"grew by {growth / 1e6:.1f} MB in {count} calls"


def main():
    if sys.argv[1:2] == ["--run"]:
        wp.config.log_level = wp.LOG_ERROR
        print(grow(int(sys.argv[2]), *sys.argv[3:]))
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--only", default=[], nargs="*")
    arguments = parser.parse_args()
    for only in arguments.only or [None]:
        growth = growth_in_own_process(arguments.count, [only] if only else [])
        print(f"{only or 'all'}: {growth / 1e6:.1f} MB in {arguments.count} calls", flush=True)


if __name__ == "__main__":
    main()
