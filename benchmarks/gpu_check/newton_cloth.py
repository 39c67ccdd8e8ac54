"""Stage: the example with newton's cloth on the device, where newton is installed and the examples are at hand."""

from __future__ import annotations

import importlib.util
import statistics
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target

_NAME = "newton_cloth"
_STEPS = 40


def cases(target: Target, *, examples: Path | None, **_: Any) -> Cases:
    """One throw."""
    return {"newton's cloth": partial(throw, target, examples)}


def throw(target: Target, examples: Path | None, record: Record) -> None:
    """Throw the cloth, bounded before every iteration; no vertex may get below the plate."""
    pytest.importorskip("newton", reason="newton is not installed")
    path = None if examples is None else examples / f"{_NAME}.py"
    if path is None or not path.exists():
        pytest.skip("the examples are not at hand; --examples names their folder")
    spec = importlib.util.spec_from_file_location(_NAME, path)
    assert spec and spec.loader
    example = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = example  # where Warp looks up the source of its kernels
    spec.loader.exec_module(example)
    cloth = example.ClothThrow("iterations", 8 if target.is_short else 24, target.device)
    seconds, below = [], 0
    for _ in range(3 if target.is_short else _STEPS):
        if seconds and record.left() < 0:
            break
        begin = time.perf_counter()
        vertices = cloth.step()
        seconds.append(time.perf_counter() - begin)
        below = max(below, example.vertices_below_plate(cloth.mesh, vertices))
    record.add(
        f"{len(seconds)} steps, {statistics.median(seconds) * 1e3:.1f} ms a step",
        steps=len(seconds),
        seconds=statistics.median(seconds),
        first=seconds[0],
    )
    if below:
        pytest.fail(f"{below} vertices got below the plate")
