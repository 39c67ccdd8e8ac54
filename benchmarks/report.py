"""Pictures and tables of the pages, from the raw figures.

    python benchmarks/report.py                              # draws all pictures, and writes the tables of all pages
    python benchmarks/report.py --check                      # names pages whose tables are others
    python benchmarks/report.py separation --results DIR     # prints tables of their names

A table stands between two marks of its name on a page: `<!-- NAME: begin -->` and `<!-- NAME: end -->`. Tables whose
parts were not measured stay as they are. Figures of a commit that is not in the history are refused.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import wrap

import numpy as np
import pandas as pd
import raw
from checkout import RESULTS, ROOT
from figures import draw_all
from machine import has_history, why_refused
from many_worlds import WORLD_CALLS
from methods import DEFAULT_TOLERANCE, OURS, PEERS, SHOWN, all_methods
from small_scenes import ADDITIVE
from small_scenes import CALLS as SMALL_CALLS
from small_scenes import PEERS as SMALL_PEERS
from texts import (
    error_text,
    memory_text,
    ratio_text,
    scene_name,
    set_name,
    table,
    table_of,
    time_text,
)
from whole_step import LBVH, NARROW

STEP_CALLS = ("find_candidates", "collision_free_step", "mesh_ccd")
MOST_STACKS = 600e6  # bytes that the kernels of a table reserve at least
FRONTIER_AT = (1e-3, 1e-6, 1e-9)
# Families of hard cases by what is hard.
HARD = {
    "in a plane": ("one_plane", "collinear", "sliding_in_plane_rotating", "infinite_roots"),
    "parallel edges": ("parallel_edges",),
    "slivers, no area": ("slivers", "needle_against_needle", "zero_size_primitives", "mixed_sizes"),
    "grazing": ("grazing_vertex", "edge_through_vertex", "double_root", "one_ulp_neighbours", "simultaneous_contacts"),
    "far from the origin": ("offset_1e6",),
    "tiny and huge scales": ("scaled_2_pow_200", "scaled_2_pow_minus_200", "mixed_axis_scales"),
    "tiny and huge motion": ("tiny_motion", "huge_motion", "fast_and_thin", "rotation_like"),
    "touching at the start or end": ("touching_at_start", "contact_exactly_at_end", "no_motion"),
}
# The sets that others have published; those made here are on the page of the benchmark.
PUBLISHED = ("handcrafted", "simulation")
# The largest and the smallest tolerance among which one would choose.
CHOICES = (1e-2, 1e-12)


def bounds(rows: pd.DataFrame) -> pd.Series:
    """Marks of times of a peer: a lower bound, as queries were stopped, or an upper one, lost in a call's overhead."""
    is_peer = rows.call_overhead.notna()
    stopped, hidden = is_peer & (rows.limited > 0), is_peer & (rows.below_resolution == True)  # noqa: E712
    return stopped.map({True: "> ", False: ""}).where(stopped, hidden.map({True: "< ", False: ""}))


def said(text: str) -> list[str]:
    """Lines of a paragraph."""
    return wrap(text, 120, break_long_words=False, break_on_hyphens=False)


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


def frontier(folder: Path) -> list[str]:
    """Speed against error over all sets: a row for each method, with its faults in numbers."""
    rows = raw.read(folder, "sweep")
    rows = rows[rows.method.isin(SHOWN) & rows.tolerance.isin(FRONTIER_AT)]
    at, lines = sorted(rows.tolerance.unique(), reverse=True), []
    for method in SHOWN:
        of = [rows[(rows.method == method) & (rows.tolerance == tolerance)] for tolerance in at]
        times = [f"{bounds(each).max()}{_between(each.seconds)}" for each in of]
        errors = [[error_text(each[f"error.{name}"].max()) for each in of] for name in ("median", "p99", "max")]
        names = ("queries", "missed", "late", "phantom", "limited")
        faults = [[f"{each[name].sum():,.0f}" for each in of] for name in names]
        lines.append([method, *map(" / ".join, ([*times], *errors, *faults))])
    header = ["method", f"time of a query by set, at {' / '.join(f'{t:.0e}' for t in at)}"]
    header += [f"{name}, of the worst set" for name in ("median error", "99 %", "largest")]
    return table([*header, "judged", "missed", "late", "phantom", "cut short"], lines)


