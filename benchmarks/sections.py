"""The sections of docs/benchmarks.md, each from the raw figures."""

from __future__ import annotations

import re

from ccd_warp.benchmarks.machine import describe
from ccd_warp.benchmarks.methods import REFERENCE, SHORT
from ccd_warp.benchmarks.numbers import (
    OURS,
    PEERS,
    at_default,
    at_least,
    count_text,
    error_of,
    error_text,
    memory_text,
    ratio_text,
    rows_of,
    set_name,
    table,
    time_text,
)


def conditions(raw: dict) -> list[str]:
    effort = raw["settings"]["sweep"]
    lines = [
        f"Measured on: {describe(raw['machine'])}.",
        "",
        f"- All methods take turns in {effort['rounds']} rounds on the same queries; times are medians over the "
        "rounds, low and high the extremes.",
        "- The tolerance is an absolute length for every method, in the unit of the data; for the hard cases it is a "
        "multiple of the size of each query's own motion.",
        f"- Ours, the bisection and the baselines are called with batches of up to {effort['batch']:,} queries, tiled "
        f"from the set, that fit into {effort['seconds']:g} s; a method that is too slow for the whole set gets its "
        "first queries, in a fixed random order.",
        "- The peers are called query by query, in a process of their own, on as many of the same first queries as "
        f"fit into {effort['peer_seconds']:g} s. The cost of the Python call is measured on a query that is decided at "
        "once, and subtracted. A query that takes longer "
        f"than {effort['cap']:g} s is stopped and counts as that long, so "
        "that `>` marks a lower bound; it has no answer, and is in no other column but `limited`.",
        "- The error is τ − toi against exact arithmetic, where both are finite. `least signed` below zero is a toi "
        "after the contact. Missed, late and phantom are counts among the queries judged.",
        "- `limited` counts answers that a limit cut short: of iterations or resolution (ours, still conservative), or "
        "the time above (peers).",
        "- `MiB` is what a call takes at its peak beside its input; for a peer, what its process grew by.",
    ]
    if not raw["complete"]:
        lines += ["", "**The run was interrupted: parts are missing.**"]
    return lines


def methods(raw: dict) -> list[str]:
    return [f"- **{m['name']}** ({m['group']}): {m['note']}" for m in raw["methods"]]


def sets(raw: dict) -> list[str]:
    rows = []
    for s in raw["sets"]:
        wrong = "–" if s["truth_disagreements"] is None else s["truth_disagreements"]
        rows.append([set_name(s), f"{s['queries']:,}", f"{s['of']:,}", f"{s['contacts']:,}", wrong])
    return table(["set", "queries", "of", "contacts", "published truth unlike exact arithmetic"], rows)


def by_method(unit: dict) -> list[str]:
    """All figures of one point."""
    rows = []
    for row in unit["rows"]:
        rows.append(
            [
                row["method"],
                at_least(row) + time_text(row["seconds"]),
                f"{time_text(row['seconds_low'])} … {time_text(row['seconds_high'])}",
                count_text(1 / row["seconds"]) if row["seconds"] > 0 else "–",
                f"{row['queries']:,}",
                *(error_text(error_of(row, name)) for name in ("median", "p99", "max", "least_signed")),
                *(f"**{row[fault]}**" if row[fault] else 0 for fault in ("missed", "late")),
                row["phantom"],
                "–" if row["limited"] is None else row["limited"],
                memory_text(row["peak_bytes"]),
            ]
        )
    header = ["method", "a query", "low … high", "queries/s", "judged", "error: median", "99 %", "max", "least signed"]
    return table([*header, "missed", "late", "phantom", "limited", "MiB"], rows)


def peer_ratios(raw: dict) -> list[str]:
    """Speed and error of ours against the peers, on the queries that each has answered."""
    rows = []
    for unit in at_default(raw):
        by = rows_of(unit)
        ours = by[OURS]
        for name in PEERS:
            peer = by[name]
            same = peer["ours_on_the_same"]
            rows.append(
                [
                    set_name(unit),
                    name,
                    time_text(ours["seconds"]),
                    at_least(peer) + time_text(peer["seconds"]),
                    at_least(peer) + ratio_text(peer["seconds"] / ours["seconds"]),
                    *(
                        f"{error_text(error_of(same, k))} / {error_text(error_of(peer, k))}"
                        for k in ("median", "p99", "max")
                    ),
                    *(f"{same[k]} / {peer[k]}" for k in ("missed", "late", "phantom")),
                    f"{peer['limited']} of {peer['timed_queries']}",
                ]
            )
    header = ["set", "peer", "ours", "peer's", "ratio", "median error: ours / peer's", "99 %", "max"]
    return table([*header, "missed", "late", "phantom", "peer's stopped"], rows)


