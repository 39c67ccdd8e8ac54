"""A harness that lets a call fail: at each use of Warp and of threads, or by an interrupt between two of its bytecodes.

A call that fails must leave nothing behind. Made again on the same objects, twice, it must answer in every bit what it
answers on fresh ones, and the exception must have reached the caller. The harness knows nothing of the library but the
calls of a `Scenario`, and how it asks for the parts of a recorded launch, which then run without Warp: it counts the
events of an undisturbed call, and then lets each of them fail in turn, on objects made anew each time. What failed is
kept until the calls after it are made, as a notebook keeps the last exception with all the frames that it went through.
"""

import functools
import operator
import signal
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._runtime.packed import PackedLaunch

# Seconds after which a call of some milliseconds is taken to hang; another one hangs for the same reason.
_PATIENCE = (120.0, 2.0)
# What a call uses of Warp, by attributes that are looked up when it does, and of threads; an event after the parts of a
# launch were asked for is one before they run.
_OF_WARP = [
    *((wp, name) for name in ("launch", "empty", "zeros", "full", "ones", "clone", "empty_like", "zeros_like", "copy")),
    *((wp, name) for name in ("load_module", "from_dlpack", "capture_launch")),
    *((wp.array, name) for name in ("__init__", "assign", "fill_", "zero_", "numpy")),
    (wp.Launch, "launch"),
    (PackedLaunch, "parts"),
]
_WARP = (wp, wp.array, wp.Launch, PackedLaunch)
_OF_THREADS = [(ThreadPoolExecutor, "submit"), (threading.Thread, "start")]
# What only reads, and what makes an array that nobody has yet: what fails directly after these leaves all as before.
_READING = {"array.numpy", "warp.load_module"}
_MAKING = {f"warp.{name}" for name in ("empty", "zeros", "full", "ones", "clone", "empty_like", "zeros_like")}
_MAKING |= {"warp.from_dlpack", "array.__init__"}
# Lines of callers by which two uses are told apart.
_DEPTH = 2
# Events of a call that are chosen beside, where many uses come from one line, as those of a recording do.
_FEWEST = 12
# Files between whose bytecodes interrupts arrive, beside the library's: what it waits and cleans up with.
_STANDARD = ("/contextlib.py", "/threading.py", "/concurrent/futures/")


class Stop(BaseException):
    """An exception that no code can expect."""


class Hung(BaseException):
    """A call did not end."""


ERRORS = (Stop, MemoryError, KeyboardInterrupt)


@dataclass(frozen=True)
class Scenario:
    """A call, and what was called before it.

    Attributes:
        fresh: Makes what the call works on.
        call: The call; its result may hold arrays of NumPy and of Warp, in data classes, tuples and dictionaries.
        before: What is done with it before, without a fault; the truth is that of a call without it.
    """

    fresh: Callable[[], Any]
    call: Callable[[Any], Any]
    before: Callable[[Any], Any] = lambda _: None


@dataclass
class Findings:
    """What came of the faults of a scenario.

    Attributes:
        num_faults: Faults that happened.
        wrong: Faults after which a call answered otherwise than on fresh objects, raised or did not end, or whose
            exception did not reach the caller; and how.
    """

    num_faults: int = 0
    wrong: list[str] = field(default_factory=list)

    def __add__(self, other: "Findings") -> "Findings":
        return Findings(self.num_faults + other.num_faults, self.wrong + other.wrong)

    def check(self) -> None:
        """Raise if anything is wrong."""
        shown = "\n  ".join(self.wrong[:8])
        assert not self.wrong, f"{len(self.wrong)} of {self.num_faults} faults:\n  {shown}"


_watch = threading.local()


def _lines(frame: Any) -> Iterator[int]:
    """Lines of a frame and of those that called it."""
    for _ in range(_DEPTH):
        if frame is None:
            return
        yield frame.f_lineno
        frame = frame.f_back


@contextmanager
def unwatched() -> Iterator[None]:
    """What the test itself does meanwhile does not count."""
    depth = getattr(_watch, "depth", 0)
    _watch.depth = depth + 1
    try:
        yield
    finally:
        _watch.depth = depth


