"""The text that the command line prints on a sequence of frames."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.motion import Lengths
from ccd_warp._cli.report import (
    body_rows,
    body_table,
    crossing_sentence,
    format_table,
    format_title,
    format_toi,
    scope_lines,
    vertex_lines,
)
from ccd_warp._cli.scene import StartContacts
from ccd_warp._cli.scope import looked_at
from ccd_warp._cli.sequence_records import StepRecord, ranges_text
from ccd_warp._display import start_sentence
from ccd_warp._input.options import Options
from ccd_warp._pose_sequence import PoseSequence
from ccd_warp._sequence import FrameSequence

# Steps whose toi the report lists; the CSV file has all.
_MOST_ROWS = 20


def format_sequence(
    sequence: FrameSequence | PoseSequence,
    records: Sequence[StepRecord],
    options: Options,
    ignored: StartContacts | None,
    at_start: NDArray[np.float64],
) -> str:
    """The report of the steps that were computed, in their order, without a final newline."""
    mesh, bodies = sequence.mesh, sequence._first_bodies
    names = ", ".join(each.name for each in sequence._series)
    lines = [format_title(f"{len(sequence)} frames of {names}", options), ""]
    lines += body_table(("body", "", "vertices", "faces"), body_rows(mesh, bodies), align="<<>>")
    lines += [*vertex_lines(mesh, bodies), ""]
    bad = [record for record in records if record.hit]
    if bad:
        steps = ranges_text([record.step for record in bad])
        lines.append(f"steps with contacts  {len(bad)} of {len(records)}: {steps}")
        lines += _first(bad[0])
        lines.append("")
        rows = [
            (str(record.step), record.start, format_toi(record.toi), f"{sum(record.counts.values()):,}")
            for record in bad[:_MOST_ROWS]
        ]
        lines += format_table(("step", "from frame", "toi", "contacts"), rows, align="><<>")
        lines += [f"  … {len(bad) - _MOST_ROWS} more"] if len(bad) > _MOST_ROWS else []
        lines.append("")
        num_capped = sum(record.at_limit for record in records)
        if num_capped:
            lines.append(f"{num_capped:,} contacts stopped at a limit: their toi is early, never late")
    else:
        pairs = looked_at(mesh, options)
        lines.append(f"steps with contacts  none of {len(records)}   (certain for the pairs looked at: {pairs})")
    crossing = [record for record in records if record.crossing]
    if crossing:
        steps = ranges_text([record.step for record in crossing])
        lines.append(f"surfaces cross at the start of  {len(crossing)} of {len(records)} steps: {steps}")
        lines.append(f"           of the first, {crossing_sentence(crossing[0].pairs_crossing)}")
    else:
        lines.append("at the start of each step  no edge passes through a face")
    lines += [*scope_lines(mesh, options, ignored), ""]
    displacement = max(record.displacement for record in records)
    lengths = Lengths.of(at_start, displacement, options)
    return "\n".join([*lines, *format_table(("in the unit of the files", ""), lengths.rows(mesh.radius), align="<<")])


def _first(record: StepRecord) -> list[str]:
    """Lines on the first step that has a contact."""
    frames = f"{record.start} -> {record.end}"
    lines = [f"the first  step {record.step}, {frames}, toi {format_toi(record.toi)}"]
    lines += [f"           {line}" for line in record.described]
    sentence = start_sentence(record.pairs_at_start)
    return lines + ([f"           {sentence}"] if sentence else [])
