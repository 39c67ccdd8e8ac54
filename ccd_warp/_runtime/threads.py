"""A pool of Python threads, and jobs that end on every thread before an exception propagates.

Warp runs a CPU kernel on the thread that launches it and releases the GIL meanwhile. A job is a list of tasks that
threads share. It is **over** when no thread runs a part of it, and :func:`run` returns or raises only then: a task that
raises, or an interrupt of the caller, sets the job's stop flag, which long kernels read (`kernels.interrupts`), and the
caller waits for the tasks that still run. No lock of Python's library is used that an interrupt could leave locked:
threads communicate only through queues and lists, each operation of which is atomic.
"""

import _thread
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import warp as wp

_TICK = 0.1  # seconds between two calls of ``tick``


class StopFlag:
    """The flag that long kernels read to stop early.

    Attributes:
        array: The flag, int32, shape [1]; 1 means stop.
    """

    def __init__(self, device: wp.Device) -> None:
        self.array: wp.array = wp.zeros(1, dtype=wp.int32, device=device)
        self._host = np.zeros(1, dtype=np.int32) if device.is_cuda else self.array.numpy()

    def set(self) -> None:
        """Stop the kernels that read the flag; their output is discarded, and the flag must be cleared before reuse."""
        self._host[0] = 1

    @property
    def is_set(self) -> bool:
        """Whether kernels must stop."""
        return bool(self._host[0])


class _Job:
    """Tasks that threads share; one thread takes each."""

    def __init__(self, tasks: Sequence[Callable[[], Any]], flag: StopFlag | None) -> None:
        self.results: list[Any] = [None] * len(tasks)
        self._tasks: Sequence[Callable[[], Any]] = tasks
        self._flag = flag
        self._outer: _Job | None = getattr(_this_thread, "job", None)
        self._is_stopped = False
        self._errors: list[BaseException] = []
        self._pending = iter(range(len(tasks)))
        # threads append to these; a job is over when as many have left as have entered
        self._done: list[int] = []
        self._entered: list[None] = []
        self._left: list[None] = []
        self._news: SimpleQueue[None] = SimpleQueue()

    @property
    def is_stopped(self) -> bool:
        """Whether no further task may begin."""
        return self._is_stopped or (self._outer is not None and self._outer.is_stopped)

    def stop(self) -> None:
        """Begin no further task, and stop the kernels."""
        self._is_stopped = True
        if self._flag is not None:
            self._flag.set()

    def work(self) -> None:
        """Take tasks until there are none left."""
        for k in self._pending:
            if self.is_stopped:
                return
            self.results[k] = self._tasks[k]()
            self._done.append(k)

    def serve(self) -> None:
        """Work on a thread of the pool; an error is kept for the caller of the job."""
        self._entered.append(None)
        outer, _this_thread.job = getattr(_this_thread, "job", None), self
        try:
            self.work()
        except BaseException as error:
            self._errors.append(error)
            self.stop()
        finally:
            _this_thread.job = outer
            self._left.append(None)
            self._news.put(None)

    def wait(self, tick: Callable[[], None] | None) -> None:
        """Wait until all tasks are done, or one has raised."""
        while len(self._done) < len(self.results) and not self.is_stopped:
            try:
                self._news.get(timeout=None if tick is None else _TICK)
            except Empty:
                assert tick
                tick()

    def end(self) -> None:
        """Wait until no thread runs a task, even if interrupts arrive; the last interrupt is raised afterwards."""
        self._is_stopped = True
        interrupt: BaseException | None = None
        while True:
            try:
                while len(self._left) < len(self._entered):
                    self._news.get()
                break
            except BaseException as error:
                interrupt = error
                self.stop()
        self._tasks = ()
        if interrupt is not None:
            raise interrupt

    def checked_results(self) -> list[Any]:
        """What the tasks returned.

        Raises:
            BaseException: The first error of a task.
        """
        if self._errors:
            raise self._errors[0]
        if len(self._done) < len(self.results):
            raise _EndedError
        return self.results


class _EndedError(BaseException):
    """Raised in a part of a job that was stopped from outside; the job's caller raises the reason."""


