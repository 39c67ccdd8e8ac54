"""The vertices within a few edges of each vertex, or paired with it, for the pairs of primitives that these exclude."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.input.edges import lowest_linked

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

# Vertices whose rings are computed at a time, and the most vertices in all rings: half a gigabyte on the device.
_SOURCES = 256
_MOST_VERTICES = 1 << 27


def excluded_vertices(mesh: "CollisionMesh") -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The begin of each vertex's row, and the rows: the vertices that must not meet it, ascending.

    They are those of ``exclusion_rings``, and the other vertices of its pairs in ``exclude_pairs``.

    Raises:
        ValueError: If the rings hold more than 2²⁷ vertices in all.
    """
    count = mesh.num_vertices
    begin, rows = np.zeros(count + 1, dtype=np.int32), np.zeros(0, dtype=np.int32)
    if mesh.exclusion_rings > 1:
        begin, rows = vertex_rings(mesh)
    if "vertices" in mesh.exclude_pairs:
        a, b = mesh.exclude_pairs["vertices"].astype(np.int64).T
        near = np.repeat(np.arange(count), np.diff(begin)) * count + rows
        keys = np.unique(np.concatenate([near, a * count + b, b * count + a]))
        lengths = np.bincount(keys // count, minlength=count)
        begin, rows = np.append(0, np.cumsum(lengths)).astype(np.int32), (keys % count).astype(np.int32)
    return begin, rows


def vertex_rings(mesh: "CollisionMesh") -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The begin of each vertex's row, and the rows: vertices within ``exclusion_rings - 1`` edges, ascending.

    Raises:
        ValueError: If the rows hold more than 2²⁷ vertices in all.
    """
    if mesh.exclusion_rings >= mesh.num_vertices:  # no two vertices are farther apart
        lengths, rows = _whole_components(mesh)
    else:
        lengths, rows = _walked_rings(mesh)
    begin = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(lengths)])
    return begin.astype(np.int32), rows


def _walked_rings(mesh: "CollisionMesh") -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The length of each row, and the rows, ring by ring."""
    count = mesh.num_vertices
    a, b = mesh.edges.T.astype(np.int64)
    source, target = np.concatenate([a, b]), np.concatenate([b, a])
    order = np.argsort(source, kind="stable")
    target = target[order]
    begin = np.searchsorted(source[order], np.arange(count + 1))
    lengths, rows, total = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int32)], 0
    for first in range(0, count, _SOURCES):
        vertices = np.arange(first, min(first + _SOURCES, count))
        rings = [np.zeros(0, dtype=np.int64), vertices * count + vertices]  # keys (vertex, near vertex)
        total += len(vertices)
        for _ in range(mesh.exclusion_rings - 1):
            vertex, at = np.divmod(rings[-1], count)
            degree = begin[at + 1] - begin[at]
            within = np.arange(degree.sum()) - np.repeat(np.cumsum(degree) - degree, degree)
            reached = np.repeat(vertex, degree) * count + target[np.repeat(begin[at], degree) + within]
            # A neighbour of a ring is in the previous ring, in this one, or in the next. The lowest bit distinguishes
            # reached vertices from known ones, which come first among equals.
            keys = np.concatenate([reached << 1 | 1, rings[-2] << 1, rings[-1] << 1])
            keys.sort()
            is_first = np.ones(len(keys), dtype=bool)
            is_first[1:] = keys[1:] >> 1 != keys[:-1] >> 1
            fresh = keys[is_first & (keys & 1 == 1)] >> 1
            if len(fresh) == 0:
                break  # all reachable vertices are listed
            total += len(fresh)
            _check_total(mesh, total)
            rings.append(fresh)
        near = np.sort(np.concatenate(rings))
        lengths.append(np.bincount(near // count - first, minlength=len(vertices)))
        rows.append((near % count).astype(np.int32))
    return np.concatenate(lengths), np.concatenate(rows)


def _whole_components(mesh: "CollisionMesh") -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The length of each row, and the rows, each of which is a whole connected component."""
    label = lowest_linked(mesh.num_vertices, mesh.edges)
    order = np.argsort(label, kind="stable")
    size = np.bincount(label, minlength=mesh.num_vertices)
    lengths = size[label]
    _check_total(mesh, sum(lengths.tolist()))
    members = np.split(order.astype(np.int32), np.cumsum(size)[:-1])
    return lengths, np.concatenate([np.zeros(0, dtype=np.int32), *(members[k] for k in label)])


def _check_total(mesh: "CollisionMesh", total: int) -> None:
    if total > _MOST_VERTICES:
        raise ValueError(
            f"exclusion_rings is {mesh.exclusion_rings}, which leaves out more than {_MOST_VERTICES} pairs of vertices "
            f"of this mesh; expected a lower number, or self_collision=False where a body is not to touch itself at all"
        )
