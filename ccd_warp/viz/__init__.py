"""Pictures of a step, without a display. They need PyVista, the extra ``viz``.

The bodies are shown at t = 0, at the toi of the scene and at t = 1. Static bodies are grey, each other body has its own
colour, and a legend names them; a line shows the path of a body that moves farther than its own size. With ``motion=``
rigid bodies are where they are at these times, and lines show the arcs of their outermost vertices. At the toi, the
earliest contacts are points with their normals as arrows; later contacts are fainter and drawn at their future
positions. Nothing hides a contact. At t = 1 the colours show the toi of the vertices, on large faces the earliest of
their corners; what touches nothing is pale in the colour of its body, and large faces of static bodies stay grey. With
the result of ``check_start=True``, points mark at t = 0 where surfaces cross. :func:`to_pyvista` gives the step as data
sets, for other pictures, close-ups, windows and animations.

Pictures need no display and no GPU, but an OpenGL library that works without them: on Linux, EGL or OSMesa, which most
systems have; otherwise install it, for example with ``apt-get install libegl1 libgl1-mesa-dri``.
"""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from decimal import ROUND_FLOOR, Context
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ccd_warp._results.contact_place import BodyMotion
from ccd_warp._results.results import HostLaunchResult, MeshResult
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import check_choice, check_instance, check_items, check_path, check_real, shown
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.viz._camera import direction_to_viewer
from ccd_warp.viz._export import to_pyvista
from ccd_warp.viz._file import Picture, check_picture_path
from ccd_warp.viz._scene import check_result, make_scene
from ccd_warp.viz._window import ZOOM, drawing_without_display, drawn

if TYPE_CHECKING:
    from ccd_warp.viz._panel import Panel

__all__ = [
    "Picture",
    "draw_step",
    "drawing_without_display",
    "render_step",
    "to_pyvista",
]

Colour = Literal["vertex_toi", "body"]

# Sizes of text, points and lines are given in pixels of a panel with a shorter side of this many pixels, and scale with
# it.
_SHORTER_SIDE = 520
_SMALLEST, _LARGEST = 150, 4000


def draw_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    result: MeshResult | HostLaunchResult,
    *,
    size: tuple[int, int] = (1600, 520),
    camera: ArrayLike | None = None,
    colour: Colour = "vertex_toi",
    t_max: float = 1.0,
    motion: BodyMotion | None = None,
) -> Picture:
    """Draw a step: the scene at t = 0, at its toi and at t = 1, side by side.

    Args:
        mesh: The mesh of the step.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, as ``mesh_ccd`` takes them, shape [V, 3] or [V_moving, 3].
        result: The result of ``mesh_ccd``, or of a launch on the host.
        size: Width and height in pixels.
        camera: Direction from the scene to the viewer, shape [3]; by default across the motion and from a little above.
            The view is parallel, with z up, fits the whole motion, and is the same at all three times.
        colour: Colours of the bodies at t = 1: by the toi of the vertices, with a colour bar, or by body as at the
            other times.
        t_max: The ``t_max`` of the step, shown in place of the toi if there is no contact.
        motion: How rigid bodies turn, a :class:`ccd_warp.RigidMotion`; their vertices stand in their own frames in both
            positions. Of a mesh without rigid bodies all are, as in ``rigid_ccd``.

    Returns:
        The picture, which a notebook shows.

    Raises:
        ImportError: If the extra ``viz`` is not installed.
        RuntimeError: If the system has no OpenGL that works without a display.
        ValueError: If an argument is not as described.
    """
    check_instance("mesh", mesh, CollisionMesh)
    check_result(result)
    width, height = _validated_size(size)
    t_max = check_real("t_max", t_max, "a number in (0, 1]", lambda x: 0 < x <= 1)
    toi_range = _toi_range(result, colour)
    scene = make_scene(mesh, vertices_t0, vertices_t1, result, motion)
    towards = direction_to_viewer(*scene.ends, camera)
    enlargement = min(width / 3, height) / _SHORTER_SIDE

    def draw(plotter: Any) -> None:
        from ccd_warp.viz._panel import Panel, see

        panel_size = (width / 3 / enlargement, height / enlargement)
        panels = [Panel(plotter, (0, k), scene, panel_size, ZOOM * enlargement) for k in range(3)]
        see(panels, towards)
        _draw_panels(panels, toi_range, t_max)

    return Picture(drawn((width, height), 3, draw))


@text_completed_by(draw_step)
def render_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    result: MeshResult | HostLaunchResult,
    path: str | Path,
    *,
    size: tuple[int, int] = (1600, 520),
    camera: ArrayLike | None = None,
    colour: Colour = "vertex_toi",
    t_max: float = 1.0,
    motion: BodyMotion | None = None,
) -> Picture:
    """Write a picture of a step: the scene at t = 0, at its toi and at t = 1, side by side.

    Args:
        path: File to write, ``.png``.

    Returns:
        The picture, which a notebook shows, and which stands for its file where a path is expected.

    Raises:
        OSError: If the file cannot be written.
    """
    if isinstance(mesh, (str, PathLike)):
        raise ValueError(
            f"mesh is {shown(mesh)}; expected the mesh first, as in draw_step, and the path last: "
            f"render_step(mesh, vertices_t0, vertices_t1, result, path)"
        )
    path = check_path("path", path)
    check_picture_path(path, "path")
    picture = draw_step(
        mesh,
        vertices_t0,
        vertices_t1,
        result,
        size=size,
        camera=camera,
        colour=colour,
        t_max=t_max,
        motion=motion,
    )
    return picture.save(path)


def _draw_panels(panels: list[Panel], toi_range: tuple[float, float] | None, t_max: float) -> None:
    scene = panels[0].scene
    is_hit = np.isfinite(scene.toi)
    middle = scene.toi if is_hit else t_max
    middle_title = f"t = toi = {_rounded_down(middle)}" if is_hit else f"t = {t_max:g}, no contact"
    titles = ("t = 0, surfaces cross" if len(scene.crossing_points) else "t = 0", middle_title, "t = 1")
    for panel, t, title in zip(panels, (0.0, middle, 1.0), titles, strict=True):
        panel.light()
        panel.draw_bodies(t, toi_range if panel is panels[2] else None)
        panel.draw_trails()
        panel.write_title(title)
    panels[0].draw_legend()
    panels[0].draw_crossings()
    if toi_range is not None:
        panels[2].draw_toi_bar(toi_range)
    if is_hit:
        panels[1].draw_contacts()


def _toi_range(result: MeshResult | HostLaunchResult, colour: Colour) -> tuple[float, float] | None:
    """Range of the colour map, or None to colour by body."""
    check_choice("colour", colour, ("vertex_toi", "body"))
    toi = np.asarray(result.vertex_toi)
    toi = toi[np.isfinite(toi)]
    if colour == "body" or len(toi) == 0:
        return None
    return float(toi.min()), max(float(toi.max()), float(toi.min()) + 1e-6)


def _validated_size(size: tuple[int, int]) -> tuple[int, int]:
    expected = f"width and height in [{_SMALLEST}, {_LARGEST}] pixels"
    try:
        width, height = (
            int(check_real("size", side, expected, lambda x: x % 1 == 0 and _SMALLEST <= x <= _LARGEST))
            for side in check_items("size", size, expected)
        )
    except ValueError:
        raise ValueError(f"size is {shown(size)}; expected {expected}") from None
    return width, height


def _rounded_down(toi: float) -> str:
    """Six digits that are no later than the toi."""
    return str(Context(prec=6, rounding=ROUND_FLOOR).create_decimal(repr(toi)).normalize())
