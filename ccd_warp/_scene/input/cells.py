"""The boundary surface of volume cells: tetrahedra, hexahedra, wedges and pyramids, mixed with shells."""

import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.arrays import as_array, as_positions, check_finite, validated_indices
from ccd_warp._scene.input.messages import warn
from ccd_warp._scene.input.names import body_label

_Integers = NDArray[np.int64]

# The sides of each cell, outward in the order of VTK's tetrahedron; a triangle repeats its last corner.
_SIDES = {
    "tetra": ((0, 2, 1, 1), (0, 1, 3, 3), (1, 2, 3, 3), (0, 3, 2, 2)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 2, 1, 1), (3, 4, 5, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4, 4), (1, 2, 4, 4), (2, 3, 4, 4), (3, 0, 4, 4)),
}
_SHELLS = {"triangle": ((0, 1, 2, 2),), "quad": ((0, 1, 2, 3),)}
_CORNERS = {"tetra": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5, "triangle": 3, "quad": 4}
# Quadratic cells: the one that their corners form, and the edges in the middle of which the nodes behind these are.
_RING = ((0, 1), (1, 2), (2, 3), (3, 0))
_QUADRATIC = {
    "tetra10": ("tetra", ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))),
    "hexahedron20": (
        "hexahedron",
        (*_RING, *((a + 4, b + 4) for a, b in _RING), *((a, a + 4) for a in range(4))),
    ),
    "triangle6": ("triangle", ((0, 1), (1, 2), (2, 0))),
    "quad8": ("quad", _RING),
    "wedge15": ("wedge", ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))),
    "pyramid13": ("pyramid", (*_RING, *((a, 4) for a in range(4)))),
}
_BY_CORNERS = {_CORNERS[kind]: kind for kind in _SIDES}
_BY_CORNERS |= {10: "tetra10", 13: "pyramid13", 15: "wedge15", 20: "hexahedron20"}
_EXPECTED = f"cells by type, {', '.join(_SIDES)}, {' or '.join(_SHELLS)}, or quadratic {', '.join(_QUADRATIC)}"
# A node is on its edge if it is within so many lengths of this, more than single precision rounds.
_STRAIGHT = 1e-6

# Indices into vertices, by the type of the cells or in an array for each; the last are the blocks of meshio.
Cells = ArrayLike | Mapping[str, ArrayLike] | Sequence[Any]


class _Sides(NamedTuple):
    """The sides of some cells: their corners, shape [n, 4], and which of them are seen from within their cell."""

    corners: _Integers
    is_inward: NDArray[np.bool_]


def cells_by_type(cells: Any) -> dict[str, Any]:
    """Cells by type, from an array, a list of arrays, or what meshio calls ``cells`` or ``cells_dict``.

    Raises:
        ValueError: If they are nothing of this, or the number of columns of an array is that of no volume.
    """
    if isinstance(cells, Mapping):
        return dict(cells)
    is_list = isinstance(cells, (list, tuple)) and not any(map(_is_cell, cells))
    by_type: dict[str, Any] = {}
    for block in cells if is_list else [cells]:
        kind, values = None, block
        if _is_typed(block):
            kind, values = block if isinstance(block, tuple) else (block.type, block.data)
        rows = as_array(values, "cells", "integers and shape (n, corners)")
        if kind is None:
            if rows.ndim != 2 or rows.shape[1] not in _BY_CORNERS:
                counts = ", ".join(f"{count} of a {kind}" for count, kind in sorted(_BY_CORNERS.items()))
                raise ValueError(f"cells has shape {rows.shape}; expected (n, corners) with {counts}, or {_EXPECTED}")
            kind = _BY_CORNERS[rows.shape[1]]
        by_type[kind] = np.concatenate([by_type[kind], rows]) if kind in by_type else rows
    return by_type


def with_surfaces(bodies: list[Any], names: Sequence[str]) -> tuple[list[Any], NDArray[np.bool_]]:
    """Bodies of :meth:`ccd_warp.CollisionMesh.from_arrays` with faces in place of cells, and which had cells."""
    is_of_cells = np.zeros(len(bodies), dtype=bool)
    for b, body in enumerate(bodies):
        if not isinstance(body, HalfSpace) and isinstance(body[1], Mapping):
            label = body_label(b, names)
            vertices = as_positions(body[0], f"vertices of {label}", 3)
            cells, midsides = by_corners(body[1].items(), f"cells of {label}", len(vertices))
            faces = surface_of(cells, f"cells of {label}", len(vertices), vertices)
            if not len(faces):
                raise ValueError(f"cells in place of faces of {body_label(b, names)} are none; expected {_EXPECTED}")
            is_of_none = np.ones(len(vertices), dtype=bool)
            for _, corners in cells:
                is_of_none[np.asarray(corners, dtype=np.int64)] = False
            check_finite(vertices, f"vertices of {label}", but=np.flatnonzero(is_of_none))
            warn_of_midsides(f"cells of {label}", midsides, faces, vertices)
            bodies[b], is_of_cells[b] = (vertices, faces, *body[2:]), True
    return bodies, is_of_cells


