"""The summary of a check in Markdown: how each stage ended, the goals, and the figures of each stage in a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ccd_warp.benchmarks.gpu_check.bits import totals
from ccd_warp.benchmarks.gpu_check.journal import FAILED, LEFT_OUT, StageRecord
from ccd_warp.benchmarks.gpu_check.queries import COLLIDING, CULLED
from ccd_warp.benchmarks.gpu_check.stages import NAMES
from ccd_warp.benchmarks.gpu_check.target import CUDA
from ccd_warp.benchmarks.numbers import table

# The goals on a GPU: queries a second in float64, and seconds of a launch of a mesh of some 200,000 faces.
GOAL_COLLIDING, GOAL_CULLED = 1e9, 5e9
GOAL_LAUNCH, GOAL_FACES = 1e-3, 190_000
_MOST_COMPLAINTS = 30
Stages = dict[str, StageRecord]


def rows_of(stages: Stages, stage: str, having: str) -> list[dict]:
    """The rows of a stage that have a value; none where it has not run."""
    return [row for row in stages.get(stage, StageRecord()).rows if having in row]


def summary(settings: dict, stages: Stages) -> list[str]:
    """All lines."""
    lines = [f"# Check of ccd_warp on {device_name(stages)}", ""]
    kind = settings["kind"]
    if kind != CUDA:
        lines += [f"This is a rehearsal ({kind}): no time below is one of a GPU.", ""]
    lines += ["## Stages", "", *stage_table(stages), "", "## Goals", "", *goal_table(stages, kind == CUDA), ""]
    wrong = complaints(stages)
    if wrong:
        lines += ["## What is wrong", "", *(f"- {line}" for line in wrong[:_MOST_COMPLAINTS])]
        lines += [f"- {len(wrong) - _MOST_COMPLAINTS} more"] if len(wrong) > _MOST_COMPLAINTS else []
        lines += [""]
    for title, rows in figures(stages):
        if rows:
            lines += [f"## {title}", "", *table(rows[0], (row.values() for row in rows)), ""]
    failed = [
        (f"{name}: {case}", why) for name, stage in stages.items() for case, why in stage.failed.items() if "\n" in why
    ]
    if failed:
        lines += ["## Errors", ""]
        for name, why in failed:
            lines += [f"{name}:", "", "```text", why.strip(), "```", ""]
    return lines


def complaints(stages: Stages) -> list[str]:
    """A line for each stage that did not come to its end, and for each case that failed."""
    lines = []
    for name, stage in stages.items():
        if stage.why and stage.status != LEFT_OUT:
            lines.append(f"{name}: {stage.status}, {stage.why.strip().splitlines()[-1]}")
        for case, why in stage.failed.items():
            lines.append(f"{name}: {case}: {why.strip().splitlines()[-1][:300] if why.strip() else FAILED}")
    return lines


def device_name(stages: Stages) -> str:
    """The name of the device, as the first stage has read it."""
    return next((row["device"]["name"] for row in rows_of(stages, "machine", "device")), "an unknown device")


def stage_table(stages: Stages) -> list[str]:
    """How each stage ended, and what it left out."""
    cells = []
    for name in NAMES:
        stage = stages.get(name)
        if stage is not None:
            left_out = "; ".join(stage.left_out[:4])
            more = len(stage.left_out) - 4
            counts = Counter(line["outcome"] for line in stage.cases.values())
            said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
            cells.append([name, stage.status, f"{stage.seconds:.1f}", said, left_out + f"; {more} more" * (more > 0)])
    return table(["stage", "", "seconds", "cases", "left out"], cells)


def goal_table(stages: Stages, is_real: bool) -> list[str]:
    """Goals, what was measured, and whether they are met; times are judged on a GPU alone."""
    cells = []
    for what, goal in ((COLLIDING, GOAL_COLLIDING), (CULLED, GOAL_CULLED)):
        found = [
            row for row in rows_of(stages, "queries", "what") if row["what"] == what and row["precision"] == "float64"
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
    large = [row for row in rows_of(stages, "kernels", "launch") if GOAL_FACES <= row["faces"] < 2 * GOAL_FACES]
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
    stage = stages.get("bits", StageRecord())
    failed = len(stage.failed)
    said = f"{totals(stage.rows)['arrays']:,} arrays of {len(stage.rows)} calls, {failed} calls differ or fail"
    is_whole = stage.is_whole and not stage.left_out
    verdict = met(failed == 0 if is_whole or failed else None)
    cells.append(["bits as on the CPU", "all", said if stage.cases else "–", verdict])
    return table(["goal", "", "measured", ""], cells)


def met(is_met: bool | None) -> str:
    """Whether a goal is met, in a word."""
    return "not known" if is_met is None else "met" if is_met else "missed"


def ms(seconds: float | None) -> str:
    """Seconds in milliseconds."""
    return "–" if seconds is None else f"{seconds * 1e3:.3f} ms"


def figures(stages: Stages) -> Iterator[tuple[str, list[dict[str, str]]]]:
    """A title, and the rows of its table with the text of each column, for every stage that has measured something."""

    def rows(stage: str, having: str) -> list[dict]:
        return rows_of(stages, stage, having)

    calls = ("collision_free_step", "mesh_ccd", "find_candidates")
    yield (
        "Whole steps",
        [
            {
                "scene": row["scene"],
                "pairs": f"{row['pairs']:,}",
                "launch": ms(row["launch"]["median"]),
                "in a graph": ms(row["replay"]["median"]),
                **{name: ms(row["host"].get(name)) for name in calls},
                "slowest kernels": ", ".join(f"{k} {ms(seconds)}" for k, seconds in list(row["kernels"].items())[:2])
                or "–",
            }
            for row in rows("kernels", "launch")
        ],
    )
    rates: dict[tuple, dict[str, str]] = {}
    queries = rows("queries", "what")
    dims = sorted({row["block_dim"] for row in queries}, key=lambda dim: dim or 0)
    for row in queries:
        line = f"{row['count']:,} {row['what']} {row['kind']}", row["precision"]
        of_line = rates.setdefault(line, dict.fromkeys((f"{dim or 'its own'} threads a block" for dim in dims), "–"))
        of_line[f"{row['block_dim'] or 'its own'} threads a block"] = f"{row['queries_a_second'] / 1e9:.3f}"
    yield (
        "Queries",
        [{"G queries a second": name, "precision": precision, **row} for (name, precision), row in rates.items()],
    )
    yield (
        "Beside others",
        [
            {
                "scene": row["scene"],
                "call": call,
                "here": ms(row["seconds"]["device"][call]),
                "beside": row["other"],
                "times as fast": f"{ratio:.2f}",
            }
            for row in rows("against", "ratios")
            for call, ratio in row["ratios"].items()
        ],
    )
    yield (
        "Broad phases",
        [
            {
                "scene": row["scene"],
                "broad phase": row["broad_phase"],
                **{name: ms(row[name]["median"]) for name in ("launch", "find_candidates")},
            }
            for row in rows("broad phases", "launch")
        ],
    )
    yield (
        "Graphs",
        [
            {
                "what is captured": row["kind"],
                "where": row["where"],
                "replays": str(row["replays"]),
                "a replay": ms(row["seconds"]),
            }
            for row in rows("graphs", "where")
        ],
    )
    names = ("reserve", "reserve again", "reserve at positions", "first launch", "launch", "first line search")
    yield (
        "reserve()",
        [{"mesh": row["mesh"], **{name: ms(row[name]) for name in names}} for row in rows("reserve", "reserve")],
    )
