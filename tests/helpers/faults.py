"""A harness that lets a call fail: at each use of Warp and of threads, or by an interrupt between two of its bytecodes.

A call that fails must leave nothing behind. Made again on the same objects, twice, it must answer in every bit what it
answers on fresh ones, and the exception must have reached the caller. The harness knows nothing of the library but its
calls, and how it asks for the parts of a recorded launch, which then run without Warp: it counts the events of an
undisturbed call, and then lets some of them fail in turn, on objects made anew each time. What failed is kept until the
calls after it are made, as a notebook keeps the last exception with all the frames that it went through.
"""

import functools
import operator
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from laws.outputs import different, outputs_of

from ccd_warp._runtime.packed import PackedLaunch

# Seconds after which a call of some milliseconds is taken to hang.
_PATIENCE = 120.0
# What a call uses of Warp, by attributes that are looked up when it does, and of threads; an event after the parts of a
# launch were asked for is one before they run.
_NEW = [(wp, name) for name in ("empty", "zeros", "full", "ones", "clone", "empty_like", "zeros_like", "from_dlpack")]
_NEW.append((wp.array, "__init__"))
_READ = [(wp.array, "numpy"), (wp, "load_module")]
_WRITE = [(wp, name) for name in ("launch", "copy", "capture_launch")]
_WRITE += [*((wp.array, name) for name in ("assign", "fill_", "zero_")), (wp.Launch, "launch"), (PackedLaunch, "parts")]
_OF_THREADS = [(ThreadPoolExecutor, "submit"), (threading.Thread, "start")]
# Files between whose bytecodes interrupts arrive, beside the library's: what it waits and cleans up with.
_STANDARD = ("/contextlib.py", "/threading.py", "/concurrent/futures/", "/ccd_warp/", "/kernels/")


class Stop(BaseException):
    """An exception that no code can expect."""


ERRORS = (Stop, MemoryError, KeyboardInterrupt)
_watch = threading.local()


@dataclass(frozen=True)
class Scenario:
    """A call on what `fresh` makes, and what is done with that before; the truth is that of a call without it."""

    fresh: Callable[[], Any]
    call: Callable[[Any], Any]
    before: Callable[[Any], Any] = lambda _: None


class Event:
    """An exception at the n-th use of Warp or threads, before it is carried out or directly after."""

    def __init__(self, n: int = 0, is_after: bool = False, error: type[BaseException] = Stop) -> None:
        self.n, self.is_after, self.error = n, is_after, error
        self.count, self.has_happened, self.what = 0, False, ""
        self.sites: dict[tuple[Any, ...], int] = {}  # first events from each line and its caller's
        self.writes: set[int] = set()
        self._lock = threading.Lock()

    def __str__(self) -> str:
        return f"{self.error.__name__} {'after' if self.is_after else 'before'} event {self.n} ({self.what})"

    def start(self) -> None:
        self._originals = [(*at, getattr(*at)) for at in (*_NEW, *_READ, *_WRITE, *_OF_THREADS)]
        for owner, name, original in self._originals:
            setattr(owner, name, self._watched(original, (owner, name)))

    def stop(self) -> None:
        for owner, name, original in self._originals:
            setattr(owner, name, original)

    def _watched(self, original: Any, at: tuple[Any, str]) -> Any:
        @functools.wraps(original)
        def call(*args: Any, **options: Any) -> Any:
            # what Warp does within one of its functions is that function's; a pool that starts a thread may fail there
            if getattr(_watch, "is_inside", False):
                return original(*args, **options)
            with self._lock:
                self.count += 1
                is_now = self.count == self.n
                frame = sys._getframe(1)
                self.sites.setdefault((at[1], frame.f_lineno, frame.f_back and frame.f_back.f_lineno), self.count)
                if at not in _NEW and at not in _READ:
                    self.writes.add(self.count)
                if is_now:
                    self.has_happened, self.what = True, at[1]
            if is_now and not self.is_after:
                raise self.error("injected")
            try:
                _watch.is_inside = at not in _OF_THREADS
                result = original(*args, **options)
            finally:
                _watch.is_inside = False
            if is_now:
                raise self.error("injected")
            return result

        return call


class _Signal:
    """Asks for an interrupt when its attribute is read: no function of Python is called, after which it would come."""

    trip = staticmethod(functools.partial(__import__("_thread").interrupt_main, signal.SIGINT))
    now = property(operator.methodcaller("trip"))


_SIGNAL = _Signal()


class Interrupt:
    """KeyboardInterrupt from the n-th bytecode of the library's own on, and another some bytecodes later."""

    error = KeyboardInterrupt

    def __init__(self, n: int = 0, gap: int = 0) -> None:
        self.n, self.second = n, n + gap if gap else 0
        self.count, self.has_happened, self.where = 0, False, ""
        self._is_own: dict[str, bool] = {}

    def __str__(self) -> str:
        return f"interrupt at bytecode {self.n}{f' and {self.second}' if self.second else ''} ({self.where})"

    def start(self) -> None:
        self._handler = signal.signal(signal.SIGINT, self._arrive)
        sys.settrace(self._enter)

    def stop(self) -> None:
        sys.settrace(None)
        signal.signal(signal.SIGINT, self._handler)

    def _arrive(self, *_: object) -> None:
        """Raise the interrupt where a real one is raised, and go on counting."""
        sys.settrace(self._enter)
        raise KeyboardInterrupt

    def _enter(self, frame: Any, event: str, _: Any) -> Any:
        name = frame.f_code.co_filename
        if name not in self._is_own:
            self._is_own[name] = any(part in name for part in _STANDARD)
        if not self._is_own[name]:
            return None
        frame.f_trace_lines = False
        frame.f_trace = self._step  # before the next line, or Python 3.13 traces no bytecodes
        frame.f_trace_opcodes = True
        return self._step

    def _step(self, frame: Any, event: str, _: Any) -> Any:
        if event != "opcode":
            return self._step
        self.count += 1
        if self.count == self.n or self.count == self.second:
            self.where += f" {frame.f_code.co_filename.rpartition('/')[2]}:{frame.f_lineno}"
            self.has_happened = True
            # or the interrupt would arrive where the next bytecode is traced, such as that which releases a lock
            sys.settrace(None)
            _SIGNAL.now  # noqa: B018
        return self._step


