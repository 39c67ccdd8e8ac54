"""Pictures and tables of the pages, from the raw figures.

    python benchmarks/report.py                              # draws all pictures, and writes the tables of all pages
    python benchmarks/report.py separation --results DIR     # prints tables of their names

A table stands between two marks of its name on a page: `<!-- NAME: begin -->` and `<!-- NAME: end -->`. Tables whose
parts were not measured stay as they are.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from textwrap import wrap

import pandas as pd
import raw
from checkout import RESULTS, ROOT
from figures import draw_all, exponents
from machine import why_stale
from many_worlds import WORLD_CALLS
from methods import DEFAULT_TOLERANCE, OURS, PEERS, all_methods
from small_scenes import CALLS as SMALL_CALLS
from small_scenes import PEERS as SMALL_PEERS
from texts import (
    error_text,
    memory_text,
    ratio_text,
    scene_name,
    set_name,
    table_of,
    time_text,
)

STEP_CALLS = ("find_candidates", "collision_free_step", "mesh_ccd")
# The sets that others have published; those made here are on the page of the benchmark.
PUBLISHED = ("handcrafted", "simulation")
# Tolerances of the table that helps to choose one.
CHOICES = (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)


def bounds(rows: pd.DataFrame) -> pd.Series:
    """Marks of times of a peer: a lower bound, as queries were stopped, or an upper one, lost in a call's overhead."""
    is_peer = rows.call_overhead.notna()
    stopped, hidden = is_peer & (rows.limited > 0), is_peer & (rows.below_resolution == True)  # noqa: E712
    return stopped.map({True: "> ", False: ""}).where(stopped, hidden.map({True: "< ", False: ""}))


def counted(values: pd.Series) -> pd.Series:
    """Counts with separators of thousands."""
    return values.map(lambda value: f"{value:,.0f}")


def at_default(folder: Path) -> pd.DataFrame:
    """The sweep at the default tolerance, with the name of its set, and the marks of its times."""
    sweep = raw.read(folder, "sweep")
    rows = sweep[sweep.tolerance == DEFAULT_TOLERANCE]
    return rows.assign(name=set_name(rows), bound=bounds(rows))


def methods(folder: Path) -> list[str]:
    named: dict[str, list[str]] = {}  # by what they are, which methods that differ in a detail share
    for m in all_methods(["cpu"]):
        named.setdefault(f"({m.group}): {m.note}", []).append(m.name)
    return [f"- **{', '.join(names)}** {note}" for note, names in named.items() if "threads" not in names[0]]


def sets(folder: Path) -> list[str]:
    rows = raw.read(folder, "sets")
    wrong = rows.truth_disagreements.map(lambda n: "–" if pd.isna(n) else f"{n:.0f}")
    columns = {"set": set_name(rows), **{name: counted(rows[name]) for name in ("queries", "of", "contacts")}}
    return table_of(pd.DataFrame({**columns, "published truth unlike exact arithmetic": wrong}))


def peers(folder: Path) -> list[str]:
    """Speed and error of ours against the peers, on the queries that each has answered."""
    rows = at_default(folder)
    ours = rows[rows.method == OURS].set_index("name").seconds
    rows = rows[rows.method.isin(PEERS)].assign(ours=lambda r: r.name.map(ours))
    columns = {"set": rows.name, "peer": rows.method, "ours": rows.ours.map(time_text)}
    columns["peer's"] = rows.bound + rows.seconds.map(time_text)
    hidden = (rows.median_query_seconds <= rows.resolution).map({True: "< ", False: ""})
    columns["its median query"] = hidden + rows.median_query_seconds.map(time_text)
    columns["ratio"] = rows.bound + (rows.seconds / rows.ours).map(ratio_text)
    for name, header in (("median", "median error: ours / peer's"), ("p99", "99 %"), ("max", "max")):
        both = (rows[f"{of}error.{name}"].map(error_text) for of in ("ours_on_the_same.", ""))
        columns[header] = next(both) + " / " + next(both)
    for fault in ("missed", "late", "phantom"):
        columns[fault] = counted(rows[f"ours_on_the_same.{fault}"]) + " / " + counted(rows[fault])
    columns["peer's stopped"] = counted(rows.limited) + " of " + counted(rows.timed_queries)
    return table_of(pd.DataFrame(columns))


