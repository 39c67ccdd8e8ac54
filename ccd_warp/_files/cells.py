"""The meshes of VTK and XDMF files: cells as triangles, and positions to which a field of displacements is added."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ccd_warp._input.messages import InputError, reason_of

# Cells of a fixed number of corners, by VTK's number: their names and corners.
VTK_CELLS = {
    **{1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4), 12: ("hexahedron", 8)},
    **{13: ("wedge", 6), 14: ("pyramid", 5), 21: ("line3", 3), 22: ("triangle6", 6), 23: ("quad8", 8)},
    **{24: ("tetra10", 10), 25: ("hexahedron20", 20)},
}
Blocks = list[tuple[str, Any]]


class Grid(NamedTuple):
    """Points, cells of one type in each block, and fields at points and of cells, which are read when called."""

    points: np.ndarray
    blocks: Blocks
    fields: Mapping[str, Callable[[], np.ndarray]]
    cell_fields: Mapping[str, Callable[[], np.ndarray]]


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what goes wrong in a damaged file into an InputError: parsers of XML, HDF5 and numbers raise anything."""
    try:
        yield
    except Exception as error:
        if str(error).startswith(f"{path}"):
            raise
        reason = reason_of(error)
        if not isinstance(error, InputError):
            reason = f"cannot be read ({reason}); write it again, or save it as PLY"
        raise InputError(f"{path}: {reason}") from error


def vtk_blocks(types: np.ndarray, ends: np.ndarray, corners: np.ndarray) -> Blocks:
    """The cells of VTK in blocks.

    Args:
        types: VTK's number of the type of each cell, shape [n].
        ends: Where the corners of each cell end, shape [n].
        corners: The corners of all cells, one cell after another.

    Raises:
        InputError: If a cell has other corners than its type, or a type is not known.
    """
    begins = np.append(0, ends[:-1])
    blocks: Blocks = []
    first = np.flatnonzero(np.append(True, types[1:] != types[:-1])) if len(types) else np.zeros(0, dtype=np.int64)
    for begin, end in zip(first.tolist(), [*first[1:].tolist(), len(types)], strict=True):
        if int(types[begin]) not in VTK_CELLS:
            raise InputError(f"cell {begin} is of VTK's type {types[begin]}, which is not read; save triangles")
        name, count = VTK_CELLS[int(types[begin])]
        bad = np.flatnonzero(ends[begin:end] - begins[begin:end] != count)
        if bad.size:
            k = begin + int(bad[0])
            raise InputError(f"cell {k} is a {name} of {ends[k] - begins[k]} corners; expected {count}: it is damaged")
        cells = corners[begins[begin] : ends[end - 1]].reshape(-1, count)
        # VTK's wedge is the mirror image of everybody else's.
        blocks.append((name, cells[:, [0, 2, 1, 3, 5, 4]] if name == "wedge" else cells))
    if len(corners) != (ends[-1] if len(ends) else 0):
        raise InputError(f"its cells have {len(corners)} corners, and their offsets end elsewhere; it is damaged")
    return blocks


def triangles(path: Path, grid: Grid, surface: bool) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all cells, in their order; of volumes those of their boundary surface, before the others.

    And of quadratic cells, which are taken by their corners, the ends and the node of each edge.
    """
    from ccd_warp._input.cells import SHELLS, VOLUMES, by_corners, surface_of

    for kind, _ in grid.blocks:
        if kind not in (*SHELLS, *(VOLUMES if surface else ())):
            advice = "; --surface, in Python surface=True, takes the boundary surface" if kind in VOLUMES else ""
            raise InputError(f"{path}: holds cells of the type {kind}; expected triangles and quads{advice}")
    try:
        cells, midsides = by_corners(grid.blocks, "cells", len(grid.points))
        return surface_of(cells, "cells", len(grid.points)), midsides
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def displaced(path: Path, grid: Grid, displacement: str | None) -> np.ndarray:
    """Positions in float64, with the displacements of this name added if one is given."""
    vertices = np.array(grid.points, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{path}: its points have shape {vertices.shape}; expected (n, 3)")
    if displacement is None:
        return vertices
    if displacement not in grid.fields:
        found = ", ".join(map(repr, grid.fields)) or "none"
        raise InputError(f"{path}: has no field {displacement!r} at its points; expected one of them: {found}")
    vectors = np.asarray(grid.fields[displacement](), dtype=np.float64)
    if vectors.shape != vertices.shape:
        raise InputError(
            f"{path}: the field {displacement!r} has shape {vectors.shape}; expected {vertices.shape}, like the points"
        )
    return vertices + vectors