@contextmanager
def alarm(seconds: float, error: type[BaseException]) -> Iterator[None]:
    """Raises an error in the main thread after so many seconds."""

    def ring(*_: Any) -> None:
        raise error("the call did not end")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _disturbed(fault: Any, call: Callable[[], Any]) -> tuple[BaseException | None, Any]:
    """What the call raised, and returned, while a fault happened in it; a second interrupt takes the first's place."""
    error, result = None, None
    settle = (lambda: None).__call__  # a call, in which an interrupt arrives that the last bytecode asked for
    try:
        try:
            fault.start()
            result = call()
        except BaseException as raised:
            error = raised
        settle()
    except BaseException as raised:
        error = raised
    finally:
        fault.stop()
    return error, None if error else result


def _is_of(error: BaseException, kind: type[BaseException]) -> bool:
    """Whether an exception is of a kind, or was raised by Python's own lock while it cleaned up after one.

    `threading.Condition.wait` releases its lock a bytecode before it is ready to take it again. An interrupt just there
    lets the ``with`` around it release the lock once more, and the RuntimeError of that hides the interrupt.
    """
    if isinstance(error, RuntimeError) and str(error) == "release unlocked lock" and error.__context__ is not None:
        error = error.__context__
    return isinstance(error, kind)


def inject(scenario: Scenario, fault: Any, truth: dict[str, np.ndarray]) -> list[str]:
    """Let one fault happen, and make the same call twice; what is wrong, in words."""
    objects = _prepared(scenario)
    ignored: list[Any] = []
    hook, sys.unraisablehook = sys.unraisablehook, ignored.append
    try:  # an interrupt within a copy of Warp would leave the null stream as the current one
        with alarm(_PATIENCE, TimeoutError), wp.ScopedStream(wp.get_stream() if wp.get_device().ordinal >= 0 else None):
            error, result = _disturbed(fault, lambda: scenario.call(objects))
    finally:
        sys.unraisablehook = hook
    if not fault.has_happened:
        return []
    wrong = []
    if error is not None and not _is_of(error, fault.error):
        wrong.append(f"the caller got {error!r}")
    # where memory is short a call may find another way, and Python drops what is raised in a destructor
    elif error is None and fault.error is not MemoryError and not ignored:
        wrong.append("the exception did not reach the caller")
    elif error is None:
        wrong += different(outputs_of(result), truth)
    for count in ("next", "second"):
        with alarm(_PATIENCE, TimeoutError):
            wrong += [f"the {count} call: {line}" for line in different(outputs_of(scenario.call(objects)), truth)]
    del error  # kept until here, with all its frames
    return [f"{fault}: {line}" for line in wrong]


def _prepared(scenario: Scenario) -> Any:
    objects = scenario.fresh()
    scenario.before(objects)
    return objects


def _counted(scenario: Scenario, fault: Any) -> Any:
    """A fault that counts and does not happen."""
    objects = _prepared(scenario)
    error, _ = _disturbed(fault, lambda: scenario.call(objects))
    assert error is None and fault.count > 0, error
    return fault


def truth_of(scenario: Scenario) -> dict[str, np.ndarray]:
    """What the call answers on fresh objects; checks that it answers the same again, and after what came before."""
    truth = outputs_of(scenario.call(scenario.fresh()))
    objects = _prepared(scenario)
    for _ in range(2):
        assert different(outputs_of(scenario.call(objects)), truth) == [], "without a fault"
    return truth


def wrong_after_events(scenario: Scenario, every: int | None = None) -> list[str]:
    """A fault before an event, and after one that changes something: every so many of the lines, or all events."""
    truth, counted = truth_of(scenario), _counted(scenario, Event())
    wrong: list[str] = []
    for k, n in enumerate(sorted(counted.sites.values())[::every] if every else range(1, counted.count + 1)):
        for is_after in (False, True) if n in counted.writes else (False,):
            wrong += inject(scenario, Event(n, is_after, ERRORS[(k + is_after) % len(ERRORS)]), truth)
    return wrong


def wrong_after_interrupts(scenario: Scenario, seed: int, num_samples: int) -> list[str]:
    """Interrupts at places drawn over all bytecodes of the call, of which every third is followed by another."""
    truth = truth_of(scenario)
    # from Python 3.12 on, bytecodes are traced from a function's second call on
    _disturbed(Interrupt(), functools.partial(scenario.call, _prepared(scenario)))
    count, rng = _counted(scenario, Interrupt()).count, np.random.default_rng(seed)
    wrong: list[str] = []
    for k in range(num_samples):
        n = 1 + int((k + rng.random()) * count / num_samples)
        wrong += inject(scenario, Interrupt(n, int(10 ** rng.uniform(0.5, 3.0)) if k % 3 == 2 else 0), truth)
    return wrong