class _Pool:
    """Threads that serve jobs, started on demand, up to one for each core."""

    def __init__(self) -> None:
        self._jobs: SimpleQueue[_Job] = SimpleQueue()
        self._threads: list[int] = []

    def submit(self, job: _Job, count: int) -> None:
        """Let up to ``count`` threads serve a job."""
        count = min(count, max(1, os.cpu_count() or 1))
        while len(self._threads) < count:  # two concurrent callers may start one thread too many
            self._threads.append(_thread.start_new_thread(self._serve, ()))
        for _ in range(count):
            self._jobs.put(job)

    def _serve(self) -> None:
        while True:
            job = self._jobs.get()
            job.serve()
            del job  # otherwise it and its buffers would stay alive until the next job


_this_thread = threading.local()
_pool = _Pool()
_compilers: list[SimpleQueue[Callable[[], None]]] = []
_aside: list[Any] = []


def _renew() -> None:
    """Start anew in a forked child, which has none of the threads, while their locks stay locked."""
    global _pool, _this_thread, _compilers, _aside
    _pool, _compilers, _aside = _Pool(), [], []
    _this_thread = threading.local()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)


def default_num_threads() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run(
    tasks: Sequence[Callable[[], Any]],
    num_threads: int,
    flag: StopFlag | None = None,
    *,
    is_long: bool = False,
    tick: Callable[[], None] | None = None,
) -> list[Any]:
    """Call the tasks, at most ``num_threads`` at a time, and return their results in order.

    Args:
        tasks: The functions to call; any thread may take any of them.
        num_threads: Number of threads that share the tasks.
        flag: The flag to set if the job must end early.
        is_long: Whether a task may delay the response to an interrupt noticeably: then the calling thread only waits.
            Otherwise it works on tasks itself, which saves waking another thread.
        tick: Called ten times a second while the calling thread waits.

    Raises:
        BaseException: What a task raised, or an interrupt of the caller, after every task has ended.
    """
    # a thread of the pool may work instead of waiting
    is_here = getattr(_this_thread, "job", None) is not None
    if not is_long and (num_threads == 1 or len(tasks) == 1):
        return [task() for task in tasks]
    takes_part = is_here or not is_long
    job = _Job(tasks, flag)
    try:
        if len(tasks) > 1 or not takes_part:
            _pool.submit(job, min(num_threads, len(tasks)) - (1 if takes_part else 0))
        if takes_part:
            job.work()
        job.wait(tick)
    except BaseException:
        job.stop()
        job.end()
        raise
    job.end()
    return job.checked_results()


def is_any_aside() -> bool:
    """Whether a task of :func:`run_aside` is still running, possibly with no caller waiting for it."""
    return bool(_aside)


def run_aside(task: Callable[[], Any], tick: Callable[[], None] | None = None) -> None:
    """Call a task on a thread that stays, and wait for it; an interrupt ends the wait but not the task.

    Meanwhile ``tick`` is called ten times a second.
    """
    outcome = _begin_aside([task], 0)
    while True:
        try:
            error = outcome.get(timeout=None if tick is None else _TICK)
            break
        except Empty:
            assert tick
            tick()
    if error is not None:
        raise error


def run_side_by_side(tasks: Sequence[Callable[[], Any]]) -> None:
    """Call tasks at once on this thread, which is that of :func:`run_aside`, and on others that stay."""
    pending = iter(tasks)
    others = [_begin_aside(pending, k) for k in range(1, min(len(tasks), default_num_threads()))]
    try:
        for task in pending:
            task()
    finally:
        errors = [other.get() for other in others]
    for error in errors:
        if error is not None:
            raise error


def _begin_aside(tasks: Iterable[Callable[[], Any]], number: int) -> "SimpleQueue[BaseException | None]":
    """Let a thread call tasks; what it finds in the end is the first error, or None.

    Warp's compiler has a precompiled header for each thread. So these threads stay (`shared_header` has them share the
    first one), and the first of them takes whatever is compiled alone.
    """
    outcome: SimpleQueue[BaseException | None] = SimpleQueue()

    def call() -> None:
        error: BaseException | None = None
        _aside.append(outcome)
        try:
            for task in tasks:
                task()
        except BaseException as raised:
            error = raised
        finally:
            _aside.remove(outcome)
            outcome.put(error)

    while len(_compilers) <= number:  # two concurrent callers may start one thread too many
        queue: SimpleQueue[Callable[[], None]] = SimpleQueue()
        _thread.start_new_thread(_serve_aside, (queue,))
        _compilers.append(queue)
    _compilers[number].put(call)
    return outcome


def _serve_aside(queue: "SimpleQueue[Callable[[], None]]") -> None:
    while True:
        queue.get()()
