"""The bodies of a mesh file, in which vertices are one that its format splits, and their places in other frames."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.content import Mesh
from ccd_warp._files.mesh import read_mesh
from ccd_warp._files.parts import parts_of
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.cells import warn_of_midsides
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.names import distinct_names
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True)
class Body:
    """One body of a scene.

    Attributes:
        name: The name of its file, or of its object, group or node in the file.
        vertices: Positions in the first frame, float64, shape [n, 3].
        faces: Vertex indices within the body, shape [m, 3].
        source_index: Index of each vertex in its file (the first of merged ones), shape [n].
        is_static: True for an obstacle that does not move.
        num_merged: Number of the file's vertices that were merged into others.
        half_space: The half-space that it is in place of a mesh; None of a file.
        is_surface: Whether its faces are the surface of volumes, so that the other vertices are inside them.
    """

    name: str
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    source_index: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    is_static: bool = True
    num_merged: int = 0
    half_space: HalfSpace | None = None
    is_surface: bool = False

    @property
    def arrays(self) -> tuple[Any, ...] | HalfSpace:
        """What :meth:`ccd_warp.CollisionMesh.from_arrays` takes of it: the vertices inside take no part."""
        return self.half_space or (self.vertices, {"triangle": self.faces} if self.is_surface else self.faces)


class FileBodies:
    """The bodies of the first frame of a file, and where their vertices are in other frames of the same topology.

    Copies that a format makes of a vertex are one where they are in the same place, and in one node: those of two nodes
    are two bodies that touch. Without merging, every seam would be in contact with itself at t = 0.

    Attributes:
        bodies: The bodies.
        source_index: Index of each of their vertices in the file, shape [n].
    """

    def __init__(self, first: Mesh, name: str, *, split: bool, is_static: bool = False) -> None:
        self._first = first
        index = np.arange(len(first.vertices))
        merged, vertex = _merge(first) if first.has_copies else (index, index)
        faces, copies = vertex[first.faces], np.bincount(vertex, minlength=len(merged)) - 1
        names, part = parts_of(first, faces, len(merged), name, split=split)
        vertices, of_part = (_by_part(parts, len(names)) for parts in (part, part[faces[:, 0]]))
        local = np.empty(len(merged), dtype=np.int64)
        self.bodies: list[Body] = []
        for body_name, body_vertices, body_faces in zip(names, vertices, of_part, strict=True):
            local[body_vertices] = np.arange(len(body_vertices))
            source_index = merged[body_vertices]
            self.bodies.append(
                Body(
                    body_name,
                    first.vertices[source_index],
                    local[faces[body_faces]],
                    source_index,
                    is_static,
                    int(copies[body_vertices].sum()),
                    is_surface=first.is_surface,
                )
            )
        self.source_index = np.concatenate([body.source_index for body in self.bodies])
        self._copies = np.flatnonzero(merged[vertex] != index)
        self._copied = merged[vertex[self._copies]]

    def positions(self, frame: Mesh) -> np.ndarray:
        """The vertices of all bodies in another frame, shape [n, 3].

        Raises:
            InputError: If it differs in topology, or vertices that are one in the first frame part.
        """
        first = self._first
        for noun in ("vertices", "faces"):
            if len(getattr(first, noun)) != len(getattr(frame, noun)):
                raise InputError(
                    f"topology differs: {first.path} has {len(first.vertices)} vertices and {len(first.faces)} faces, "
                    f"{frame.path} has {len(frame.vertices)} vertices and {len(frame.faces)} faces; "
                    f"both frames need the same {noun} in the same order"
                )
        different = np.flatnonzero((first.faces != frame.faces).any(axis=1))
        if different.size:
            k = int(different[0])
            raise InputError(
                f"topology differs: face {k} is {first.faces[k].tolist()} in {first.path} "
                f"and {frame.faces[k].tolist()} in {frame.path} ({different.size} of {len(first.faces)} faces differ); "
                "both frames need the same faces in the same order"
            )
        torn = np.flatnonzero((frame.vertices[self._copies] != frame.vertices[self._copied]).any(axis=1))
        if torn.size:
            a, b = int(self._copies[torn[0]]), int(self._copied[torn[0]])
            raise InputError(
                f"{frame.path}: vertex {a} leaves vertex {b}, although both are in one place in {first.path}; a format "
                "that stores a vertex several times does not say which ones are one, so save all frames in another, "
                "PLY for example"
            )
        return frame.vertices[self.source_index]


def _merge(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The first of each set of vertices that are one, in order of appearance, and for each vertex the set's number."""
    node = np.zeros((len(mesh.vertices), 1))
    if mesh.face_name is not None:
        node[mesh.faces, 0] = mesh.face_name[:, None]
    # Adding 0.0 turns -0.0 into 0.0, because they are the same position; bits compare what is no number, too.
    rows = (np.hstack([mesh.vertices, node]) + 0.0).view(np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def _by_part(parts: np.ndarray, count: int) -> list[np.ndarray]:
    """The indices that belong to each part, ascending."""
    return np.split(np.argsort(parts, kind="stable"), np.cumsum(np.bincount(parts, minlength=count))[:-1])


def file_bodies(path: Path, *, surface: bool, split: bool, is_static: bool = False) -> list[Body]:
    """The bodies of a file that is read once."""
    mesh = read_mesh(path, surface=surface)
    warn_of_midsides(f"cells of {path.name}", mesh.midsides, mesh.faces, mesh.vertices)
    return FileBodies(mesh, path.name, split=split, is_static=is_static).bodies


def static_bodies(static: Sequence[Path | HalfSpace], *, surface: bool = False, split: bool = False) -> list[Body]:
    """The bodies in mesh files that do not move, and half-spaces."""
    bodies: list[Body] = []
    for item in static:
        if isinstance(item, HalfSpace):
            bodies.append(Body("half-space", half_space=item))
        else:
            bodies += file_bodies(item, surface=surface, split=split, is_static=True)
    return bodies


def mesh_of(bodies: Sequence[Body], **options: Any) -> CollisionMesh:
    """The bodies as one mesh, called by their names, with further options of ``CollisionMesh.from_arrays``."""
    return CollisionMesh.from_arrays(
        [body.arrays for body in bodies],
        static=[b for b, body in enumerate(bodies) if body.is_static],
        names=distinct_names([body.name for body in bodies]),
        **options,
    )
