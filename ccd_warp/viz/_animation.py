"""An animation of the frames of a sequence: GIF, or MP4 where there is an encoder."""

import importlib
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.viz._camera import Camera, automatic_direction, make_camera
from ccd_warp.viz._file import check_file_path
from ccd_warp.viz._moving import outermost
from ccd_warp.viz._scene import StepScene, middle_of, placed
from ccd_warp.viz._window import ZOOM, drawn

__all__ = ["FrameView", "check_animation_path", "draw_frame", "encoder", "outermost", "write_animation"]

ANIMATION_SUFFIXES = (".gif", ".mp4")

_SIZE, _SHORTER_SIDE = (800, 600), 520
_MARGINS = (14, 40, 72)  # pixels at the sides, above for the title, below for the legend
_PER_SECOND = 10
_HELD = 4  # a contact is shown as long as this many frames
_COLOURS = 256
_BEYOND = 1.08  # between these directions a ball reaches so much farther


@dataclass(frozen=True)
class FrameView:
    """The view of all frames, in coordinates in which they lie between -1 and 1.

    Attributes:
        centre: Middle of the box around all frames, shape [3].
        unit: Half its longest side.
        camera: The view of it.
    """

    centre: NDArray[np.float64]
    unit: float
    camera: Camera

    @classmethod
    def of(cls, points: NDArray[np.float64], motion: NDArray[np.float64]) -> "FrameView":
        """The view of points that lie outermost, across a motion, both of shape [n, 3]."""
        centre, unit = middle_of(points, points)
        shown = _BEYOND * (points - centre) / unit
        enlargement = min(_SIZE) / _SHORTER_SIDE
        size = (_SIZE[0] / enlargement, _SIZE[1] / enlargement)
        return cls(centre, unit, make_camera(shown, shown, automatic_direction(motion / unit), size, _MARGINS))


def draw_frame(
    mesh: CollisionMesh,
    positions: NDArray[np.float64],
    contacts: ArrayLike,
    title: str,
    view: FrameView,
    *,
    crossing: ArrayLike = (),
    sizes: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.uint8]:
    """An image of a mesh at one time.

    Args:
        mesh: The mesh.
        positions: Of all vertices, shape [V, 3].
        contacts: Places of contacts, the first of which is marked, shape [m, 3].
        title: Line above it.
        view: The view.
        crossing: Places where surfaces cross, shape [k, 3].
        sizes: Of the smaller body and the smaller primitive of the first contact, which may be shown close-up.

    Returns:
        Red, green and blue, uint8, shape [height, width, 3].
    """
    points, crossings = (np.asarray(places, dtype=np.float64).reshape(-1, 3) for places in (contacts, crossing))
    scene = replace(
        _scene(mesh, positions, points, view),
        crossing_points=(crossings - view.centre) / view.unit,
        first_body_size=sizes[0] / view.unit,
        first_contact_size=sizes[1] / view.unit,
    )

    def draw(plotter: Any) -> None:
        from ccd_warp.viz._front import draw_close_up, draw_contacts, draw_crossings
        from ccd_warp.viz._panel import Panel

        panel = Panel(plotter, (0, 0), scene, view.camera, ZOOM * min(_SIZE) / _SHORTER_SIDE)
        panel.set_view()
        panel.draw_bodies(0.0)
        panel.write_title(title)
        panel.draw_legend()
        draw_crossings(panel)
        if len(scene.contact_points):
            draw_close_up(panel, draw_contacts(panel))

    return drawn(_SIZE, 1, draw)


def _scene(
    mesh: CollisionMesh, positions: NDArray[np.float64], contacts: NDArray[np.float64], view: FrameView
) -> StepScene:
    """A step in which nothing moves and which has these contacts."""
    return StepScene(
        **placed(mesh, positions, positions, view.centre, view.unit),
        vertex_toi=np.full(len(positions), np.inf),
        toi=0.0 if len(contacts) else np.inf,
        contact_points=(contacts - view.centre) / view.unit,
        contact_normals=np.zeros_like(contacts),
        contact_is_first=np.arange(len(contacts)) == 0,
        first_contact=0 if len(contacts) else -1,
        first_body_size=0.0,
        first_contact_size=0.0,
    )


def check_animation_path(path: Path, argument: str) -> None:
    """Refuse an animation that cannot be written, before the work is done.

    Raises:
        ValueError: If the folder does not exist or cannot be written to, or there is no encoder for the format.
    """
    check_file_path(path, argument)
    if path.suffix.lower() == ".mp4" and encoder() is None:
        raise ValueError(
            f"{argument} {path}: MP4 needs an encoder; install ffmpeg, or pip install 'ccd-warp[video]', or choose .gif"
        )


def encoder() -> str | None:
    """The program ffmpeg: that of the system, or of the package imageio-ffmpeg; None if there is none."""
    system_ffmpeg = shutil.which("ffmpeg")
    if system_ffmpeg is not None:
        return system_ffmpeg
    try:
        program: str = importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
        return program
    except (ImportError, RuntimeError):
        return None


def write_animation(path: Path, images: Iterable[tuple[NDArray[np.uint8], bool]]) -> None:
    """Write images, of which some are held for longer.

    Args:
        path: ``.gif`` or ``.mp4``, of which the second needs an :func:`encoder`.
        images: The images, in their order, and whether each is held.

    Raises:
        OSError: If the file cannot be written.
    """
    if path.suffix.lower() == ".gif":
        _write_gif(path, images)
    else:
        _write_mp4(path, images)


def _write_gif(path: Path, images: Iterable[tuple[NDArray[np.uint8], bool]]) -> None:
    from PIL import Image

    durations: list[int] = []
    pictures: list[Any] = []
    for image, is_held in images:
        # By octree, which keeps a colour that few pixels have, as one of the legend; a third of the image's memory.
        pictures.append(Image.fromarray(image).quantize(_COLOURS, Image.Quantize.FASTOCTREE))
        durations.append(1000 // _PER_SECOND * (_HELD if is_held else 1))
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0)


def _write_mp4(path: Path, images: Iterable[tuple[NDArray[np.uint8], bool]]) -> None:
    program = encoder()
    assert program is not None, "checked before"
    width, height = _SIZE
    command = [
        *(program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", str(_PER_SECOND), "-i", "-", "-an", "-pix_fmt", "yuv420p", str(path)),
    ]
    # In a session of its own, so that Ctrl-C reaches this process alone, which then ends it.
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    try:
        assert process.stdin is not None
        for image in _repeated(images):
            process.stdin.write(image.tobytes())
        _, said = process.communicate()
    except BrokenPipeError:
        _, said = process.communicate()
    except BaseException:
        process.kill()
        process.communicate()
        raise
    if process.returncode:
        reason = " ".join(said.decode(errors="replace").split()) or f"status {process.returncode}"
        raise OSError(f"the encoder failed: {reason}")


def _repeated(images: Iterable[tuple[NDArray[np.uint8], bool]]) -> Iterator[NDArray[np.uint8]]:
    for image, is_held in images:
        for _ in range(_HELD if is_held else 1):
            yield image
