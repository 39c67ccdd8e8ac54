"""The sections of docs/benchmarks.md on queries, each from the raw figures; `scene_sections` has those on scenes."""

from __future__ import annotations

import pandas as pd
from ccd_warp.benchmarks.machine import describe
from ccd_warp.benchmarks.methods import REFERENCE, SHORT
from ccd_warp.benchmarks.numbers import (
    DEFAULT_TOLERANCE,
    OURS,
    PEERS,
    at_default,
    bound,
    count_text,
    error_of,
    error_text,
    is_peer,
    memory_text,
    ratio_text,
    rows_of,
    set_name,
    share_text,
    table,
    time_text,
)
from ccd_warp.benchmarks.raw_file import frame


def conditions(raw: dict) -> list[str]:
    sweep, cases = raw["settings"]["sweep"], raw["settings"]["cases"]
    lines = [
        f"Measured on: {describe(raw['machine'])}. Code and settings: {raw['fingerprint'][:12]}.",
        "",
        f"- All methods take turns in {sweep['rounds']} rounds ({cases['rounds']} for the hard cases). Times are "
        "medians over the rounds, low and high the extremes: their spread is over repeats, not over samples.",
        "- A query's time is the mean over queries, so a few slow ones set it; the median query stands beside it.",
        "- Ours, the bisection and the baselines are called with batches: "
        f"up to {sweep['batch']:,} queries, tiled from the set, that fit into {sweep['seconds']:g} s "
        f"({cases['batch']:,} and {cases['seconds']:g} s for the hard cases). A method that is too slow for the whole "
        "set gets its first queries, in a fixed random order.",
        "- The peers are called query by query, in a process of their own, on as many of the first queries as fit into "
        f"{sweep['peer_seconds']:g} s ({cases['peer_seconds']:g} s). The cost of the Python call is measured around "
        "every pass on queries that are decided at once, and subtracted; what is left below the scatter of those "
        "measurements is given as that scatter, with `<`.",
        f"- A query of a peer that takes longer than {sweep['cap']:g} s ({cases['cap']:g} s) is stopped and counts as "
        "that long: `>` marks such a time, which is mostly the limit then, and a lower bound. It has no answer, and is "
        "in no column but `limited`.",
        "- The tolerance is a length in the unit of the data; for the hard cases, whose scales differ by hundreds of "
        "orders of magnitude, a multiple of the size of each query's own motion. Additive CCD takes it as the fraction "
        "of the start gap that is left, the cubic as a Euclidean distance, the others as a width along the axes.",
        "- The error is τ − toi against exact arithmetic, where both are finite. `least signed` below zero is a toi "
        "after the contact. Missed, late (by any amount) and phantom are counts among the queries judged, and so is "
        "everything that compares ours with a peer: it is of the queries that both have answered.",
        "- `limited` is the share that a limit cut short: of iterations or resolution (ours, still conservative), or "
        "the time above (peers).",
        "- `MiB` is what a call takes at its peak beside its input: for ours and the baselines of a whole batch, for a "
        "peer what its process grew by, query after query.",
    ]
    if marks := raw.get("measured_apart", {}):
        runs: dict[tuple[str, str], list[str]] = {}
        for part, mark in marks.items():
            runs.setdefault((mark["machine"]["date"], mark["fingerprint"][:12]), []).append(part)
        said = "; ".join(f"{', '.join(parts)} on {date}, {code}" for (date, code), parts in sorted(runs.items()))
        lines.append(f"- Parts that were measured in runs of their own, by date and code: {said}.")
    if not raw["complete"]:
        lines += ["", "**The run was interrupted: parts are missing.**"]
    return lines


