"""The parts of one mesh file, each a body of its own: groups of cells, or what hangs together."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ccd_warp._files.cells import Grid
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.messages import InputError, warn

_MOST_NAMES = 3  # of the groups of a part, in its name
# Whether files are split by connected component, or the name of the field of cells by which.
Split = bool | str


class Parts(NamedTuple):
    """The parts of a file, or of a body in it.

    Attributes:
        of_vertex: The part of each vertex, -1 for one of no cell, shape [n].
        names: What each part is called.
        is_suffix: Whether the name of the body comes before that.
    """

    of_vertex: np.ndarray
    names: list[str]
    is_suffix: bool = False


def check_split(split: Any) -> Split:
    """True, False or the name of a field, or a ValueError."""
    if not isinstance(split, (bool, np.bool_, str)) or split == "":
        raise ValueError(f"split is {shown(split)}; expected True, False or the name of a field of cells")
    return split if isinstance(split, str) else bool(split)


def components(cells: Sequence[np.ndarray], num_vertices: int) -> Parts:
    """What hangs together, in the order of the cells, with the names #0, #1 and so on behind that of the body.

    Args:
        cells: Vertices of the cells, shape [m, k] for each of some types.
        num_vertices: Number of vertices.
    """
    part, of_vertex = _numbered(cells, num_vertices)
    return Parts(of_vertex, [f"#{k}" for k in range(int(part.max(initial=-1)) + 1)], is_suffix=True)


def groups(names: Sequence[str], group: np.ndarray, cells: Sequence[np.ndarray], num_vertices: int) -> Parts:
    """Groups of cells, of which ``group`` has the index of each; those that share a vertex are one part."""
    part, of_vertex = _numbered(cells, num_vertices, group)
    found: list[list[str]] = [[] for _ in range(int(part.max(initial=-1)) + 1)]
    for number, first in zip(*(each.tolist() for each in np.unique(group, return_index=True)), strict=True):
        found[part[first]].append(names[number])
    return Parts(of_vertex, [_joined(each) for each in found])


def groups_of_field(field: str, values: np.ndarray, cells: Sequence[np.ndarray], num_vertices: int) -> Parts:
    """The cells of each value of a field as a group, called by both, or by a value that is a text.

    Raises:
        InputError: If there is no number or text for each cell.
    """
    values, count = np.asarray(values), sum(map(len, cells))
    is_text = values.dtype.kind == "U"
    if values.shape != (count,) or not (is_text or (values.dtype.kind in "biuf" and np.isfinite(values).all())):
        raise InputError(
            f"the field {field!r} is {values.dtype} of shape {values.shape}; expected a finite number for each of the "
            f"{count} cells"
        )
    distinct, group = np.unique(values, return_inverse=True)
    style = {"U": "{value}", "f": "{field} {value:.15g}"}.get(values.dtype.kind, "{field} {value}")
    names = [style.format(field=field, value=value) for value in distinct.tolist()]
    parts = groups(names, group.reshape(-1), cells, num_vertices)
    if len(parts.names) == 1 < len(names):
        warn(f"the cells of all {len(names)} values of the field {field!r} hang together by shared vertices; one body")
    return parts


def parts_of(grid: Grid, split: Split, *, needs_field: bool) -> Parts | None:
    """The parts into which the cells are to be split; None where they are not."""
    cells = [corners for _, corners in grid.blocks]
    if isinstance(split, str) and split in grid.cell_fields:
        return groups_of_field(split, grid.cell_fields[split](), cells, len(grid.points))
    if isinstance(split, str) and needs_field:
        found = ", ".join(map(repr, grid.cell_fields)) or "none"
        raise InputError(f"has no field {split!r} of its cells; expected one of them: {found}")
    return components(cells, len(grid.points)) if split is True else None


def _joined(names: Sequence[str]) -> str:
    """The name of a part of several groups: that of their object, or the first ones."""
    distinct = list(dict.fromkeys(filter(None, names)))
    if len(distinct) > 1 and len({name.partition("/")[0] for name in distinct}) == 1:
        return distinct[0].partition("/")[0]
    shown = distinct[:_MOST_NAMES]
    return " + ".join(shown) + (f" + {len(distinct) - len(shown)} more" if len(distinct) > len(shown) else "")


def _numbered(
    cells: Sequence[np.ndarray], num_vertices: int, group: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The part of each cell and of each vertex, -1 where it has no cell; cells of one group are in one part.

    Parts are numbered by the least group in them, without groups by their first cell.
    """
    first = np.concatenate([each[:, 0] for each in cells])
    links = [np.stack([each[:, k], each[:, k + 1]], axis=1) for each in cells for k in range(each.shape[1] - 1)]
    key = np.arange(len(first)) if group is None else group
    if group is not None:
        links.append(np.stack([first, num_vertices + group], axis=1))
    count = num_vertices + (0 if group is None else int(group.max(initial=-1)) + 1)
    root = _roots(count, np.concatenate(links))
    least = np.full(count, len(first) + count)
    np.minimum.at(least, root[first], key)
    roots = np.unique(root[first])
    number = np.full(count, -1)
    number[roots[np.argsort(least[roots], kind="stable")]] = np.arange(len(roots))
    return number[root[first]], number[root[:num_vertices]]


def _roots(count: int, links: np.ndarray) -> np.ndarray:
    """The least node of those with which each is connected, shape [count]."""
    root = np.arange(count)
    while True:
        ends = np.sort(root[links], axis=1)
        links = ends[ends[:, 0] != ends[:, 1]]
        if not len(links):
            return root
        np.minimum.at(root, links[:, 1], links[:, 0])
        while not np.array_equal(further := root[root], root):
            root = further
