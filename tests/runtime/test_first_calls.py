"""First calls of a process that many threads make at once, and calls of a process that was forked from a busy one."""

import os
import signal
import subprocess
import sys
import threading
import time
import traceback

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd

RNG = np.random.default_rng(0)
PAIRS = {"vertex_face": 4, "edge_edge": 4, "point_segment": 3, "point_point": 2}
START, END = RNG.uniform(size=(2, 30, 4, 3))


def sheet_over_floor():
    """A sheet falls through another, which is static: a new mesh, and both ends of the step."""
    x = np.array([[i, j, 0.0] for i in range(5) for j in range(5)])
    faces = [[k, k + 5, k + 1 + 5 * side] for side in (0, 1) for k in range(20) if k % 5 < 4]
    mesh = ccd.CollisionMesh.from_arrays([(x + [0.1, 0.2, 1.0], faces), (x, faces)], static=[1])
    return mesh, mesh.vertices, mesh.vertices - np.outer(mesh.vertex_body == 0, [0, 0, 1.5])


def of_pairs(kind, **options):
    start, end = (x[:, : PAIRS[kind]].copy() for x in (START, END))
    return lambda: getattr(ccd, f"{kind}_ccd")(start, end, minimum_separation=0.02, **options).toi


def of_mesh(name, field=None, **options):
    def call():
        result = getattr(ccd, name)(*sheet_over_floor(), num_threads=2, **options)
        return result if field is None else getattr(result, field)

    return call


CALLS = [
    *(of_pairs(kind, precision=precision) for precision in ("float64", "float32") for kind in PAIRS),
    of_pairs("edge_edge", method="bisection"),
    of_mesh("mesh_ccd", "vertex_toi"),
    of_mesh("collision_free_step", precision="float32"),
    of_mesh("find_candidates", "edge_edge"),
]


def call_at_once(calls, num_threads):
    """Make calls on threads that begin together; each then once more, alone, to compare. What went wrong."""
    barrier, answers, errors = threading.Barrier(num_threads), [None] * num_threads, []

    def work(k):
        barrier.wait()
        try:
            answers[k] = np.array(calls[k % len(calls)]())
        except BaseException:
            errors.append(traceback.format_exc())

    threads = [threading.Thread(target=work, args=[k]) for k in range(num_threads)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(num_threads):
        if not errors and answers[k].tobytes() != np.array(calls[k % len(calls)]()).tobytes():
            errors.append(f"call {k} answered otherwise the second time")
    return errors


def call_in_children(num_forks):
    """Fork while threads are at work; each child makes a call of its own on two threads. What went wrong."""
    call, is_done, errors = of_mesh("mesh_ccd", "vertex_toi"), threading.Event(), []
    expected = call().tobytes()

    def work():
        while not is_done.is_set():
            call()

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for k in range(num_forks):
        time.sleep(1e-3 * (k % 7))
        if (child := os.fork()) == 0:
            status = 1
            try:
                signal.alarm(120)  # ends a child that hangs
                status = int(call().tobytes() != expected)
            finally:
                os._exit(status)
        if (status := os.waitpid(child, 0)[1]) != 0:
            errors.append(f"child {k} ended with {status}")
    is_done.set()
    for thread in threads:
        thread.join()
    return errors


IN_PROCESSES = {
    "20 threads, then forks": lambda: call_at_once(CALLS, 20) + call_in_children(20),
    "nothing compiled": lambda: call_at_once(CALLS[:4], 8),  # one module of kernels, which takes seconds to compile
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork of POSIX")
@pytest.mark.parametrize("name", [pytest.param(k, marks=[pytest.mark.long] * (k[0] != "2")) for k in IN_PROCESSES])
def test_first_calls_of_a_process_come_from_many_threads_or_from_a_child_of_a_busy_one(tmp_path, name):
    cache = {"WARP_CACHE_PATH": str(tmp_path)} if name == "nothing compiled" else {}
    command, environment = [sys.executable, __file__, name], os.environ | cache
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr[-3000:]


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    sys.exit("\n".join(IN_PROCESSES[sys.argv[1]]()) or 0)
