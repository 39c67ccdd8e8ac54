"""Read mesh frames in full precision, merge vertices that their format splits, and write frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.mesh import Mesh, read_mesh
from ccd_warp._half_space import HalfSpace
from ccd_warp._input.arguments import check_count
from ccd_warp._input.messages import InputError

_MOST_BYTES = 2**63 - 1
_MOST_NAMES = 3  # of the groups of a body, in its name

__all__ = ["Body", "InputError", "body_between", "make_body", "read_frames", "read_static", "write_mesh"]


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
        merged: Number of the file's vertices that were merged into others.
        names: Names of the objects, groups and nodes in the file.
        face_name: Index of the name of each face, shape [m]; None where there is one name.
        num_copies: Number of vertices that were merged into each, shape [n]; None where none were.
        half_space: The half-space that it is in place of a mesh; None of a file.
        is_surface: Whether its faces are the surface of volumes, so that the other vertices are inside them.
    """

    name: str
    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray
    source_index: np.ndarray
    is_static: bool = False
    merged: int = 0
    names: Sequence[str] = ("",)
    face_name: np.ndarray | None = None
    num_copies: np.ndarray | None = None
    half_space: HalfSpace | None = None
    is_surface: bool = False

    @classmethod
    def of_half_space(cls, name: str, half_space: HalfSpace) -> "Body":
        """A half-space as a body, which has no vertices of its own."""
        none = np.zeros((0, 3))
        return replace(make_body(name, none, None, none, is_static=True), half_space=half_space)

    @property
    def arrays(self) -> tuple[Any, ...] | HalfSpace:
        """What :meth:`ccd_warp.CollisionMesh.from_arrays` takes of it: the vertices inside take no part."""
        return self.half_space or (self.vertices_t0, {"triangle": self.faces} if self.is_surface else self.faces)

    def split(self) -> list["Body"]:
        """The objects, groups and nodes of the file as bodies of their own, called by their names.

        Those that share a vertex are one body. A vertex in no face belongs to the body of the vertex before it.
        """
        if self.face_name is None:
            return [self]
        part_of_name = _connected(self.faces, self.face_name, len(self.names))
        vertex_part = np.full(len(self.vertices_t0), -1, dtype=np.int64)
        vertex_part[self.faces] = part_of_name[self.face_name][:, None]
        last = np.maximum.accumulate(np.where(vertex_part >= 0, np.arange(len(vertex_part)), -1))
        vertex_part = vertex_part[np.where(last >= 0, last, self.faces.min())]
        face_part = part_of_name[self.face_name]
        vertices, faces = _by_part(vertex_part, len(self.names)), _by_part(face_part, len(self.names))
        local = np.empty(len(vertex_part), dtype=np.int64)
        names: dict[int, list[str]] = {}
        for name in np.unique(self.face_name).tolist():
            names.setdefault(int(part_of_name[name]), []).append(self.names[name])
        bodies = []
        for part, of_part in names.items():
            chosen = vertices[part]
            local[chosen] = np.arange(len(chosen))
            bodies.append(
                Body(
                    _joined(of_part) or self.name,
                    self.vertices_t0[chosen],
                    self.vertices_t1[chosen],
                    local[self.faces[faces[part]]],
                    self.source_index[chosen],
                    self.is_static,
                    0 if self.num_copies is None else int(self.num_copies[chosen].sum()),
                )
            )
        return [replace(bodies[0], name=self.name)] if len(bodies) == 1 else bodies


def _by_part(parts: np.ndarray, count: int) -> list[np.ndarray]:
    """The indices that belong to each part, ascending."""
    return np.split(np.argsort(parts, kind="stable"), np.cumsum(np.bincount(parts, minlength=count))[:-1])


def _connected(faces: np.ndarray, face_name: np.ndarray, count: int) -> np.ndarray:
    """The number of the part to which each name belongs, where names whose faces share a vertex are one part."""
    part = np.arange(count)
    of_corner = np.repeat(face_name, 3)
    order = np.lexsort((of_corner, faces.ravel()))
    vertex, name = faces.ravel()[order], of_corner[order]
    shares = (vertex[1:] == vertex[:-1]) & (name[1:] != name[:-1])
    for a, b in np.unique(np.column_stack([name[:-1], name[1:]])[shares], axis=0).tolist():
        part[part == part[b]] = part[a]
    return part


def _joined(names: Sequence[str]) -> str:
    """The name of a body of several groups: that of their object, or the first ones."""
    distinct = list(dict.fromkeys(filter(None, names)))
    if len(distinct) > 1 and len({name.partition("/")[0] for name in distinct}) == 1:
        return distinct[0].partition("/")[0]
    shown = distinct[:_MOST_NAMES]
    return " + ".join(shown) + (f" + {len(distinct) - len(shown)} more" if len(distinct) > len(shown) else "")