def ahead(folder: Path) -> list[str]:
    """Every set or family, and scene, in which a figure of another method is better than that of ours."""
    lines = list(_ahead_of_queries(folder))
    steps, small, pairs = (raw.read(folder, part) for part in ("steps", "small", "pairs"))
    for name in STEP_CALLS if len(steps) else ():
        for row in steps[steps[f"ratio.{name}"] < 1].to_dict("records"):
            lines.append(f"- {row['scene']}: `{name}` takes {1 / row[f'ratio.{name}']:.2f} times the time of the peer")
    for peer in SMALL_PEERS if len(small) else ():
        ratios = small[[f"seconds.{call}" for call in SMALL_CALLS]].div(small[f"seconds.{peer}"], axis=0).max(axis=1)
        for scene, ratio in zip(small.scene, ratios, strict=True):
            lines += [f"- {scene}, {peer}: a call of ours takes up to {ratio:.1f} times its time"] if ratio > 1 else []
    if len(pairs):
        ratios = pairs["seconds.ours"] / pairs[f"seconds.{SMALL_PEERS[1]}"]
        lines.append(f"- a call with one pair: {ratios.min():.0f} to {ratios.max():.0f} times additive CCD's")
    return lines or ["- Nowhere in this run."]


def _ahead_of_queries(folder: Path) -> Iterator[str]:
    words = {"error.median": "median error", "error.p99": "99th percentile of the error", "error.max": "largest error"}
    for part, keys in (("sweep", ["set", "kind", "tolerance"]), ("cases", ["family", "kind"])):
        rows = raw.read(folder, part)
        if not len(rows):
            continue
        ours = rows[rows.method == OURS].set_index(keys).seconds
        rows = rows[~rows.method.str.startswith("ours") & (rows.queries > 0)].set_index(keys)
        better = {"time": rows.seconds < ours.reindex(rows.index).to_numpy()}
        hidden = rows.below_resolution == True  # noqa: E712
        better["time, or hidden in the overhead of a call"] = ~better["time"] & hidden
        better |= {word: rows[name] < rows[f"ours_on_the_same.{name}"] for name, word in words.items()}
        better["phantoms"] = rows.phantom < rows["ours_on_the_same.phantom"]
        table = pd.DataFrame(better).assign(method=rows.method, missed=rows.missed, late=rows.late).reset_index()
        for (name, kind, method), of in table.groupby([keys[0], "kind", "method"], sort=False):
            if found := [f"{word} ({of[word].sum()} of {len(of)})" for word in better if of[word].any()]:
                faults = [f"{of[fault].sum()} {fault}" for fault in ("missed", "late") if of[fault].any()]
                but = f", with {' and '.join(faults)} answers" if faults else ""
                found = [word.replace(" (1 of 1)", "") for word in found]
                yield f"- {name.replace('_', ' ')}, {kind}: {method}, in {', '.join(found)}{but}"


def fault_totals(folder: Path) -> list[str]:
    """Missed and late answers of each method over all hard cases."""
    cases = raw.read(folder, "cases")
    cases["rows with a missed or late one"] = (cases.missed > 0) | (cases.late > 0)
    names = ["queries", "contacts", "missed", "late", "phantom", "rows with a missed or late one"]
    totals = cases.groupby("method", sort=False)[names].sum()
    return table_of(totals.map(lambda n: f"{n:,}").rename(columns={"queries": "judged"}).reset_index())


def batches(folder: Path) -> list[str]:
    """Throughput against the size of a batch."""
    rows = raw.read(folder, "batches")
    rates = rows.assign(rate=rows["count"] / rows.seconds)
    rates = rates.pivot_table(index="count", columns="method", values="rate", sort=False)
    texts = rates.map(lambda rate: "–" if pd.isna(rate) else time_text(1 / rate)).reset_index()
    texts["count"] = counted(texts["count"])
    return table_of(texts.rename(columns={"count": "queries of a call; time of a query"}))


def start(folder: Path) -> list[str]:
    rows = raw.read(folder, "start")
    call = rows.call if "call" in rows else pd.Series("vertex_face_ccd", rows.index)
    columns = {"first call of a process, imports aside": "`" + call + "`, " + rows.precision + ", " + rows.device}
    columns["nothing compiled before"] = rows["compile"].map(time_text)
    columns["kernels in Warp's cache"] = rows.load.map(time_text)
    return table_of(pd.DataFrame(columns))


