"""How the examples draw: key frames side by side, one row for each run of a scene. It needs the extra ``viz``."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ccd_warp.viz import drawing_without_display


def draw_rows(
    path: Path,
    rows: Sequence[Sequence[tuple[str, Any]]],
    add: Callable[[Any, Any, Any], None],
    camera: list[tuple[float, float, float]],
    size: tuple[int, int] = (360, 300),
) -> None:
    """Draw key frames in rows.

    Args:
        path: The PNG to write; its folder is made if need be.
        rows: The key frames of each run: a caption and a state.
        add: Called with PyVista, a plotter and a state; adds the meshes of the state to the plotter.
        camera: Its place, what it looks at, and the direction up.
        size: Width and height of a key frame in pixels.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = len(rows), max(len(row) for row in rows)
    with drawing_without_display() as pyvista:
        window = shape[1] * size[0], shape[0] * size[1]
        plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=window, border=False)
        plotter.enable_anti_aliasing("ssaa")
        for i, row in enumerate(rows):
            for j, (caption, state) in enumerate(row):
                plotter.subplot(i, j)
                add(pyvista, plotter, state)
                plotter.add_text(caption, position=(8, 8), font_size=8, color="#222222")
                plotter.camera_position = camera
                plotter.background_color = "white"
        image = plotter.screenshot(return_img=True)
        plotter.close()
    from PIL import Image  # a dependency of PyVista

    Image.fromarray(image).quantize(256).save(path, optimize=True)