def peers(folder: Path) -> list[str]:
    """Times and errors of ours and of the peers by set."""
    rows, sets = at_default(folder), raw.read(folder, "sets")
    columns = {"set": set_name(sets), "queries": counted(sets.queries), "contacts": counted(sets.contacts)}
    of = {name: rows[rows.method == name].set_index("name").loc[columns["set"]] for name in (OURS, *PEERS)}
    for name, each in of.items():
        columns[name] = (each.bound + each.seconds.map(time_text)).to_numpy()
    for name in PEERS:
        columns[f"ratio, {name}"] = (of[name].bound + (of[name].seconds / of[OURS].seconds).map(ratio_text)).to_numpy()
        stopped = counted(of[name].limited) + " of " + counted(of[name].timed_queries)
        columns[f"stopped, {name}"] = stopped.to_numpy()
    for part, header in (("median", "median error"), ("p99", "99 %")):
        texts = [each[f"error.{part}"].map(error_text).to_numpy() for each in of.values()]
        columns[header] = [" / ".join(each) for each in zip(*texts, strict=True)]
    agree = sets[sets.truth_disagreements.notna()]
    text = f"Of {agree.queries.sum():,} queries with published truth exact arithmetic says otherwise for "
    return [*table_of(pd.DataFrame(columns)), "", f"{text}{agree.truth_disagreements.sum():.0f}."]


def ahead(folder: Path) -> list[str]:
    """Of each other method the sets, families and scenes in which a figure of it is better than that of ours."""
    found: dict[str, list[str]] = {}
    for method, where in _ahead_of_queries(folder):
        found.setdefault(method, []).append(where)
    steps, small, pairs = (raw.read(folder, part) for part in ("steps", "small", "pairs"))
    for row in _against_peers(steps).to_dict("records") if len(steps) else ():
        better = {f"time, {row['ratio']:.2f} of ours": row["ratio"] < 1, "error": row["short"] < row["ours_short"]}
        words = [word for word, is_better in better.items() if is_better and not row["late"]]
        where = f"{row['scene']}, {row['threads']} threads, {row['setting']} ({' and '.join(words)})"
        found.setdefault(row["method"], []).extend([where] if words else [])
    for peer in SMALL_PEERS if len(small) else ():
        like = [f"seconds.{call}" for call in SMALL_CALLS if call.endswith("collision_free_step")]  # the peer's answer
        ratios = small[like].div(small[f"seconds.{peer}"], axis=0).max(axis=1)
        slower = [f"{scene} (time, {ratio:.1f})" for scene, ratio in zip(small.scene, ratios, strict=True) if ratio > 1]
        found.setdefault(f"LBVH with {peer}, in small scenes", []).extend(slower)
    if len(pairs):
        ratios = pairs["seconds.ours"] / pairs[f"seconds.{ADDITIVE}"]
        found.setdefault(ADDITIVE, []).append(f"a call with one pair (time, {ratios.min():.0f} to {ratios.max():.0f})")
    return [f"- **{method}**: {'; '.join(where)}." for method, where in found.items() if where]


def _ahead_of_queries(folder: Path) -> Iterator[tuple[str, str]]:
    """Methods, and where they are ahead: in what, at how many of the tolerances, with which faults."""
    words = {"error.median": "median error", "error.p99": "99 % of errors", "error.max": "largest error"}
    for part, keys in (("sweep", ["set", "kind", "tolerance"]), ("cases", ["family", "kind"])):
        rows = raw.read(folder, part)
        rows = rows[rows.method.isin(SHOWN)] if len(rows) else rows
        if not len(rows):
            continue
        ours = rows[rows.method == OURS].set_index(keys).seconds
        rows = rows[~rows.method.str.startswith("ours") & (rows.queries > 0)].set_index(keys)
        better = {"time": (rows.seconds < ours.reindex(rows.index).to_numpy()) | (rows.below_resolution == True)}  # noqa: E712
        better |= {word: rows[name] < rows[f"ours_on_the_same.{name}"] for name, word in words.items()}
        better["phantoms"] = rows.phantom < rows["ours_on_the_same.phantom"]
        grouped = pd.DataFrame(better).assign(method=rows.method, missed=rows.missed, late=rows.late).reset_index()
        for (name, kind, method), of in grouped.groupby([keys[0], "kind", "method"], sort=False):
            if found := [f"{word} {of[word].sum()} of {len(of)}" for word in better if of[word].any()]:
                found = [word.removesuffix(" 1 of 1") for word in found]
                found += [f"{of[fault].sum()} {fault}" for fault in ("missed", "late") if of[fault].any()]
                short = {"vertex-face": "VF", "edge-edge": "EE"}[kind]
                yield method, f"{name.replace('_', ' ')} {short} ({', '.join(found)})"


