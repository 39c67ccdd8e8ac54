"""Read VTK and XDMF files through meshio (extra ``formats``), as triangles in full precision."""

import contextlib
import importlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._input.messages import InputError

SUFFIXES = (".vtu", ".vtk", ".xdmf", ".xmf")
_MODULES = {".vtu": "vtu", ".vtk": "vtk", ".xdmf": "xdmf", ".xmf": "xdmf"}
_INSTALL = "install with: pip install 'ccd-warp[formats]'"

Part = tuple[np.ndarray, np.ndarray]


def read_through_meshio(path: Path, displacement: str | None = None, surface: bool = False) -> Part:
    """Positions and triangles of one file.

    Args:
        path: A file that ends in one of ``SUFFIXES`` and holds one mesh.
        displacement: Name of the vectors at the points that are added to the positions.
        surface: Whether volume cells stand for their boundary surface.

    Raises:
        InputError: If the file is damaged or holds other cells, or meshio is not installed.
    """
    meshio = import_meshio(path)
    with reading(path):
        reader = getattr(meshio, _MODULES[path.suffix.lower()])
        mesh = reader.read(str(path))
        faces = triangles(path, [(block.type, block.data) for block in mesh.cells], len(mesh.points), surface)
        return displaced(path, mesh.points, mesh.point_data, displacement), faces


def import_meshio(path: Path) -> Any:
    """The module ``meshio``, or an error that says how to install it."""
    try:
        return importlib.import_module("meshio")
    except ImportError as error:
        raise InputError(f"{path}: VTK and XDMF files are read by meshio; {_INSTALL}") from error


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what goes wrong in meshio into an InputError: it raises anything, and prints what it leaves out."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            yield
    except InputError:
        raise
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: its data need {error.name}; {_INSTALL}") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: meshio cannot read it ({reason}); write it again, or save it as PLY") from error
    if said.getvalue().strip():
        reason = " ".join(said.getvalue().split())
        raise InputError(f"{path}: meshio would leave something out ({reason}); save it as PLY")


def triangles(path: Path, blocks: list[tuple[str, Any]], num_points: int, surface: bool) -> np.ndarray:
    """Triangles of all cells, in their order; of volumes those of their boundary surface, before the others."""
    from ccd_warp._input.cells import SHELLS, VOLUMES, surface_of

    cells: list[tuple[str, Any]] = []
    for kind, rows in blocks:
        if kind not in (*SHELLS, *(VOLUMES if surface else ())):
            advice = "; --surface, in Python surface=True, takes the boundary surface" if kind in VOLUMES else ""
            raise InputError(f"{path}: holds cells of the type {kind}; expected triangles and quads{advice}")
        cells.append((kind, rows))
    try:
        return surface_of(cells, "cells", num_points)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def displaced(path: Path, points: Any, point_data: dict[str, Any], displacement: str | None) -> np.ndarray:
    """Positions in float64, with the displacements of this name added if one is given."""
    vertices = np.array(points, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{path}: its points have shape {vertices.shape}; expected (n, 3)")
    if displacement is None:
        return vertices
    if displacement not in point_data:
        found = ", ".join(map(repr, point_data)) or "none"
        raise InputError(f"{path}: has no field {displacement!r} at its points; expected one of them: {found}")
    vectors = np.asarray(point_data[displacement], dtype=np.float64)
    if vectors.shape != vertices.shape:
        raise InputError(
            f"{path}: the field {displacement!r} has shape {vectors.shape}; expected {vertices.shape}, like the points"
        )
    return vertices + vectors
