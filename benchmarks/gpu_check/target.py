"""The device that is checked, real, emulated or the CPU in its place, and how calls on it are timed."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.emulation import emulated_device

CUDA, EMULATED, CPU = "cuda", "emulated", "cpu"
# Why a stage that needs the machine itself is left out elsewhere.
NOT_HERE = {EMULATED: "not on the emulation", CPU: "not on the CPU"}


@dataclass(frozen=True)
class Target:
    """What is checked, and how much of it.

    Attributes:
        device: Name of the Warp device.
        kind: ``"cuda"``, ``"emulated"`` (the CUDA source on the CPU) or ``"cpu"`` (a rehearsal).
        is_short: Whether small scenes and few repeats do.
    """

    device: str
    kind: str
    is_short: bool = False

    @property
    def stride(self) -> int:
        """Every which case is compared: the emulation is slow, and has tests of its own; the CPU is equal to itself."""
        return {CUDA: 1, EMULATED: 23, CPU: 5}[self.kind]

    @property
    def is_real(self) -> bool:
        """Whether it is a GPU."""
        return self.kind == CUDA

    def checked(self) -> AbstractContextManager[None]:
        """Within this, the device is the one that is checked: a GPU always is, and the CPU has to be emulated."""
        return emulated_device() if self.kind == EMULATED else nullcontext()

    def array(self, values: Any, dtype: Any) -> wp.array:
        """An array on the device."""
        real = np.float32 if dtype in (wp.vec2f, wp.vec3f, wp.float32) else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=real), dtype=dtype, device=self.device)

    def wait(self) -> None:
        """Wait for the device."""
        wp.synchronize_device(self.device)

    def is_lost(self) -> bool:
        """Whether the device answers nothing more in this process: an error of CUDA stays with it to its end."""
        try:
            if self.is_real:
                wp.zeros(1, dtype=wp.int32, device=self.device).numpy()
        except Exception:  # of whatever kind
            return True
        return False

    def free_memory(self) -> int | None:
        """Bytes of the device that nobody has reserved; None on the CPU."""
        return int(wp.get_device(self.device).free_memory) if self.is_real else None

    def seconds_on_device(self, call: Callable[[], Any], repeats: int) -> list[float]:
        """Seconds of each call on the device, between two events; on the CPU by the clock."""
        call()
        self.wait()
        if not self.is_real:
            return self.seconds_on_host(call, repeats, warm_up=False)
        device = wp.get_device(self.device)
        events = [[wp.Event(device, enable_timing=True) for _ in range(2)] for _ in range(repeats)]
        for begin, end in events:
            device.stream.record_event(begin)
            call()
            device.stream.record_event(end)
        self.wait()
        return [wp.get_event_elapsed_time(*pair) * 1e-3 for pair in events]

    def seconds_on_host(self, call: Callable[[], Any], repeats: int, *, warm_up: bool = True) -> list[float]:
        """Seconds of each call by the clock, the wait for the device included."""
        if warm_up:
            call()
            self.wait()
        seconds = []
        for _ in range(repeats):
            begin = time.perf_counter()
            call()
            self.wait()
            seconds.append(time.perf_counter() - begin)
        return seconds

    def kernel_seconds(self, call: Callable[[], Any]) -> dict[str, float]:
        """Seconds of each kernel of a call, by name, from events around every launch; empty on the CPU."""
        if not self.is_real:
            return {}
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        call()
        seconds: dict[str, float] = {}
        for result in wp.timing_end():
            name = result.name.removeprefix("forward kernel ")
            seconds[name] = seconds.get(name, 0.0) + result.elapsed * 1e-3
        return dict(sorted(seconds.items(), key=lambda item: -item[1]))


def middle(seconds: list[float]) -> dict[str, float]:
    """The median of repeats, and the least and the greatest."""
    return {"median": statistics.median(seconds), "least": min(seconds), "greatest": max(seconds)}


@contextmanager
def launched_with(block_dim: int | None):
    """Let every launch within have a number of threads a block, its own if None; the CPU has blocks of one thread."""
    launch = wp.launch
    if block_dim is None:
        yield
        return

    def with_block_dim(*arguments: Any, **options: Any) -> Any:
        return launch(*arguments, **{**options, "block_dim": block_dim})

    wp.launch = with_block_dim
    try:
        yield
    finally:
        wp.launch = launch
