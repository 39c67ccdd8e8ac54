"""``ccd-warp run``: CCD of one step between two mesh files."""

import argparse
import time
from pathlib import Path

from ccd_warp import CollisionPipeline
from ccd_warp._cli.arguments import given_options
from ccd_warp._cli.half_spaces import half_space_bodies
from ccd_warp._cli.output import check_output_path, write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.poses import check_poses, pose_sequence
from ccd_warp._cli.process import report_on, start_quietly, warn, warnings_on_stderr
from ccd_warp._cli.progress import waiting
from ccd_warp._cli.report import format_report
from ccd_warp._cli.scene import SceneArguments
from ccd_warp._cli.solve import SolvedStep, load_kernels, solve_scene
from ccd_warp._files.frames import read_frames
from ccd_warp._frames import static_bodies
from ccd_warp._input.messages import InputError, printable
from ccd_warp._odd_motion import motion_warnings


def run_step(arguments: argparse.Namespace) -> int:
    """Read, solve, write and report one step.

    Returns:
        1 if there is a contact, or surfaces cross at the start, and ``--fail-on-contact`` is given; else 0.
    """
    start_quietly(arguments.device)
    if arguments.output is not None:
        check_output_path(arguments.output)
    if arguments.picture is not None:
        check_picture(arguments.picture, "--picture")
    begin = time.perf_counter()
    how = {"max_bytes": arguments.max_bytes, "surface": arguments.surface, "split": arguments.split}
    reading = waiting("reading the files", is_quiet=arguments.quiet)
    check_poses(arguments)
    motion, title = None, f"{arguments.start} -> {arguments.end}"
    if arguments.poses is None:
        if arguments.end is None:
            raise InputError(
                "END is missing; expected the mesh at the end of the step, or --poses; see ccd-warp run --help"
            )
        with reading, warnings_on_stderr(is_quiet=arguments.quiet):
            bodies = read_frames(arguments.start, arguments.end, **how).split(arguments.split)
            bodies += static_bodies(arguments.static, **how)
        bodies += half_space_bodies(arguments.half_space)
    else:
        with reading, warnings_on_stderr(is_quiet=arguments.quiet):
            sequence = pose_sequence(arguments.start, arguments)
        if len(sequence) != 2:
            raise InputError(
                f"--poses {arguments.poses}: holds poses at {len(sequence)} times; expected 2, those of both ends of "
                "the step; `sequence` takes more"
            )
        bodies, motion = sequence._first_bodies, sequence.step(0)
        title = f"{arguments.start}: {sequence.labels[0]} -> {sequence.labels[1]}"
    timings = {"read files": time.perf_counter() - begin}

    options = given_options(arguments)
    timings["load kernels"] = load_kernels(
        options,
        is_quiet=arguments.quiet,
        has_radius=bool(arguments.radius),
        has_half_space=bool(arguments.half_space),
        has_poses=motion is not None,
    )
    step = solve_scene(
        bodies,
        options,
        scene=SceneArguments.of(arguments),
        is_quiet=arguments.quiet,
        ignores_start=arguments.ignore_start_contacts,
        motion=motion,
    )
    timings.update(step.timings)
    if not arguments.quiet:
        for line in _oddities(step):
            warn(line)
    written: list[Path] = []
    if arguments.output is not None:
        begin = time.perf_counter()
        with waiting("writing the results", is_quiet=arguments.quiet):
            written = write_result(arguments.output, step)
        timings["write files"] = time.perf_counter() - begin
    if arguments.picture is not None:
        begin = time.perf_counter()
        written.append(draw_step(arguments.picture, step, is_quiet=arguments.quiet))
        timings["draw picture"] = time.perf_counter() - begin
    if not arguments.quiet:
        report = report_on(arguments.output)
        print(format_report(title, step, timings, is_verbose=arguments.verbose), file=report)
        for path in written:
            print(f"wrote {printable(str(path))}", file=report)
    return int(arguments.fail_on_contact and (step.result.hit or step.start.num_crossing > 0))


def _oddities(step: SolvedStep) -> list[str]:
    """What is odd about the frames, a line each."""
    lines = motion_warnings(step.mesh, step.vertices_t0, step.vertices_t1, step.options.t_max)
    if step.start.num_crossing and step.motion is None:
        with CollisionPipeline.borrowed(step.mesh, step.options) as pipeline:
            if not pipeline.find_intersections(step.vertices_t1).num_crossing:
                lines.append("surfaces cross at the start of the step and not at its end; are START and END swapped?")
    return lines