def _is_cell(row: object) -> bool:
    """Whether it is the corners of one cell, and not an array of cells."""
    if isinstance(row, (list, tuple)):
        return len(row) > 0 and isinstance(row[0], numbers.Number)
    return getattr(row, "ndim", None) == 1


def _is_typed(block: object) -> bool:
    """Whether cells come with their type, as a pair or as a block of meshio."""
    if isinstance(block, tuple):
        return len(block) == 2 and isinstance(block[0], str)
    return isinstance(getattr(block, "type", None), str) and hasattr(block, "data")


def by_corners(
    cells: Iterable[tuple[str, Any]], label: str, num_vertices: int
) -> tuple[list[tuple[str, Any]], _Integers]:
    """Cells with their types, the quadratic ones by their corners; and the ends of each edge of these, and its node.

    Raises:
        ValueError: If an index of a quadratic cell is not known.
    """
    linear: list[tuple[str, Any]] = []
    midsides = [np.zeros((0, 3), dtype=np.int64)]
    for kind, values in cells:
        if kind in _QUADRATIC:
            kind_of_corners, edges = _QUADRATIC[kind]
            count = _CORNERS[kind_of_corners]
            nodes = validated_indices(values, count + len(edges), num_vertices, f"{label}[{kind!r}]")
            midsides += [nodes[:, [a, b, count + k]] for k, (a, b) in enumerate(edges)]
            kind, values = kind_of_corners, nodes[:, :count]
        linear.append((kind, values))
    return linear, np.concatenate(midsides)


