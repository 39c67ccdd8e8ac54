"""The bodies of one mesh file: its objects, groups and nodes, or what hangs together in them."""

from collections.abc import Sequence

import numpy as np

from ccd_warp._files.content import Mesh
from ccd_warp._scene.input.edges import lowest_linked

_MOST_NAMES = 3  # of the groups of a body, in its name


def parts_of(
    mesh: Mesh, faces: np.ndarray, cells: Sequence[np.ndarray], count: int, name: str, *, split: bool
) -> tuple[list[str], np.ndarray]:
    """The names of the parts of a mesh, and to which of them each vertex belongs.

    Objects, groups and nodes that share a vertex are one part, called by their names; a part that is alone has the name
    of the file. A vertex of no face belongs to the part of the vertex before it.

    Args:
        mesh: The mesh.
        faces: Its elements, three vertices each, of which those that are one are merged.
        cells: What hangs together, shape [k, corners] each, of the same vertices.
        count: Number of these vertices.
        name: Name of the file.
        split: Whether parts are divided into their connected components, with ``#0``, ``#1`` and so on behind the name.
    """
    names, part = [name], np.zeros(count, dtype=np.int64)
    if mesh.element_name is not None:
        names, part = _groups(mesh.names, mesh.element_name, faces, count)
        names = [part_name or name for part_name in names] if len(names) > 1 else [name]
    if split:
        names, part = _components(names, part, cells, count)
    if len(names) == 1:
        return names, np.zeros(count, dtype=np.int64)
    last = np.maximum.accumulate(np.where(part >= 0, np.arange(count), -1))
    return names, part[np.where(last >= 0, last, faces.min())]


def _groups(names: Sequence[str], group: np.ndarray, faces: np.ndarray, count: int) -> tuple[list[str], np.ndarray]:
    """The parts that groups of faces make, by their first group; ``group`` has the index of that of each face."""
    links = np.concatenate([_pairs(faces), np.stack([faces[:, 0], count + group], axis=1)])
    root = lowest_linked(count + len(names), links)
    used, first = np.unique(group, return_index=True)
    roots, by_group = np.unique(root[faces[first, 0]], return_inverse=True)
    order = np.argsort(np.unique(by_group, return_index=True)[1])
    number = np.full(len(root), -1)
    number[roots[order]] = np.arange(len(order))
    names_of_parts: list[list[str]] = [[] for _ in order]
    for k, part in zip(used.tolist(), number[root[faces[first, 0]]].tolist(), strict=True):
        names_of_parts[part].append(names[k])
    return [_joined(part_names) for part_names in names_of_parts], number[root[:count]]


def _components(
    names: Sequence[str], part: np.ndarray, cells: Sequence[np.ndarray], count: int
) -> tuple[list[str], np.ndarray]:
    """The connected components of each part, in the order of its cells."""
    root = lowest_linked(count, np.concatenate([_pairs(block) for block in cells]))
    roots, first = np.unique(root[np.concatenate([block[:, 0] for block in cells])], return_index=True)
    order = np.lexsort((first, part[roots]))
    number = np.full(count, -1)
    number[roots[order]] = np.arange(len(order))
    component_names: list[str] = []
    for name, components in zip(names, np.bincount(part[roots], minlength=len(names)).tolist(), strict=True):
        component_names += [f"{name}#{k}" for k in range(components)] if components > 1 else [name]
    return component_names, number[root]


def _joined(names: Sequence[str]) -> str:
    """The name of a part of several groups: that of their object, or the first ones."""
    distinct = list(dict.fromkeys(filter(None, names)))
    if len(distinct) > 1 and len({name.partition("/")[0] for name in distinct}) == 1:
        return distinct[0].partition("/")[0]
    shown = distinct[:_MOST_NAMES]
    return " + ".join(shown) + (f" + {len(distinct) - len(shown)} more" if len(distinct) > len(shown) else "")


def _pairs(cells: np.ndarray) -> np.ndarray:
    """Vertices of a cell that follow one another, shape [n, 2]."""
    return np.concatenate([cells[:, k : k + 2] for k in range(cells.shape[1] - 1)])
