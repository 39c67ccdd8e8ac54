"""Pictures of the raw figures, readable in greyscale: markers and line styles differ, and colour only helps."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from machine import describe
from methods import REFERENCE
from numbers import DEFAULT_TOLERANCE, is_peer, ratio_text, set_name, time_text
from raw_file import frame
from rigid_sections import draw_turns, of_what
from scene_sections import machine_of, scene_name
from sections import FIRST_CALL
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

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
    others = [m for m in methods if m not in _STYLES]
    color, marker = _OTHER[others.index(method) % len(_OTHER)]
    return {"color": color, "linestyle": "-", "marker": marker}


def draw_all(raw: dict, folder: Path, prefix: str = "bench_") -> list[Path]:
    """Draw every picture that the raw figures have data for; the files written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (draw, section, has_data) in _PICTURES.items():
        if not has_data(raw):
            continue
        figure = draw(raw)
        about = describe(machine_of(raw, section))
        figure.text(0.995, 0.002, about, ha="right", va="bottom", fontsize=6, color="0.35")
        path = folder / f"{prefix}{name}.png"
        figure.savefig(path, dpi=110, metadata={"Software": None})
        plt.close(figure)
        written.append(path)
    return written


def _panels(count: int, columns: int, width: float = 4.0, height: float = 3.3) -> tuple[Figure, list[Axes]]:
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(width * columns, height * rows + 0.9), layout="constrained", squeeze=False
    )
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))
    flat = list(axes.flat)
    for unused in flat[count:]:
        unused.set_axis_off()
    return figure, flat[:count]


def _methods(raw: dict) -> list[str]:
    return [m["name"] for m in raw["methods"]]


def _sweep(raw: dict) -> pd.DataFrame:
    """The sweep, with the name of its set in each row."""
    sweep = frame(raw, "sweep")
    sweep["name"] = [set_name(row) for row in sweep.to_dict("records")]
    return sweep


def _legend_below(figure: Figure, axes: list[Axes], columns: int = 5) -> None:
    handles: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=columns, frameon=False, fontsize=8
    )


def draw_speed_error(raw: dict) -> Figure:
    """Time of a query against the 99th percentile of the error, a few sets and methods: the picture of the README."""
    sweep = _sweep(raw)
    names = list(dict.fromkeys(sweep.name))
    chosen = [name for name in _FEW_SETS if name in names] or names[:4]
    figure, axes = _panels(len(chosen), 2, 4.6, 3.1)
    for ax, name in zip(axes, chosen, strict=True):
        _plot_pareto(ax, sweep[sweep.name == name], _FEW_METHODS, raw, marker_size=6)
        ax.set_title(name.replace(" EE", ", edge-edge").replace(" VF", ", vertex-face"), fontsize=11)
        ax.set(xlabel="99 in 100 errors of toi are below", ylabel="time of a query")
        ax.yaxis.set_major_formatter(lambda value, _: time_text(value))
    _legend_below(figure, axes, columns=3)
    return figure


def draw_pareto(raw: dict) -> Figure:
    """Time of a query against the 99th percentile of the error, every set, at the size of a page."""
    by_set = _sweep(raw).groupby("name", sort=False)
    figure, axes = _panels(len(by_set), 2, 5.4, 3.3)
    methods = [m for m in _methods(raw) if m in _PARETO_METHODS or (m not in _STYLES and "threads" not in m)]
    for ax, (name, rows) in zip(axes, by_set, strict=True):
        _plot_pareto(ax, rows, methods, raw, marker_size=5)
        ax.set_title(name, fontsize=11)
        ax.set(xlabel="99 in 100 errors of toi are below", ylabel="time of a query")
        ax.yaxis.set_major_formatter(lambda value, _: time_text(value))
    _legend_below(figure, axes, columns=4)
    return figure


def _plot_pareto(ax: Axes, rows: pd.DataFrame, methods: Iterable[str], raw: dict, marker_size: float) -> None:
    """A line for each method over the tolerances; crosses where a collision is missed or late."""
    rows = rows.assign(error=rows["error.p99"].clip(lower=_LEAST_ERROR)).dropna(subset="error")
    for method in methods:
        points = rows[rows.method == method]
        if points.empty:
            continue
        ax.plot(points.error, points.seconds, label=method, markersize=marker_size, **style(method, _methods(raw)))
        cut = points[points.limited.fillna(0) > _CUT_SHARE * points.queries]
        ax.plot(cut.error, cut.seconds, "o", color="white", markersize=0.45 * marker_size, zorder=4)
        bad = points[(points.missed > 0) | (points.late > 0)]
        ax.plot(bad.error, bad.seconds, "x", color="red", markersize=9, markeredgewidth=1.6, zorder=5)
    ax.plot([], [], "x", color="red", markersize=9, markeredgewidth=1.6, label="misses a collision, or is late")
    ax.plot([], [], "o", color="0.3", markerfacecolor="white", markersize=6, label="white dot: over 5 % cut short")
    ax.set(xscale="log", yscale="log")
    ax.grid(alpha=0.3)


