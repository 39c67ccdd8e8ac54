"""The meshes of VTK and XDMF files: cells as triangles, and positions to which a field of displacements is added."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ccd_warp._files.content import Mesh, check_part
from ccd_warp._scene.input.cells import SHELLS, VOLUMES, by_corners, surface_of
from ccd_warp._scene.input.messages import InputError, printable, reason_of

Blocks = list[tuple[str, Any]]
_LONGEST_REASON = 200  # characters of a parser's message, which may hold bytes of the file


class Grid(NamedTuple):
    """Points, cells of one type in each block, and the fields at points, which are read when called."""

    points: np.ndarray
    blocks: Blocks
    fields: Mapping[str, Callable[[], np.ndarray]]


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what goes wrong in a damaged file into an InputError: parsers of XML, HDF5 and numbers raise anything."""
    try:
        yield
    except Exception as error:
        if str(error).startswith(f"{path}"):
            raise
        reason = printable(reason_of(error))
        if not isinstance(error, InputError):
            shown = reason if len(reason) <= _LONGEST_REASON else f"{reason[:_LONGEST_REASON]}…"
            reason = f"cannot be read ({shown}); write it again, or save it as VTU or PLY"
        raise InputError(f"{path}: {reason}") from error


def load_meshio() -> Any:
    """meshio, and h5py with it; an InputError that says where they come from if one is not installed."""
    try:
        import h5py  # noqa: F401
        import meshio
    except ImportError as error:
        raise InputError(f"{error.name} reads it; install with: pip install 'ccd-warp[formats]'") from error
    return meshio


def mesh_of_grid(path: Path, grid: Grid, displacement: str | None, surface: bool) -> Mesh:
    """The surface of the cells of a file; messages call it ``path``."""
    vertices, (faces, midsides) = _displaced(grid, displacement), _triangles(grid, surface)
    check_part(vertices, faces)
    is_surface, cells = surface or len(midsides) > 0, [corners for _, corners in grid.blocks]
    return Mesh(path, vertices, faces, False, is_surface=is_surface, cells=cells, midsides=midsides)


def _triangles(grid: Grid, surface: bool) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all cells, in their order; of volumes those of their boundary surface, before the others.

    And of quadratic cells, which are taken by their corners, the ends and the node of each edge.
    """
    for kind, _ in grid.blocks:
        if kind not in (*SHELLS, *(VOLUMES if surface else ())):
            advice = "; --surface, in Python surface=True, takes the boundary surface" if kind in VOLUMES else ""
            raise InputError(f"holds cells of the type {kind}; expected triangles and quads{advice}")
    cells, midsides = by_corners(grid.blocks, "cells", len(grid.points))
    return surface_of(cells, "cells", len(grid.points)), midsides


def _displaced(grid: Grid, displacement: str | None) -> np.ndarray:
    """Positions in float64, with the displacements of this name added if one is given."""
    vertices = np.array(grid.points, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"its points have shape {vertices.shape}; expected (n, 3)")
    if displacement is None:
        return vertices
    if displacement not in grid.fields:
        field_names = ", ".join(map(repr, grid.fields)) or "none"
        raise InputError(f"has no field {displacement!r} at its points; expected one of them: {field_names}")
    vectors = np.asarray(grid.fields[displacement](), dtype=np.float64)
    if vectors.shape != vertices.shape:
        raise InputError(f"the field {displacement!r} has shape {vectors.shape}; expected {vertices.shape}, as points")
    return vertices + vectors
