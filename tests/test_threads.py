"""Own work of a job is done wherever the job runs: beside the pool, on one of its threads, in a capture on the CPU."""

import time

import pytest
import warp as wp

from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import run


@pytest.mark.parametrize("num_tasks", [0, 1, 3])
@pytest.mark.parametrize("is_long", [False, True])
@pytest.mark.parametrize("num_threads", [1, 2])
def test_own_work_is_never_left_out(num_tasks, is_long, num_threads):
    done = []
    tasks = [lambda k=k: done.append(k) for k in range(num_tasks)]
    run(tasks, num_threads, is_long=is_long, own=lambda: done.append("own"))
    assert sorted(map(str, done)) == sorted([*map(str, range(num_tasks)), "own"])


@pytest.mark.parametrize("num_tasks", [0, 1, 3])
def test_own_work_of_a_job_within_a_job(num_tasks):
    done = []

    def outer():
        time.sleep(0.01)  # so that both tasks are taken by threads of the pool
        run([lambda: done.append("task")] * num_tasks, 2, is_long=True, own=lambda: done.append("own"))

    run([outer, outer], 2, is_long=True)
    assert done.count("own") == 2
    assert done.count("task") == 2 * num_tasks


def test_own_work_in_a_capture_on_the_cpu():
    done = []
    with wp.ScopedCapture("cpu"):
        execution = Execution(wp.get_device("cpu"), 1)
        assert execution.is_serial
        execution.run([], is_long=True, own=lambda: done.append("own"))
    assert done == ["own"]