def draw_phantoms(raw: dict) -> Figure:
    """Share of queries without a contact that a method reports as one, against the tolerance."""
    shown = [m for m in _methods(raw) if "threads" not in m]
    sweep = _sweep(raw)
    sweep["free"] = sweep.queries - sweep.contacts
    sweep = sweep[sweep.method.isin(shown) & (sweep.free > 0)]
    by_set = sweep.groupby("name", sort=False)
    figure, axes = _panels(len(by_set), 4)
    for ax, (name, rows) in zip(axes, by_set, strict=True):
        for method in shown:
            points = rows[rows.method == method]
            ax.plot(
                points.tolerance,
                points.phantom / points.free,
                label=method,
                markersize=4.5,
                **style(method, _methods(raw)),
            )
        ax.set_yscale("symlog", linthresh=1e-3)
        ax.set(xscale="log", title=name, xlabel="tolerance", ylabel="phantoms / queries without contact")
        ax.set_ylim(-1e-4, 1.5)
        ax.grid(alpha=0.3)
    _legend_below(figure, axes)
    return figure


def draw_cases(raw: dict) -> Figure:
    """Families by methods: red with the number where a collision is missed or late, else phantoms in grey."""
    methods = [m for m in _methods(raw) if "threads" not in m]
    cases = frame(raw, "cases")
    cases["free"] = cases.queries - cases.contacts
    counted = ["missed", "late", "phantom", "limited", "free"]
    sums = cases.groupby(["family", "method"], sort=False)[counted].sum().astype(int)
    families = list(dict.fromkeys(cases.family))
    cells = {
        (families.index(family), methods.index(method)): dict(zip(counted, sum_of, strict=True))
        for (family, method), *sum_of in sums.itertuples()
        if method in methods
    }
    level = np.full((len(families), len(methods)), 6)  # not applicable
    for at, cell in cells.items():
        share = cell["phantom"] / max(cell["free"], 1)
        level[at] = 5 if cell["missed"] else 4 if cell["late"] else np.digitize(share, [1e-9, 0.05, 0.3])
    figure, ax = plt.subplots(figsize=(1.15 * len(methods) + 3.4, 0.33 * len(families) + 2.2), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))
    colors = ListedColormap(["white", "0.92", "0.84", "0.74", "#f4b6a6", "#b00020", "0.97"])
    ax.imshow(level, cmap=colors, vmin=0, vmax=6, aspect="auto")
    for i, j in np.ndindex(level.shape):
        cell = cells.get((i, j))
        color, weight = ("white", "bold") if level[i, j] == 5 else ("black", "normal")
        ax.text(
            j, i, _cell_text(cell), ha="center", va="center", fontsize=6, color=color, weight=weight, linespacing=0.95
        )
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


def _cell_text(cell: dict[str, int] | None) -> str:
    """The faults of a method's answers for a family; a dot if there are none."""
    if cell is None:
        return "n/a"
    parts = [f"{cell[key]} {word}" for key, word in (("missed", "MISSED"), ("late", "late")) if cell[key]]
    if cell["phantom"] and not parts:
        parts.append(f"{cell['phantom']} phantom")
    if cell["limited"]:
        parts.append(f"{cell['limited']} limited")
    return "\n".join(parts) or "·"


def draw_scaling(raw: dict) -> Figure:
    """Throughput against the batch, seconds of a call with the first call's, speed-up by threads."""
    figure, (rate, call, threads) = _panels(3, 3, 4.6, 3.9)
    threads.set_visible(bool(raw["threads"]))
    methods = _methods(raw)
    data = raw["batches"] or {"rows": []}
    for method, rows in pd.DataFrame(data["rows"]).groupby("method", sort=False) if data["rows"] else ():
        drawn = {"markersize": 4.5, **style(method, methods)}
        rate.loglog(rows["count"], rows["count"] / rows.seconds, label=method, **drawn)
        call.loglog(rows["count"], rows.seconds, **drawn)
    for unit in raw["sweep"]:
        if (unit["set"], unit["kind"], unit["tolerance"]) == ("random_colliding", "vertex-face", DEFAULT_TOLERANCE):
            for row in (row for row in unit["rows"] if is_peer(row)):
                each = row["seconds"] + row["call_overhead"]
                line = {k: v for k, v in style(row["method"], methods).items() if k != "marker"}
                rate.axhline(1 / each, label=f"{row['method']}, one by one", **line)
    starts = [row for row in raw["start"] if row.get("call", FIRST_CALL) == FIRST_CALL]
    for row, line in zip(starts, ("-", "--", "-.", ":") * 4, strict=False):
        where = f"{row['precision']}, {row['device']}"
        call.axhline(row["compile"], color="0.3", linestyle=line, linewidth=1, label=f"first call, compiling: {where}")
        call.axhline(row["load"], color="0.7", linestyle=line, linewidth=1, label=f"first call, cached: {where}")
    rate.set(xlabel="queries of a call", ylabel="queries a second", title="random colliding, vertex-face")
    call.set(xlabel="queries of a call", ylabel="seconds of the call", title="launch and compile overhead")
    if raw["threads"]:
        speedups = frame(raw, "threads").pivot_table(index="threads", columns="what", values="speedup", sort=False)
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


