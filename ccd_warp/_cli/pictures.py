"""Pictures of a step that the command line draws, checked before the work is done."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ccd_warp._cli.solve import SolvedStep
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


def check_picture(path: Path, option: str) -> None:
    """Refuse a picture that cannot be drawn or written."""
    from ccd_warp.viz._file import check_picture_path
    from ccd_warp.viz._window import drawing_without_display

    check_picture_path(path, option)
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
