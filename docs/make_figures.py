"""Draw the figures of docs/method.md: ``python docs/make_figures.py [FOLDER]``, with ``pip install -e '.[docs]'``.

Bounds of the toi and counts are those of the library: with ``max_iterations=k`` it reports the lower bound that it has
reached after k boxes, or k rounds of the default method. The boxes of the bisection themselves, which it does not give
out, are those of ``illustrated_boxes``, which is checked to test as many.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle

import ccd_warp as ccd

FIGURES = Path(__file__).parent / "figures"
BOX_TOLERANCE = 1e-2  # of the boxes drawn: smaller ones are not seen
TOLERANCE = 1e-6  # of the convergence
MANY = 10_000_000
ROUNDING = 25 * 2.0**-53  # about the library's, of boxes, relative to the largest corner per axis
DARK, MID, LIGHT = "0.0", "0.45", "0.85"


@dataclass(frozen=True)
class Case:
    """A vertex-face pair; rows are v, f0, f1, f2."""

    name: str
    title: str
    start: np.ndarray
    end: np.ndarray
    touching: Callable[[list[list[Fraction]]], Fraction]  # of the exact points at a time; above 0 before the contact

    def toi(self) -> float:
        """Earliest root of ``touching``, in rational arithmetic."""
        low, high = Fraction(0), Fraction(1)
        for _ in range(70):
            middle = (low + high) / 2
            low, high = (middle, high) if self.touching(self.points_at(middle)) > 0 else (low, middle)
        return float(low)

    def points_at(self, t: Fraction) -> list[list[Fraction]]:
        rows = zip(self.start.tolist(), self.end.tolist(), strict=True)
        return [[(1 - t) * Fraction(x) + t * Fraction(y) for x, y in zip(a, b, strict=True)] for a, b in rows]

    def solved(self, **options: Any) -> ccd.PairResult:
        return ccd.vertex_face_ccd(self.start[None], self.end[None], **options)

    def corners(self, t: float) -> np.ndarray:
        """w00, w01, w10 of the patch, shape [3, 3]."""
        x = (1 - t) * self.start + t * self.end
        return x[0] - x[1:]


def height(x: list[list[Fraction]]) -> Fraction:
    """The vertex's height over the face, times twice the face's area: P·(Q×R)."""
    (px, py, pz), (qx, qy, qz), (rx, ry, rz) = ([a - b for a, b in zip(x[i], x[j], strict=True)] for i, j in _SIDES)
    return px * (qy * rz - qz * ry) + py * (qz * rx - qx * rz) + pz * (qx * ry - qy * rx)


_SIDES = ((0, 1), (1, 2), (1, 3))


def beyond_edge(x: list[list[Fraction]]) -> Fraction:
    """Distance of the vertex from the edge f1-f2 in the plane z = 0, times the edge's length."""
    v, _, a, b = x
    return (b[1] - a[1]) * (v[0] - a[0]) - (b[0] - a[0]) * (v[1] - a[1])


def grazing_points(t: float) -> np.ndarray:
    """A vertex at (t, 1/4, 0) and a face of height (3t - 1)(3x - 1)/4: they touch at t = 1/3 and part again."""
    points = np.array([[t, 0.25, 0.0], [-0.5, -0.5, 0.0], [1.5, -0.5, 0.0], [0.5, 1.5, 0.0]])
    points[1:, 2] = (3 * t - 1) * (3 * points[1:, 0] - 1) / 4
    return points


