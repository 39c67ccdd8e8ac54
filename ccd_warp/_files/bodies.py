"""The bodies of a mesh file, in which vertices are one that its format splits, and their places in other frames."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.cells import with_boundary
from ccd_warp._files.content import NO_EDGES, Mesh, elements_of
from ccd_warp._files.mesh import read_mesh
from ccd_warp._files.parts import parts_of
from ccd_warp._files.polygons import triangulated
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.cells import warn_of_midsides
from ccd_warp._scene.input.messages import InputError, warn
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
        edges: Vertex indices of codimensional edges, shape [k, 2].
        has_points: Whether its vertices that no face and no edge uses are codimensional points.
        half_space: The half-space that it is in place of a mesh; None of a file.
        is_surface: Whether its faces are the surface of volumes, so that the other vertices are inside them.
    """

    name: str
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    source_index: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    is_static: bool = True
    num_merged: int = 0
    edges: np.ndarray = field(default_factory=lambda: NO_EDGES)
    has_points: bool = False
    half_space: HalfSpace | None = None
    is_surface: bool = False

    @property
    def arrays(self) -> tuple[Any, ...] | HalfSpace:
        """What :meth:`ccd_warp.CollisionMesh.from_arrays` takes of it: the vertices inside take no part."""
        faces = {"triangle": self.faces} if self.is_surface else self.faces
        return self.half_space or (self.vertices, faces, *([self.edges] if len(self.edges) else []))


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
        faces, edges, copies = vertex[first.faces], vertex[first.edges], np.bincount(vertex, minlength=len(merged)) - 1
        try:
            if first.counts is not None:
                faces = triangulated(first.vertices[merged], faces, first.counts)
            if first.volumes:
                volumes = {kind: vertex[rows] for kind, rows in first.volumes.items()}
                faces = with_boundary(first.vertices[merged], faces, first.counts, volumes)
        except ValueError as error:
            raise InputError(f"{first.path}: {error}") from None
        self._midsides, self._merged, self._faces = vertex[first.midsides], merged, faces
        elements = elements_of(faces, edges, vertex[first.points])
        cells = [vertex[rows] for rows in (first.elements, *first.volumes.values())]
        names, part = parts_of(first, elements, cells, len(merged), name, split=split)
        by_part = (_by_part(parts, len(names)) for parts in (part, part[faces[:, 0]], part[edges[:, 0]]))
        has_points = np.bincount(part[vertex[first.points]], minlength=len(names)) > 0
        local = np.empty(len(merged), dtype=np.int64)
        self.bodies: list[Body] = []
        for k, (body_vertices, body_faces, body_edges) in enumerate(zip(*by_part, strict=True)):
            local[body_vertices] = np.arange(len(body_vertices))
            source_index = merged[body_vertices]
            self.bodies.append(
                Body(
                    names[k],
                    first.vertices[source_index],
                    local[faces[body_faces]],
                    source_index,
                    is_static,
                    int(copies[body_vertices].sum()),
                    local[edges[body_edges]],
                    bool(has_points[k]),
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
        for noun in ("vertices", "faces", "edges", "points"):
            a, b = (len(getattr(mesh, noun)) for mesh in (first, frame))
            if a != b:
                raise InputError(
                    f"topology differs: {first.path} has {len(first.vertices)} vertices and {len(first.faces)} faces, "
                    f"{frame.path} has {len(frame.vertices)} vertices and {len(frame.faces)} faces; "
                    f"both frames need the same {noun} in the same order"
                )
        if not all(np.array_equal(a, b) for a, b in zip(_topology(first), _topology(frame), strict=True)):
            ours, theirs = (_corners_of(mesh) for mesh in (first, frame))
            different = [k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b]
            k = different[0]
            is_turned = len(ours) == len(theirs) and all(_is_turned(ours[k], theirs[k]) for k in different)
            raise InputError(
                f"topology differs: face {k} is {ours[k]} in {first.path} and {theirs[k]} in {frame.path} "
                f"({len(different)} of {len(ours)} faces differ{', and in their orientation alone' * is_turned}); "
                "both frames need the same faces in the same order"
            )
        for kind in first.volumes.keys() | frame.volumes.keys():
            if not np.array_equal(first.volumes.get(kind, NO_EDGES), frame.volumes.get(kind, NO_EDGES)):
                raise InputError(f"topology differs: {first.path} and {frame.path} have other cells of the type {kind}")
        torn = np.flatnonzero((frame.vertices[self._copies] != frame.vertices[self._copied]).any(axis=1))
        if torn.size:
            a, b = int(self._copies[torn[0]]), int(self._copied[torn[0]])
            raise InputError(
                f"{frame.path}: vertex {a} leaves vertex {b}, although both are in one place in {first.path}; a format "
                "that stores a vertex several times does not say which ones are one, so save all frames in another, "
                "PLY for example"
            )
        return frame.vertices[self.source_index]

    def warn(self, *frames: Mesh) -> None:
        """Say what was left out of the file, and how far quadratic cells are off their corners in these frames."""
        for note in self._first.notes:
            warn(f"{self._first.path.name}: {note}")
        positions = (frame.vertices[self._merged] for frame in frames)
        warn_of_midsides(f"cells of {self._first.path.name}", self._midsides, self._faces, *positions)


def _merge(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The first of each set of vertices that are one, in order of appearance, and for each vertex the set's number."""
    node = np.zeros((len(mesh.vertices), 1))
    if mesh.element_name is not None:
        node[mesh.elements, 0] = mesh.element_name[:, None]
    # Adding 0.0 turns -0.0 into 0.0, because they are the same position; bits compare what is no number, too.
    rows = (np.hstack([mesh.vertices, node]) + 0.0).view(np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def _topology(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The elements, and the number of corners of each polygon."""
    return mesh.elements, np.zeros(0) if mesh.counts is None else mesh.counts


def _corners_of(mesh: Mesh) -> list[list[int]]:
    """The corners of each polygon, then the ends of each edge and the vertex of each point, for a message."""
    corners = mesh.faces.tolist()
    if mesh.counts is not None:
        fans = np.split(mesh.faces, np.cumsum(mesh.counts - 2)[:-1])
        corners = [[*of_face[0, :2].tolist(), *of_face[:, 2].tolist()] for of_face in fans]
    return [*corners, *mesh.edges.tolist(), *mesh.points[:, None].tolist()]


def _is_turned(corners: list[int], others: list[int]) -> bool:
    """Whether others are the same ones the other way round, from any of them on."""
    back = others[::-1]
    return any(back[k:] + back[:k] == corners for k in range(len(back)))


def _by_part(parts: np.ndarray, count: int) -> list[np.ndarray]:
    """The indices that belong to each part, ascending."""
    return np.split(np.argsort(parts, kind="stable"), np.cumsum(np.bincount(parts, minlength=count))[:-1])


def file_bodies(path: Path, *, surface: bool, split: bool, is_static: bool = False) -> list[Body]:
    """The bodies of a file that is read once."""
    mesh = read_mesh(path, surface=surface)
    of_file = FileBodies(mesh, path.name, split=split, is_static=is_static)
    of_file.warn(mesh)
    return of_file.bodies


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
        codimensional_points=[body.has_points for body in bodies],
        names=distinct_names([body.name for body in bodies]),
        **options,
    )
