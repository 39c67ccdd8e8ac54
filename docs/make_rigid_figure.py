"""Draw the figure of docs/rigid.md: ``python docs/make_rigid_figure.py [FOLDER]``, with ``pip install -e '.[docs]'``.

What moves on arcs is placed by ``RigidMotion.at``; chords join the places of a vertex at both ends of the step.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import ccd_warp as ccd

FIGURES = Path(__file__).parent / "figures"
DARK, MID, LIGHT = "0.0", "0.45", "0.8"
TIMES = np.linspace(0.0, 1.0, 5)
FINE = np.linspace(0.0, 1.0, 101)
BAR = np.array([[-1.0, -0.12, 0], [1.0, -0.12, 0], [1.0, 0.12, 0], [-1.0, 0.12, 0]])
HALF_TURN = ccd.RigidMotion([[0.0, 0, 0, 0, 0, 0, 1]], twist=[[0, 0, 0, 0, 0, np.pi]])
# a quarter turn of a bar whose origin, in its middle, goes from (1.6, 0) to (0, 1.6)
ENDS = [[1.6, 0, 0, 0, 0, 0, 1]], [[0.0, 1.6, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]]


def placed(motion: ccd.RigidMotion, t: float) -> NDArray[np.float64]:
    """The corners of the bar in the plane at a time, for turns about z, shape [4, 2]."""
    x, y, *_, qz, qw = motion.at(t)[0]
    c, s = qw * qw - qz * qz, 2 * qw * qz
    return BAR[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]


def draw_bars(ax: Axes, corners: list[NDArray[np.float64]]) -> None:
    for k, bar in enumerate(corners):
        closed = np.vstack([bar, bar[:1]])
        is_end = k in (0, len(corners) - 1)
        ax.fill(*bar.T, color=LIGHT if is_end else "none", zorder=1)
        ax.plot(*closed.T, color=DARK if is_end else MID, linewidth=1.0 if is_end else 0.7, zorder=2)
    ax.set_aspect("equal")
    ax.tick_params(labelsize=7)


def draw_chords(ax: Axes) -> None:
    start, end = placed(HALF_TURN, 0.0), placed(HALF_TURN, 1.0)
    draw_bars(ax, [(1 - t) * start + t * end for t in TIMES])
    for a, b in zip(start, end, strict=True):
        ax.plot(*np.array([a, b]).T, color=DARK, linestyle="--", linewidth=0.8)
    ax.plot(0, 0, "o", color=DARK, markersize=4)
    ax.set_title("Chords: half a turn shrinks\nthe bar to a point at t = 1/2", fontsize=9)


def draw_arcs(ax: Axes) -> None:
    draw_bars(ax, [placed(HALF_TURN, t) for t in TIMES])
    ways = np.array([placed(HALF_TURN, t) for t in FINE])
    for corner in range(4):
        ax.plot(*ways[:, corner].T, color=DARK, linestyle="--", linewidth=0.8)
    ax.set_title("Arcs: what RigidMotion\nmeans by half a turn", fontsize=9)


def draw_paths(ax: Axes, path: str, title: str) -> None:
    motion = ccd.RigidMotion(*ENDS, path=path)  # type: ignore[arg-type]
    draw_bars(ax, [placed(motion, t) for t in TIMES])
    ax.plot(*np.array([motion.at(t)[0, :2] for t in FINE]).T, color=DARK, linestyle="--", linewidth=0.8)
    for t in TIMES:
        ax.plot(*motion.at(t)[0, :2], "o", color=DARK, markersize=3)
    if path == "screw":
        ax.plot(0, 0, "+", color=DARK, markersize=8)
    ax.set_title(title, fontsize=9)


def main() -> None:
    figure, axes = plt.subplots(1, 4, figsize=(10.0, 3.0), layout="constrained")
    draw_chords(axes[0])
    draw_arcs(axes[1])
    draw_paths(axes[2], "linear", 'path="linear": the pivot,\nhere the origin, moves straight')
    draw_paths(axes[3], "screw", 'path="screw": all turns\nabout one axis (+)')
    for ax in axes[:2]:
        ax.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15))
    for ax in axes[2:]:
        ax.set(xlim=(-0.4, 2.8), ylim=(-0.4, 2.8))
    path = Path(sys.argv[1] if len(sys.argv) > 1 else FIGURES) / "arcs.png"
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)
    print(f"{path.name}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
