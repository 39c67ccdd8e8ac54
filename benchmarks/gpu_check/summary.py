"""The summary of a check in Markdown: how each stage ended, the goals, and the figures of each stage in a table."""

from __future__ import annotations

from typing import Any

from ccd_warp.benchmarks.gpu_check.bits import totals
from ccd_warp.benchmarks.gpu_check.queries import COLLIDING, CULLED
from ccd_warp.benchmarks.gpu_check.record import DONE
from ccd_warp.benchmarks.gpu_check.stages import NAMES
from ccd_warp.benchmarks.gpu_check.target import CUDA
from ccd_warp.benchmarks.numbers import table

# The goals on a GPU: queries a second in float64, and seconds of a launch of a mesh of some 200,000 faces.
GOAL_COLLIDING, GOAL_CULLED = 1e9, 5e9
GOAL_LAUNCH, GOAL_FACES = 1e-3, 190_000
_MOST_COMPLAINTS = 30
# Keys of a row that say what it is about.
_NAMING = ("case", "kind", "where", "scene", "broad_phase", "tool")


def rows_of(raw: dict, stage: str, having: str) -> list[dict]:
    """The rows of a stage that have a value, as those of a case that failed do not; none where it has not run."""
    return [row for row in raw["stages"].get(stage, {}).get("rows", []) if having in row]


def summary(raw: dict) -> list[str]:
    """All lines."""
    lines = [f"# Check of ccd_warp on {device_name(raw)}", ""]
    kind = raw["settings"]["kind"]
    if kind != CUDA:
        lines += [f"This is a rehearsal ({kind}): no time below is one of a GPU.", ""]
    lines += ["## Stages", "", *stage_table(raw), "", "## Goals", "", *goal_table(raw), ""]
    wrong = complaints(raw)
    if wrong:
        lines += ["## What is wrong", "", *(f"- {line}" for line in wrong[:_MOST_COMPLAINTS])]
        lines += [f"- {len(wrong) - _MOST_COMPLAINTS} more"] if len(wrong) > _MOST_COMPLAINTS else []
        lines += [""]
    for title, part in (
        ("Whole steps", kernel_table(raw)),
        ("Queries", query_table(raw)),
        ("Beside others", against_table(raw)),
        ("Broad phases", broad_phase_table(raw)),
        ("Graphs", graph_table(raw)),
        ("reserve()", reserve_table(raw)),
    ):
        if part:
            lines += [f"## {title}", "", *part, ""]
    failed = [(name, stage["error"]) for name, stage in raw["stages"].items() if "error" in stage]
    if failed:
        lines += ["## Errors of stages", ""]
        for name, error in failed:
            lines += [f"{name}:", "", "```text", error.strip(), "```", ""]
    return lines


def complaints(raw: dict) -> list[str]:
    """A line for each stage that did not end well, and for each row that failed or differs from the CPU."""
    lines = []
    for name, stage in raw["stages"].items():
        if "error" in stage:
            lines.append(f"{name}: {stage['status']}, {stage['error'].strip().splitlines()[-1]}")
        for row in stage["rows"]:
            what = ", ".join(str(row[key]) for key in _NAMING if key in row) or name
            for key in ("failed", "different"):
                if row.get(key):
                    lines.append(f"{name}: {what}: {key}: {str(row[key])[:300]}")
            if "tool" in row and row["status"] != 0:
                lines.append(f"{name}: {what}: {row['summary']}")
            if row.get("below"):
                lines.append(f"{name}: {row['below']} vertices got below the plate")
    return lines


def device_name(raw: dict) -> str:
    """The name of the device, as the first stage has read it."""
    return next((row["device"]["name"] for row in rows_of(raw, "machine", "device")), "an unknown device")


def stage_table(raw: dict) -> list[str]:
    """How each stage ended, and what it left out."""
    cells = []
    for name in NAMES:
        stage = raw["stages"].get(name)
        if stage is not None:
            left_out = "; ".join(stage["left_out"][:4])
            more = len(stage["left_out"]) - 4
            cells.append([name, stage["status"], f"{stage['seconds']:.1f}", left_out + (f"; {more} more" * (more > 0))])
    return table(["stage", "", "seconds", "left out"], cells)


