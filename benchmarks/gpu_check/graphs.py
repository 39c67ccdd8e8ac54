"""Stage: every kind of launch captured in a graph and replayed, on Warp's stream, on a second one, and with PyTorch."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
import warp as wp
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.steps import Step, worlds
from ccd_warp.benchmarks.gpu_check.target import Target
from laws.calls import EVERY_PER
from laws.outputs import Outputs, different, outputs_of

import ccd_warp as ccd

REPLAYS = 100
_PHASES = 2  # different motions among which the replays go round
WHERE = ("Warp's stream", "a second stream", "PyTorch")
KINDS = ("launch", *(f"line search per {per}" for per in EVERY_PER))


def cases(target: Target, **_: Any) -> Cases:
    """Every kind of launch on every stream."""
    return {f"{kind} on {where}": partial(compare, target, kind, where) for where in WHERE for kind in KINDS}


def compare(target: Target, kind: str, where: str, record: Record) -> None:
    """Capture and replay; the results must be those that the CPU gives without a graph."""
    if where != WHERE[0] and not target.is_real:
        pytest.skip(f"there is none on {target.device}")
    if where == "PyTorch":
        pytest.importorskip("torch", reason="it is not installed")
    count = 2 if target.is_short else 40
    ends, expected = answers(count, kind)
    with target.checked():
        replay(target, record, worlds(count), ends, expected, kind, where, _PHASES if target.is_short else REPLAYS)


@cache
def answers(count: int, kind: str) -> tuple[list[np.ndarray], list[Outputs]]:
    """Where a step of so many worlds may end, and what the CPU gives then."""
    step = worlds(count)
    ends = [step.start + (0.3 + 0.3 * k) * (step.end - step.start) for k in range(_PHASES)]
    return ends, [without_graph(step, end, kind) for end in ends]


def caller(pipeline: ccd.CollisionPipeline, kind: str) -> Callable[[Any, Any], ccd.LaunchResult]:
    """The call of a kind."""
    if kind == "launch":
        return pipeline.launch
    per = kind.removeprefix("line search per ")
    return lambda start, end: pipeline.launch_line_search(start, end, per=per)  # type: ignore[arg-type]


def arrays_of(result: ccd.LaunchResult, end: wp.array) -> Outputs:
    """What a launch has written."""
    return outputs_of({name: getattr(result, name) for name in ("toi", "world_toi", "flags")} | {"end": end})


def without_graph(step: Step, end: np.ndarray, kind: str) -> Outputs:
    """What the CPU gives, called directly."""
    pipeline = ccd.CollisionPipeline(step.mesh, device="cpu", **step.capacities)
    start, wished = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (step.start, end))
    result = caller(pipeline, kind)(start, wished)
    return arrays_of(result, wished)


@contextmanager
def stream_of(target: Target, where: str) -> Iterator[None]:
    """Make a stream the current one of Warp."""
    if where == "a second stream":
        stream: Any = wp.ScopedStream(wp.Stream(target.device))
    elif where == "PyTorch":
        import torch

        theirs = torch.cuda.Stream(wp.device_to_torch(target.device))
        with torch.cuda.stream(theirs), wp.ScopedStream(wp.stream_from_torch(theirs)):
            yield
        return
    else:
        stream = nullcontext()
    with stream:
        yield


def replay(
    target: Target,
    record: Record,
    step: Step,
    ends: list[np.ndarray],
    expected: list[Outputs],
    kind: str,
    where: str,
    replays: int,
) -> None:
    """Capture one kind of launch, replay it with several motions in turn, and compare with what the CPU gives.

    With PyTorch, the launch is captured on Warp's own stream while the tensors belong to PyTorch's, so that its arrays
    are asked for across streams; the replay is on PyTorch's stream.
    """
    start, wished = (wp.array(x, dtype=wp.vec3d, device=target.device) for x in (step.start, ends[0]))
    given: list[Any] = [start, wished]
    if where == "PyTorch":
        given = [wp.to_torch(array).clone() for array in (start, wished)]
        wished = wp.from_torch(given[1], dtype=wp.vec3d)
    motions = [wp.array(end, dtype=wp.vec3d, device=target.device) for end in ends]
    pipeline = ccd.CollisionPipeline(step.mesh, device=target.device, **step.capacities)
    call = caller(pipeline, kind)
    call(*given)
    target.wait()
    capture_on = nullcontext() if where == "PyTorch" else stream_of(target, where)
    with capture_on:
        wp.copy(wished, motions[0])
        with wp.ScopedCapture(device=target.device) as capture:
            result = call(*given)
    num_different = 0
    seconds = []
    with stream_of(target, where):
        for k in range(replays):
            wp.copy(wished, motions[k % len(motions)])
            target.wait()
            begin = time.perf_counter()
            wp.capture_launch(capture.graph)
            target.wait()
            seconds.append(time.perf_counter() - begin)
            if k < len(motions) or k >= replays - len(motions):
                num_different += bool(different(arrays_of(result, wished), expected[k % len(motions)]))
    record.add(
        f"{kind}, {where}: {replays} replays, {statistics.median(seconds) * 1e3:.3f} ms each",
        kind=kind,
        where=where,
        replays=replays,
        seconds=statistics.median(seconds),
    )
    if num_different:
        pytest.fail(f"{num_different} of {replays} replays differ from the CPU")
