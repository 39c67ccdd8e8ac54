"""A small scene through every kind of launch, for compute-sanitizer: ``python -m …gpu_check.small_scene DEVICE``."""

import sys

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check import cases, precompile, steps

import ccd_warp as ccd


def main(device: str) -> None:
    """Run a launch, a line search and the calls of the host on a sheet over a ball, and the pair functions."""
    wp.config.log_level = wp.LOG_WARNING
    precompile.use_named()
    step = steps.sheet_over_ball(6)
    pipeline = ccd.CollisionPipeline(step.mesh, device=device)
    start, end = cases.positions(step, np.float64, device)
    pipeline.launch(start, end).to_host()
    pipeline.launch_line_search(start, end, per="vertex")
    cases.on_host(step, {}, device)
    for kind in cases.PAIRS:
        points = cases.pair_points(kind, 60, 3)
        cases.solve_pairs(kind, points, True, {}, device)
    wp.synchronize()
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