def batches(folder: Path) -> list[str]:
    """Throughput against the size of a batch."""
    rows = raw.read(folder, "batches")
    rows = rows[rows["count"].isin([1, 10, 1_000, 100_000, rows["count"].max()])]
    rates = rows.assign(rate=rows["count"] / rows.seconds)
    rates = rates.pivot_table(index="count", columns="method", values="rate", sort=False)
    texts = rates.map(lambda rate: "–" if pd.isna(rate) else time_text(1 / rate)).reset_index()
    texts["count"] = counted(texts["count"])
    return table_of(texts.rename(columns={"count": "queries of a call; time of a query"}))


def start(folder: Path) -> list[str]:
    rows = raw.read(folder, "start")
    columns = {"first call of a process, imports aside": "`" + rows.call + "`, " + rows.precision + ", " + rows.device}
    columns["nothing compiled before"] = rows["compile"].map(time_text)
    columns["kernels in Warp's cache"] = rows.load.map(time_text)
    return table_of(pd.DataFrame(columns))


def _against_peers(steps: pd.DataFrame, call: str = "collision_free_step") -> pd.DataFrame:
    """Rows of the peers' steps with the ratio of their times to that of a call of ours, and its error."""
    keys = ["scene", "device", "threads"]
    ours = steps[(steps.method == OURS) & (steps.setting == call)].set_index(keys)
    rows = steps[[name in NARROW for name in zip(steps.method, steps.setting, strict=True)]]
    same = ours.loc[pd.MultiIndex.from_frame(rows[keys])]
    return rows.assign(ratio=rows.seconds / same.seconds.to_numpy(), ours_short=same.short.to_numpy())


def _by_threads(rows: pd.DataFrame) -> pd.Series:
    """Milliseconds of a call by scene: on one thread, and on all."""
    texts = rows.assign(text=(1e3 * rows.seconds).map("{:.1f}".format)).sort_values("threads")
    return texts.groupby(scene_name(texts), sort=False).text.agg(" / ".join)


def _scene_table(steps: pd.DataFrame, names: dict[tuple[str, str], str], has_error: bool) -> pd.DataFrame:
    """Times of calls, columns by their headers, by scene."""
    columns = {}
    for (method, setting), header in names.items():
        rows = steps[(steps.method == method) & (steps.setting.fillna("") == setting)]
        columns[header] = _by_threads(rows)
        if has_error:
            columns[header] += ", " + rows.groupby(scene_name(rows)).short.max().map(error_text)
    return pd.DataFrame(columns)


def steps(folder: Path) -> list[str]:
    """Times and errors of the free step of ours and of the peers, and how many times that of ours each takes."""
    rows = raw.read(folder, "steps")
    first = rows.drop_duplicates(["scene", "device"])
    names = {name: ", ".join(name) for name in NARROW} | {(OURS, call): f"`{call}`" for call in STEP_CALLS[1:]}
    columns = _scene_table(rows, names, True).loc[scene_name(first)]
    columns.insert(0, "exact toi", first.exact.map(lambda t: f"{t:.6g}" if t <= 1 else "none").to_numpy())
    against = _against_peers(rows)
    for method in PEERS:
        like = against[(against.method == method) & against.setting.str.endswith("leaves 1e-6")]
        ratios = like.sort_values("threads").groupby(scene_name(like), sort=False).ratio
        columns[f"ratio, {method}, leaves 1e-6"] = ratios.agg(lambda r: " / ".join(map(ratio_text, r)))
    columns = columns.rename_axis("scene, faces").reset_index()
    far = (rows["quartiles.1"] - rows["quartiles.0"]) / rows.seconds
    about = f"{rows.rounds.min()} to {rows.rounds.max()} rounds. Between the quartiles of a time lie {far.median():.0%}"
    return [*table_of(columns), "", f"{about} of it in the median of all calls, {far.quantile(0.9):.0%} in one of ten."]


