"""Stage: the tests of the package that run on a CUDA device, where their folder is at hand."""

from __future__ import annotations

import importlib.util
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check.record import Record
from ccd_warp.benchmarks.gpu_check.target import Target

# Tests with the fixture `device` have "cuda:0" in their names; the emulation and the compilation to PTX need no GPU.
_CHOSEN = "cuda and not emulated"
_WITHOUT = ("kernels/test_cuda.py", "benchmarks/test_cuda_code.py", "benchmarks/test_gpu_check.py")
_WAYS = "PASSED|FAILED|SKIPPED|ERROR|XFAIL|XPASS"
# Of pytest itself, and of pytest-xdist, which names the process and the outcome first.
_OUTCOME = re.compile(rf"^(\S+::.*?) ({_WAYS})\b|^\[gw\d+\] \[ *\d+%\] ({_WAYS}) (\S+::.*?) *$", re.MULTILINE)
_PROCESSES = 6
_PLUGIN = "ccd_warp.benchmarks.gpu_check.pytest_cubins"
_LATE = 8.0  # seconds that pytest has to stop after an interrupt


def run(target: Target, record: Record, *, tests: Path | None, **_: Any) -> None:
    """Run the tests within the time of the stage, and count how they ended."""
    if tests is None:
        record.leave_out("the tests", "their folder is not at hand; --tests names it")
        return
    if importlib.util.find_spec("pytest") is None:
        record.leave_out("the tests", "pytest is not installed")
        return
    command = [sys.executable, "-P", "-m", "pytest", str(tests), "-v", "--tb=short", "-k", _CHOSEN]
    command += ["-p", "no:cacheprovider", "-p", _PLUGIN]
    command += ["--continue-on-collection-errors", *(f"--ignore={tests / name}" for name in _WITHOUT)]
    if importlib.util.find_spec("xdist") is not None:
        command += ["-n", str(_PROCESSES)]
    process = subprocess.Popen(command, cwd=tests.parent, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    left = max(record.left() - _LATE, 1.0)
    is_cut = threading.Event()
    ends = [threading.Timer(left, lambda: (is_cut.set(), process.send_signal(signal.SIGINT)))]
    ends += [threading.Timer(left + _LATE, process.kill)]
    for timer in ends:
        timer.start()
    said, kept = "", 0.0
    record.add()
    for line in process.stdout:
        said += line
        if time.perf_counter() - kept > 1.0:  # what ends this process leaves the outcomes so far
            kept = time.perf_counter()
            record.replace(**row_of(said), last=line.strip())
    status = process.wait()
    for timer in ends:
        timer.cancel()
    if is_cut.is_set():
        record.leave_out("the tests that are not counted", "no time was left")
    record.replace(**row_of(said), status=status)
    record.say(", ".join(f"{n} {outcome.lower()}" for outcome, n in record.rows[-1]["counts"].items()) or "no test ran")


def row_of(said: str) -> dict[str, Any]:
    """What pytest has said: counts, failures, and its last words if there are any or no test ran."""
    counts, failed = outcomes(said)
    return {"counts": counts, "failed": failed, "output": said[-6000:] if failed or not counts else ""}


def outcomes(said: str) -> tuple[dict[str, int], list[str]]:
    """How many tests ended in which way, and the names of those that failed, in what ``pytest -v`` says."""
    found = [(name or other, outcome or way) for name, outcome, way, other in _OUTCOME.findall(said)]
    counts = Counter(outcome for _, outcome in found)
    counts["ERROR"] += len(re.findall(r"^ERROR (?!.*::)\S+\.py", said, re.MULTILINE))  # files that cannot be imported
    return {k: n for k, n in counts.items() if n}, [name for name, outcome in found if outcome in ("FAILED", "ERROR")]
