"""Pictures that the command line draws, checked before the work is done."""

from dataclasses import replace
from pathlib import Path

from ccd_warp._cli.progress import waiting
from ccd_warp._cli.replacing import replacing
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._files.frames import InputError
from ccd_warp._runtime.terminal import closed_stderr


def check_picture(path: Path, option: str) -> None:
    """Refuse a picture that cannot be drawn or written, before the work is done."""
    from ccd_warp.viz._file import check_picture_path

    check_picture_path(path, option)
    check_drawing(option)


def check_drawing(option: str) -> None:
    """Refuse to draw where PyVista or OpenGL is missing."""
    from ccd_warp.viz._window import drawing_without_display

    try:
        with closed_stderr(), drawing_without_display():
            pass
    except (ImportError, RuntimeError) as error:
        raise InputError(f"{option}: {error}") from error


def draw_step(path: Path, step: SolvedStep, *, is_quiet: bool) -> Path:
    """Draw a step at its start, toi and end; return the path."""
    from ccd_warp import viz

    with waiting("drawing the picture", is_quiet=is_quiet), replacing(path) as to, closed_stderr():
        viz.render_step(
            step.mesh,
            step.vertices_t0,
            step.vertices_t1,
            replace(step.result, start=step.start),
            to,
            t_max=step.options.t_max,
            motion=step.motion,
        )
    return path


def check_animation(path: Path, option: str) -> None:
    """Refuse a picture of a sequence that cannot be drawn or written, before the work is done."""
    if path.suffix.lower() == ".png":
        check_picture(path, option)
        return
    from ccd_warp.viz._animation import ANIMATION_SUFFIXES, check_animation_path

    if path.suffix.lower() not in ANIMATION_SUFFIXES:
        raise InputError(f"{option} {path}: the name must end in {', '.join([*ANIMATION_SUFFIXES, '.png'])}")
    check_animation_path(path, option)
    check_drawing(option)
