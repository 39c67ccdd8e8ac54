"""docs/benchmarks.md, parts of other pages, and the final output of the command, from the raw figures."""

from __future__ import annotations

from pathlib import Path

import rigid_sections, scene_sections, sections
from ahead import ahead
from front_page import speed
from machine import describe
from methods import REFERENCE
from numbers import (
    DEFAULT_TOLERANCE,
    OURS,
    at_default,
    bound,
    ratio_text,
    rows_of,
    set_name,
    time_text,
)
from scene_sections import scene_name, step_cells

COMMAND = "ccd-warp bench --output benchmarks/results --docs ."


def document(raw: dict, figures: str = "figures") -> str:
    """docs/benchmarks.md; every number in it is in the raw file."""

    def picture(name: str, title: str) -> list[str]:
        return [f"![{title}]({figures}/bench_{name}.png)", ""]

    lines = [
        "# Speed against error",
        "",
        "What ccd_warp, the literature's method in the same kernel, ipc-toolkit's Tight-Inclusion and additive CCD, "
        "the univariate cubic and the test at both ends of the step cost, and what their answers are worth against "
        "exact arithmetic. Every number and picture on this page is made from one raw file by one command; run it, "
        "and the page is of your machine:",
        "",
        "```sh",
        f"pip install -e '.[bench]' && {COMMAND}",
        "```",
        "",
        "`--render` writes the page from the raw file alone, `--quick` takes five minutes, `--compare OLD.json` says "
        "what became slower or less accurate.",
        "",
        "## Conditions",
        "",
        *sections.conditions(raw),
        "",
        "## Methods",
        "",
        *sections.methods(raw),
        "",
        "## Sets",
        "",
        *sections.sets(raw),
        "",
    ]
    if raw["sweep"]:
        lines += [
            "## Ours and the peers, at the default tolerance",
            "",
            *sections.peer_ratios(raw),
            "",
            *picture("speed_error", "Time of a query against the error of its toi, for four sets"),
            "A line is a method, and each of its points a tolerance; those of ours lie on each other where the "
            "tolerance changes nothing. At a white dot more than one answer in twenty was cut short by a limit, of "
            "work or of time. [All sets](#the-sweep).",
            "",
            *picture("phantoms", "Phantom contacts against the tolerance"),
            "## Where another method is ahead",
            "",
            "Found by comparing every figure of the sweep and of the hard cases with that of ours in float64 on one "
            "thread, errors and phantoms on the same queries; and the whole steps, small scenes and single pairs. `<` "
            "marks a time that the call's overhead hides: it may be less than ours or not.",
            "",
            *ahead(raw),
            "",
        ]
        lines += [
            "## What to choose",
            "",
            "What tolerance, precision and minimum separation of ours to choose is [a page of its own](choosing.md).",
            "",
        ]
    if raw["cases"]:
        lines += [
            "## Hard cases",
            "",
            f"Tolerance {DEFAULT_TOLERANCE:g}. The families, with what fails on each, are the catalogue "
            "`benchmarks/hard_cases.py`. The univariate methods round to either side of the contact, so that "
            "many of their answers are late by an ulp; what counts is what they miss.",
            "",
            *picture("cases", "Missed, late and phantom answers by family and method"),
            *sections.fault_totals(raw),
            "",
            *sections.why(raw),
            "",
            "A cell is missed/late/phantom, the largest error, and the time of a query; red where a collision is "
            "missed, bold where one is missed or late.",
            "",
            *sections.hard_cases(raw),
            "",
        ]
    if raw["batches"] or raw["start"] or raw["threads"]:
        lines += ["## Batches, the first call, threads", ""]
        lines += picture("scaling", "Batch size, overhead and threads") if raw["batches"] else []
        for name, make in (
            ("batches", sections.batches),
            ("start", sections.first_calls),
            ("threads", sections.threads),
        ):
            lines += [*make(raw), ""] if raw[name] else []
    if raw["steps"]:
        lines += [
            "## Whole steps",
            "",
            "Milliseconds on all cores. The peer is ipc-toolkit: candidates by its LBVH, then its step bound with "
            "Tight-Inclusion; `mesh_ccd` gives contacts, normals and tois, for which it has no counterpart, and is set "
            "against that bound. Each call is made twice in a row and the second timed, the peer's as ours. Not alike: "
            "the peer's tolerance is the length 1e-6, ours 1e-6 of the scene; its bound keeps a fifth of each start "
            "gap (its default, conservative_rescaling = 0.8); it builds its tree anew at each call, ours keeps an "
            "order and buffers between calls, made in the first one, which is given apart; meshes are constructed "
            "beforehand for both. Candidates of the peer that overlap in its float32 boxes alone do not count as "
            "other.",
            "",
            *scene_sections.steps(raw),
            "",
            *picture("steps", "Time of a step by scene, ours and the peer's, and their ratio; logarithmic scales"),
        ]
    if raw.get("broad"):
        lines += [
            "### Broad phases",
            "",
            "Milliseconds on all cores: candidates by ipc-toolkit's LBVH and by ours with a tree and with a spatial "
            "hash, and the stages of `mesh_ccd` that differ between these two: the boxes, which the hash sorts in "
            "every step, and the search with the cull. Candidates of the hash are sorted, those of the tree stay in "
            "the order of the search. The answers of both are equal in every bit.",
            "",
            *scene_sections.broad(raw),
            "",
        ]
    if raw.get("worlds"):
        lines += [
            "### Many worlds",
            "",
            "Microseconds of the processor for a world, of all threads together, where all worlds lie in one place: "
            "they do not grow with the number of worlds. `launch` and `launch_line_search` (by world) take arrays of "
            "Warp and leave their answers there, the others take and give NumPy's. The tois of all are equal in every "
            "bit.",
            "",
            *scene_sections.worlds(raw),
            "",
        ]
    if raw.get("small"):
        lines += [
            "### Small scenes",
            "",
            "Where a scene has few faces the fixed cost of a call counts. Both narrow phases of ipc-toolkit follow its "
            "LBVH. A round calls each in turn, as often in a row as fits some milliseconds; medians over the rounds of "
            "the means. `launch` takes arrays of Warp and leaves its answer there; the other calls take and give "
            "NumPy's.",
            "",
            *scene_sections.small(raw),
            "",
        ]
    if raw.get("pairs"):
        lines += ["### Single pairs", "", *scene_sections.single_pairs(raw), ""]
    if raw["growth"]:
        lines += ["### Growth", "", *scene_sections.growth(raw), ""]
        lines += picture("growth", "Time and memory against the faces of a scene") if "exponents" in raw else []
    if raw.get("rigid"):
        lines += ["## Rigid bodies that turn", "", *rigid_sections.rigid(raw, figures), ""]
    if raw["sweep"]:
        lines += ["## The sweep", "", "Time of a query, and the 99th percentile of the error of its toi.", ""]
        lines += picture("pareto", "Time of a query against the error of its toi, for every set")
        lines += [*sections.by_tolerance(raw), "", "## Every figure at the default tolerance", ""]
        for unit in at_default(raw):
            lines += [f"### {set_name(unit)}", "", *sections.by_method(unit), ""]
    return "\n".join(lines).rstrip() + "\n"


