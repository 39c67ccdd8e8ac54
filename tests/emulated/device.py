"""A device that is the CPU for Warp and a CUDA device for the library.

While it is emulated, a launch on the CPU runs the CUDA source of its kernel, in blocks and on threads as a device does,
and the modules of the library find that `device.is_cuda` is true, so that the host takes its path for CUDA. Warp itself
still finds a CPU: arrays lie in host memory, and sorts and scans are those of the CPU.
"""

import ctypes
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Lock
from typing import Any
from unittest import mock

import warp as wp
from warp._src import context

from emulated.build import build
from emulated.source import BLOCK_DIMS, cuda_source, emulated_source, entry_point, name_of

# What Warp takes where a launch leaves the size of a block to it.
_DEFAULT_BLOCK_DIM = 256
# The bytes of new memory, up to so many: what a kernel reads before it was written is neither zero nor plausible.
_GARBAGE, _MOST_GARBAGE = 0xCB, 1 << 24
# In the names of the kernels in which nearly all time goes: searches, culls and solvers.
_SLOW = re.compile("search_trees|search_hashes|cull_candidates|solve_pairs")
# Multiprocessors of the GPU for which the library launches as many threads as it can run at once, whatever they find.
MULTIPROCESSORS = 132


class Emulation:
    """The emulated modules, and what they have run.

    Attributes:
        is_sanitized: Whether modules are compiled with AddressSanitizer.
        watches_all: Whether races are looked for in searches, culls and solvers as well, in which nearly all time goes.
        launches: Number of launches of each kernel, by the names of its module and its own.
    """

    def __init__(self, is_sanitized: bool = False, watches_all: bool = False) -> None:
        self.is_sanitized, self.watches_all = is_sanitized, watches_all
        self.launches: Counter[tuple[str, str]] = Counter()
        self._libraries: dict[tuple[Any, bytes], ctypes.CDLL] = {}
        self._executables: dict[tuple[Any, bytes, int], _Executable] = {}
        self._lock = Lock()

    def library_of(self, module: Any) -> ctypes.CDLL:
        """The compiled program of a Warp module."""
        key = (module, _hash_of(module))
        with self._lock:
            if key not in self._libraries:
                self._libraries[key] = self._load(self._build(module))
            return self._libraries[key]

    def executable_of(self, module: Any, device: Any, block_dim: int) -> "_Executable":
        """What Warp launches of a module, for a size of blocks."""
        library = self.library_of(module)
        key = (module, _hash_of(module), block_dim)
        if key not in self._executables:
            self._executables[key] = _Executable(self, library, module, device, block_dim)
        return self._executables[key]

    def check(self) -> None:
        """Raise the error of a launch whose caller could not, as in the replay of a graph."""
        for library in self._libraries.values():
            if message := library.take_error().decode():
                raise RuntimeError(f"emulated device: {message}")

    def _build(self, module: Any) -> Path:
        is_watched = self.watches_all or not _SLOW.search(" ".join(module.kernels))
        return build(name_of(module), lambda: emulated_source(cuda_source(module)), self.is_sanitized, is_watched)

    @staticmethod
    def _load(path: Any) -> ctypes.CDLL:
        library = ctypes.CDLL(str(path))
        library.take_error.restype = ctypes.c_char_p
        return library


def _hash_of(module: Any) -> bytes:
    """What the source of a module depends on; for launches in blocks of any size it is that of its own."""
    return module.get_module_hash(module.options["block_dim"])


class _Executable(context.ModuleExec):
    """The kernels of a module; takes the place of what Warp loads for the CPU."""

    def __init__(self, emulation: Emulation, library: ctypes.CDLL, module: Any, device: Any, block_dim: int) -> None:
        module_hash, own_block_dim = _hash_of(module), module.options["block_dim"]
        hashes = module.hashers[own_block_dim].kernel_hashes
        super().__init__(None, module_hash, device, {}, own_block_dim, kernel_hashes=hashes)
        self._emulation, self._library, self._launch_block_dim = emulation, library, block_dim

    def get_kernel_hooks(self, kernel: Any) -> context.KernelHooks:
        """The function that launches a kernel."""
        name = self.get_kernel_mangled_name(kernel)
        if name not in self.kernel_hooks:
            function = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(
                (entry_point(name, self._launch_block_dim), self._library)
            )
            function.errcheck = self._checked(kernel)
            self.kernel_hooks[name] = context.KernelHooks(function, None)
        return self.kernel_hooks[name]

    def _checked(self, kernel: Any) -> Any:
        """What ctypes calls after each launch: counts it, and raises its error."""
        name, launches, library = (kernel.module.name, kernel.key), self._emulation.launches, self._library

        def check(failed: int, _function: Any, _arguments: Any) -> None:
            launches[name] += 1
            if failed:
                raise RuntimeError(f"emulated device: {kernel.key}: {library.take_error().decode()}")

        return check


class _Event:
    """Stands for an event of CUDA: launches are over when they return."""

    def __init__(self, device: Any = None, **_options: Any) -> None:
        self.time = 0.0


class _Stream:
    """Stands for the only stream of a device."""

    is_blocking = True

    def __init__(self, device: Any = None) -> None:
        self.device = wp.get_device(device)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Stream) and self.device == other.device

    def __hash__(self) -> int:
        return hash(str(self.device))

    def record_event(self, event: _Event) -> _Event:
        """Remember the time."""
        event.time = time.perf_counter()
        return event


