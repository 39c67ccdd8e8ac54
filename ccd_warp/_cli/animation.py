"""An animation of a sequence of frames, with the contacts of its steps."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.progress import ItemsLine
from ccd_warp._cli.replacing import replacing
from ccd_warp._cli.sequence_records import StepRecord
from ccd_warp._contact_place import MovingVertices
from ccd_warp._runtime.terminal import closed_stderr


def draw_animation(
    path: Path, moving: Callable[[int], MovingVertices], records: dict[int, StepRecord], line: ItemsLine
) -> Path:
    """Draw every frame, and every step with a contact at its toi, of which ``moving`` gives each; return the path."""
    from ccd_warp.viz._animation import write_animation

    line.begin("pictures", 2 * len(records))
    with replacing(path) as beside, closed_stderr():
        write_animation(beside, _images(moving, records, line))
    return path


def _images(
    moving: Callable[[int], MovingVertices], records: dict[int, StepRecord], line: ItemsLine
) -> Iterator[tuple[NDArray[np.uint8], bool]]:
    from ccd_warp.viz._animation import FrameView, draw_frame, outermost

    num_steps = len(records)
    points, moved = [], np.zeros((1, 3))
    for k in range(num_steps):
        step = moving(k)
        start, end = step.all_at(0.0), step.all_at(1.0)
        points += [outermost(step.all_at(t)) for t in step.times]
        moved = np.maximum(moved, np.abs(end - start).max(axis=0))
        line.advance()
    view = FrameView.of(np.concatenate(points), moved)
    for k in range(num_steps):
        step, record = moving(k), records[k]
        mesh = step.mesh
        title = f"{record.start}, surfaces cross" if record.crossing else record.start
        yield draw_frame(mesh, step.all_at(0.0), [], title, view, crossing=record.crossing_points), False
        if record.hit:
            title = f"{record.start}, toi = {record.toi:.4g}"
            at_toi = step.all_at(record.toi)
            yield draw_frame(mesh, at_toi, record.points, title, view, sizes=record.sizes), True
        if k == num_steps - 1:
            yield draw_frame(mesh, step.all_at(1.0), [], record.end, view), True
        line.advance()
