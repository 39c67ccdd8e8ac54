"""Launch a kernel over a range: at once on CUDA, in disjoint parts on Python threads on the CPU.

Warp runs a CPU kernel serially and releases the GIL meanwhile, so disjoint ranges on Python threads run in parallel.
Every kernel launched here takes ``begin: int`` as its first parameter and works on item ``begin + wp.tid()``.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, make_dataclass
from functools import partial
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.kernel_cache import is_current, load_or_repair
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.packed import PackedLaunch
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.quiet import quietly
from ccd_warp._runtime.streams import is_captured_by_library
from ccd_warp._runtime.threads import StopFlag, run, run_aside, run_side_by_side
from ccd_warp.kernels.once import building, uncollected

# Largest number of items in a part of a kernel that does little work for each: some 20 ms.
_MOST_ITEMS = 1 << 19
# Parts of few items each that mostly take no longer one by one than waking a thread for some of them, and the seconds
# after which it pays all the same.
_FEW_PARTS, _WAKING = 8, 2e-4

_loaded: set[tuple[Any, str]] = set()


def block_dim_of(kernel: wp.Kernel, device: wp.Device) -> int | None:
    """Threads of a block in launches of a kernel: what its module says, 256 for most; Warp's own choice on the CPU."""
    return kernel.module.options["block_dim"] if device.is_cuda else None


def load(kernel: wp.Kernel, device: wp.Device, progress: Progress | None = None) -> None:
    """Compile and load a kernel once, on another thread, so that an interrupt is handled meanwhile."""
    load_all([kernel], device, progress)


def load_all(kernels: Iterable[Any], device: wp.Device, progress: Progress | None = None) -> None:
    """Compile and load kernels once, their modules side by side; what takes longest comes first.

    How many of them are ready is told to ``progress``, which then goes on with its stage.
    """
    wanted = {(kernel.module, str(device)): kernel for kernel in kernels}
    missing = {key: kernel for key, kernel in wanted.items() if key not in _loaded or not is_current(key[0], device)}
    if not missing:
        return

    progress = progress or Progress()
    stage = progress.stage, progress.total, progress.done
    progress.begin("compiling kernels", len(missing))

    def load_module(kernel: wp.Kernel) -> None:
        load_or_repair(kernel, device, block_dim_of(kernel, device))
        progress.done += 1

    tasks = [lambda k=kernel: load_module(k) for kernel in missing.values()]
    if device.is_capturing:  # Warp allows it only on the thread of the capture
        with building, uncollected(), quietly():
            for task in tasks:
                task()
    else:
        build_side_by_side(tasks, progress)
    progress.begin(*stage)
    _loaded.update(missing)


def build_side_by_side(tasks: Sequence[Callable[[], None]], progress: Progress) -> None:
    """Compile modules side by side on other threads, while this one waits, shows progress and handles an interrupt."""

    def build() -> None:
        with building, uncollected(), quietly():
            run_side_by_side(tasks)

    try:
        run_aside(build, progress.tick)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("while kernels were compiled, which the next call goes on with") from None


