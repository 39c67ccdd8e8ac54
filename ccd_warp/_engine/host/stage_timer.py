"""Seconds of the stages of a step: on CUDA by events, which are read once the result is available."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, TypeVar

import warp as wp

_T = TypeVar("_T")


class StageTimer:
    """The time of each stage of a step.

    Attributes:
        seconds: Seconds by the name of the stage; once it is finished also their ``total``.
        timed: Adds the time of a block to that of a stage.
    """

    def __init__(self, device: wp.Device) -> None:
        self.seconds = {"input": 0.0}
        self._events: list[tuple[str, wp.Event, wp.Event]] = []
        self._device = device if device.is_cuda else None
        of_device = partial(_BlockOnDevice, self._events, device) if device.is_cuda else partial(_Block, self.seconds)
        self.timed: Callable[[str], AbstractContextManager[None]] = of_device

    def now(self) -> Any:
        """This moment: on CUDA that in which the device comes to it."""
        return time.perf_counter() if self._device is None else _event_on(self._device)

    def add(self, stage: str, begin: Any, end: Any) -> None:
        """Add the time between two moments to that of a stage."""
        if self._device is not None:
            self._events.append((stage, begin, end))
        else:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + end - begin

    def timed_items(self, stage: str, items: Iterator[_T]) -> Iterator[_T]:
        """Items, while the time in which each is made is added to that of a stage."""
        while True:
            with self.timed(stage):
                item = next(items, None)
            if item is None:
                return
            yield item

    def finish(self) -> None:
        """Read the events, and sum the stages."""
        for stage, begin, end in self._events:
            seconds = 1e-3 * wp.get_event_elapsed_time(begin, end)
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        self._events.clear()
        self.seconds["total"] = sum(self.seconds.values())


class _Block:
    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self._seconds, self._stage = seconds, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + time.perf_counter() - self._begin


class _BlockOnDevice:
    def __init__(self, events: list[tuple[str, wp.Event, wp.Event]], device: wp.Device, stage: str) -> None:
        self._events, self._device, self._stage = events, device, stage

    def __enter__(self) -> None:
        self._begin = _event_on(self._device)

    def __exit__(self, *_: object) -> None:
        self._events.append((self._stage, self._begin, _event_on(self._device)))


def _event_on(device: wp.Device) -> wp.Event:
    return wp.get_stream(device).record_event(wp.Event(device, enable_timing=True))
