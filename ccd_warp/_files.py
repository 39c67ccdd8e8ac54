"""Read mesh frames in any format that trimesh reads, in full precision."""

import io
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

# How a format stores a vertex that several faces share.
#   indexed: once; the file's own vertices are taken as they are.
#   split:   once per normal, texture coordinate or material (glTF), so one vertex may appear several times.
#   soup:    once per face corner (STL).
Sharing = Literal["indexed", "split", "soup"]
_SHARING: dict[str, Sharing] = {".stl": "soup", ".stl_ascii": "soup", ".glb": "split", ".gltf": "split"}


class InputError(ValueError):
    """Bad input of the command line; the message is one line that says what is wrong and what to do."""


@dataclass(frozen=True)
class Body:
    """One body of a scene.

    Attributes:
        name: Shown in the report, mostly the file's name.
        vertices_t0: Start positions, float64, shape [n, 3].
        vertices_t1: End positions, float64, shape [n, 3]; the start positions for a static body.
        faces: Vertex indices within the body, shape [m, 3].
        source_index: Index of each vertex in its file (the first of those that were merged), shape [n].
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
    """A body of plain arrays; ``vertices_t1`` may be None for a static one."""
    start = np.array(vertices_t0, dtype=np.float64)
    end = start if vertices_t1 is None else np.array(vertices_t1, dtype=np.float64)
    return Body(name, start, end, np.array(faces, dtype=np.int64), np.arange(len(start)), is_static)


@dataclass(frozen=True)
class _Mesh:
    """One file as it stands: vertices in double precision, nothing merged or reordered."""

    path: Path
    vertices: np.ndarray
    faces: np.ndarray
    sharing: Sharing


def read_frames(start_path: str | Path, end_path: str | Path) -> Body:
    """Read the two ends of a step.

    Args:
        start_path: Mesh file of the start positions.
        end_path: Mesh file of the end positions, with the same faces.

    Returns:
        A moving body.

    Raises:
        InputError: If a file is missing, unreadable, not finite, or the two differ in topology.
    """
    start, end = _read_mesh(Path(start_path)), _read_mesh(Path(end_path))
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
        # The file's indices tell copies apart that never part during the step. Both ends of a copy agree, so its
        # whole trajectory does, and leaving it unmerged would report a contact of every seam with itself at t = 0.
        source_index, merged = _merge(np.hstack([start.vertices, end.vertices]))
    return Body(
        name,
        start.vertices[source_index],
        end.vertices[source_index],
        merged[start.faces],
        source_index,
        merged=len(merged) - len(source_index),
    )


def read_static(path: str | Path) -> Body:
    """Read an obstacle that does not move.

    Args:
        path: Mesh file.

    Returns:
        A static body.

    Raises:
        InputError: If the file is missing, unreadable or not finite.
    """
    mesh = _read_mesh(Path(path))
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
    """First index of each distinct row, in order of appearance, and the number of each row's class."""
    # Adding 0.0 turns -0.0 into 0.0: one position, whatever its sign bits.
    _, first, inverse = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def _read_mesh(path: Path) -> _Mesh:
    """Load one file with trimesh, every part of a scene in its place, nothing merged, reordered or rounded."""
    import trimesh

    if not path.is_file():
        raise InputError(f"{path}: no such file; give a mesh file such as PLY, OBJ, STL, OFF or GLB")
    suffix = path.suffix.lower()
    # `process` would merge and drop vertices; the others keep textures from doing it.
    keep: dict[str, Any] = {"process": False, "maintain_order": True, "skip_materials": True}
    if suffix == ".ply":
        keep["fix_texture"] = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if suffix == ".obj":
                stripped = io.BytesIO(_strip_obj(path.read_bytes()))
                scene = trimesh.load_scene(stripped, file_type="obj", **keep)
            else:
                scene = trimesh.load_scene(str(path), **keep)
            parts = _flatten(scene)
    except Exception as error:  # the loaders raise whatever their parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: trimesh cannot read it as a mesh ({reason}); save it as PLY, OBJ, STL, OFF or GLB"
        ) from error
    if not parts:
        raise InputError(f"{path}: holds no triangles; give a triangle mesh")
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = np.vstack([vertices for vertices, _ in parts])
    faces = np.vstack([faces + offset for (_, faces), offset in zip(parts, offsets, strict=False)])
    if faces.min() < 0 or faces.max() >= len(vertices):
        k = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise InputError(
            f"{path}: face {k} is {faces[k].tolist()}, but the file has {len(vertices)} vertices; repair the file"
        )
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"{path}: vertex {k} is {vertices[k].tolist()} ({bad.size} of {len(vertices)} vertices are not finite); "
            "every coordinate must be finite"
        )
    return _Mesh(path, vertices, faces, _SHARING.get(suffix, "indexed"))


def _flatten(scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and faces of every mesh of a scene, moved to where the scene puts it."""
    parts = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64)
        if faces.size == 0:
            continue
        vertices = np.array(mesh.vertices, dtype=np.float64)
        # Compared exactly: trimesh's own flattening leaves out a motion that is nearly nothing.
        if not np.array_equal(matrix, np.eye(4)):
            vertices = vertices @ np.asarray(matrix)[:3, :3].T + np.asarray(matrix)[:3, 3]
        parts.append((vertices, faces.reshape(-1, 3)))
    return parts


def _strip_obj(text: bytes) -> bytes:
    """An OBJ file's vertices and faces alone.

    trimesh splits the vertices of an OBJ file at every seam of its texture or normals and sorts faces by material;
    with those left out it keeps the vertices and the faces of the file.
    """
    joined = text.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    lines = [line.strip() for line in joined.split(b"\n")]
    kept = [re.sub(rb"/\S*", b"", line) for line in lines if line.startswith((b"v ", b"v\t", b"f ", b"f\t"))]
    return b"\n".join(kept)


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
