"""The meshes of files of cells: polygons and volumes, or else curves and points, displaced by a field."""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ccd_warp._files.content import NO_EDGES, NO_INDICES, Mesh, check_part, elements_of
from ccd_warp._files.opened import not_installed
from ccd_warp._files.polygons import fan
from ccd_warp._scene.input.cells import by_corners, surface_of
from ccd_warp._scene.input.messages import InputError, printable, reason_of

# The cells of a type as a library calls them, their corners, and which cells these are, shape [n].
Block = tuple[str, np.ndarray, np.ndarray]
_LONGEST_REASON = 200  # characters of a parser's message, which may hold bytes of the file
_CORNERS = {
    **{"vertex": 1, "line": 2, "triangle": 3, "quad": 4, "pixel": 4, "tetra": 4},
    **{"pyramid": 5, "wedge": 6, "hexahedron": 8, "voxel": 8},
}
_LEAST_CORNERS = {"poly_vertex": 1, "poly_line": 2, "polygon": 3, "strip": 3}
_ORDERS = {"pixel": [0, 1, 3, 2], "voxel": [0, 1, 3, 2, 4, 5, 7, 6]}  # in which they are quads and hexahedra
_QUADRATIC = {  # which quadratic ones cells of so many nodes are, or begin as
    **{("triangle", 6): "triangle6", ("triangle", 7): "triangle6", ("quad", 8): "quad8", ("quad", 9): "quad8"},
    **{("tetra", 10): "tetra10", ("wedge", 15): "wedge15", ("wedge", 18): "wedge15"},
    **{("hexahedron", size): "hexahedron20" for size in (20, 24, 27)},
    **{("pyramid", size): "pyramid13" for size in (13, 14, 19)},
}


