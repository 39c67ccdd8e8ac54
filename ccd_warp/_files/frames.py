"""Read mesh frames in full precision, merge vertices that their format splits, and write frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.mesh import Mesh, Reading, read_mesh
from ccd_warp._files.natural import are_swapped
from ccd_warp._files.parts import Parts, Split, components, groups
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import check_count
from ccd_warp._scene.input.cells import warn_of_midsides
from ccd_warp._scene.input.messages import InputError, warn

_MOST_BYTES = 2**63 - 1


@dataclass(frozen=True)
class Body:
    """One body of a scene, or all bodies of a file, which :meth:`split` tells apart.

    Attributes:
        name: Shown in the report, mostly the file's name.
        vertices_t0: Start positions, float64, shape [n, 3].
        vertices_t1: End positions, float64, shape [n, 3]; the start positions for a static body.
        faces: Vertex indices within the body, shape [m, 3].
        source_index: Index of each vertex in its file (the first of merged ones), shape [n].
        is_static: True for an obstacle that does not move.
        names: Names of the objects, groups and nodes in the file.
        face_name: Index of the name of each face, shape [m]; None where there is one name.
        num_copies: Number of vertices that were merged into each, shape [n]; None where none were.
        half_space: The half-space that it is in place of a mesh; None of a file.
        is_surface: Whether its faces are the surface of volumes, so that the other vertices are inside them.
        parts: The parts of its cells into which it is to be split; None if it is not.
    """

    name: str
    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray
    source_index: np.ndarray
    is_static: bool = False
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None
    num_copies: np.ndarray | None = None
    half_space: HalfSpace | None = None
    is_surface: bool = False
    parts: Parts | None = None

    @classmethod
    def of_half_space(cls, name: str, half_space: HalfSpace) -> "Body":
        """A half-space as a body, which has no vertices of its own."""
        none = np.zeros((0, 3))
        return replace(make_body(name, none, None, none, is_static=True), half_space=half_space)

    @property
    def merged(self) -> int:
        """Number of the file's vertices that were merged into others."""
        return 0 if self.num_copies is None else int(self.num_copies.sum())

    @property
    def arrays(self) -> tuple[Any, ...] | HalfSpace:
        """What :meth:`ccd_warp.CollisionMesh.from_arrays` takes of it: the vertices inside take no part."""
        return self.half_space or (self.vertices_t0, {"triangle": self.faces} if self.is_surface else self.faces)

    def split(self, split: Split = False) -> list["Body"]:
        """The objects, groups and nodes of the file as bodies of their own, called by their names.

        Those that share a vertex are one body. A vertex in no face belongs to the body of the vertex before it.

        Args:
            split: Whether each of these is divided into its connected components; a field divided it in reading.
        """
        cells, count = [self.faces], len(self.vertices_t0)
        if self.parts is not None:
            return self._divided(self.parts)
        if self.face_name is not None:
            bodies = self._divided(groups(self.names, self.face_name, cells, count))
            return [part for body in bodies for part in body.split(split)] if split is True else bodies
        return self._divided(components(cells, count)) if split is True else [self]

    def _divided(self, parts: Parts) -> list["Body"]:
        """Each part as a body."""
        if len(parts.names) == 1:
            return [replace(self, names=("",), face_name=None, parts=None)]
        vertex_part = parts.of_vertex
        last = np.maximum.accumulate(np.where(vertex_part >= 0, np.arange(len(vertex_part)), -1))
        vertex_part = vertex_part[np.where(last >= 0, last, self.faces.min())]
        vertices, faces = (_by_part(each, len(parts.names)) for each in (vertex_part, vertex_part[self.faces[:, 0]]))
        local = np.empty(len(vertex_part), dtype=np.int64)
        bodies = []
        for name, chosen, of_part in zip(parts.names, vertices, faces, strict=True):
            local[chosen] = np.arange(len(chosen))
            bodies.append(
                Body(
                    self.name + name if parts.is_suffix else name or self.name,
                    self.vertices_t0[chosen],
                    self.vertices_t1[chosen],
                    local[self.faces[of_part]],
                    self.source_index[chosen],
                    self.is_static,
                    num_copies=None if self.num_copies is None else self.num_copies[chosen],
                    is_surface=self.is_surface,
                )
            )
        return bodies


def _by_part(parts: np.ndarray, count: int) -> list[np.ndarray]:
    """The indices that belong to each part, ascending."""
    return np.split(np.argsort(parts, kind="stable"), np.cumsum(np.bincount(parts, minlength=count))[:-1])


def make_body(name: str, vertices_t0, vertices_t1, faces, *, is_static: bool = False) -> Body:
    """A body from plain arrays; ``vertices_t1`` may be None for a static one."""
    start = np.array(vertices_t0, dtype=np.float64)
    end = start if vertices_t1 is None else np.array(vertices_t1, dtype=np.float64)
    return Body(name, start, end, np.array(faces, dtype=np.int64), np.arange(len(start)), is_static)


