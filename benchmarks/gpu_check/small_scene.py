"""A small scene through every kind of call; ``python -m …gpu_check.small_scene DEVICE`` for compute-sanitizer."""

import sys
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks.gpu_check import broad_phases, cases, precompile, steps

import ccd_warp as ccd


def run_small_scene(device: str) -> None:
    """Run a launch, a line search and the calls of the host on a sheet over a ball, and the pair functions."""
    step = steps.sheet_over_ball(6)
    names = broad_phases.choices()
    for precision, name in zip(cases.PRECISIONS, (names * 2)[: len(cases.PRECISIONS)], strict=True):
        options: dict[str, Any] = {broad_phases.OPTION: name} if len(names) > 1 else {}
        options["precision"] = precision
        pipeline = ccd.CollisionPipeline(step.mesh, device=device, **options)
        start, end = cases.positions(step, np.float64, device)
        pipeline.launch(start, end).to_host()
        pipeline.launch_line_search(start, end, per="vertex")
        cases.on_host(step, options, device)
        cases.candidates(step, 0.0, {broad_phases.OPTION: name} if len(names) > 1 else {}, device)
        for kind in cases.PAIRS:
            cases.solve_pairs(kind, cases.pair_points(kind, 60, 3), True, {"precision": precision}, device)
    wp.synchronize()


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    precompile.use_named()
    run_small_scene(sys.argv[1])
    print("done")