def _is_asked_by_library() -> bool:
    """Whether the function that calls the caller belongs to the library."""
    return sys._getframe(2).f_globals.get("__name__", "").partition(".")[0] == "ccd_warp"


def _patches(emulated: Emulation, num_multiprocessors: int) -> list[Any]:
    """What lets the kernels of the CPU run as on a CUDA device, from `start()` to `stop()`."""
    from ccd_warp.kernels.narrow_phase import queued_launch

    from ccd_warp._engine import stages  # with what only CUDA launches

    wp.init()  # which describes the devices as they are
    load, resolve, stream = context.Module.load, context._resolve_launch_block_dim, context.Device.stream
    numpy, allocate = wp.array.numpy, context.CpuDefaultAllocator.allocate

    def of_device(most: int) -> int:
        """Threads of a launch that a device of this size runs at once."""
        return most * num_multiprocessors // MULTIPROCESSORS // queued_launch.WARP * queued_launch.WARP

    def stream_of(device: Any) -> Any:
        return _Stream(device) if _is_asked_by_library() and device.ordinal < 0 else stream.fget(device)

    def captures_of(device: Any) -> Any:
        """Streams that are captured: on the CPU that is the whole device."""
        if _is_asked_by_library() and device.ordinal < 0:
            return [_Stream(device)] if device.is_capturing else []
        return vars(device)["captures"]

    def block_dim_of(device: Any, block_dim: int | None) -> int:
        if not device.is_cpu:
            return resolve(device, block_dim)
        asked = int(block_dim or 0)
        if asked > 1 and asked not in BLOCK_DIMS:
            raise ValueError(f"block_dim is {asked}; expected one of {BLOCK_DIMS}, for which there are entry points")
        return asked if asked > 1 else _DEFAULT_BLOCK_DIM

    def load_emulated(module: Any, device: Any, block_dim: int | None = None, *rest: Any, **named: Any) -> Any:
        device = wp.get_device(device)
        if not device.is_cpu:
            return load(module, device, block_dim, *rest, **named)
        return emulated.executable_of(module, device, block_dim_of(device, block_dim))

    def copied(array: wp.array) -> Any:
        """On a device the host gets a copy, which does not follow what kernels write."""
        return numpy(array).copy() if _is_asked_by_library() else numpy(array)

    def allocate_garbage(allocator: Any, size: int) -> Any:
        place = allocate(allocator, size)
        if place:
            ctypes.memset(place, _GARBAGE, min(size, _MOST_GARBAGE))
        return place

    solvers = {stage: of_device(most) for stage, most in queued_launch.MOST_SOLVERS.items()}
    replaced = (
        (context.Device, "is_cuda", property(lambda device: _is_asked_by_library() or device.ordinal >= 0)),
        (context.Device, "is_cpu", property(lambda device: not _is_asked_by_library() and device.ordinal < 0)),
        (context.Device, "stream", property(stream_of)),
        (context.Device, "captures", property(captures_of)),
        (context, "_resolve_launch_block_dim", block_dim_of),
        (context.Module, "load", load_emulated),
        (context.CpuDefaultAllocator, "allocate", allocate_garbage),
        (wp.array, "numpy", copied),
        (stages, "_MOST_CULLS", of_device(stages._MOST_CULLS)),
        (stages, "_MOST_REST", of_device(stages._MOST_REST)),
        (wp, "Event", _Event),
        (wp, "get_stream", _Stream),
        (wp, "is_conditional_graph_supported", lambda: True),
        (wp, "get_event_elapsed_time", lambda begin, end, *_: 1e3 * (end.time - begin.time)),
    )
    patches = [mock.patch.object(*each, create=True) for each in replaced]
    return [mock.patch.dict(queued_launch.MOST_SOLVERS, solvers), *patches]


@contextmanager
def emulation(emulated: Emulation | None = None, num_multiprocessors: int = 4) -> Iterator[Emulation]:
    """Run the kernels of the CPU as on a CUDA device, until the end of the block.

    Meshes and pipelines keep what they have recorded for a device: those of the block and others must not be mixed.

    Args:
        emulated: The emulated modules; those that all blocks share by default.
        num_multiprocessors: How many threads the library launches at most where only the device knows how many have
            work. With a few, threads of small scenes take several turns and few threads take none; with
            ``MULTIPROCESSORS`` nearly all take none, on which the emulation would spend most of its time.

    Raises:
        RuntimeError: If a launch of a graph failed.
    """
    emulated = emulated or SHARED
    with ExitStack() as stack:
        for patch in _patches(emulated, num_multiprocessors):
            stack.enter_context(patch)
        yield emulated
    emulated.check()


# What all blocks share: sanitized in a process that has loaded the library for that.
SHARED = Emulation(is_sanitized="libasan" in os.environ.get("LD_PRELOAD", ""))
# What is replaced while a whole run of the tests is on the emulated device.
_of_run: list[Any] = []


def begin_run() -> None:
    """Emulate the device until `end_run()`."""
    _of_run[:] = _patches(SHARED, 4)
    for patch in _of_run:
        patch.start()


def end_run() -> None:
    """End the emulation of a whole run, if there is one."""
    for patch in reversed(_of_run):
        patch.stop()
    if _of_run:
        _of_run.clear()
        SHARED.check()


@contextmanager
def on_the_other_device() -> Iterator[None]:
    """The CPU for a while; where all runs on the CPU, the emulated device."""
    if wp.get_device().ordinal >= 0:
        with wp.ScopedDevice("cpu"):
            yield
    elif _of_run:
        end_run()
        yield
        begin_run()
    else:
        with emulation():
            yield