def goal_table(raw: dict) -> list[str]:
    """Goals, what was measured, and whether they are met; times are judged on a GPU alone."""
    is_real = raw["settings"]["kind"] == CUDA
    cells = []
    for what, goal in ((COLLIDING, GOAL_COLLIDING), (CULLED, GOAL_CULLED)):
        found = [
            row for row in rows_of(raw, "queries", "what") if row["what"] == what and row["precision"] == "float64"
        ]
        best = max(found, key=lambda row: row["queries_a_second"], default=None)
        cells.append(
            [
                f"{what} queries a second in float64",
                f"over {goal / 1e9:.0f} G",
                "–"
                if best is None
                else f"{best['queries_a_second'] / 1e9:.3f} G ({best['block_dim'] or 'its own'} threads a block)",
                met(None if best is None or not is_real else best["queries_a_second"] > goal),
            ]
        )
    large = [row for row in rows_of(raw, "kernels", "launch") if GOAL_FACES <= row["faces"] < 2 * GOAL_FACES]
    slowest = max((row["launch"]["median"] for row in large), default=None)
    said = (
        "–"
        if slowest is None
        else ", ".join(
            f"{row['scene']}: {ms(row['launch']['median'])}, in a graph {ms(row['replay']['median'])}" for row in large
        )
    )
    cells.append(
        [
            "a launch of 200,000 faces",
            "under 1 ms",
            said,
            met(None if slowest is None or not is_real else slowest < GOAL_LAUNCH),
        ]
    )
    stage = raw["stages"].get("bits", {})
    total = totals(rows_of(raw, "bits", "case"))
    differing = total["different"] + total["failed"]
    said = f"{total['arrays']:,} arrays of {total['cases']} calls, {differing} calls differ" if stage else "–"
    is_whole = stage.get("status") == DONE and not stage["left_out"]
    cells.append(["bits as on the CPU", "all", said, met(differing == 0 if is_whole or differing else None)])
    return table(["goal", "", "measured", ""], cells)


def met(is_met: bool | None) -> str:
    """Whether a goal is met, in a word."""
    return "not known" if is_met is None else "met" if is_met else "missed"


def ms(seconds: float | None) -> str:
    """Seconds in milliseconds."""
    return "–" if seconds is None else f"{seconds * 1e3:.3f} ms"


def kernel_table(raw: dict) -> list[str]:
    """Times of whole steps."""
    calls = ("collision_free_step", "mesh_ccd", "find_candidates")
    rows = rows_of(raw, "kernels", "launch")
    cells = (
        [
            row["scene"],
            f"{row['pairs']:,}",
            ms(row["launch"]["median"]),
            ms(row["replay"]["median"]),
            *(ms(row["host"].get(name)) for name in calls),
            ", ".join(f"{name} {ms(seconds)}" for name, seconds in list(row["kernels"].items())[:2]) or "–",
        ]
        for row in rows
    )
    return table(["scene", "pairs", "launch", "in a graph", *calls, "slowest kernels"], cells) if rows else []


def query_table(raw: dict) -> list[str]:
    """Rates by threads a block."""
    rows = rows_of(raw, "queries", "what")
    dims = sorted({row["block_dim"] for row in rows}, key=lambda dim: dim or 0)
    rates = {(r["what"], r["kind"], r["count"], r["precision"], r["block_dim"]): r["queries_a_second"] for r in rows}
    cells = []
    for key in dict.fromkeys(key[:4] for key in rates):
        found = [rates.get((*key, dim)) for dim in dims]
        said = ["–" if rate is None else f"{rate / 1e9:.3f}" for rate in found]
        cells.append([f"{key[2]:,} {key[0]} {key[1]}", key[3], *said])
    return (
        table(["G queries a second", "precision", *(f"{dim or 'its own'} threads a block" for dim in dims)], cells)
        if rows
        else []
    )


def against_table(raw: dict) -> list[str]:
    """Times beside those of the CPU and of newton."""
    cells = [
        [row["scene"], call, ms(row["seconds"]["device"][call]), row["other"], f"{ratio:.2f}"]
        for row in rows_of(raw, "against", "ratios")
        for call, ratio in row["ratios"].items()
    ]
    return table(["scene", "call", "here", "beside", "times as fast"], cells) if cells else []


def broad_phase_table(raw: dict) -> list[str]:
    """Times of the broad phases."""
    rows = rows_of(raw, "broad phases", "launch")
    cells = (
        [
            row["scene"],
            row["broad_phase"],
            ms(row["launch"]["median"]),
            ms(row["find_candidates"]["median"]),
            ", ".join(row["different"]) or "none",
        ]
        for row in rows
    )
    return table(["scene", "broad phase", "launch", "find_candidates", "differences"], cells) if rows else []


def graph_table(raw: dict) -> list[str]:
    """Captures and replays."""
    rows = rows_of(raw, "graphs", "where")
    cells = (
        [row["kind"], row["where"], row.get("replays", 0), row.get("different", "failed"), ms(row.get("seconds"))]
        for row in rows
    )
    return table(["what is captured", "where", "replays", "differ", "a replay"], cells) if rows else []


def reserve_table(raw: dict) -> list[str]:
    """Times of `reserve()` and of first launches."""
    names = ("reserve", "reserve again", "reserve at positions", "first launch", "launch", "first line search")
    rows = rows_of(raw, "reserve", "reserve")
    cells: list[list[Any]] = [[row["mesh"], *(ms(row[name]) for name in names)] for row in rows]
    return table(["mesh", *names], cells) if rows else []
