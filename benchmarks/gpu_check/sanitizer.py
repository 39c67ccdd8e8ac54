"""Stage: a small scene under NVIDIA's compute-sanitizer, where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ccd_warp.benchmarks.gpu_check.record import Cases, Record
from ccd_warp.benchmarks.gpu_check.target import Target

_TOOLS = ("memcheck", "racecheck", "initcheck", "synccheck")
_PLACES = ("/usr/local/cuda/bin/compute-sanitizer", "/opt/cuda/bin/compute-sanitizer")
_SCENE = "ccd_warp.benchmarks.gpu_check.small_scene"
_SUMMARY = re.compile(r"(?:ERROR|RACECHECK) SUMMARY: .*")


def cases(target: Target, **_: Any) -> Cases:
    """The tools, memory first."""
    return {name: partial(run_scene, target, name) for name in _TOOLS}


def run_scene(target: Target, name: str, record: Record) -> None:
    """Run the scene under a tool."""
    tool = shutil.which("compute-sanitizer") or next((path for path in _PLACES if Path(path).exists()), None)
    command = [
        tool or pytest.skip("compute-sanitizer is not installed"),
        *("--tool", name, "--error-exitcode", "3", sys.executable, "-P", "-m", _SCENE, target.device),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=record.left())
    except subprocess.TimeoutExpired:
        pytest.skip("the scene took longer than there was time")
    said = done.stdout + done.stderr
    summary = summary_of(said)
    record.add(f"{name}: {summary}", tool=name, summary=summary, status=done.returncode)
    if done.returncode != 0:
        pytest.fail(f"{said[-1500:]}\n{summary}")


def summary_of(said: str) -> str:
    """The line that sums up what the tool found."""
    found = _SUMMARY.findall(said)
    return found[-1] if found else "it did not come to an end"