CASES = [
    Case(
        "simple",
        "Simple: a vertex falls through a face",
        np.array([[0.3, 0.2, 1.0], [0.0, 0.0, -0.25], [1.0, 0.0, 0.0], [0.0, 1.0, 0.25]]),
        np.array([[0.4, 0.3, -1.0], [0.1, 0.0, 0.25], [1.0, 0.1, -0.25], [0.0, 1.0, 0.0]]),
        height,
    ),
    Case(
        "grazing",
        "Grazing: the vertex touches the turning face and parts again",
        grazing_points(0.0),
        grazing_points(1.0),
        lambda x: Fraction(1, 3) - x[0][0],  # the vertex is at x = t
    ),
    Case(
        "in_plane",
        "In-plane: the vertex meets the edge of a turning face in its plane",
        np.array([[1.5, 1.25, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        np.array([[-0.5, -0.25, 0.0], [0.0, 0.0, 0.0], [0.75, 0.5, 0.0], [-0.5, 0.75, 0.0]]),
        beyond_edge,
    ),
]


def illustrated_boxes(case: Case, tolerance: float) -> list[tuple[tuple[float, ...], str]]:
    """Boxes (t0, t1, u0, u1, v0, v1) of plain bisection in the order of their tests; "free", "split" or "accepted"."""
    ends = [case.corners(0.0), case.corners(1.0)]
    both = np.concatenate([case.start, case.end])
    rounding = ROUNDING * np.abs(np.concatenate(ends)).max(axis=0)
    delta = tolerance * (both.max(axis=0) - both.min(axis=0)).max() + rounding

    def point(t: float, u: float, v: float) -> np.ndarray:
        w00, w01, w10 = (1 - t) * ends[0] + t * ends[1]
        return (1 - u) * ((1 - v) * w00 + v * w01) + u * w10

    boxes: list[tuple[tuple[float, ...], str]] = []
    stack: list[tuple[float, ...]] = [(0.0, 1.0, 0.0, 1.0, 0.0, 1.0)]
    best = 2.0
    while stack:
        box = stack.pop()
        if box[0] >= best:
            continue
        hull = np.array([[[point(t, u, v) for v in box[4:]] for u in box[2:4]] for t in box[:2]])
        low, high = hull.min(axis=(0, 1, 2)), hull.max(axis=(0, 1, 2))
        if (low > rounding).any() or (high < -rounding).any():
            boxes.append((box, "free"))
        elif (high - low <= delta).all():
            boxes.append((box, "accepted"))
            best = box[0]
        else:
            boxes.append((box, "split"))
            k = int(np.argmax([np.abs(np.diff(hull, axis=axis) / delta).max() for axis in range(3)]))
            middle = 0.5 * (box[2 * k] + box[2 * k + 1])
            stack.append((*box[: 2 * k], middle, *box[2 * k + 1 :]))  # the later half waits
            stack.append((*box[: 2 * k + 1], middle, *box[2 * k + 2 :]))
    return boxes


def reached_bounds(case: Case, method: str, limits: list[int]) -> np.ndarray:
    """The library's own lower bounds of the toi after a number of boxes or rounds."""
    return np.array([case.solved(method=method, max_iterations=k, tolerance=TOLERANCE).toi[0] for k in limits])


def draw_boxes(ax: Axes, case: Case) -> None:
    boxes = illustrated_boxes(case, BOX_TOLERANCE)
    count = int(case.solved(method="bisection", tolerance=BOX_TOLERANCE, max_iterations=MANY).iterations[0])
    if count != len(boxes):
        raise RuntimeError(f"{case.name}: the library tests {count} boxes, the illustration {len(boxes)}")
    # the widest first, so that none hides another
    free = sorted((b for b, fate in boxes if fate == "free"), key=lambda b: -(b[1] - b[0]) * (b[3] - b[2]))
    rectangles = [Rectangle((b[0], b[2]), b[1] - b[0], b[3] - b[2]) for b in free]
    ax.add_collection(PatchCollection(rectangles, facecolor=LIGHT, edgecolor=MID, linewidth=0.6))
    ax.plot([], [], "s", color=LIGHT, markeredgecolor=MID, markersize=7, label="certified free")
    *_, accepted = (b for b, fate in boxes if fate == "accepted")  # each is earlier than the one before
    ax.plot(accepted[0], 0.5 * (accepted[2] + accepted[3]), "v", color=DARK, markersize=7, label="box reported")
    ax.axvline(case.toi(), color=DARK, linewidth=1.0, linestyle="--", label="exact toi")
    ax.set(xlim=(0, 1), ylim=(0, 1), ylabel="u, from f0 to f2")
    ax.set_title(f"Plain bisection, δ = {BOX_TOLERANCE:g}: {count} boxes", fontsize=10)
    ax.legend(loc="upper right", framealpha=1.0)


def rounds_of(case: Case) -> np.ndarray:
    """Times up to which the library has shown the pair free after each round of the default method."""
    count = int(case.solved(tolerance=TOLERANCE).iterations[0])
    return reached_bounds(case, "clipping", list(range(1, count + 1)))


def draw_intervals(ax: Axes, case: Case, rounds: np.ndarray) -> None:
    for k, t in enumerate(rounds, start=1):
        ax.barh(k, t, height=0.7, color=LIGHT, edgecolor=DARK, linewidth=0.8)
    ax.axvline(case.toi(), color=DARK, linewidth=1.0, linestyle="--")
    ax.set(xlim=(0, 1), ylim=(len(rounds) + 0.6, 0.4), yticks=range(1, len(rounds) + 1), ylabel="round")
    ax.set_xlabel("t, as a fraction of the step")
    ax.set_title("Default method: certified free after each round", fontsize=10)


def draw_convergence(ax: Axes, case: Case, rounds: np.ndarray) -> None:
    toi = case.toi()

    def error(t: Any) -> Any:
        return toi - np.asarray(t)

    answer = case.solved(method="bisection", tolerance=TOLERANCE, max_iterations=MANY)
    count = int(answer.iterations[0])
    limits = sorted({int(k) for k in np.geomspace(1, count, 60)})
    ax.step(limits, error(reached_bounds(case, "bisection", limits)), where="post", color=MID, linewidth=1.6)
    ax.text(count, float(error(answer.toi)[0]) * 0.3, f"bisection,\n{count:,} boxes", ha="right", va="top", color=MID)
    ax.plot(range(1, len(rounds) + 1), error(rounds), "s-", color=DARK, markerfacecolor="white", linewidth=0.8)
    ax.plot([], [], "s-", color=DARK, markerfacecolor="white", linewidth=0.8, label="default method, by rounds")
    ax.plot([], [], color=MID, linewidth=1.6, label="plain bisection, by boxes")
    ax.set(xscale="log", yscale="log", ylim=(1e-16, 3), xlim=(0.8, max(2 * count, 1000)))
    ax.set_xlabel("boxes, or rounds")
    ax.set_ylabel("exact toi − lower bound")
    ax.set_title(f"How early the bound of toi still is, δ = {TOLERANCE:g}", fontsize=10)
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.legend(loc="lower right", framealpha=1.0)


def draw(case: Case, folder: Path) -> Path:
    rounds = rounds_of(case)
    figure = plt.figure(figsize=(9.0, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.7, 1.0), width_ratios=(1.1, 1.0))
    boxes = figure.add_subplot(grid[0, 0])
    draw_boxes(boxes, case)
    draw_intervals(figure.add_subplot(grid[1, 0], sharex=boxes), case, rounds)
    draw_convergence(figure.add_subplot(grid[:, 1]), case, rounds)
    figure.suptitle(case.title, fontsize=11, fontweight="bold")
    path = folder / f"{case.name}.png"
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)
    return path


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FIGURES
    plt.rcParams.update({"font.size": 9, "legend.fontsize": 8, "axes.axisbelow": True})
    for case in CASES:
        path = draw(case, folder)
        print(f"{path.name}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
