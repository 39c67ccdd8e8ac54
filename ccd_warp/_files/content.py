"""What a mesh file holds, whatever its format, and what no file may hold."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ccd_warp._scene.input.messages import InputError


@dataclass(frozen=True)
class Mesh:
    """The content of one file: vertices in double precision, nothing merged or reordered.

    Attributes:
        path: The file.
        vertices: Positions, float64, shape [n, 3].
        faces: Vertex indices, shape [m, 3].
        has_copies: Whether its format stores a vertex several times that several faces share: at each corner (STL), or
            once for each normal, texture coordinate and material (glTF, COLLADA).
        names: Names of its objects, groups and nodes; "" stands for what has none.
        face_name: Index of the name of each face, shape [m]; None where there is one name.
        is_surface: Whether it is the surface of volumes, so that the other vertices are inside them.
        cells: Cells that hang together by the vertices that they share, shape [k, corners] each; None where the faces
            do.
        midsides: Of quadratic cells the ends and the node of each edge, shape [e, 3].
    """

    path: Path
    vertices: np.ndarray
    faces: np.ndarray
    has_copies: bool
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None
    is_surface: bool = False
    cells: Sequence[np.ndarray] | None = None
    midsides: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))


def check_part(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse no faces, faces of vertices that do not exist, and positions of vertices of faces that are not finite."""
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