def make_body(name: str, vertices_t0, vertices_t1, faces, *, is_static: bool = False) -> Body:
    """A body from plain arrays; ``vertices_t1`` may be None for a static one."""
    start = np.array(vertices_t0, dtype=np.float64)
    end = start if vertices_t1 is None else np.array(vertices_t1, dtype=np.float64)
    return Body(name, start, end, np.array(faces, dtype=np.int64), np.arange(len(start)), is_static)


def read_frames(
    start_path: str | Path, end_path: str | Path, *, max_bytes: int = MAX_BYTES, surface: bool = False
) -> Body:
    """Read the two ends of a step.

    Args:
        start_path: Mesh file of the start positions.
        end_path: Mesh file of the end positions, with the same faces.
        max_bytes: Limit on the unpacked size of an archive; a plain file may have as much, or 1 GiB.
        surface: Whether volume cells stand for their boundary surface.

    Returns:
        A moving body.

    Raises:
        InputError: If a file is missing, damaged, not finite, unpacks to more than the limit, or the two differ in
            topology.
        ValueError: If ``max_bytes`` is not a positive integer.
    """
    max_bytes = check_count("max_bytes", max_bytes, _MOST_BYTES)
    start, end = (read_mesh(Path(path), max_bytes, surface=surface) for path in (start_path, end_path))
    return body_between(start, end)


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
    name = start.path.name
    if start.sharing == "indexed":
        body = make_body(name, start.vertices, end.vertices, start.faces)
        return replace(body, names=start.names, face_name=start.face_name, is_surface=start.is_surface)
    if start.sharing == "soup":
        source_index, merged = _merge(np.hstack([start.vertices, _node_of_vertex(start)]))
        torn = np.flatnonzero((end.vertices[source_index][merged] != end.vertices).any(axis=1))
        if torn.size:
            k = int(torn[0])
            raise InputError(
                f"{end.path}: corner {k % 3} of face {k // 3} leaves corner {source_index[merged[k]] % 3} of face "
                f"{source_index[merged[k]] // 3}, although they are one vertex in {start.path}; an STL file does not "
                "say which corners are one vertex, so save both frames in a format that does, PLY for example"
            )
    else:
        # The file gives different indices to copies of a vertex that coincide throughout the step: they agree at both
        # ends and hence on the whole trajectory. Without merging, every seam would be in contact with itself at t = 0.
        source_index, merged = _merge(np.hstack([start.vertices, end.vertices, _node_of_vertex(start)]))
    return Body(
        name,
        start.vertices[source_index],
        end.vertices[source_index],
        merged[start.faces],
        source_index,
        False,
        len(merged) - len(source_index),
        start.names,
        start.face_name,
        np.bincount(merged) - 1,
    )


def read_static(path: str | Path, *, max_bytes: int = MAX_BYTES, surface: bool = False) -> Body:
    """Read an obstacle that does not move.

    Args:
        path: Mesh file.
        max_bytes: Limit on the unpacked size of an archive; a plain file may have as much, or 1 GiB.
        surface: Whether volume cells stand for their boundary surface.

    Returns:
        A static body.

    Raises:
        InputError: If the file is missing, damaged or not finite, or unpacks to more than the limit.
        ValueError: If ``max_bytes`` is not a positive integer.
    """
    mesh = read_mesh(Path(path), check_count("max_bytes", max_bytes, _MOST_BYTES), surface=surface)
    if mesh.sharing == "indexed":
        body = make_body(mesh.path.name, mesh.vertices, None, mesh.faces, is_static=True)
        return replace(body, names=mesh.names, face_name=mesh.face_name, is_surface=mesh.is_surface)
    source_index, merged = _merge(np.hstack([mesh.vertices, _node_of_vertex(mesh)]))
    vertices = mesh.vertices[source_index]
    return Body(
        mesh.path.name,
        vertices,
        vertices,
        merged[mesh.faces],
        source_index,
        True,
        len(merged) - len(source_index),
        mesh.names,
        mesh.face_name,
        np.bincount(merged) - 1,
    )


def _node_of_vertex(mesh: Mesh) -> np.ndarray:
    """The node of each vertex, shape [n, 1]: vertices of different nodes are not one, wherever they are."""
    node = np.zeros((len(mesh.vertices), 1))
    if mesh.face_name is not None:
        node[mesh.faces, 0] = mesh.face_name[:, None]
    return node


def _merge(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first index of each distinct row, in order of appearance, and for each row the number of its distinct row."""
    # Adding 0.0 turns -0.0 into 0.0, because they are the same position; bits compare what is no number, too.
    _, first, inverse = np.unique((rows + 0.0).view(np.int64), axis=0, return_index=True, return_inverse=True)
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
