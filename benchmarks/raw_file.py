"""The raw figures: one JSON file for all, and a CSV file for each table."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pandas as pd

_KEYS = ("machine", "settings", "complete", "methods", "sets", "sweep", "cases", "batches", "start", "threads", "steps")


def write_raw(path: Path, raw: dict) -> None:
    """Write the JSON file, with a line for each record of a list, and the CSV files ``NAME_sweep.csv`` and so on."""
    parts = []
    for key, value in raw.items():
        if isinstance(value, list) and value:
            lines = ",\n".join("  " + json.dumps(record, default=_plain) for record in value)
            parts.append(f' "{key}": [\n{lines}\n ]')
        else:
            parts.append(f' "{key}": {json.dumps(value, default=_plain)}')
    new = path.with_suffix(".new")
    new.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")
    os.replace(new, path)
    for name, rows in flat_rows(raw).items():
        if rows:
            pd.DataFrame(rows, dtype=object).to_csv(path.with_name(f"{path.stem}_{name}.csv"), index=False)


def read_raw(path: Path) -> dict:
    """Read the JSON.

    Raises:
        ValueError: If it does not exist or is not a raw file of this benchmark.
    """
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(
            f"{path} cannot be read ({error.strerror}); expected a bench.json of ccd-warp bench"
        ) from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not JSON ({error}); expected a bench.json of ccd-warp bench") from error
    lacking = set(_KEYS) - (raw.keys() if isinstance(raw, dict) else set())
    if lacking:
        raise ValueError(f"{path} lacks {', '.join(sorted(lacking))}; expected a bench.json of ccd-warp bench")
    return raw


def merged(kept: dict, new: dict, sections: tuple[str, ...]) -> dict:
    """Raw figures with some parts from another run, each marked with its machine and date.

    Args:
        kept: Figures of all parts.
        new: Figures of the run that measured some parts again.
        sections: The parts to take from ``new``.
    """
    mark = {"machine": new["machine"], "fingerprint": new["fingerprint"], "quick": new["settings"]["quick"]}
    marks = kept.get("measured_apart", {}) | dict.fromkeys(sections, mark)
    parts = {section: new[section] for section in sections}
    if "exponents" in new:
        parts["exponents"] = new["exponents"]
    return {**kept, **parts, "measured_apart": marks, "complete": kept["complete"] and new["complete"]}


def flat_rows(raw: dict) -> dict[str, list[dict]]:
    """The lists of the raw figures as flat rows."""
    result: dict[str, list[dict]] = {}
    for name in ("sweep", "cases", "rigid"):
        result[name] = [
            _flat({**{k: v for k, v in unit.items() if k != "rows"}, **row})
            for unit in raw.get(name, [])
            for row in unit["rows"]
        ]
    for name in ("steps", "broad", "worlds", "small", "pairs", "growth", "start", "threads"):
        result[name] = [_flat(row) for row in raw.get(name) or []]
    result["batches"] = list((raw.get("batches") or {"rows": []})["rows"])
    return result


def frame(raw: dict, section: str) -> pd.DataFrame:
    """A section as a table, in which a method on a set or a family has a row."""
    return pd.DataFrame(flat_rows(raw)[section])


def _flat(record: dict, prefix: str = "") -> dict[str, Any]:
    """Nested objects by joined names; lists of single queries are left to the JSON."""
    flat: dict[str, Any] = {}
    for key, value in record.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        elif key != "query_seconds":
            flat[prefix + key] = value
    return flat


def _plain(value: Any) -> Any:
    return value.item()