def threads(folder: Path) -> list[str]:
    by = raw.read(folder, "threads").pivot_table(index="what", columns="threads", values="speedup", sort=False)
    return table_of(by.map(lambda n: f"{n:.2f}").reset_index().rename(columns={"what": "speed-up by threads"}))


def steps(folder: Path) -> list[str]:
    rows = raw.read(folder, "steps")
    columns = {"scene, faces": scene_name(rows)}
    peer = rows["seconds.peer build"] + rows["seconds.peer step"]
    for name, seconds in {"LBVH": rows["seconds.peer build"], "LBVH and step": peer}.items():
        columns[f"{name} [ms]"] = seconds.map(lambda s: f"{1e3 * s:.1f}")
    for name in STEP_CALLS:
        ratio = rows[f"ratio.{name}"].map(ratio_text)
        columns[f"`{name}`, ratio"] = rows[f"seconds.{name}"].map(lambda s: f"{1e3 * s:.1f}, ") + ratio
    columns["first `mesh_ccd`"] = rows["first.mesh_ccd"].map(time_text)
    step, theirs = (rows[name].map(lambda t: f"{t:.6g}") for name in ("step", "peer_step"))
    columns["step: ours / peer's"] = step + " / " + theirs
    columns["candidates"] = counted(rows.candidates) + " / " + counted(rows.peer_candidates)
    columns["other than the peer's"] = counted(rows.disagreements)
    return table_of(pd.DataFrame(columns))


def broad(folder: Path) -> list[str]:
    rows = raw.read(folder, "broad")
    columns = {"scene, faces": scene_name(rows)}
    stages = product(("find_candidates", "boxes", "pairs", "mesh_ccd"), ("tree", "hash"))
    for name in ("LBVH", *(f"{of} {what}" for what, of in stages)):
        columns[name.replace("_", "\\_")] = rows[f"seconds.{name}"].map(lambda s: f"{1e3 * s:.1f}")
    columns["candidates"] = counted(rows.candidates)
    columns["equal"] = rows.are_equal.map({True: "yes", False: "no"})
    return table_of(pd.DataFrame(columns))


def worlds(folder: Path) -> list[str]:
    """Processor time of a world, for the least and the largest number of them."""
    rows = raw.read(folder, "worlds")
    rows = rows[rows.worlds.isin([rows.worlds.min(), rows.worlds.max()])]
    columns = {"scene": scene_name(rows), "worlds": counted(rows.worlds), "contacts": counted(rows.contacts)}
    for name in WORLD_CALLS:
        call, *of = name.split(", ")
        columns[", ".join([f"`{call}`", *of])] = (1e6 * rows[f"seconds.{name}"] / rows.worlds).map("{:.1f}".format)
    columns["equal"] = rows.are_equal.map({True: "yes", False: "no"})
    return table_of(pd.DataFrame(columns))


def small(folder: Path) -> list[str]:
    rows = raw.read(folder, "small")
    columns = {"scene, faces": scene_name(rows)}
    columns |= {name: rows[f"seconds.{name}"].map(time_text) for name in SMALL_PEERS}
    columns |= {f"`{name}`": rows[f"seconds.{name}"].map(time_text) for name in SMALL_CALLS}
    found = [rows[name].map(lambda t: f"{t:.5g}") for name in ("step", "peer_step", "additive_step")]
    return table_of(pd.DataFrame({**columns, "step: ours / theirs": found[0] + " / " + found[1] + " / " + found[2]}))


def pairs(folder: Path) -> list[str]:
    rows = raw.read(folder, "pairs")
    seconds = {"additive CCD": rows[f"seconds.{SMALL_PEERS[1]}"], "ours": rows["seconds.ours"]}
    columns = {"a call with one pair": rows.pair.str.replace("_", "-")}
    return table_of(pd.DataFrame(columns | {name: of.map(time_text) for name, of in seconds.items()}))


