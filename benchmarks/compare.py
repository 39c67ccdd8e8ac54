"""Comparison of two runs: what became slower or less accurate.

Times are divided by those of the peer in the same run, on queries and scenes that both runs have finished, so that the
speed of the machine cancels. They are minima over the rounds, which noise can only raise. The peer runs on one core, so
noise on other cores, or on a GPU, does not cancel. A figure of one set and method is the geometric mean over the
tolerances of both runs. Small scenes and single pairs are compared with ipc-toolkit's additive CCD. Growth, batches,
threads and memory are not compared.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

from ccd_warp.benchmarks.methods import REFERENCE
from ccd_warp.benchmarks.numbers import error_text, rows_of, set_name
from ccd_warp.benchmarks.scene_sections import SMALL_PEERS, pair_name, scene_name

DEFAULT_THRESHOLD = 1.25
# An error below this is rounding of a toi near one; a ratio of such errors is meaningless.
_ERROR_FLOOR = 1e-14
_LEAST_QUERIES = 10


@dataclass(frozen=True)
class Change:
    """One figure of ours in both runs.

    Attributes:
        what: Name of the figure.
        ratio: Factor by which it became worse; below 1 it became better.
        text: Both values.
    """

    what: str
    ratio: float
    text: str


def reference_ratio(old: dict, new: dict) -> float | None:
    """Time of the peer in the new run over that in the old, on queries that both have answered; None if too few."""
    pairs = [
        (a, b)
        for a, b in zip(old.get("query_seconds", []), new.get("query_seconds", []), strict=False)
        if a is not None and b is not None
    ]
    total_old, total_new = (sum(values) for values in zip(*pairs, strict=True)) if pairs else (0.0, 0.0)
    return total_new / total_old if len(pairs) >= _LEAST_QUERIES and total_old > 0 and total_new > 0 else None


def _units(raw: dict, section: str) -> dict[tuple, dict]:
    name = "set" if section == "sweep" else "family"
    return {(unit[name], unit["kind"], unit.get("tolerance")): unit for unit in raw[section]}


def _worse_error(old: float | None, new: float | None) -> float:
    return 1.0 if old is None or new is None else max(new, _ERROR_FLOOR) / max(old, _ERROR_FLOOR)


def _least_ratio(row: dict, call: str) -> float:
    """Least time of the peer over that of ours on a whole step."""
    least = {name: low for name, (low, _) in row["spread"].items()}
    return (least["peer build"] + (call != "find_candidates") * least["peer step"]) / least[call]


def changes(old: dict, new: dict) -> tuple[list[Change], list[str]]:
    """Every figure that both runs have, and notes on what could not be compared."""
    found: list[Change] = []
    notes: list[str] = []
    speed: dict[str, list[float]] = {}
    for section in ("sweep", "cases"):
        before, after = _units(old, section), _units(new, section)
        if only := len(before.keys() ^ after.keys()):
            notes.append(f"{only} points of the {section} are in one run only")
        for key in before.keys() & after.keys():
            rows = [rows_of(unit) for unit in (before[key], after[key])]
            label = set_name(after[key]) if section == "sweep" else f"{key[0]} {key[1]}"
            at = f" at {key[2]:g}" if section == "sweep" else ""
            if before[key]["points"] != after[key]["points"]:
                notes.append(f"{label}: other queries in the two runs, not compared")
                continue
            for method in rows[0].keys() ^ rows[1].keys():
                notes.append(f"{method} is in one run only")
            machine = reference_ratio(*(r.get(REFERENCE, {}) for r in rows)) if section == "sweep" else None
            if machine is None and section == "sweep":
                notes.append(f"{label}{at}: the peer has answered too few queries of both runs to compare times")
            for method in rows[0].keys() & rows[1].keys():
                if not method.startswith("ours"):
                    continue
                a, b = rows[0][method], rows[1][method]
                if machine is not None:
                    ratio = b["seconds_low"] / a["seconds_low"] / machine
                    speed.setdefault(f"{label}, {method}: time", []).append(ratio)
                if a["queries"] != b["queries"]:
                    notes.append(f"{label}{at}, {method}: fewer queries in one of the runs, answers not compared")
                    continue
                for fault in ("missed", "late", "phantom", "limited"):
                    ratio = math.inf if fault in ("missed", "late") else (b[fault] + 1) / (a[fault] + 1)
                    ratio = ratio if b[fault] > a[fault] else 1.0
                    found.append(Change(f"{label}{at}, {method}: {fault}", ratio, f"{a[fault]} → {b[fault]}"))
                for name in ("median", "p99", "max"):
                    errors = [None if row["error"] is None else row["error"][name] for row in (a, b)]
                    text = f"{error_text(errors[0])} → {error_text(errors[1])}"
                    found.append(Change(f"{label}{at}, {method}: {name} error", _worse_error(*errors), text))
    for what, ratios in speed.items():
        mean = statistics.geometric_mean(ratios)
        found.append(Change(what, mean, f"{mean:.2f} times, {len(ratios)} tolerances, against the peer"))
    before, after = ({scene_name(row): row for row in raw["steps"]} for raw in (old, new))
    if only := len(before.keys() ^ after.keys()):
        notes.append(f"{only} scenes are in one run only")
    for name in before.keys() & after.keys():
        for call in before[name]["ratio"]:
            was, now = (_least_ratio(rows[name], call) for rows in (before, after))
            found.append(Change(f"{name}, {call}: time", was / now, f"peer's / ours {was:.2f} → {now:.2f}"))
        found.append(_step_change(name, *(rows[name]["step"] for rows in (before, after))))
        others = [rows[name]["disagreements"] for rows in (before, after)]
        found.append(
            Change(
                f"{name}: candidates other than the peer's",
                (others[1] + 1) / (others[0] + 1),
                f"{others[0]} → {others[1]}",
            )
        )
    found += _small_changes(old, new, notes)
    return sorted(found, key=lambda change: (-change.ratio, change.what)), notes


def _small_changes(old: dict, new: dict, notes: list[str]) -> list[Change]:
    """Times on small scenes and single pairs over those of the peer, and the steps."""
    before, after = (
        {(scene_name(row) if "scene" in row else f"one {pair_name(row)} pair"): row for row in rows_of_both}
        for rows_of_both in ([*raw.get("small", []), *raw.get("pairs", [])] for raw in (old, new))
    )
    if only := len(before.keys() ^ after.keys()):
        notes.append(f"{only} small scenes or single pairs are in one run only")
    found = []
    for name in before.keys() & after.keys():
        spreads = [rows[name]["spread"] for rows in (before, after)]
        for call in (spreads[0].keys() & spreads[1].keys()) - set(SMALL_PEERS):
            was, now = (spread[SMALL_PEERS[1]][0] / spread[call][0] for spread in spreads)
            found.append(Change(f"{name}, {call}: time", was / now, f"peer's / ours {was:.2f} → {now:.2f}"))
        if "step" in before[name]:
            found.append(_step_change(name, *(rows[name]["step"] for rows in (before, after))))
    return found


def _step_change(name: str, old: float, new: float) -> Change:
    ratio = old / new if new else (math.inf if old else 1.0)
    return Change(f"{name}: collision-free step", ratio, f"{old:.6g} → {new:.6g}")


def compare(old: dict, new: dict, threshold: float) -> tuple[list[str], bool]:
    """Lines to print, and whether something became worse by more than the threshold.

    Args:
        old: Raw figures of the run to compare with.
        new: Raw figures of this run.
        threshold: Largest ratio that passes, above 1.

    Returns:
        The lines, and True if a ratio is above the threshold, or if the runs have nothing in common.
    """
    found, notes = changes(old, new)
    lines = []
    if old["settings"] != new["settings"]:
        lines.append("the two runs have other settings; what both have measured is compared")
    worse = [change for change in found if change.ratio > threshold]
    better = [change for change in found if change.ratio < 1 / threshold]
    for title, chosen in ((f"worse by more than {threshold:g}", worse), ("better by as much", better)):
        lines.append(f"{title}: {len(chosen)} of {len(found)} figures")
        lines += [f"  {change.what}: {change.text} ({change.ratio:.3g})" for change in chosen]
    lines += [f"note: {note}" for note in dict.fromkeys(notes)]
    if not found:
        lines.append("nothing to compare: the two runs share no point and no scene")
    return lines, bool(worse) or not found