def draw_steps(raw: dict) -> Figure:
    """Time of a step of each scene, ours and the peer's, with their ratio."""
    rows = raw["steps"]
    calls = {
        "find_candidates": "find_candidates and LBVH",
        "collision_free_step": "collision_free_step and LBVH with its step",
        "mesh_ccd": "mesh_ccd and LBVH with its step",
    }
    figure, axes = _panels(3, 3, 4.4, 0.34 * len(rows) + 1.1)
    places = np.arange(len(rows))
    for ax, (call, title) in zip(axes, calls.items(), strict=True):
        ours = np.array([row["seconds"][call] for row in rows])
        peer = np.array([row["seconds"]["peer build"] for row in rows])
        if call != "find_candidates":
            peer += [row["seconds"]["peer step"] for row in rows]
        ax.hlines(places, ours, peer, color="0.7", linewidth=1.2, zorder=1)
        ax.plot(ours, places, "o", color="black", label="ccd_warp", zorder=2)
        ax.plot(peer, places, "s", color="tab:red", label="ipc-toolkit", zorder=2)
        for y, ratio in enumerate(peer / ours):
            ax.annotate(f"{ratio_text(ratio)} ×", (max(ours[y], peer[y]), y), (7, 0), **_BESIDE)
        ax.set(xscale="log", xlabel="time of a step", title=title)
        ax.xaxis.set_major_formatter(lambda value, _: time_text(value))
        ax.set_xlim(right=ax.get_xlim()[1] * 5)  # room for the ratios
        ax.title.set_fontsize(10)
        ax.set_yticks(places, [scene_name(row) for row in rows] if ax is axes[0] else [""] * len(rows), fontsize=9)
        ax.invert_yaxis()
        ax.grid(axis="x", alpha=0.3)
    _legend_below(figure, axes)
    return figure


def draw_growth(raw: dict) -> Figure:
    """Time and peak memory of a step against the faces of the scene."""
    rows, powers = raw["growth"], raw["exponents"]
    figure, (time, memory) = _panels(2, 2, 4.6, 3.8)
    faces = [row["faces"] for row in rows]
    for (name, line), marker in zip(
        {"find_candidates": ":", "collision_free_step": "-", "mesh_ccd": "--"}.items(), "so^", strict=True
    ):
        seconds = [row["seconds"][name] for row in rows]
        time.loglog(faces, seconds, line, marker=marker, color="black", label=f"{name}: faces^{powers[name]:.2f}")
    time.loglog(faces, [rows[-1]["seconds"]["mesh_ccd"] * n / faces[-1] for n in faces], color="0.7", label="linear")
    time.set(xlabel="faces", ylabel="seconds a step", title="cloth over sphere: time")
    if "peak memory" in powers:
        peak = [row["peak_bytes_above_input"] / 2**20 for row in rows]
        memory.loglog(faces, peak, "-", marker="o", color="black", label=f"faces^{powers['peak memory']:.2f}")
        memory.loglog(faces, [peak[-1] * n / faces[-1] for n in faces], color="0.7", label="linear")
    memory.set(xlabel="faces", ylabel="MiB beside the input, at the peak", title="memory")
    for ax in (time, memory):
        ax.legend(frameon=False, fontsize=8)
        ax.grid(alpha=0.3)
    return figure


# How each picture is drawn, of which part, and whether the raw figures have what it needs.
_PICTURES = {
    "speed_error": (draw_speed_error, "sweep", lambda raw: raw["sweep"]),
    "pareto": (draw_pareto, "sweep", lambda raw: raw["sweep"]),
    "phantoms": (draw_phantoms, "sweep", lambda raw: raw["sweep"]),
    "cases": (draw_cases, "cases", lambda raw: raw["cases"]),
    "scaling": (draw_scaling, "batches", lambda raw: raw["batches"]),
    "steps": (draw_steps, "steps", lambda raw: raw["steps"]),
    "growth": (draw_growth, "growth", lambda raw: len(raw["growth"]) > 1),
    "turns": (draw_turns, "rigid", lambda raw: of_what(raw, "turns")),
}
