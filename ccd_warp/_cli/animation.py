"""An animation of a sequence of frames, with the contacts of its steps."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.process import closed_stderr
from ccd_warp._cli.progress import ItemsLine
from ccd_warp._cli.replacing import replacing
from ccd_warp._cli.sequence_records import StepRecord
from ccd_warp._sequence import FrameSequence


def draw_animation(path: Path, sequence: FrameSequence, records: dict[int, StepRecord], line: ItemsLine) -> Path:
    """Draw every frame, and every step with a contact at its toi; return the path."""
    from ccd_warp.viz._animation import write_animation

    line.begin("pictures", 2 * (len(sequence) - 1))
    with replacing(path) as beside, closed_stderr():
        write_animation(beside, _images(sequence, records, line))
    return path


def _images(
    sequence: FrameSequence, records: dict[int, StepRecord], line: ItemsLine
) -> Iterator[tuple[NDArray[np.uint8], bool]]:
    from ccd_warp.viz._animation import FrameView, draw_frame, outermost

    num_steps = len(sequence) - 1
    points, moved = [], np.zeros((1, 3))
    for k in range(num_steps):
        step = sequence.step(k)
        start, end = step.vertices_t0, step.vertices_t1
        points += [outermost(start), outermost(end)]
        moved = np.maximum(moved, np.abs(end - start).max(axis=0))
        line.advance()
    view = FrameView.of(np.concatenate(points), moved)
    for k in range(num_steps):
        step, record = sequence.step(k), records[k]
        mesh, start, end = step.mesh, step.vertices_t0, step.vertices_t1
        yield draw_frame(mesh, start, [], record.start, view), False
        if record.hit:
            at_toi = (1.0 - record.toi) * start + record.toi * end
            yield draw_frame(mesh, at_toi, record.points, f"{record.start}, toi = {record.toi:.4g}", view), True
        if k == num_steps - 1:
            yield draw_frame(mesh, end, [], record.end, view), True
        line.advance()
