"""Pictures that the command line draws: of a step, and the animation of a sequence; checked before the work is done."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.process import waiting
from ccd_warp._cli.solve import SolvedStep, positions_of
from ccd_warp._cli.table import StepRow
from ccd_warp._cli.terminal import closed_stderr
from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._scene.input.messages import InputError


def check_picture(path: Path, option: str, *, is_sequence: bool = False) -> None:
    """Refuse a picture that cannot be drawn or written; that of a sequence may be an animation."""
    from ccd_warp.viz._animation import ANIMATION_SUFFIXES, check_animation_path
    from ccd_warp.viz._file import check_picture_path
    from ccd_warp.viz._window import drawing_without_display

    if not is_sequence or path.suffix.lower() == ".png":
        check_picture_path(path, option)
    elif path.suffix.lower() in ANIMATION_SUFFIXES:
        check_animation_path(path, option)
    else:
        raise InputError(f"{option} {path}: the name must end in {', '.join([*ANIMATION_SUFFIXES, '.png'])}")
    try:
        with closed_stderr(), drawing_without_display():
            pass
    except (ImportError, RuntimeError) as error:  # PyVista or OpenGL is missing
        raise InputError(f"{option}: {error}") from error


def draw_step(path: Path, step: SolvedStep, *, is_quiet: bool) -> None:
    """Draw a step at its start, toi and end."""
    from ccd_warp import viz

    result, t_max = replace(step.result, start=step.start), step.options.t_max
    with waiting("drawing the picture", is_quiet=is_quiet), closed_stderr():
        viz.render_step(step.mesh, *positions_of(step.bodies), result, path, t_max=t_max, motion=step.motion)


def draw_animation(
    path: Path, moving: Callable[[int], MovingVertices], rows: Sequence[StepRow], advance: Callable[[], None]
) -> None:
    """Draw every frame, and every step with a contact at its toi, of which ``moving`` gives each."""
    from ccd_warp.viz._animation import write_animation

    with closed_stderr():
        write_animation(path, _images(moving, rows, advance))


def _images(
    moving: Callable[[int], MovingVertices], rows: Sequence[StepRow], advance: Callable[[], None]
) -> Iterator[tuple[NDArray[np.uint8], bool]]:
    from ccd_warp.viz._animation import FrameView, draw_frame, outermost

    points, moved = [], np.zeros((1, 3))
    for row in rows:
        step = moving(row.step)
        points += [outermost(step.all_at(t)) for t in step.times]
        moved = np.maximum(moved, np.abs(step.all_at(1.0) - step.all_at(0.0)).max(axis=0))
        advance()
    view = FrameView.of(np.concatenate(points), moved)
    for row in rows:
        step, title = moving(row.step), f"{row.start}, surfaces cross" if row.crossing else row.start
        yield draw_frame(step.mesh, step.all_at(0.0), [], title, view, crossing=row.crossing_points), False
        if row.hit:
            title, at_toi = f"{row.start}, toi = {row.toi:.4g}", step.all_at(row.toi)
            yield draw_frame(step.mesh, at_toi, row.points, title, view, sizes=row.sizes), True
        if row is rows[-1]:
            yield draw_frame(step.mesh, step.all_at(1.0), [], row.end, view), True
        advance()
