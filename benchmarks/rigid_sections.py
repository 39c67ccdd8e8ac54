"""The section of docs/benchmarks.md on rigid bodies, from the raw figures."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib.pyplot as plt
from ccd_warp.benchmarks.numbers import error_text, ratio_text, table, time_text
from ccd_warp.benchmarks.scene_sections import apart
from matplotlib.figure import Figure


def of_what(raw: dict, what: str) -> list[dict]:
    """The records of a kind."""
    return [record for record in raw.get("rigid") or [] if record["what"] == what]


def rigid(raw: dict, figures: str) -> list[str]:
    """Time against what is missed, the price of a pair by its turn, the dice, and the edges of a planner."""
    lines = [
        "Processor time of one step on one thread. An answer is missed where ours has a contact and the other none, "
        "and a phantom the other way round; late is a toi above that of ours. What ours says is held against exact "
        "intersections at many times of each step, and against the gap at its toi.",
        "",
    ]
    for record in of_what(raw, "steps"):
        lines += [*_steps(record), ""]
    lines += list(_pairs(raw))
    lines += list(_turns(raw, figures))
    for record in of_what(raw, "dice"):
        lines += [*_dice(record), ""]
    for record in of_what(raw, "edges"):
        lines += [*_edges(record), ""]
    return [*lines[:-1], *apart(raw, "rigid")]


def _steps(record: dict) -> list[str]:
    evidence = record["evidence"]
    missing = ", ".join(record["not_installed"])
    versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
    about = (
        f"**{record['scene']}**: {record['steps']:,} steps, {record['hits']:,} of them with a contact. "
        f"{evidence['samples']:,} exact looks at each step show {evidence['missed']} missed and {evidence['late']} "
        f"late by ours, and {evidence['apart']} of its contacts are none."
    )
    about += f" Not installed: {missing}." if missing else ""
    about += f" {versions}." if versions else ""
    rows = (
        [
            row["method"],
            time_text(row["seconds"]),
            f"**{row['missed']}**" if row["missed"] else "0",
            row["late"],
            row["phantom"],
            error_text(row["error"]),
        ]
        for row in record["rows"]
    )
    return [about, "", *table(["program", "a step", "missed", "late", "phantom", "largest error of toi"], rows)]


def _pairs(raw: dict) -> Iterator[str]:
    records = of_what(raw, "pairs")
    if not records:
        return
    yield from ("ipc-toolkit's `NonlinearCCD` on single pairs, trajectories as Python callbacks, 0.5 rad:", "")
    rows = (
        [
            record["kind"],
            f"{record['hits']} of {record['pairs']}",
            *(time_text(row["seconds"]) for row in record["rows"]),
            record["rows"][1]["missed"],
            record["rows"][1]["phantom"],
            error_text(record["rows"][1]["error"]),
        ]
        for record in records
    )
    header = ["pairs", "contacts", "ours, with all stages", "`NonlinearCCD`", "missed", "phantom", "error of toi"]
    yield from (*table(header, rows), "")


def _turns(raw: dict, figures: str) -> Iterator[str]:
    records = of_what(raw, "turns")
    if not records:
        return
    yield (
        "What a pair costs on arcs: nanoseconds of the narrow phase a pair and step, on arcs and on its chords, and "
        "the ratio of both (beyond 1 rad to the chords at 1 rad); and how many times the solver for a single pair "
        "steps."
    )
    yield ""
    rows = [_turn_row(record["kind"], row) for record in records for row in record["rows"]]
    header = [
        "pairs",
        "turn [rad]",
        "free: arcs, chords",
        "ratio",
        "steps",
        "hit: arcs, chords",
        "ratio",
        "steps, most",
    ]
    yield from (*table(header, rows), "")
    for record in records:
        spin = record["spin"]
        yield (
            f"A pair ({record['kind']}) of bodies that spin together by 1 rad about one axis costs "
            f"{time_text(spin['spinning'])} with all stages, {time_text(spin['still'])} where both stand still."
        )
    yield ""
    yield from (f"![Steps of a pair by its turn]({figures}/bench_turns.png)", "")


def _turn_row(kind: str, row: dict) -> list[str]:
    cells = [kind, f"{row['turn']:.3g}"]
    for name in ("free", "hit"):
        price = row[name]
        chords = f"{1e9 * price['chords']:.0f}" if "chords" in price else "–"
        steps = row["steps"][name]
        text = f"{steps['mean']:.1f}" + (f", {steps['most']}" if name == "hit" else "")
        cells += [f"{1e9 * price['arcs']:.0f}, {chords}", ratio_text(price["ratio"]), text]
    return cells


def _dice(record: dict) -> list[str]:
    about = (
        f"**{record['scene']}**, falling on a plane: {record['touching']:,} pairs of dice touch in the step, with "
        f"{record['contacts']:,} contacts of {record['solved']:,} pairs solved."
    )
    stages = [stage for stage in record["rows"][0]["stages"] if stage != "total"]
    rows = (
        [
            row["method"],
            f"{1e3 * row['seconds']:.0f}",
            *(f"{1e3 * row['stages'].get(stage, 0.0):.0f}" if "stages" in row else "" for stage in stages),
            row.get("missed", ""),
        ]
        for row in record["rows"]
    )
    return [about, "", *table(["milliseconds", "a step", *stages, "missed pairs of dice"], rows)]


def _edges(record: dict) -> list[str]:
    evidence = record["evidence"]
    stages = ", ".join(f"{name} {time_text(seconds)}" for name, seconds in record["rows"][0]["stages"].items())
    about = (
        f"**{record['scene'].capitalize()}** among {record['obstacles']} obstacles: {record['edges']:,} edges of a "
        f"motion planner, 1 rad long, {record['free']:,} of them free. {evidence['samples']:,} exact looks at each of "
        f"{evidence['edges']} edges show {evidence['missed']} missed and {evidence['late']} late by ours, and "
        f"{evidence['apart']} of its contacts are none. Processor time; ours takes "
        f"{time_text(record['rows'][0]['on clock'])} of the clock an edge: {stages}."
    )
    rows = (
        [row["method"], time_text(row["seconds"]), f"**{row['missed']}**" if row["missed"] else "0"]
        for row in record["rows"]
    )
    return [about, "", *table(["program", "an edge", "missed"], rows)]


def draw_turns(raw: dict) -> Figure:
    """Steps that a pair takes by its turn, and its price against that on chords."""
    figure, (steps, price) = plt.subplots(1, 2, figsize=(9.2, 3.8))
    styles = {"vertex-face": "-", "edge-edge": "--"}
    for record in of_what(raw, "turns"):
        turns = [row["turn"] for row in record["rows"]]
        for name, marker in (("free", "o"), ("hit", "s")):
            label = f"{record['kind']}, {name}"
            line = {"linestyle": styles[record["kind"]], "marker": marker, "color": "black" if name == "hit" else "0.5"}
            steps.loglog(turns, [row["steps"][name]["mean"] for row in record["rows"]], label=label, **line)
            price.loglog(turns, [row[name]["ratio"] for row in record["rows"]], label=label, **line)
    steps.set(xlabel="turn of both bodies in the step [rad]", ylabel="steps of the solver, mean")
    price.set(xlabel="turn of both bodies in the step [rad]", ylabel="price on arcs to that on chords")
    for ax in (steps, price):
        ax.grid(alpha=0.3)
        ax.legend(frameon=False, fontsize=8)
    figure.tight_layout()
    return figure