def growth(folder: Path) -> list[str]:
    rows = raw.read(folder, "growth")
    columns = {"faces": counted(rows.faces)} | {f"`{n}`": rows[f"seconds.{n}"].map(time_text) for n in STEP_CALLS}
    columns["peak MiB beside the input"] = rows.peak_bytes_above_input.map(memory_text)
    lines = table_of(pd.DataFrame(columns))
    powers = ", ".join(f"{name} {value:.2f}" for name, value in exponents(rows).items())
    return [
        *lines,
        "",
        f"Powers of the number of faces: {powers}. Below one, fixed costs count at the small end.",
    ]


def rigid(folder: Path) -> list[str]:
    """Time against what is missed: a row for each program, and a column for each scene."""
    rows = raw.read(folder, "rigid")
    lines = []
    for scene, of in rows.groupby("scene", sort=False):
        about = of.iloc[0]
        wrong = [f"{about[f'evidence.{name}']:.0f}" for name in ("missed", "late", "apart")]
        lines.append(
            f"- **{scene}**: {about.steps:,} steps, {about.hits:,} with a contact. {about['evidence.samples']:,} looks "
            f"at each show {wrong[0]} missed and {wrong[1]} late by ours, and {wrong[2]} of its contacts are none."
        )
    faults = rows.missed.astype(str) + " / " + rows.late.astype(str) + " / " + rows.phantom.astype(str)
    cells = rows.seconds.map(time_text) + ", " + faults + ", " + rows.error.map(error_text)
    table = rows.assign(cell=cells, program=rows.method.str.replace(r", (linear|screw)$", "", regex=True))
    table = table.pivot_table(
        index="program", columns="scene", values="cell", aggfunc="first", sort=False, observed=True
    )
    return [*lines, "", *table_of(table[list(rows.scene.unique())].fillna("–").reset_index())]


def speed(folder: Path) -> list[str]:
    """The sentences of the README: ours and the fastest peer on the published sets, and a call with a single pair."""
    rows = at_default(folder)
    rows = rows[rows["set"].isin(PUBLISHED)]
    fastest = min(PEERS, key=lambda name: rows[rows.method == name].seconds.max())
    ours, peer = (rows[rows.method == name] for name in (OURS, fastest))
    totals = [[of[name].sum() for name in ("missed", "late", "phantom")] for of in (ours, peer)]
    faults = f"Ours misses {sum(totals[0][:2])} collisions and the peer {sum(totals[1][:2])}, late answers included."
    if not any(sum(of[:2]) for of in totals):
        faults = "Neither misses a collision or reports one late."
    errors = [[error_text(of[f"error.{name}"].max()) for of in (ours, peer)] for name in ("median", "max")]
    text = (
        f"On {ours.queries.sum():,} published queries, at tolerance 1e-6 on one thread of a CPU, a query takes "
        f"{_between(ours.seconds)} with ours, called with a batch. {fastest[0].upper()}{fastest[1:]} of "
        f"[ipc-toolkit](https://ipctk.xyz), the faster of its two methods, takes {peer.bound.max()}"
        f"{_between(peer.seconds)}, called query by query from Python with the cost of the call subtracted. {faults} "
        f"The median error of a toi is {errors[0][0]} with ours and {errors[0][1]} with the peer, in the worst set, "
        f"the largest error {errors[1][0]} and {errors[1][1]}; {totals[0][2]} and {totals[1][2]} answers are phantoms."
    )
    single = raw.read(folder, "pairs")
    if len(single):
        of = [_between(single[f"seconds.{name}"]) for name in ("ours", SMALL_PEERS[1])]
        text += f" A single pair in a call of its own costs ours {of[0]}, and the peer {of[1]}."
    return wrap(text, 120, break_long_words=False, break_on_hyphens=False)


def _between(seconds: pd.Series) -> str:
    low, high = time_text(seconds.min()), time_text(seconds.max())
    return low if low == high else f"{low} to {high}"


