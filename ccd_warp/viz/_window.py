"""PyVista, and a way to draw without a display."""

import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Pixels that are rendered for each pixel of a picture, along one side.
ZOOM = 2
_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"
_EGL, _OSMESA, _X = "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkXOpenGLRenderWindow"
_PROBE = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkRenderer
window = vtkRenderWindow()
window.OffScreenRenderingOn()
window.AddRenderer(vtkRenderer())
window.Render()
"""


def import_pyvista() -> Any:
    """The module ``pyvista``.

    Raises:
        ImportError: If it is not installed.
    """
    try:
        return importlib.import_module("pyvista")
    except ModuleNotFoundError as error:
        raise ImportError("ccd_warp.viz needs pyvista; install with: pip install 'ccd-warp[viz]'") from error


@contextmanager
def drawing_without_display() -> Iterator[Any]:
    """PyVista, set up to draw without a display and without messages on stderr.

    Raises:
        ImportError: If PyVista is not installed.
        RuntimeError: If the system has no OpenGL that works without a display.
    """
    pyvista = import_pyvista()
    from vtkmodules.vtkCommonCore import vtkObject

    warnings, user_choice = vtkObject.GetGlobalWarningDisplay(), os.environ.get(_CHOICE)
    vtkObject.GlobalWarningDisplayOff()
    try:
        window = user_choice or _window_without_display()
        if window is not None:
            os.environ[_CHOICE] = window
        yield pyvista
    finally:
        vtkObject.SetGlobalWarningDisplay(warnings)
        if user_choice is None:
            os.environ.pop(_CHOICE, None)


def drawn(size: tuple[int, int], num_panels: int, draw: Callable[[Any], None]) -> NDArray[np.uint8]:
    """An image of panels side by side, each pixel of which is the mean of ``ZOOM``² that are rendered.

    That is smoother than the multisampling of OpenGL, and unlike VTK's own supersampling it takes renderers that lie
    above one another.

    Args:
        size: Width and height in pixels.
        num_panels: Number of panels.
        draw: Called with a plotter of PyVista without lights.

    Returns:
        Red, green and blue, uint8, shape [height, width, 3].

    Raises:
        ImportError: If PyVista is not installed.
        RuntimeError: If the system has no OpenGL that works without a display.
    """
    width, height = size
    with drawing_without_display() as pyvista:
        plotter = pyvista.Plotter(
            off_screen=True,
            shape=(1, num_panels),
            window_size=(ZOOM * width, ZOOM * height),
            border=False,
            lighting="none",
            theme=pyvista.themes.DocumentTheme(),
        )
        try:
            draw(plotter)
            plotter.render()
            image = plotter.screenshot(return_img=True)
        finally:
            plotter.close()
    pixels = image.reshape(height, ZOOM, width, ZOOM, 3).mean(axis=(1, 3))
    return (pixels + 0.5).astype(np.uint8)


@cache
def _window_without_display() -> str | None:
    """VTK's class of a window that works, or None for VTK's default.

    VTK tries X first and falls back to EGL and then to OSMesa, but crashes where one of these libraries is missing.
    """
    if not sys.platform.startswith("linux"):
        return None
    from vtkmodules import vtkRenderingOpenGL2  # noqa: F401  # registers the classes
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    os.environ[_CHOICE] = _EGL
    try:
        if vtkRenderWindow().GetClassName() == _EGL:
            return _EGL
    finally:
        del os.environ[_CHOICE]
    for window in (_OSMESA, _X) if os.environ.get("DISPLAY") else (_OSMESA,):
        probe = [sys.executable, "-c", _PROBE]
        if subprocess.run(probe, env=os.environ | {_CHOICE: window}, capture_output=True, check=False).returncode == 0:
            return window
    raise RuntimeError(
        "found no OpenGL to draw with; a library with EGL or OSMesa is needed, on Debian and Ubuntu: "
        "apt-get install libegl1 libgl1-mesa-dri"
    )
