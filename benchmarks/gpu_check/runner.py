"""Runs the stages one after another, each in a process of its own, and keeps the file of records up to date.

What ends a stage ends nothing else: an error of CUDA stays with a process to its end, and a kernel that hangs can only
be ended with its process. A rehearsal without a GPU runs all stages in this process, which is faster.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check.record import DONE, FAILED, FILE, LEFT_OUT, STOPPED, Record, read_json, write_json
from ccd_warp.benchmarks.gpu_check.stages import STAGES, Stage
from ccd_warp.benchmarks.gpu_check.target import NOT_HERE, Target

_PARTIAL = "gpu_check.stage.json"
_GRACE = 10.0  # seconds beyond its time after which the process of a stage is ended
_START = 4.0  # seconds until a process has loaded the package and made a context


class Journal:
    """The file of all records.

    Attributes:
        raw: Its contents: settings, and the record of each stage that has ended, by name.
        note: What was done about a file of an earlier run.
    """

    def __init__(self, folder: Path, settings: dict[str, Any], *, is_anew: bool) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / FILE
        before = read_json(self.path)
        self.raw: dict[str, Any] = {"settings": settings, "stages": {}}
        self.note = ""
        if not isinstance(before, dict) or "stages" not in before:
            return
        if before.get("settings") == settings and not is_anew:
            kept = {name: stage for name, stage in before["stages"].items() if stage["status"] == DONE}
            self.raw["stages"] = kept
            self.note = f"{self.path} is of the same check: {len(kept)} stages are kept (--again measures all anew)"
        else:
            old = self.path.with_suffix(".old.json")
            os.replace(self.path, old)
            self.note = f"{self.path} was of another run, and is {old.name} now"

    def put(self, name: str, record: dict) -> None:
        """Keep the record of a stage."""
        self.raw["stages"][name] = record
        write_json(self.path, self.raw)


def run_all(
    target: Target,
    arguments: dict[str, Any],
    journal: Journal,
    chosen: list[str],
    seconds: float,
    say: Callable[[str], None],
) -> None:
    """Run the stages that are chosen and not kept, within a time for all.

    Args:
        target: What is checked.
        arguments: What the stages are told beside it.
        journal: Where the records go.
        chosen: Names of stages.
        seconds: The time for all. Each stage gets its share of what is left.
        say: Called with each line for people.
    """
    end = time.perf_counter() + seconds
    pending = [stage for stage in STAGES if stage.name in chosen and stage.name not in journal.raw["stages"]]
    while pending:
        stage = pending[0]
        shares = sum(each.share for each in pending)
        left = max(end - time.perf_counter(), 0.0) * stage.share / shares
        say(f"\n== {stage.name}: {stage.about} (at most {left:.0f} s)")
        if stage.needs_gpu and not target.is_real:
            record = {"status": LEFT_OUT, "seconds": 0.0, "rows": [], "left_out": [NOT_HERE[target.kind]]}
        elif target.is_real:
            record = _run_apart(stage, target, arguments, journal.path.parent, left)
        else:
            record = run_stage(stage, target, arguments, Record(None, left, say))
        journal.put(stage.name, record)
        line = f"== {stage.name}: {record['status']} in {record['seconds']:.1f} s"
        say(line + (f"\n{record['error']}" if "error" in record else ""))
        pending.pop(0)


def run_stage(stage: Stage, target: Target, arguments: dict[str, Any], record: Record) -> dict:
    """Run a stage in this process; an error is part of its record."""
    try:
        with nullcontext() if stage.has_reference else target.checked():
            stage.run(target, record, **arguments)
    except Exception:
        return record.as_json(FAILED, traceback.format_exc())
    return record.as_json(DONE)


def _run_apart(stage: Stage, target: Target, arguments: dict[str, Any], folder: Path, seconds: float) -> dict:
    """Run a stage in a process of its own, which is ended if it takes longer than it may."""
    path = folder / _PARTIAL
    path.unlink(missing_ok=True)
    order = json.dumps(
        {
            "stage": stage.name,
            "target": asdict(target),
            "arguments": {name: None if value is None else str(value) for name, value in arguments.items()},
            "seconds": max(seconds - _START, 1.0),
            "record": str(path),
        }
    )
    command = [sys.executable, "-P", "-m", "ccd_warp.benchmarks.gpu_check", "--stage", order]
    begin = time.perf_counter()
    process = subprocess.Popen(command, start_new_session=True)
    try:
        code = process.wait(seconds + _GRACE)
        how = f"its process ended with status {code}"
    except subprocess.TimeoutExpired:
        how = f"it took more than {seconds:.0f} s, and was ended"
    except BaseException:
        _end(process)
        raise
    _end(process)  # and what it has started
    record = read_json(path)
    path.unlink(missing_ok=True)
    if record is None:
        record = {"status": STOPPED, "rows": [], "left_out": []}
    record["seconds"] = round(time.perf_counter() - begin, 2)
    if record["status"] == STOPPED:
        record["error"] = how
    return record


def _end(process: subprocess.Popen) -> None:
    """End a process and all that it has started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait()


def run_ordered(order: str) -> None:
    """Run the stage that another process has ordered, and write its record."""
    given = json.loads(order)
    stage = next(each for each in STAGES if each.name == given["stage"])
    arguments = {name: None if value is None else Path(value) for name, value in given["arguments"].items()}
    path = Path(given["record"])
    record = Record(path, given["seconds"], lambda line: print(f"   {line}", flush=True))
    write_json(path, run_stage(stage, Target(**given["target"]), arguments, record))
