"""Draw a step at one time into a panel of PyVista."""

from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import pyvista
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D

from ccd_warp.viz._camera import Camera
from ccd_warp.viz._scene import StepScene

_EDGE_COLOUR, LINE_COLOUR, TEXT_COLOUR = "#303030", "#555555", "#222222"
# In pixels.
_READABLE_EDGE, _COARSE_EDGE = 10, 60
_EDGE_WIDTH, _TRAIL_WIDTH, _CABLE_WIDTH, _PARTICLE_SIZE = 1, 1.5, 4, 8
_TITLE_SIZE, LABEL_SIZE = 17, 13
_LEGEND_LEFT, _LEGEND_BELOW, _LEGEND_LINE = 10, 8, 17
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
        camera: Its view, in whose pixels sizes are given.
        zoom: Window pixels for each pixel of the camera, along one side.
    """

    plotter: Any
    place: tuple[int, int]
    scene: StepScene
    camera: Camera
    zoom: float

    @property
    def renderer(self) -> Any:
        """The renderer of the panel, which becomes the active one."""
        self.plotter.subplot(*self.place)
        return self.plotter.renderer

    def set_view(self) -> None:
        """Set up view and lights."""
        renderer = self.renderer
        renderer.background_color = "white"
        add_lights(renderer)
        aim(renderer.camera, self.camera)
        renderer.camera.is_set = True  # PyVista would fit its own view

    def draw_bodies(self, t: float, toi_range: tuple[float, float] | None = None) -> None:
        """Draw surfaces, cables and particles, replacing those drawn before.

        Args:
            t: Time, in [0, 1].
            toi_range: Range of the toi for colouring by the toi of the vertices; by default the colours are those of
                the bodies. On large faces interpolated colours would mean nothing: such a face has one colour, by the
                earliest toi of its corners, and stays grey if its body is static.
        """
        scene, positions = self.scene, self.scene.positions(t)
        colours = scene.vertex_colours if toi_range is None else self._colours_by_toi(scene.vertex_toi, toi_range)
        edge_length = scene.body_edge_length[scene.vertex_body[scene.faces[:, 0]]] / self.camera.pixel
        has_edges, is_coarse = edge_length >= _READABLE_EDGE, edge_length >= _COARSE_EDGE
        is_coarse &= toi_range is not None
        light = _LIGHT_OF_BODIES if toi_range is None else _LIGHT_OF_TOI
        for name, is_drawn in (
            ("faces", ~has_edges),
            ("faces with edges", has_edges & ~is_coarse),
            ("coarse faces", is_coarse),
        ):
            if not is_drawn.any():
                continue
            used, faces = _used_vertices(scene.faces[is_drawn])
            # a deep copy, because VTK would read the array after it is freed
            surface = pyvista.PolyData.from_regular_faces(positions[used], faces, deep=True)
            scalars, preference = colours[used], "point"
            if toi_range is not None and is_drawn is is_coarse:
                scalars, preference = self._colours_of_faces(scene.faces[is_drawn], toi_range), "cell"
            style = {"show_edges": name != "faces", "edge_color": _EDGE_COLOUR, "edge_opacity": 0.3}
            style |= {"line_width": _EDGE_WIDTH * self.zoom, "preference": preference}
            style |= {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": _SHARP}
            self._add(name, surface, scalars, **light, **style)
        if len(scene.segments):
            used, segments = _used_vertices(scene.segments)
            cables = pyvista.PolyData(positions[used], lines=np.insert(segments, 0, 2, axis=1).ravel())
            style = {"line_width": _CABLE_WIDTH * self.zoom, "render_lines_as_tubes": True}
            self._add("cables", cables, colours[used], **light, **style)
        if len(scene.points):
            particles = pyvista.PolyData(positions[scene.points])
            style = {"point_size": _PARTICLE_SIZE * self.zoom, "render_points_as_spheres": True}
            self._add("particles", particles, colours[scene.points], **light, **style)

        if len(scene.squares):
            corners = scene.squares.reshape(-1, 3)
            planes = pyvista.PolyData(corners, faces=np.insert(np.arange(len(corners)).reshape(-1, 4), 0, 4, axis=1))
            colours = np.tile(scene.plane_colour, (len(corners), 1))
            style = {"opacity": _PLANE_OPACITY, "show_edges": True, "edge_color": _EDGE_COLOUR, "edge_opacity": 0.3}
            self._add("half-spaces", planes, colours, lighting=False, **style)

    def _add(self, name: str, shape: Any, colours: NDArray[np.uint8], **style: Any) -> None:
        """Add a shape with colours of its points or cells."""
        self.plotter.subplot(*self.place)
        self.plotter.add_mesh(
            shape, name=f"{name} {self.place}", scalars=colours, rgb=True, reset_camera=False, **style
        )

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
                flat_actor(trails, LINE_COLOUR, line_width=_TRAIL_WIDTH * self.zoom), reset_camera=False
            )

    def write_title(self, text: str) -> None:
        """Write a line on top."""
        write(self.renderer, text, (0.5, 0.93), _TITLE_SIZE * self.zoom, is_centred=True)

    def draw_legend(self) -> None:
        """Name the bodies by their colours, below the scene: which move, and which are static."""
        size, (width, height) = LABEL_SIZE, self.camera.size
        entries = self.scene.legend
        for row, (colour, text) in enumerate(entries):
            x, y = _LEGEND_LEFT / width, (_LEGEND_BELOW + (len(entries) - 1 - row) * _LEGEND_LINE) / height
            box = [
                [x, y, 0],
                [x + size / width, y, 0],
                [x + size / width, y + size / height, 0],
                [x, y + size / height, 0],
            ]
            mapper, coordinate, swatch = vtkPolyDataMapper2D(), vtkCoordinate(), vtkActor2D()
            coordinate.SetCoordinateSystemToNormalizedViewport()
            mapper.SetInputData(pyvista.PolyData(box, faces=[4, 0, 1, 2, 3]))
            mapper.SetTransformCoordinate(coordinate)
            swatch.SetMapper(mapper)
            swatch.GetProperty().SetColor(*(colour / 255.0))
            self.renderer.AddActor(swatch)
            write(self.renderer, text, (x + 1.6 * size / width, y), size * self.zoom)

    def draw_toi_bar(self, toi_range: tuple[float, float]) -> None:
        """Draw the colour bar of the bodies that are coloured by toi."""
        mapper = pyvista.DataSetMapper(pyvista.PolyData())
        mapper.lookup_table = pyvista.LookupTable(_toi_colours(), n_values=256, scalar_range=toi_range)
        mapper.scalar_range = toi_range
        size = LABEL_SIZE * self.zoom
        self.plotter.subplot(*self.place)
        self.plotter.add_scalar_bar(
            mapper=mapper,
            n_labels=3,
            vertical=False,
            position_x=0.22,
            position_y=0.015,
            width=0.56,
            height=0.075,
            label_font_size=round(size),
            unconstrained_font_size=True,
            color=TEXT_COLOUR,
            fmt="%.4g",
        )
        write(self.renderer, "toi of the vertices", (0.5, 0.1), size, is_centred=True)


def aim(view: Any, camera: Camera) -> None:
    """Set a camera of VTK to the given view."""
    view.SetParallelProjection(True)
    view.SetPosition(*camera.position)
    view.SetFocalPoint(*camera.focus)
    view.SetViewUp(*camera.up)
    view.SetParallelScale(camera.parallel_scale)
    view.SetClippingRange(1.0, 20.0)


def add_lights(renderer: Any) -> None:
    """Light a renderer of VTK from behind the viewer."""
    for position, intensity in _LIGHTS:
        renderer.AddLight(pyvista.Light(position=position, light_type="camera light", intensity=intensity))


def flat_actor(
    shape: Any, colour: str, *, opacity: float = 1.0, point_size: float = 1.0, line_width: float = 1.0
) -> Any:
    """An actor in one colour without light; points are round."""
    actor = pyvista.Actor(mapper=pyvista.DataSetMapper(shape))
    actor.mapper.scalar_visibility = False
    prop = actor.prop
    prop.color, prop.opacity, prop.lighting = colour, opacity, False
    prop.point_size, prop.line_width, prop.render_points_as_spheres = point_size, line_width, True
    return actor


def write(
    renderer: Any,
    text: str,
    position: tuple[float, float],
    size: float,
    *,
    is_centred: bool = False,
    is_on_white: bool = False,
) -> None:
    """Write a text at a position in fractions of a renderer."""
    actor = pyvista.Text(text=text, position=position)
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.prop.font_size, actor.prop.color = round(size), TEXT_COLOUR
    actor.prop.font_family = "arial"
    actor.prop.justification_horizontal = "center" if is_centred else "left"
    if is_on_white:
        actor.prop.background_color, actor.prop.background_opacity = "white", 0.8
    renderer.AddActor(actor)


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
