"""The tasks of a job are all done wherever the job runs: on the calling thread, on the pool, within a task."""

import threading
import time
from functools import partial

import pytest

from ccd_warp._runtime.launch import _left_after
from ccd_warp._runtime.threads import run, run_aside, run_side_by_side


@pytest.mark.parametrize(
    ("num_tasks", "is_long", "num_threads"), [(0, True, 2), (1, True, 2), (3, False, 2), (3, True, 1)]
)
def test_no_task_is_left_out(num_tasks, is_long, num_threads):
    assert run([lambda k=k: k * k for k in range(num_tasks)], num_threads, is_long=is_long) == [0, 1, 4][:num_tasks]
    done = []

    def outer():
        time.sleep(0.01)  # so that both tasks are taken by threads of the pool
        run([lambda: done.append("task")] * num_tasks, 2, is_long=True)

    run([outer, outer], 2, is_long=True)
    assert done.count("task") == 2 * num_tasks


@pytest.mark.parametrize("is_long", [False, True])
def test_the_error_of_a_task_is_that_of_its_job(is_long):
    """Also of one that a thread of the pool has taken, as where the calling thread only waits."""
    for tasks in ([lambda: 1 // 0, int], [int, lambda: 1 // 0]):
        with pytest.raises(ZeroDivisionError):
            run(tasks, 2, is_long=is_long)


def test_parts_that_take_longer_than_waking_a_thread_are_left_to_others():
    done: list[int] = []
    parts = [partial(done.append, k) for k in range(3)]
    assert _left_after(parts, 60.0) == [] and done == [0, 1, 2]
    assert _left_after(parts, 0.0) == parts[1:] and done == [0, 1, 2, 0]


@pytest.mark.parametrize("failing", range(3))
def test_what_is_done_aside_has_a_thread_that_stays_and_tasks_beside_each_other_all_end(failing):
    """Warp's compiler keeps its precompiled header for each thread."""
    running, threads = [], set()

    def task(k):
        running.append(k)
        time.sleep(0.01)
        running.remove(k)
        if k == failing:
            raise ValueError(str(k))

    for _ in range(3):
        run_aside(lambda: threads.add(threading.get_ident()))
    assert len(threads) == 1 and threading.get_ident() not in threads
    with pytest.raises(ValueError, match=str(failing)):
        run_aside(lambda: run_side_by_side([lambda k=k: task(k) for k in range(3)]))
    assert running == []