def by_tolerance(raw: dict) -> list[str]:
    """Time and 99th percentile of the error over the sweep."""
    chosen = [OURS, "ours float32", "plain bisection", REFERENCE, "additive CCD", "cubic, closed form"]
    rows = []
    for unit in raw["sweep"]:
        by = rows_of(unit)
        cells = [
            f"{at_least(by[m])}{time_text(by[m]['seconds'])}, {error_text(error_of(by[m], 'p99'))}"
            for m in chosen
            if m in by
        ]
        rows.append([set_name(unit), f"{unit['tolerance']:.0e}", *cells])
    return table(["set", "tolerance", *chosen], rows)


def cell_text(row: dict) -> str:
    """missed/late/phantom of a method in a family, and its time."""
    faults = f"{row['missed']}/{row['late']}/{row['phantom']}"
    if row["missed"] or row["late"]:
        faults = f"**{faults}**"
    stopped = f" ({row['limited']} stopped)" if row.get("call_overhead") is not None and row["limited"] else ""
    return f"{faults}, {error_text(error_of(row, 'max'))}, {at_least(row)}{time_text(row['seconds'])}{stopped}"


def hard_cases(raw: dict) -> list[str]:
    names = [m["name"] for m in raw["methods"] if "threads" not in m["name"]]
    rows = []
    for unit in raw["cases"]:
        by = rows_of(unit)
        cells = [cell_text(by[name]) if name in by else "–" for name in names]
        rows.append([f"{unit['family']} {SHORT[unit['kind']]}", *cells])
    return table(["family", *names], rows)


def why(raw: dict) -> list[str]:
    seen = {unit["family"]: unit for unit in raw["cases"]}
    return table(["family", "why it is hard", "what fails"], ([n, u["why"], u["fails"]] for n, u in seen.items()))


def fault_totals(raw: dict) -> list[str]:
    """Missed and late answers of each method over all hard cases."""
    totals: dict[str, list[int]] = {}
    for unit in raw["cases"]:
        for row in unit["rows"]:
            total = totals.setdefault(row["method"], [0] * 6)
            for k, name in enumerate(("queries", "contacts", "missed", "late", "phantom")):
                total[k] += row[name]
            total[5] += bool(row["missed"] or row["late"])
    rows = [[name, *(f"{n:,}" for n in total)] for name, total in totals.items()]
    return table(["method", "judged", "contacts", "missed", "late", "phantom", "rows with a missed or late one"], rows)


def batches(raw: dict) -> list[str]:
    data = raw["batches"] or {"rows": [], "left_out": []}
    names = list(dict.fromkeys(row["method"] for row in data["rows"]))
    counts = sorted({row["count"] for row in data["rows"]})
    seconds = {(row["method"], row["count"]): row["seconds"] for row in data["rows"]}
    rows = [[f"{n:,}", *(count_text(n / seconds[m, n]) if (m, n) in seconds else "–" for m in names)] for n in counts]
    lines = table(["queries of a call", *(f"{m}, queries/s" for m in names)], rows)
    if data["left_out"]:
        lines += ["", f"Left out, as memory would not hold them: {', '.join(f'{n:,}' for n in data['left_out'])}."]
    start = table(
        ["first call of a process", "nothing compiled before", "kernels in Warp's cache"],
        ([f"{r['precision']}, {r['device']}", time_text(r["compile"]), time_text(r["load"])] for r in raw["start"]),
    )
    return [*lines, "", *start]


def threads(raw: dict) -> list[str]:
    counts = sorted({row["threads"] for row in raw["threads"]})
    by: dict[str, dict[int, float]] = {}
    for row in raw["threads"]:
        by.setdefault(row["what"], {})[row["threads"]] = row["speedup"]
    header = ["speed-up by threads", *map(str, counts)]
    return table(header, ([what, *(f"{s[n]:.2f}" for n in counts)] for what, s in by.items()))


def step_cells(row: dict) -> list[str]:
    """Milliseconds of the peer and of ours on a whole step."""
    s = row["seconds"]
    whole = s["peer build"] + s["peer step"]
    values = (s["peer build"], s["find_candidates"], whole, s["collision_free_step"], s["mesh_ccd"])
    return [f"{1e3 * value:.1f}" for value in values]


