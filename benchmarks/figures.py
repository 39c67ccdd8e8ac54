"""Pictures of the raw figures, readable in greyscale: markers and line styles differ, and colour only helps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib
import raw

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from methods import DEFAULT_TOLERANCE, PEERS, REFERENCE
from texts import ratio_text, scene_name, set_name, time_text

# Errors of zero are drawn at the left edge.
_LEAST_ERROR = 1e-18
# Share of answers cut short by a limit from which on a point is marked.
_CUT_SHARE = 0.05
# Line, marker and colour of the methods that a picture of many lines shows.
_STYLES: dict[str, dict[str, Any]] = {
    "ours float64": {"color": "black", "linestyle": "-", "marker": "o", "linewidth": 2.2},
    "ours float32": {"color": "black", "linestyle": "--", "marker": "o", "markerfacecolor": "white"},
    "plain bisection": {"color": "tab:blue", "linestyle": "-.", "marker": "D"},
    REFERENCE: {"color": "tab:red", "linestyle": "-", "marker": "s"},
    "additive CCD": {"color": "tab:orange", "linestyle": "--", "marker": "^"},
    "cubic, closed form": {"color": "0.45", "linestyle": ":", "marker": "v"},
    "cubic, companion": {"color": "0.45", "linestyle": ":", "marker": "<"},
    "cubic, newton": {"color": "0.45", "linestyle": ":", "marker": ">"},
    "both ends": {"color": "0.65", "linestyle": ":", "marker": "x"},
}
_OTHER = [("tab:green", "P"), ("tab:purple", "X"), ("tab:brown", "*"), ("tab:olive", "h"), ("tab:cyan", "p")]
# What the picture of the README shows; edge-edge queries are those on which the peers are fastest.
_FEW_METHODS = ("ours float64", REFERENCE, "additive CCD", "cubic, closed form")
_FEW_SETS = ("handcrafted EE", "simulation EE", "cloth like EE", "hard cases EE")
# What the picture of all sets shows: one of the three ways to solve the cubic, which differ little, and one thread.
_PARETO_METHODS = (*_FEW_METHODS, "ours float32", "plain bisection")
_BESIDE: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 8}


def style(method: str, methods: list[str]) -> dict[str, Any]:
    """The style of a method, the same in every picture."""
    if method in _STYLES:
        return _STYLES[method]
    color, marker = _OTHER[[m for m in methods if m not in _STYLES].index(method) % len(_OTHER)]
    return {"color": color, "linestyle": "-", "marker": marker}


def draw_all(folder: Path, to: Path) -> list[Path]:
    """Draw every picture whose part was measured; the files written."""
    to.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (draw, part) in _PICTURES.items():
        rows = raw.read(folder, part)
        if not len(rows):
            continue
        figure = draw(rows, folder)
        about = raw.described(folder, part) if name.startswith("bench") else ""
        figure.text(0.995, 0.002, about, ha="right", va="bottom", fontsize=6, color="0.35")
        written.append(to / f"{name}.png")
        figure.savefig(written[-1], dpi=110, metadata={"Software": None})
        plt.close(figure)
    return written


def _panels(count: int, columns: int, width: float = 4.0, height: float = 3.3) -> tuple[Figure, list[Axes]]:
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(width * columns, height * rows + 0.9), layout="constrained", squeeze=False
    )
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))
    for unused in axes.flat[count:]:
        unused.set_axis_off()
    return figure, list(axes.flat[:count])


def _legend_below(figure: Figure, axes: list[Axes], columns: int = 5) -> None:
    handles: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    options = {"ncols": columns, "frameon": False, "fontsize": 8}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", **options)


def _speed_error(sweep: pd.DataFrame, _: Path) -> Figure:
    """Time of a query against the 99th percentile of the error, a few sets and methods: the picture of the README."""
    names = set_name(sweep)
    chosen = [name for name in _FEW_SETS if name in set(names)] or list(names.unique()[:4])
    figure, axes = _panels(len(chosen), 2, 4.6, 3.1)
    for ax, name in zip(axes, chosen, strict=True):
        _plot_pareto(ax, sweep[names == name], _FEW_METHODS, list(sweep.method.unique()), marker_size=6)
        ax.set_title(name.replace(" EE", ", edge-edge").replace(" VF", ", vertex-face"), fontsize=11)
    _legend_below(figure, axes, columns=3)
    return figure


def _pareto(sweep: pd.DataFrame, _: Path) -> Figure:
    """Time of a query against the 99th percentile of the error, every set, at the size of a page."""
    by_set = sweep.groupby(set_name(sweep), sort=False)
    figure, axes = _panels(len(by_set), 2, 5.4, 3.3)
    every = list(sweep.method.unique())
    methods = [m for m in every if m in _PARETO_METHODS or (m not in _STYLES and "threads" not in m)]
    for ax, (name, rows) in zip(axes, by_set, strict=True):
        _plot_pareto(ax, rows, methods, every, marker_size=5)
        ax.set_title(name, fontsize=11)
    _legend_below(figure, axes, columns=4)
    return figure


def _plot_pareto(ax: Axes, rows: pd.DataFrame, methods: Iterable[str], every: list[str], marker_size: float) -> None:
    """A line for each method over the tolerances; crosses where a collision is missed or late."""
    rows = rows.assign(error=rows["error.p99"].clip(lower=_LEAST_ERROR)).dropna(subset="error")
    for method in methods:
        points = rows[rows.method == method]
        if points.empty:
            continue
        ax.plot(points.error, points.seconds, label=method, markersize=marker_size, **style(method, every))
        cut = points[points.limited.fillna(0) > _CUT_SHARE * points.queries]
        ax.plot(cut.error, cut.seconds, "o", color="white", markersize=0.45 * marker_size, zorder=4)
        bad = points[(points.missed > 0) | (points.late > 0)]
        ax.plot(bad.error, bad.seconds, "x", color="red", markersize=9, markeredgewidth=1.6, zorder=5)
    ax.plot([], [], "x", color="red", markersize=9, markeredgewidth=1.6, label="misses a collision, or is late")
    ax.plot([], [], "o", color="0.3", markerfacecolor="white", markersize=6, label="white dot: over 5 % cut short")
    ax.set(xscale="log", yscale="log", xlabel="99 in 100 errors of toi are below", ylabel="time of a query")
    ax.yaxis.set_major_formatter(lambda value, _: time_text(value))
    ax.grid(alpha=0.3)


def _phantoms(sweep: pd.DataFrame, _: Path) -> Figure:
    """Share of queries without a contact that a method reports as one, against the tolerance."""
    every = list(sweep.method.unique())
    sweep = sweep.assign(name=set_name(sweep), free=sweep.queries - sweep.contacts)
    sweep = sweep[~sweep.method.str.contains("threads") & (sweep.free > 0)]
    by_set = sweep.groupby("name", sort=False)
    figure, axes = _panels(len(by_set), 4)
    for ax, (name, rows) in zip(axes, by_set, strict=True):
        for method, points in rows.groupby("method", sort=False):
            share = points.phantom / points.free
            ax.plot(points.tolerance, share, label=method, markersize=4.5, **style(method, every))
        ax.set_yscale("symlog", linthresh=1e-3)
        ax.set(xscale="log", title=name, xlabel="tolerance", ylabel="phantoms / queries without contact")
        ax.set_ylim(-1e-4, 1.5)
        ax.grid(alpha=0.3)
    _legend_below(figure, axes)
    return figure


def _cases(cases: pd.DataFrame, _: Path) -> Figure:
    """Families by methods: red with the number where a collision is missed or late, else phantoms in grey."""
    cases = cases[~cases.method.str.contains("threads")].assign(free=cases.queries - cases.contacts)
    families, methods = list(cases.family.unique()), list(cases.method.unique())
    counted = ["missed", "late", "phantom", "limited", "free"]
    sums = cases.groupby(["family", "method"], sort=False)[counted].sum().astype(int)
    level = np.full((len(families), len(methods)), 6)  # not applicable
    texts = np.full(level.shape, "n/a", dtype=object)
    for (family, method), cell in zip(sums.index, sums.to_dict("records"), strict=True):
        at = families.index(family), methods.index(method)
        share = cell["phantom"] / max(cell["free"], 1)
        level[at] = 5 if cell["missed"] else 4 if cell["late"] else np.digitize(share, [1e-9, 0.05, 0.3])
        parts = [f"{cell[key]} {word}" for key, word in (("missed", "MISSED"), ("late", "late")) if cell[key]]
        parts += [f"{cell['phantom']} phantom"] if cell["phantom"] and not parts else []
        parts += [f"{cell['limited']} limited"] if cell["limited"] else []
        texts[at] = "\n".join(parts) or "·"
    figure, ax = plt.subplots(figsize=(1.15 * len(methods) + 3.4, 0.33 * len(families) + 2.2), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))
    colors = ListedColormap(["white", "0.92", "0.84", "0.74", "#f4b6a6", "#b00020", "0.97"])
    ax.imshow(level, cmap=colors, vmin=0, vmax=6, aspect="auto")
    for i, j in np.ndindex(level.shape):
        options = {"color": "white", "weight": "bold"} if level[i, j] == 5 else {}
        ax.text(j, i, texts[i, j], ha="center", va="center", fontsize=6, linespacing=0.95, **options)
    ax.set_xticks(range(len(methods)), methods, rotation=30, ha="left", fontsize=8)
    ax.xaxis.tick_top()
    ax.set_yticks(range(len(families)), [name.replace("_", " ") for name in families], fontsize=8)
    ax.set_xticks(np.arange(-0.5, len(methods)), minor=True)
    ax.set_yticks(np.arange(-0.5, len(families)), minor=True)
    ax.grid(which="minor", color="0.5", linewidth=0.4)
    ax.tick_params(which="minor", length=0)
    ax.set_xlabel(
        f"tolerance {DEFAULT_TOLERANCE:g}; dark red: collisions missed; light red: reported late, by any amount; "
        "grey: phantoms, darker for more;\nlimited: answers cut short by a limit, of work (ours, still conservative) "
        "or of time (peers, which then have none)",
        fontsize=8,
    )
    return figure


def _scaling(batches: pd.DataFrame, folder: Path) -> Figure:
    """Throughput against the batch, seconds of a call with the first call's, speed-up by threads."""
    figure, (rate, call, threads) = _panels(3, 3, 4.6, 3.9)
    every = list(raw.read(folder, "sweep").get("method", batches.method).unique())
    for method, rows in batches.groupby("method", sort=False):
        drawn = {"markersize": 4.5, **style(method, every)}
        rate.loglog(rows["count"], rows["count"] / rows.seconds, label=method, **drawn)
        call.loglog(rows["count"], rows.seconds, **drawn)
    sweep = raw.read(folder, "sweep")
    if len(sweep):
        at = (sweep["set"] == "random_colliding") & (sweep.kind == "vertex-face")
        for row in sweep[at & (sweep.tolerance == DEFAULT_TOLERANCE) & sweep.method.isin(PEERS)].itertuples():
            line = {k: v for k, v in style(row.method, every).items() if k != "marker"}
            rate.axhline(1 / (row.seconds + row.call_overhead), label=f"{row.method}, one by one", **line)
    start = raw.read(folder, "start")
    if len(start):
        first = start[start.call == start.call.iloc[0]] if "call" in start else start
        for row, line in zip(first.itertuples(), ("-", "--", "-.", ":") * 4, strict=False):
            for color, seconds, how in (("0.3", row.compile, "compiling"), ("0.7", row.load, "cached")):
                label = f"first call, {how}: {row.precision}, {row.device}"
                call.axhline(seconds, color=color, linestyle=line, linewidth=1, label=label)
    rate.set(xlabel="queries of a call", ylabel="queries a second", title="random colliding, vertex-face")
    call.set(xlabel="queries of a call", ylabel="seconds of the call", title="launch and compile overhead")
    of_threads = raw.read(folder, "threads")
    threads.set_visible(bool(len(of_threads)))
    if len(of_threads):
        speedups = of_threads.pivot_table(index="threads", columns="what", values="speedup", sort=False)
        for k, (what, of) in enumerate(speedups.items()):
            drawn = {"color": "black", "linestyle": ("-", "--", "-.", ":", "-")[k % 5], "marker": "osD^v"[k % 5]}
            threads.plot(of.index, of, label=what, **drawn)
        counts = sorted(speedups.index)
        threads.plot(counts, counts, color="0.7", label="ideal")
        threads.set_xticks(counts)
    threads.set(xlabel="threads", ylabel="speed-up", title="threads")
    for ax in (rate, call, threads):
        ax.grid(alpha=0.3)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(frameon=False, fontsize=7)
    return figure


