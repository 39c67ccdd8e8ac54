"""What a mesh file holds, whatever its format, and what no file may hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ccd_warp._scene.input.messages import InputError

NO_INDICES = np.zeros(0, dtype=np.int64)
NO_EDGES = np.zeros((0, 2), dtype=np.int64)


class FilePart(NamedTuple):
    """A part of a file: its positions and elements, the names in it, and the index of the name of each element.

    Elements are faces, then edges, then points; see :class:`Mesh`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    counts: np.ndarray | None = None
    edges: np.ndarray = NO_EDGES
    points: np.ndarray = NO_INDICES
    names: Sequence[str] = ("",)
    element_name: np.ndarray | None = None  # None where there is one name

    @property
    def elements(self) -> np.ndarray:
        """Three vertices of each element, the last one repeated."""
        return elements_of(self.faces, self.edges, self.points)


@dataclass(frozen=True)
class Mesh:
    """The content of one file: vertices in double precision, nothing merged or reordered.

    Attributes:
        path: The file.
        vertices: Positions, float64, shape [n, 3].
        faces: Vertex indices, shape [m, 3]; of polygons their fans.
        has_copies: Whether its format stores a vertex several times that several faces share: at each corner (STL), or
            once for each normal, texture coordinate and material (glTF, COLLADA).
        names: Names of its objects, groups and nodes; "" stands for what has none.
        element_name: Index of the name of each element, shape [m + k + p]; None where there is one name.
        is_surface: Whether it is the surface of volumes, so that the other vertices are inside them.
        midsides: Of quadratic cells the ends and the node of each edge, shape [e, 3].
        counts: Number of corners of each polygon; None where all are triangles.
        edges: Edges of curves, shape [k, 2].
        points: Vertices that are particles, shape [p].
        volumes: Corners of volume cells by type, of which the boundary surface stands for them.
        notes: What is said of it once.
    """

    path: Path
    vertices: np.ndarray
    faces: np.ndarray
    has_copies: bool
    names: Sequence[str] = ("",)
    element_name: np.ndarray | None = None
    is_surface: bool = False
    midsides: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    counts: np.ndarray | None = None
    edges: np.ndarray = field(default_factory=lambda: NO_EDGES)
    points: np.ndarray = field(default_factory=lambda: NO_INDICES)
    volumes: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def elements(self) -> np.ndarray:
        """Three vertices of each element, the last one repeated, shape [m + k + p, 3]."""
        return elements_of(self.faces, self.edges, self.points)


def elements_of(faces: np.ndarray, edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Three vertices of each face, edge and point, the last one repeated."""
    return np.concatenate([faces, edges[:, [0, 1, 1]], points[:, None][:, [0, 0, 0]]])


def check_part(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse no faces, faces of vertices that do not exist, and positions of vertices of faces that are not finite.

    Edges and points are faces here, too, as those of :func:`elements_of`.
    """
    if not len(faces):
        raise InputError("holds no triangles; give a triangle mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        k = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise InputError(f"face {k} is {faces[k].tolist()}, but the file has {len(vertices)} vertices; repair the file")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    bad = bad[np.isin(bad, faces)]
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"vertex {k} is {vertices[k].tolist()} ({bad.size} of {len(vertices)} vertices are not finite); "
            "every coordinate of a face must be finite"
        )