def warn_of_midsides(label: str, midsides: _Integers, faces: _Integers, *frames: NDArray[np.float64]) -> None:
    """Say how far the nodes of quadratic cells lie off the edges of the surface that stands for them.

    Args:
        label: What the message calls the cells.
        midsides: Ends of each edge and its node, shape [k, 3].
        faces: The surface, shape [m, 3].
        frames: Positions at one time or several, shape [n, 3].
    """
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    first, last = np.sort(midsides[:, :2], axis=1).T
    midsides = midsides[np.isin(first << 32 | last, ends[:, 0] << 32 | ends[:, 1])]
    if not len(midsides):
        return
    off, length = np.zeros((2, len(midsides)))
    for vertices in frames:
        with np.errstate(all="ignore"):  # sizes without a square are not those of a mesh
            a, b, node = np.moveaxis(vertices[midsides], 1, 0)
            edge = b - a
            squared = np.einsum("ij,ij->i", edge, edge)
            share = np.clip(np.einsum("ij,ij->i", node - a, edge) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
            off = np.fmax(off, np.linalg.norm(node - a - share[:, None] * edge, axis=1))
            length = np.fmax(length, np.sqrt(squared))
    if (off <= _STRAIGHT * length).all():
        return
    warn(
        f"{label}: quadratic ones collide by their corners, and the nodes in the middle of their edges lie up to "
        f"{off.max():.3g} off these, the longest of which is {length.max():.3g}; where that matters, divide the cells "
        "into linear ones, or give the body a radius"
    )


def surface_of(
    cells: Iterable[tuple[str, Any]], label: str, num_vertices: int, vertices: NDArray[np.float64] | None = None
) -> _Integers:
    """The triangles of the boundary of volumes, and of shells that are no side of a volume.

    A side with four corners is two triangles. It belongs to the boundary if it is a side of one cell alone; a corner
    that a cell repeats, as a hexahedron that has shrunk to a wedge does, counts once.

    Args:
        cells: Cells with their types, in the order of corners of VTK, either way round.
        label: What messages call them.
        num_vertices: Number of vertices.
        vertices: Their positions, by which sides are turned outward, shape [n, 3]; without them they are as in a cell
            that is not mirrored.

    Returns:
        Triangles in the order of cells, volumes before shells, int64, shape [m, 3].

    Raises:
        ValueError: If a type or an index is not known, or two volumes have the same corners, or more
            than two the same side, so that nobody could say what is outside.
    """
    volumes, shells, keys = [], [], []
    for kind, values in cells:
        if kind not in _CORNERS:
            raise ValueError(f"{label} holds the type {shown(kind)}; expected {_EXPECTED}")
        corners = validated_indices(values, _CORNERS[kind], num_vertices, f"{label}[{kind!r}]")
        if kind in _SHELLS:
            shells.append(corners[:, _SHELLS[kind][0]])
            continue
        of_kind = corners[:, _SIDES[kind]]
        is_mirrored = np.zeros(len(corners), dtype=bool) if vertices is None else _is_mirrored(of_kind, vertices)
        volumes.append(_Sides(of_kind.reshape(-1, 4), np.repeat(is_mirrored, len(_SIDES[kind]))))
        keys.append(np.pad(_distinct(corners), ((0, 0), (8 - _CORNERS[kind], 0)), constant_values=-1))
    shell = np.concatenate([*shells, np.zeros((0, 4), dtype=np.int64)])
    if not volumes:
        return _triangles(shell)
    _check_cells_differ(keys, label)
    sides, is_inward = (np.concatenate(parts) for parts in zip(*volumes, strict=True))
    has_area = _distinct(sides)[:, 1] >= 0  # three corners or more, not those of which only an edge is left
    sides, is_inward = sides[has_area], is_inward[has_area]
    number, of_side = _numbered(_distinct(np.concatenate([sides, shell])))
    count = np.bincount(number[: len(sides)], minlength=of_side)
    if count.max(initial=0) > 2:
        k = int(np.argmax(count[number[: len(sides)]] > 2))
        raise ValueError(f"{label} has {count.max()} cells at the side {sides[k].tolist()}; expected at most two")
    is_outer = count[number[: len(sides)]] == 1
    sides[is_inward] = sides[is_inward][:, [0, 3, 2, 1]]
    kept = np.concatenate([sides[is_outer], shell[count[number[len(sides) :]] == 0]])
    return _triangles(kept)


def _triangles(sides: _Integers) -> _Integers:
    """Two triangles of each side, one where the other has all corners, because the side has three or fewer."""
    first, second = sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]
    is_same = first[:, :, None] == second[:, None, :]
    has_second = ~is_same.any(axis=1).all(axis=1)
    has_first = ~is_same.any(axis=2).all(axis=1) | ~has_second
    kept: _Integers = np.stack([first, second], axis=1)[np.stack([has_first, has_second], axis=1)]
    return kept


def _is_mirrored(sides: _Integers, vertices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which cells, given by their sides, shape [n, s, 4], have a negative volume in this order of corners."""
    points = vertices[sides]
    with np.errstate(all="ignore"):
        points = points / (np.abs(points).max(initial=0.0) or 1.0)
        a, b, c, d = np.moveaxis(points - points.mean(axis=(1, 2))[:, None, None], 2, 0)
        volume = np.einsum("nsi,nsi->n", a, np.cross(b, c) + np.cross(c, d))
    mirrored: NDArray[np.bool_] = volume < 0.0
    return mirrored


def _distinct(corners: _Integers) -> _Integers:
    """The corners of each row in ascending order, each once, after as many -1 as are missing."""
    ascending = np.sort(corners, axis=1)
    ascending[:, 1:][ascending[:, 1:] == ascending[:, :-1]] = -1
    ascending.sort(axis=1)
    return ascending


def _numbered(rows: _Integers) -> tuple[_Integers, int]:
    """A number for each row, the same for the same row, and how many there are."""
    rows = (rows[:, ::2] + 1) << 32 | (rows[:, 1::2] + 1)  # two columns in one, which takes half as long to sort
    rows = rows[:, rows.any(axis=0)] if len(rows) else rows
    order = np.lexsort(rows.T)
    number = np.zeros(len(rows), dtype=np.int64)
    number[order[1:]] = np.cumsum((rows[order[1:]] != rows[order[:-1]]).any(axis=1))
    return number, int(number.max(initial=-1)) + 1


def _check_cells_differ(keys: list[_Integers], label: str) -> None:
    rows = np.concatenate(keys)
    number, count = _numbered(rows)
    if count < len(rows):
        twice = rows[np.argmax(np.bincount(number)[number] > 1)]
        raise ValueError(
            f"{label} holds two cells of the vertices {twice[twice >= 0].tolist()}; expected each cell once"
        )