def step_faults(folder: Path) -> list[str]:
    """What each method misses in whole steps, over all scenes, settings and threads."""
    rows = raw.read(folder, "steps")
    of = rows[rows.step.notna()].groupby("method", sort=False)
    found = [
        f"{name} {' / '.join(f'{each[fault].sum():.0f}' for fault in ('missed', 'late', 'phantom'))} of {len(each)}"
        for name, each in of
    ]
    return said(f"Missed / late / phantom of all steps, by method: {', '.join(found)}.")


def broad(folder: Path) -> list[str]:
    """Broad phases in sentences: times as parts of LBVH's, or of those with a tree, over all scenes."""
    rows = raw.read(folder, "steps")
    rows = rows.assign(name=scene_name(rows), setting=rows.setting.fillna(LBVH))
    by = rows.pivot(index=["name", "threads"], columns=["method", "setting"], values="seconds")
    lbvh, ours = by[LBVH, LBVH], by[OURS]
    parts = {
        "`find_candidates` takes, of the time of LBVH,": ours["find_candidates"] / lbvh,
        "with a spatial hash": ours["find_candidates, hash"] / lbvh,
        "`mesh_ccd` with a hash takes, of its time with a tree,": ours["mesh_ccd, hash"] / ours["mesh_ccd"],
    }
    words = []
    for what, ratios in parts.items():
        of = {threads: each for threads, each in ratios.groupby(level="threads")}
        words.append(f"{what} {' and '.join(f'{r.min():.2f} to {r.max():.2f} on {n}' for n, r in of.items())}")
    first = rows.drop_duplicates(["scene", "device"])
    text = f"{', '.join(words[:2])} threads. {words[2]}. Of {first.candidates.sum():,} candidates of ours and "
    text += f"{first.peer_candidates.sum():,} of the peer's {first.disagreements.sum():,} are of one alone."
    return said(text)


def hard(folder: Path) -> list[str]:
    """Groups of families of hard cases against methods: time, largest error, and faults in numbers."""
    rows = raw.read(folder, "cases")
    rows = rows[rows.method.isin(SHOWN)]
    group = {family: name for name, families in HARD.items() for family in families}
    by = [rows.assign(group=rows.family.map(group).fillna("the others")), rows.assign(group="all")]
    lines = []
    for name, of in pd.concat(by).groupby("group", sort=False):
        cells = []
        for method in SHOWN:
            each = of[of.method == method]
            faults = " / ".join(f"{each[fault].sum():,.0f}" for fault in ("missed", "late", "phantom"))
            cut = f", {each.limited.sum():,.0f} cut short" if each.limited.sum() else ""
            cells.append(f"{time_text(each.seconds.median())}, {error_text(each['error.max'].max())}, {faults}{cut}")
        judged = of[of.method == OURS]
        lines.append([name, f"{judged.queries.sum():,} / {judged.contacts.sum():,}", *cells])
    lines.sort(key=lambda line: [*HARD, "the others", "all"].index(line[0]))
    return table(["families", "queries / contacts", *SHOWN], lines)


def worlds(folder: Path) -> list[str]:
    """Processor time of a world, for the largest number of them."""
    rows = raw.read(folder, "worlds")
    rows = rows[rows.worlds == rows.worlds.max()]
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
    found = [rows[name].map(lambda t: f"{t:.5g}") for name in ("step", *(f"peer_step.{name}" for name in SMALL_PEERS))]
    columns["step: ours / theirs"] = [" / ".join(each) for each in zip(*found, strict=True)]
    return table_of(pd.DataFrame(columns))


def pairs(folder: Path) -> list[str]:
    rows = raw.read(folder, "pairs")
    of = zip(rows.pair.str.replace("_", "-"), rows["seconds.ours"], rows[f"seconds.{ADDITIVE}"], strict=True)
    texts = [f"{kind} {time_text(ours)} and {time_text(theirs)}" for kind, ours, theirs in of]
    return said(f"A call with a single pair takes, ours and additive CCD: {', '.join(texts)}.")