@dataclass(frozen=True)
class Execution:
    """The device and the number of threads on which to run.

    Attributes:
        device: Warp device.
        num_threads: Threads on the CPU.
        flag: The flag that long kernels read to stop early, or None where no such kernel is launched.
        progress: Told how far a long job is, ten times a second, on the thread that waits for it.
        may_be_captured: Whether launches may be those of a graph that is captured.
    """

    device: wp.Device
    num_threads: int
    flag: StopFlag | None = None
    progress: Progress = field(default_factory=Progress)
    may_be_captured: bool = True

    @lazy_property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.device.is_cuda

    def launch(
        self,
        kernel: wp.Kernel,
        count: int,
        inputs: list,
        outputs: list,
        grain: int = 1024,
        parts_per_thread: int = 1,
        *,
        num_needed: Callable[[], int] | None = None,
        is_long: Callable[[], bool] | None = None,
    ) -> None:
        """Run ``kernel`` for items 0 … count-1.

        Args:
            kernel: Warp kernel whose first parameter is ``begin: int``.
            count: Number of items; nothing is launched for zero.
            inputs: Kernel inputs after ``begin``.
            outputs: Kernel outputs.
            grain: Smallest number of items that is worth its own part.
            parts_per_thread: Parts for each thread.
            num_needed: Called on the CPU outside a capture: how many of the parts, from the first on, have anything to
                do.
            is_long: Called on the CPU outside a capture: whether items may take long, in which case the kernel reads
                the stop flag.
        """
        if count == 0:
            return
        load(kernel, self.device, self.progress)

        def part(begin: int, end: int) -> None:
            block_dim = block_dim_of(kernel, self.device)
            dim, packed = end - begin, [begin, *inputs]
            wp.launch(
                kernel,
                dim=dim,
                inputs=packed,
                outputs=outputs,
                device=self.device,
                block_dim=block_dim,
                record_tape=False,
            )

        if self.is_serial:
            part(0, count)
            return
        parts = self.ranges(count, grain, parts_per_thread)
        needed = parts if num_needed is None else parts[: num_needed()]
        if not needed:
            return
        tasks = [lambda b=b, e=e: part(b, e) for b, e in needed]  # type: ignore[misc]
        self.run(tasks, is_long=is_long is not None and is_long())

    @staticmethod
    def struct(of: "StructFields") -> Any:
        """A struct as :meth:`launch` takes it; none of its fields is a slot."""
        return of.packed({})

    def call(self, function: Callable[[], None]) -> None:
        """Call a function that launches kernels of Warp's own."""
        function()

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """A group of launches that may run side by side; those that run now do so one after another."""
        yield

    @property
    def is_serial(self) -> bool:
        """Whether this thread launches all: on CUDA, and in a capture on the CPU, which records only this thread."""
        return self.is_cuda or (self.may_be_captured and self.device.is_capturing)

    def ranges(self, count: int, grain: int, parts_per_thread: int = 1) -> list[tuple[int, int]]:
        """Parts of 0 … count-1 for the threads, none much smaller than ``grain``, none so large that it takes long."""
        parts = 1
        if not self.is_cuda:
            parts = max(1, min(self.num_threads * parts_per_thread, count // grain), -(-count // _MOST_ITEMS))
        return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))

    def run(self, tasks: Sequence[Callable[[], Any]], *, is_long: bool = False) -> list[Any]:
        """Call the tasks, at most ``num_threads`` at a time, and return their results in order once all have ended.

        Long tasks run on other threads, while this one waits and handles an interrupt.
        """
        if self.is_serial:
            return [task() for task in tasks]
        return run(tasks, self.num_threads, self.flag, is_long=is_long, tick=self.progress.tick)


@dataclass(frozen=True)
class Slot:
    """A named argument of a recording, set by :meth:`Recording.bind`."""

    name: str


@dataclass(frozen=True)
class StructFields:
    """A struct of kernels by its fields, some of which may be slots of a recording; a subclass names both.

    Attributes:
        struct: The struct, a class of Warp.
    """

    struct: ClassVar[Any]

    def packed(self, values: dict[str, Any]) -> Any:
        """The struct, with values in place of slots; a field whose value is None is as it is in a new one."""
        packed = self.struct()
        for name, value in self._given():
            value = values[value.name] if isinstance(value, Slot) else value
            if value is not None:
                setattr(packed, name, value)
        return packed

    def slots(self) -> list[tuple[str, str]]:
        """The fields that are slots, and the names of these."""
        return [(name, value.name) for name, value in self._given() if isinstance(value, Slot)]

    def _given(self) -> list[tuple[str, Any]]:
        return [(each.name, getattr(self, each.name)) for each in fields(self)]


def fields_of(struct: Any) -> Any:
    """A class of `StructFields` for a struct of Warp, whose arguments are the fields in their order."""
    named: dict[str, Any] = {"bases": (StructFields,), "namespace": {"struct": struct}, "frozen": True}
    return make_dataclass(f"{struct.cls.__name__}Fields", list(struct.vars), **named)


@dataclass(eq=False)
class _PackedStruct:
    """A struct in a recording, and the launches that have it."""

    of: StructFields
    packed: Any
    uses: list[tuple[PackedLaunch, int]] = field(default_factory=list)


@dataclass(frozen=True)
class _Call:
    """A function that launches kernels of Warp's own, in place of a launch."""

    launch: Callable[[], None]
    num_parts: ClassVar[int] = 1

    def parts(self) -> list[Callable[[], None]]:
        """The function, which has no parts."""
        return [self.launch]


@dataclass(frozen=True)
class _Launch:
    """A launch, with how many of its parts are needed, and whether they may take long."""

    packed: PackedLaunch | _Call
    is_large: bool = False  # at least as many items as are worth a part
    num_needed: Callable[[], int] | None = None
    is_long: Callable[[], bool] | None = None

    @property
    def is_short(self) -> bool:
        """Whether it is one part, which is always needed and never takes long."""
        return self.packed.num_parts == 1 and self.num_needed is None and self.is_long is None


