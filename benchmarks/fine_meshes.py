"""Scenes of any number of faces, also of the benchmarks: sheets and spheres, and two spheres through each other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh


@dataclass(frozen=True)
class Scene:
    """A mesh at both ends of a step, with its static bodies and those without self-collision."""

    name: str
    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray
    body_faces: tuple[int, ...] = ()  # faces of each body, in order; one body if empty
    static: tuple[int, ...] = field(default=())
    self_collision: bool = True
    worlds: int = 1  # all alike, whose vertices follow one another; faces are those of the first

    def mesh(self, ccd, *more, **options):
        """The ``CollisionMesh`` of the scene, with half-spaces besides; options are those of meshes."""
        options |= {"self_collision": self.self_collision}
        if not self.body_faces:
            return ccd.CollisionMesh.from_arrays([(self.vertices_t0, self.faces)], **options)
        bodies = []
        for faces in np.split(self.faces, np.cumsum(self.body_faces)[:-1]):
            low, high = faces.min(), faces.max() + 1
            bodies.append((self.vertices_t0[low:high], faces - low))
        mesh = ccd.CollisionMesh.from_arrays([*bodies, *more], static=self.static, **options)
        return mesh if self.worlds == 1 else mesh.replicate(self.worlds)


def grid(rows: int, columns: int, width: float = 2.0, length: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A sheet in the plane z = 0 around the origin: vertices and faces."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, rows) * width, np.linspace(-0.5, 0.5, columns) * length, indexing="ij")
    k = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (corner.ravel() for corner in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces


def sphere(num_faces: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of roughly ``num_faces`` faces: the finely divided surface of a cube, projected onto it."""
    n = max(2, round((num_faces / 12) ** 0.5) + 1)
    side, faces = grid(n, n)
    turns = [np.roll(np.eye(3), k, axis=0) for k in range(3)]
    vertices, all_faces = [], []
    for turn in turns:
        for sign in (1.0, -1.0):
            all_faces.append((faces if sign > 0 else faces[:, ::-1]) + len(vertices) * n * n)
            vertices.append((side + [0, 0, sign]) @ turn)
    merged = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(all_faces), process=True)
    points = np.asarray(merged.vertices)
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True), np.asarray(merged.faces)


def joined(name: str, parts: list, **options) -> Scene:
    """One scene of bodies (vertices_t0, vertices_t1, faces)."""
    offset = np.cumsum([0] + [len(start) for start, _, _ in parts])
    return Scene(
        name,
        np.concatenate([start for start, _, _ in parts]),
        np.concatenate([end for _, end, _ in parts]),
        np.concatenate([faces + offset[k] for k, (_, _, faces) in enumerate(parts)]),
        tuple(len(faces) for _, _, faces in parts),
        **options,
    )


def spheres_through_each_other(
    num_faces: int, name: str = "two spheres", apart: float = 0.6, move: float = 0.15
) -> Scene:
    """Two dense spheres of radius 0.5, so far from the middle, move so far into or through each other."""
    ball, faces = sphere(num_faces // 2, 0.5)
    left, right, along = ball - [apart, 0, 0], ball + [apart, 0.013, 0.017], np.array([move, 0, 0])
    return joined(f"{name}, {num_faces:,}", [(left, left + along, faces), (right, right - along, faces)])
