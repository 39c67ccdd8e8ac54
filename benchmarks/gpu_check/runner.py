"""Runs the stages one after another, each by pytest in a process of its own, within a time for all.

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from ccd_warp.benchmarks.gpu_check.emulation import require_emulation
from ccd_warp.benchmarks.gpu_check.journal import DONE, FAILED, LATE, LEFT_OUT, STOPPED, SUMMARY, Journal
from ccd_warp.benchmarks.gpu_check.plugin import Plugin
from ccd_warp.benchmarks.gpu_check.stages import STAGES, Stage
from ccd_warp.benchmarks.gpu_check.summary import summary
from ccd_warp.benchmarks.gpu_check.target import EMULATED, NOT_HERE, Target

_GRACE = 10.0  # seconds beyond its time after which the process of a stage is ended
_START = 4.0  # seconds until a process has loaded the package and made a context
Folders = dict[str, Path | None]
Say = Callable[[str], None]


def run_all(
    target: Target,
    folders: Folders,
    journal: Journal,
    chosen: list[str],
    seconds: float,
    say: Say,
    is_apart: bool = False,
) -> None:
    """Run the stages that are chosen and not whole, within a time for all.

    Args:
        target: What is checked.
        folders: What the stages are told beside it.
        journal: Where the records go.
        chosen: Names of stages.
        seconds: The time for all. Each stage gets its share of what is left.
        say: Called with each line for people.
        is_apart: Whether each stage has a process of its own; on a GPU it has.
    """
    end = time.perf_counter() + seconds
    whole = {name for name, record in journal.stages().items() if record.is_whole}
    pending = [each for each in STAGES if each.name in chosen and each.name not in whole]
    while pending:
        stage = pending[0]
        left = max(end - time.perf_counter(), 0.0) * stage.share / sum(each.share for each in pending)
        say(f"\n== {stage.name}: {stage.about} (at most {left:.0f} s)")
        why = NOT_HERE[target.kind] if stage.needs_gpu and not target.is_real else ""
        if stage.arguments is not None and folders.get("tests") is None:
            why = why or "the folder of the tests is not at hand; --tests names it"
        if why:
            journal.add(stage=stage.name, outcome=LEFT_OUT, seconds=0.0, why=why)
        else:
            _run(stage, target, folders, journal, left, say, is_apart)
        stages = journal.stages()
        (journal.path.parent / SUMMARY).write_text("\n".join(summary(journal.settings, stages)), encoding="utf-8")
        record = stages[stage.name]
        say(f"== {stage.name}: {record.status} in {record.seconds:.1f} s" + f"\n{record.why}" * bool(record.why))
        pending.pop(0)


def _run(
    stage: Stage, target: Target, folders: Folders, journal: Journal, seconds: float, say: Say, is_apart: bool
) -> None:
    """Run a stage, from where an earlier attempt has ended; after a case in which its process ends, the rest of it."""
    begin = time.perf_counter()
    while True:
        left = max(seconds - (time.perf_counter() - begin), 0.0)
        over = journal.stage(stage.name).over
        is_late = False
        if is_apart:
            how, is_late = _run_apart(stage, target, folders, journal, left)
        else:
            how = Plugin(stage, target, folders, journal, left, say).run()
        spent = round(time.perf_counter() - begin, 2)
        if how is None:
            return journal.add(stage=stage.name, outcome=DONE, seconds=spent, why="")
        record = journal.stage(stage.name)
        how += f" in {', '.join(record.open)}" * bool(record.open)
        for case in record.open:
            if is_late and case not in record.late:  # it may have had little time; the next run begins with it
                journal.add(stage=stage.name, case=case, outcome=LATE)
            else:
                # the case would end the next process as well: it is over
                journal.add(stage=stage.name, case=case, outcome=FAILED, why=how)
                say(f"   FAILED {case}: {how}")
        is_stuck = journal.stage(stage.name).over == over
        if is_late or is_stuck or spent > seconds - 2 * _START:
            return journal.add(stage=stage.name, outcome=STOPPED, seconds=spent, why=how)


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
    stage: Stage, target: Target, folders: Folders, journal: Journal, seconds: float
) -> tuple[str | None, bool]:
    """Run a stage in a process of its own, which is ended if it takes longer than it may.

    Returns:
        How it ended, None if as it should; and whether it took too long.
    """
    order = {
        "stage": stage.name,
        "target": asdict(target),
        "folders": {name: None if value is None else str(value) for name, value in folders.items()},
        "settings": journal.settings,
        "seconds": max(seconds - _START, 1.0),
    }
    command = [sys.executable, "-P", "-m", "ccd_warp.benchmarks.gpu_check", "--stage", json.dumps(order)]
    with _group() as group:
        process = subprocess.Popen([*command, "--output", str(journal.path.parent)], process_group=group)
        try:
            status = process.wait(seconds + _GRACE)
        except subprocess.TimeoutExpired:
            return f"it took more than {seconds:.0f} s, and was ended", True
        finally:
            process.kill()
            process.wait()
    return None if status == 0 else f"its process ended with status {status}", False


def run_ordered(order: str, folder: Path) -> int:
    """Run the stage that another process has ordered; the status with which this one is to end."""
    given = json.loads(order)
    stage = next(each for each in STAGES if each.name == given["stage"])
    target = Target(**given["target"])
    folders = {name: None if value is None else Path(value) for name, value in given["folders"].items()}
    if target.kind == EMULATED:
        require_emulation(folders["tests"])
    journal = Journal(folder, given["settings"])
    how = Plugin(stage, target, folders, journal, given["seconds"], lambda line: print(f"   {line}", flush=True)).run()
    if how is not None:
        print(how, file=sys.stderr, flush=True)
    return int(how is not None)