def exponents(growth: pd.DataFrame) -> dict[str, float]:
    """Powers of the number of faces with which time and memory grow."""
    columns = {name.partition(".")[2] or "peak memory": growth[name] for name in growth if name != "faces"}
    faces = np.log(growth.faces)
    return {name: float(np.polyfit(faces, np.log(v), 1)[0]) for name, v in columns.items() if v.notna().all()}


def growth(folder: Path) -> list[str]:
    rows = raw.read(folder, "growth")
    least, most = rows.iloc[0], rows.iloc[-1]
    texts = [
        f"`{name}` {time_text(least[f'seconds.{name}'])} to {time_text(most[f'seconds.{name}'])}, as faces^{power:.2f}"
        for name, power in exponents(rows).items()
        if name in STEP_CALLS
    ]
    memory = [memory_text(each.peak_bytes_above_input) for each in (least, most)]
    return said(
        f"A cloth over a sphere of {least.faces:,.0f} to {most.faces:,.0f} faces: {'; '.join(texts)}; "
        f"{' to '.join(memory)} MiB beside the input at the peak, as faces^{exponents(rows)['peak memory']:.2f}. Below "
        "a power of one, fixed costs count at the small end."
    )


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
        f"the largest error {errors[1][0]} and {errors[1][1]}; {totals[0][2]} and {totals[1][2]} answers are phantoms, "
        f"those of ours of pairs that come as near as {error_text(ours.phantom_gap.max())} of their size."
    )
    single = raw.read(folder, "pairs")
    if len(single):
        of = [_between(single[f"seconds.{name}"]) for name in ("ours", ADDITIVE)]
        text += f" A single pair in a call of its own costs ours {of[0]}, and the peer {of[1]}."
    whole = raw.read(folder, "steps")
    if len(whole):
        against = _against_peers(whole)
        against = against[against.setting.str.endswith("leaves 1e-6") & (against.threads == 1)]
        of = {name: against[against.method == name].ratio for name in PEERS}
        ratios = [f"{ratio_text(of[name].min())} to {ratio_text(of[name].max())} times with {name}" for name in PEERS]
        text += (
            f" The free step of {whole.scene.nunique()} scenes, on one thread, takes its LBVH {' and '.join(ratios)} "
            "what ours takes, where they leave a millionth of each start gap."
        )
    return said(text)


def _between(seconds: pd.Series) -> str:
    low, high = time_text(seconds.min()), time_text(seconds.max())
    return low if low == high else f"{low} to {high}"


