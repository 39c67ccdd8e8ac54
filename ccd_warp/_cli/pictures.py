"""Pictures that the command line draws: of a step, and the animation of a sequence; checked before the work is done."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.solve import SolvedStep
from ccd_warp._cli.table import StepRow
from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._scene.input.messages import InputError


@contextmanager
def closed_stderr() -> Iterator[None]:
    """Drop what native code writes to stderr, as OpenGL and VTK do."""
    saved = os.dup(2)
    try:
        with open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


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


def draw_step(path: Path, step: SolvedStep) -> None:
    """Draw a step at its start, toi and end."""
    from ccd_warp import viz

    ends, result = (step.frames.vertices_t0, step.frames.vertices_t1), replace(step.result, start=step.start)
    with closed_stderr():
        viz.render_step(step.mesh, *ends, result, path, t_max=step.options.t_max)


def draw_animation(
    path: Path, moving: Callable[[int], MovingVertices], rows: Sequence[StepRow], advance: Callable[[], None]
) -> None:
    """Draw every frame, and every step with a contact at its toi, of which ``moving`` gives each."""
    from ccd_warp.viz._animation import write_animation

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
        with closed_stderr():
            images = [(draw_frame(step.mesh, step.all_at(0.0), [], title, view, crossing=row.crossing_points), False)]
            if row.hit:
                title, at_toi = f"{row.start}, toi = {row.toi:.4g}", step.all_at(row.toi)
                images.append((draw_frame(step.mesh, at_toi, row.points, title, view, sizes=row.sizes), True))
            if row is rows[-1]:
                images.append((draw_frame(step.mesh, step.all_at(1.0), [], row.end, view), True))
        yield from images
        advance()