STEP_HEADER = (
    "scene, faces",
    "LBVH",
    "`find_candidates`",
    "LBVH and step",
    "`collision_free_step`",
    "`mesh_ccd`",
)


def scene_name(row: dict) -> str:
    return row["scene"] if row["device"] == "cpu" else f"{row['scene']} ({row['device']})"


def steps(raw: dict) -> list[str]:
    lines = table(STEP_HEADER, ([scene_name(row), *step_cells(row)] for row in raw["steps"]))
    ratios = [
        [
            scene_name(row),
            *(ratio_text(row["ratio"][n]) for n in ("find_candidates", "collision_free_step", "mesh_ccd")),
            f"{row['step']:.6g} / {row['peer_step']:.6g}",
            f"{sum(row['candidates']):,}",
            row["disagreements"],
        ]
        for row in raw["steps"]
    ]
    header = ["ratio of times, peer's to ours", "`find_candidates`", "`collision_free_step`", "`mesh_ccd`"]
    lines += ["", *table([*header, "step: ours / peer's", "candidates", "unlike the peer's"], ratios)]
    if raw["growth"]:
        rows = [
            [
                f"{row['faces']:,}",
                *(time_text(row["seconds"][n]) for n in ("find_candidates", "collision_free_step", "mesh_ccd")),
                memory_text(row["peak_bytes_above_input"]),
            ]
            for row in raw["growth"]
        ]
        header = ["faces", "`find_candidates`", "`collision_free_step`", "`mesh_ccd`", "peak MiB beside the input"]
        lines += ["", *table(header, rows)]
    if "exponents" in raw:
        powers = ", ".join(f"{name} {value:.2f}" for name, value in raw["exponents"].items())
        lines += ["", f"Powers of the number of faces, fitted: {powers}."]
    return lines


_ERRORS = {"median": "median", "p99": "99th percentile of the", "max": "largest"}


def where_peers_are_better(raw: dict) -> list[str]:
    """Every figure in which a peer, or a baseline that missed nothing, is ahead of ours in float64 on one thread."""
    lines = []
    for unit in raw["sweep"]:
        by = rows_of(unit)
        ours = by[OURS]
        place = f"{set_name(unit)} at {unit['tolerance']:.0e}"
        for name, row in by.items():
            if name.startswith("ours") or not row["queries"]:
                continue
            faulty = f" (missing {row['missed']}, late for {row['late']})" if row["missed"] or row["late"] else ""
            if row["seconds"] < ours["seconds"]:
                errors = [error_text(error_of(r, "p99")) for r in (row, ours)]
                lines.append(
                    f"{place}: {name} takes {time_text(row['seconds'])} a query (99 % of errors below {errors[0]}), "
                    f"ours {time_text(ours['seconds'])} ({errors[1]}){faulty}"
                )
            if (same := row.get("ours_on_the_same")) is None:
                continue
            for key in ("median", "p99", "max"):
                a, b = error_of(same, key), error_of(row, key)
                if a is not None and b is not None and b < a:
                    lines.append(
                        f"{place}: {_ERRORS[key]} error of {name} {error_text(b)}, of ours {error_text(a)}{faulty}"
                    )
            if row["phantom"] < same["phantom"]:
                lines.append(f"{place}: {name} has {row['phantom']} phantoms, ours {same['phantom']}{faulty}")
    for row in raw["steps"]:
        for name, ratio in row["ratio"].items():
            if ratio < 1:
                lines.append(f"{scene_name(row)}: `{name}` takes {1 / ratio:.2f} times the time of the peer")
    return lines


def grouped_better(raw: dict) -> list[str]:
    """The same, as a list of at most a line for each set, method and kind of figure."""
    groups: dict[tuple[str, str], list[str]] = {}
    for line in where_peers_are_better(raw):
        place, rest = line.split(": ", 1)
        found = re.match(r"(.*) at (\S+)$", place)
        method = next((m["name"] for m in raw["methods"] if m["name"] in rest), "")
        figure = next((k for k in ("takes", "phantoms", *_ERRORS.values()) if k in rest), "")
        key = (f"{found[1] if found else place}, {method}".rstrip(", "), figure)
        groups.setdefault(key, []).append(f"at {found[2]}: {rest}" if found else rest)
    lines = []
    for (place, _), found in groups.items():
        more = f" (and at {len(found) - 1} other tolerances)" if len(found) > 1 else ""
        lines.append(f"- {place}: {found[0]}{more}")
    return lines or ["- Nowhere in this run."]