def by_tolerance(folder: Path) -> list[str]:
    """What tolerance and precision change of ours, in sentences."""
    rows = raw.read(folder, "sweep")
    rows = rows[rows.method.isin(["ours float64", "ours float32"]) & (rows.tolerance <= CHOICES[0])]
    rows = rows.assign(name=set_name(rows), is_hard=rows["set"] == "hard cases")
    keys = ["name", "tolerance"]
    double, single = (rows[rows.method == f"ours {p}"].set_index(keys) for p in ("float64", "float32"))
    plain, hard = double[~double.is_hard], double[double.is_hard]
    by_set = plain.groupby("name")
    moves = by_set[["error.p99", "phantom"]].nunique().max(axis=1)
    spread = (by_set.seconds.max() / by_set.seconds.min()).max()
    errors = [hard.xs(t, level="tolerance")["error.p99"].max() for t in (CHOICES[0], CHOICES[-1])]
    slower = (hard.xs(CHOICES[-1], level=1).seconds / hard.xs(DEFAULT_TOLERANCE, level=1).seconds).max()
    ratios = (single.seconds / double.seconds).xs(DEFAULT_TOLERANCE, level="tolerance")
    of = [each[~each.is_hard].xs(DEFAULT_TOLERANCE, level="tolerance")["error.p99"] for each in (double, single)]
    low, high = ([error_text(value) for value in (each.min(), each.max())] for each in of)
    text = (
        f"From {CHOICES[0]:.0e} to {CHOICES[-1]:.0e} float64 has the same errors and phantoms on {(moves == 1).sum()} "
        f"of {len(moves)} sets without the hard cases, and the time of a query changes by at most {spread:.2f} times. "
        f"On the hard cases the error that 99 % stay below goes from {errors[0]:.0e} to {errors[1]:.0e}, for up to "
        f"{slower:.1f} times the time of the default. At the default, float32 takes {ratios.min():.2f} to "
        f"{ratios.max():.2f} of the time of float64, and 99 % of the errors of a set are below {' to '.join(high)}, "
        f"where those of float64 are below {' to '.join(low)}."
    )
    return said(text)


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
    rows = rows[rows.scene.notna() & (rows.broad_phase == "tree")].assign(is_cpu=lambda r: r.device == "cpu")
    stages = code[code.kernel == "solve_pairs"].set_index("hash").module.str.split().str[2]

    def shares(kernels: dict[str, float]) -> str:
        parts = [(name.rpartition("_")[::2], seconds / sum(kernels.values())) for name, seconds in kernels.items()]
        named = [(f"`{short.split('__')[-1]}` {stages.get(key, '')}".strip(), part) for (short, key), part in parts]
        return ", ".join(f"{name} {100 * part:.0f} %" for name, part in named if part >= 0.08)

    on_cpu = rows[rows.is_cpu].set_index("scene")[["launch", "mesh_ccd"]].add_prefix("cpu ")
    rows = rows[~rows.is_cpu].join(on_cpu, on="scene")
    columns = {"scene": rows.scene, "pairs": counted(rows.pairs)}
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
        index=["ends", "precision"], columns=["kind", "count"], values="rate", aggfunc="first", sort=False
    )
    table.columns = [", ".join(name) for name in table.columns]
    return table_of(table.reset_index().rename(columns={"ends": "queries that"}))


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
    table = table[table.max(axis=1) * 132 * 2048 > MOST_STACKS]
    most = counted(table.max(axis=1) * 132 * 2048 / 1e6) + " MB"
    table = (
        table[sorted(table, key=len)]
        .map(lambda stack: "–" if pd.isna(stack) else f"{stack:,.0f}")
        .assign(reserved=most)
    )
    return table_of(table.rename(columns={"": "maximum"}).reset_index())


def measured(folder: Path) -> list[str]:
    """Where, when and of which commit each part was measured."""
    runs = raw.read(folder, raw.RUNS)
    runs = runs.assign(about=[raw.described(folder, part).rpartition(", ")[0] for part in runs.part])
    runs["code"] = [why_refused(code) or f"of {code}" for code in runs.code.fillna("")]
    runs["code"] += runs.quick.map({True: ", in small (--quick)", False: ""}).fillna("")
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
    "measured": (measured, raw.RUNS),
    "methods": (methods, raw.RUNS),
    **{each.__name__: (each, "sweep") for each in (frontier, peers, ahead)},
    "hard": (hard, "cases"),
    **{each.__name__: (each, "steps") for each in (step_faults, broad)},
}
for each in (batches, start, steps, worlds, small, pairs, growth, rigid, separation):
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
    parser.add_argument("--any-commit", action="store_true", help="for a try: take figures of any code")
    parser.add_argument("--check", action="store_true", help="write nothing, and name pages with other tables")
    options = parser.parse_args()
    for name in options.names:
        make, part = TABLES[name]
        print("\n".join(make(options.results)) if len(raw.read(options.results, part)) else f"{part} was not measured")
    if options.names:
        return
    if not has_history():
        print("no history here: nothing tells whether figures are of commits in it")
    elif wrong := [] if options.any_commit else raw.refused(options.results):
        sys.exit("\n".join(wrong))
    pages = [options.docs / "README.md", *sorted((options.docs / "docs").rglob("*.md"))]
    texts = {page: page.read_text(encoding="utf-8") for page in pages}
    new = {page: with_tables(text, options.results) for page, text in texts.items()}
    other = [page for page in pages if new[page] != texts[page]]
    if options.check:
        sys.exit("\n".join(f"{page} has other tables than its figures" for page in other) or None)
    draw_all(options.results, options.docs / "docs" / "figures")
    for page in other:
        page.write_text(new[page], encoding="utf-8")
        print(f"wrote {page}")


if __name__ == "__main__":
    main()