# The first call that every raw file has.
FIRST_CALL = "vertex_face_ccd"
# Tolerances of the table that helps to choose one.
_CHOICES = (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)


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
        of = row["timed_queries"] if is_peer(row) else row["queries"]
        rows.append(
            [
                row["method"],
                bound(row) + time_text(row["seconds"]),
                f"{time_text(row['seconds_low'])} … {time_text(row['seconds_high'])}",
                count_text(1 / row["seconds"]),
                f"{row['queries']:,}",
                *(error_text(error_of(row, name)) for name in ("median", "p99", "max", "least_signed")),
                *(f"**{row[fault]}**" if row[fault] else 0 for fault in ("missed", "late")),
                row["phantom"],
                share_text(row["limited"], of),
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
                    bound(peer) + time_text(peer["seconds"]),
                    median_query_text(peer),
                    bound(peer) + ratio_text(peer["seconds"] / ours["seconds"]),
                    *(
                        f"{error_text(error_of(same, k))} / {error_text(error_of(peer, k))}"
                        for k in ("median", "p99", "max")
                    ),
                    *(f"{same[k]} / {peer[k]}" for k in ("missed", "late", "phantom")),
                    f"{peer['limited']} of {peer['timed_queries']:,}",
                ]
            )
    header = [
        "set",
        "peer",
        "ours",
        "peer's",
        "its median query",
        "ratio",
        "median error: ours / peer's",
        "99 %",
        "max",
    ]
    return table([*header, "missed", "late", "phantom", "peer's stopped"], rows)


def median_query_text(row: dict) -> str:
    """Time of a peer's median query, given as a bound where the overhead of a call hides it."""
    hidden = row["median_query_seconds"] <= row["resolution"]
    return ("< " if hidden else "") + time_text(row["median_query_seconds"])


def by_tolerance(raw: dict) -> list[str]:
    """Time and 99th percentile of the error over the sweep."""
    chosen = [OURS, "ours float32", "plain bisection", REFERENCE, "additive CCD", "cubic, closed form"]
    rows = []
    for unit in raw["sweep"]:
        by = rows_of(unit)
        cells = [
            f"{bound(by[m])}{time_text(by[m]['seconds'])}, {error_text(error_of(by[m], 'p99'))}" if m in by else "–"
            for m in chosen
        ]
        rows.append([set_name(unit), f"{unit['tolerance']:.0e}", *cells])
    return table(["set", "tolerance", *chosen], rows)


def ours_by_tolerance(raw: dict) -> list[str]:
    """Effect of tolerance and precision on ours: time, largest error, phantoms."""
    ours = frame(raw, "sweep")
    ours = ours[ours.method.isin(["ours float64", "ours float32"])]
    points = ours.groupby("tolerance").size()
    tolerances = [t for t in _CHOICES if points.get(t) == points.max()]
    of_methods = ours[ours.tolerance.isin(tolerances)]
    texts = pd.DataFrame(
        {
            "set": [set_name(row) for row in of_methods.to_dict("records")],
            "precision": of_methods.method.str.removeprefix("ours ").tolist(),
            "time": of_methods.seconds.map(time_text).tolist(),
            "99 %": of_methods["error.p99"].map(error_text).tolist(),
            "max": of_methods["error.max"].map(error_text).tolist(),
            "phantoms": of_methods.phantom.map(str).tolist(),
        }
    )
    rows = texts.groupby(["set", "precision"], sort=False).agg(" / ".join).reset_index().values
    at = " / ".join(f"{t:.0e}" for t in tolerances)
    header = ["set", "precision", f"time of a query at {at}", "99 % of errors below", "largest error", "phantoms"]
    return [*table(header, rows), "", _gain_of_float32(of_methods)]


def _gain_of_float32(rows: pd.DataFrame) -> str:
    """A sentence on the time of float32 against float64."""
    seconds = rows.pivot_table(index=["set", "kind", "tolerance"], columns="method", values="seconds")
    ratios = seconds["ours float32"] / seconds["ours float64"]
    at_default = ratios.xs(DEFAULT_TOLERANCE, level="tolerance")
    return (
        f"At the default tolerance float32 takes {at_default.min():.2f} to {at_default.max():.2f} of the time of "
        f"float64, by set; over all tolerances of the table {ratios.min():.2f} to {ratios.max():.2f}, in the median "
        f"{ratios.median():.2f}."
    )


def cell_text(row: dict) -> str:
    """missed/late/phantom of a method in a family, its largest error and its time; red where a collision is missed."""
    faults = f"{row['missed']}/{row['late']}/{row['phantom']}"
    if row["missed"] or row["late"]:
        faults = f"{'🟥 ' if row['missed'] else ''}**{faults}**"
    stopped = f" ({row['limited']} of {row['timed_queries']} stopped)" if is_peer(row) and row["limited"] else ""
    return f"{faults}, {error_text(error_of(row, 'max'))}, {bound(row)}{time_text(row['seconds'])}{stopped}"


