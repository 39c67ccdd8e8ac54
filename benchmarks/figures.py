"""Pictures of the raw figures, readable in greyscale: markers and line styles differ, and colour only helps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import raw

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from methods import CUBIC, ENDS, PEERS, REFERENCE, SHOWN
from texts import set_name, time_text

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
    PEERS[1]: {"color": "tab:orange", "linestyle": "--", "marker": "^"},
    CUBIC: {"color": "0.45", "linestyle": ":", "marker": "v"},
    ENDS: {"color": "0.65", "linestyle": ":", "marker": "x"},
}
# What the picture of the README shows; edge-edge queries are those on which the peers are fastest.
_FEW_SETS = ("handcrafted EE", "simulation EE", "cloth like EE", "hard cases EE")


def draw_all(folder: Path, to: Path) -> list[Path]:
    """Draw every picture whose part was measured; the files written."""
    to.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (draw, part) in _PICTURES.items():
        rows = raw.read(folder, part)
        if not len(rows):
            continue
        figure = draw(rows, folder)
        figure.text(0.995, 0.002, raw.described(folder, part), ha="right", va="bottom", fontsize=6, color="0.35")
        written.append(to / f"{name}.png")
        figure.savefig(written[-1], dpi=110, metadata={"Software": None})
        plt.close(figure)
    return written


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """Two in a row."""
    rows = -(-count // 2)
    size = 9.2, 3.1 * rows + 0.9
    figure, axes = plt.subplots(rows, min(count, 2), figsize=size, layout="constrained", squeeze=False)
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))
    for unused in axes.flat[count:]:
        unused.set_axis_off()
    return figure, list(axes.flat[:count])


def _legend_below(figure: Figure, axes: list[Axes]) -> None:
    handles: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    options = {"ncols": 5, "frameon": False, "fontsize": 8}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", **options)


def _speed_error(sweep: pd.DataFrame, _: Path) -> Figure:
    """Time of a query against the 99th percentile of the error, for a few sets: the picture of the README."""
    names = set_name(sweep)
    chosen = [name for name in _FEW_SETS if name in set(names)] or list(names.unique()[:4])
    figure, axes = _panels(len(chosen))
    sweep = sweep.assign(error=sweep["error.p99"])
    for ax, name in zip(axes, chosen, strict=True):
        _plot_frontier(ax, sweep[names == name])
        ax.set(xlabel="99 in 100 errors of toi are below", ylabel="time of a query")
        ax.set_title(name.replace(" EE", ", edge-edge").replace(" VF", ", vertex-face"), fontsize=11)
    _legend_below(figure, axes)
    return figure


def _steps(rows: pd.DataFrame, _: Path) -> Figure:
    """Time of a whole step against the part by which it is short of the exact toi, on one thread."""
    rows = rows[(rows.threads == 1) & rows.step.notna() & ~rows.setting.fillna("").str.startswith("mesh_ccd")]
    rows = rows.assign(error=rows.short.abs(), limited=0.0, queries=1)
    names = list(rows[rows.method == ENDS].scene.unique())  # those that have every method
    figure, axes = _panels(len(names))
    for ax, name in zip(axes, names, strict=True):
        _plot_frontier(ax, rows[rows.scene == name].sort_values("error"))
        ax.set(xlabel="part of the exact toi by which a step is short", ylabel="time of a step")
        ax.set_title(name, fontsize=11)
    _legend_below(figure, axes)
    return figure


def _plot_frontier(ax: Axes, rows: pd.DataFrame) -> None:
    """A line for each method over what it was told; crosses where a collision is missed or late, with how many."""
    rows = rows.assign(error=rows.error.clip(lower=_LEAST_ERROR)).dropna(subset="error")
    for method in SHOWN:
        points = rows[rows.method == method]
        if points.empty:
            continue
        ax.plot(points.error, points.seconds, label=method, markersize=6, **_STYLES[method])
        cut = points[points.limited.fillna(0) > _CUT_SHARE * points.queries]
        ax.plot(cut.error, cut.seconds, "o", color="white", markersize=2.7, zorder=4)
        bad = points[(points.missed > 0) | (points.late > 0)]
        ax.plot(bad.error, bad.seconds, "x", color="red", markersize=9, markeredgewidth=1.6, zorder=5)
    ax.plot([], [], "x", color="red", markersize=9, markeredgewidth=1.6, label="misses a collision, or is late")
    ax.plot([], [], "o", color="0.3", markerfacecolor="white", markersize=6, label="white dot: over 5 % cut short")
    ax.set(xscale="log", yscale="log")
    ax.yaxis.set_major_formatter(lambda value, _: time_text(value))
    ax.grid(alpha=0.3)


# How each picture is drawn, and of which part.
_PICTURES: dict[str, tuple[Callable[[pd.DataFrame, Path], Figure], str]] = {
    "bench_speed_error": (_speed_error, "sweep"),
    "bench_steps": (_steps, "steps"),
}
