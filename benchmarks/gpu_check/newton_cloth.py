"""Stage: the example with newton's cloth on the device, where newton is installed and the examples are at hand."""

from __future__ import annotations

import importlib.util
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target

_NAME = "newton_cloth"
_STEPS = 40


def run(target: Target, record: Record, *, examples: Path | None, **_: Any) -> None:
    """Throw the cloth, bounded before every iteration; no vertex may get below the plate."""
    if importlib.util.find_spec("newton") is None:
        record.leave_out("newton's cloth", "newton is not installed")
        return
    path = None if examples is None else examples / f"{_NAME}.py"
    if path is None or not path.exists():
        record.leave_out("newton's cloth", "the examples are not at hand; --examples names their folder")
        return
    spec = importlib.util.spec_from_file_location(_NAME, path)
    assert spec and spec.loader
    example = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = example  # where Warp looks up the source of its kernels
    spec.loader.exec_module(example)
    throw = example.ClothThrow("iterations", 8 if target.is_short else 24, target.device)
    seconds, below = [], 0
    for _ in range(3 if target.is_short else _STEPS):
        if not record.has_time(f"steps after the first {len(seconds)}"):
            break
        begin = time.perf_counter()
        vertices = throw.step()
        seconds.append(time.perf_counter() - begin)
        below = max(below, example.vertices_below_plate(throw.mesh, vertices))
    if seconds:
        record.add(
            f"{len(seconds)} steps, {statistics.median(seconds) * 1e3:.1f} ms a step, "
            f"at most {below} vertices below the plate",
            steps=len(seconds),
            seconds=statistics.median(seconds),
            first=seconds[0],
            below=below,
        )