def read_frames(start_path: str | Path, end_path: str | Path, **options: Any) -> Body:
    """Read the two ends of a step, with the same faces, as a moving body; ``options`` are those of :class:`Reading`.

    Raises:
        InputError: If a file is missing, damaged, not finite, unpacks to more than the limit, or the two differ in
            topology.
        ValueError: If ``max_bytes`` is not a positive integer.
    """
    how = _reading(options)
    start, end = read_mesh(Path(start_path), how), read_mesh(Path(end_path), how._replace(split=False))
    body = body_between(start, end)
    warn_of_step(start, end)
    return body


def _reading(options: dict[str, Any]) -> Reading:
    how = Reading(**options)
    check_count("max_bytes", how.max_bytes, _MOST_BYTES)
    return how


def warn_of_step(start: Mesh, end: Mesh) -> None:
    """Say what is odd about two frames: nodes of quadratic cells off their edges, and names in the other order."""
    warn_of_midsides(f"cells of {start.path.name}", start.midsides, start.faces, start.vertices, end.vertices)
    if are_swapped(start.path, end.path):
        warn(
            f"the step goes from {start.path.name} to {end.path.name}; are the two swapped? The frame at the start of "
            "the step comes first"
        )


def body_between(start: Mesh, end: Mesh) -> Body:
    """The moving body of a step between two frames.

    Raises:
        InputError: If the two differ in topology, or in which vertices are one.
    """
    if start.sharing != end.sharing:
        raise InputError(
            f"{start.path} and {end.path} store shared vertices in different ways; "
            "save both frames in the same format, PLY for example"
        )
    for noun, in_start, in_end in (
        ("vertices", start.vertices, end.vertices),
        ("faces", start.faces, end.faces),
    ):
        if len(in_start) != len(in_end):
            raise InputError(
                f"topology differs: {start.path} has {len(start.vertices)} vertices and {len(start.faces)} faces, "
                f"{end.path} has {len(end.vertices)} vertices and {len(end.faces)} faces; "
                f"both frames need the same {noun} in the same order"
            )
    different = np.flatnonzero((start.faces != end.faces).any(axis=1))
    if different.size:
        k = int(different[0])
        raise InputError(
            f"topology differs: face {k} is {start.faces[k].tolist()} in {start.path} "
            f"and {end.faces[k].tolist()} in {end.path} ({different.size} of {len(start.faces)} faces differ); "
            "both frames need the same faces in the same order"
        )
    if start.sharing == "indexed":
        return _body(start, end.vertices)
    if start.sharing == "split":
        # The file gives different indices to copies of a vertex that coincide throughout the step: they agree at both
        # ends and hence on the whole trajectory. Without merging, every seam would be in contact with itself at t = 0.
        return _body(start, end.vertices, _merge(start, start.vertices, end.vertices))
    source_index, merged = _merge(start, start.vertices)
    torn = np.flatnonzero((end.vertices[source_index][merged] != end.vertices).any(axis=1))
    if torn.size:
        k, other = int(torn[0]), int(source_index[merged[torn[0]]])
        raise InputError(
            f"{end.path}: corner {k % 3} of face {k // 3} leaves corner {other % 3} of face {other // 3}, although "
            f"they are one vertex in {start.path}; an STL file does not say which corners are one vertex, so save both "
            "frames in a format that does, PLY for example"
        )
    return _body(start, end.vertices, (source_index, merged))


def read_static(path: str | Path, **options: Any) -> Body:
    """Read an obstacle that does not move; ``options`` are those of :class:`Reading`, and a field may be missing."""
    mesh = read_mesh(Path(path), _reading({"needs_field": False, **options}))
    warn_of_midsides(f"cells of {mesh.path.name}", mesh.midsides, mesh.faces, mesh.vertices)
    return _body(mesh, None, None if mesh.sharing == "indexed" else _merge(mesh, mesh.vertices))


def _body(mesh: Mesh, vertices_t1: np.ndarray | None, merged: tuple[np.ndarray, np.ndarray] | None = None) -> Body:
    """The body of a mesh, static without end positions; ``merged`` is what :func:`_merge` gives."""
    index = np.arange(len(mesh.vertices))
    source_index, of_vertex = (index, index) if merged is None else merged
    return Body(
        mesh.path.name,
        mesh.vertices[source_index],
        (mesh.vertices if vertices_t1 is None else vertices_t1)[source_index],
        of_vertex[mesh.faces],
        source_index,
        is_static=vertices_t1 is None,
        names=mesh.names,
        face_name=mesh.face_name,
        num_copies=None if merged is None else np.bincount(of_vertex) - 1,
        is_surface=mesh.is_surface or len(mesh.midsides) > 0,
        parts=mesh.parts,
    )


def _merge(mesh: Mesh, *frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first of each set of vertices that are one, in order of appearance, and for each vertex the set's number.

    They are in the same place in all frames, and in one node: those of two nodes are two bodies that touch.
    """
    node = np.zeros((len(mesh.vertices), 1))
    if mesh.face_name is not None:
        node[mesh.faces, 0] = mesh.face_name[:, None]
    # Adding 0.0 turns -0.0 into 0.0, because they are the same position; bits compare what is no number, too.
    rows = (np.hstack([*frames, node]) + 0.0).view(np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def write_mesh(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a binary PLY file in double precision (trimesh writes single)."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    rows["count"] = 3
    rows["indices"] = faces
    path.write_bytes(header.encode() + np.ascontiguousarray(vertices, dtype="<f8").tobytes() + rows.tobytes())