class Event:
    """An exception at the n-th use of Warp or threads, before it is carried out or directly after."""

    def __init__(self, n: int = 0, is_after: bool = False, error: type[BaseException] = Stop) -> None:
        self.n, self.is_after, self.error = n, is_after, error
        self.count = 0
        self.has_happened = False
        self.what = ""
        self.sites: dict[tuple[Any, ...], int] = {}
        self.names: list[str] = []
        self._lock = threading.Lock()

    def __str__(self) -> str:
        moment = "after" if self.is_after else "before"
        return f"{self.error.__name__} {moment} event {self.n} ({self.what})"

    def start(self) -> None:
        """Stand between the caller and Warp."""
        self._originals = [(owner, name, getattr(owner, name)) for owner, name in (*_OF_WARP, *_OF_THREADS)]
        for owner, name, original in self._originals:
            setattr(owner, name, self._watched(original, f"{owner.__name__}.{name}", owner not in _WARP))

    def stop(self) -> None:
        """Step aside."""
        for owner, name, original in self._originals:
            setattr(owner, name, original)

    def _watched(self, original: Any, name: str, is_of_threads: bool) -> Any:
        @functools.wraps(original)
        def call(*args: Any, **options: Any) -> Any:
            # what Warp does within one of its functions is that function's; a pool that starts a thread may fail there
            if getattr(_watch, "depth", 0) > 0:
                return original(*args, **options)
            with self._lock:
                self.count += 1
                is_now = self.count == self.n
                self.names.append(name)
                self.sites.setdefault((name, *_lines(sys._getframe(1))), self.count)
                if is_now:
                    self.has_happened, self.what = True, name
            if is_now and not self.is_after:
                raise self.error("injected")
            if is_of_threads:
                result = original(*args, **options)
            else:
                with unwatched():
                    result = original(*args, **options)
            if is_now:
                raise self.error("injected")
            return result

        return call


class _Signal:
    """Asks for an interrupt when its attribute is read, as SIGINT does.

    No function of Python is called for that, since Python looks for signals after each call: the interrupt arrives in
    the code that is traced, and not in the function that traces it.
    """

    trip = staticmethod(functools.partial(__import__("_thread").interrupt_main, signal.SIGINT))
    now = property(operator.methodcaller("trip"))


_SIGNAL = _Signal()


class Interrupt:
    """KeyboardInterrupt from the n-th bytecode of the library's own on, and another some bytecodes later."""

    error = KeyboardInterrupt

    def __init__(self, folders: tuple[str, ...], n: int = 0, gap: int = 0) -> None:
        self.n, self.second = n, n + gap if gap else 0
        self.count = 0
        self.has_happened = False
        self._folders = folders
        self._is_own: dict[str, bool] = {}
        self.where = ""

    def __str__(self) -> str:
        again = f" and {self.second - self.n} later" if self.second else ""
        return f"interrupt at bytecode {self.n}{again} ({self.where})"

    def start(self) -> None:
        """Trace this thread."""
        self._handler = signal.signal(signal.SIGINT, self._arrive)
        sys.settrace(self._enter)

    def stop(self) -> None:
        """Stop tracing."""
        sys.settrace(None)
        signal.signal(signal.SIGINT, self._handler)

    def _arrive(self, *_: object) -> None:
        """Raise the interrupt where a real one is raised, and go on counting."""
        sys.settrace(self._enter)
        raise KeyboardInterrupt

    def _enter(self, frame: Any, event: str, _: Any) -> Any:
        name = frame.f_code.co_filename
        is_own = self._is_own.get(name)
        if is_own is None:
            is_own = self._is_own[name] = any(folder in name for folder in (*self._folders, *_STANDARD))
        if not is_own:
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


def arrays_of(result: Any, name: str = "result") -> dict[str, np.ndarray]:
    """Copies of all arrays and numbers of a result, by name; contacts of the device in their order on the host."""
    if hasattr(result, "to_host"):
        result = result.to_host()
    if isinstance(result, (list, tuple)):
        result = dict(enumerate(result))
    if is_dataclass(result):
        # how long it took, and how often memory had to be cleared, is not the answer
        kept = [f.name for f in fields(result) if f.name not in ("counts", "timings", "num_rounds", "_step")]
        result = {key: getattr(result, key) for key in kept}
    if isinstance(result, dict):
        return {key: array for part in result for key, array in arrays_of(result[part], f"{name}.{part}").items()}
    return {name: np.array(result.numpy() if isinstance(result, wp.array) else result)}


def difference(ours: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> str:
    """The first array that differs in a bit, in words, or nothing."""
    if ours.keys() != truth.keys():
        return f"holds {sorted(ours.keys() ^ truth.keys())}"
    for name, array in ours.items():
        other = truth[name]
        if array.shape != other.shape:
            return f"{name} has shape {array.shape} instead of {other.shape}"
        if array.dtype != other.dtype or array.tobytes() != other.tobytes():
            shown = [str(values.ravel()[:1]) for values in (array, other)]
            return f"{name} differs ({shown[0]} … instead of {shown[1]} …)"
    return ""


_num_hung = 0


@contextmanager
def patience() -> Iterator[None]:
    """Raises `Hung` where the main thread waits too long, if the system has alarms."""
    global _num_hung
    if not hasattr(signal, "setitimer"):
        yield
        return

    def give_up(*_: Any) -> None:
        raise Hung("the call did not end")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE[min(_num_hung, 1)])
    try:
        yield
    except Hung:
        _num_hung += 1
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _settle() -> None:
    """A call, in which an interrupt arrives that the last bytecode asked for."""