def by_tolerance(folder: Path) -> list[str]:
    """Effect of tolerance and precision on ours: time, largest error, phantoms."""
    ours = raw.read(folder, "sweep")
    ours = ours[ours.method.isin(["ours float64", "ours float32"]) & ours.tolerance.isin(CHOICES)]
    texts = pd.DataFrame({"set": set_name(ours), "precision": ours.method.str.removeprefix("ours ")})
    at = " / ".join(f"{t:.0e}" for t in CHOICES if t in set(ours.tolerance))
    texts[f"time of a query at {at}"] = ours.seconds.map(time_text)
    texts["99 % of errors below"] = ours["error.p99"].map(error_text)
    texts["largest error"] = ours["error.max"].map(error_text)
    texts["phantoms"] = ours.phantom.astype(str)
    lines = table_of(texts.groupby(["set", "precision"], sort=False).agg(" / ".join).reset_index())
    seconds = ours.pivot_table(index=["set", "kind", "tolerance"], columns="method", values="seconds")
    ratios = seconds["ours float32"] / seconds["ours float64"]
    default = ratios.xs(DEFAULT_TOLERANCE, level="tolerance")
    gain = (
        f"At the default tolerance float32 takes {default.min():.2f} to {default.max():.2f} of the time of float64, by "
        f"set; over all tolerances of the table {ratios.min():.2f} to {ratios.max():.2f}, in the median "
        f"{ratios.median():.2f}."
    )
    return [*lines, "", gain]


def separation(folder: Path) -> list[str]:
    rows = raw.read(folder, "separation")
    columns = {"separation": rows.separation.map("{:g}".format)}
    columns["in edge lengths"] = (rows.separation / rows.edge_length).map("{:.2g}".format)
    columns |= {name: counted(rows[name]) for name in ("candidates", "after the cull", "contacts")}
    columns |= {"toi": rows.toi.map("{:.5f}".format), "`mesh_ccd`": rows.seconds.map(time_text)}
    return table_of(pd.DataFrame(columns))


def gpu_launches(folder: Path) -> list[str]:
    """Launches of scenes on a GPU and on the CPU beside it, with the kernels that take longest."""
    rows, code = raw.read(folder, "gpu_times"), raw.read(folder, "cuda_code")
    rows = rows[rows.scene.notna()].assign(is_cpu=lambda r: r.device == "cpu")
    stages = code[code.kernel == "solve_pairs"].set_index("hash").module.str.split().str[2]

    def shares(kernels: dict[str, float]) -> str:
        parts = [(name.rpartition("_")[::2], seconds / sum(kernels.values())) for name, seconds in kernels.items()]
        named = [(f"`{short.split('__')[-1]}` {stages.get(key, '')}".strip(), part) for (short, key), part in parts]
        return ", ".join(f"{name} {100 * part:.0f} %" for name, part in named if part >= 0.08)

    on_cpu = rows[rows.is_cpu].set_index("scene")[["launch", "mesh_ccd"]].add_prefix("cpu ")
    rows = rows[~rows.is_cpu].join(on_cpu, on="scene")
    columns = {"scene": rows.scene, "pairs": counted(rows.pairs), "broad phase": rows.broad_phase}
    columns |= {"`launch`": rows.launch.map(time_text), "in a graph": rows.replay.map(time_text)}
    columns |= {"its kernels": rows.kernels.map(shares), "`launch` on the CPU": rows["cpu launch"].map(time_text)}
    columns |= {
        f"`mesh_ccd`{of}": rows[f"{key}mesh_ccd"].map(time_text)
        for of, key in ((" there", ""), (" on the CPU", "cpu "))
    }
    return table_of(pd.DataFrame(columns))


def gpu_queries(folder: Path) -> list[str]:
    rows = raw.read(folder, "gpu_times")
    rows = rows[rows.queries.notna()]
    rates = rows.assign(
        count=counted(rows.queries) + " queries", rate=(rows.queries_a_second / 1e9).map("{:.3f}".format)
    )
    rates["ends"] = rates.touching.map({1: "touch", 0: "freed by the first test"})
    table = rates.pivot_table(
        index=["kind", "ends", "precision"], columns="count", values="rate", aggfunc="first", sort=False
    )
    return table_of(table.add_suffix(" [G/s]").reset_index().rename(columns={"ends": "queries that"}))


def gpu_first(folder: Path) -> list[str]:
    rows = raw.read(folder, "gpu_times")
    rows = rows[rows.worlds.notna()]
    calls = {name: rows[name].map(time_text) for name in ("reserve", "first launch", "launch", "first line search")}
    return table_of(pd.DataFrame({"worlds of 400 faces": counted(rows.worlds), **calls}))


