"""The sections of docs/benchmarks.md on queries, each from the raw figures; `scene_sections` has those on scenes."""

from __future__ import annotations

from ccd_warp.benchmarks.machine import describe
from ccd_warp.benchmarks.methods import REFERENCE, SHORT
from ccd_warp.benchmarks.numbers import (
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
    if not raw["complete"]:
        lines += ["", "**The run was interrupted: parts are missing.**"]
    return lines


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
    by_set: dict[str, dict[float, dict]] = {}
    for unit in raw["sweep"]:
        by_set.setdefault(set_name(unit), {})[unit["tolerance"]] = rows_of(unit)
    tolerances = [t for t in _CHOICES if all(t in units for units in by_set.values())]
    rows = []
    for name, units in by_set.items():
        for precision in ("float64", "float32"):
            found = [units[t][f"ours {precision}"] for t in tolerances]
            cells = (
                " / ".join(texts)
                for texts in (
                    (time_text(row["seconds"]) for row in found),
                    (error_text(error_of(row, "p99")) for row in found),
                    (error_text(error_of(row, "max")) for row in found),
                    (str(row["phantom"]) for row in found),
                )
            )
            rows.append([name, precision, *cells])
    at = " / ".join(f"{t:.0e}" for t in tolerances)
    header = ["set", "precision", f"time of a query at {at}", "99 % of errors below", "largest error", "phantoms"]
    return table(header, rows)


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
    missed: dict[str, dict[str, int]] = {}
    reasons = {}
    for unit in raw["cases"]:
        reasons[unit["family"]] = unit["why"]
        found = missed.setdefault(unit["family"], {})
        for row in unit["rows"]:
            if row["missed"]:
                found[row["method"]] = found.get(row["method"], 0) + row["missed"]
    rows = [
        [name, reason, ", ".join(f"{m} {n}" for m, n in missed[name].items()) or "none"]
        for name, reason in reasons.items()
    ]
    return table(["family", "why it is hard", "missed here"], rows)


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
    """Throughput against the size of a batch, and from which size on a call of ours is faster than a peer's calls."""
    data = raw["batches"]
    names = list(dict.fromkeys(row["method"] for row in data["rows"]))
    counts = sorted({row["count"] for row in data["rows"]})
    seconds = {(row["method"], row["count"]): row["seconds"] for row in data["rows"]}
    rows = [[f"{n:,}", *(count_text(n / seconds[m, n]) if (m, n) in seconds else "–" for m in names)] for n in counts]
    lines = table(["queries of a call", *(f"{m}, queries/s" for m in names)], rows)
    if data["left_out"]:
        lines += ["", f"Left out, as memory would not hold them: {', '.join(f'{n:,}' for n in data['left_out'])}."]
    unit = next((u for u in at_default(raw) if (u["set"], u["kind"]) == (data["family"], "vertex-face")), None)
    if unit is not None:
        by = rows_of(unit)
        for name in PEERS:
            each = by[name]["seconds"] + by[name]["call_overhead"]
            faster = [n for n in counts if seconds[OURS, n] < n * each]
            since = f"ours is faster from {faster[0]:,} on" if faster else "none is large enough for ours"
            what = f"{name}, called from Python for each of the same queries, takes {time_text(each)} a call"
            lines += ["", f"{what}: of the sizes above, {since}."]
        lines += ["", f"A call of ours with a single query takes {time_text(seconds[OURS, counts[0]])}."]
    return lines


def first_calls(raw: dict) -> list[str]:
    rows = [[f"{r['precision']}, {r['device']}", time_text(r["compile"]), time_text(r["load"])] for r in raw["start"]]
    header = ["first call of a process, imports aside", "nothing compiled before", "kernels in Warp's cache"]
    return table(header, rows)


def threads(raw: dict) -> list[str]:
    counts = sorted({row["threads"] for row in raw["threads"]})
    by: dict[str, dict[int, float]] = {}
    for row in raw["threads"]:
        by.setdefault(row["what"], {})[row["threads"]] = row["speedup"]
    header = ["speed-up by threads", *map(str, counts)]
    return table(header, ([what, *(f"{s[n]:.2f}" for n in counts)] for what, s in by.items()))