def hard_cases(raw: dict) -> list[str]:
    names = [m["name"] for m in raw["methods"] if "threads" not in m["name"]]
    rows = []
    for unit in raw["cases"]:
        by = rows_of(unit)
        cells = [cell_text(by[name]) if name in by else "–" for name in names]
        rows.append([f"{unit['family']} {SHORT[unit['kind']]}", *cells])
    return table(["family", *names], rows)


def why(raw: dict) -> list[str]:
    """Why each family is hard, and which methods missed a collision there in this run."""
    cases = frame(raw, "cases")
    missed = cases[cases.missed > 0].groupby(["family", "method"], sort=False).missed.sum()
    said = (missed.index.get_level_values("method") + " " + missed.astype(str)).groupby("family").agg(", ".join)
    reasons = cases.groupby("family", sort=False).why.first()
    rows = ([name, reason, said.get(name, "none")] for name, reason in reasons.items())
    return table(["family", "why it is hard", "missed here"], rows)


def fault_totals(raw: dict) -> list[str]:
    """Missed and late answers of each method over all hard cases."""
    cases = frame(raw, "cases")
    cases["faulty"] = cases[["missed", "late"]].any(axis=1)
    counts = ["queries", "contacts", "missed", "late", "phantom", "faulty"]
    totals = cases.groupby("method", sort=False)[counts].sum()
    rows = ([name, *(f"{n:,}" for n in total)] for name, *total in totals.itertuples())
    return table(["method", "judged", "contacts", "missed", "late", "phantom", "rows with a missed or late one"], rows)


def batches(raw: dict) -> list[str]:
    """Throughput against the size of a batch, and from which size on a call of ours is faster than a peer's calls."""
    data = raw["batches"]
    seconds = frame(raw, "batches").pivot_table(index="count", columns="method", values="seconds", sort=False)
    rates = seconds.rdiv(seconds.index, axis=0).map(lambda rate: "–" if pd.isna(rate) else count_text(rate))
    header = ["queries of a call", *(f"{m}, queries/s" for m in rates.columns)]
    lines = table(header, ([f"{n:,}", *texts] for n, *texts in rates.itertuples()))
    if data["left_out"]:
        lines += ["", f"Left out, as memory would not hold them: {', '.join(f'{n:,}' for n in data['left_out'])}."]
    unit = next((u for u in at_default(raw) if (u["set"], u["kind"]) == (data["family"], "vertex-face")), None)
    if unit is not None:
        by = rows_of(unit)
        for name in PEERS:
            each = by[name]["seconds"] + by[name]["call_overhead"]
            faster = seconds.index[seconds[OURS] < seconds.index * each]
            since = f"ours is faster from {faster[0]:,} on" if len(faster) else "none is large enough for ours"
            what = f"{name}, called from Python for each of the same queries, takes {time_text(each)} a call"
            lines += ["", f"{what}: of the sizes above, {since}."]
        lines += ["", f"A call of ours with a single query takes {time_text(seconds[OURS].iloc[0])}."]
    return lines


def first_calls(raw: dict) -> list[str]:
    """Seconds of first calls; figures of processor time, and calls but one, are in newer raw files only."""

    def seconds(row: dict, name: str) -> str:
        of_processor = row.get(f"{name}_processor")
        return time_text(row[name]) + ("" if of_processor is None else f" ({time_text(of_processor)})")

    rows = [
        [
            f"`{row.get('call', FIRST_CALL)}`, {row['precision']}, {row['device']}",
            seconds(row, "compile"),
            seconds(row, "load"),
        ]
        for row in raw["start"]
    ]
    header = ["first call of a process, imports aside", "nothing compiled before", "kernels in Warp's cache"]
    has_processor = any("compile_processor" in row for row in raw["start"])
    header[1:] = [f"{name}: clock (processor)" if has_processor else name for name in header[1:]]
    return table(header, rows)


def threads(raw: dict) -> list[str]:
    by = frame(raw, "threads").pivot_table(index="what", columns="threads", values="speedup", sort=False)
    rows = ([what, *(f"{speedup:.2f}" for speedup in of)] for what, *of in by.itertuples())
    return table(["speed-up by threads", *map(str, by.columns)], rows)
