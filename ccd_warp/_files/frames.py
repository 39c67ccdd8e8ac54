"""Read mesh frames in full precision, merge vertices that their format splits, and write frames."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.mesh import read_mesh
from ccd_warp._input.arguments import check_count
from ccd_warp._input.messages import InputError

_MOST_BYTES = 2**63 - 1

__all__ = ["Body", "InputError", "make_body", "read_frames", "read_static", "write_mesh"]


@dataclass(frozen=True)
class Body:
    """One body of a scene.

    Attributes:
        name: Shown in the report, mostly the file's name.
        vertices_t0: Start positions, float64, shape [n, 3].
        vertices_t1: End positions, float64, shape [n, 3]; the start positions for a static body.
        faces: Vertex indices within the body, shape [m, 3].
        source_index: Index of each vertex in its file (the first of merged ones), shape [n].
        is_static: True for an obstacle that does not move.
        merged: Number of the file's vertices that were merged into others.
    """

    name: str
    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray
    source_index: np.ndarray
    is_static: bool = False
    merged: int = 0


def make_body(name: str, vertices_t0, vertices_t1, faces, *, is_static: bool = False) -> Body:
    """A body from plain arrays; ``vertices_t1`` may be None for a static one."""
    start = np.array(vertices_t0, dtype=np.float64)
    end = start if vertices_t1 is None else np.array(vertices_t1, dtype=np.float64)
    return Body(name, start, end, np.array(faces, dtype=np.int64), np.arange(len(start)), is_static)


def read_frames(start_path: str | Path, end_path: str | Path, *, max_bytes: int = MAX_BYTES) -> Body:
    """Read the two ends of a step.

    Args:
        start_path: Mesh file of the start positions.
        end_path: Mesh file of the end positions, with the same faces.
        max_bytes: Limit on the unpacked size of an archive.

    Returns:
        A moving body.

    Raises:
        InputError: If a file is missing, damaged, not finite, unpacks to more than the limit, or the two differ in
            topology.
        ValueError: If ``max_bytes`` is not a positive integer.
    """
    max_bytes = check_count("max_bytes", max_bytes, _MOST_BYTES)
    start, end = read_mesh(Path(start_path), max_bytes), read_mesh(Path(end_path), max_bytes)
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
        return make_body(name, start.vertices, end.vertices, start.faces)
    if start.sharing == "soup":
        source_index, merged = _merge(start.vertices)
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
        source_index, merged = _merge(np.hstack([start.vertices, end.vertices]))
    return Body(
        name,
        start.vertices[source_index],
        end.vertices[source_index],
        merged[start.faces],
        source_index,
        merged=len(merged) - len(source_index),
    )


def read_static(path: str | Path, *, max_bytes: int = MAX_BYTES) -> Body:
    """Read an obstacle that does not move.

    Args:
        path: Mesh file.
        max_bytes: Limit on the unpacked size of an archive.

    Returns:
        A static body.

    Raises:
        InputError: If the file is missing, damaged or not finite, or unpacks to more than the limit.
        ValueError: If ``max_bytes`` is not a positive integer.
    """
    mesh = read_mesh(Path(path), check_count("max_bytes", max_bytes, _MOST_BYTES))
    if mesh.sharing == "indexed":
        return make_body(mesh.path.name, mesh.vertices, None, mesh.faces, is_static=True)
    source_index, merged = _merge(mesh.vertices)
    vertices = mesh.vertices[source_index]
    return Body(
        mesh.path.name,
        vertices,
        vertices,
        merged[mesh.faces],
        source_index,
        is_static=True,
        merged=len(merged) - len(source_index),
    )


def _merge(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first index of each distinct row, in order of appearance, and for each row the number of its distinct row."""
    # Adding 0.0 turns -0.0 into 0.0, because they are the same position.
    _, first, inverse = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)
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
