"""The foreground of a panel: its contacts, and a close-up of the first one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyvista
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkRenderer

from ccd_warp.viz._camera import Camera
from ccd_warp.viz._panel import LABEL_SIZE, LINE_COLOUR, Panel, add_lights, aim, flat_actor, write
from ccd_warp.viz._scene import CROSSING_COLOUR, StepScene

_FIRST_COLOUR, _LATER_COLOUR, _LATER_OPACITY = "#c8102e", "#d8484f", 0.3
# In pixels.
_FIRST_SIZE, _LATER_SIZE, _ARROW_LENGTH = 10, 2.5, 50
_GAP, _TITLE, _FRAME_WIDTH = 8, 36, 1
# A close-up is drawn if the smaller body of the first contact takes less than _SMALL of the panel's shorter side, or
# its smaller primitive less than _TINY. The close-up takes _SIDE of that side, the body _SHARE of the close-up, the
# primitive _SHARE_OF_CONTACT, unless it is so small that single precision, in which it is drawn, would show.
_SMALL, _TINY, _SIDE, _SHARE, _SHARE_OF_CONTACT = 0.1, 0.01, 0.31, 0.4, 0.2
_LEAST_HALF = 5e-4
_CROSSING_SIZE = 8
_INSET_EDGE = 0.5
_WHITE = 250


def draw_contacts(panel: Panel) -> Any:
    """Draw the earliest contacts with their normals and later ones fainter; return the renderer used."""
    behind = panel.renderer
    front = _add_renderer(panel, behind.GetViewport())
    front.SetActiveCamera(behind.GetActiveCamera())
    _add_contacts(front, panel.scene, panel.camera.pixel, panel.zoom)
    return front


def draw_crossings(panel: Panel) -> None:
    """Mark where surfaces cross at the start."""
    points = panel.scene.crossing_points
    if len(points):
        behind = panel.renderer
        front = _add_renderer(panel, behind.GetViewport())
        front.SetActiveCamera(behind.GetActiveCamera())
        front.AddActor(flat_actor(pyvista.PolyData(points), CROSSING_COLOUR, point_size=_CROSSING_SIZE * panel.zoom))


def draw_close_up(panel: Panel, front: Any) -> None:
    """Draw the first contact enlarged in the emptiest corner of a panel, if its smaller body or primitive is small.

    Args:
        panel: A panel with its bodies drawn.
        front: The renderer of its contacts.
    """
    scene, camera = panel.scene, panel.camera
    size, shorter = camera.size, min(camera.size)
    has_small_body = 0.0 < scene.first_body_size < _SMALL * shorter * camera.pixel
    if not has_small_body and not 0.0 < scene.first_contact_size < _TINY * shorter * camera.pixel:
        return
    side = _SIDE * shorter
    half = 0.5 * scene.first_body_size / _SHARE
    if not has_small_body:
        half = max(0.5 * scene.first_contact_size / _SHARE_OF_CONTACT, _LEAST_HALF)
    focus = scene.contact_points[scene.first_contact]
    near = replace(
        camera,
        focus=focus,
        position=focus + camera.position - camera.focus,
        parallel_scale=half,
        size=(side, side),
    )
    renderer = panel.renderer
    x0, y0, x1, y1 = renderer.GetViewport()
    width, height = side / size[0] * (x1 - x0), side / size[1] * (y1 - y0)
    x, y = _emptiest_corner(panel, (x0, y0, x1, y1), (width, height))
    viewport = (x, y, x + width, y + height)
    inset = _add_renderer(panel, viewport)
    inset.SetPreserveColorBuffer(False)
    inset.SetBackground(1.0, 1.0, 1.0)
    add_lights(inset)
    for actor in renderer.actors.values():
        if not isinstance(actor, vtkActor2D):
            inset.AddActor(actor if has_small_body else _with_edges(actor, panel.zoom))
    aim(inset.GetActiveCamera(), near)
    line_width = _FRAME_WIDTH * panel.zoom
    front.AddActor(flat_actor(_frame(near, half), LINE_COLOUR, line_width=line_width))
    contacts = _add_renderer(panel, viewport)
    contacts.SetActiveCamera(inset.GetActiveCamera())
    _add_contacts(contacts, scene, near.pixel, panel.zoom)
    contacts.AddActor(flat_actor(_frame(near, 0.99 * half), LINE_COLOUR, line_width=line_width))
    write(contacts, f"× {camera.pixel / near.pixel:.0f}", (0.05, 0.05), LABEL_SIZE * panel.zoom, is_on_white=True)


def _with_edges(actor: Any, zoom: float) -> Any:
    """The same actor with the edges of its faces, which are too short to be seen in the panel."""
    other = pyvista.Actor(mapper=actor.mapper.copy(), prop=actor.prop.copy())  # which keeps what it has drawn
    other.prop.show_edges, other.prop.edge_color, other.prop.edge_opacity = True, "black", 0.6
    other.prop.line_width = _INSET_EDGE * zoom
    return other


def _add_renderer(panel: Panel, viewport: tuple[float, ...]) -> Any:
    """A renderer in front of all others."""
    window = panel.plotter.render_window
    front = vtkRenderer()
    front.SetLayer(window.GetNumberOfLayers())
    window.SetNumberOfLayers(front.GetLayer() + 1)
    front.SetViewport(*viewport)
    front.InteractiveOff()
    window.AddRenderer(front)
    return front


def _add_contacts(renderer: Any, scene: StepScene, pixel: float, zoom: float) -> None:
    is_first = scene.contact_is_first
    if not is_first.all():
        later = pyvista.PolyData(scene.contact_points[~is_first])
        renderer.AddActor(flat_actor(later, _LATER_COLOUR, opacity=_LATER_OPACITY, point_size=_LATER_SIZE * zoom))
    points, normals = scene.contact_points[is_first], scene.contact_normals[is_first]
    if len(points):
        renderer.AddActor(flat_actor(pyvista.PolyData(points), _FIRST_COLOUR, point_size=_FIRST_SIZE * zoom))
    has_normal = normals.any(axis=1)
    if has_normal.any():
        tails = pyvista.PolyData(points[has_normal])
        tails["normal"] = normals[has_normal]
        arrow = pyvista.Arrow(tip_length=0.3, tip_radius=0.09, shaft_radius=0.025, scale=_ARROW_LENGTH * pixel)
        arrows = tails.glyph(orient="normal", scale=False, geom=arrow)
        renderer.AddActor(flat_actor(arrows, _FIRST_COLOUR))


def _emptiest_corner(
    panel: Panel, viewport: tuple[float, float, float, float], part: tuple[float, float]
) -> tuple[float, float]:
    """Lower left of the corner rectangle below the title that hides least, in fractions of the window."""
    image = panel.plotter.screenshot(return_img=True)
    height, width = image.shape[:2]
    is_drawn = (image < _WHITE).any(axis=2)[::-1]
    gap = _GAP * panel.zoom
    x0, y0, x1, y1 = viewport
    right, top = x1 - part[0] - gap / width, y1 - part[1] - (gap + _TITLE * panel.zoom) / height
    corners = [(x, y) for y in (y0 + gap / height, top) for x in (right, x0 + gap / width)]

    def hidden(corner: tuple[float, float]) -> int:
        columns, rows = (
            slice(int(low * count), int((low + extent) * count))
            for low, extent, count in zip(corner, part, (width, height), strict=True)
        )
        return int(is_drawn[rows, columns].sum())

    return min(corners, key=hidden)


def _frame(camera: Camera, half: float) -> Any:
    """The square that a camera sees."""
    towards = (camera.position - camera.focus) / np.linalg.norm(camera.position - camera.focus)
    right = np.cross(camera.up, towards)
    corners = [camera.focus + half * (x * right + y * camera.up) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return pyvista.PolyData(np.array(corners), lines=[5, 0, 1, 2, 3, 0])