def _steps(rows: pd.DataFrame, _: Path) -> Figure:
    """Time of a step of each scene, ours and the peer's, with their ratio."""
    calls = {
        "find_candidates": "find_candidates and LBVH",
        "collision_free_step": "collision_free_step and LBVH with its step",
        "mesh_ccd": "mesh_ccd and LBVH with its step",
    }
    figure, axes = _panels(3, 3, 4.4, 0.34 * len(rows) + 1.1)
    places = np.arange(len(rows))
    for ax, (call, title) in zip(axes, calls.items(), strict=True):
        ours = rows[f"seconds.{call}"].to_numpy()
        peer = rows["seconds.peer build"].to_numpy()
        if call != "find_candidates":
            peer = peer + rows["seconds.peer step"].to_numpy()
        ax.hlines(places, ours, peer, color="0.7", linewidth=1.2, zorder=1)
        ax.plot(ours, places, "o", color="black", label="ccd_warp", zorder=2)
        ax.plot(peer, places, "s", color="tab:red", label="ipc-toolkit", zorder=2)
        for y, ratio in enumerate(peer / ours):
            ax.annotate(f"{ratio_text(ratio)} ×", (max(ours[y], peer[y]), y), (7, 0), **_BESIDE)
        ax.set(xscale="log", xlabel="time of a step", title=title)
        ax.xaxis.set_major_formatter(lambda value, _: time_text(value))
        ax.set_xlim(right=ax.get_xlim()[1] * 5)  # space for the ratios
        ax.title.set_fontsize(10)
        ax.set_yticks(places, list(scene_name(rows)) if ax is axes[0] else [""] * len(rows), fontsize=9)
        ax.invert_yaxis()
        ax.grid(axis="x", alpha=0.3)
    _legend_below(figure, axes)
    return figure


