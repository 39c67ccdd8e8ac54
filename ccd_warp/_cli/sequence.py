"""``ccd-warp sequence``: CCD of every step of a sequence of frames."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import (
    INTERRUPTED,
    STDOUT,
    make_folder,
    say,
    start_quietly,
    teller,
    warnings_on_stderr,
    write_out,
)
from ccd_warp._cli.report import (
    body_lines,
    crossing_sentence,
    format_title,
    format_toi,
    length_line,
    looked_at,
    scope_lines,
)
from ccd_warp._cli.scene import open_sequence
from ccd_warp._cli.solve import Steps
from ccd_warp._cli.table import COLUMNS, StepRow, csv_text
from ccd_warp._runtime.display import start_sentence
from ccd_warp._scene.input.messages import printable

CSV = "steps.csv"


def run(arguments: argparse.Namespace) -> int:
    """Solve every step, write its row, and report all.

    Returns:
        0; 1 if a step has a contact, or surfaces that cross at its start, and ``--fail-on-contact`` is given; 130 after
        Ctrl-C, with the rows of the steps that were solved.
    """
    start_quietly(arguments.device)
    picture, is_quiet, output = arguments.picture, arguments.quiet, arguments.output
    if picture is not None:
        check_picture(picture, "--picture")
    with warnings_on_stderr(is_quiet=is_quiet):
        sequence = open_sequence(arguments, arguments.frames)
    if output != STDOUT:
        make_folder(output, "--output")
    steps = Steps(arguments, sequence)
    tell = teller(output, is_quiet=is_quiet)
    rows: list[StepRow] = []
    is_complete = False
    is_file = output != STDOUT
    with (output / CSV).open("w", encoding="utf-8", newline="") if is_file else nullcontext(sys.stdout) as file:
        try:
            write = partial(write_out, stream=file, name=output / CSV if is_file else "standard output")
            write(csv_text([COLUMNS]))
            steps.begin("steps", len(steps))
            for k in range(len(steps)):
                row = StepRow.of(k, sequence.labels[k : k + 2], steps.solved(k))
                write(csv_text([row.cells]))
                rows.append(row)
                steps.advance()
            if picture is not None:
                _draw(picture, steps, rows)
            is_complete = True
        except KeyboardInterrupt:
            pass
        finally:
            steps.line.clear()
    if rows:
        tell(_report(steps, rows))
    files = {output / CSV: is_file, picture: picture is not None and is_complete}
    for path in [path for path, is_written in files.items() if is_written]:
        tell(f"wrote {printable(str(path))}")
    if not is_complete:
        say(f"interrupted after {len(rows)} of {len(steps)} steps{f'; {CSV} holds these' if is_file else ''}")
        return INTERRUPTED
    return int(arguments.fail_on_contact and any(row.hit or row.crossing for row in rows))


def _draw(path: Path, steps: Steps, rows: Sequence[StepRow]) -> None:
    """Draw the first step that has a contact, or else one at whose start surfaces cross."""
    crossing = next((row.step for row in rows if row.crossing), 0)
    step = steps.solved(next((row.step for row in rows if row.hit), crossing))
    steps.line.clear()
    draw_step(path, step)


def _report(steps: Steps, rows: Sequence[StepRow]) -> str:
    """The report of the steps that were solved, without a final newline."""
    sequence, options, mesh = steps.sequence, steps.options, steps.sequence.mesh
    title = f"{len(sequence)} frames of {sequence._name}"
    lines = [format_title(title, options), "", *body_lines(sequence.step(0)), ""]
    hits, crossing = [row for row in rows if row.hit], [row for row in rows if row.crossing]
    if not hits:
        lines.append(f"steps with contacts  none of {len(rows)}   {looked_at(mesh, options)}")
    else:
        lines.append(f"steps with contacts  {_numbers(hits, rows)}")
        first = hits[0]
        lines.append(f"the first  step {first.step}, {first.start} -> {first.end}, toi {format_toi(first.toi)}")
        sentence = start_sentence(first.at_start)
        lines += [f"           {line}" for line in [*first.described, *([sentence] if sentence else [])]]
        if num_capped := sum(row.at_limit for row in rows):
            lines.append(f"{num_capped:,} contacts stopped at a limit: their toi is early, never late")
    if crossing:
        lines.append(f"surfaces cross at the start of  {_numbers(crossing, rows, ' steps')}")
        lines.append(f"           of the first, {crossing_sentence(crossing[0].crossing)}")
    else:
        lines.append("at the start of each step  no edge passes through a face")
    lines += scope_lines(mesh, options, steps.ignored)
    displacement = max(row.displacement for row in rows)
    return "\n".join([*lines, length_line(mesh, steps.at_start, displacement, options)])


def _numbers(some: Sequence[StepRow], rows: Sequence[StepRow], what: str = "") -> str:
    """How many of the steps these are, and which, with runs of them as ranges: "4 of 10: 3-5, 8"."""
    runs: list[list[int]] = []
    for row in some:
        if runs and row.step == runs[-1][-1] + 1:
            runs[-1] = [runs[-1][0], row.step]
        else:
            runs.append([row.step])
    return f"{len(some)} of {len(rows)}{what}: {', '.join('-'.join(map(str, run)) for run in runs)}"