def cuda_code(folder: Path) -> list[str]:
    """What solvers keep on the stack, and what the driver reserves for it on 132 multiprocessors of 2,048 threads."""
    rows = raw.read(folder, "cuda_code")
    rows = rows.join(rows.module.str.extract(r"queued_pairs (?P<solver>\w+ \w+ \w+) ?(?P<norm>\w*)"))
    table = rows.fillna({"norm": ""}).pivot_table(index="solver", columns="norm", values="stack", sort=False)
    most = counted(table.max(axis=1) * 132 * 2048 / 1e6) + " MB"
    table = (
        table[sorted(table, key=len)]
        .map(lambda stack: "–" if pd.isna(stack) else f"{stack:,.0f}")
        .assign(reserved=most)
    )
    return table_of(table.rename(columns={"": "maximum"}).reset_index())


def gradients(folder: Path) -> list[str]:
    rows = raw.read(folder, "gradients")
    is_new = rows.scene != rows.scene.shift()
    columns = {"scene": rows.scene.where(is_new, ""), "contacts": counted(rows.contacts).where(is_new, "")}
    plain = rows["seconds.plain"]
    columns |= {"call": rows.call, "ms": (1e3 * plain).map("{:.3g}".format)}
    columns["on a tape"] = (100 * rows["seconds.on a tape"] / plain - 100).map("{:+.1f} %".format)
    columns["backward"] = (100 * rows["seconds.backward"] / plain).map("{:.1f} %".format)
    return table_of(pd.DataFrame(columns))


def measured(folder: Path) -> list[str]:
    """Where, when and of which commit each part was measured."""
    runs = raw.read(folder, raw.RUNS)
    runs = runs.assign(about=[raw.described(folder, part).rpartition(", ")[0] for part in runs.part])
    runs["code"] = [why_stale(code).partition(", since")[0] or f"of {code}" for code in runs.code.fillna("")]
    by_machine = runs.groupby("about", sort=False)
    return [
        f"- {about}: "
        + "; ".join(f"{', '.join(of.part)} on {date}, {code}" for (date, code), of in rows.groupby(["date", "code"]))
        + "."
        for about, rows in by_machine
    ]


# What makes the table of each mark, and the part that it is of.
TABLES: dict[str, tuple[Callable[[Path], list[str]], str]] = {
    "speed": (speed, "sweep"),
    "by tolerance": (by_tolerance, "sweep"),
    "launches on a GPU": (gpu_launches, "gpu_times"),
    "queries on a GPU": (gpu_queries, "gpu_times"),
    "first calls on a GPU": (gpu_first, "gpu_times"),
    "stack of kernels": (cuda_code, "cuda_code"),
    "what gradients cost": (gradients, "gradients"),
    "measured": (measured, raw.RUNS),
    "methods": (methods, raw.RUNS),
    **{each.__name__: (each, "sweep") for each in (peers, ahead)},
    "fault_totals": (fault_totals, "cases"),
}
for each in (sets, batches, start, threads, steps, broad, worlds, small, pairs, growth, rigid, separation):
    TABLES[each.__name__] = (each, each.__name__)


def with_tables(text: str, folder: Path) -> str:
    """A page with what stands between the marks of tables replaced."""
    for name, (make, part) in TABLES.items():
        begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
        if begin in text and len(raw.read(folder, part)):
            before, rest = text.split(begin)
            text = before + begin + "\n".join(make(folder)) + "\n" + end + rest.split(end)[1]
    return text


def main() -> None:
    """Draw the pictures and write the tables of all pages of a checkout, or print some tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"print these tables: {', '.join(TABLES)}")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of CSV files that run.py has written")
    parser.add_argument("--docs", type=Path, default=ROOT, help="root of a checkout, with README.md and docs/")
    options = parser.parse_args()
    for name in options.names:
        make, part = TABLES[name]
        print("\n".join(make(options.results)) if len(raw.read(options.results, part)) else f"{part} was not measured")
    if options.names:
        return
    draw_all(options.results, options.docs / "docs" / "figures")
    for page in [options.docs / "README.md", *sorted((options.docs / "docs").rglob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        if (new := with_tables(text, options.results)) != text:
            page.write_text(new, encoding="utf-8")
            print(f"wrote {page}")


if __name__ == "__main__":
    main()