def _disturbed(fault: Any, call: Callable[[], Any]) -> tuple[BaseException | None, Any]:
    """What the call raised, and returned, while a fault happened in it."""
    error, result = None, None
    try:
        try:
            fault.start()
            result = call()
            _settle()
        except BaseException as raised:
            error = raised
            _settle()
    except BaseException as raised:  # a second interrupt, which arrived above
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


def inject(scenario: Scenario, fault: Any, truth: dict[str, np.ndarray]) -> Findings:
    """Let one fault happen, and make the same call twice."""
    objects = scenario.fresh()
    scenario.before(objects)
    ignored: list[Any] = []
    hook, sys.unraisablehook = sys.unraisablehook, ignored.append
    try:
        with patience():
            error, result = _disturbed(fault, lambda: scenario.call(objects))
    except Hung as hung:
        error, result = hung, None
    finally:
        sys.unraisablehook = hook
    if not fault.has_happened:
        return Findings()
    wrong = []
    if error is None:
        # where memory is short a call may find another way, and Python drops what is raised in a destructor
        if fault.error is not MemoryError and not ignored:
            wrong.append("the exception did not reach the caller")
        elif found := difference(arrays_of(result), truth):
            wrong.append(f"the call itself: {found}")
    elif not _is_of(error, fault.error):
        wrong.append(f"the caller got {error!r}")
    for count in ("next", "second"):
        try:
            with patience():
                found = difference(arrays_of(scenario.call(objects)), truth)
        except (Exception, Hung) as raised:
            found = f"raised {raised!r}"
        if found:
            wrong.append(f"the {count} call: {found}")
    del error  # kept until here, with all its frames
    return Findings(1, [f"{fault}: {'; '.join(wrong)}"] if wrong else [])


def truth_of(scenario: Scenario) -> dict[str, np.ndarray]:
    """What the call answers on fresh objects; checks that it answers the same again, and after what came before."""
    truth = arrays_of(scenario.call(scenario.fresh()))
    objects = scenario.fresh()
    scenario.before(objects)
    for _ in range(2):
        found = difference(arrays_of(scenario.call(objects)), truth)
        assert not found, f"without a fault: {found}"
    return truth


def _undisturbed(scenario: Scenario, fault: Any) -> Any:
    """A fault that has counted and does not happen."""
    _count(scenario, fault)
    assert fault.count > 0, "the call has no events"
    return fault


def _count(scenario: Scenario, fault: Any) -> None:
    objects = scenario.fresh()
    scenario.before(objects)
    error, _ = _disturbed(fault, lambda: scenario.call(objects))
    assert error is None, repr(error)


def inject_events(scenario: Scenario, *, at_every_event: bool = False, every_error: bool = False) -> Findings:
    """A fault before and directly after an event: the first from each line and its callers', and some more, or every.

    Directly after an event that leaves all as before, one happens only where every event is asked for. The errors take
    turns, unless each is to happen at each event.
    """
    truth = truth_of(scenario)
    findings = Findings()
    counted = _undisturbed(scenario, Event())
    every = range(1, counted.count + 1)
    chosen = every if at_every_event else sorted({*counted.sites.values(), *every[:: max(1, counted.count // _FEWEST)]})
    for k, n in enumerate(chosen):
        is_as_before = counted.names[n - 1] in (_READING if at_every_event else _READING | _MAKING)
        for is_after in (False,) if is_as_before else (False, True):
            for error in ERRORS if every_error else (ERRORS[(k + is_after) % len(ERRORS)],):
                findings += inject(scenario, Event(n, is_after, error), truth)
    return findings


def inject_interrupts(scenario: Scenario, name: str, num_samples: int, folders: tuple[str, ...]) -> Findings:
    """Interrupts at places drawn over all bytecodes of the call, of which every third is followed by another."""
    truth = truth_of(scenario)
    _count(scenario, Interrupt(folders))  # from Python 3.12 on, bytecodes are traced from a function's second call on
    count = _undisturbed(scenario, Interrupt(folders)).count
    findings = Findings()
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    for k in range(num_samples):
        n = 1 + int((k + rng.random()) * count / num_samples)
        gap = int(10 ** rng.uniform(0.5, 3.0)) if k % 3 == 2 else 0
        findings += inject(scenario, Interrupt(folders, n, gap), truth)
    return findings