def exponents(growth: pd.DataFrame) -> dict[str, float]:
    """Powers of the number of faces with which time and memory grow."""
    columns = {name.partition(".")[2] or "peak memory": growth[name] for name in growth if name != "faces"}
    faces = np.log(growth.faces)
    return {name: float(np.polyfit(faces, np.log(v), 1)[0]) for name, v in columns.items() if v.notna().all()}


def _growth(rows: pd.DataFrame, _: Path) -> Figure:
    """Time and peak memory of a step against the faces of the scene."""
    powers, faces = exponents(rows), rows.faces
    figure, (time, memory) = _panels(2, 2, 4.6, 3.8)
    for name, line in {"find_candidates": "s:", "collision_free_step": "o-", "mesh_ccd": "^--"}.items():
        time.loglog(faces, rows[f"seconds.{name}"], line, color="black", label=f"{name}: faces^{powers[name]:.2f}")
    last = rows.iloc[-1]
    time.loglog(faces, last["seconds.mesh_ccd"] * faces / last.faces, color="0.7", label="linear")
    time.set(xlabel="faces", ylabel="seconds a step", title="cloth over sphere: time")
    if "peak memory" in powers:
        peak = rows.peak_bytes_above_input / 2**20
        memory.loglog(faces, peak, "-", marker="o", color="black", label=f"faces^{powers['peak memory']:.2f}")
        memory.loglog(faces, peak.iloc[-1] * faces / last.faces, color="0.7", label="linear")
    memory.set(xlabel="faces", ylabel="MiB beside the input, at the peak", title="memory")
    for ax in (time, memory):
        ax.legend(frameon=False, fontsize=8)
        ax.grid(alpha=0.3)
    return figure


# How each picture is drawn, and of which part.
_PICTURES: dict[str, tuple[Callable[[pd.DataFrame, Path], Figure], str]] = {
    "bench_speed_error": (_speed_error, "sweep"),
    "bench_pareto": (_pareto, "sweep"),
    "bench_phantoms": (_phantoms, "sweep"),
    "bench_cases": (_cases, "cases"),
    "bench_scaling": (_scaling, "batches"),
    "bench_steps": (_steps, "steps"),
    "bench_growth": (_growth, "growth"),
}