@dataclass(frozen=True)
class _Conditional:
    """Launches that have nothing to do where a flag on the device is 0."""

    condition: wp.array  # int32, the first element
    on_host: NDArray[np.int32] | None  # the same as a NumPy array; None on CUDA
    groups: "list[_Group]"


_Group = list[_Launch] | _Conditional


def leaves_out_launches(device: wp.Device) -> bool:
    """Whether the graph that is captured on a device can leave out launches by a flag.

    On CUDA that takes a driver from 12.4 on and a capture that Warp has begun. It would wait for the flag in one that
    it does not know, and end that of another library for each branch.
    """
    if device.is_cpu:
        return True
    is_begun_here = device.stream in device.captures and not is_captured_by_library(device.stream)
    return is_begun_here and wp.is_conditional_graph_supported()


class Recording:
    """Launches that are packed once and then repeated, in the order in which they were given.

    They form sections, which are played one by one. Launches within :meth:`at_once` do not depend on each other.
    """

    def __init__(self, execution: Execution, values: dict[str, Any]) -> None:
        """``values`` are the initial values of the slots."""
        self.execution = execution
        self.values = dict(values)
        self._sections: dict[str, list[_Group]] = {}
        self._calls: dict[str, list[Callable[[], None]]] = {}  # what plays sections on the CPU
        self._groups: list[_Group] = []  # of the section that is recorded
        self._is_at_once = False
        self._uses: dict[str, list[tuple[PackedLaunch, int]]] = {name: [] for name in values}
        self._structs: list[_PackedStruct] = []
        self._changed: list[_PackedStruct] = []
        self._field_uses: dict[str, list[tuple[_PackedStruct, str]]] = {name: [] for name in values}

    @property
    def device(self) -> Any:
        """Warp device."""
        return self.execution.device

    @property
    def progress(self) -> Progress:
        """What is told how far a long job is."""
        return self.execution.progress

    @lazy_property
    def is_cuda(self) -> bool:
        """True on a CUDA device."""
        return self.execution.is_cuda

    @property
    def num_threads(self) -> int:
        """Threads on the CPU."""
        return self.execution.num_threads

    def __contains__(self, section: str) -> bool:
        return section in self._sections

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """Record launches as a section."""
        self._groups = []
        yield
        self._sections[name], self._groups = self._groups, []

    @contextmanager
    def only_if(self, condition: wp.array) -> Iterator[None]:
        """Record launches that have nothing to do where a flag on the device is 0, so that they may be left out.

        Args:
            condition: The flag, int32, in the first element, as it is when the launches would begin.
        """
        outer, self._groups = self._groups, []
        yield
        on_host = None if self.execution.device.is_cuda else condition.numpy()
        outer.append(_Conditional(condition, on_host, self._groups))
        self._groups = outer

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Record launches that threads may run concurrently."""
        self._groups.append([])
        self._is_at_once = True
        yield
        self._is_at_once = False

    def launch(
        self,
        kernel: wp.Kernel,
        count: int,
        inputs: list,
        outputs: list,
        grain: int = 1024,
        parts_per_thread: int = 1,
        *,
        num_needed: Callable[[], int] | None = None,
        is_long: Callable[[], bool] | None = None,
    ) -> None:
        """Record a launch; the arguments are those of :meth:`Execution.launch`, and may include slots."""
        if count == 0:
            return
        load(kernel, self.execution.device, self.progress)
        arguments = [*inputs, *outputs]
        structs = {i: self._struct_of(a) for i, a in enumerate(arguments) if isinstance(a, StructFields)}
        values = [structs[i].packed if i in structs else a for i, a in enumerate(arguments)]
        command: Any = wp.launch(
            kernel,
            dim=count,
            inputs=[0, *(self.values[a.name] if isinstance(a, Slot) else a for a in values)],
            device=self.execution.device,
            record_cmd=True,
            record_tape=False,
            block_dim=block_dim_of(kernel, self.execution.device),
        )
        packed = PackedLaunch(command, self.execution.ranges(count, grain, parts_per_thread))
        for index, argument in enumerate(arguments):
            if isinstance(argument, Slot):
                self._uses[argument.name].append((packed, index + 1))
        for index, struct in structs.items():
            struct.uses.append((packed, index + 1))
        self._add(_Launch(packed, count >= grain > 1, num_needed, is_long))

    @staticmethod
    def struct(of: StructFields) -> StructFields:
        """A struct as :meth:`launch` takes it: by its fields, of which some may be slots."""
        return of

    def _struct_of(self, of: StructFields) -> _PackedStruct:
        """The struct with these fields: one for all launches that are given the same object."""
        for known in self._structs:
            if known.of is of:
                return known
        struct = _PackedStruct(of, of.packed(self.values))
        self._structs.append(struct)
        for name, slot in of.slots():
            self._field_uses[slot].append((struct, name))
        return struct

    def call(self, function: Callable[[], None]) -> None:
        """Record a call of a function that launches kernels of Warp's own."""
        self._add(_Launch(_Call(function)))

    def _add(self, launch: _Launch) -> None:
        if not self._is_at_once:
            self._groups.append([])
        group = self._groups[-1]
        assert isinstance(group, list)
        group.append(launch)

    def bind(self, name: str, value: Any) -> None:
        """Set a slot to an array, a struct or a number."""
        before = self.values[name]
        if value is before or (isinstance(value, float | int) and value == before):
            return
        self.values[name] = None  # no value counts as bound while only some launches have the new one
        for launch, index in self._uses[name]:
            launch.bind(index, value)
        for struct, of_struct in self._field_uses[name]:
            setattr(struct.packed, of_struct, value)
            if struct not in self._changed:
                self._changed.append(struct)
        self.values[name] = value

    def play(self, section: str) -> None:
        """Launch a section: on the CPU on threads, unless a graph is captured, which records only this thread."""
        self.update_structs()
        if self.execution.is_serial:
            self._play_serially(self._sections[section])
            return
        calls = self._calls.get(section)
        if calls is None:
            calls = self._calls[section] = self._calls_of(section, self._sections[section])
        for call in calls:
            call()

    def update_structs(self) -> None:
        """Let launches have what was bound to fields of their structs, within a section that is played."""
        while self._changed:
            struct = self._changed[-1]
            for launch, index in struct.uses:
                launch.bind(index, struct.packed)
            self._changed.pop()

    def _play_serially(self, groups: list[_Group]) -> None:
        for group in groups:
            if isinstance(group, _Conditional):
                self._play_conditional(group)
            else:
                for each in group:
                    each.packed.launch()

    def _play_conditional(self, group: _Conditional) -> None:
        """Launch what may be left out: as a branch of a graph; by the flag on the CPU; in any case otherwise on CUDA.

        There the host would have to wait for the flag, and the kernels find out by themselves.
        """
        device = self.execution.device

        def play() -> None:
            self._play_serially(group.groups)

        if device.is_capturing and leaves_out_launches(device):
            wp.capture_if(group.condition, on_true=play)
        else:
            play()

    def _calls_of(self, section: str, groups: list[_Group]) -> list[Callable[[], None]]:
        """What plays groups on the CPU, not in a capture: parts of launches, where these are not worth a thread."""
        calls: list[Callable[[], None]] = []
        for group in groups:
            if isinstance(group, _Conditional):
                assert group.on_host is not None
                calls.append(partial(_call_if, group.on_host, self._calls_of(section, group.groups)))
            elif (len(group) > 1 and any(each.is_large for each in group)) or not all(each.is_short for each in group):
                of_each = [(each.packed.parts(), each.num_needed, each.is_long, each.is_large) for each in group]
                calls.append(partial(self._play_on_threads, section, of_each))
            else:
                calls += [part for each in group for part in each.packed.parts()]
        return calls

    def _play_on_threads(self, section: str, group: list[tuple[Any, ...]]) -> None:
        """Launch what is needed of a group at once, on this thread alone where no other is worth waking."""
        parts: list[Callable[[], None]] = []
        is_long = is_worth_threads = False
        for needed, num_needed, takes_long, is_large in group:
            if num_needed is not None:
                needed = needed[: num_needed()]
            if needed:
                parts += needed
                is_long = is_long or (takes_long is not None and takes_long())
                is_worth_threads = is_worth_threads or is_large
        if not is_long and (len(parts) <= 1 or (len(parts) <= _FEW_PARTS and not is_worth_threads)):
            parts = _left_after(parts, _WAKING)
            if not parts:
                return
        progress = self.progress
        progress.begin(section, len(parts))

        def run(part: Callable[[], None]) -> None:
            part()
            progress.done += 1

        self.execution.run([lambda p=p: run(p) for p in parts], is_long=is_long)  # type: ignore[misc]


def _left_after(parts: list[Callable[[], None]], seconds: float) -> list[Callable[[], None]]:
    """Call them one by one for so long; returns those that are left."""
    end = perf_counter() + seconds
    for k, part in enumerate(parts, 1):
        part()
        if perf_counter() > end:
            return parts[k:]
    return []


def _call_if(condition: NDArray[np.int32], calls: list[Callable[[], None]]) -> None:
    """Call them where a flag is not 0."""
    if condition[0]:
        for call in calls:
            call()
