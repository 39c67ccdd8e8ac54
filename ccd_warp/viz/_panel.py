"""Draw a step at one time into a panel of PyVista."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import pyvista
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkRenderer

from ccd_warp.viz._scene import CROSSING_COLOUR, StepScene

_EDGE_COLOUR, _LINE_COLOUR, _TEXT_COLOUR = "#303030", "#555555", "#222222"
_FIRST_COLOUR, _LATER_COLOUR, _LATER_OPACITY = "#c8102e", "#d8484f", 0.3
# In pixels of a panel with a shorter side of 520.
_FIRST_SIZE, _LATER_SIZE, _ARROW_LENGTH, _CROSSING_SIZE = 10, 2.5, 50, 8
_READABLE_EDGE, _COARSE_EDGE = 10, 60
_EDGE_WIDTH, _TRAIL_WIDTH, _CABLE_WIDTH, _PARTICLE_SIZE = 1, 1.5, 4, 8
_TITLE_SIZE, _LABEL_SIZE, _LEGEND_LINE, _LEGEND_GAP = 17, 13, 20, 3
# In fractions of a panel: width and height of a scene, how far it is above the middle, and the width of a legend.
_WIDTH, _HEIGHT, _RAISED, _LEGEND_WIDTH = 0.95, 0.78, 0.06, 0.4
_LEAST_HALF = 0.05  # of a view, so that a motion straight towards the viewer does not fill the panel
_SHADED = 0.75  # of a colour, in the legend, where the text has it, too
_PLANE_OPACITY = 0.4
_SHARP = 35.0  # degrees between two faces that are not shaded as one surface
# Lights in the viewer's coordinates, with the viewer at (0, 0, 1), and their intensity.
_LIGHTS = (((-0.7, 1.0, 1.5), 0.6), ((1.0, -0.1, 1.0), 0.3))
_LIGHT_OF_BODIES = {"ambient": 0.5, "diffuse": 0.75, "specular": 0.0}
_LIGHT_OF_TOI = {"ambient": 0.65, "diffuse": 0.5, "specular": 0.0}  # colours near those of the bar


@dataclass(frozen=True)
class Panel:
    """The panel in which a step is drawn.

    Attributes:
        plotter: Plotter of PyVista, without its own lights.
        place: Row and column of the panel in it.
        scene: The step.
        size: Width and height, in pixels of a panel with a shorter side of 520.
        zoom: Window pixels for each of these, along one side.
    """

    plotter: Any
    place: tuple[int, int]
    scene: StepScene
    size: tuple[float, float]
    zoom: float

    @property
    def renderer(self) -> Any:
        """The renderer of the panel, which becomes the active one."""
        self.plotter.subplot(*self.place)
        return self.plotter.renderer

    @property
    def pixel(self) -> float:
        """Length of a pixel, in the view that :func:`see` sets up."""
        return float(2.0 * self.renderer.camera.parallel_scale / self.size[1])

    def light(self) -> None:
        """Light the panel, on white, from behind the viewer."""
        renderer = self.renderer
        renderer.background_color = "white"
        for position, intensity in _LIGHTS:
            renderer.AddLight(pyvista.Light(position=position, light_type="camera light", intensity=intensity))

    def draw_bodies(self, t: float, toi_range: tuple[float, float] | None = None) -> None:
        """Draw surfaces, cables and particles.

        Args:
            t: Time, in [0, 1].
            toi_range: Range of the toi for colouring by the toi of the vertices; by default the colours are those of
                the bodies. On large faces interpolated colours would mean nothing: such a face has one colour, by the
                earliest toi of its corners, and stays grey if its body is static.
        """
        scene, positions = self.scene, self.scene.positions(t)
        colours = scene.vertex_colours if toi_range is None else self._colours_by_toi(scene.vertex_toi, toi_range)
        edge_length = scene.body_edge_length[scene.vertex_body[scene.faces[:, 0]]] / self.pixel
        has_edges, is_coarse = edge_length >= _READABLE_EDGE, edge_length >= _COARSE_EDGE
        is_coarse &= toi_range is not None
        light = _LIGHT_OF_BODIES if toi_range is None else _LIGHT_OF_TOI
        for is_drawn in (~has_edges, has_edges & ~is_coarse, is_coarse):
            if not is_drawn.any():
                continue
            used, faces = _used_vertices(scene.faces[is_drawn])
            # a deep copy, because VTK would read the array after it is freed
            surface = pyvista.PolyData.from_regular_faces(positions[used], faces, deep=True)
            scalars, preference = colours[used], "point"
            if toi_range is not None and is_drawn is is_coarse:
                scalars, preference = self._colours_of_faces(scene.faces[is_drawn], toi_range), "cell"
            style = {"show_edges": bool(has_edges[is_drawn].all()), "edge_color": _EDGE_COLOUR, "edge_opacity": 0.3}
            style |= {"line_width": _EDGE_WIDTH * self.zoom, "preference": preference}
            style |= {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": _SHARP}
            self._add(surface, scalars, **light, **style)
        if len(scene.segments):
            used, segments = _used_vertices(scene.segments)
            cables = pyvista.PolyData(positions[used], lines=np.insert(segments, 0, 2, axis=1).ravel())
            style = {"line_width": _CABLE_WIDTH * self.zoom, "render_lines_as_tubes": True}
            self._add(cables, colours[used], **light, **style)
        if len(scene.points):
            particles = pyvista.PolyData(positions[scene.points])
            style = {"point_size": _PARTICLE_SIZE * self.zoom, "render_points_as_spheres": True}
            self._add(particles, colours[scene.points], **light, **style)

        if len(scene.squares):
            corners = scene.squares.reshape(-1, 3)
            planes = pyvista.PolyData(corners, faces=np.insert(np.arange(len(corners)).reshape(-1, 4), 0, 4, axis=1))
            colours = np.tile(scene.plane_colour, (len(corners), 1))
            style = {"opacity": _PLANE_OPACITY, "show_edges": True, "edge_color": _EDGE_COLOUR, "edge_opacity": 0.3}
            self._add(planes, colours, lighting=False, **style)

    def _add(self, shape: Any, colours: NDArray[np.uint8], **style: Any) -> None:
        """Add a shape with colours of its points or cells."""
        self.plotter.subplot(*self.place)
        self.plotter.add_mesh(shape, scalars=colours, rgb=True, reset_camera=False, **style)

    def _colours_by_toi(self, vertex_toi: NDArray[np.float64], toi_range: tuple[float, float]) -> NDArray[np.uint8]:
        """Colour of each vertex by its toi, or pale where it has none, shape [V, 3]."""
        is_hit = np.isfinite(vertex_toi)
        colours = self.scene.pale_colours.copy()
        colours[is_hit] = _mapped(vertex_toi[is_hit], toi_range)
        return colours

    def _colours_of_faces(self, faces: NDArray[np.int32], toi_range: tuple[float, float]) -> NDArray[np.uint8]:
        """One colour for each face, by the earliest toi of its corners unless its body is static, shape [m, 3]."""
        scene = self.scene
        colours = scene.pale_colours[faces[:, 0]]
        toi = scene.vertex_toi[faces].min(axis=1)
        is_shown = np.isfinite(toi) & ~scene.static[scene.vertex_body[faces[:, 0]]]
        colours[is_shown] = _mapped(toi[is_shown], toi_range)
        return colours

    def draw_trails(self) -> None:
        """Draw the paths of bodies that move far."""
        paths = self.scene.trails
        if paths:
            first = np.cumsum([0, *map(len, paths[:-1])])
            lines = [[len(path), *range(k, k + len(path))] for path, k in zip(paths, first.tolist(), strict=True)]
            trails = pyvista.PolyData(np.concatenate(paths), lines=np.concatenate(lines))
            self.renderer.add_actor(
                _flat_actor(trails, _LINE_COLOUR, line_width=_TRAIL_WIDTH * self.zoom), reset_camera=False
            )

    def draw_contacts(self) -> None:
        """Draw the earliest contacts with their normals, and later ones fainter; nothing hides them."""
        scene, front, zoom = self.scene, self._front(), self.zoom
        is_first = scene.contact_is_first
        if not is_first.all():
            later = pyvista.PolyData(scene.contact_points[~is_first])
            front.AddActor(_flat_actor(later, _LATER_COLOUR, opacity=_LATER_OPACITY, point_size=_LATER_SIZE * zoom))
        points, normals = scene.contact_points[is_first], scene.contact_normals[is_first]
        if len(points):
            front.AddActor(_flat_actor(pyvista.PolyData(points), _FIRST_COLOUR, point_size=_FIRST_SIZE * zoom))
        has_normal = normals.any(axis=1)
        if has_normal.any():
            tails = pyvista.PolyData(points[has_normal])
            tails["normal"] = normals[has_normal]
            arrow = pyvista.Arrow(tip_length=0.3, tip_radius=0.09, shaft_radius=0.025, scale=_ARROW_LENGTH * self.pixel)
            front.AddActor(_flat_actor(tails.glyph(orient="normal", scale=False, geom=arrow), _FIRST_COLOUR))

    def draw_crossings(self) -> None:
        """Mark where surfaces cross at the start; nothing hides them."""
        points = self.scene.crossing_points
        if len(points):
            marks = _flat_actor(pyvista.PolyData(points), CROSSING_COLOUR, point_size=_CROSSING_SIZE * self.zoom)
            self._front().AddActor(marks)

    def _front(self) -> Any:
        """A renderer in front of all others of the panel."""
        window, front, behind = self.plotter.render_window, vtkRenderer(), self.renderer
        front.SetLayer(window.GetNumberOfLayers())
        window.SetNumberOfLayers(front.GetLayer() + 1)
        front.SetViewport(*behind.GetViewport())
        front.SetActiveCamera(behind.GetActiveCamera())
        window.AddRenderer(front)
        return front

    def write_title(self, text: str) -> None:
        """Write a line on top."""
        self._write(text, 0.93, _TITLE_SIZE)

    def draw_legend(self) -> None:
        """Name the bodies by their colours, below the scene: which move, and which are static."""
        entries = [[text, (_SHADED * colour / 255.0).tolist()] for colour, text in self.scene.legend]
        if entries:
            self.plotter.subplot(*self.place)
            size = _LEGEND_WIDTH, _LEGEND_LINE * len(entries) / self.size[1]
            style: dict[str, Any] = {"face": "rectangle", "loc": "lower left", "font_family": "arial"}
            self.plotter.add_legend(entries, bcolor=None, size=size, **style).SetPadding(round(_LEGEND_GAP * self.zoom))

    def draw_toi_bar(self, toi_range: tuple[float, float]) -> None:
        """Draw the colour bar of the bodies that are coloured by toi."""
        mapper = pyvista.DataSetMapper(pyvista.PolyData())
        mapper.lookup_table = pyvista.LookupTable(_toi_colours(), n_values=256, scalar_range=toi_range)
        mapper.scalar_range = toi_range
        self.plotter.subplot(*self.place)
        self.plotter.add_scalar_bar(
            mapper=mapper,
            n_labels=3,
            vertical=False,
            position_x=0.22,
            position_y=0.015,
            width=0.56,
            height=0.075,
            label_font_size=round(_LABEL_SIZE * self.zoom),
            unconstrained_font_size=True,
            color=_TEXT_COLOUR,
            fmt="%.4g",
        )
        self._write("toi of the vertices", 0.1, _LABEL_SIZE)

    def _write(self, text: str, height: float, size: float) -> None:
        """Write a text in the middle, at a height in fractions of the panel."""
        actor = pyvista.Text(text=text, position=(0.5, height))
        actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
        actor.prop.font_size, actor.prop.color = round(size * self.zoom), _TEXT_COLOUR
        actor.prop.font_family, actor.prop.justification_horizontal = "arial", "center"
        self.renderer.AddActor(actor)


def see(panels: Sequence[Panel], towards: NDArray[np.float64]) -> None:
    """See the whole motion in all panels, in one parallel view towards the viewer; z is up, or y in a view along z."""
    axis = np.array([0.0, 0.0, 1.0] if np.hypot(*towards[:2]) > 1e-6 else [0.0, 1.0, 0.0])
    right = np.cross(axis, towards) / np.linalg.norm(np.cross(axis, towards))
    across = np.array([right, np.cross(towards, right)])
    shown = np.concatenate(panels[0].scene.ends) @ across.T
    middle, half = 0.5 * (shown.min(axis=0) + shown.max(axis=0)), np.maximum(0.5 * np.ptp(shown, axis=0), _LEAST_HALF)
    width, height = panels[0].size
    panels[0].plotter.link_views()
    camera = panels[0].renderer.camera
    camera.parallel_projection = True
    camera.parallel_scale = (half / [_WIDTH * width / height, _HEIGHT]).max()
    camera.focal_point = (middle - [0.0, _RAISED * camera.parallel_scale]) @ across
    camera.position, camera.up = camera.focal_point + 10.0 * towards, across[1]
    camera.clipping_range = 1.0, 20.0
    for panel in panels:
        panel.renderer.camera.is_set = True  # PyVista would fit its own view


def _flat_actor(
    shape: Any, colour: str, *, opacity: float = 1.0, point_size: float = 1.0, line_width: float = 1.0
) -> Any:
    """An actor in one colour without light; points are round."""
    actor = pyvista.Actor(mapper=pyvista.DataSetMapper(shape))
    actor.mapper.scalar_visibility = False
    prop = actor.prop
    prop.color, prop.opacity, prop.lighting = colour, opacity, False
    prop.point_size, prop.line_width, prop.render_points_as_spheres = point_size, line_width, True
    return actor


def _used_vertices(primitives: NDArray[np.int32]) -> tuple[NDArray[np.int32], Any]:
    """Vertices of some primitives, and the primitives in terms of these."""
    used, indices = np.unique(primitives, return_inverse=True)
    return used, indices.reshape(primitives.shape)


def _mapped(toi: NDArray[np.float64], toi_range: tuple[float, float]) -> NDArray[np.uint8]:
    """Colours of finite toi, shape [m, 3]."""
    low, high = toi_range
    share = np.clip((toi - low) / (high - low), 0.0, 1.0)
    return _toi_colours()(share, bytes=True)[:, :3]


def _toi_colours() -> Any:
    """A colour map from dark to light, never as light as the colours of vertices without a toi."""
    return LinearSegmentedColormap.from_list("toi", matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, 256)))
