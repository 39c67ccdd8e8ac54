"""Stage: every kind of launch captured in a graph and replayed, on Warp's stream, on a second one, and with PyTorch."""

from __future__ import annotations

import importlib.util
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check.calls import EVERY_PER
from ccd_warp.benchmarks.gpu_check.outputs import Outputs, different, outputs_of
from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.steps import Step, worlds
from ccd_warp.benchmarks.gpu_check.target import Target

import ccd_warp as ccd

REPLAYS = 100
_PHASES = 2  # different motions among which the replays go round
KINDS = ("launch", *(f"line search per {per}" for per in EVERY_PER))


def run(target: Target, record: Record, **_: Any) -> None:
    """Capture and replay; the results must be those that the CPU gives without a graph."""
    count = 2 if target.is_short else 40
    replays = _PHASES if target.is_short else REPLAYS
    step = worlds(count)
    ends = [step.start + (0.3 + 0.3 * k) * (step.end - step.start) for k in range(_PHASES)]
    expected = {kind: [without_graph(step, end, kind) for end in ends] for kind in KINDS}
    step = worlds(count)  # a mesh keeps what it was used with
    with target.checked():
        for where in ("Warp's stream", "a second stream", "PyTorch"):
            if where != "Warp's stream" and not target.is_real:
                record.leave_out(where, f"there is none on {target.device}")
                continue
            if where == "PyTorch" and importlib.util.find_spec("torch") is None:
                record.leave_out(where, "it is not installed")
                continue
            for kind in KINDS:
                if record.begins(f"{kind} on {where}"):
                    try:
                        replay(target, record, step, ends, expected[kind], kind, where, replays)
                    except Exception as error:  # the other kinds are worth a try
                        target.check_alive()
                        said = f"{type(error).__name__}: {error}"[:2000]
                        record.add(f"FAILED {kind}, {where}: {said}", kind=kind, where=where, failed=said)


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
        f"{kind}, {where}: {replays} replays, {num_different} differ, {statistics.median(seconds) * 1e3:.3f} ms each",
        kind=kind,
        where=where,
        replays=replays,
        different=num_different,
        seconds=statistics.median(seconds),
    )
