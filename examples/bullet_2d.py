"""The bullet of the literature in the plane, and the work of each method on it.

A point flies from (0.5, 3.5) to (9.5, 3.5) within one step, past a static wall: the segment at x = 5 from y = 1 to
y = 6. The first contact is at t = 0.5, in the middle of the wall. Plain inclusion bisection finds it by halving boxes
of time and wall; the literature reports 53 of them at δ = 1e-4. The default method clips the time from below instead.

    python examples/bullet_2d.py

takes some seconds, the loading of the kernels included. With `--output bullet` and `pip install -e '.[viz]'` it draws
bullet/bullet_2d.png: the toi that each method reports, and its work, at ever smaller tolerances.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import ccd_warp as ccd

# p, a, b: shape [1, 3, 2]
POINTS_T0 = np.array([[[0.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])
POINTS_T1 = np.array([[[9.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])
METHODS = {"bisection": "boxes", "clipping": "steps"}


def solve(method: str, tolerance: float) -> ccd.PairResult:
    """The first contact of the point with the wall, by one of the methods."""
    return ccd.point_segment_ccd(POINTS_T0, POINTS_T1, method=method, tolerance=tolerance, length_scale=1.0)


def draw(path: Path) -> None:
    """Draw the step, and beside it the work of each method over the tolerance."""
    import matplotlib.pyplot as plt

    figure, (scene, work) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    (p0, a, b), (p1, _, _) = POINTS_T0[0], POINTS_T1[0]
    toi = solve("clipping", 1e-4).toi[0]
    scene.plot(*np.transpose([a, b]), color="black", linewidth=4)
    scene.plot(*np.transpose([p0, p1]), color="tab:blue", linestyle=":")
    for t, label, offset in ((0.0, "t = 0", (8, 10)), (1.0, "t = 1", (-30, 10)), (toi, f"toi = {toi:.4f}", (10, -18))):
        place = p0 + t * (p1 - p0)
        scene.plot(*place, "o", color="tab:red" if t == toi else "tab:blue", markersize=9)
        scene.annotate(label, place, xytext=offset, textcoords="offset points")
    scene.set(xlim=(0, 10), ylim=(0, 7), aspect="equal", title="a point and a wall in one step")
    tolerances = 10.0 ** np.arange(-1.0, -9.0, -1.0)
    for method, unit in METHODS.items():
        work.plot(tolerances, [solve(method, t).iterations[0] for t in tolerances], "o-", label=f"{method}: {unit}")
    work.set(xscale="log", yscale="log", xlabel="tolerance δ", title="work until the toi is known to δ")
    work.invert_xaxis()
    work.legend(frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Solve by each method, print, and draw."""
    parser = argparse.ArgumentParser(description="A bullet and a wall in the plane, by two methods; some seconds.")
    parser.add_argument("--output", type=Path, help="folder for bullet_2d.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("matplotlib") is None:
        parser.error("--output needs matplotlib; install it with: pip install 'ccd-warp[viz]'")
    for method, unit in METHODS.items():
        result = solve(method, 1e-4)
        print(
            f"{method:10} toi = {result.toi[0]:.6f} at {result.parameters[0, 0]:.4f} of the wall's length,",
            f"gap <= {result.gap[0]:.1e}, {result.iterations[0]} {unit}",
        )
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "bullet_2d.png")


if __name__ == "__main__":
    main()
