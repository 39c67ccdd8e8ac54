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
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pandas as pd
from ccd_warp.benchmarks.methods import REFERENCE
from ccd_warp.benchmarks.numbers import error_text, rows_of, set_name
from ccd_warp.benchmarks.raw_file import flat_rows
from ccd_warp.benchmarks.scene_sections import SMALL_PEERS, pair_name, scene_name

DEFAULT_THRESHOLD = 1.25
# An error below this is rounding of a toi near one; a ratio of such errors is meaningless.
_ERROR_FLOOR = 1e-14
_LEAST_QUERIES = 10


class Figure(NamedTuple):
    """A figure of ours in one run.

    Attributes:
        what: Its name; the time of a set and method has one for each tolerance.
        rule: How it is compared, a key of ``RULES``.
        part: What it is of: a point of the sweep, a family, a scene.
        value: The figure, None if there is none.
        of: The queries, and how many of them; the figures of others are not comparable.
    """

    what: str
    rule: str
    part: str
    value: float | None
    of: str = ""


class Change(NamedTuple):
    """One figure of ours in both runs.

    Attributes:
        what: Name of the figure.
        ratio: Factor by which it became worse; below 1 it became better.
        text: Both values.
    """

    what: str
    ratio: float
    text: str


def _worse_error(old: float | None, new: float | None) -> float:
    return 1.0 if old is None or new is None else max(new, _ERROR_FLOOR) / max(old, _ERROR_FLOOR)


# By which factor a figure became worse, from its values in the old run and the new one, and both values in words.
RULES: dict[str, tuple[Callable[[Any, Any], float], Callable[[Any, Any], str]]] = {
    "fault": (lambda old, new: math.inf if new > old else 1.0, lambda old, new: f"{old} → {new}"),
    "more": (lambda old, new: (new + 1) / (old + 1) if new > old else 1.0, lambda old, new: f"{old} → {new}"),
    "count": (lambda old, new: (new + 1) / (old + 1), lambda old, new: f"{old} → {new}"),
    "error": (_worse_error, lambda old, new: f"{error_text(old)} → {error_text(new)}"),
    "speed": (lambda old, new: old / new, lambda old, new: f"peer's / ours {old:.2f} → {new:.2f}"),
    "step": (
        lambda old, new: old / new if new else (math.inf if old else 1.0),
        lambda old, new: f"{old:.6g} → {new:.6g}",
    ),
}


def figures(raw: dict) -> Iterator[Figure]:
    """Every figure of ours in a run."""
    rows = flat_rows(raw)
    for row in rows["sweep"] + rows["cases"]:
        if not row["method"].startswith("ours"):
            continue
        label, at = (
            (set_name(row), f" at {row['tolerance']:g}") if "set" in row else (f"{row['family']} {row['kind']}", "")
        )
        name, part = f"{label}{at}, {row['method']}", f"{label}{at}"
        if "set" in row:
            yield Figure(f"{label}, {row['method']}: time", "time", part, row["seconds_low"], row["points"])
        of = f"{row['points']} {row['queries']}"
        for fault in ("missed", "late", "phantom", "limited"):
            yield Figure(f"{name}: {fault}", "fault" if fault in ("missed", "late") else "more", part, row[fault], of)
        for error in ("median", "p99", "max"):
            yield Figure(f"{name}: {error} error", "error", part, row.get(f"error.{error}"), of)
    for row in raw["steps"]:
        name = scene_name(row)
        least = {call: low for call, (low, _) in row["spread"].items()}
        for call in row["ratio"]:
            peer = least["peer build"] + (call != "find_candidates") * least["peer step"]
            yield Figure(f"{name}, {call}: time", "speed", name, peer / least[call])
        yield Figure(f"{name}: candidates other than the peer's", "count", name, row["disagreements"])
    for row in [*raw.get("small", []), *raw.get("pairs", [])]:
        name = scene_name(row) if "scene" in row else f"one {pair_name(row)} pair"
        for call in row["spread"].keys() - set(SMALL_PEERS):
            yield Figure(
                f"{name}, {call}: time", "speed", name, row["spread"][SMALL_PEERS[1]][0] / row["spread"][call][0]
            )
    for row in [*raw["steps"], *raw.get("small", [])]:
        if "step" in row:
            yield Figure(f"{scene_name(row)}: collision-free step", "step", scene_name(row), row["step"])


def reference_ratio(old: dict, new: dict) -> float | None:
    """Time of the peer in the new run over that in the old, on queries that both have answered; None if too few."""
    pairs = [
        (a, b)
        for a, b in zip(old.get("query_seconds", []), new.get("query_seconds", []), strict=False)
        if a is not None and b is not None
    ]
    total_old, total_new = (sum(values) for values in zip(*pairs, strict=True)) if pairs else (0.0, 0.0)
    return total_new / total_old if len(pairs) >= _LEAST_QUERIES and total_old > 0 and total_new > 0 else None


def machine_ratios(old: dict, new: dict) -> dict[str, float | None]:
    """The ratio of the peer's times at each point of the sweep of both runs."""
    peers = [
        {f"{set_name(unit)} at {unit['tolerance']:g}": rows_of(unit).get(REFERENCE, {}) for unit in raw["sweep"]}
        for raw in (old, new)
    ]
    return {part: reference_ratio(peers[0][part], peers[1][part]) for part in peers[0].keys() & peers[1].keys()}


def changes(old: dict, new: dict) -> tuple[list[Change], list[str]]:
    """Every figure that both runs have, and notes on what could not be compared."""
    keys = ["what", "rule", "part"]
    tables = [pd.DataFrame(figures(raw), columns=Figure._fields, dtype=object) for raw in (old, new)]
    joined = tables[0].merge(tables[1], on=keys, how="outer", suffixes=("_old", "_new"), indicator="where")
    alone = joined[joined["where"] != "both"]
    notes = [f"{part}: {len(of)} figures are in one run only" for part, of in alone.groupby("part", sort=False)]
    both = joined[joined["where"] == "both"].astype(object).where(lambda table: table.notna(), None)
    machine = machine_ratios(old, new)
    notes += [
        f"{part}: the peer has answered too few queries of both runs to compare times"
        for part, ratio in machine.items()
        if ratio is None
    ]
    found: list[Change] = []
    speed: dict[str, list[float]] = {}
    for row in both.itertuples():
        if row.of_old != row.of_new:
            notes.append(f"{row.part}: other queries in the two runs, not compared")
        elif row.rule != "time":
            ratio, text = (of(row.value_old, row.value_new) for of in RULES[row.rule])
            found.append(Change(row.what, ratio, text))
        elif (ratio := machine.get(row.part)) is not None:
            speed.setdefault(row.what, []).append(row.value_new / row.value_old / ratio)
    for what, ratios in speed.items():
        mean = statistics.geometric_mean(ratios)
        found.append(Change(what, mean, f"{mean:.2f} times, {len(ratios)} tolerances, against the peer"))
    return sorted(found, key=lambda change: (-change.ratio, change.what)), notes


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
