"""First calls of a process that many threads make at once, and calls of a process that was forked from a busy one."""

import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle, islice

import numpy as np
import pytest
import warp as wp
from programs import begun
from scenes import sheet_over_floor

import ccd_warp as ccd
from ccd_warp._runtime.threads import run

POINTS = np.random.default_rng(0).uniform(size=(2, 30, 4, 3))
PAIRS = {"vertex_face_ccd": 4, "edge_edge_ccd": 4, "point_segment_ccd": 3, "point_point_ccd": 2}
FIRST_CALLS = [
    *((name, {"precision": precision}) for precision in ("float64", "float32") for name in PAIRS),
    ("edge_edge_ccd", {"method": "bisection"}),
    ("mesh_ccd", {}),
    ("collision_free_step", {"precision": "float32"}),
    ("find_candidates", {}),
]


def bits_of(name, options):
    """What a call answers for pairs, or for a sheet that falls through another, which is static, in a new mesh."""
    if name in PAIRS:
        start, end = (x[:, : PAIRS[name]].copy() for x in POINTS)
        return getattr(ccd, name)(start, end, minimum_separation=0.02, **options).toi.tobytes()
    result = getattr(ccd, name)(*sheet_over_floor(4), num_threads=2, **options)
    field = {"mesh_ccd": "vertex_toi", "find_candidates": "edge_edge"}.get(name)
    return np.array(getattr(result, field) if field else result).tobytes()


def call_at_once(calls, num_threads):
    """Make calls on threads that begin together; each then once more, alone, to compare."""
    barrier, calls = threading.Barrier(num_threads), [*islice(cycle(calls), num_threads)]

    def work(call):
        barrier.wait()
        return bits_of(*call)

    with ThreadPoolExecutor(num_threads) as threads:
        answers = [*threads.map(work, calls)]
    assert [call for call, answer in zip(calls, answers, strict=True) if answer != bits_of(*call)] == []


def call_in_children(num_forks):
    """Fork while threads are at work; each child makes a call of its own on two threads."""
    call, is_done = ("mesh_ccd", {}), threading.Event()

    def answers():
        return bits_of(*call), run([lambda: 1] * 2, 2, is_long=True)  # for which the caller only waits

    expected = answers()

    def work():
        while not is_done.is_set():
            bits_of(*call)

    with ThreadPoolExecutor(2) as threads:
        busy = [threads.submit(work) for _ in range(2)]
        ends = []
        for k in range(num_forks):
            time.sleep(1e-3 * (k % 7))
            if (child := os.fork()) == 0:
                status = 1
                try:
                    signal.alarm(60)  # ends a child that hangs
                    status = int(answers() != expected)
                finally:
                    os._exit(status)
            ends.append(os.waitpid(child, 0)[1])
            if ends[-1]:
                break
        is_done.set()
    assert ends == [0] * num_forks and [thread.result() for thread in busy] == [None, None]


IN_PROCESSES = {
    "20 threads, then forks": lambda: (call_at_once(FIRST_CALLS, 20), call_in_children(20)),
    "nothing compiled": lambda: call_at_once(
        FIRST_CALLS[:4], 8
    ),  # one module of kernels, which takes seconds to compile
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork of POSIX")
@pytest.mark.parametrize("name", [pytest.param(k, marks=[pytest.mark.long] * (k[0] != "2")) for k in IN_PROCESSES])
def test_first_calls_of_a_process_come_from_many_threads_or_from_a_child_of_a_busy_one(tmp_path, name):
    cache = {"WARP_CACHE_PATH": str(tmp_path)} if name == "nothing compiled" else {}
    hidden = {"CUDA_VISIBLE_DEVICES": ""} if "forks" in name else {}  # CUDA does not outlive a fork
    status, _, error = begun(tmp_path, __file__, name, **cache, **hidden)
    assert status == 0, error[-3000:]


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    IN_PROCESSES[sys.argv[1]]()
