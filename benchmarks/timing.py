"""Times of calls in interleaved rounds: each round makes every call, so that all of them meet the same noise."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

Name = TypeVar("Name")
Times = dict[Name, list[float]]

_MOST_CALLS = 100
_LONG = 0.25  # seconds


def interleaved(
    calls: dict[Name, Callable[[], Any]],
    rounds: int,
    *,
    budget: float = 0.0,
    is_settled: bool = False,
    fill: float = 0.0,
    clock: Callable[[], float] = time.perf_counter,
    wait: Callable[[], Any] = lambda: None,
    after: Callable[[Name, Any], Any] = lambda name, result: None,
) -> Times:
    """Seconds of each call in each round.

    Args:
        calls: The calls by name, in the order in which a round makes them. Each is made once before the first round.
        rounds: Number of rounds, the least one with a budget.
        budget: Seconds in which further rounds are begun.
        is_settled: Whether each call below a quarter of a second is made twice in a row, and the second timed: threads
            of the library that ran before spin for a while, and the caches hold its data.
        fill: Seconds that a short call is repeated for, of which the mean counts; 0 for a single call.
        clock: The time in seconds: of the wall, or of the processor.
        wait: Waits for a device; called before and after what is timed.
        after: Called with the name and the result of each timed call.
    """
    repeats, is_short = {}, {}
    for name, call in calls.items():
        begin = time.perf_counter()
        call()
        is_short[name] = time.perf_counter() - begin < _LONG
        begin = time.perf_counter()
        if fill:
            call()
        repeats[name] = int(min(max(fill / max(time.perf_counter() - begin, 1e-9), 1), _MOST_CALLS)) if fill else 1
    seconds: Times = {name: [] for name in calls}
    end = time.perf_counter() + budget
    done = 0
    while done < rounds or time.perf_counter() < end:
        for name, call in calls.items():
            if is_settled and is_short[name]:
                call()
            wait()
            begin = clock()
            for _ in range(repeats[name]):
                result = call()
            wait()
            seconds[name].append((clock() - begin) / repeats[name])
            after(name, result)
        done += 1
    return seconds


def medians(seconds: Times) -> dict[Name, float]:
    """The median of the rounds of each call."""
    return {name: statistics.median(values) for name, values in seconds.items()}


def quartiles(values: list[float]) -> list[float]:
    """The first and the third."""
    return [float(x) for x in np.percentile(values, [25, 75])]


def figures(seconds: Times) -> dict[str, dict]:
    """What a raw file has of times: the medians, and the quartiles."""
    return {"seconds": medians(seconds), "quartiles": {name: quartiles(v) for name, v in seconds.items()}}