class Grid(NamedTuple):
    """What a file of cells holds.

    Attributes:
        points: Positions, shape [n, 2 or 3].
        corners: Those of all polygons, one polygon after another.
        counts: Number of corners of each.
        volumes: Corners of volumes, by type.
        edges: Those of curves, shape [k, 2].
        lone: Points that are cells.
        midsides: Of quadratic cells the ends and the node of each edge, shape [e, 3].
        num_bent: Number of cells of a higher order.
        fields: Values at the points, by name; None of those that were not asked for.
        num_pieces: Number of pieces, each of which has its own points.
    """

    points: np.ndarray
    corners: np.ndarray
    counts: np.ndarray
    volumes: dict[str, np.ndarray]
    edges: np.ndarray
    lone: np.ndarray
    midsides: np.ndarray
    num_bent: int
    fields: Mapping[str, Any]
    num_pieces: int


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what goes wrong in a damaged file into an InputError: parsers of XML, HDF5 and numbers raise anything."""
    try:
        yield
    except Exception as error:
        if str(error).startswith(f"{path}"):
            raise
        reason = printable(reason_of(error))
        if isinstance(error, KeyError) and " " not in str(key := error.args[0]):  # a type of cells, or an attribute
            reason = printable(f"its reader knows no {key.item() if isinstance(key, np.generic) else key!r}")
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
        raise not_installed(error.name) from error
    return meshio


def grid_of_meshio(mesh: Any) -> Grid:
    """What meshio has read."""
    ends = np.cumsum([0, *(len(block.data) for block in mesh.cells)])
    blocks = [
        (block.type.lower().removeprefix("vtk_lagrange_"), np.asarray(block.data, dtype=np.int64), np.arange(a, b))
        for block, a, b in zip(mesh.cells, ends, ends[1:], strict=False)
    ]
    return grid_of(np.asarray(mesh.points), blocks, mesh.point_data)


def grid_of(points: np.ndarray, blocks: Iterable[Block], fields: Mapping[str, Any], num_pieces: int = 1) -> Grid:
    """Cells sorted by what they are; a name that ends with a number is that of cells of a higher order.

    Raises:
        InputError: If a type of cells is not known, or has another number of corners.
    """
    shells: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros((0, 3), dtype=np.int64), NO_INDICES)]
    volumes: dict[str, list[np.ndarray]] = {}
    edges, lone, midsides, num_bent = [NO_EDGES], [NO_INDICES], [np.zeros((0, 3), dtype=np.int64)], 0
    for name, rows, numbers in blocks:
        base, size = re.sub(r"\d+$", "", name), rows.shape[1]
        count = _CORNERS.get(base) or max(size, _LEAST_CORNERS.get(base, size))
        if base not in (*_CORNERS, *_LEAST_CORNERS):
            raise InputError(
                f"cell {numbers[0]} is of the type {name}, which is not read; save triangles or tetrahedra"
            )
        if size < count or (size > count and base == name):
            raise InputError(f"cell {numbers[0]} is a {name} of {size} corners; expected {count}: it is damaged")
        if quadratic := _QUADRATIC.get((base, size)):  # cells with nodes on faces begin with those of their kin
            kin = rows[:, : int(quadratic.removeprefix(base))]
            midsides.append(by_corners([(quadratic, kin)], "cells", len(points))[1])
        num_bent += len(rows) * (size > count and not quadratic)
        rows = rows[:, _ORDERS.get(base, slice(count))]
        if base == "strip":  # in which every other triangle is the other way round
            k = np.arange(size - 2)
            rows = rows[:, np.stack([k, k + 1 + k % 2, k + 2 - k % 2], axis=1)].reshape(-1, 3)
            shells.append((rows, np.repeat(numbers, size - 2)))
        elif base in ("line", "poly_line"):
            edges.append(np.stack([rows[:, :-1], rows[:, 1:]], axis=2).reshape(-1, 2))
        elif base in ("vertex", "poly_vertex"):
            lone.append(rows.ravel())
        elif base in ("triangle", "quad", "pixel", "polygon"):
            shells.append((rows, numbers))
        else:
            volumes.setdefault(base.replace("voxel", "hexahedron"), []).append(rows)
    counts = np.concatenate([np.full(len(rows), rows.shape[1]) for rows, _ in shells])
    corners, begins = np.concatenate([rows.ravel() for rows, _ in shells]), np.cumsum(counts) - counts
    order = np.argsort(np.concatenate([numbers for _, numbers in shells]), kind="stable")
    counts, begins = counts[order], begins[order]
    at = np.arange(counts.sum()) + np.repeat(begins - (np.cumsum(counts) - counts), counts)
    of_kind = {kind: np.concatenate(rows) for kind, rows in volumes.items()}
    all_edges, all_lone, all_midsides = (np.concatenate(rows) for rows in (edges, lone, midsides))
    return Grid(points, corners[at], counts, of_kind, all_edges, all_lone, all_midsides, num_bent, fields, num_pieces)


def mesh_of_grid(path: Path, grid: Grid, displacement: str | None, surface: bool) -> Mesh:
    """The mesh of a file; messages call it ``path``.

    Polygons and the boundary surface of volumes; where there are none of both, curves and points.
    """
    vertices, fans, notes = _displaced(grid, displacement), fan(grid.corners, grid.counts), []
    edges, points = grid.edges, np.unique(grid.lone)
    if grid.volumes and not surface and not len(fans):
        raise InputError(
            f"holds cells of the type {next(iter(grid.volumes))}; expected triangles and polygons; --surface, in "
            "Python surface=True, takes the boundary surface"
        )
    if len(fans) or grid.volumes:
        others = [f"{len(rows)} {noun}" for rows, noun in ((edges, "edges of curves"), (points, "points")) if len(rows)]
        notes += [f"{' and '.join(others)} beside its faces and cells are left out"] if others else []
        edges, points = NO_EDGES, NO_INDICES
    elif len(points) and len(np.setdiff1d(np.arange(len(vertices)), [*edges.ravel(), *points])):
        raise InputError("has points in no cell beside those that are one; expected all as cells, or none")
    if grid.num_bent:
        notes.append(
            f"{grid.num_bent} cells of a higher order collide by their corners alone; divide them where they bend"
        )
    rows = [elements_of(fans, edges, points), *(row.reshape(-1, 1)[:, [0, 0, 0]] for row in grid.volumes.values())]
    check_part(vertices, np.concatenate(rows))
    return Mesh(
        path,
        vertices,
        fans,
        grid.num_pieces > 1,
        is_surface=len(grid.volumes) > 0 or len(grid.midsides) > 0,
        volumes=grid.volumes,
        midsides=grid.midsides,
        counts=grid.counts if (grid.counts > 3).any() else None,
        edges=edges,
        points=points,
        notes=notes,
    )


def with_boundary(
    vertices: np.ndarray, faces: np.ndarray, counts: np.ndarray | None, volumes: Mapping[str, np.ndarray]
) -> np.ndarray:
    """The triangles of the boundary surface of volumes, turned outward, and of polygons that are no side of one.

    Args:
        vertices: Positions.
        faces: Triangles of the polygons.
        counts: Number of corners of each polygon; None where all are triangles.
        volumes: Corners of volumes by type.
    """
    counts = np.full(len(faces), 3) if counts is None else counts
    is_half = np.repeat(counts, counts - 2) == 4
    # Of a quadrilateral a, b, c, d with the diagonal from a to c one half begins with a, b and c.
    one, two = faces[is_half].reshape(-1, 2, 3).swapaxes(0, 1)
    is_same = one[:, :, None] == two[:, None, :]
    turn = (np.argmin(is_same.any(axis=2), axis=1)[:, None] + [2, 0, 1]) % 3
    last = np.take_along_axis(two, np.argmin(is_same.any(axis=1), axis=1)[:, None], axis=1)
    quads = np.concatenate([np.take_along_axis(one, turn, axis=1), last], axis=1)
    return surface_of(
        [*volumes.items(), ("triangle", faces[~is_half]), ("quad", quads)], "cells", len(vertices), vertices
    )


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
    vectors = np.asarray(grid.fields[displacement], dtype=np.float64)
    if vectors.shape != vertices.shape:
        raise InputError(f"the field {displacement!r} has shape {vectors.shape}; expected {vertices.shape}, as points")
    return vertices + vectors