# What stands between marks, by the page on which it is.
TABLES = {
    "README.md": {"speed": speed},
    "docs/choosing.md": {"by tolerance": sections.ours_by_tolerance},
}


def with_tables(page: str, text: str, raw: dict) -> str:
    """A page with its tables between their marks replaced."""
    for name, make in TABLES[page].items():
        text = with_table(text, name, make(raw))
    return text


def with_table(text: str, name: str, lines: list[str]) -> str:
    """A text with the part between two marks replaced."""
    begin, end = _marks(name)
    before, rest = text.split(f"{begin}\n")
    return f"{before}{begin}\n" + "\n".join(lines) + f"\n{end}" + rest.split(end)[1]


def check_docs(root: Path) -> None:
    """Check that a folder is the root of a checkout whose docs can be written.

    Raises:
        ValueError: If it is not.
    """
    front = root / "README.md"
    if not front.is_file() or not (root / "docs").is_dir():
        raise ValueError(f"docs is {root}; expected the root of a checkout, with README.md and docs/")
    for page, tables in TABLES.items():
        text = (root / page).read_text(encoding="utf-8") if (root / page).is_file() else ""
        for mark in (mark for name in tables for mark in _marks(name)):
            if mark not in text:
                raise ValueError(f"docs is {root}, whose {page} lacks the mark {mark}")


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"


def write_docs(root: Path, raw: dict) -> list[Path]:
    """Write docs/benchmarks.md and the tables of other pages of a checkout that `check_docs` has found to be one."""
    texts = {root / page: with_tables(page, (root / page).read_text(encoding="utf-8"), raw) for page in TABLES}
    texts[root / "docs" / "benchmarks.md"] = document(raw)
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return list(texts)


def summary(raw: dict) -> list[str]:
    """A few lines for the terminal."""
    lines = [describe(raw["machine"])]
    if at_default(raw):
        lines += [
            "",
            f"a query at tolerance {DEFAULT_TOLERANCE:g}, one thread; m/l/p: missed, late, phantom where both answered",
            "",
        ]
        lines.append(f"{'set':24} {'ours':>9} {'m/l/p':>8} {REFERENCE:>16} {'m/l/p':>8} {'ratio':>8}")
        for unit in at_default(raw):
            by = rows_of(unit)
            ours, peer = by[OURS], by[REFERENCE]
            same = peer["ours_on_the_same"]
            faults = ["/".join(str(row[k]) for k in ("missed", "late", "phantom")) for row in (same, peer)]
            ratio = ratio_text(peer["seconds"] / ours["seconds"])
            lines.append(
                f"{set_name(unit):24} {time_text(ours['seconds']):>9} {faults[0]:>8} "
                f"{bound(peer) + time_text(peer['seconds']):>16} {faults[1]:>8} {bound(peer) + ratio:>8}"
            )
    if raw["cases"]:
        missed: dict[str, int] = {}
        for unit in raw["cases"]:
            for row in unit["rows"]:
                missed[row["method"]] = missed.get(row["method"], 0) + row["missed"] + row["late"]
        lines += ["", "hard cases, missed or late: " + ", ".join(f"{name} {n}" for name, n in missed.items())]
    if raw["steps"]:
        lines += ["", f"{'whole step, ms':34} {'LBVH + step':>12} {'free step':>10} {'mesh_ccd':>9}"]
        for row in raw["steps"]:
            cells = step_cells(row)
            lines.append(f"{scene_name(row):34} {cells[2]:>12} {cells[3]:>10} {cells[4]:>9}")
    return lines
