"""Seconds of the stages of a step: on CUDA by events, which are read once the result is available."""

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

import warp as wp

_T = TypeVar("_T")


class StageTimer:
    """The time of each stage of a step.

    Attributes:
        seconds: Seconds by the name of the stage; once it is finished also their ``total``.
    """

    def __init__(self, device: wp.Device, seconds: dict[str, float]) -> None:
        """Begin with the seconds of what was done before."""
        self.seconds = seconds
        self._device = device
        self._events: list[tuple[str, wp.Event, wp.Event]] = []

    def timed(self, stage: str) -> "AbstractContextManager[None]":
        """Add the time of a block to that of a stage."""
        return self._timed_by_events(stage) if self._device.is_cuda else _Block(self.seconds, stage)

    def each(self, stage: str, items: Iterator[_T]) -> Iterator[_T]:
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

    @contextmanager
    def _timed_by_events(self, stage: str) -> Iterator[None]:
        begin_event, end_event = (wp.Event(self._device, enable_timing=True) for _ in range(2))
        stream = wp.get_stream(self._device)
        stream.record_event(begin_event)
        yield
        stream.record_event(end_event)
        self._events.append((stage, begin_event, end_event))


class _Block:
    """Adds the time of its block to that of a stage."""

    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self._seconds, self._stage = seconds, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + time.perf_counter() - self._begin
