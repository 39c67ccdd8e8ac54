"""``ccd-warp run``: CCD of one step between two mesh files."""

import argparse
import time
from functools import partial
from pathlib import Path

from ccd_warp import CollisionPipeline
from ccd_warp._cli.arguments import given_options
from ccd_warp._cli.output import RESULT_SUFFIXES, write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import STDOUT, check_output, start_quietly, teller, waiting, warn, warnings_on_stderr
from ccd_warp._cli.report import format_report
from ccd_warp._cli.scene import how_to_read, make_mesh, obstacles, pose_sequence
from ccd_warp._cli.solve import SolvedStep, load_kernels, positions_of, solve_scene
from ccd_warp._files.frames import Body, read_frames
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._scene.input.messages import InputError, printable


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
    timings, begin = {}, time.perf_counter()
    with waiting("reading the files", is_quiet=is_quiet), warnings_on_stderr(is_quiet=is_quiet):
        bodies, motion, title = _read(arguments)
    timings["read files"] = time.perf_counter() - begin
    given = given_options(arguments)
    timings["load kernels"] = load_kernels(
        given,
        is_quiet=is_quiet,
        has_radius=bool(arguments.radius),
        has_half_space=bool(arguments.half_space),
        has_poses=motion is not None,
    )
    rigid = [k for k, body in enumerate(bodies) if motion is not None and not body.is_static]
    step = solve_scene(
        bodies,
        given,
        partial(make_mesh, arguments, rigid=rigid),
        is_quiet=is_quiet,
        ignores_start=arguments.ignore_start_contacts,
        motion=motion,
    )
    timings.update(step.timings)
    for line in _oddities(step) if not is_quiet else ():
        warn(line)
    written = [path for path in (output, picture) if path not in (None, STDOUT)]
    if output is not None:
        begin = time.perf_counter()
        with waiting("writing the results", is_quiet=is_quiet):
            write_result(output, step)
        timings["write files"] = time.perf_counter() - begin
    if picture is not None:
        begin = time.perf_counter()
        draw_step(picture, step, is_quiet=is_quiet)
        timings["draw picture"] = time.perf_counter() - begin
    tell = teller(output, is_quiet=is_quiet)
    tell(format_report(title, step, timings, is_verbose=arguments.verbose))
    for path in written:
        tell(f"wrote {printable(str(path))}")
    return int(arguments.fail_on_contact and (step.result.hit or step.start.num_crossing > 0))


def _read(arguments: argparse.Namespace) -> tuple[list[Body], RigidMotion | None, str]:
    """The bodies, how they turn, and the title of the report."""
    sequence = pose_sequence(arguments.start, arguments)
    if sequence is None:
        if arguments.end is None:
            raise InputError("END is missing; expected the mesh at the end of the step, or --poses; see run --help")
        frames = read_frames(arguments.start, arguments.end, **how_to_read(arguments))
        bodies = frames.split(arguments.split) + obstacles(arguments)
        return bodies, None, f"{arguments.start} -> {arguments.end}"
    if len(sequence) != 2:
        raise InputError(
            f"--poses {arguments.poses}: holds poses at {len(sequence)} times; expected 2, those of both ends of the "
            "step; `sequence` takes more"
        )
    title = f"{arguments.start}: {sequence.labels[0]} -> {sequence.labels[1]}"
    return sequence._first_bodies, sequence.step(0), title


def _oddities(step: SolvedStep) -> list[str]:
    """What is odd about the frames, a line each."""
    lines = step.warnings
    if step.start.num_crossing and step.motion is None:
        with CollisionPipeline.borrowed(step.mesh, step.options) as pipeline:
            if not pipeline.find_intersections(positions_of(step.bodies)[1]).num_crossing:
                lines.append("surfaces cross at the start of the step and not at its end; are START and END swapped?")
    return lines
