"""How often a pair that parts or slides from within its distance gets its whole step, for several margins.

``python -m ccd_warp.benchmarks.hold_margin`` prints the shares in percent. Pairs of triangles lie one above the other,
turned at random, at shares of their distance from 0.1 to 1; the upper one moves along the lower one, and of half the
pairs away from it, too. A margin is a constant of the kernels (`kernels.hold`), so each is measured in a process of its
own, where the kernels are compiled anew.
"""

import argparse
import subprocess
import sys

import numpy as np

MARGINS = (32, 64, 128, 256, 1024)  # in units of the roundoff 2^-53 and of the size of a pair
NORMS = {"Euclidean": "minimum_distance", "maximum": "minimum_separation"}
_DISTANCE = 1e-3
_SHARES = (1.0, 1.0 - 1e-12, 0.9, 0.1)


def _with_margin(margin: float) -> None:
    """Give the kernels another margin, before any of them is compiled."""
    import warp as wp
    from ccd_warp.kernels.pair import hold

    wp.config.quiet = True
    hold.MARGIN.update(dict.fromkeys(hold.MARGIN, margin * 2.0**-53))


def shares_of(option: str, count: int) -> tuple[int, float, float]:
    """The number of pairs that start within their distance, and the shares of whole steps of those part and slide."""
    import ccd_warp as ccd

    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    lower, upper = rng.normal(size=(2, count, 3, 3)) * [1.0, 1.0, 0.0]
    upper[:, :, 2] += _DISTANCE * rng.choice(_SHARES, size=(count, 1))
    start = np.concatenate([lower, upper], axis=1) @ turn
    parts = rng.random(count) < 0.5
    motion = rng.normal(size=(count, 1, 2)) @ turn[:, :2]
    motion += np.where(parts, np.abs(rng.normal(size=count)), 0.0)[:, None, None] * turn[:, 2:]
    end = start.copy()
    end[:, 3:] += motion
    face = np.array([[0, 1, 2]])
    mesh = ccd.CollisionMesh.from_arrays([(start[0, :3], face), (start[0, 3:], face)]).replicate(count)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", length_scale=1.0, **{option: _DISTANCE})
    reached = pipeline.line_search(start, end, per="world").vertices.reshape(end.shape)
    is_near = pipeline.mesh_ccd(start, start).world_toi == 0.0
    is_whole = (reached == end).all(axis=(1, 2))
    return int(is_near.sum()), is_whole[is_near & parts].mean(), is_whole[is_near & ~parts].mean()


def main() -> None:
    """Print the shares for every margin, each from a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=50_000, help="pairs of each norm; some half start close")
    parser.add_argument("--margin", type=float, help="only this one, in this process")
    args = parser.parse_args()
    if args.margin is None:
        print(f"{'margin':>6}  {'norm':>9}  {'pairs':>6}  {'part':>7}  {'slide':>7}", flush=True)
        for margin in MARGINS:
            call = [sys.executable, "-m", "ccd_warp.benchmarks.hold_margin"]
            subprocess.run([*call, "--pairs", str(args.pairs), "--margin", str(margin)], check=True)
        return
    _with_margin(args.margin)
    for name, option in NORMS.items():
        count, part, slide = shares_of(option, args.pairs)
        print(f"{args.margin:6g}  {name:>9}  {count:6d}  {100 * part:7.3f}  {100 * slide:7.3f}", flush=True)


if __name__ == "__main__":
    main()
