"""Stage: a small scene under NVIDIA's compute-sanitizer, where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target

_TOOLS = ("memcheck", "racecheck", "initcheck", "synccheck")
_PLACES = ("/usr/local/cuda/bin/compute-sanitizer", "/opt/cuda/bin/compute-sanitizer")
_SCENE = "ccd_warp.benchmarks.gpu_check.small_scene"
_SUMMARY = re.compile(r"(?:ERROR|RACECHECK) SUMMARY: .*")


def run(target: Target, record: Record, **_: Any) -> None:
    """Run the scene under each tool that there is time for; memory first."""
    tool = shutil.which("compute-sanitizer") or next((path for path in _PLACES if Path(path).exists()), None)
    if tool is None:
        record.leave_out("compute-sanitizer", "it is not installed")
        return
    for name in _TOOLS:
        if not record.begins(name, 2.0):
            continue
        command = [tool, "--tool", name, "--error-exitcode", "3", sys.executable, "-P", "-m", _SCENE, target.device]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=record.left())
        except subprocess.TimeoutExpired:
            record.leave_out(name, "the scene took longer than there was time")
            continue
        said = done.stdout + done.stderr
        summary = summary_of(said)
        record.add(
            f"{name}: {summary}",
            tool=name,
            summary=summary,
            status=done.returncode,
            output="" if done.returncode == 0 else said[-4000:],
        )


def summary_of(said: str) -> str:
    """The line that sums up what the tool found."""
    found = _SUMMARY.findall(said)
    return found[-1] if found else "it did not come to an end"
