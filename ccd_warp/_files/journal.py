"""The results so far, on disk: an interrupted run keeps them, and the next one continues from there."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import ccd_warp.kernels


def fingerprint(settings: dict, about: dict, data: Path | None = None, code: Path | None = None) -> str:
    """Fingerprint of what must agree for a run to be continued: settings, machine, versions, code of the package, data.

    Args:
        settings: What was asked for.
        about: The machine and the versions.
        data: Folder of the data.
        code: Folder of further code.
    """
    digest = hashlib.sha256(json.dumps([settings, {**about, "date": ""}], sort_keys=True).encode())
    for path in sorted(data.rglob("*")) if data else ():
        if data and path.is_file():
            digest.update(f"{path.relative_to(data)} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
    folders = [Path(__file__).parents[1], Path(ccd_warp.kernels.__path__[0])]
    for folder in (*folders, *([code] if code else [])):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


class Journal:
    """Records by key, one JSON object on each line, each on disk before the next is measured.

    Attributes:
        records: Results by key.
        set_aside: Path to which the journal of another run was moved, if there was one.
        num_foreign: Number of lines that are no records; the last one may be incomplete, and is not counted.
    """

    def __init__(self, path: Path, mark: str) -> None:
        self.path = path
        self.records: dict[str, Any] = {}
        self.set_aside: Path | None = None
        self.num_foreign = 0
        text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
        lines = text.splitlines()
        if lines and _parsed(lines[0]) == {"fingerprint": mark}:
            for number, line in enumerate(lines[1:], start=2):
                entry = _parsed(line)
                if isinstance(entry, dict) and entry.keys() == {"key", "record"} and isinstance(entry["key"], str):
                    self.records[entry["key"]] = entry["record"]
                else:
                    self.num_foreign += number < len(lines) or text.endswith("\n")
        elif len(lines) > 1:
            self.set_aside = path.with_suffix(".old")
            os.replace(path, self.set_aside)
        self._write([{"fingerprint": mark}, *({"key": k, "record": r} for k, r in self.records.items())])

    def _write(self, entries: list[dict]) -> None:
        new = self.path.with_suffix(".new")
        new.write_text("".join(json.dumps(entry) + "\n" for entry in entries), encoding="utf-8")
        os.replace(new, self.path)

    def add(self, key: str, record: Any) -> None:
        """Save a record."""
        self.records[key] = record
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, "record": record}) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def close(self) -> None:
        """Remove the journal of a complete run, so that the next one starts afresh."""
        self.path.unlink(missing_ok=True)


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except json.JSONDecodeError:
        return None
