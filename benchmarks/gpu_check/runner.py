"""Runs the stages one after another, each in a process of its own, and keeps the file of records up to date.

What ends a stage ends nothing else: an error of CUDA stays with a process to its end, and a kernel that hangs can only
be ended with its process. A stage whose process ends within a case goes on after it in another. A rehearsal without a
GPU runs all stages in this process, which is faster, unless it is asked for the others.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ccd_warp.benchmarks.gpu_check.emulation import require_emulation
from ccd_warp.benchmarks.gpu_check.record import (
    DONE,
    FAILED,
    FILE,
    LEFT_OUT,
    PARTIAL,
    STOPPED,
    SUMMARY,
    Record,
    read_json,
    write_json,
)
from ccd_warp.benchmarks.gpu_check.stages import STAGES, Stage
from ccd_warp.benchmarks.gpu_check.summary import summary
from ccd_warp.benchmarks.gpu_check.target import EMULATED, NOT_HERE, Target

_GRACE = 10.0  # seconds beyond its time after which the process of a stage is ended
_START = 4.0  # seconds until a process has loaded the package and made a context


class Journal:
    """The file of all records, and the summary beside it.

    Attributes:
        raw: Its contents: settings, and the record of each stage that has ended, by name.
        note: What was done about a file of an earlier run.
    """

    def __init__(self, folder: Path, settings: dict[str, Any], *, is_anew: bool) -> None:
        """Go on with the records of these settings that the folder holds, and set others aside."""
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / FILE
        self.note = ""
        self.raw: dict[str, Any] = {"settings": settings, "stages": {}}
        before = self._left_behind(read_json(self.path))
        if before is not None and (before["settings"] != settings or is_anew):
            free = (self.path.with_suffix(f".old{k}.json") for k in range(1, 10**6))
            aside = next(path for path in free if not path.exists())
            write_json(aside, before)
            self.note += f"{self.path} was of another run, and is {aside.name} now\n"
            before = None
        if before is None and not is_anew:  # or of this GPU, before another took its turn
            for aside in folder.glob(f"{self.path.stem}.old*.json"):
                earlier = read_json(aside)
                if earlier is not None and earlier["settings"] == settings:
                    before = earlier
                    os.replace(aside, self.path)
                    break
        if before is not None:
            self.raw = before
            kept = sum(map(is_whole, before["stages"].values()))
            self.note += f"{self.path} is of the same check: {kept} stages are kept (--again measures all anew)"
        write_json(self.path, self.raw)

    def _left_behind(self, before: Any) -> dict[str, Any] | None:
        """An earlier file, with what a stage has left that was ended together with the check."""
        path = self.path.parent / PARTIAL
        partial = read_json(path)
        path.unlink(missing_ok=True)
        if not isinstance(before, dict) or not {"stages", "settings"} <= set(before):
            return None
        if partial is not None and partial["settings"] == before["settings"]:
            partial["error"] = "the check ended" + (f" in {partial['case']}" if partial["case"] else "")
            self.note = f"{partial['stage']}: {partial['error']}; it goes on from there\n"
            before["stages"][partial["stage"]] = partial
        return before

    def put(self, name: str, record: dict) -> None:
        """Keep the record of a stage, and sum up what there is."""
        self.raw["stages"][name] = record
        write_json(self.path, self.raw)
        (self.path.parent / SUMMARY).write_text("\n".join(summary(self.raw)), encoding="utf-8")


def is_whole(record: dict) -> bool:
    """Whether nothing of a stage is left to be done."""
    return record["status"] == DONE and not record["is_cut"]


def run_all(
    target: Target,
    arguments: dict[str, Any],
    journal: Journal,
    chosen: list[str],
    seconds: float,
    say: Callable[[str], None],
    is_apart: bool = False,
) -> None:
    """Run the stages that are chosen and not whole, within a time for all.

    Args:
        target: What is checked.
        arguments: What the stages are told beside it.
        journal: Where the records go.
        chosen: Names of stages.
        seconds: The time for all. Each stage gets its share of what is left.
        say: Called with each line for people.
        is_apart: Whether each stage has a process of its own; on a GPU it has.
    """
    end = time.perf_counter() + seconds
    stages = journal.raw["stages"]
    pending = [each for each in STAGES if each.name in chosen and not is_whole(stages.get(each.name, _NOTHING))]
    while pending:
        stage = pending[0]
        shares = sum(each.share for each in pending)
        left = max(end - time.perf_counter(), 0.0) * stage.share / shares
        say(f"\n== {stage.name}: {stage.about} (at most {left:.0f} s)")
        if stage.needs_gpu and not target.is_real:
            record = Record(None, 0.0, say, left_out=[NOT_HERE[target.kind]]).as_json(LEFT_OUT)
        else:
            record = _run(stage, target, arguments, journal, left, say, is_apart)
        journal.put(stage.name, record)
        line = f"== {stage.name}: {record['status']} in {record['seconds']:.1f} s"
        say(line + (f"\n{record['error']}" if "error" in record else ""))
        pending.pop(0)


_NOTHING: dict[str, Any] = {"status": STOPPED, "is_cut": True}


def _run(
    stage: Stage,
    target: Target,
    arguments: dict[str, Any],
    journal: Journal,
    seconds: float,
    say: Callable[[str], None],
    is_apart: bool,
) -> dict:
    """Run a stage, from where an earlier attempt has ended; after a case in which it ends, the rest of it."""
    begin = time.perf_counter()
    before = journal.raw["stages"].get(stage.name)
    while True:
        left = max(seconds - (time.perf_counter() - begin), 0.0)
        if is_apart:
            record = _run_apart(stage, target, arguments, journal, before, left)
        else:
            own = Record(None, left, say)
            own.go_on(before)
            record = run_stage(stage, target, arguments, own)
        record["seconds"] = round(time.perf_counter() - begin, 2)
        case = record["case"]
        if record["status"] == DONE or case is None:
            return record
        if record["status"] == STOPPED and "was ended" in record["error"] and case not in record["ended"]:
            record["ended"].append(case)  # it may have had little time; the next run begins with it
            return record
        # the case would end the next process as well: it is over, with what it has
        failed = f"{record['status']}: {record['error']}"
        record["rows"].append({"case": case, "failed": failed[-2000:]})
        record |= {"cases": [*record["cases"], case], "case": None}
        say(f"   FAILED {case}: {failed.strip().splitlines()[-1]}")
        if time.perf_counter() - begin > seconds - (2 * _START if is_apart else 0.0):
            return record
        before = record


def run_stage(stage: Stage, target: Target, arguments: dict[str, Any], record: Record) -> dict:
    """Run a stage in this process; an error is part of its record."""
    try:
        with nullcontext() if stage.has_reference else target.checked():
            stage.run(target, record, **arguments)
    except Exception:
        return record.as_json(FAILED, traceback.format_exc())
    record.end_case()
    return record.as_json(DONE)


@contextmanager
def _group() -> Iterator[int]:
    """A group of processes that ends with the block, and with this process, however that ends."""
    command = ["/bin/sh", "-c", "read -r line; kill -9 0"]  # the pipe is closed by the end of this process
    guard = subprocess.Popen(command, stdin=subprocess.PIPE, process_group=0)
    try:
        yield guard.pid
    finally:
        os.killpg(guard.pid, signal.SIGKILL)
        guard.communicate()


def _run_apart(
    stage: Stage, target: Target, arguments: dict[str, Any], journal: Journal, before: dict | None, seconds: float
) -> dict:
    """Run a stage in a process of its own, which is ended if it takes longer than it may."""
    path = journal.path.parent / PARTIAL
    about = {"stage": stage.name, "settings": journal.raw["settings"]}
    own = Record(path, 0.0, print, about)
    own.go_on(before)
    write_json(path, own.as_json(STOPPED))
    order = {
        "target": asdict(target),
        "arguments": {name: None if value is None else str(value) for name, value in arguments.items()},
        "seconds": max(seconds - _START, 1.0),
    }
    command = [sys.executable, "-P", "-m", "ccd_warp.benchmarks.gpu_check", "--stage", json.dumps(order)]
    with _group() as group:
        process = subprocess.Popen([*command, "--output", str(path.parent)], process_group=group)
        try:
            how = f"its process ended with status {process.wait(seconds + _GRACE)}"
        except subprocess.TimeoutExpired:
            how = f"it took more than {seconds:.0f} s, and was ended"
    process.wait()
    record = {name: value for name, value in read_json(path).items() if name not in about}
    path.unlink()
    if record["status"] == STOPPED:
        record["error"] = how + (f" in {record['case']}" if record["case"] else "")
    return record


def run_ordered(order: str, folder: Path) -> None:
    """Run the stage that another process has ordered, from where its record ends, and write its record."""
    given = json.loads(order)
    path = folder / PARTIAL
    before = read_json(path)
    stage = next(each for each in STAGES if each.name == before["stage"])
    target = Target(**given["target"])
    arguments = {name: None if value is None else Path(value) for name, value in given["arguments"].items()}
    if target.kind == EMULATED:
        require_emulation(arguments["tests"])
    about = {name: before[name] for name in ("stage", "settings")}
    record = Record(path, given["seconds"], lambda line: print(f"   {line}", flush=True), about)
    record.go_on(before)
    write_json(path, run_stage(stage, target, arguments, record))
