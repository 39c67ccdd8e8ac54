"""Draw the figures of docs/method.md: ``python docs/make_figures.py``, with ``pip install -e '.[docs]'``.

Bounds of the toi and counts are those of the library: with ``max_iterations=k`` it reports the lower bound that it has
reached after k steps. It does not give out its boxes, nor the single clips of a step. These come from two illustrations
in NumPy, ``illustrated_boxes`` and ``illustrated_clips``: the same mathematics, without the rounding bounds.
"""

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
SMALLEST_ERROR = 1e-15  # of the illustrated clips, which have no rounding bounds
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


def hull_crossing(b: np.ndarray) -> float:
    """Fraction of the interval at which the hull of Bernstein coefficients first reaches 0; inf if it does not."""
    n = len(b)
    crossings = [
        (i + (j - i) * b[i] / (b[i] - b[j])) / (n - 1) for i in range(n) for j in range(i, n) if b[i] > 0 >= b[j]
    ]
    return 0.0 if b[0] <= 0 else min(crossings, default=np.inf)


def volume_coefficients(case: Case, t: float, x: float) -> list[np.ndarray]:
    """Bernstein coefficients of P·(Q×R) on [t, x], positive at t; from its values at four times."""
    times = np.linspace(t, x, 4)
    values = [np.linalg.det(np.array([w[0], w[1] - w[0], w[2] - w[0]])) for w in map(case.corners, times)]
    a, b, c, d = np.array(values) * np.sign(values[0])
    return [np.array([a, (-5 * a + 18 * b - 9 * c + 2 * d) / 6, (2 * a - 9 * b + 18 * c - 5 * d) / 6, d])]


def facet_coefficients(case: Case, t: float, x: float) -> list[np.ndarray]:
    """Bernstein coefficients on [t, x] of d·W for the three corners W, with d the moving normal of the edge f1-f2."""
    w_t, w_x = case.corners(t), case.corners(x)
    d_t, d_x = (np.cross(w[1] - w[2], [0.0, 0.0, 1.0]) for w in (w_t, w_x))
    sign = np.sign(d_t @ w_t[0])
    return [sign * np.array([d_t @ a, (d_t @ b + d_x @ a) / 2, d_x @ b]) for a, b in zip(w_t, w_x, strict=True)]


def illustrated_clips(case: Case, coefficients: Callable[[Case, float, float], list[np.ndarray]]) -> list[float]:
    """Times up to which one step of the default method clips, one after the other."""
    t, x = 0.0, 1.0
    times = [t]
    for _ in range(16):
        first = min(hull_crossing(b) for b in coefficients(case, t, x))
        if np.isinf(first):
            t, x = x, min(1.0, x + 4 * (x - t))
        else:
            s = t + (x - t) * first * (1 - 1e-15)
            if s <= t:
                break
            t, x = s, min(1.0, s + 2 * (s - t))
        times.append(t)
    return times


def reached_bounds(case: Case, method: str, limits: list[int]) -> np.ndarray:
    """The library's own lower bounds of the toi after a number of boxes or steps."""
    return np.array([case.solved(method=method, max_iterations=k, tolerance=TOLERANCE).toi[0] for k in limits])


def draw_boxes(ax: Axes, case: Case) -> None:
    boxes = illustrated_boxes(case, BOX_TOLERANCE)
    count = int(case.solved(method="bisection", tolerance=BOX_TOLERANCE, max_iterations=MANY).iterations[0])
    if count != len(boxes):
        print(f"{case.name}: the library tests {count} boxes, the illustration {len(boxes)}")
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


def draw_intervals(ax: Axes, case: Case, clips: list[float]) -> None:
    shown = clips[1:7]
    for k, t in enumerate(shown):
        ax.barh(k + 1, t, height=0.7, color=LIGHT, edgecolor=DARK, linewidth=0.8)
    ax.axvline(case.toi(), color=DARK, linewidth=1.0, linestyle="--")
    ax.set(xlim=(0, 1), ylim=(len(shown) + 0.6, 0.4), yticks=range(1, len(shown) + 1), ylabel="clip")
    ax.set_xlabel("t, as a fraction of the step")
    ax.set_title("Default method: certified free after each clip", fontsize=10)


def draw_convergence(ax: Axes, case: Case, clips: list[float]) -> None:
    toi = case.toi()

    def error(t: Any) -> Any:
        return toi - np.asarray(t)

    answer = case.solved(method="bisection", tolerance=TOLERANCE, max_iterations=MANY)
    count = int(answer.iterations[0])
    limits = sorted({int(k) for k in np.geomspace(1, count, 60)})
    ax.step(limits, error(reached_bounds(case, "bisection", limits)), where="post", color=MID, linewidth=1.6)
    ax.text(count, float(error(answer.toi)[0]) * 0.3, f"bisection,\n{count:,} boxes", ha="right", va="top", color=MID)
    steps = int(case.solved(tolerance=TOLERANCE).iterations[0])
    bounds = reached_bounds(case, "clipping", list(range(1, steps + 1)))
    clips = [t for t in clips[1:] if error(t) > SMALLEST_ERROR]
    at = len(clips) + 1 + np.arange(steps)
    ax.plot(range(1, len(clips) + 1), error(clips), "o-", color=DARK, markersize=3.5, linewidth=0.8)
    ax.plot(at, error(bounds), "s", color=DARK, markerfacecolor="white", markersize=7)
    ax.plot([], [], "o", color=DARK, markersize=3.5, label="default: clips of step 1")
    ax.plot([], [], "s", color=DARK, markerfacecolor="white", markersize=7, label=f"bound after steps 1 to {steps}")
    ax.set(xscale="log", yscale="log", ylim=(1e-16, 3), xlim=(0.8, max(2 * count, 1000)))
    ax.set_xlabel("boxes, or clips")
    ax.set_ylabel("exact toi − lower bound")
    ax.set_title(f"How early the bound of toi still is, δ = {TOLERANCE:g}", fontsize=10)
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.legend(loc="lower right", framealpha=1.0)


def draw(case: Case) -> Path:
    coefficients = facet_coefficients if case.name == "in_plane" else volume_coefficients
    clips = illustrated_clips(case, coefficients)
    figure = plt.figure(figsize=(9.0, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.7, 1.0), width_ratios=(1.1, 1.0))
    boxes = figure.add_subplot(grid[0, 0])
    draw_boxes(boxes, case)
    draw_intervals(figure.add_subplot(grid[1, 0], sharex=boxes), case, clips)
    draw_convergence(figure.add_subplot(grid[:, 1]), case, clips)
    figure.suptitle(case.title, fontsize=11, fontweight="bold")
    path = FIGURES / f"{case.name}.png"
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)
    return path


def main() -> None:
    plt.rcParams.update({"font.size": 9, "legend.fontsize": 8, "axes.axisbelow": True})
    FIGURES.mkdir(exist_ok=True)
    for case in CASES:
        path = draw(case)
        print(f"{path.relative_to(FIGURES.parent)}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
