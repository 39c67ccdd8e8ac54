"""A small scene through every kind of call; ``python -m …gpu_check.small_scene DEVICE`` for compute-sanitizer."""

import sys

import warp as wp
from ccd_warp.benchmarks.gpu_check import broad_phases, cases, precompile, steps
from laws import calls


def run_small_scene(device: str) -> None:
    """Run launches, line searches and the calls of the host on a sheet over a ball, and the pair functions."""
    names = broad_phases.choices()
    for k, precision in enumerate(cases.PRECISIONS):
        case = calls.StepCase(lambda: steps.sheet_over_ball(6), {broad_phases.OPTION: names[k % len(names)]})
        for call in (calls.launches, calls.launched_line_searches, calls.steps, calls.searches):
            call(case, precision, device)
        for kind in cases.KINDS:
            calls.pairs(kind, *cases.pair_points(kind, 60, 3), precision, {}, device)
    wp.synchronize()


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    precompile.use_named()
    run_small_scene(sys.argv[1])
    print("done")
