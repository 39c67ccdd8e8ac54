"""The file of records: a JSON line for each case of a stage as it begins, and one as it is over.

Lines are only added, so what ends a process loses none; one that was cut off is passed over. Each names the run that it
belongs to, by its settings: two GPUs, or two versions of the code, may have their lines in one file, and each goes on
with its own.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FILE, SUMMARY = "gpu_check.jsonl", "gpu_check.md"
# How a case can stand, or a stage as a whole.
BEGUN, LATE, PASSED, SKIPPED, FAILED = "begun", "late", "passed", "skipped", "failed"
DONE, STOPPED, LEFT_OUT = "done", "stopped", "left out"
NO_TIME = "no time was left"


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
class StageRecord:
    """What the lines of a stage say.

    Attributes:
        cases: The last line of each case, in the order in which they began.
        late: Cases in which there was once no more time, each of which has one more try.
        status: How the stage ended.
        seconds: How long it took.
        why: Why it did not come to its end.
    """

    cases: dict[str, dict] = field(default_factory=dict)
    late: set[str] = field(default_factory=set)
    status: str = STOPPED
    seconds: float = 0.0
    why: str = ""

    @property
    def rows(self) -> list[dict]:
        """What was measured."""
        return [row for line in self.cases.values() for row in line.get("rows", [])]

    @property
    def over(self) -> set[str]:
        """The cases that need not be repeated."""
        return {name for name, line in self.cases.items() if line["outcome"] in (PASSED, FAILED)}

    @property
    def open(self) -> list[str]:
        """The cases that have begun, and are not over."""
        return [name for name, line in self.cases.items() if line["outcome"] == BEGUN]

    @property
    def failed(self) -> dict[str, str]:
        """What went wrong in which case."""
        return {name: line["why"] for name, line in self.cases.items() if line["outcome"] == FAILED}

    @property
    def left_out(self) -> list[str]:
        """What was not done, each with the reason."""
        names: dict[str, list[str]] = {}
        for name, line in self.cases.items():
            if line["outcome"] == SKIPPED:
                names.setdefault(line["why"], []).append(name)
        said = [f"{each[0]}{f' and {len(each) - 1} more' * (len(each) > 1)}: {why}" for why, each in names.items()]
        return said + ([self.why] if self.status == LEFT_OUT else [])

    @property
    def is_whole(self) -> bool:
        """Whether nothing is left to be done."""
        return self.status == DONE and not any(line.get("why") == NO_TIME for line in self.cases.values())


class Journal:
    """The lines of one run, and the file to which they are added.

    Attributes:
        path: The file.
        settings: What is checked.
        run: What tells its lines from those of other settings.
    """

    def __init__(self, folder: Path, settings: dict[str, Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path, self.settings = folder / FILE, settings
        self.run = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:12]

    def add(self, **line: Any) -> None:
        """Add a line."""
        text = json.dumps({"run": self.run, **line}, default=_plain)
        with self.path.open("a+b") as file:
            file.seek(0, os.SEEK_END)
            if file.tell():
                file.seek(-1, os.SEEK_END)
                text = text if file.read() == b"\n" else "\n" + text  # after a line that was cut off
            file.write(f"{text}\n".encode())

    def begin(self, anew: list[str]) -> str:
        """Begin a check or go on with it; returns what is known of it already.

        Args:
            anew: Stages that are measured anew, whatever the file has of them.
        """
        self.add(settings=self.settings, anew=anew)
        stages = self.stages()
        notes = [
            f"{name}: the check ended in {', '.join(record.open)}; it goes on from there"
            for name, record in stages.items()
            if record.open
        ]
        if stages:
            kept = sum(record.is_whole for record in stages.values())
            notes.append(f"{self.path} is of the same check: {kept} stages are kept (--again measures all anew)")
        return "\n".join(notes)

    def stages(self) -> dict[str, StageRecord]:
        """What there is of each stage."""
        found: dict[str, StageRecord] = {}
        text = self.path.read_text(encoding="utf-8", errors="replace") if self.path.exists() else ""
        for each in text.splitlines():
            try:
                line = json.loads(each)
            except ValueError:
                continue
            if line["run"] != self.run:
                continue
            for name in line.get("anew", ()):
                found.pop(name, None)
            if "stage" not in line:
                continue
            record = found.setdefault(line["stage"], StageRecord())
            if "case" in line:
                record.cases[line["case"]] = line
                if line["outcome"] == LATE:
                    record.late.add(line["case"])
            else:
                record.status, record.seconds, record.why = line["outcome"], line["seconds"], line["why"]
        return found

    def stage(self, name: str) -> StageRecord:
        """What there is of a stage."""
        return self.stages().get(name, StageRecord())
