"""``ccd-warp sequence``: CCD of every step of a sequence of frames, each saved so that a run can be resumed."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import warp as wp

from ccd_warp._cli.animation import draw_animation
from ccd_warp._cli.arguments import given_options
from ccd_warp._cli.half_spaces import half_space_bodies
from ccd_warp._cli.output import STDOUT, make_folder, plain_options
from ccd_warp._cli.pictures import check_animation, draw_step
from ccd_warp._cli.poses import check_poses, pose_sequence
from ccd_warp._cli.process import (
    INTERRUPTED,
    check_standard_output,
    report_on,
    say,
    start_quietly,
    warn,
    warnings_on_stderr,
)
from ccd_warp._cli.progress import ItemsLine, waiting
from ccd_warp._cli.replacing import replacing
from ccd_warp._cli.scene import SceneArguments, StartContacts
from ccd_warp._cli.sequence_records import COLUMNS, StepRecord, csv_text, draw_plot
from ccd_warp._cli.sequence_report import format_sequence
from ccd_warp._cli.solve import SolvedStep, load_kernels, make_options, moving_vertices, solve
from ccd_warp._contact_place import MovingVertices
from ccd_warp._files.frames import InputError
from ccd_warp._files.journal import Journal, fingerprint
from ccd_warp._files.opened import Stamp, noted_files, stamp
from ccd_warp._files.series import find_series
from ccd_warp._frames import static_bodies
from ccd_warp._input.arguments import check_count
from ccd_warp._input.messages import printable
from ccd_warp._input.options import Options
from ccd_warp._pose_sequence import PoseSequence
from ccd_warp._sequence import FrameSequence
from ccd_warp._version import __version__

JOURNAL, CSV, PLOT = "sequence.journal", "steps.csv", "steps.png"


def run_sequence(arguments: argparse.Namespace) -> int:
    """Solve every step that an earlier run has not solved, and write and report all.

    Returns:
        0; 1 if a step has a contact, or surfaces that cross at its start, and ``--fail-on-contact`` is given; 130 after
        Ctrl-C, with what was computed kept.
    """
    start_quietly(arguments.device)
    if arguments.picture is not None:
        check_animation(arguments.picture, "--picture")
    reading = waiting("reading the first step", is_quiet=arguments.quiet)
    with noted_files() as opened, reading, warnings_on_stderr(is_quiet=arguments.quiet):
        sequence = _open(arguments)
    given = given_options(arguments)
    at_start = _moving(sequence, 0).all_at(0.0)
    options, ignored = make_options(given, sequence.mesh, None if arguments.poses is None else at_start), None
    num_steps = len(sequence) - 1
    folder: Path | None = None if arguments.output == STDOUT else arguments.output
    journal = None
    if folder is None:
        check_standard_output()
    else:
        make_folder(folder, "--output")
        journal = _journal(folder, arguments, sequence, options, opened)
    load_kernels(
        given,
        is_quiet=arguments.quiet,
        has_radius=bool(arguments.radius),
        has_half_space=bool(arguments.half_space),
        has_poses=arguments.poses is not None,
    )
    if arguments.ignore_start_contacts:
        with warnings_on_stderr(is_quiet=arguments.quiet):
            ignored = StartContacts.of(sequence.mesh, at_start, options)
        sequence.mesh = sequence.mesh.excluding(ignored.pairs)

    report = report_on(arguments.output)
    records = {} if journal is None else StepRecord.from_journal(journal.records, num_steps)
    if journal is not None and (foreign := journal.num_foreign + len(journal.records) - len(records)):
        warn(f"{journal.path}: {foreign} lines are no records of a step; what they stood for is computed again")
    records = {k: record for k, record in records.items() if _is_unchanged(record)}
    if records and not arguments.quiet:
        print(f"{len(records)} of {num_steps} steps were computed before", file=report)
    line = ItemsLine(arguments.quiet)

    def solved(k: int) -> SolvedStep:
        bodies = sequence._bodies(k)
        mesh, motion = sequence._mesh_of(bodies), sequence._motion(k)
        return solve(bodies, mesh, options, line, is_quiet=arguments.quiet, ignored=ignored, motion=motion)

    is_complete = True
    written: list[Path] = []
    try:
        todo = [k for k in range(num_steps) if k not in records]
        line.begin("steps", len(todo))
        for k in todo:
            records[k] = record = StepRecord.of(k, sequence.labels[k : k + 2], solved(k), sequence._opened)
            if journal is not None:
                journal.add(str(k), record.plain())
            line.advance()
        if arguments.picture is not None:
            written.append(_draw(arguments.picture, sequence, records, solved, line, is_quiet=arguments.quiet))
    except KeyboardInterrupt:
        is_complete = False
    finally:
        line.clear()
    ordered = [records[k] for k in sorted(records)]
    if folder is not None:
        written = _write(folder, ordered, options.t_max, is_quiet=arguments.quiet) + written
    elif ordered:
        sys.stdout.write(csv_text(ordered))
    if not arguments.quiet:
        _warn_of_motions(ordered)
        if ordered:
            print(format_sequence(sequence, ordered, options, ignored, at_start), file=report)
        for path in written:
            print(f"wrote {printable(str(path))}", file=report)
    if not is_complete:
        kept = "what was computed is kept, and the same command goes on from there"
        lost = "without a folder for --output nothing is kept"
        say(f"interrupted after {len(ordered)} of {num_steps} steps; {lost if journal is None else kept}")
        return INTERRUPTED
    if journal is not None:
        journal.close()
    return int(arguments.fail_on_contact and any(record.hit or record.crossing for record in ordered))


def _moving(sequence: FrameSequence | PoseSequence, k: int) -> MovingVertices:
    """How all vertices move in a step."""
    bodies = sequence._bodies(k)
    return moving_vertices(sequence._mesh_of(bodies), bodies, sequence._motion(k))


def _open(arguments: argparse.Namespace) -> FrameSequence | PoseSequence:
    """The frames of the command line, with the first step read."""
    check_poses(arguments)
    if arguments.poses is not None:
        if len(arguments.frames) != 1:
            raise InputError(f"{len(arguments.frames)} files are given with --poses; expected one mesh file")
        for name in ("displacement", "faces"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name} is given with --poses; expected one of them")
        return pose_sequence(arguments.frames[0], arguments)
    limit = check_count("max_bytes", arguments.max_bytes, 2**63 - 1)
    how: dict[str, Any] = {"max_bytes": limit, "surface": arguments.surface, "split": arguments.split}
    series = find_series(arguments.frames, displacement=arguments.displacement, faces=arguments.faces, **how)
    static = static_bodies(arguments.static, **how) + half_space_bodies(arguments.half_space)
    return FrameSequence(series, static, SceneArguments.of(arguments).mesh, split=arguments.split)


def _journal(
    folder: Path,
    arguments: argparse.Namespace,
    sequence: FrameSequence | PoseSequence,
    options: Options,
    opened: list[Stamp],
) -> Journal:
    """The steps that an interrupted run of the same command has left in the folder."""
    files = {*opened, *(stamp(path) for each in sequence._series for path in each.files)}
    files |= set() if arguments.exclude is None else {stamp(arguments.exclude)}
    settings: dict[str, Any] = {
        "options": plain_options(options),
        **SceneArguments.of(arguments).plain(),
        **{
            name: getattr(arguments, name)
            for name in ("half_space", "displacement", "surface", "split", "ignore_start_contacts", "path")
        },
        "columns": COLUMNS,
        "labels": [each.labels for each in sequence._series],
        "files": sorted(files),
    }
    about = {"version": __version__, "device": wp.get_device(options.device).name}
    try:
        return Journal(folder / JOURNAL, fingerprint(settings, about))
    except OSError as error:
        raise InputError(f"--output {folder}: cannot be written ({error.strerror or error})") from error


def _is_unchanged(record: StepRecord) -> bool:
    """Whether the files from which the frames of a step were read, such as buffers beside them, are as they were."""
    try:
        return all(tuple(each) == stamp(Path(each[0])) for each in record.files)
    except InputError:
        return False


def _draw(
    path: Path,
    sequence: FrameSequence | PoseSequence,
    records: dict[int, StepRecord],
    solved: Callable[[int], SolvedStep],
    line: ItemsLine,
    *,
    is_quiet: bool,
) -> Path:
    """Draw the animation, or the first step that has a contact, or else one at whose start surfaces cross."""
    if path.suffix.lower() != ".png":
        return draw_animation(path, partial(_moving, sequence), records, line)
    ordered = sorted(records.items())
    crossing = next((k for k, record in ordered if record.crossing), 0)
    bad = next((k for k, record in ordered if record.hit), crossing)
    step = solved(bad)
    line.clear()
    return draw_step(path, step, is_quiet=is_quiet)


def _write(folder: Path, records: list[StepRecord], t_max: float, *, is_quiet: bool) -> list[Path]:
    """Write the CSV file and, where matplotlib is installed, the plot of the steps so far."""
    if not records:
        return []
    written = [folder / CSV]
    with replacing(folder / CSV) as beside:
        beside.write_text(csv_text(records), encoding="utf-8")
    try:
        with waiting(f"drawing {PLOT}", is_quiet=is_quiet), replacing(folder / PLOT) as beside:
            draw_plot(beside, records, t_max)
        written.append(folder / PLOT)
    except ImportError:
        if not is_quiet:
            warn(f"{PLOT} is not drawn without matplotlib; install with: pip install 'ccd-warp[viz]'")
    return written


def _warn_of_motions(records: list[StepRecord]) -> None:
    """Say once what is odd about the motions, and in how many steps."""
    odd = [record for record in records if record.warnings]
    if odd:
        more = f" (and {len(odd) - 1} more steps)" if len(odd) > 1 else ""
        for sentence in odd[0].warnings:
            warn(f"step {odd[0].step}: {sentence}{more}")
