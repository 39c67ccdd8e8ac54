"""What a stage is given: the time that it has, and the record to which it adds; and the file of all records."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FILE = "gpu_check.json"
PARTIAL = "gpu_check.stage.json"  # the record of the stage that is running
SUMMARY = "gpu_check.md"
# How a stage can have ended.
DONE, FAILED, STOPPED, LEFT_OUT = "done", "failed", "stopped", "left out"


def write_json(path: Path, value: Any) -> None:
    """Write a file whole or not at all: beside the old one first, then in its place."""
    new = path.with_suffix(f".{os.getpid()}.new")
    new.write_text(json.dumps(value, indent=1, default=_plain) + "\n", encoding="utf-8")
    os.replace(new, path)


def read_json(path: Path) -> Any:
    """What a file holds, or None where there is no such file, or not a whole one."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's."""
    return value.item() if hasattr(value, "item") else str(value)


@dataclass
class Record:
    """The record of a stage, kept on disk from row to row, so that what ends the process loses no row.

    Attributes:
        path: Its file, or None where it stays in memory.
        seconds: The time that the stage has.
        say: Called with a line for people.
        about: What is written beside it: the stage and the settings of the check.
        rows: What was measured, in order.
        left_out: What was not done, each with the reason.
        cases: The cases that are over, here or in an earlier attempt at the stage.
        case: The case that has begun.
        ended: Cases in which there was no more time for the process of the stage, each of which has another try.
        is_cut: Whether there was no time for a case.
    """

    path: Path | None
    seconds: float
    say: Callable[[str], None]
    about: dict = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    cases: list[str] = field(default_factory=list)
    case: str | None = None
    ended: list[str] = field(default_factory=list)
    is_cut: bool = False
    _row: int = 0  # at which the rows of the case begin
    _begin: float = field(default_factory=time.perf_counter)

    def left(self) -> float:
        """Seconds that are left of the stage's time."""
        return self.seconds - (time.perf_counter() - self._begin)

    def go_on(self, before: dict | None) -> None:
        """Keep what an earlier attempt at the stage has, but for the case in which it was cut short."""
        if before is not None:
            self.cases, self.ended = list(before["cases"]), list(before["ended"])
            self.rows = before["rows"][: before["row"] if before["case"] else None]

    def begins(self, case: str, seconds: float = 0.0) -> bool:
        """Begin a case, unless it is over already, or fewer seconds are left, which is noted."""
        self.end_case()
        if case in self.cases:
            return False
        if self.left() <= seconds:
            if not self.is_cut:
                self.say(f"no time was left for {case} and what follows")
            self.is_cut = True
            self.left_out.append(f"{case}: no time was left")
            return False
        self.case, self._row = case, len(self.rows)
        self._write()
        return True

    def end_case(self) -> None:
        """The case that has begun is over."""
        if self.case is not None:
            self.cases.append(self.case)
            self.case = None

    def replace(self, **row: Any) -> None:
        """Keep this row in place of the last one."""
        self.rows[-1:] = [row]
        self._write()

    def add(self, line: str | None = None, **row: Any) -> None:
        """Keep a row, and say a line about it."""
        self.rows.append(row)
        self._write()
        if line is not None:
            self.say(line)

    def leave_out(self, what: str, why: str) -> None:
        """Note what is not done."""
        self.left_out.append(f"{what}: {why}")
        self._write()
        self.say(f"left out: {what}: {why}")

    def has_time(self, what: str, seconds: float = 0.0) -> bool:
        """Whether so many seconds are left; where they are not, what does not fit is noted."""
        if self.left() > seconds:
            return True
        self.leave_out(what, "no time was left")
        return False

    def as_json(self, status: str, error: str | None = None) -> dict:
        """The record with how the stage ended."""
        seconds = round(time.perf_counter() - self._begin, 2)
        record: dict[str, Any] = {"status": status, "seconds": seconds, "rows": self.rows, "left_out": self.left_out}
        record |= {
            "cases": self.cases,
            "case": self.case,
            "ended": self.ended,
            "row": self._row,
            "is_cut": self.is_cut,
            **self.about,
        }
        return record if error is None else {**record, "error": error}

    def _write(self) -> None:
        if self.path is not None:
            write_json(self.path, self.as_json(STOPPED))
