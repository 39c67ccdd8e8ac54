"""``ccd-warp run``: CCD of one step between two mesh files."""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from ccd_warp._cli.output import RESULT_SUFFIXES, write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import STDOUT, check_output, start_quietly, teller, warnings_on_stderr
from ccd_warp._cli.report import format_report
from ccd_warp._cli.scene import open_sequence
from ccd_warp._cli.solve import Steps
from ccd_warp._scene.input.messages import printable


def run(arguments: argparse.Namespace) -> int:
    """Read, solve, write and report one step.

    Returns:
        1 if there is a contact, or surfaces cross at the start, and ``--fail-on-contact`` is given; else 0.
    """
    start_quietly(arguments.device)
    output: Path | None = arguments.output
    picture, is_quiet = arguments.picture, arguments.quiet
    check_output(output, RESULT_SUFFIXES)
    if picture is not None:
        check_picture(picture, "--picture")
    begin = time.perf_counter()
    with warnings_on_stderr(is_quiet=is_quiet):
        sequence = open_sequence(arguments, [arguments.start, arguments.end])
    seconds = time.perf_counter() - begin
    steps = Steps(arguments, sequence)
    try:
        step = steps.solved(0)
    finally:
        steps.line.clear()
    step = replace(step, timings={"read_files": seconds, **step.timings})
    if output is not None:
        write_result(output, step)
    if picture is not None:
        draw_step(picture, step)
    tell = teller(output, is_quiet=is_quiet)
    tell(format_report(f"{arguments.start} -> {arguments.end}", step))
    for path in (path for path in (output, picture) if path not in (None, STDOUT)):
        tell(f"wrote {printable(str(path))}")
    return int(arguments.fail_on_contact and (step.result.hit or step.start.num_crossing > 0))
