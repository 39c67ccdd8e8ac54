"""First calls of a process that many threads make at once, and calls of a process that was forked from a busy one.

`python tests/runtime/test_first_calls.py [--runs 20] [--forks 40]` makes more of both.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import numpy as np
import pytest
import warp as wp
from scenes import CORNERS, random_pairs, sheet_over_floor

import ccd_warp as ccd


def of_pairs(kind, **options):
    return lambda: getattr(ccd, f"{kind}_ccd")(*random_pairs(kind), minimum_separation=0.02, **options).toi


def of_mesh(name, **options):
    return lambda: getattr(ccd, name)(*sheet_over_floor(), num_threads=2, **options)


def launch(dtype=wp.vec3d, method="launch", **options):
    def call():
        mesh, *frames = sheet_over_floor()
        pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu", num_threads=2, **options)
        result = getattr(pipeline, method)(*(wp.array(x, dtype=dtype, device="cpu") for x in frames))
        return result.vertex_toi.numpy().copy()

    return call


CALLS = [
    *(of_pairs(kind) for kind in CORNERS),
    *(of_pairs(kind, precision="float32") for kind in CORNERS),
    of_pairs("edge_edge", method="bisection"),
    lambda: of_mesh("mesh_ccd")().vertex_toi,
    lambda: of_mesh("mesh_ccd", precision="float32")().vertex_toi,
    of_mesh("collision_free_step"),
    lambda: of_mesh("find_candidates")().edge_edge,
    lambda: of_mesh("line_search")().vertices,
    launch(),
    launch(wp.vec3f),
    launch(method="launch_line_search"),
    launch(precision="float32"),
]
# One module of kernels, which takes seconds to compile.
FEW = CALLS[:4]


def call_at_once(calls, num_threads):
    """Make calls on threads that begin together; each then once more, alone, to compare. The exit status."""
    barrier = threading.Barrier(num_threads)
    answers, errors = [None] * num_threads, []

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
    if errors:
        print(f"{len(errors)} of {num_threads} threads failed\n{errors[0]}", file=sys.stderr)
    return int(bool(errors))


def call_in_children(num_forks, patience=120.0):
    """Fork while threads are at work; each child makes a call of its own on two threads. The exit status."""
    mesh, start, end = sheet_over_floor()
    expected = ccd.mesh_ccd(mesh, start, end, num_threads=2)
    is_done = threading.Event()

    def work():
        own, *frames = sheet_over_floor()
        while not is_done.is_set():
            ccd.mesh_ccd(own, *frames, num_threads=2)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    hung = wrong = 0
    for k in range(num_forks):
        time.sleep(1e-3 * (k % 7))
        child = os.fork()
        if child == 0:
            status = 1
            try:
                result = ccd.mesh_ccd(mesh, start, end, num_threads=2)
                status = int(result.vertex_toi.tobytes() != expected.vertex_toi.tobytes())
            finally:
                os._exit(status)
        last = time.monotonic() + patience
        while (ended := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < last:
            time.sleep(2e-3)
        if ended[0] == 0:
            hung += 1
            os.kill(child, 9)
            os.waitpid(child, 0)
        else:
            wrong += int(ended[1] != 0)
    is_done.set()
    for thread in threads:
        thread.join()
    if hung or wrong:
        print(f"of {num_forks} children {hung} hung and {wrong} failed", file=sys.stderr)
    return int(bool(hung or wrong))


def in_own_process(*arguments, cache=None, timeout=600):
    """Run this file; what it wrote to the error stream where it failed or hung."""
    environment = os.environ | ({"WARP_CACHE_PATH": cache} if cache else {})
    command = [sys.executable, __file__, "--run", *map(str, arguments)]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=timeout, cwd=os.getcwd()
        )
    except subprocess.TimeoutExpired:
        return f"did not end within {timeout} s"
    return "" if done.returncode == 0 else f"ended with {done.returncode}: {done.stderr[-3000:]}"


@pytest.mark.parametrize("num_threads", [pytest.param(4, marks=pytest.mark.long), 20])
def test_first_calls_of_a_process_come_from_many_threads(num_threads):
    assert in_own_process("all", num_threads) == ""


@pytest.mark.long
def test_first_calls_come_from_many_threads_while_nothing_is_compiled_yet(tmp_path):
    assert in_own_process("few", 8, cache=str(tmp_path), timeout=900) == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork of POSIX")
def test_child_of_a_process_with_busy_threads_makes_calls_of_its_own():
    assert in_own_process("fork", 20) == ""


def test_thread_that_is_held_up_holds_up_no_thread_on_another_mesh(monkeypatch):
    """Nor a child that is forked meanwhile, where the other thread is gone and holds a lock for ever."""
    real = ccd._engine.boxes.step_boxes.choose_quantization
    is_in, go_on = threading.Event(), threading.Event()

    def held_up(*arguments):
        if threading.current_thread().name == "held up":
            is_in.set()
            go_on.wait(600.0)
        return real(*arguments)

    monkeypatch.setattr(ccd._engine.boxes.step_boxes, "choose_quantization", held_up)
    slow, other = (threading.Thread(target=of_mesh("mesh_ccd"), name=name) for name in ("held up", "other"))
    slow.start()
    assert is_in.wait(60.0)
    other.start()
    other.join(120.0)
    has_ended = not other.is_alive()
    go_on.set()
    slow.join()
    other.join()
    assert has_ended


def main():
    if sys.argv[1:2] == ["--run"]:
        wp.config.log_level = wp.LOG_ERROR
        kind, count = sys.argv[2], int(sys.argv[3])
        if kind == "fork":
            sys.exit(call_in_children(count))
        # with an offset the threads begin with other calls
        calls = FEW if kind == "few" else CALLS
        offset = int(sys.argv[4]) if len(sys.argv) > 4 else 0
        sys.exit(call_at_once(calls[offset % len(calls) :] + calls[: offset % len(calls)], count))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="with warm caches, for each number of threads")
    parser.add_argument("--cold-runs", type=int, default=2, help="with an empty cache")
    parser.add_argument("--forks", type=int, default=40)
    arguments = parser.parse_args()
    for num_threads in (2, 4, 20):
        failed = [found for k in range(arguments.runs) if (found := in_own_process("all", num_threads, 5 * k))]
        print(f"{num_threads} threads, warm: {len(failed)} of {arguments.runs} runs failed", *failed[:1], flush=True)
    failed = []
    for k in range(arguments.cold_runs):
        with tempfile.TemporaryDirectory() as cache:
            failed += [found for found in [in_own_process("all", 20, 5 * k, cache=cache, timeout=900)] if found]
    print(f"20 threads, cold: {len(failed)} of {arguments.cold_runs} runs failed", *failed[:1], flush=True)
    print(f"forks: {in_own_process('fork', arguments.forks, timeout=900) or 'all well'}")


if __name__ == "__main__":
    main()
