"""Seconds of the stages of a step: on CUDA by events, which are read once the result is available."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import partial
from operator import sub
from typing import Any, TypeVar

import warp as wp

_T = TypeVar("_T")


class StageTimer:
    """The time of each stage of a step.

    On CUDA events are those of earlier steps, where these have ended.

    Attributes:
        seconds: Seconds by the name of the stage; once it is finished also their ``total``.
        timed: Adds the time of a block to that of a stage.
        now: This moment: on CUDA that in which the device comes to it.
    """

    def __init__(self, device: wp.Device, unused: list[wp.Event]) -> None:
        """Begin a step on a device, with events that no other step uses."""
        self.seconds = {"input": 0.0}
        self._events: list[tuple[str, wp.Event, wp.Event]] = []
        self.now: Callable[[], Any] = time.perf_counter
        self.timed: Callable[[str], AbstractContextManager[None]] = partial(_Block, self.seconds)
        self._is_cuda = device.is_cuda
        if self._is_cuda:
            self._device, self._unused, self._used = device, unused, list[wp.Event]()
            self.now, self.timed = self._event, partial(_BlockOnDevice, self._events, self._event)

    def _event(self) -> wp.Event:
        event = self._unused.pop() if self._unused else wp.Event(self._device, enable_timing=True)
        self._used.append(event)
        return wp.get_stream(self._device).record_event(event)

    def add(self, stages: Sequence[str], moments: Sequence[Any]) -> None:
        """Add the times of stages, each from one moment to the next; the first has taken some already.

        Where there are too few moments, the last stages were left out, and have taken none.
        """
        seconds = self.seconds
        if self._is_cuda:
            self._events += zip(stages, moments, moments[1:], strict=False)
            seconds |= dict.fromkeys(stages[1:], 0.0)
            return
        seconds[stages[0]] += moments[1] - moments[0]
        seconds |= zip(stages[1:], map(sub, moments[2:], moments[1:]), strict=False)
        if len(seconds) < len(stages):
            seconds |= dict.fromkeys(stages, 0.0) | seconds

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
        if self._is_cuda:
            for stage, begin, end in self._events:
                seconds = 1e-3 * wp.get_event_elapsed_time(begin, end)
                self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
            self._unused += self._used
            self._events.clear()
            self._used.clear()
        self.seconds["total"] = sum(self.seconds.values())


class _Block:
    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self._seconds, self._stage = seconds, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + time.perf_counter() - self._begin


class _BlockOnDevice:
    def __init__(self, events: list[tuple[str, wp.Event, wp.Event]], now: Callable[[], wp.Event], stage: str) -> None:
        self._events, self._now, self._stage = events, now, stage

    def __enter__(self) -> None:
        self._begin = self._now()

    def __exit__(self, *_: object) -> None:
        self._events.append((self._stage, self._begin, self._now()))
